#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A set of vertices. Half of the matching is spent on it: few places have more correspondences than are kept in it
/// without an allocation, and they are counted in pairs; boost::dynamic_bitset takes three times as long.
class Bits {
 public:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  /// @param size vertices there are   @param has_all whether they are in the set
  explicit Bits(std::size_t size, bool has_all = false) : size_((size + 63) / 64), many_(size_ > kFew ? size_ : 0) {
    for (std::size_t i = 0; has_all && i < size; ++i) set(i);
  }
  void set(std::size_t i) { words()[i / 64] |= std::uint64_t{1} << (i % 64); }
  void reset(std::size_t i) { words()[i / 64] &= ~(std::uint64_t{1} << (i % 64)); }
  bool any() const {
    return std::any_of(words(), words() + size_, [](std::uint64_t word) { return word != 0; });
  }
  /// The lowest vertex in the set that is not below `begin`, or kNone.
  std::size_t next(std::size_t begin) const {
    std::uint64_t above = ~std::uint64_t{0} << (begin % 64);
    for (std::size_t w = begin / 64; w < size_; ++w) {
      const std::uint64_t rest = words()[w] & above;
      if (rest != 0) return 64 * w + static_cast<std::size_t>(__builtin_ctzll(rest));
      above = ~std::uint64_t{0};
    }
    return kNone;
  }
  /// Vertices that are in both sets.
  std::size_t count_common(const Bits& other) const {
    int count = 0;
    for (std::size_t w = 0; w < size_; ++w) count += __builtin_popcountll(words()[w] & other.words()[w]);
    return static_cast<std::size_t>(count);
  }
  Bits& operator&=(const Bits& other) {
    for (std::size_t w = 0; w < size_; ++w) words()[w] &= other.words()[w];
    return *this;
  }
  Bits& operator-=(const Bits& other) {
    for (std::size_t w = 0; w < size_; ++w) words()[w] &= ~other.words()[w];
    return *this;
  }

 private:
  static constexpr std::size_t kFew = 4;

  std::uint64_t* words() { return size_ > kFew ? many_.data() : few_.data(); }
  const std::uint64_t* words() const { return size_ > kFew ? many_.data() : few_.data(); }

  std::size_t size_;  ///< words of 64 vertices
  std::array<std::uint64_t, kFew> few_{};
  std::vector<std::uint64_t> many_;  ///< instead, if there are more
};

/// An undirected graph: for each vertex those that it is joined to.
using BitGraph = std::vector<Bits>;
using Clique = std::vector<std::size_t>;  ///< vertices, ascending

/// A largest clique, by branch and bound with greedy coloring (the bound of Tomita and Seki 2003, on bit sets).
/// @param max_steps branches visited at most; then the best so far is returned
Clique largest_clique(const BitGraph& graph, int max_steps);
/// A maximal clique that contains `vertex`, grown by most common neighbours first, lowest index on ties.
Clique greedy_clique(const BitGraph& graph, std::size_t vertex);

/// A node of an object graph.
struct LabelledPoint {
  Vec3 position = Vec3::Zero();  ///< m
  int label = -1;
  double size = 0.0;  ///< radius, m
  int class_id = -1;  ///< counts towards GraphMatch::classes; points of different classes may share a label
};

struct NodePair {
  int a = -1, b = -1;

  bool operator==(const NodePair& other) const { return a == other.a && b == other.b; }
};

/// One way to lay graph b over graph a: p_a = T_a_b * (scale * p_b).
struct GraphMatch {
  SE3 T_a_b;
  double scale = 1.0;           ///< of a's unit of length over b's; 1 unless the scale is free
  std::vector<NodePair> pairs;  ///< inliers, one-to-one, ascending in a
  int classes = 0;              ///< different classes among them, on the side that has fewer
  double score = 0.0;           ///< sum of exp(-(residual / sigma)^2 / 2)
  double rms_m = 0.0;
  Vec3 spread_m = Vec3::Zero();  ///< singular values of the inliers' spread, descending
};

constexpr double kMaxScale = 1.6;  ///< between two submaps, with a free scale

/// Matches two labelled point sets: correspondences of equal label and similar size, an edge between two of them whose
/// distances agree, cliques of that graph (largest one exactly, others greedily), rigid alignment, regrown inliers.
/// A pure function of its input; the same input gives the same matches.
///
/// With a free scale (graph mode), pairs of points of equal labels first vote for the log ratio of their distances;
/// each of the best scales is matched like that, with set b rescaled (all tolerances are in a's unit), and made exact
/// by its inliers.
/// @return distinct matches, best score first; empty if there is none of at least `min_pairs`.
///         Non-finite points are left out.
std::vector<GraphMatch> match_graphs(const std::vector<LabelledPoint>& a, const std::vector<LabelledPoint>& b,
                                     const LoopOptions& options, int min_pairs = 4);

}  // namespace semantic_topo_loop::core
