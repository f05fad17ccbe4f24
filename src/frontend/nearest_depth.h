#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// Undistorted pixel of a point in the camera frame; nullopt if it is out of view.
std::optional<Vec2> pixel_in_view(const Camera& camera, const Vec3& point_camera);

/// The nearest that an image sees, by cells of some pixels.
class NearestDepth {
 public:
  NearestDepth() = default;
  NearestDepth(const Camera& camera, const std::vector<Vec3>& points_camera);
  /// Whether the image saw through where a point is: clearly before all that it shows there and around.
  bool sees_through(const Camera& camera, const Vec3& point_camera) const;

 private:
  cv::Point cell(const Camera& camera, const Vec2& pixel) const;

  int cell_px_ = 1;
  cv::Mat1f nearest_m_;  ///< in each cell and around it; 0: no depth in the cell
};

}  // namespace semantic_topo_loop::core
