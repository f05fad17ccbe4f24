#include "geometry/assignment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace semantic_topo_loop::core {
namespace {

/// Minimum-cost assignment of every row, rows <= columns, by one shortest augmenting path a row.
class MinCostAssignment {
 public:
  explicit MinCostAssignment(const Eigen::MatrixXd& cost)
      : cost_(cost),
        row_of_column_(static_cast<std::size_t>(cost.cols()), kFree),
        row_potential_(Eigen::VectorXd::Zero(cost.rows())),
        column_potential_(Eigen::VectorXd::Zero(cost.cols())) {
    for (int row = 0; row < cost_.rows(); ++row) augment(row);
  }

  const std::vector<int>& row_of_column() const { return row_of_column_; }

 private:
  static constexpr int kFree = -1;  ///< in place of a row or column

  void augment(int start_row) {
    const auto n = static_cast<std::size_t>(cost_.cols());
    std::vector<double> distance(n, std::numeric_limits<double>::infinity());
    std::vector<int> previous(n, kFree);
    std::vector<bool> scanned(n, false);
    int row = start_row;
    int column = kFree;
    double shortest = 0.0;
    do {
      relax(row, column, shortest, scanned, &distance, &previous);
      column = nearest(distance, scanned);
      shortest = distance[static_cast<std::size_t>(column)];
      scanned[static_cast<std::size_t>(column)] = true;
      row = row_of_column_[static_cast<std::size_t>(column)];
    } while (row != kFree);
    update_potentials(start_row, shortest, distance, scanned, column);
    flip(start_row, column, previous);
  }

  /// Shortens the way to every open column over `row`, which was reached through `from`.
  void relax(int row, int from, double shortest, const std::vector<bool>& scanned, std::vector<double>* distance,
             std::vector<int>* previous) const {
    for (int j = 0; j < cost_.cols(); ++j) {
      const auto at = static_cast<std::size_t>(j);
      if (scanned[at]) continue;
      const double candidate = shortest + cost_(row, j) - row_potential_(row) - column_potential_(j);
      if (candidate < (*distance)[at]) {
        (*distance)[at] = candidate;
        (*previous)[at] = from;
      }
    }
  }

  static int nearest(const std::vector<double>& distance, const std::vector<bool>& scanned) {
    int best = kFree;
    for (std::size_t j = 0; j < distance.size(); ++j) {
      if (scanned[j]) continue;
      if (best == kFree || distance[j] < distance[static_cast<std::size_t>(best)]) best = static_cast<int>(j);
    }
    return best;
  }

  void update_potentials(int start_row, double shortest, const std::vector<double>& distance,
                         const std::vector<bool>& scanned, int last_column) {
    row_potential_(start_row) += shortest;
    for (std::size_t j = 0; j < scanned.size(); ++j) {
      if (!scanned[j] || static_cast<int>(j) == last_column) continue;
      const double slack = shortest - distance[j];
      column_potential_(static_cast<int>(j)) -= slack;
      row_potential_(row_of_column_[j]) += slack;
    }
  }

  /// Shifts the rows along the path that ends in a free column.
  void flip(int start_row, int column, const std::vector<int>& previous) {
    while (column != kFree) {
      const int from = previous[static_cast<std::size_t>(column)];
      row_of_column_[static_cast<std::size_t>(column)] =
          from == kFree ? start_row : row_of_column_[static_cast<std::size_t>(from)];
      column = from;
    }
  }

