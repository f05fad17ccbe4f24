#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <unordered_map>
#include <vector>

#include "association/track.h"

namespace semantic_topo_loop::core {

/// The tracks by id, and by place: a uniform grid over the map tells which landmarks may be in view, so that the time
/// of a frame follows from what is near and not from the size of the map.
class TrackStore {
 public:
  Track* find(std::int64_t id);
  /// A new track, which must not exist yet.
  Track& create(std::int64_t id);
  void erase(std::int64_t id);
  std::size_t size() const { return slot_of_id_.size(); }

  /// Enters the track's current ellipsoid or points into the grid; retired tracks and those without either leave it.
  void place(Track* track);
  /// Keeps the track among the recently seen ones.
  void touch(Track* track);

  /// Tracks in front of the camera up to `range_m` away, as far as the grid tells (more, but never fewer), and those
  /// for which `is_recent` holds; in order of id.
  /// @return valid until the next call
  template <class IsRecent>
  const std::vector<const Track*>& near(const Camera& camera, const SE3& T_map_camera, double range_m,
                                        IsRecent is_recent) {
    ++query_;
    found_.clear();
    collect_in_view(camera, T_map_camera, range_m);
    std::size_t kept = 0;
    for (const std::int32_t slot : recent_) {
      Entry& entry = entries_[static_cast<std::size_t>(slot)];
      entry.is_recent = entry.track.id >= 0 && is_recent(entry.track);
      if (!entry.is_recent) continue;
      recent_[kept++] = slot;
      visit(slot);
    }
    recent_.resize(kept);
    std::sort(found_.begin(), found_.end(), [](const Track* a, const Track* b) { return a->id < b->id; });
    return found_;
  }
  /// Every track, in order of id.
  std::vector<const Track*> all() const;

 private:
  using Cell = std::array<std::int32_t, 3>;
  struct CellRange {
    Cell low{0, 0, 0}, high{-1, -1, -1};  ///< inclusive; empty while high < low
    bool operator==(const CellRange& other) const { return low == other.low && high == other.high; }
  };
  struct Entry {
    Track track;
    CellRange cells;
    bool is_recent = false;
    std::uint64_t visited_by = 0;
  };

  void collect_in_view(const Camera& camera, const SE3& T_map_camera, double range_m);
  void visit(std::int32_t slot);
  void move_to(std::int32_t slot, const CellRange& cells);
  static CellRange cells_of(const Track& track);

  std::deque<Entry> entries_;  ///< by slot; pointers to tracks stay valid
  std::vector<std::int32_t> free_slots_;
  std::unordered_map<std::int64_t, std::int32_t> slot_of_id_;  ///< looked up only, never walked through
  std::unordered_map<std::uint64_t, std::vector<std::int32_t>> slots_of_cell_;
  std::vector<std::int32_t> recent_;
  std::uint64_t query_ = 0;
  std::vector<const Track*> found_;  ///< by the last query
};

}  // namespace semantic_topo_loop::core
