#include "map/frame_points.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr int kCellPx = 16;

int cell_of(double pixel, int cells) {
  return std::clamp(static_cast<int>(std::floor(std::clamp(pixel, -1e6, 1e6) / kCellPx)), 0, cells - 1);
}

bool contains(const Box& box, const Vec2& pixel) {
  return pixel.x() >= box.x1 && pixel.x() <= box.x2 && pixel.y() >= box.y1 && pixel.y() <= box.y2;
}

}  // namespace

FramePoints::FramePoints(const std::vector<Vec3>& points_camera, const Camera& camera)
    : camera_(camera),
      columns_(std::max(1, (camera.width + kCellPx - 1) / kCellPx)),
      rows_(std::max(1, (camera.height + kCellPx - 1) / kCellPx)),
      cell_begin_(static_cast<std::size_t>(columns_ * rows_) + 1, 0) {
  std::vector<std::uint32_t> cell_of_point;
  std::vector<SeenPoint> unsorted;
  cell_of_point.reserve(points_camera.size());
  unsorted.reserve(points_camera.size());
  for (const Vec3& p : points_camera) {
    if (!p.allFinite() || !(p.z() > 0.0)) continue;
    const Vec2 pixel(camera.fx * p.x() / p.z() + camera.cx, camera.fy * p.y() / p.z() + camera.cy);
    if (!pixel.allFinite()) continue;
    const auto cell = static_cast<std::uint32_t>(row(pixel.y()) * columns_ + column(pixel.x()));
    cell_of_point.push_back(cell);
    unsorted.push_back({pixel, p});
    ++cell_begin_[cell + 1];
  }
  for (std::size_t i = 1; i < cell_begin_.size(); ++i) cell_begin_[i] += cell_begin_[i - 1];
  std::vector<std::uint32_t> next(cell_begin_.begin(), cell_begin_.end() - 1);
  points_.resize(unsorted.size());
  for (std::size_t i = 0; i < unsorted.size(); ++i) points_[next[cell_of_point[i]]++] = unsorted[i];
}

int FramePoints::column(double u) const { return cell_of(u, columns_); }
int FramePoints::row(double v) const { return cell_of(v, rows_); }

std::vector<SeenPoint> FramePoints::in(const Box& box, std::size_t count_max) const {
  std::vector<SeenPoint> found;
  if (!box.is_valid() || count_max == 0) return found;
  const Cells wanted = cells(box);
  const auto begin = [&](int row, int column) {
    return cell_begin_[static_cast<std::size_t>(row * columns_ + column)];
  };
  std::size_t candidates = 0;
  for (int r = wanted.first_row; r <= wanted.last_row; ++r) {
    candidates += begin(r, wanted.last_column + 1) - begin(r, wanted.first_column);
  }
  // Every n-th; n is odd, so that it does not fall in step with the lines of an even grid.
  std::size_t step = (candidates + count_max - 1) / count_max;
  if (step > 1) step |= 1;
  std::size_t k = 0;
  for (int r = wanted.first_row; r <= wanted.last_row; ++r) {
    for (std::uint32_t i = begin(r, wanted.first_column); i < begin(r, wanted.last_column + 1); ++i, ++k) {
      if (k % step == 0 && contains(box, points_[i].pixel)) found.push_back(points_[i]);
    }
  }
  return found;
}

}  // namespace semantic_topo_loop::core
