#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "loop/graph/graph_matcher.h"

namespace semantic_topo_loop::core {

struct SubmapIndexOptions {
  double distance_tolerance_m = 0.06;
  double distance_tolerance_share = 0.03;
  double min_distance_m = 0.05;
  int min_edges = 6;        ///< agreeing pairs of objects of a candidate: those of four objects
  int max_candidates = 40;  ///< returned at most, those with most agreeing pairs
};

/// Finds submaps that share pairs of objects with a query: an index over (label pair, distance), so that a query visits
/// the entries of its own pairs instead of every submap.
class SubmapIndex {
 public:
  explicit SubmapIndex(const SubmapIndexOptions& options) : options_(options) {}
  /// Submaps are numbered from 0 in the order of insertion.
  void insert(const std::vector<LabelledPoint>& points);
  int size() const { return size_; }
  /// How many pairs of the query's objects each of the submaps 0 .. end - 1 shares.
  std::vector<int> agreeing_pairs(const std::vector<LabelledPoint>& points, int end) const;
  /// @param end submaps from this number on are left out   @return numbers, ascending
  std::vector<int> query(const std::vector<LabelledPoint>& points, int end) const;

 private:
  using Key = std::uint64_t;
  static Key key(int label_p, int label_q, int bin);
  int bin(double distance_m) const;

  SubmapIndexOptions options_;
  int size_ = 0;
  std::unordered_map<Key, std::vector<int>> submaps_of_;  ///< looked up only, never iterated over; each ascending
};

}  // namespace semantic_topo_loop::core
