#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// What association remembers of a landmark.
struct Track {
  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::min() / 2;

  std::int64_t id = -1;
  std::vector<std::pair<int, double>> class_weights;  ///< summed detector scores by class
  int class_id = -1;                                  ///< of the largest weight
  std::int64_t observations = 0;
  std::int64_t last_answer = kNever;  ///< which of the detector's answers had it last, counted from 0
  std::int64_t last_stamp_ns = 0;
  std::int64_t last_keyframe_id = -1;
  Box last_box;  ///< undistorted, px
  LandmarkState state = LandmarkState::kCandidate;
  bool has_ellipsoid = false;
  bool is_provisional = false;  ///< the ellipsoid comes from depth as yet, not from several directions
  Vec3 center_map = Vec3::Zero();
  Mat3 shape_map = Mat3::Zero();  ///< R diag(a^2) R^T
  double size_m = 0.0;            ///< longest axis
  std::vector<Vec3> points_map;   ///< of its last observation with points, while without ellipsoid

  double class_share(int id_of_class) const {
    double total = 0.0, weight = 0.0;
    for (const auto& [id_, w] : class_weights) {
      total += w;
      if (id_ == id_of_class) weight = w;
    }
    return total > 0.0 ? weight / total : 0.0;
  }

  void add_class_weight(int id_of_class, double weight) {
    const auto it = std::find_if(class_weights.begin(), class_weights.end(),
                                 [id_of_class](const auto& entry) { return entry.first == id_of_class; });
    if (it == class_weights.end()) {
      class_weights.emplace_back(id_of_class, weight);
    } else {
      it->second += weight;
    }
    class_id = std::max_element(class_weights.begin(), class_weights.end(), [](const auto& a, const auto& b) {
                 return a.second < b.second || (a.second == b.second && a.first > b.first);
               })->first;
  }
};

/// The tracks by id, and by place: a uniform grid over the map tells which landmarks may be in view, so that the time
/// of a frame follows from what is near and not from the size of the map.
class TrackStore {
 public:
  Track* find(std::int64_t id);
  /// A new track, which must not exist yet.
  Track& create(std::int64_t id);
  void erase(std::int64_t id);

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
  std::unordered_map<std::int64_t, std::int32_t> slot_of_id_;  ///< in no order: what is found by it is sorted
  std::unordered_map<std::uint64_t, std::vector<std::int32_t>> slots_of_cell_;
  std::vector<std::int32_t> recent_;
  std::uint64_t query_ = 0;
  std::vector<const Track*> found_;  ///< by the last query
};

}  // namespace semantic_topo_loop::core
