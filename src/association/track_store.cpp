#include "association/track_store.h"

#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr double kCell_m = 2.0;        // a desk: some hundred cells in a view of 10 m, and few landmarks in each
constexpr double kViewCellsMax = 1e5;  // a broken calibration sees more: then every track is looked at instead
constexpr int kCellsMax = 5;           // along one side of an object, so that a broken size cannot fill the grid

std::array<std::int32_t, 3> cell_of(const Vec3& point) {
  constexpr double kLimit = 1e6;  // in cells: 21 bits of a key hold them with their sign
  const Vec3 cell = (point / kCell_m).cwiseMax(-kLimit).cwiseMin(kLimit).array().floor();
  return {static_cast<std::int32_t>(cell.x()), static_cast<std::int32_t>(cell.y()),
          static_cast<std::int32_t>(cell.z())};
}

std::uint64_t key_of(const std::array<std::int32_t, 3>& cell) {
  std::uint64_t key = 0;
  for (const std::int32_t c : cell) key = (key << 21) | (static_cast<std::uint64_t>(c + (1 << 20)) & 0x1fffff);
  return key;
}

template <class Function>
void for_each_cell(const std::array<std::int32_t, 3>& low, const std::array<std::int32_t, 3>& high, Function function) {
  for (std::int32_t x = low[0]; x <= high[0]; ++x) {
    for (std::int32_t y = low[1]; y <= high[1]; ++y) {
      for (std::int32_t z = low[2]; z <= high[2]; ++z) function(std::array<std::int32_t, 3>{x, y, z});
    }
  }
}

/// The pyramid that a camera sees, up to a range.
struct Frustum {
  std::array<Vec3, 4> inward;  ///< unit normals of the sides, map frame
  Vec3 apex, low, high;

  Frustum(const Camera& camera, const SE3& T_map_camera, double range_m) : apex(T_map_camera.t) {
    const Box image = camera.image();
    std::array<Vec3, 4> corners{camera.ray({image.x1, image.y1}), camera.ray({image.x2, image.y1}),
                                camera.ray({image.x2, image.y2}), camera.ray({image.x1, image.y2})};
    low = high = apex;
    for (Vec3& corner : corners) {
      corner = T_map_camera.q * corner;
      low = low.cwiseMin(apex + range_m * corner);
      high = high.cwiseMax(apex + range_m * corner);
    }
    for (std::size_t i = 0; i < 4; ++i) inward[i] = corners[i].cross(corners[(i + 1) % 4]).normalized();
  }

  /// Signed distances from the four sides to a point, inside positive.
  Vec4 distances(const Vec3& point) const {
    Vec4 result;
    for (std::size_t i = 0; i < 4; ++i) result(static_cast<Eigen::Index>(i)) = inward[i].dot(point - apex);
    return result;
  }
};

}  // namespace

Track* TrackStore::find(std::int64_t id) {
  const auto it = slot_of_id_.find(id);
  return it == slot_of_id_.end() ? nullptr : &entries_[static_cast<std::size_t>(it->second)].track;
}

Track& TrackStore::create(std::int64_t id) {
  std::int32_t slot = static_cast<std::int32_t>(entries_.size());
  if (free_slots_.empty()) {
    entries_.emplace_back();
  } else {
    slot = free_slots_.back();
    free_slots_.pop_back();
  }
  slot_of_id_[id] = slot;
  Entry& entry = entries_[static_cast<std::size_t>(slot)];
  entry.track.id = id;
  return entry.track;
}

void TrackStore::erase(std::int64_t id) {
  const auto it = slot_of_id_.find(id);
  if (it == slot_of_id_.end()) return;
  const std::int32_t slot = it->second;
  move_to(slot, {});
  Entry& entry = entries_[static_cast<std::size_t>(slot)];
  if (entry.is_recent) recent_.erase(std::find(recent_.begin(), recent_.end(), slot));
  entry = Entry();
  free_slots_.push_back(slot);
  slot_of_id_.erase(it);
}

void TrackStore::place(Track* track) { move_to(slot_of_id_.at(track->id), cells_of(*track)); }

