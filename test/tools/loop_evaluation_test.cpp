#include "tools/evaluation/loop_evaluation.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "support/test_files.h"

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
  loop.reason_text = "accepted";
  loop.T_match_query = truth[m].T_world_camera.inverse() * truth[q].T_world_camera *
                       SE3(so3_exp(Vec3(radians(error_deg), 0.0, 0.0)), Vec3::Zero());
  loop.T_match_query.t += Vec3(0.0, error_m, 0.0);
  return loop;
}

std::vector<JudgedLoop> judge(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                              const TruePoses& truth) {
  return checked(judge_loops(loops, frames, truth));
}

LoopEvaluation evaluate(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                        const StampedPoses& mocap = {}) {
  const TruePoses truth(frames, mocap, 0.1);
  return evaluate_loops(judge(loops, frames, truth), truth);
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

TEST(LoopEvaluation, FiguresByViewpointDifference) {
  StampedPoses truth = visit_twice();
  for (std::size_t i = 0; i < 1000; ++i) truth[i].T_world_camera.q = Quaternion::Identity();
  for (std::size_t i = 2000; i < 3000; ++i) {
    truth[i].T_world_camera.q = so3_exp(Vec3(0.0, radians(i < 2500 ? 45.0 : 135.0), 0.0));
  }
  const LoopEvaluation e = evaluate({make_loop(truth, 2100, 100), make_loop(truth, 2600, 100),
                                     make_loop(truth, 2700, 100, 0.1), make_loop(truth, 2800, 100, 0.5)},
                                    truth);
  EXPECT_EQ(e.by_viewpoint[1].from_deg, 30.0);
  EXPECT_EQ(e.by_viewpoint[1].right_wide.total, 1);
  EXPECT_EQ(e.by_viewpoint[4].right_wide.right, 2);
  EXPECT_EQ(e.by_viewpoint[4].right_wide.total, 3);
  EXPECT_NEAR(e.by_viewpoint[4].error_m.median, 0.1, 1e-9);
  EXPECT_EQ(e.by_viewpoint[0].right_wide.total + e.by_viewpoint[5].right_wide.total, 0);
  EXPECT_NEAR(e.largest_right_view_deg, 135.0, 1e-9);
}

TEST(LoopEvaluation, LatencyFromTheFirstLoopableQuery) {
  StampedPoses truth = visit_twice();
  // The camera leaves once more: two revisits, 2010 to 2385 and 2505 to 2985.
  for (std::size_t i = 2400; i < 2500; ++i) truth[i].T_world_camera.t.x() = 80.0;
  EXPECT_EQ(evaluate({}, truth).revisits.size(), 2u);
  const LoopEvaluation e = evaluate({make_loop(truth, 2110, 100), make_loop(truth, 2100, 100, 0.5),
                                     make_loop(truth, 2300, 100), make_loop(truth, 2600, 1700)},
                                    truth);
  ASSERT_EQ(e.revisits.size(), 2u);
  EXPECT_EQ(e.revisits[0].first, 2010);
  EXPECT_EQ(e.revisits[0].last, 2385);
  EXPECT_EQ(e.revisits[0].latency_frames, 100);  // the wrong loop before does not count
  EXPECT_EQ(e.revisits[1].first, 2505);
  EXPECT_FALSE(e.revisits[1].latency_frames);  // the only loop is not over the gap
}

TEST(LoopEvaluation, HolesDoNotEndARevisit) {
  const StampedPoses truth = visit_twice();
  StampedPoses mocap;
  for (int i = 0; i < 3000; ++i) {
    if (i <= 2500 || i >= 2600) mocap.push_back({kStart + i * kPeriod, truth[0].T_world_camera});
  }
  EXPECT_EQ(evaluate({}, truth, mocap).revisits.size(), 1u);
}

TEST(LoopEvaluation, LoopsOfAnotherRunAreAnError) {
  const StampedPoses frames = visit_twice();
  const TruePoses truth(frames, {}, 0.1);
  LoopRecord loop = make_loop(frames, 2100, 100);
  loop.query_end = 3000;
  EXPECT_EQ(judge_loops({loop}, frames, truth).message(), "a loop names frame 3000, which the run does not have");
  loop = make_loop(frames, 2100, 100);
  loop.query_stamp_ns += 1;
  EXPECT_NE(judge_loops({loop}, frames, truth).message().find("the stamps of loop 2100 - 100"), std::string::npos);
  StampedPoses other = frames;
  for (StampedPose& pose : other) pose.stamp_ns += 1000000000000;
  EXPECT_NE(judge_loops({}, frames, TruePoses(other, {}, 0.1)).message().find("no stamp in common"), std::string::npos);
}

TEST(LoopEvaluation, LoopsIntoEarlierSessionsAreLeftOut) {
  const StampedPoses frames = visit_twice();
  const TruePoses truth(frames, {}, 0.1);
  constexpr std::int64_t kFirst = 700;  // a run that goes on with a map counts its frames on
  LoopRecord within = make_loop(frames, 2100, 100), into_earlier = within;
  for (std::int64_t* frame :
       {&within.query_frame, &within.match_frame, &within.query_begin, &within.query_end, &within.match_begin,
        &within.match_end, &into_earlier.query_frame, &into_earlier.query_begin, &into_earlier.query_end}) {
    *frame += kFirst;
  }
  const auto judged = checked(judge_loops({into_earlier, within}, frames, truth, kFirst));
  ASSERT_EQ(judged.size(), 1U);
  EXPECT_EQ(judged[0].match_begin_ns, frames[40].stamp_ns);
  EXPECT_TRUE(judged[0].is_right());
  within.query_end = kFirst + 3000;
  EXPECT_FALSE(judge_loops({within}, frames, truth, kFirst));
}

TEST(LoopEvaluation, HolesOfTheSharedMocap) {
  const auto frames = shared_data("tum/fr2_desk/groundtruth_frames.txt");
  const auto mocap = shared_data("tum/fr2_desk/groundtruth.txt");
  if (!frames || !mocap) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const auto truth = read_tum_ground_truth(*frames);
  const auto holes = read_tum_ground_truth(*mocap);
  ASSERT_TRUE(truth && holes) << truth.message() << holes.message();
  // A loop from every frame to itself: those in holes are not judged. shared/README.md speaks of 671 filled frames.
  std::vector<LoopRecord> loops;
  for (int i = 0; i < static_cast<int>(truth->size()); ++i) loops.push_back(make_loop(*truth, i, i));
  EXPECT_EQ(evaluate(loops, *truth, *holes).not_judged, 671);
  EXPECT_EQ(evaluate(loops, *truth).not_judged, 0);
}

/// Keyframes every 100 frames; images of both visits show the objects 1, 2 and 3, or only 1 and 2 from 2500 on.
KeyframeViews every_hundredth() {
  KeyframeViews input;
  for (int i = 0; i < 3000; i += 100) input.keyframe_stamps_ns.push_back(kStart + i * kPeriod);
  input.objects.assign(3000, {});
  for (std::size_t i = 0; i < 1000; ++i) input.objects[i] = {1, 2, 3, 4};
  for (std::size_t i = 2000; i < 3000; ++i) input.objects[i] = {1, 2, 3};
  for (std::size_t i = 2500; i < 3000; ++i) input.objects[i] = {1, 2};
  return input;
}

LoopRecord with_score(LoopRecord loop, double score, bool accepted = true) {
  loop.score = score;
  loop.accepted = accepted;
  return loop;
}

TEST(LoopCriteria, CountsOneLoopAKeyframe) {
  const StampedPoses frames = visit_twice();
  const TruePoses truth(frames, {}, 0.1);
  const auto loops = judge({with_score(make_loop(frames, 2150, 150), 2.0),         // keyframes 2100, 100: right
                            with_score(make_loop(frames, 2180, 1080), 1.0),        // worse one of 2100, another place
                            with_score(make_loop(frames, 2250, 1150), 3.0),        // 2200, another place
                            with_score(make_loop(frames, 2260, 150), 1.0),         // worse one of 2200, right
                            with_score(make_loop(frames, 2750, 250), 9.0, false),  // rejected
                            with_score(make_loop(frames, 2650, 150), 1.0),         // 2600
                            with_score(make_loop(frames, 2950, 2150), 5.0)},       // not over 1000 frames
                           frames, truth);
  const std::vector<CriterionCounts> rows = count_by_criterion(loops, truth, every_hundredth());
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_EQ(rows[0].keyframes, 30);
  // Keyframes 2000 to 2900 see the first visit's, which ends 1000 frames before the earliest of them.
  EXPECT_EQ(rows[0].reference_loops, 10);
  EXPECT_EQ(rows[0].real_loops, 3);
  EXPECT_EQ(rows[0].true_positives, 2);
  EXPECT_EQ(rows[0].found, 3);
  EXPECT_NEAR(rows[0].precision().value(), 2.0 / 3.0, 1e-12);
  EXPECT_NEAR(rows[0].recall().value(), 0.2, 1e-12);
  EXPECT_EQ(rows[1].reference_loops, 10);
  // Common objects: 2600 shares only two with 100. The gap is 500: 2900 counts, and shares two with 2100.
  EXPECT_EQ(rows[2].reference_loops, 9);  // 2000 to 2400, and 600 to 900 within the first visit
  EXPECT_EQ(rows[2].real_loops, 4);
  EXPECT_EQ(rows[2].true_positives, 1);
}

TEST(LoopCriteria, ReferencePairs) {
  const TruePoses truth(visit_twice(), {}, 0.1);
  const KeyframeViews input = every_hundredth();
  const auto pairs = reference_pairs(truth, input);
  const auto rows = count_by_criterion({}, truth, input);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(std::count_if(pairs.begin(), pairs.end(), [i](const ReferencePair& pair) { return pair.fulfils[i]; }),
              rows[i].reference_pairs);
    EXPECT_GT(rows[i].reference_pairs, 0);
  }
}

