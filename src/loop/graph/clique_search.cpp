#include "loop/graph/clique_search.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

using Words = std::vector<std::uint64_t>;

int count(const std::uint64_t* words, int n) {
  int total = 0;
  for (int w = 0; w < n; ++w) total += __builtin_popcountll(words[w]);
  return total;
}

/// Calls f(vertex) for each set bit, ascending.
template <class F>
void for_each_bit(const Words& words, F f) {
  for (std::size_t w = 0; w < words.size(); ++w) {
    for (std::uint64_t rest = words[w]; rest != 0; rest &= rest - 1) {
      f(static_cast<int>(w * 64) + __builtin_ctzll(rest));
    }
  }
}

void clear_bit(Words& words, int i) { words[static_cast<std::size_t>(i >> 6)] &= ~(std::uint64_t{1} << (i & 63)); }
void set_bit(Words& words, int i) { words[static_cast<std::size_t>(i >> 6)] |= std::uint64_t{1} << (i & 63); }
bool any(const Words& words) {
  return std::any_of(words.begin(), words.end(), [](std::uint64_t w) { return w != 0; });
}

class CliqueSearch {
 public:
  CliqueSearch(const BitGraph& graph, int max_steps) : graph_(graph), steps_left_(max_steps) {}

  std::vector<int> run() {
    Words all(static_cast<std::size_t>(graph_.words()), 0);
    for (int i = 0; i < graph_.size(); ++i) set_bit(all, i);
    expand(all);
    std::sort(best_.begin(), best_.end());
    return best_;
  }

 private:
  struct Coloured {
    int vertex;
    int colour;
  };

  /// Greedy colouring: a clique within the vertices up to one of colour c has at most c members.
  std::vector<Coloured> colour(const Words& candidates) const {
    std::vector<Coloured> order;
    Words uncoloured = candidates;
    for (int colour = 1; any(uncoloured); ++colour) {
      Words open = uncoloured;
      while (any(open)) {
        int vertex = -1;
        for (std::size_t w = 0; vertex < 0; ++w) {
          if (open[w] != 0) vertex = static_cast<int>(w * 64) + __builtin_ctzll(open[w]);
        }
        clear_bit(open, vertex);
        clear_bit(uncoloured, vertex);
        const std::uint64_t* row = graph_.row(vertex);
        for (std::size_t w = 0; w < open.size(); ++w) open[w] &= ~row[w];
        order.push_back({vertex, colour});
      }
    }
    return order;
  }

  void expand(Words candidates) {
    const std::vector<Coloured> order = colour(candidates);
    for (auto it = order.rbegin(); it != order.rend(); ++it) {
      if (current_.size() + static_cast<std::size_t>(it->colour) <= best_.size() || steps_left_-- <= 0) return;
      current_.push_back(it->vertex);
      Words next = candidates;
      const std::uint64_t* row = graph_.row(it->vertex);
      for (std::size_t w = 0; w < next.size(); ++w) next[w] &= row[w];
      if (any(next)) {
        expand(std::move(next));
      } else if (current_.size() > best_.size()) {
        best_ = current_;
      }
      current_.pop_back();
      clear_bit(candidates, it->vertex);
    }
  }

  const BitGraph& graph_;
  int steps_left_;
  std::vector<int> current_, best_;
};

}  // namespace

BitGraph::BitGraph(int vertices)
    : size_(vertices),
      words_((vertices + 63) / 64),
      bits_(static_cast<std::size_t>(size_) * static_cast<std::size_t>(words_), 0) {}

void BitGraph::connect(int i, int j) {
  const auto set = [this](int r, int c) {
    bits_[static_cast<std::size_t>(r) * static_cast<std::size_t>(words_) + static_cast<std::size_t>(c >> 6)] |=
        std::uint64_t{1} << (c & 63);
  };
  set(i, j);
  set(j, i);
}

int BitGraph::degree(int i) const { return count(row(i), words_); }

std::vector<int> largest_clique(const BitGraph& graph, int max_steps) { return CliqueSearch(graph, max_steps).run(); }

std::vector<int> greedy_clique(const BitGraph& graph, int vertex) {
  std::vector<int> clique{vertex};
  Words candidates(graph.row(vertex), graph.row(vertex) + graph.words());
  while (any(candidates)) {
    int best = -1, best_common = -1;
    for_each_bit(candidates, [&](int v) {
      const std::uint64_t* row = graph.row(v);
      int common = 0;
      for (std::size_t w = 0; w < candidates.size(); ++w) common += __builtin_popcountll(row[w] & candidates[w]);
      if (common > best_common) {
        best = v;
        best_common = common;
      }
    });
    clique.push_back(best);
    const std::uint64_t* row = graph.row(best);
    for (std::size_t w = 0; w < candidates.size(); ++w) candidates[w] &= row[w];
  }
  std::sort(clique.begin(), clique.end());
  return clique;
}

}  // namespace semantic_topo_loop::core
