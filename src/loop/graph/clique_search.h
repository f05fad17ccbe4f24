#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace semantic_topo_loop::core {

/// An undirected graph as rows of bits.
class BitGraph {
 public:
  explicit BitGraph(int vertices);

  int size() const { return size_; }
  int words() const { return words_; }
  void connect(int i, int j);
  bool connected(int i, int j) const { return ((row(i)[j >> 6] >> (j & 63)) & 1u) != 0; }
  const std::uint64_t* row(int i) const {
    return &bits_[static_cast<std::size_t>(i) * static_cast<std::size_t>(words_)];
  }
  int degree(int i) const;

 private:
  int size_, words_;
  std::vector<std::uint64_t> bits_;
};

/// A largest clique, by branch and bound with greedy colouring (the bound of Tomita and Seki 2003, on bit sets).
/// @param max_steps branches visited at most; then the best so far is returned
std::vector<int> largest_clique(const BitGraph& graph, int max_steps);
/// A maximal clique that contains `vertex`, grown by most common neighbours first, lowest index on ties.
std::vector<int> greedy_clique(const BitGraph& graph, int vertex);

}  // namespace semantic_topo_loop::core
