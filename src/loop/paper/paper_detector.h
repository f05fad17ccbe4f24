#pragma once

#include <map>
#include <optional>
#include <vector>

#include "loop/graph/graph_matcher.h"
#include "loop/graph/local_map.h"
#include "loop/graph/submap_refiner.h"
#include "loop/paper/keyframe_queue.h"
#include "loop/paper/paper_score.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// QLT-SLC as in the paper: candidates by shared landmark ids, a score over semantic vectors, consistency over
/// consecutive keyframes. Every keyframe estimates its node centres itself, from the boxes of a window around it, so
/// that a drifted revisit gives a correction; read from the shared landmark, both sides would be the same point.
class PaperDetector {
 public:
  explicit PaperDetector(const LoopOptions& options);

  /// Takes over landmark qualities and merges.
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
  GraphMatcher matcher_;
  SubmapRefiner refiner_;
  LandmarkRedirects redirects_;
  ObjectIndex index_;
  std::map<std::int64_t, double> quality_;
  std::vector<Keyframe> keyframes_;
  int streak_ = 0;  ///< consecutive keyframes whose best candidates lie together
  std::int64_t streak_match_ns_ = 0;
  std::int64_t streak_keyframe_id_ = -1;
};

}  // namespace semantic_topo_loop::core
