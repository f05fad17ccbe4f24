#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// What is new in a landmark.
struct LandmarkDelta {
  LandmarkRecord record;
  std::size_t first = 0;                  ///< number of the first of `observations`; those before are as they were
  std::vector<Observation> observations;  ///< all from there on
};

/// That two landmarks became one. Ids that went so may be given out again in a later session.
struct LoggedMerge {
  std::int64_t number = 0;  ///< counted from 0 in the order they were made, over all sessions
  LandmarkMerge merge;
  int merged_class_id = -1, merged_observations = 0;  ///< of the one that went
  std::int64_t frame_id = -1;                         ///< after which it was made
  std::int64_t stamp_ns = 0;                          ///< of the last image that was answered then
  std::optional<std::int64_t> undone_frame_id;        ///< whose correction pulled the two apart again
};

/// What is new in a map of objects.
struct MapperDelta {
  bool is_whole = true;  ///< what is not in it is not in the map
  Camera camera;
  std::vector<LandmarkDelta> changed;  ///< in order of id
  std::vector<std::int64_t> removed;   ///< ids
  std::vector<LoggedMerge> merges;     ///< new, or taken back now; in order of number
  std::int64_t first_merge = 0;        ///< number; those before are forgotten
};

/// All that a later session needs of a map of objects to go on with it. Merges are settled: they are not taken back.
struct MapperState {
  Camera camera;                          ///< whose pixels the observations' boxes are in
  std::vector<MappedLandmark> landmarks;  ///< in order of id
  std::vector<LoggedMerge> merges;        ///< in order of number
};

/// Takes a landmark's boxes from the pixels of one camera to those of another, which sees along the same rays.
/// @return false, and all as it was, if their pixels are the same
bool move_boxes(const Camera& from, const Camera& to, MappedLandmark* landmark);

/// Forgets beside which landmarks each was seen that are no more: another one may be given their id.
/// @param landmarks all of a map
void forget_gone_neighbours(std::vector<MappedLandmark>* landmarks);

}  // namespace semantic_topo_loop::core
