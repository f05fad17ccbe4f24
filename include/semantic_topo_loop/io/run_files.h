#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// A row of objects.csv.
struct MappedObject {
  std::int64_t id = -1;
  int class_id = -1;
  std::string label;
  Vec3 center = Vec3::Zero();     ///< map frame, m
  Vec3 semi_axes = Vec3::Ones();  ///< m
  std::string state;              ///< candidate, confirmed or retired
  int observations = 0;
  Quaternion rotation = Quaternion::Identity();
  double baseline_deg = 0.0, mean_iou = 0.0, quality = 0.0;
};

/// @param landmark with an ellipsoid
MappedObject mapped_object(const Landmark& landmark, const ClassTable& classes);

/// A row of loops.csv. The pose is the identity for a candidate that was rejected before it had one.
struct LoopRecord : LoopFigures {
  std::string reason_text;  ///< the column `reason`: `LoopFigures::reason` is not read
};

/// A row of loop_objects.csv.
struct LoopObjectRecord {
  std::int64_t query_frame = -1, match_frame = -1, query_end = -1, match_end = -1;  ///< these name the loop
  bool is_query = false;  ///< of the query's submap, else of the match's
  int pair = -1;          ///< number of the pair that it belongs to, -1: none
  SubmapObject object;
  std::string label;
};

/// The tables of a run, as docs/files.md describes them: their first lines, and their rows with the end of line.
std::string keyframe_table_header();
std::string object_table_header();
std::string loop_table_header();
std::string loop_object_table_header();
std::string table_row(const KeyframePose& keyframe);
std::string table_row(const MappedObject& object);
std::string table_row(const LoopFigures& loop);
/// One row an object of the two submaps.
std::string loop_object_rows(const LoopClosure& loop, const ClassTable& classes);

/// Read such tables. Columns are found by the names in the header, so that their order is free and more of them do no
/// harm.
/// @return an error, with file, line, column and value
Result<std::vector<KeyframePose>> read_keyframes(const std::string& path);
Result<std::vector<MappedObject>> read_objects(const std::string& path);
Result<std::vector<LoopRecord>> read_loops(const std::string& path);
Result<std::vector<LoopObjectRecord>> read_loop_objects(const std::string& path);

/// Reads loops for the pose graph: the columns of loops.csv; `sigma_m,sigma_deg`, the stated errors of translation and
/// rotation, may be missing or not computed (-1) and are 0.05 m and 1.7 degrees then. Keyframe ids are left open: the
/// run that takes them knows which frames they are.
Result<std::vector<LoopClosure>> read_given_loops(const std::string& path);
/// Writes loops to be handed to the pose graph, as loops.csv; `sigma_m` and `sigma_deg` are what the covariance
/// says of translation and rotation, the root of its trace.
Status write_given_loops(const std::string& path, const std::vector<LoopClosure>& loops);

}  // namespace semantic_topo_loop::core
