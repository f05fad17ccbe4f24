#include "loop/submap/graph_matcher.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "loop/graph/graph_detector.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::noise;
using testing::uniform;

struct Problem {
  std::vector<LabelledPoint> a, b;
  SE3 T_a_b;
  int common = 0;
};

SE3 random_transform(std::mt19937_64& random) {
  const Vec3 rotation(uniform(random, -2, 2), uniform(random, -2, 2), uniform(random, -2, 2));
  return {so3_exp(rotation), Vec3(uniform(random, -3, 3), uniform(random, -3, 3), uniform(random, -3, 3))};
}

LabelledPoint random_point(std::mt19937_64& random, int labels) {
  LabelledPoint point;
  point.position = Vec3(uniform(random, -1, 1), uniform(random, -0.7, 0.7), uniform(random, 0, 0.5));
  point.label = static_cast<int>(uniform(random, 0, labels));
  point.size = uniform(random, 0.05, 0.12);
  return point;
}

/// Point i < common of b is point i of a, seen in another frame with 1 cm of noise; the rest are others.
Problem random_problem(std::uint64_t seed, int common, int others, int labels) {
  std::mt19937_64 random(seed);
  Problem problem;
  problem.T_a_b = random_transform(random);
  problem.common = common;
  const SE3 T_b_a = problem.T_a_b.inverse();
  for (int i = 0; i < common + others; ++i) {
    const LabelledPoint p = random_point(random, labels);
    LabelledPoint q = i < common ? p : random_point(random, labels);
    q.position = T_b_a * q.position + 0.01 * Vec3(noise(random), noise(random), noise(random));
    problem.a.push_back(p);
    problem.b.push_back(q);
  }
  return problem;
}

std::vector<GraphMatch> match(const Problem& problem) { return match_graphs(problem.a, problem.b, LoopOptions()); }

TEST(GraphMatcher, FindsTheCommonPartAmongOutliers) {
  int exact = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const Problem problem = random_problem(seed, 9, 6, 4);
    const std::vector<GraphMatch> matches = match(problem);
    ASSERT_FALSE(matches.empty()) << "seed " << seed;
    bool close = true;
    for (int i = 0; i < problem.common; ++i) {
      const LabelledPoint& p = problem.a[static_cast<std::size_t>(i)];
      const LabelledPoint& q = problem.b[static_cast<std::size_t>(i)];
      close = close && (matches.front().T_a_b * q.position - p.position).norm() < 0.08;
    }
    int right = 0;
    for (const NodePair& pair : matches.front().pairs) right += pair.a == pair.b && pair.a < problem.common ? 1 : 0;
    exact += close && right >= problem.common - 1 ? 1 : 0;
  }
  EXPECT_GE(exact, 197);
}

TEST(GraphMatcher, VotesForTheScale) {
  LoopOptions options;
  options.scale = "free";
  std::mt19937_64 random(5);
  int exact = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    Problem problem = random_problem(seed, 9, 4, 5);
    const double scale = uniform(random, 1.0, 1.5), of_a_over_b = seed % 2 == 0 ? scale : 1.0 / scale;
    for (LabelledPoint& point : problem.b) {
      point.position /= of_a_over_b;
      point.size /= of_a_over_b;
    }
    const std::vector<GraphMatch> matches = match_graphs(problem.a, problem.b, options);
    if (matches.empty()) continue;
    const GraphMatch& best = matches.front();
    bool close = std::abs(best.scale / of_a_over_b - 1.0) < 0.05;
    for (int i = 0; i < problem.common; ++i) {
      const Vec3 p = best.T_a_b * (best.scale * problem.b[static_cast<std::size_t>(i)].position);
      close = close && (p - problem.a[static_cast<std::size_t>(i)].position).norm() < 0.1;
    }
    exact += close ? 1 : 0;
    for (const GraphMatch& match : match(problem)) EXPECT_EQ(match.scale, 1.0);
  }
  EXPECT_GE(exact, 190);
}

TEST(GraphMatcher, AFreeScaleFindsNothingInDegenerateInput) {
  LoopOptions options;
  options.scale = "free";
  std::mt19937_64 random(1);
  std::vector<LabelledPoint> one_place(6, random_point(random, 1)), broken = one_place;
  for (LabelledPoint& point : broken) point.position.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(match_graphs({}, {}, options).empty());
  EXPECT_TRUE(match_graphs(one_place, one_place, options).empty());
  EXPECT_TRUE(match_graphs(broken, one_place, options).empty());
}

TEST(GraphMatcher, IsExactWithoutNoise) {
  std::mt19937_64 random(3);
  Problem problem = random_problem(11, 8, 0, 4);
  for (std::size_t i = 0; i < problem.a.size(); ++i) {
    problem.b[i].position = problem.T_a_b.inverse() * problem.a[i].position;
  }
  const std::vector<GraphMatch> matches = match(problem);
  ASSERT_FALSE(matches.empty());
  EXPECT_EQ(matches.front().pairs.size(), 8u);
  EXPECT_LT(matches.front().rms_m, 1e-9);
  EXPECT_NEAR(matches.front().score, 8.0, 1e-9);
  EXPECT_LT((matches.front().T_a_b.t - problem.T_a_b.t).norm(), 1e-9);
}

