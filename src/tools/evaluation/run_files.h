#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/result.h"
#include "tools/evaluation/loop_judge.h"
#include "tools/evaluation/object_evaluation.h"

namespace semantic_topo_loop::core {

/// Confirmed objects that were detected in a frame, by its stamp.
using Sightings = std::map<std::int64_t, std::set<std::int64_t>>;

/// Readers of a run's files and of the reference objects. Columns are found by the names in the header, so that their
/// order is free and more of them do no harm.
/// @return an error, with file, line, column and value
Result<std::vector<MappedObject>> read_objects(const std::string& path);
Result<std::vector<LoopRecord>> read_loops(const std::string& path);
/// Loops for the pose graph: the columns of loops.csv and, if they are there, `sigma_m,sigma_deg` of each axis of the
/// pose, else 0.03 m and 1 degree. Keyframe ids are left open: the run that takes them knows which frames they are.
Result<std::vector<LoopClosure>> read_given_loops(const std::string& path);
Result<std::vector<KeyframePose>> read_keyframes(const std::string& path);
Result<std::vector<ReferenceObject>> read_reference_objects(const std::string& path);
Result<std::vector<std::int64_t>> read_keyframe_stamps(const std::string& path);
/// From trajectory.txt, associations.csv and objects.csv of a run's directory.
Result<Sightings> read_sightings(const std::string& directory);

}  // namespace semantic_topo_loop::core
