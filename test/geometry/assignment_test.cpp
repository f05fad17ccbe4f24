#include "geometry/assignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <random>
#include <set>

namespace semantic_topo_loop::core {
namespace {

double total(const Eigen::MatrixXd& score, const std::vector<int>& columns) {
  double sum = 0.0;
  for (int i = 0; i < score.rows(); ++i) {
    const int j = columns[static_cast<std::size_t>(i)];
    if (j >= 0) sum += score(i, j);
  }
  return sum;
}

/// Best total over every injective partial assignment.
double brute_force(const Eigen::MatrixXd& score, int row = 0, unsigned used = 0) {
  if (row == score.rows()) return 0.0;
  double best = brute_force(score, row + 1, used);
  for (int j = 0; j < score.cols(); ++j) {
    if ((used & (1u << j)) == 0 && score(row, j) > 0.0) {
      best = std::max(best, score(row, j) + brute_force(score, row + 1, used | (1u << j)));
    }
  }
  return best;
}

void expect_one_to_one(const Eigen::MatrixXd& score, const std::vector<int>& columns) {
  ASSERT_EQ(columns.size(), static_cast<std::size_t>(score.rows()));
  std::set<int> used;
  for (int i = 0; i < score.rows(); ++i) {
    const int j = columns[static_cast<std::size_t>(i)];
    if (j < 0) continue;
    ASSERT_LT(j, score.cols());
    EXPECT_GT(score(i, j), 0.0);
    EXPECT_TRUE(used.insert(j).second) << "column " << j << " taken twice";
  }
}

TEST(Assignment, PrefersTheTotalToTheGreedyChoice) {
  Eigen::MatrixXd score(2, 2);
  score << 0.9, 0.8, 0.8, 0.1;
  EXPECT_EQ(assign_max(score), (std::vector<int>{1, 0}));
}

TEST(Assignment, LeavesForbiddenPairsFree) {
  Eigen::MatrixXd score(3, 2);
  score << 0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), 0.5, 0.4, std::numeric_limits<double>::infinity();
  EXPECT_EQ(assign_max(score), (std::vector<int>{-1, 1, 0}));
}

TEST(Assignment, EmptyInput) {
  EXPECT_TRUE(assign_max(Eigen::MatrixXd(0, 3)).empty());
  EXPECT_EQ(assign_max(Eigen::MatrixXd(2, 0)), (std::vector<int>{-1, -1}));
}

TEST(Assignment, MatchesBruteForceOnRandomMatrices) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> value(-0.5, 1.0);
  for (int trial = 0; trial < 600; ++trial) {
    Eigen::MatrixXd score(1 + static_cast<int>(random() % 6), 1 + static_cast<int>(random() % 6));
    for (int i = 0; i < score.size(); ++i) score.data()[i] = value(random);
    const std::vector<int> columns = assign_max(score);
    expect_one_to_one(score, columns);
    EXPECT_NEAR(total(score, columns), brute_force(score), 1e-12) << score;
  }
}

TEST(Assignment, MatchesBruteForceWithManyTies) {
  std::mt19937_64 random(8);
  for (int trial = 0; trial < 300; ++trial) {
    Eigen::MatrixXd score(1 + static_cast<int>(random() % 6), 1 + static_cast<int>(random() % 6));
    for (int i = 0; i < score.size(); ++i) score.data()[i] = static_cast<double>(random() % 3);
    const std::vector<int> columns = assign_max(score);
    expect_one_to_one(score, columns);
    EXPECT_EQ(total(score, columns), brute_force(score)) << score;
    EXPECT_EQ(columns, assign_max(score));
  }
}

TEST(Assignment, TransposedScoresGiveTheInverseAssignment) {
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> value(0.0, 1.0);
  Eigen::MatrixXd score(40, 70);
  for (int i = 0; i < score.size(); ++i) score.data()[i] = value(random);
  const std::vector<int> columns = assign_max(score);
  const std::vector<int> rows = assign_max(score.transpose());
  for (std::size_t i = 0; i < columns.size(); ++i) {
    ASSERT_GE(columns[i], 0);
    EXPECT_EQ(rows[static_cast<std::size_t>(columns[i])], static_cast<int>(i));
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