TEST(LoopCriteria, CurveFallsThroughAllScores) {
  const StampedPoses frames = visit_twice();
  const TruePoses truth(frames, {}, 0.1);
  LoopRecord no_pose = with_score(make_loop(frames, 2950, 150), 0.5, false);
  no_pose.T_match_query = SE3();
  const auto loops =
      judge({with_score(make_loop(frames, 2150, 150), 3.0), with_score(make_loop(frames, 2250, 1150, 2.0), 2.0),
             with_score(make_loop(frames, 2350, 150), 1.0, false), no_pose},
            frames, truth);
  const auto points = loop_curve(loops, truth, every_hundredth());
  ASSERT_EQ(points.size(), 4u);
  EXPECT_EQ(points[0].min_score, 3.0);
  EXPECT_EQ(points[0].precision.value(), 1.0);
  EXPECT_EQ(points[0].recall.right, 1);
  EXPECT_EQ(points[0].recall.total, 10);
  EXPECT_EQ(points[1].precision.value(), 0.5);
  EXPECT_EQ(points[1].right_wide.right, 1);
  EXPECT_EQ(points[1].right_wide.total, 2);
  EXPECT_EQ(points[2].precision.right, 2);  // the rejected one counts too
  EXPECT_GT(points[2].closed.right, points[1].closed.right);
  EXPECT_EQ(points[3].precision.total, 4);
  EXPECT_EQ(points[3].right_wide.total, 3);  // a candidate without a pose is not judged by one
  EXPECT_EQ(points[3].closed.right, points[2].closed.right);
}

}  // namespace
}  // namespace semantic_topo_loop::core
