#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <vector>

#include "pipeline/map_state.h"

namespace semantic_topo_loop::core {

/// What the last session found other than the ones before it had left it, with the evidence.
struct MapChange {
  enum class Kind { kGone, kMoved, kNew };
  Kind kind = Kind::kGone;
  std::optional<std::int64_t> before_id;  ///< the object as it was: gone, or moved from there
  std::optional<std::int64_t> after_id;   ///< the object as it is: new, or moved there
  int boxes_before = 0;                   ///< boxes kept of it from the sessions before
  double seen_through_s = 0.0;            ///< for which depth has shown what lies behind it
  int looked_at_after = 0;   ///< keyframes of the last session that had its place in view from where it had been seen
  int boxes_after = 0;       ///< boxes kept of it from the last session
  int looked_at_before = 0;  ///< keyframes before that had its place in view from where it is seen now
};
const char* to_string(MapChange::Kind kind);

/// Changes between the last session of a map and the ones before. An object is gone if the last
/// session has no box of it, nor of another in its place, although it looked there as often as should have given many
/// boxes, or depth showed what lies behind it;
/// new if only the last session has boxes of it, although the ones before had its place long
/// in view and no such object there; one that is gone and a new one of its class and about its size are one that moved,
/// the nearest first.
/// @return in order of ids; nothing if there is one session
std::vector<MapChange> map_changes(const MapState& map);

/// What two parts of a map say of the places that both have looked at.
struct MapAgreement {
  int common = 0;  ///< confirmed objects with boxes of both
  /// Confirmed objects with boxes of the first part alone, or of the second, although keyframes of the other looked at
  /// their places from where they were seen.
  int only_first = 0, only_second = 0;

  /// The smaller share of what one part should have seen of the other's that it has seen.
  double ratio() const {
    return common > 0 ? static_cast<double>(common) / (common + std::max(only_first, only_second)) : 0.0;
  }
};
/// @param first_keyframe_id of the second part
MapAgreement map_agreement(const MapState& map, std::int64_t first_keyframe_id);

}  // namespace semantic_topo_loop::core
