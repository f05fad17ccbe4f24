#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "frontend/pose_solver.h"
#include "frontend/tracking_map.h"

namespace semantic_topo_loop::core {

/// A copy of a part of the map, so that it can be refined while the next image is looked at.
struct BundleProblem {
  struct Pose {
    std::int64_t keyframe = -1;
    SE3 T_camera_map;
    bool is_fixed = false;
  };
  struct Point {
    std::int64_t id = -1;
    Vec3 position = Vec3::Zero();
  };
  struct View {
    std::size_t pose = 0, point = 0;
    PoseObservation observation;
    bool is_outlier = false;
  };
  std::vector<Pose> poses;
  std::vector<Point> points;
  std::vector<View> views;
  double focal_factor = 1.0;  ///< of the camera's focal lengths
  double cost = 0.0;          ///< once it is solved
  bool is_solved = false;
};

/// The keyframes that see most of what a keyframe sees, free, and all points they see; other keyframes that see those
/// points, fixed.
BundleProblem local_bundle(const TrackingMap& map, std::int64_t keyframe, const FrontendOptions& options);

/// Refines poses and points: reprojection and depth errors, robust. Same problem, same result, bit for bit.
/// @param with_focal fits focal_factor, too; else it is held
void solve(const Camera& camera, int iterations, bool with_focal, BundleProblem* problem);

/// What the views of a window say of the focal lengths: around log_factor, the cost is the least one times
///   1 + information (log(factor) - log_factor)^2
struct FocalEstimate {
  double log_factor = 0.0;  ///< of the camera's focal lengths
  double information = 0.0;

  /// The share of the cost that the change takes off.
  double gain() const { return information * log_factor * log_factor; }
  /// What several windows say: their costs added up.
  FocalEstimate& operator+=(const FocalEstimate& other);
};

/// @return nullopt if the views determine no focal length
std::optional<FocalEstimate> estimate_focal_length(const Camera& camera, const BundleProblem& problem);

/// Takes over what was refined, and takes views back that do not agree with it.
void apply(const BundleProblem& problem, TrackingMap* map);

}  // namespace semantic_topo_loop::core
