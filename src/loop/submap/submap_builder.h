#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"
#include "loop/submap/up_estimator.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {

/// True if the point projects well inside the image, at a depth at which objects are mapped.
bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m);

class LocalMapBuilder {
 public:
  explicit LocalMapBuilder(const LoopOptions& options) : options_(options) {}
  /// @param T_odom of the frames, any world   @return nullopt if the window holds no keyframe
  std::optional<LocalMap> build(const std::deque<ObservedFrame>& window, const LandmarkRedirects& redirects,
                                const UpEstimator& up) const;

 private:
  std::vector<LocalObject> find_objects(const LocalMap& map, const LandmarkRedirects& redirects) const;
  std::optional<LocalObject> fit(const LocalMap& map, std::vector<SubmapView> views, const Vec3& center) const;

  LoopOptions options_;
};

}  // namespace semantic_topo_loop::core
