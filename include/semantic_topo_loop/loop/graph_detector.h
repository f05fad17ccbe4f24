#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/loop/graph_matcher.h"
#include "semantic_topo_loop/loop/local_map.h"
#include "semantic_topo_loop/loop/loop_closure.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/loop/loop_verifier.h"
#include "semantic_topo_loop/loop/submap_index.h"
#include "semantic_topo_loop/loop/submap_refiner.h"

namespace semantic_topo_loop::core {

/// Loops between the submap of the last seconds and all earlier ones, by their object graphs alone.
class GraphDetector {
 public:
  explicit GraphDetector(const LoopOptions& options);

  /// Matches the submap with those stored at least `min_gap_s` before it.
  /// @return the best candidate, then those whose place was closed least recently, then rejected ones
  std::vector<LoopClosure> detect(const LocalMap& query);
  /// Keeps the submap for later queries if the last one kept is old enough.
  void store(LocalMap map);

 private:
  struct StoredMap {
    LocalMap map;
    std::vector<LabelledPoint> points;
    std::int64_t closed_ns = -1;  ///< stamp of the last query that was closed with its place
  };
  struct Candidate {
    std::size_t stored = 0;
    GraphMatch alignment;  ///< a: match, b: query
    double second_score = 0.0;
    Verdict verdict;
  };
  const LocalMap& match_of(const Candidate& candidate) const { return maps_[candidate.stored].map; }
  std::optional<Candidate> examine(const LocalMap& query, const std::vector<LabelledPoint>& points,
                                   std::size_t stored) const;
  void find_ambiguous(const LocalMap& query, std::vector<Candidate>* candidates) const;
  void select(std::vector<Candidate>* candidates) const;
  void mark_closed(const LocalMap& match, std::int64_t query_ns);
  LoopClosure finish(const LocalMap& query, const Candidate& candidate) const;

  LoopOptions options_;
  SubmapIndex index_;
  GraphMatcher matcher_;
  LoopVerifier verifier_;
  SubmapRefiner refiner_;
  std::vector<StoredMap> maps_;
};

}  // namespace semantic_topo_loop::core
