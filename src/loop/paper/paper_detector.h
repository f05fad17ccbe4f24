#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "loop/submap/graph_matcher.h"
#include "loop/submap/observation_window.h"
#include "loop/submap/submap_refiner.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/eigen.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// Of an edge's sigmas, beside graph mode's limits: three common nodes for the six that it asks for.
constexpr double kPaperVagueness = 3.0;

/// A landmark that two keyframes share: its centre in each camera frame, estimated by each keyframe for itself.
struct CommonNode {
  Vec3 center_query = Vec3::Zero();
  Vec3 center_match = Vec3::Zero();
  double quality = 1.0;  ///< rho in [0, 1]
};

/// How one semantic vector (from node i to node j) of the query lies in the match:
/// c_match = scale * R * c_query + t for both ends, with R the least rotation between the two vectors.
struct VectorTransform {
  Mat3 R = Mat3::Identity();
  double scale = 1.0;
  double angle_rad = 0.0;  ///< of R, [0, pi]
  Vec3 t = Vec3::Zero();   ///< m
};

/// The least rotation that turns the direction of `from` into that of `to`, by Rodrigues' formula with the unit axis;
/// exact at angle 0, and at pi about an arbitrary but fixed perpendicular axis.
Mat3 rotation_between(const Vec3& from, const Vec3& to);

/// R, s, t of the semantic vector from `start` to `end` (SemanticTopoLoop, QLT-SLC).
VectorTransform vector_transform(const CommonNode& start, const CommonNode& end);

/// The score by the letter of the paper (SemanticTopoLoop, equations 14, 16 and 17). For a vector from node p to q:
/// t = C_p^match - C_p^query in components (14), topology = exp(-|1 - s ||R|| - ||t||| / 2) with the spectral norm of
/// R; semantic += rho_p topology (16), and after each starting node p score += semantic (17). `semantic` begins at 0
/// once, so that what the first nodes gave is added again with every later one: n nodes that agree give (n-1) n (n+1)
/// / 2. Kept for the record: it depends on the order of the nodes; ||R|| is 1, so that no rotation is measured by
/// itself; and s = 0.5 with ||t|| = 0.5 m scores like identity.
double printed_score(const std::vector<CommonNode>& nodes);

/// Mean over the pairs of nodes of rho exp(-(|1 - s| + theta + ||t||) / 2), in [0, 1]; 1 for identity and rho = 1.
/// Where it departs from the letter: t is what R and s leave over (t = C^match - s R C^query), each difference counts
/// by itself, theta for ||R||, and a mean has neither order nor number of nodes.
double corrected_score(const std::vector<CommonNode>& nodes);

/// ObjectIndex and KeyFrameQueue of QLT-SLC: which keyframes saw a landmark. A query visits the lists of its own
/// landmarks; pairs of keyframes are never compared.
class ObjectIndex {
 public:
  /// @param keyframe ascending from call to call
  void insert(int keyframe, const std::vector<std::int64_t>& landmark_ids);
  /// How many of the landmarks each keyframe has that has any.
  /// @param redirects say which ids stand for one landmark
  std::map<int, int> query(const std::vector<std::int64_t>& landmark_ids, const LandmarkRedirects& redirects) const;

 private:
  std::map<std::int64_t, std::vector<int>> keyframes_of_;
};

/// QLT-SLC as in the paper: candidates by shared landmark ids, a score over semantic vectors, consistency over
/// consecutive keyframes. Every keyframe estimates its node centres itself, from the boxes of a window around it, so
/// that a drifted revisit gives a correction; read from the shared landmark, both sides would be the same point.
class PaperDetector {
 public:
  /// @param redirects of merged landmarks, kept up to date elsewhere; must outlive this
  PaperDetector(const LoopOptions& options, const LandmarkRedirects& redirects);
  void set_options(const LoopOptions& options);

  /// Takes over landmark qualities.
  void apply(const MapUpdate& update);
  /// Looks for the keyframe most like the one the map is anchored at, then keeps the map.
  /// @return the best candidate, accepted or not; none if no keyframe shares enough landmarks
  std::vector<LoopClosure> detect(LocalMap map, bool search);

 private:
  struct Keyframe {
    LocalMap map;
    std::map<std::int64_t, int> object_of_landmark;
  };
  struct Scored {
    int keyframe = -1;
    int common = 0;
    double score = 0.0, second_score = 0.0;
  };

  Keyframe make_keyframe(LocalMap map) const;
  std::vector<NodePair> common_objects(const Keyframe& match, const Keyframe& query) const;
  double score(const Keyframe& match, const Keyframe& query) const;
  std::optional<Scored> best_candidate(const Keyframe& query) const;
  LoopClosure judge(const Keyframe& query, const Scored& best);
  void align(const Keyframe& match, const Keyframe& query, LoopClosure* loop) const;
  bool is_consistent(const Keyframe& query, std::int64_t match_stamp_ns);

  LoopOptions options_;
  const LandmarkRedirects& redirects_;
  ObjectIndex index_;
  std::map<std::int64_t, double> quality_;
  std::vector<Keyframe> keyframes_;
  int streak_ = 0;  ///< consecutive keyframes whose best candidates lie together
  std::int64_t streak_match_ns_ = 0;
  std::int64_t streak_keyframe_id_ = -1;
};

}  // namespace semantic_topo_loop::core
