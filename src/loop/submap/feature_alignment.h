#pragma once

#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// The points of the front end's map that the window shows, in the frame of one of its cameras: at most 500 of them,
/// those shown most often.
/// @return null if no frame came with any
std::shared_ptr<const std::vector<PointFeature>> make_features(const std::deque<ObservedFrame>& window,
                                                               std::size_t anchor);

struct FeatureAlignment {
  SE3 T_a_b;
  Mat6 covariance = Mat6::Identity();  ///< of T_a_b: (translation m, rotation rad), right perturbation
  int points = 0;                      ///< that agree
};

/// Finds points of two submaps that look alike, and where b is for most of them to be in one place (RANSAC with a fixed
/// seed, then robust least squares).
/// @param a, b with features   @param T_a_b within decimetres; nullopt: not known, and more points are asked for
/// @return nullopt if too few points agree, or they tell no pose, as those of one line
std::optional<FeatureAlignment> align_features(const LocalMap& a, const LocalMap& b, const std::optional<SE3>& T_a_b);

}  // namespace semantic_topo_loop::core
