#include "semantic_topo_loop/evaluation/loop_evaluation.h"

#include <gtest/gtest.h>

#include "../test_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kPeriod = 33000000, kStart = 1000000000;

/// 3000 frames of a camera that stands at the origin, is 50 m away in frames 1000 to 1999 and then comes back.
StampedPoses visit_twice() {
  StampedPoses poses;
  for (int i = 0; i < 3000; ++i) {
    const double x = i >= 1000 && i < 2000 ? 50.0 : 0.0005 * (i % 1000);
    poses.push_back({kStart + i * kPeriod, SE3(so3_exp(Vec3(0.0, 0.0001 * i, 0.0)), Vec3(x, 0.0, 0.0))});
  }
  return poses;
}

/// An accepted loop between two frames with the evidence of 60 frames before each, off by the given error.
LoopRecord make_loop(const StampedPoses& truth, int query, int match, double error_m = 0.0, double error_deg = 0.0) {
  const auto q = static_cast<std::size_t>(query), m = static_cast<std::size_t>(match);
  LoopRecord loop;
  loop.query_frame = query;
  loop.match_frame = match;
  loop.query_stamp_ns = truth[q].stamp_ns;
  loop.match_stamp_ns = truth[m].stamp_ns;
  loop.query_begin = std::max(0, query - 60);
  loop.query_end = query;
  loop.match_begin = std::max(0, match - 60);
  loop.match_end = match;
  loop.accepted = true;
  loop.reason = "accepted";
  loop.T_match_query = truth[m].T_world_camera.inverse() * truth[q].T_world_camera *
                       SE3(so3_exp(Vec3(radians(error_deg), 0.0, 0.0)), Vec3::Zero());
  loop.T_match_query.t += Vec3(0.0, error_m, 0.0);
  return loop;
}

LoopEvaluation evaluate(const std::vector<LoopRecord>& loops, const StampedPoses& truth,
                        const StampedPoses& mocap = {}) {
  std::string error;
  const auto e = evaluate_loops(loops, truth, truth, mocap, {}, &error);
  EXPECT_TRUE(e) << error;
  return e.value_or(LoopEvaluation());
}

TEST(LoopEvaluation, RightWithinBothLimits) {
  const StampedPoses truth = visit_twice();
  const LoopEvaluation e = evaluate({make_loop(truth, 2100, 100), make_loop(truth, 2200, 100, 0.19, 4.9),
                                     make_loop(truth, 2300, 100, 0.34, 1.0), make_loop(truth, 2400, 100, 0.1, 9.0),
                                     make_loop(truth, 2500, 100, 0.36, 1.0), make_loop(truth, 2600, 100, 0.1, 11.0)},
                                    truth);
  EXPECT_EQ(e.accepted, 6);
  EXPECT_EQ(e.right_wide.right, 4);
  EXPECT_EQ(e.right_narrow.right, 2);
  EXPECT_EQ(e.right_wide.total, 6);
  EXPECT_NEAR(e.error_m.median, 0.145, 1e-9);
  EXPECT_NEAR(e.error_deg.max, 11.0, 1e-9);
}

TEST(LoopEvaluation, RejectedCandidatesAreOnlyCounted) {
  const StampedPoses truth = visit_twice();
  LoopRecord rejected = make_loop(truth, 2100, 100);
  rejected.accepted = false;
  const LoopEvaluation e = evaluate({rejected}, truth);
  EXPECT_EQ(e.candidates, 1);
  EXPECT_EQ(e.accepted, 0);
  EXPECT_EQ(e.right_wide.total, 0);
  EXPECT_EQ(e.closed, 0);
}

TEST(LoopEvaluation, CountsLoopableQueries) {
  const StampedPoses truth = visit_twice();
  const LoopEvaluation e = evaluate({}, truth);
  // Every query of the second visit: 2010 to 2985 see frames more than 1000 periods earlier.
  EXPECT_EQ(e.loopable, (2985 - 2010) / 15 + 1);
}

TEST(LoopEvaluation, LooksIntoAnotherDirectionAreNoRevisits) {
  StampedPoses truth = visit_twice();
  for (std::size_t i = 2000; i < 3000; ++i) truth[i].T_world_camera.q = so3_exp(Vec3(0.0, radians(95.0), 0.0));
  EXPECT_EQ(evaluate({}, truth).loopable, 0);
  // A roll about the optical axis does not change what is seen.
  for (std::size_t i = 2000; i < 3000; ++i) truth[i].T_world_camera.q = so3_exp(Vec3(0.0, 0.0, radians(95.0)));
  EXPECT_GT(evaluate({}, truth).loopable, 60);
}

