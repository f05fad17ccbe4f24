#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "semantic_topo_loop/types/box.h"

namespace semantic_topo_loop::core {

/// The points of an image by square cells (counting sort), so that a rectangle finds its own without a look at all
/// others. Points outside of the grid are in the cells at its border.
class PointGrid {
 public:
  PointGrid() = default;
  PointGrid(int columns, int rows, int cell_px) : columns_(columns), rows_(rows), cell_px_(cell_px) {}

  /// Takes in `count` points in place of those before.
  /// @param pixel_of gives the pixel of a point by its index
  template <class PixelOf>
  void sort(std::size_t count, PixelOf pixel_of) {
    std::vector<std::uint32_t> cell(count);
    begin_.assign(static_cast<std::size_t>(columns_ * rows_) + 1, 0);
    for (std::size_t i = 0; i < count; ++i) {
      const Vec2& pixel = pixel_of(i);
      cell[i] = static_cast<std::uint32_t>(cell_of(pixel.y(), rows_) * columns_ + cell_of(pixel.x(), columns_));
      ++begin_[cell[i] + 1];
    }
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    order_.resize(count);
    std::vector<std::uint32_t> next = begin_;
    for (std::size_t i = 0; i < count; ++i) order_[next[cell[i]]++] = static_cast<std::uint32_t>(i);
  }

  /// Indices of the points by cell, row by row; within a cell ascending.
  const std::vector<std::uint32_t>& order() const { return order_; }

  /// Calls visit(begin, end) with the range in `order` of each row of cells that the rectangle touches, top to bottom.
  template <class Visit>
  void for_each_row(const Box& box, Visit visit) const {
    const int left = cell_of(box.x1, columns_), right = cell_of(box.x2, columns_);
    for (int row = cell_of(box.y1, rows_); row <= cell_of(box.y2, rows_); ++row) {
      const auto first = static_cast<std::size_t>(row * columns_);
      visit(begin_[first + static_cast<std::size_t>(left)], begin_[first + static_cast<std::size_t>(right) + 1]);
    }
  }

 private:
  int cell_of(double coordinate, int cells) const {
    constexpr double kFar_px = 1e6;  // beyond any image, and its cells still fit an int
    return std::clamp(static_cast<int>(std::clamp(coordinate, -kFar_px, kFar_px) / cell_px_), 0, cells - 1);
  }

  int columns_ = 1, rows_ = 1;
  double cell_px_ = 1.0;
  std::vector<std::uint32_t> begin_ = {0, 0};  ///< of each cell in order_, row by row; one more at the end
  std::vector<std::uint32_t> order_;
};

}  // namespace semantic_topo_loop::core