  const Eigen::MatrixXd& cost_;
  std::vector<int> row_of_column_;
  Eigen::VectorXd row_potential_, column_potential_;
};

using Scores = Eigen::Ref<const Eigen::MatrixXd>;

bool is_allowed(double score) { return std::isfinite(score) && score > 0.0; }

/// Rows and columns that allowed pairs join, in order of index.
struct Component {
  std::vector<int> rows, columns;
};

/// Pairs of a row and a column that have no other choice, which is most of what there is.
std::vector<int> lone_pairs(const Scores& score) {
  constexpr int kNone = -1, kSeveral = -2;  // in place of a column
  std::vector<int> column_of_row(static_cast<std::size_t>(score.rows()), kNone);
  std::vector<bool> is_shared(static_cast<std::size_t>(score.cols()), false);
  for (int j = 0; j < score.cols(); ++j) {
    int rows = 0;
    for (int i = 0; i < score.rows(); ++i) {
      if (!is_allowed(score(i, j))) continue;
      int& column = column_of_row[static_cast<std::size_t>(i)];
      column = column == kNone ? j : kSeveral;
      ++rows;
    }
    is_shared[static_cast<std::size_t>(j)] = rows > 1;
  }
  for (int& column : column_of_row) {
    if (column == kSeveral || (column >= 0 && is_shared[static_cast<std::size_t>(column)])) column = kNone;
  }
  return column_of_row;
}

/// Scores are mostly forbidden pairs: what no chain of allowed pairs joins can be assigned on its own.
/// @param assigned column of each row that is settled, else -1
std::vector<Component> components(const Scores& score, const std::vector<int>& assigned) {
  const auto rows = static_cast<std::size_t>(score.rows()), columns = static_cast<std::size_t>(score.cols());
  // Disjoint sets; a row stands for each set of more than one.
  std::vector<std::size_t> parent(rows + columns);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&parent](std::size_t k) {
    while (parent[k] != k) k = parent[k] = parent[parent[k]];
    return k;
  };
  for (std::size_t j = 0; j < columns; ++j) {
    for (std::size_t i = 0; i < rows; ++i) {
      if (assigned[i] >= 0 || !is_allowed(score(static_cast<int>(i), static_cast<int>(j)))) continue;
      parent[root(rows + j)] = root(i);
    }
  }
  std::vector<Component> result;
  std::vector<std::size_t> index(rows, rows);
  for (std::size_t j = 0; j < columns; ++j) {
    const std::size_t row = root(rows + j);
    if (row >= rows) continue;
    if (index[row] == rows) {
      index[row] = result.size();
      result.emplace_back();
    }
    result[index[row]].columns.push_back(static_cast<int>(j));
  }
  for (std::size_t i = 0; i < rows; ++i) {
    const std::size_t row = root(i);
    if (index[row] != rows) result[index[row]].rows.push_back(static_cast<int>(i));
  }
  return result;
}

void assign(const Scores& score, const Component& component, std::vector<int>* column_of_row) {
  const auto n = static_cast<Eigen::Index>(component.rows.size());
  const auto m = static_cast<Eigen::Index>(component.columns.size());
  const bool transposed = n > m;
  Eigen::MatrixXd cost(std::min(n, m), std::max(n, m));
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < m; ++j) {
      const double s =
          score(component.rows[static_cast<std::size_t>(i)], component.columns[static_cast<std::size_t>(j)]);
      (transposed ? cost(j, i) : cost(i, j)) = is_allowed(s) ? -s : 0.0;
    }
  }
  const MinCostAssignment solution(cost);
  const std::vector<int>& row_of_column = solution.row_of_column();
  for (int j = 0; j < cost.cols(); ++j) {
    const int i = row_of_column[static_cast<std::size_t>(j)];
    if (i < 0 || !(cost(i, j) < 0.0)) continue;
    const int row = component.rows[static_cast<std::size_t>(transposed ? j : i)];
    (*column_of_row)[static_cast<std::size_t>(row)] = component.columns[static_cast<std::size_t>(transposed ? i : j)];
  }
}

}  // namespace

std::vector<int> assign_max(const Eigen::Ref<const Eigen::MatrixXd>& score) {
  std::vector<int> column_of_row = lone_pairs(score);
  for (const Component& component : components(score, column_of_row)) assign(score, component, &column_of_row);
  return column_of_row;
}

}  // namespace semantic_topo_loop::core
