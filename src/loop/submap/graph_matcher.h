#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A set of at most kMax vertices. In place, and counted in pairs, for half of the matching is spent on it:
/// boost::dynamic_bitset takes three times as long.
class Bits {
 public:
  static constexpr std::size_t kMax = 448, kNone = static_cast<std::size_t>(-1);

  /// @param size vertices there are   @param has_all whether they are in the set
  explicit Bits(std::size_t size, bool has_all = false) : size_((size + 63) / 64) {
    for (std::size_t i = 0; has_all && i < size; ++i) set(i);
  }
  void set(std::size_t i) { words_[i / 64] |= std::uint64_t{1} << (i % 64); }
  void reset(std::size_t i) { words_[i / 64] &= ~(std::uint64_t{1} << (i % 64)); }
  bool any() const {
    return std::any_of(words_.begin(), words_.end(), [](std::uint64_t word) { return word != 0; });
  }
  /// The lowest vertex in the set that is not below `begin`, or kNone.
  std::size_t next(std::size_t begin) const {
    std::uint64_t above = ~std::uint64_t{0} << (begin % 64);
    for (std::size_t w = begin / 64; w < size_; ++w) {
      const std::uint64_t rest = words_[w] & above;
      if (rest != 0) return 64 * w + static_cast<std::size_t>(__builtin_ctzll(rest));
      above = ~std::uint64_t{0};
    }
    return kNone;
  }
  /// Vertices that are in both sets.
  std::size_t count_common(const Bits& other) const {
    std::uint64_t count = 0;
    for (std::size_t w = 0; w < size_; ++w) count += ones(words_[w] & other.words_[w]);
    return count;
  }
  Bits& operator&=(const Bits& other) {
    for (std::size_t w = 0; w < size_; ++w) words_[w] &= other.words_[w];
    return *this;
  }
  Bits& operator-=(const Bits& other) {
    for (std::size_t w = 0; w < size_; ++w) words_[w] &= ~other.words_[w];
    return *this;
  }

 private:
  /// Bits that are set, in pairs, fours and bytes; the compiler's own calls a function where every processor is served.
  static std::uint64_t ones(std::uint64_t word) {
    word -= (word >> 1U) & 0x5555555555555555U;
    word = (word & 0x3333333333333333U) + ((word >> 2U) & 0x3333333333333333U);
    word = (word + (word >> 4U)) & 0x0f0f0f0f0f0f0f0fU;
    return (word * 0x0101010101010101U) >> 56U;
  }

  std::size_t size_;  ///< words that have vertices
  std::array<std::uint64_t, kMax / 64> words_{};
};

/// An undirected graph: for each vertex those that it is joined to.
using BitGraph = std::vector<Bits>;
using Clique = std::vector<std::size_t>;  ///< vertices, ascending

/// A largest clique, by branch and bound with greedy coloring (the bound of Tomita and Seki 2003, on bit sets).
/// @param max_steps branches visited at most; then the best so far is returned
Clique largest_clique(const BitGraph& graph, int max_steps);
/// A maximal clique that contains `vertex`, grown by most common neighbours first, lowest index on ties.
/// @param least given up, and what was found returned, once it cannot have so many vertices
Clique greedy_clique(const BitGraph& graph, std::size_t vertex, std::size_t least = 0);

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
