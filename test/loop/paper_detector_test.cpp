#include "loop/paper/paper_detector.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {
namespace {

const std::vector<Vec3> kPoints{{0.1, 0.2, 1.5}, {-0.4, 0.1, 1.2}, {0.5, -0.2, 2.0}, {0.0, 0.4, 1.8}};

std::vector<CommonNode> nodes_at(const SE3& T_match_query, double scale, double quality) {
  std::vector<CommonNode> nodes;
  for (const Vec3& point : kPoints) nodes.push_back({point, T_match_query * (scale * point), quality});
  return nodes;
}

TEST(PaperScore, IdentityScoresOne) {
  EXPECT_NEAR(corrected_score(nodes_at(SE3(), 1.0, 1.0)), 1.0, 1e-12);
  EXPECT_NEAR(corrected_score(nodes_at(SE3(), 1.0, 0.4)), 0.4, 1e-12);
}

TEST(PaperScore, CorrectedScoreFallsWithEveryDifference) {
  const double identity = corrected_score(nodes_at(SE3(), 1.0, 1.0));
  EXPECT_LT(corrected_score(nodes_at(SE3(), 0.5, 1.0)), 0.9 * identity);
  EXPECT_LT(corrected_score(nodes_at(SE3(Quaternion::Identity(), Vec3(0.5, 0, 0)), 1.0, 1.0)), 0.9 * identity);
  EXPECT_LT(corrected_score(nodes_at(SE3(so3_exp(Vec3(0, 1.0, 0)), Vec3::Zero()), 1.0, 1.0)), 0.8 * identity);
}

TEST(PaperScore, CorrectedScoreOfATranslationIsAnalytic) {
  // R = I, s = 1, ||t|| = 0.6 for every vector.
  const auto nodes = nodes_at(SE3(Quaternion::Identity(), Vec3(0.0, 0.6, 0.0)), 1.0, 1.0);
  EXPECT_NEAR(corrected_score(nodes), std::exp(-0.3), 1e-12);
}

TEST(PaperScore, PrintedScoreTakesHalfScaleAndHalfAMetreForPerfect) {
  // Two nodes, so that s = 0.5 and t = (0.5 m, 0, 0) in both directions; the rotation is none.
  std::vector<CommonNode> nodes;
  for (const Vec3& point : {Vec3(0.2, 0.1, 1.0), Vec3(-0.3, 0.4, 1.6)}) {
    nodes.push_back({point, 0.5 * point + Vec3(0.5, 0.0, 0.0), 1.0});
  }
  std::vector<CommonNode> same = nodes;
  for (CommonNode& node : same) node.center_match = node.center_query;
  EXPECT_NEAR(printed_score(nodes), printed_score(same), 1e-12);
  EXPECT_LT(corrected_score(nodes), 0.7 * corrected_score(same));
}

TEST(PaperScore, PrintedScoreIsBlindToRotationAndGrowsWithTheNodes) {
  // Two nodes that the camera turns about, on its axis: t is zero both ways, and only the turn differs.
  const Vec3 near(0.0, 0.0, 1.0), far(0.0, 0.0, 2.0);
  const auto score = [&](auto score_of, const Quaternion& turn) {
    return score_of({{near, turn * near, 1.0}, {far, turn * far, 1.0}});
  };
  const Quaternion none = Quaternion::Identity(), quarter = so3_exp(Vec3(kPi / 2, 0.0, 0.0));
  EXPECT_NEAR(score(printed_score, quarter), score(printed_score, none), 1e-9);
  EXPECT_LT(score(corrected_score, quarter), 0.6 * score(corrected_score, none));

  std::vector<CommonNode> nodes = nodes_at(SE3(), 1.0, 1.0);
  EXPECT_NEAR(printed_score(nodes), 12.0, 1e-9);
  nodes.pop_back();
  EXPECT_NEAR(printed_score(nodes), 6.0, 1e-9);
  EXPECT_NEAR(corrected_score(nodes), 1.0, 1e-12);
}

TEST(PaperScore, VectorTransformMapsBothEnds) {
  const CommonNode start{Vec3(0.1, 0.2, 1.0), Vec3(0.5, -0.2, 1.4), 1.0};
  const CommonNode end{Vec3(-0.6, 0.3, 1.3), Vec3(0.2, 0.9, 2.0), 1.0};
  const VectorTransform T = vector_transform(start, end);
  EXPECT_LT((T.scale * T.R * start.center_query + T.t - start.center_match).norm(), 1e-12);
  EXPECT_LT((T.scale * T.R * end.center_query + T.t - end.center_match).norm(), 1e-12);
}

TEST(PaperScore, RodriguesIsSafeAtZeroAndPi) {
  const Vec3 from(0.3, -0.7, 0.2);
  for (const Vec3& to : {from, Vec3(2.0 * from), Vec3(-from), Vec3(-3.0 * from), Vec3(from + Vec3(1e-12, 0, 0)),
                         Vec3(-from + Vec3(0, 1e-12, 0)), Vec3(1.0, 0.0, 0.0)}) {
    const Mat3 R = rotation_between(from, to);
    ASSERT_TRUE(R.allFinite());
    EXPECT_NEAR(R.determinant(), 1.0, 1e-9);
    EXPECT_LT((R * R.transpose() - Mat3::Identity()).norm(), 1e-9);
    EXPECT_LT((R * from.normalized() - to.normalized()).norm(), 1e-8);
  }
}

TEST(PaperScore, DegenerateNodesScoreNothing) {
  EXPECT_EQ(corrected_score({}), 0.0);
  EXPECT_EQ(printed_score({}), 0.0);
  const CommonNode node{Vec3::UnitZ(), Vec3::UnitZ(), 1.0};
  EXPECT_EQ(corrected_score({node, node}), 0.0);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const CommonNode broken{Vec3(nan, 0, 0), Vec3::UnitX(), 1.0};
  EXPECT_EQ(corrected_score({node, broken}), 0.0);
}

TEST(ObjectIndex, CountsCommonLandmarks) {
  ObjectIndex index;
  index.insert(0, {1, 2, 3});
  index.insert(1, {3, 4});
  index.insert(2, {1, 3, 4});
  EXPECT_EQ(index.query({1, 3, 9}, {}), (std::map<int, int>{{0, 2}, {1, 1}, {2, 2}}));
  EXPECT_TRUE(index.query({9}, {}).empty());
}

TEST(ObjectIndex, FollowsMergesAndWhatTakesThemBack) {
  ObjectIndex index;
  index.insert(0, {1, 2});
  index.insert(1, {2, 5});
  LandmarkRedirects redirects;
  MapUpdate update;
  update.merged = {{5, 1}, {7, 5}};
  redirects.apply(update);
  EXPECT_EQ(redirects.resolve(7), 1);
  EXPECT_EQ(redirects.aliases(5), (std::vector<std::int64_t>{1, 5, 7}));
  EXPECT_EQ(index.query({1, 2}, redirects), (std::map<int, int>{{0, 2}, {1, 2}}));
  EXPECT_EQ(index.query({7, 5, 1}, redirects).at(0), 1);
  MapUpdate back;
  back.unmerged = {{7, 5}, {5, 1}};
  redirects.apply(back);
  EXPECT_EQ(redirects.resolve(7), 7);
  EXPECT_EQ(redirects.aliases(1), std::vector<std::int64_t>{1});
  EXPECT_EQ(index.query({1, 2}, redirects), (std::map<int, int>{{0, 2}, {1, 1}}));
}

}  // namespace
}  // namespace semantic_topo_loop::core
