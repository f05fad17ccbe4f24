#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "loop/graph/observation_window.h"

namespace semantic_topo_loop::core {

/// A keyframe that shares landmarks with the query.
struct KeyframeCandidate {
  int keyframe = -1;  ///< index given at insertion
  int common = 0;
};

/// ObjectIndex and KeyFrameQueue of QLT-SLC: which keyframes saw a landmark. A query visits the lists of its own
/// landmarks; pairs of keyframes are never compared.
class ObjectIndex {
 public:
  /// @param keyframe ascending from call to call
  void insert(int keyframe, const std::vector<std::int64_t>& landmark_ids);
  /// Keyframes with at least `min_common` of the landmarks, ascending.
  /// @param redirects say which ids stand for one landmark
  std::vector<KeyframeCandidate> query(const std::vector<std::int64_t>& landmark_ids,
                                       const LandmarkRedirects& redirects, int min_common) const;

 private:
  std::map<std::int64_t, std::vector<int>> keyframes_of_;
};

}  // namespace semantic_topo_loop::core
