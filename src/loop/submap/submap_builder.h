#pragma once

#include <deque>
#include <optional>

#include "geometry/up_estimator.h"
#include "loop/submap/observation_window.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {

/// True if the point projects well inside the image, at a depth at which objects are mapped.
bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m);

/// The keyframe nearest to the middle of a window's time, its index; nullopt if there is none.
std::optional<std::size_t> middle_keyframe(const std::deque<ObservedFrame>& window);

/// @param window poses in any world   @return nullopt if it holds no keyframe
std::optional<LocalMap> build_local_map(const std::deque<ObservedFrame>& window, const LandmarkRedirects& redirects,
                                        const UpEstimator& up, const LoopOptions& options);

}  // namespace semantic_topo_loop::core
