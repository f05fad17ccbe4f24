#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"
#include "loop/submap/spheroid.h"
#include "loop/submap/up_estimator.h"

namespace semantic_topo_loop::core {

struct LoopOptions;

/// True if the point projects well inside the image, at a depth at which objects are mapped.
bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m);

class LocalMapBuilder {
 public:
  explicit LocalMapBuilder(const LoopOptions& options);
  /// @param T_odom of the frames, any world   @return nullopt if the window holds no keyframe
  std::optional<LocalMap> build(const std::deque<ObservedFrame>& window, const LandmarkRedirects& redirects,
                                const UpEstimator& up) const;

 private:
  std::vector<LocalObject> find_objects(const LocalMap& map, const LandmarkRedirects& redirects) const;
  std::optional<LocalObject> fit(const LocalMap& map, std::vector<SubmapView> views, const Vec3& center) const;

  int min_views_, fit_views_;
  double min_parallax_rad_, min_seen_share_, max_depth_m_, max_radius_m_;
};

}  // namespace semantic_topo_loop::core