void TrackStore::touch(Track* track) {
  const std::int32_t slot = slot_of_id_.at(track->id);
  Entry& entry = entries_[static_cast<std::size_t>(slot)];
  if (entry.is_recent) return;
  entry.is_recent = true;
  recent_.push_back(slot);
}

std::vector<const Track*> TrackStore::all() const {
  std::vector<const Track*> tracks;
  tracks.reserve(slot_of_id_.size());
  for (const Entry& entry : entries_) {
    if (entry.track.id >= 0) tracks.push_back(&entry.track);
  }
  std::sort(tracks.begin(), tracks.end(), [](const Track* a, const Track* b) { return a->id < b->id; });
  return tracks;
}

void TrackStore::collect_in_view(const Camera& camera, const SE3& T_map_camera, double range_m) {
  const Frustum frustum(camera, T_map_camera, range_m);
  const double view_cells = ((frustum.high - frustum.low).array() / kCell_m + 1.0).prod();
  if (!(view_cells <= kViewCellsMax)) {  // or is not a number
    for (const auto& [id, slot] : slot_of_id_) visit(slot);
    return;
  }
  const Cell low = cell_of(frustum.low), high = cell_of(frustum.high);
  // From cell to cell the distances to the sides change by constants, so that a cell costs a few additions.
  const double cell_radius = 0.5 * std::sqrt(3.0) * kCell_m;
  const Vec3 first = kCell_m * Vec3(low[0] + 0.5, low[1] + 0.5, low[2] + 0.5);
  const Vec4 start = frustum.distances(first).array() + cell_radius;
  std::array<Vec4, 3> step;
  for (std::size_t i = 0; i < 3; ++i) {
    const Vec3 next = first + kCell_m * Vec3::Unit(static_cast<Eigen::Index>(i));
    step[i] = frustum.distances(next) - frustum.distances(first);
  }
  Vec4 of_x = start;
  for (std::int32_t x = low[0]; x <= high[0]; ++x, of_x += step[0]) {
    Vec4 of_y = of_x;
    for (std::int32_t y = low[1]; y <= high[1]; ++y, of_y += step[1]) {
      Vec4 of_z = of_y;
      for (std::int32_t z = low[2]; z <= high[2]; ++z, of_z += step[2]) {
        if (of_z.minCoeff() < 0.0) continue;
        const auto slots = slots_of_cell_.find(key_of({x, y, z}));
        if (slots == slots_of_cell_.end()) continue;
        for (const std::int32_t slot : slots->second) visit(slot);
      }
    }
  }
}

void TrackStore::visit(std::int32_t slot) {
  Entry& entry = entries_[static_cast<std::size_t>(slot)];
  if (entry.visited_by == query_) return;  // it spans several cells
  entry.visited_by = query_;
  found_.push_back(&entry.track);
}

void TrackStore::move_to(std::int32_t slot, const CellRange& cells) {
  Entry& entry = entries_[static_cast<std::size_t>(slot)];
  if (entry.cells == cells) return;
  for_each_cell(entry.cells.low, entry.cells.high, [&](const Cell& cell) {
    const auto it = slots_of_cell_.find(key_of(cell));
    it->second.erase(std::find(it->second.begin(), it->second.end(), slot));
    if (it->second.empty()) slots_of_cell_.erase(it);
  });
  entry.cells = cells;
  for_each_cell(cells.low, cells.high, [&](const Cell& cell) { slots_of_cell_[key_of(cell)].push_back(slot); });
}

TrackStore::CellRange TrackStore::cells_of(const Track& track) {
  Vec3 low, high;
  if (track.state == LandmarkState::kRetired) return {};
  if (track.has_ellipsoid) {
    const Vec3 extent = track.shape_map.diagonal().cwiseMax(0.0).cwiseSqrt();
    low = track.center_map - extent;
    high = track.center_map + extent;
  } else if (!track.points_map.empty()) {
    low = high = track.points_map.front();
    for (const Vec3& point : track.points_map) {
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  } else {
    return {};
  }
  if (!low.allFinite() || !high.allFinite()) return {};
  CellRange cells{cell_of(low), cell_of(high)};
  for (std::size_t i = 0; i < 3; ++i) cells.high[i] = std::min(cells.high[i], cells.low[i] + kCellsMax - 1);
  return cells;
}

}  // namespace semantic_topo_loop::core
