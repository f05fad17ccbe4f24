#include "frontend/image_features.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {

int ImageFeatures::cell_of(double coordinate, int cells) const {
  return std::clamp(static_cast<int>(std::floor(coordinate / kCell_px)), 0, cells - 1);
}

void ImageFeatures::index(const Camera& camera) {
  columns_ = camera.width / kCell_px + 1;
  rows_ = camera.height / kCell_px + 1;
  std::vector<int> cell(size());
  begin_.assign(static_cast<std::size_t>(columns_ * rows_) + 1, 0);
  for (std::size_t i = 0; i < size(); ++i) {
    cell[i] = cell_of(features[i].pixel.y(), rows_) * columns_ + cell_of(features[i].pixel.x(), columns_);
    ++begin_[static_cast<std::size_t>(cell[i]) + 1];
  }
  for (std::size_t i = 1; i < begin_.size(); ++i) begin_[i] += begin_[i - 1];
  sorted_.resize(size());
  std::vector<int> next = begin_;
  for (std::size_t i = 0; i < size(); ++i) {
    sorted_[static_cast<std::size_t>(next[static_cast<std::size_t>(cell[i])]++)] = static_cast<int>(i);
  }
}

void ImageFeatures::near(const Vec2& pixel, double radius_px, std::vector<int>* found) const {
  found->clear();
  if (features.empty()) return;
  const int left = cell_of(pixel.x() - radius_px, columns_), right = cell_of(pixel.x() + radius_px, columns_);
  const int top = cell_of(pixel.y() - radius_px, rows_), bottom = cell_of(pixel.y() + radius_px, rows_);
  for (int row = top; row <= bottom; ++row) {
    const int begin = begin_[static_cast<std::size_t>(row * columns_ + left)];
    const int end = begin_[static_cast<std::size_t>(row * columns_ + right) + 1];
    for (int i = begin; i < end; ++i) {
      const int index = sorted_[static_cast<std::size_t>(i)];
      const Vec2 offset = features[static_cast<std::size_t>(index)].pixel - pixel;
      if (std::abs(offset.x()) <= radius_px && std::abs(offset.y()) <= radius_px) found->push_back(index);
    }
  }
}

}  // namespace semantic_topo_loop::core
