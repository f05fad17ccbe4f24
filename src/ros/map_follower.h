#pragma once

#include <cstdint>
#include <deque>
#include <set>
#include <vector>

#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop {

/// Keeps a follower of the quadric map in step with its versions: lets updates through that follow each other, and
/// bridges a gap with the full map. Not thread-safe.
class MapFollower {
 public:
  /// @return the updates to apply now, in order; empty for one that is older than the version held, and during a gap
  std::vector<core::MapUpdate> follow(const core::MapUpdate& update);
  /// @param full_map every landmark of its `map_version`, as FullMap brings it
  /// @return the jump to the full map, landmarks unknown there removed, and what came after it; empty without a gap
  std::vector<core::MapUpdate> recover(core::MapUpdate full_map);

  /// The map may have grown before this follower came: there is a gap until the full map has been seen.
  void join_late() { is_late_ = true; }
  bool has_gap() const { return is_late_ || !waiting_.empty(); }
  std::uint64_t gaps() const { return gaps_; }
  std::uint64_t version() const { return version_; }

 private:
  void take(const core::MapUpdate& update);

  std::uint64_t version_ = 0;
  std::set<std::int64_t> ids_;           ///< landmarks that the map has
  std::deque<core::MapUpdate> waiting_;  ///< updates behind the gap
  bool is_late_ = false;
  std::uint64_t gaps_ = 0;
};

}  // namespace semantic_topo_loop