TEST(GraphMatcher, KeepsTheInputsOrderOutOfTheResult) {
  const Problem problem = random_problem(21, 9, 5, 4);
  Problem reversed = problem;
  std::reverse(reversed.a.begin(), reversed.a.end());
  std::reverse(reversed.b.begin(), reversed.b.end());
  const auto matches = match(problem), matches_reversed = match(reversed);
  ASSERT_FALSE(matches.empty());
  ASSERT_FALSE(matches_reversed.empty());
  EXPECT_NEAR(matches.front().score, matches_reversed.front().score, 1e-9);
}

TEST(GraphMatcher, DoesNotCareAboutTheFrames) {
  const Problem problem = random_problem(5, 9, 5, 4);
  Problem moved = problem;
  std::mt19937_64 random(99);
  const SE3 T = random_transform(random);
  for (LabelledPoint& point : moved.b) point.position = T * point.position;
  const auto matches = match(problem), matches_moved = match(moved);
  ASSERT_EQ(matches.size(), matches_moved.size());
  for (std::size_t k = 0; k < matches.size(); ++k) {
    const SE3 difference = matches[k].T_a_b.inverse() * (matches_moved[k].T_a_b * T);
    EXPECT_LT(difference.t.norm(), 1e-9);
    EXPECT_EQ(matches[k].pairs.size(), matches_moved[k].pairs.size());
  }
}

TEST(GraphMatcher, SizesAndLabelsGateCorrespondences) {
  Problem other_labels = random_problem(8, 9, 0, 4);
  for (LabelledPoint& point : other_labels.b) point.label += 100;
  EXPECT_TRUE(match(other_labels).empty());
  Problem other_sizes = random_problem(8, 9, 0, 4);
  for (LabelledPoint& point : other_sizes.b) point.size *= 5.0;
  EXPECT_TRUE(match(other_sizes).empty());
}

TEST(GraphMatcher, CountsClassesWithinSharedLabels) {
  Problem problem = random_problem(8, 9, 0, 1);
  for (std::size_t i = 0; i < problem.a.size(); ++i) {
    problem.a[i].class_id = static_cast<int>(i % 4);
    problem.b[i].class_id = static_cast<int>(i % 3);
  }
  const auto matches = match(problem);
  ASSERT_FALSE(matches.empty());
  EXPECT_EQ(matches.front().pairs.size(), 9u);
  EXPECT_EQ(matches.front().classes, 3) << "of the side that has fewer";
}

TEST(GraphMatcher, TwoWaysToLieAreBothReported) {
  // b holds one group; a holds it twice, 3 m apart.
  Problem problem = random_problem(31, 8, 0, 4);
  std::vector<LabelledPoint> twice = problem.a;
  for (LabelledPoint point : problem.a) {
    point.position += Vec3(3.0, 0.0, 0.0);
    twice.push_back(point);
  }
  problem.a = twice;
  const std::vector<GraphMatch> matches = match(problem);
  ASSERT_GE(matches.size(), 2u);
  EXPECT_GT(matches[1].score, matches[0].score / 1.3);
  EXPECT_NEAR((matches[0].T_a_b.t - matches[1].T_a_b.t).norm(), 3.0, 0.1);
}

TEST(GraphMatcher, ACrowdIsMatchedWithoutLoss) {
  // All may correspond to all: as many correspondences as there are would take minutes.
  constexpr int kChairs = 150, kRare = 3;
  std::mt19937_64 random(41);
  Problem problem = random_problem(41, kChairs + kRare, 0, 1);
  for (int i = 0; i < kChairs + kRare; ++i) {
    LabelledPoint &p = problem.a[static_cast<std::size_t>(i)], &q = problem.b[static_cast<std::size_t>(i)];
    p.position = Vec3(uniform(random, -8, 8), uniform(random, -8, 8), uniform(random, 0, 0.5));
    q.position = problem.T_a_b.inverse() * p.position + 0.01 * Vec3(noise(random), noise(random), noise(random));
    q.size *= std::exp(0.1 * noise(random));
    if (i >= kChairs) p.label = q.label = i;
  }
  const std::vector<GraphMatch> matches = match(problem);
  ASSERT_FALSE(matches.empty());
  EXPECT_EQ(matches.front().pairs.size(), problem.a.size());
  for (const NodePair& pair : matches.front().pairs) EXPECT_EQ(pair.a, pair.b);
}

