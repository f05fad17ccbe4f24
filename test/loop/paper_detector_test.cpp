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
  // Two nodes 1 m away, halfway to which the camera has gone: s = 0.5 and ||t|| = 0.5 m both ways, no rotation.
  std::vector<CommonNode> nodes;
  for (const Vec3& point : {Vec3(0.0, 0.0, 1.0), Vec3(0.6, 0.0, 0.8)}) nodes.push_back({point, 0.5 * point, 1.0});
  std::vector<CommonNode> same = nodes;
  for (CommonNode& node : same) node.center_match = node.center_query;
  EXPECT_NEAR(printed_score(nodes), printed_score(same), 1e-12);
  EXPECT_LT(corrected_score(nodes), 0.8 * corrected_score(same));
}

TEST(PaperScore, PrintedScoreIsTheLetter) {
  // Equation 14: t = C^match - C^query. First 0 m, second (1, 0, 0), so 1 m. Topology is exp(-|1 - s - ||t||| / 2).
  const CommonNode first{Vec3(0, 0, 1), Vec3(0, 0, 1), 0.5}, second{Vec3(1, 0, 1), Vec3(2, 0, 1), 0.8};
  // First to second: s = 2, exp(-|1 - 2 - 0| / 2) = 0.606531. Second to first: s = 2, exp(-|1 - 2 - 1| / 2) = 0.367879.
  // Equations 16 and 17: semantic 0.5 x 0.606531 = 0.303265, then + 0.8 x 0.367879 = 0.597569; score is their sum.
  EXPECT_NEAR(printed_score({first, second}), 0.303265 + 0.597569, 2e-6);
  // The other way round: semantic 0.8 x 0.367879 = 0.294304, then + 0.303265 = 0.597569.
  EXPECT_NEAR(printed_score({second, first}), 0.294304 + 0.597569, 2e-6);

  // A third node that stays: first to third: s = 1, topology 1. Second to third: (-1, 1, 0) becomes (-2, 1, 0),
  // s = sqrt(5 / 2) = 1.581139, exp(-|1 - 1.581139 - 1| / 2) = 0.453587. Third to first: 1. Third to second:
  // exp(-|1 - 1.581139 - 0| / 2) = 0.747838.
  const CommonNode third{Vec3(0, 1, 1), Vec3(0, 1, 1), 1.0};
  // Semantic 0.5 (0.606531 + 1) = 0.803265, + 0.8 (0.367879 + 0.453587) = 1.460438, + 1 + 0.747838 = 3.208276.
  EXPECT_NEAR(printed_score({first, second, third}), 0.803265 + 1.460438 + 3.208276, 2e-6);
}

TEST(PaperScore, PrintedScoreGrowsWithTheNodes) {
  // Four that agree: each gives 3, the running sums 3 + 6 + 9 + 12. Three: 2 + 4 + 6.
  std::vector<CommonNode> nodes = nodes_at(SE3(), 1.0, 1.0);
  EXPECT_NEAR(printed_score(nodes), 30.0, 1e-9);
  nodes.pop_back();
  EXPECT_NEAR(printed_score(nodes), 12.0, 1e-9);
  EXPECT_NEAR(corrected_score(nodes), 1.0, 1e-12);
}

TEST(PaperScore, PrintedScoreDoesNotMeasureTheRotationOfAVector) {
  // The start stays where it is and counts alone; the end turns about it by up to half a turn.
  const CommonNode start{Vec3(0.0, 0.0, 1.0), Vec3(0.0, 0.0, 1.0), 1.0};
  const Vec3 vector(0.3, 0.2, 0.4);
  double last = 1.0;
  for (const double angle_rad : {0.5, 1.5, 3.0}) {
    const Vec3 turned = so3_exp(angle_rad * vector.cross(Vec3::UnitX()).normalized()) * vector;
    const std::vector<CommonNode> nodes{start, {start.center_query + vector, start.center_match + turned, 0.0}};
    EXPECT_NEAR(printed_score(nodes), 2.0, 1e-9) << angle_rad;
    EXPECT_LT(corrected_score(nodes), 0.9 * last) << angle_rad;
    last = corrected_score(nodes);
  }
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
  update.merged = {{5, 1}};
  redirects.apply(update);
  update.merged = {{5, 2}};  // whoever took it out of the first was not heard
  redirects.apply(update);
  EXPECT_EQ(redirects.resolve(5), 2);
  EXPECT_EQ(redirects.aliases(1), std::vector<std::int64_t>{1});
  for (const LandmarkMerge& detour : {LandmarkMerge{7, 5}, LandmarkMerge{5, 7}, LandmarkMerge{5, 5}}) {
    update.merged = {detour};
    redirects.apply(update);
  }
  EXPECT_EQ(redirects.resolve(7), 5);
  EXPECT_EQ(redirects.resolve(5), 5) << "no ring";
}

}  // namespace
}  // namespace semantic_topo_loop::core