TEST(LoopEvaluation, ClosedByEvidenceAndAtOnce) {
  const StampedPoses truth = visit_twice();
  // Evidence 2040 to 2100 holds the queries 2040, 2055, 2070, 2085 and 2100; it ends within 15 frames of the last two.
  const LoopEvaluation e = evaluate({make_loop(truth, 2100, 100)}, truth);
  EXPECT_EQ(e.closed, 5);
  EXPECT_EQ(e.closed_at_once, 2);
}

TEST(LoopEvaluation, WrongOrShortLoopsCloseNothing) {
  const StampedPoses truth = visit_twice();
  EXPECT_EQ(evaluate({make_loop(truth, 2100, 100, 0.5)}, truth).closed, 0);
  EXPECT_EQ(evaluate({make_loop(truth, 2100, 100, 0.0, 20.0)}, truth).closed, 0);
  EXPECT_EQ(evaluate({make_loop(truth, 2900, 2100)}, truth).closed, 0);  // not over the gap
}

TEST(LoopEvaluation, PairFiguresOfThePaper) {
  const StampedPoses truth = visit_twice();
  const LoopEvaluation none = evaluate({}, truth);
  EXPECT_EQ(none.pair_recall.right, 0);
  EXPECT_EQ(none.pair_precision.total, 0);
  // A loop to the far place claims the same place wrongly; the short one is not judged by the paper.
  const LoopEvaluation e =
      evaluate({make_loop(truth, 2100, 100), make_loop(truth, 2700, 1500), make_loop(truth, 2900, 2100)}, truth);
  EXPECT_EQ(e.pair_precision.right, 1);
  EXPECT_EQ(e.pair_precision.total, 2);
  EXPECT_EQ(e.pair_recall.total, none.pair_recall.total);
  EXPECT_EQ(e.pair_recall.right, 5 * 4);  // queries 2040 .. 2100 with matches 45 .. 90
}

TEST(LoopEvaluation, EndsInMocapHolesAreLeftOut) {
  const StampedPoses truth = visit_twice();
  StampedPoses mocap;
  for (int i = 0; i < 3000; ++i) {
    if (i <= 2090 || i >= 2110) mocap.push_back({kStart + i * kPeriod - 1000, truth[0].T_world_camera});
  }
  mocap.push_back({kStart + 3000 * kPeriod, truth[0].T_world_camera});
  const LoopEvaluation e = evaluate({make_loop(truth, 2100, 100), make_loop(truth, 2200, 100)}, truth, mocap);
  EXPECT_EQ(e.accepted, 2);
  EXPECT_EQ(e.not_judged, 1);
  EXPECT_EQ(e.right_wide.total, 1);
  EXPECT_EQ(evaluate({}, truth).loopable - evaluate({}, truth, mocap).loopable, 1);  // query 2100 itself
}

TEST(LoopEvaluation, LoopsOfAnotherRunAreAnError) {
  const StampedPoses truth = visit_twice();
  std::string error;
  LoopRecord loop = make_loop(truth, 2100, 100);
  loop.query_end = 3000;
  EXPECT_FALSE(evaluate_loops({loop}, truth, truth, {}, {}, &error));
  EXPECT_EQ(error, "a loop names frame 3000, but the run has 3000");
  loop = make_loop(truth, 2100, 100);
  loop.query_stamp_ns += 1;
  EXPECT_FALSE(evaluate_loops({loop}, truth, truth, {}, {}, &error));
  EXPECT_NE(error.find("the stamps of loop 2100 - 100"), std::string::npos);
  StampedPoses other = truth;
  for (StampedPose& pose : other) pose.stamp_ns += 1000000000000;
  EXPECT_FALSE(evaluate_loops({}, truth, other, {}, {}, &error));
  EXPECT_NE(error.find("no stamp in common"), std::string::npos);
}

TEST(LoopEvaluation, HolesOfTheSharedMocap) {
  const auto frames = shared_data("tum/fr2_desk/groundtruth_frames.txt");
  const auto mocap = shared_data("tum/fr2_desk/groundtruth.txt");
  if (!frames || !mocap) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  std::string error;
  const auto truth = read_tum_ground_truth(*frames, &error);
  const auto holes = read_tum_ground_truth(*mocap, &error);
  ASSERT_TRUE(truth && holes) << error;
  // A loop from every frame to itself: those in holes are not judged. shared/README.md speaks of 671 filled frames.
  std::vector<LoopRecord> loops;
  for (int i = 0; i < static_cast<int>(truth->size()); ++i) loops.push_back(make_loop(*truth, i, i));
  EXPECT_EQ(evaluate(loops, *truth, *holes).not_judged, 671);
  EXPECT_EQ(evaluate(loops, *truth).not_judged, 0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