TEST(GraphMatcher, DegenerateInputGivesNothing) {
  const LoopOptions options;
  EXPECT_TRUE(match_graphs({}, {}, options).empty());
  std::vector<LabelledPoint> points = random_problem(1, 3, 0, 2).a;
  EXPECT_TRUE(match_graphs(points, points, options).empty()) << "too few";

  points = random_problem(1, 8, 0, 2).a;
  for (LabelledPoint& point : points) point.position = Vec3(0.3, 0.2, 0.1);
  EXPECT_TRUE(match_graphs(points, points, options).empty()) << "all in one place";

  for (std::size_t i = 0; i < points.size(); ++i) points[i].position = Vec3(0.3 * static_cast<double>(i), 0, 0);
  for (const GraphMatch& match : match_graphs(points, points, options)) {
    EXPECT_TRUE(match.T_a_b.is_finite());
    EXPECT_LT(match.spread_m(1), 0.05) << "on a line";
  }

  points = random_problem(1, 8, 0, 3).a;
  std::vector<LabelledPoint> broken = points;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  broken[0].position.x() = nan;
  broken[1].size = nan;
  broken[2].size = -1.0;
  for (const GraphMatch& match : match_graphs(broken, points, options)) {
    EXPECT_TRUE(match.T_a_b.is_finite());
    for (const NodePair& pair : match.pairs) EXPECT_GT(pair.a, 2);
  }
}

TEST(CliqueSearch, FindsAPlantedClique) {
  std::mt19937_64 random(17);
  for (int trial = 0; trial < 50; ++trial) {
    const std::size_t n = 90;
    BitGraph graph(n, Bits(n));
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = i + 1; j < n; ++j) {
        if (uniform(random, 0, 1) >= 0.15) continue;
        graph[i].set(j);
        graph[j].set(i);
      }
    }
    Clique planted;
    for (int i = 0; i < 9; ++i) planted.push_back(static_cast<std::size_t>(uniform(random, i * 10, i * 10 + 10)));
    for (const std::size_t i : planted) {
      for (const std::size_t j : planted) {
        if (i != j) graph[i].set(j);
      }
    }
    const Clique clique = largest_clique(graph, 100000);
    EXPECT_GE(clique.size(), planted.size());
    for (const std::size_t i : clique) {
      for (const std::size_t j : clique) EXPECT_TRUE(i == j || graph[i].next(j) == j);
    }
    const Clique grown = greedy_clique(graph, planted.front());
    EXPECT_NE(std::find(grown.begin(), grown.end(), planted.front()), grown.end());
    EXPECT_EQ(greedy_clique(graph, planted.front(), grown.size()), grown) << "it may be as large as is asked for";
    EXPECT_LT(greedy_clique(graph, planted.front(), clique.size() + 1).size(), clique.size() + 1);
  }
}

TEST(CliqueSearch, HandlesEmptyAndLooseGraphs) {
  EXPECT_TRUE(largest_clique({}, 100).empty());
  EXPECT_EQ(largest_clique(BitGraph(5, Bits(5)), 100).size(), 1u);
}

std::vector<LabelledPoint> random_points(std::mt19937_64& random, int count) {
  std::vector<LabelledPoint> points;
  for (int i = 0; i < count; ++i) {
    LabelledPoint point;
    point.position = Vec3(uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, 0, 0.5));
    point.label = static_cast<int>(uniform(random, 0, 8));
    point.size = 0.1;
    points.push_back(point);
  }
  return points;
}

TEST(SubmapIndex, FindsTheSubmapThatSharesObjects) {
  std::mt19937_64 random(1);
  SubmapIndex index(LoopOptions(), 5);
  std::vector<std::vector<LabelledPoint>> maps;
  for (int i = 0; i < 200; ++i) {
    maps.push_back(random_points(random, 12));
    index.insert(maps.back());
  }
  ASSERT_EQ(index.size(), 200);
  const SE3 T_query_map(so3_exp(Vec3(0.4, -1.0, 2.0)), Vec3(3.0, 1.0, -2.0));
  for (int i = 0; i < 200; i += 10) {
    std::vector<LabelledPoint> query(maps[static_cast<std::size_t>(i)].begin(),
                                     maps[static_cast<std::size_t>(i)].begin() + 8);
    for (LabelledPoint& point : query) point.position = T_query_map * point.position;
    const std::vector<int> candidates = index.query(query, 200);
    EXPECT_LE(candidates.size(), 5u);
    EXPECT_TRUE(std::is_sorted(candidates.begin(), candidates.end()));
    EXPECT_TRUE(std::count(candidates.begin(), candidates.end(), i) == 1) << i;
    const std::vector<int> before = index.query(query, i);
    EXPECT_TRUE(before.empty() || before.back() < i) << "submaps from `end` on are left out";
  }
}

TEST(SubmapIndex, BadPointsAreLeftOut) {
  std::mt19937_64 random(2);
  SubmapIndex index{LoopOptions()};
  std::vector<LabelledPoint> points = random_points(random, 8);
  points[0].position.x() = std::nan("");
  points[1].label = -1;
  points[2].position = points[3].position;
  points[4].position.y() = 1e300;
  index.insert(points);
  index.insert({});
  EXPECT_EQ(index.query({}, 2).size(), 0u);
  for (const int candidate : index.query(points, 2)) EXPECT_EQ(candidate, 0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
