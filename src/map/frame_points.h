#pragma once

#include <cstdint>
#include <vector>

#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// A point that a frame saw, and where: undistorted pixel.
struct SeenPoint {
  Vec2 pixel;
  Vec3 point_camera;  ///< m
};

/// The points of one frame, sorted into cells of the image, so that a box finds its own without a look at all others.
class FramePoints {
 public:
  /// Points that are not finite or not in front of the camera are left out.
  FramePoints(const std::vector<Vec3>& points_camera, const Camera& camera);

  const Camera& camera() const { return camera_; }
  std::size_t size() const { return points_.size(); }
  /// Those that project into the box, at most about `count_max` of them, evenly taken.
  std::vector<SeenPoint> in(const Box& box, std::size_t count_max) const;

 private:
  struct Cells {
    int first_column, last_column, first_row, last_row;
  };

  int column(double u) const;
  int row(double v) const;
  Cells cells(const Box& box) const { return {column(box.x1), column(box.x2), row(box.y1), row(box.y2)}; }

  Camera camera_;
  int columns_, rows_;
  std::vector<std::uint32_t> cell_begin_;  ///< by cell, row by row; one more at the end
  std::vector<SeenPoint> points_;          ///< by cell, within one in the order given
};

}  // namespace semantic_topo_loop::core
