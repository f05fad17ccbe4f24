#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// An ellipsoid: pose of its axes in the world and its semi-axes.
struct Ellipsoid {
  SE3 T_world_quadric;
  Vec3 semi_axes = Vec3::Ones();  ///< m, > 0

  const Vec3& center() const { return T_world_quadric.t; }
  /// Radius of the sphere of the same volume, m.
  double radius() const { return std::cbrt(semi_axes.prod()); }
  /// R diag(a^2) R^T, m^2.
  Mat3 shape() const;
  /// Q* = Z diag(a^2, b^2, c^2, -1) Z^T with Z = T_world_quadric (SemanticTopoLoop, quadric representation).
  Mat4 dual() const;
};

enum class LandmarkState : std::uint8_t { kCandidate = 0, kConfirmed = 1, kRetired = 2 };

const char* to_string(LandmarkState state);

/// How often something was boxed as a class.
struct ClassCount {
  int class_id = -1;
  int count = 0;
};

/// An object as the map publishes it.
struct Landmark {
  std::int64_t id = -1;
  int class_id = -1;
  LandmarkState state = LandmarkState::kCandidate;
  std::optional<Ellipsoid> ellipsoid;     ///< in the map frame; none while too few views
  Mat3 center_covariance = Mat3::Zero();  ///< m^2
  std::int64_t anchor_keyframe_id = -1;   ///< the keyframe it moves with
  int observations = 0;
  double baseline_deg = 0.0;             ///< largest angle between two rays to the centre
  double mean_iou = 0.0;                 ///< of projected and detected boxes
  double quality = 0.0;                  ///< rho in [0, 1]
  std::vector<ClassCount> class_counts;  ///< of its boxes, in order of class

  void count_class(int of_class, int count = 1);
};

struct LandmarkMerge {
  std::int64_t merged_id = -1;
  std::int64_t survivor_id = -1;
};

/// So many merges can be taken back, the last ones: some minutes of a large map at least.
inline constexpr std::size_t kMostOpenMerges = 1000;

/// Why a map version came about.
enum class MapUpdatePhase : std::uint8_t {
  kObservation = 0,  ///< a frame's associations were integrated
  kCorrection = 1,   ///< the frame's pose-graph result was applied; the frame is complete
};

/// A delta between two versions of the quadric map.
struct MapUpdate {
  std::int64_t frame_id = -1;
  MapUpdatePhase phase = MapUpdatePhase::kObservation;
  std::uint64_t base_version = 0;
  std::uint64_t map_version = 0;
  SE3 T_map_odom;
  std::vector<Landmark> changed;        ///< in order of id; retirement is a state
  std::vector<std::int64_t> removed;    ///< candidates given up
  std::vector<LandmarkMerge> unmerged;  ///< merges taken back, before `merged` is read; the last made comes first
  std::vector<LandmarkMerge> merged;    ///< redirects, in the order they were made
  double duration_us = 0.0;
};

/// Which landmark the ids of merged landmarks stand for.
class LandmarkRedirects {
 public:
  /// Takes over the merges of an update and those that it takes back.
  void apply(const MapUpdate& update);
  void merge(const LandmarkMerge& merge);
  void unmerge(std::int64_t merged_id);
  std::int64_t resolve(std::int64_t id) const;
  /// All ids that stand for the landmark of this id, ascending.
  std::vector<std::int64_t> aliases(std::int64_t id) const;

 private:
  std::map<std::int64_t, std::int64_t> survivor_;
  std::map<std::int64_t, std::vector<std::int64_t>> merged_into_;
};

}  // namespace semantic_topo_loop::core
