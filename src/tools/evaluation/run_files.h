#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "tools/evaluation/loop_judge.h"
#include "tools/evaluation/object_evaluation.h"

namespace semantic_topo_loop::core {

/// Confirmed objects that were detected in a frame, by its stamp.
using Sightings = std::map<std::int64_t, std::set<std::int64_t>>;

/// Readers of a run's files and of the reference objects. Columns are found by the names in the header, so that their
/// order is free and more of them do no harm.
/// @return nullopt, with file, line, column and value in `error`
std::optional<std::vector<MappedObject>> read_objects(const std::string& path, std::string* error);
std::optional<std::vector<LoopRecord>> read_loops(const std::string& path, std::string* error);
/// Loops for the pose graph: the columns of loops.csv and, if they are there, `sigma_m,sigma_deg` of each axis of the
/// pose, else 0.03 m and 1 degree. Keyframe ids are left open: the run that takes them knows which frames they are.
std::optional<std::vector<LoopClosure>> read_given_loops(const std::string& path, std::string* error);
std::optional<std::vector<KeyframePose>> read_keyframes(const std::string& path, std::string* error);
std::optional<std::vector<ReferenceObject>> read_reference_objects(const std::string& path, std::string* error);
std::optional<std::vector<std::int64_t>> read_keyframe_stamps(const std::string& path, std::string* error);
/// From trajectory.txt, associations.csv and objects.csv of a run's directory.
std::optional<Sightings> read_sightings(const std::string& directory, std::string* error);

}  // namespace semantic_topo_loop::core
