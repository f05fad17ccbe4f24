#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

constexpr double kPixelGate2 = 5.991;  ///< chi square of a pixel's two values, 95 %
constexpr double kMinDepth_m = 0.05;   ///< nearer points, and those behind, have no place in an image

/// A map point found in an image.
struct PoseObservation {
  Vec3 point_map = Vec3::Zero();
  Vec2 pixel = Vec2::Zero();  ///< undistorted
  double pixel_sigma = 1.0;
  double depth_m = 0.0;  ///< measured; 0: none
  double depth_sigma_m = 0.0;
  bool is_trusted = true;  ///< otherwise the pose does not hang on it
};

struct PoseEstimate {
  SE3 T_camera_map;
  Mat6 covariance = Mat6::Zero();  ///< of (translation m, rotation rad) in the camera frame
  std::vector<bool> is_inlier;     ///< of each observation
  int inliers = 0;
};

/// Fits a camera pose to the observations that are trusted: Gauss-Newton on reprojection and depth errors, with
/// Cauchy's loss at first, then without those that do not fit. A wrong depth alone does not cost an observation its
/// pixel. Of the others it is only told whether they fit.
/// @return nullopt if the observations do not determine a pose
std::optional<PoseEstimate> refine_pose(const Camera& camera, const SE3& T_camera_map,
                                        const std::vector<PoseObservation>& observations);

/// Finds a camera pose without a guess, from many wrong observations: poses of three points with depth, the one that
/// explains most observations wins. Draws from its own generator, so that the same input gives the same pose.
/// @return nullopt if no pose explains `min_inliers` observations
std::optional<PoseEstimate> find_pose(const Camera& camera, const std::vector<PoseObservation>& observations,
                                      int min_inliers);

}  // namespace semantic_topo_loop::core
