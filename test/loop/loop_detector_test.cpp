#include "semantic_topo_loop/loop/loop_detector.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "loop/pair_record.h"
#include "loop/submap/submap_builder.h"
#include "odometry/graph_loop.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/pipeline/options.h"
#include "support/random_motions.h"
#include "support/synthetic_desk.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

using testing::random_desk;
using testing::run;
using testing::RunOutcome;
using testing::RunSetup;

/// Two visits to a desk half a minute apart, with 0.5 m and 8 deg of drift between them and new landmark ids.
RunSetup drifted_revisit(std::uint64_t seed) {
  RunSetup setup;
  setup.desk = random_desk(seed, 12);
  setup.visits = {{0.0, 12.0, 0.0, 80.0}, {30.0, 42.0, 60.0, -20.0}};
  setup.end_s = 42.0;
  setup.drift = SE3(so3_exp(Vec3(0.08, -0.06, 0.1)), Vec3(0.4, 0.25, -0.15));
  setup.drift_from_s = 20.0;
  return setup;
}

double error_m(const SE3& a, const SE3& b) { return (a.t - b.t).norm(); }
double error_deg(const SE3& a, const SE3& b) { return degrees(rotation_angle(a.q, b.q)); }

void expect_right(const RunOutcome& outcome) {
  for (const LoopClosure& loop : outcome.loops) {
    ASSERT_TRUE(loop.T_match_query.is_finite());
    if (!loop.accepted) continue;
    EXPECT_LT(error_m(loop.T_match_query, outcome.truth(loop)), 0.1);
    EXPECT_LT(error_deg(loop.T_match_query, outcome.truth(loop)), 3.0);
    EXPECT_EQ(loop.reason, LoopReason::kAccepted);
    EXPECT_LT(loop.match_end, loop.query_begin);
    EXPECT_LE(loop.query_begin, loop.query_frame);
    EXPECT_LE(loop.query_frame, loop.query_end);
    EXPECT_EQ(static_cast<int>(loop.matches.size()), loop.inliers);
    for (std::size_t i = 0; i < loop.matches.size(); ++i) {
      EXPECT_EQ(loop.query_objects.at(i).landmark_id, loop.matches[i].query_landmark_id);
      EXPECT_EQ(loop.match_objects.at(i).landmark_id, loop.matches[i].match_landmark_id);
      const Vec3 in_match = loop.T_match_query * Vec3(loop.scale * loop.query_objects[i].position);
      EXPECT_LT((in_match - loop.match_objects[i].position).norm(), 0.2) << "one object";
    }
  }
}

TEST(LoopDetector, GraphModeClosesADriftedRevisitWithoutSharedIds) {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    const RunOutcome outcome = run(LoopOptions(), drifted_revisit(seed));
    EXPECT_GE(outcome.accepted(), 5) << "seed " << seed;
    expect_right(outcome);
    for (const LoopClosure& loop : outcome.loops) {
      if (!loop.accepted) continue;
      EXPECT_GT(error_m(loop.T_match_query, outcome.odometry(loop)), 0.1) << "no innovation";
    }
  }
}

TEST(LoopDetector, ClosesAcrossARestartOfTheOdometry) {
  RunSetup setup = drifted_revisit(2);
  setup.drift = SE3(so3_exp(Vec3(-0.9, 1.2, 0.8)), Vec3(-4.0, 1.0, 2.0));
  setup.drift_is_break = true;
  const RunOutcome outcome = run(LoopOptions(), setup);
  EXPECT_GE(outcome.accepted(), 5);
  expect_right(outcome);
}

/// In each of its parts: the submaps of the run, those of an earlier one, and the paper's keyframes.
TEST(LoopDetector, OptionsChangeFromTheNextFrameOn) {
  std::vector<LocalMap> earlier_map;
  run(LoopOptions(), drifted_revisit(1), [&](const LoopDetector& detector) { earlier_map = detector.submaps(); });
  for (const std::string part : {"graph", "earlier map", "paper"}) {
    LoopOptions options;
    options.paper_min_gap_frames = 150;
    if (part == "paper") options.mode = "paper";
    RunSetup setup = drifted_revisit(1);
    setup.same_ids = true;
    if (part == "earlier map") setup.earlier_map = earlier_map;
    setup.changed_at_s = 40.0;
    // Loops before that, and from then on.
    const auto accepted = [&] {
      std::pair<int, int> counts;
      for (const LoopClosure& loop : run(options, setup).loops) {
        if (!loop.accepted || loop.T_earlier_match.has_value() != (part == "earlier map")) continue;
        ++(0.1 * static_cast<double>(loop.query_end) < setup.changed_at_s ? counts.first : counts.second);
      }
      return counts;
    };
    const auto [before, after] = accepted();
    EXPECT_GT(before, 0) << part;
    EXPECT_GT(after, 0) << part;
    setup.changed = options;
    setup.changed->max_rms_m = 1e-9;
    EXPECT_EQ(accepted(), std::pair(before, 0)) << part;
  }
}

TEST(LoopDetector, WhatTheSourceFoundRestsOnNothingOfAnEarlierSession) {
  LoopDetector detector(LoopOptions(), std::make_shared<const ClassTable>());
  constexpr std::int64_t kBefore = 100;
  std::vector<KeyframePose> keyframes;
  for (std::int64_t i = 0; i < kBefore; ++i) keyframes.push_back({i, 10 * i, i * 1'000'000'000, {}});
  detector.restore({}, keyframes, {});
  std::vector<LoopClosure> loops;
  for (std::int64_t i = 0; i < 10; ++i) {  // by a clock that begins anew
    Frame frame;
    frame.frame_id = 10 * (kBefore + i);
    frame.keyframe_id = kBefore + i;
    frame.is_keyframe = true;
    frame.stamp_ns = i * 1'000'000'000;
    if (i == 9) frame.source_loop = SourceLoop{0, {}, Mat6::Identity(), 80};
    loops = detector.detect(frame, {});
  }
  ASSERT_EQ(loops.size(), 1U);
  EXPECT_EQ(loops[0].match_begin, 10 * kBefore);
  EXPECT_EQ(loops[0].match_end, 10 * (kBefore + 2));
}

TEST(LoopDetector, WhatTheSourceFoundLeadsToNoEarlierSession) {
  LoopDetector detector(LoopOptions(), std::make_shared<const ClassTable>());
  detector.restore({}, {{0, 0, 1'000'000'000, {}}, {1, 10, 2'000'000'000, {}}}, {});
  Frame frame;
  frame.is_keyframe = true;
  for (const std::int64_t id : {2, 3}) {
    frame.frame_id = 10 * id;
    frame.keyframe_id = id;
    frame.stamp_ns = id * 1'000'000'000;
    frame.source_loop = SourceLoop{1'000'000'000, {}, Mat6::Identity(), 80};  // of before this stage was loaded
    EXPECT_TRUE(detector.detect(frame, {}).empty());
  }
}

TEST(LoopDetector, PassesOnWhatTheOdometrysSourceFound) {
  const SE3 T_odom_match(so3_exp(Vec3(0.1, 0.2, -0.3)), Vec3(1.0, 2.0, 3.0));
  const SE3 T_match_image(so3_exp(Vec3(0.0, 0.05, 0.0)), Vec3(0.02, 0.0, 0.03));  // of the image that was found again
  const SE3 T_image_now(so3_exp(Vec3(0.2, 0.0, 0.1)), Vec3(0.3, -0.1, 0.2));
  const SE3 T_odom_query(so3_exp(Vec3(-0.4, 0.0, 0.0)), Vec3(-1.0, 0.0, 0.5));
  const SE3 T_query_now(so3_exp(Vec3(0.0, 0.0, 0.03)), Vec3(0.0, 0.04, 0.0));
  LoopDetector detector(LoopOptions(), std::make_shared<const ClassTable>());
  const auto detect = [&detector](std::int64_t id, std::int64_t keyframe_id, bool is_keyframe, const SE3& T_odom_camera,
                                  const std::optional<SourceLoop>& source_loop) {
    Frame frame;
    frame.frame_id = id;
    frame.stamp_ns = 1'000'000'000 * (id + 1);
    frame.keyframe_id = keyframe_id;
    frame.is_keyframe = is_keyframe;
    frame.T_odom_camera = T_odom_camera;
    frame.source_loop = source_loop;
    return detector.detect(frame, {});
  };
  EXPECT_TRUE(detect(0, 0, true, T_odom_match, {}).empty());
  EXPECT_TRUE(detect(1, 0, false, T_odom_match * T_match_image, {}).empty());
  EXPECT_TRUE(detect(2, 1, true, T_odom_query, {}).empty());
  SourceLoop found;
  found.stamp_ns = 2'000'000'000;
  found.T_odom_camera = T_odom_match * T_match_image * T_image_now;
  found.covariance = 1e-4 * Mat6::Identity();
  found.points = 80;
  const std::vector<LoopClosure> loops = detect(3, 1, false, T_odom_query * T_query_now, found);
  ASSERT_EQ(loops.size(), 1U);
  const LoopClosure& loop = loops[0];
  EXPECT_TRUE(loop.accepted);
  EXPECT_EQ(loop.reason, LoopReason::kFoundBySource);
  EXPECT_EQ(loop.query_keyframe_id, 1);
  EXPECT_EQ(loop.match_keyframe_id, 0);
  EXPECT_EQ(loop.query_frame, 2);
  EXPECT_EQ(loop.match_frame, 0);
  const SE3 truth = T_match_image * T_image_now * T_query_now.inverse();
  EXPECT_LT(error_m(loop.T_match_query, truth), 1e-9);
  EXPECT_LT(error_deg(loop.T_match_query, truth), 1e-6);
  EXPECT_GT(loop.covariance(0, 0), 1e-4) << "a turn at the frame moves the keyframe";
  EXPECT_NEAR(loop.sigma_m, std::sqrt(loop.covariance.topLeftCorner<3, 3>().trace()), 1e-12);
  EXPECT_EQ(loop.inliers, 80);
  EXPECT_NE(detector.explain(1, 0).text.find("80 points"), std::string::npos);
  EXPECT_EQ(loop.match_begin, 0);
  found.stamp_ns = 0;  // before the run
  EXPECT_TRUE(detect(4, 1, false, T_odom_query, found).empty());
  LoopOptions off;
  off.enabled = false;
  detector.set_options(off);
  found.stamp_ns = 2'000'000'000;
  EXPECT_TRUE(detect(5, 1, false, T_odom_query, found).empty());
}

TEST(LoopDetector, WhatTheSourceFoundOfOnePlaceInARowSharesEvidence) {
  LoopDetector detector(LoopOptions(), std::make_shared<const ClassTable>());
  constexpr int kFrames = 60, kFound = 40;  // twice a second
  std::vector<GraphLoop> loops;
  for (int k = 0; k < kFrames; ++k) {
    Frame frame;
    frame.frame_id = frame.keyframe_id = k;
    frame.stamp_ns = 500'000'000LL * (k + 1);
    frame.is_keyframe = true;
    if (k == kFound || k == kFound + 1 || k == kFound + 15) {
      frame.source_loop = SourceLoop{500'000'000LL * (k + 1 - 30), SE3(), 1e-4 * Mat6::Identity(), 80};
    }
    for (const LoopClosure& loop : detector.detect(frame, {}))
      loops.push_back(checked(make_graph_loop(loop, k, k - 30)));
  }
  ASSERT_EQ(loops.size(), 3U);
  EXPECT_GT(shared_evidence(loops[0], loops[1]), 0.3);
  EXPECT_LT(shared_evidence(loops[0], loops[1]), 0.9);
  EXPECT_EQ(shared_evidence(loops[0], loops[2]), 0.0) << "seconds later, of another place";
}

/// T_match_query of a scaled odometry has the match's unit of length, which is the true one here.
TEST(LoopDetector, AFreeScaleClosesWhereTheOdometrysScaleHasDrifted) {
  LoopOptions free;
  free.scale = "free";
  for (const double scale : {1.0, 0.75, 1.25, 1.5}) {
    RunSetup setup = drifted_revisit(2);
    setup.drift_scale = scale;
    setup.drift_is_break = true;
    const RunOutcome outcome = run(free, setup);
    EXPECT_GE(outcome.accepted(), 5) << "scale " << scale;
    expect_right(outcome);
    for (const LoopClosure& loop : outcome.loops) {
      if (!loop.accepted) continue;
      const double error = std::log(loop.scale * scale), sigma = std::sqrt(loop.scale_covariance(6));
      EXPECT_LT(std::abs(error), 0.05) << "scale " << scale;
      EXPECT_LT(std::abs(error), 4.0 * sigma) << "scale " << scale << " is stated too precisely";
    }
    if (std::abs(scale - 1.0) > 0.2) {
      EXPECT_LT(run(LoopOptions(), setup).accepted(), outcome.accepted() / 2);
    }
  }
}

TEST(LoopDetector, TheOdometrysWorldDoesNotMatter) {
  for (const char* mode : {"graph", "paper"}) {
    LoopOptions options;
    options.mode = mode;
    options.paper_min_gap_frames = 150;
    RunSetup setup = drifted_revisit(1);
    setup.same_ids = true;
    const RunOutcome outcome = run(options, setup);
    setup.T_odom_world = SE3(so3_exp(Vec3(1.1, -0.7, 2.0)), Vec3(30.0, -20.0, 5.0));
    const RunOutcome moved = run(options, setup);
    const auto pairs = [](const RunOutcome& o) {
      std::set<std::pair<std::int64_t, std::int64_t>> result;
      for (const LoopClosure& loop : o.loops) {
        if (loop.accepted) result.emplace(loop.query_frame, loop.match_frame);
      }
      return result;
    };
    EXPECT_FALSE(pairs(outcome).empty()) << mode;
    EXPECT_EQ(pairs(outcome), pairs(moved)) << mode;
  }
}

TEST(LoopDetector, IsDeterministic) {
  const RunOutcome first = run(LoopOptions(), drifted_revisit(3)), second = run(LoopOptions(), drifted_revisit(3));
  ASSERT_EQ(first.loops.size(), second.loops.size());
  for (std::size_t i = 0; i < first.loops.size(); ++i) {
    EXPECT_EQ(first.loops[i].T_match_query.t, second.loops[i].T_match_query.t);
    EXPECT_EQ(first.loops[i].covariance, second.loops[i].covariance);
  }
}

/// Two visits, of which the second sees the desk `second`. @param spoil changes what a frame is told of its boxes
std::vector<LoopClosure> two_visits(
    const RunSetup& setup, const std::vector<testing::DeskObject>& second,
    const std::function<void(std::int64_t, Frame*, AssociationFrame*)>& spoil = [](auto...) {}) {
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::mt19937_64 random(1);
  std::vector<LoopClosure> loops;
  for (std::int64_t k = 0; k < 420; ++k) {
    const double time_s = 0.1 * static_cast<double>(k);
    const SE3 pose = testing::desk_pose(setup.visits, time_s);
    Frame frame = *builder.build({k * 100'000'000, pose});
    const bool is_first = time_s < 20.0;
    AssociationFrame associations =
        testing::observe(is_first ? setup.desk : second, frame, pose, is_first ? 0 : 500, random);
    spoil(k, &frame, &associations);
    for (LoopClosure& loop : detector.detect(frame, associations)) loops.push_back(std::move(loop));
  }
  return loops;
}

int accepted(const std::vector<LoopClosure>& loops) {
  return static_cast<int>(std::count_if(loops.begin(), loops.end(), [](const auto& loop) { return loop.accepted; }));
}

TEST(LoopDetector, AnotherDeskIsNoLoop) {
  // The second visit sees another desk: objects at another place, shown by ids and truth alike.
  std::size_t candidates = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const RunSetup setup = drifted_revisit(seed);
    const std::vector<LoopClosure> loops = two_visits(setup, drifted_revisit(seed + 100).desk);
    EXPECT_EQ(accepted(loops), 0) << seed;
    EXPECT_GE(accepted(two_visits(setup, setup.desk)), 5) << seed << ": the same one is";
    candidates += loops.size();
  }
  EXPECT_GT(candidates, 0U) << "some looked alike at first";
}

/// Motions of a run along a desk; what comes later holds. @param drift_mps straight ahead, beside the true motion
/// @param slip_from_s from then on for 2.4 s by 0.6 m in all, longer than any burst
/// @param answered_every frames that the detector takes for an answer
std::map<std::int64_t, SolvedMotion> motions_along_a_desk(LoopDetector* detector, double drift_mps,
                                                          std::vector<SE3>* keyframes, double slip_from_s = 1e9,
                                                          std::int64_t answered_every = 1) {
  const auto desk = random_desk(6, 10);
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::mt19937_64 random(2);
  std::map<std::int64_t, SolvedMotion> motions;
  for (std::int64_t k = 0; k < 200; ++k) {
    const double time_s = 0.1 * static_cast<double>(k);
    const SE3 pose = testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, time_s);
    const double slipped_m = 0.25 * std::clamp(time_s - slip_from_s, 0.0, 2.4);
    const SE3 drift(Quaternion::Identity(), Vec3(drift_mps * time_s, slipped_m, 0.0));
    const auto frame = builder.build({1'000'000'000 + k * 100'000'000, drift * pose});
    if (frame->is_keyframe) keyframes->push_back(pose);
    AssociationFrame seen = testing::observe(desk, *frame, pose, 0, random);
    if (k % answered_every != 0) seen = AssociationFrame::without_answer(frame->frame_id);
    detector->detect(*frame, seen);
    for (const SolvedMotion& motion : detector->motions()) motions[motion.from_keyframe_id] = motion;
  }
  detector->detect(builder.end(), {});
  EXPECT_TRUE(detector->motions().empty()) << "they are told once";
  return motions;
}

TEST(LoopDetector, TellsHowTheCameraMovedFromKeyframeToKeyframe) {
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  std::vector<SE3> truth;
  constexpr double kDrift_mps = 0.03;
  const auto motions = motions_along_a_desk(&detector, kDrift_mps, &truth);
  EXPECT_GT(motions.size() + 4, truth.size()) << "but for those of the last frames";
  double path_m = 0.0;
  SE3 T_first_last;
  for (const auto& [from, motion] : motions) {
    EXPECT_EQ(motion.to_keyframe_id, from + 1);
    EXPECT_GE(motion.path_m, (1.0 - 1e-9) * motion.T_from_to.t.norm());
    EXPECT_FALSE(motion.missed.is_any());
    path_m += motion.path_m;
    T_first_last = T_first_last * motion.T_from_to;
  }
  const std::size_t last = static_cast<std::size_t>(motions.rbegin()->second.to_keyframe_id);
  const SE3 error = (truth.front().inverse() * truth[last]).inverse() * T_first_last;
  EXPECT_LT(error.t.norm(), 0.5 * 20.0 * kDrift_mps);
  EXPECT_NEAR(path_m, 4.3, 0.4) << "the length of the way around the desk, up and down";
  EXPECT_EQ(detector.submaps().back().missed.translation_m, 0.0);
}

TEST(LoopDetector, TellsNoWayWhileTheCameraStands) {
  const auto desk = random_desk(6, 12);
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::mt19937_64 random(2);
  Random jitter(3);
  constexpr double kStands_s = 7.0, kGoesOn_s = 17.0;
  SE3 last_pose;
  double way_m = 0.0;
  std::vector<double> ways_m;  // to each keyframe
  std::map<std::int64_t, SolvedMotion> motions;
  for (int k = 0; k < 900; ++k) {
    const double time_s = k / 30.0;
    const double moves_for_s = std::min(time_s, kStands_s) + std::max(time_s - kGoesOn_s, 0.0);
    const SE3 pose = testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, moves_for_s);
    if (k > 0) way_m += (pose.t - last_pose.t).norm();
    last_pose = pose;
    const auto frame =
        builder.build({std::llround(1e9 * (1.0 + time_s)), pose * random_motion(&jitter, 0.002, 0.0005)});
    if (frame->is_keyframe) ways_m.push_back(way_m);
    detector.detect(*frame, testing::observe(desk, *frame, pose, 0, random));
    for (const SolvedMotion& motion : detector.motions()) motions[motion.from_keyframe_id] = motion;
  }
  double path_m = 0.0;
  for (const auto& [from, motion] : motions) path_m += motion.path_m;
  const double expected_m = ways_m[static_cast<std::size_t>(motions.rbegin()->second.to_keyframe_id)];
  EXPECT_NEAR(path_m, expected_m, 0.05 * expected_m);
}

class LoopDetectorSlip : public ::testing::TestWithParam<std::int64_t> {};

TEST_P(LoopDetectorSlip, IsToldFromKeyframeToKeyframe) {
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  std::vector<SE3> truth;
  const auto motions = motions_along_a_desk(&detector, 0.0, &truth, 9.0, GetParam());
  EXPECT_GT(motions.size() + 4, truth.size()) << "it parts nothing";
  double slipped_s = 0.0;
  SE3 T_first_last;
  for (const auto& [from, motion] : motions) {
    slipped_s += motion.missed.slipped_s;
    T_first_last = T_first_last * motion.T_from_to;
  }
  EXPECT_NEAR(slipped_s, 2.4, 0.7);
  const std::size_t last = static_cast<std::size_t>(motions.rbegin()->second.to_keyframe_id);
  EXPECT_LT(((truth.front().inverse() * truth[last]).inverse() * T_first_last).t.norm(), 0.1);
}

INSTANTIATE_TEST_SUITE_P(AnsweredEvery, LoopDetectorSlip, ::testing::Values(1, 2));

/// First frame of the last submap along a desk, where after seven seconds (210 frames) the odometry is turned at once.
/// @param answered_every frames that the detector takes for an answer
std::int64_t last_begin_after_a_turn(bool camera_turns, int frames = 420, std::int64_t answered_every = 1) {
  const auto desk = random_desk(6, 12);
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::mt19937_64 random(2);
  const SE3 turn(so3_exp(Vec3(0.0, radians(4.0), 0.0)), Vec3::Zero());
  for (std::int64_t k = 0; k < frames; ++k) {
    const double time_s = static_cast<double>(k) / 30.0;
    const SE3 pose = testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, time_s);
    const SE3 T_odom_camera = time_s < 7.0 ? pose : pose * turn;
    const auto frame = builder.build({std::llround(1e9 * (1.0 + time_s)), T_odom_camera});
    AssociationFrame seen = testing::observe(desk, *frame, camera_turns ? T_odom_camera : pose, 0, random);
    if ((k + 5) % answered_every != 0) seen = AssociationFrame::without_answer(frame->frame_id);
    detector.detect(*frame, seen);
  }
  const std::vector<LocalMap> submaps = detector.submaps();
  return submaps.empty() ? -1 : submaps.back().begin_frame;
}

TEST(LoopDetector, AJoltOfTheCameraEndsNoSubmap) {
  EXPECT_EQ(last_begin_after_a_turn(true), 0);
  EXPECT_NE(last_begin_after_a_turn(false), 0);
}

TEST(LoopDetector, BoxesFromBeforeAJumpDoNotRefuteIt) {
  const std::int64_t begin = last_begin_after_a_turn(false, 600, 15);  // the last ones 5 frames before it
  EXPECT_GT(begin, 210);
  EXPECT_LT(begin, 235) << "before the boxes could show it";
}

TEST(LoopDetector, NothingIsSolvedForWhileLoopClosingIsOffNorInPaperMode) {
  std::vector<SE3> truth;
  LoopOptions disabled;
  disabled.enabled = false;
  LoopDetector off(LoopOptions(), testing::desk_classes());
  off.set_options(disabled);
  EXPECT_TRUE(motions_along_a_desk(&off, 0.0, &truth).empty());
  LoopOptions options;
  options.mode = "paper";
  LoopDetector paper(options, testing::desk_classes());
  EXPECT_TRUE(motions_along_a_desk(&paper, 0.0, &truth).empty());
}

class LoopDetectorStand : public ::testing::TestWithParam<double> {};

TEST_P(LoopDetectorStand, IsToldBySubmapsThatFollowWithAllThatWasMissed) {
  const auto desk = random_desk(6, 12);
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::mt19937_64 random(2);
  const auto camera_at = [](double time_s) { return testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, time_s); };
  constexpr double kStands_s = 7.0, kGoesOn_s = 8.5;
  const double turns_s = GetParam();
  const SE3 turn(so3_exp(Vec3(0.0, radians(4.0), 0.0)), Vec3::Zero());
  for (int k = 0; k < 750; ++k) {
    const double time_s = k / 30.0;
    SE3 T_odom_camera = camera_at(std::min(time_s, kStands_s));
    if (time_s > kGoesOn_s) T_odom_camera = T_odom_camera * camera_at(kGoesOn_s).inverse() * camera_at(time_s);
    if (time_s > turns_s) T_odom_camera = T_odom_camera * turn;
    const auto frame = builder.build({std::llround(1e9 * (1.0 + time_s)), T_odom_camera});
    detector.detect(*frame, testing::observe(desk, *frame, camera_at(time_s), 0, random));
  }
  const std::vector<LocalMap> submaps = detector.submaps();
  ASSERT_GE(submaps.size(), 2U);
  EXPECT_EQ(submaps.front().missed.translation_m, 0.0);
  const SE3 missed = camera_at(kStands_s).inverse() * camera_at(kGoesOn_s);
  EXPECT_NEAR(submaps.back().missed.translation_m, missed.t.norm(), 0.3 * missed.t.norm());
  EXPECT_NEAR(submaps.back().missed.rotation_rad, rotation_angle(missed.q, Quaternion::Identity()), 0.05);
}

// A burst of the odometry, soon afterwards, ends the window that tells of the stand; or there is none.
INSTANTIATE_TEST_SUITE_P(TurnsAt, LoopDetectorStand, ::testing::Values(1e9, 11.0, 13.0));

TEST(LoopDetector, TwoIdenticalGroupsAreAmbiguous) {
  // The first visit sees two equal groups side by side, the second visit one of them.
  RunSetup setup = drifted_revisit(4);
  const auto group = random_desk(4, 7, Vec3(-0.9, 0.0, 0.7));
  LoopDetector detector(LoopOptions(), testing::desk_classes());
  FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
  std::vector<testing::DeskObject> both = group;
  for (testing::DeskObject object : group) {
    object.spheroid.center += Vec3(1.8, 0.0, 0.0);
    both.push_back(object);
  }
  std::mt19937_64 random(1);
  int ambiguous = 0;
  for (std::int64_t k = 0; k < 420; ++k) {
    const double time_s = 0.1 * static_cast<double>(k);
    SE3 pose = testing::desk_pose(setup.visits, time_s);
    pose.t += pose.q * Vec3(0.0, 0.0, -1.2);
    const auto frame = builder.build({k * 100'000'000, pose});
    const auto associations = testing::observe(time_s < 20.0 ? both : group, *frame, pose, 0, random);
    for (const LoopClosure& loop : detector.detect(*frame, associations)) {
      EXPECT_FALSE(loop.accepted);
      ambiguous += loop.reason == LoopReason::kAmbiguous ? 1 : 0;
    }
  }
  EXPECT_GT(ambiguous, 0);
}

/// Visits desks one after the other, `visit_s` each with a steady walk of 6 s between; all desks are copies of one.
struct AlikeDesks {
  std::vector<Vec3> middles;
  std::vector<int> visits;  ///< index of the desk
  double visit_s = 12.0;

  RunOutcome run(std::uint64_t seed) const {
    std::vector<testing::DeskObject> objects;
    for (const Vec3& middle : middles) {
      const auto desk = random_desk(seed, 10, middle);
      objects.insert(objects.end(), desk.begin(), desk.end());
    }
    LoopDetector detector(LoopOptions(), testing::desk_classes());
    FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
    std::mt19937_64 random(seed);
    RunOutcome outcome;
    std::int64_t k = 0;
    for (std::size_t v = 0; v < visits.size(); ++v) {
      const Vec3 middle = middles[static_cast<std::size_t>(visits[v])];
      const Vec3 next = middles[static_cast<std::size_t>(visits[std::min(v + 1, visits.size() - 1)])];
      for (double time_s = 0.0; time_s < visit_s + 6.0; time_s += 0.1, ++k) {
        const double walked = std::max(0.0, (time_s - visit_s) / 6.0);
        const std::vector<testing::Visit> round{{0.0, visit_s, 0.0, 80.0}};
        const SE3 begin = testing::desk_pose(round, 0.0, next);
        SE3 pose = testing::desk_pose(round, std::min(time_s, visit_s), middle);
        pose.t += walked * (begin.t - pose.t);
        pose.q = pose.q.slerp(walked, begin.q);
        const auto frame = builder.build({k * 100'000'000, pose});
        const auto seen = testing::observe(objects, *frame, pose, 0, random);
        for (LoopClosure& loop : detector.detect(*frame, seen)) outcome.loops.push_back(std::move(loop));
        outcome.T_world_camera.push_back(pose);
      }
    }
    return outcome;
  }
};

/// No accepted loop may lead to another desk; a good part of the candidates is left open.
void expect_abstention(const RunOutcome& outcome) {
  int ambiguous = 0, wrong = 0;
  for (const LoopClosure& loop : outcome.loops) {
    ambiguous += loop.reason == LoopReason::kAmbiguous ? 1 : 0;
    wrong += loop.accepted && error_m(loop.T_match_query, outcome.truth(loop)) > 0.35 ? 1 : 0;
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GT(ambiguous, 0);
}

TEST(LoopDetector, AbstainsBetweenIdenticalDesksOfDifferentSubmaps) {
  const AlikeDesks desks{{Vec3(0.0, 0.0, 0.7), Vec3(5.0, 0.0, 0.7)}, {0, 1, 0}};
  expect_abstention(desks.run(1));
}

TEST(LoopDetector, AbstainsInAGridOfIdenticalDesks) {
  AlikeDesks desks;
  for (int i = 0; i < 9; ++i) desks.middles.emplace_back(3.0 * (i % 3), 3.0 * (i / 3), 0.7);
  desks.visit_s = 8.0;
  std::uint64_t seed = 5;
  for (const std::vector<int>& visits : {std::vector<int>{0, 8, 4}, {2, 6, 1}, {3, 5, 7}}) {
    desks.visits = visits;
    expect_abstention(desks.run(seed++));
  }
}

TEST(LoopDetector, PaperModeCorrectsADriftedRevisit) {
  for (const char* score : {"corrected", "printed"}) {
    LoopOptions options;
    options.mode = "paper";
    options.score = score;
    options.paper_min_gap_frames = 150;
    RunSetup setup = drifted_revisit(1);
    setup.same_ids = true;
    const RunOutcome outcome = run(options, setup);
    EXPECT_GE(outcome.accepted(), 3) << score;
    expect_right(outcome);
    for (const LoopClosure& loop : outcome.loops) {
      if (!loop.accepted) continue;
      EXPECT_GT(error_m(loop.T_match_query, outcome.odometry(loop)), 0.1) << "no innovation";
      EXPECT_GT(loop.labels, 1) << "of a desk with things of several classes";
    }
  }
}

/// The objects show a jump that the odometry does not announce, within three frames.
TEST(LoopDetector, NoWindowStraddlesAJumpOfTheOdometry) {
  constexpr std::int64_t kJump = 370;  // frame, in the middle of the second visit
  for (const char* mode : {"graph", "paper"}) {
    LoopOptions options;
    options.mode = mode;
    options.paper_min_gap_frames = 150;
    RunSetup setup = drifted_revisit(1);
    setup.same_ids = true;
    setup.drift = SE3(so3_exp(Vec3(0.0, 0.0, radians(8.0))), Vec3(0.1, 0.0, 0.0));
    setup.drift_from_s = 0.1 * kJump - 0.05;
    const RunOutcome outcome = run(options, setup);
    int before = 0, after = 0;
    for (const LoopClosure& loop : outcome.loops) {
      ++(loop.query_begin < kJump ? before : after);
      EXPECT_TRUE(loop.query_begin >= kJump || loop.query_end <= kJump + 3)
          << mode << ": " << loop.query_begin << " to " << loop.query_end;
    }
    EXPECT_GT(before, 0) << mode;
    EXPECT_GT(after, 0) << mode;
  }
}

TEST(LoopDetector, PaperModeNeedsSharedIdsGapAndScore) {
  LoopOptions options;
  options.mode = "paper";
  options.paper_min_gap_frames = 150;
  RunSetup setup = drifted_revisit(1);
  EXPECT_TRUE(run(options, setup).loops.empty()) << "no landmark is shared";
  setup.same_ids = true;
  options.paper_min_gap_frames = 1000;
  EXPECT_TRUE(run(options, setup).loops.empty()) << "too close in time";
  options.paper_min_gap_frames = 150;
  options.paper_corrected_min_score = 0.99;
  const RunOutcome outcome = run(options, setup);
  EXPECT_FALSE(outcome.loops.empty());
  for (const LoopClosure& loop : outcome.loops) EXPECT_EQ(loop.reason, LoopReason::kLowScore);
}

/// So many visits of 12 s to one side of a desk, half a minute apart.
RunSetup many_visits(int visits, int objects = 12) {
  RunSetup setup;
  setup.desk = random_desk(2, objects);
  for (int v = 0; v < visits; ++v) setup.visits.push_back({30.0 * v, 30.0 * v + 12.0, 0.0, 80.0});
  setup.end_s = setup.visits.back().end_s;
  return setup;
}

TEST(LoopDetector, SubmapsOfAKnownPlaceDoNotPileUp) {
  const auto submaps_after = [](int visits, bool enabled, int objects = 12) {
    LoopOptions options;
    options.enabled = enabled;
    std::size_t kept = 0;
    run(options, many_visits(visits, objects),
        [&kept](const LoopDetector& detector) { kept = detector.submaps().size(); });
    return kept;
  };
  const std::size_t few = submaps_after(3, true), many = submaps_after(12, true), more = submaps_after(24, true);
  EXPECT_GE(few, 5U);
  EXPECT_GT(many, few) << "several visits are kept";
  EXPECT_LE(more, many + 2) << "but not all";
  EXPECT_LE(submaps_after(24, false), many + 2) << "also while loops are not looked for";
  constexpr int kFewObjects = 5;  // than a loop by objects alone needs
  EXPECT_GE(submaps_after(3, true, kFewObjects), 5U);
  EXPECT_LE(submaps_after(24, true, kFewObjects), submaps_after(12, true, kFewObjects) + 2);
}

TEST(LoopDetector, AKnownPlaceIsRecognisedAtEveryVisit) {
  const RunOutcome outcome = run(LoopOptions(), many_visits(24));
  std::map<std::int64_t, int> accepted;  // by visit
  for (const LoopClosure& loop : outcome.loops) accepted[loop.query_stamp_ns / 30'000'000'000] += loop.accepted ? 1 : 0;
  for (int visit = 1; visit < 24; ++visit) EXPECT_GE(accepted[visit], 5) << visit;
  expect_right(outcome);
}

TEST(LoopDetector, CanBeSwitchedOff) {
  LoopOptions options;
  options.enabled = false;
  EXPECT_TRUE(run(options, drifted_revisit(1)).loops.empty());
}

TEST(LoopDetector, DegenerateScenesGiveNoLoopAndNoNan) {
  auto line = random_desk(1, 9), one_class = random_desk(1, 10), coincident = random_desk(1, 6);
  for (std::size_t i = 0; i < line.size(); ++i) {
    line[i].spheroid.center = Vec3(-0.8 + 0.2 * static_cast<double>(i), 0.0, 0.75);
  }
  for (auto& object : one_class) object.class_id = 3;
  for (auto& object : coincident) object.spheroid.center = Vec3(0.0, 0.0, 0.8);
  struct Scene {
    std::vector<testing::DeskObject> desk;
    std::optional<LoopReason> reason;  ///< of most candidates of graph mode; none: there are no candidates
  };
  const Scene scenes[] = {{{}, std::nullopt},
                          {random_desk(1, 2), std::nullopt},
                          {line, LoopReason::kDegenerate},
                          {one_class, LoopReason::kTooFewLabels},
                          {coincident, std::nullopt}};
  for (const char* mode : {"graph", "paper"}) {
    const bool is_graph = std::string(mode) == "graph";
    for (const Scene& scene : scenes) {
      LoopOptions options;
      options.mode = mode;
      options.paper_min_gap_frames = 150;
      RunSetup setup = drifted_revisit(1);
      setup.desk = scene.desk;
      setup.same_ids = true;
      const RunOutcome outcome = run(options, setup);
      std::map<LoopReason, int> reasons;
      for (const LoopClosure& loop : outcome.loops) {
        ASSERT_TRUE(loop.T_match_query.is_finite());
        ASSERT_TRUE(std::isfinite(loop.score));
        ++reasons[loop.reason];
        // Paper mode asks of the shared ids alone; what it accepts must be right all the same.
        EXPECT_TRUE(!loop.accepted || error_m(loop.T_match_query, outcome.truth(loop)) < 0.15) << mode;
      }
      if (!is_graph) continue;
      EXPECT_EQ(reasons[LoopReason::kAccepted], 0);
      EXPECT_EQ(outcome.loops.empty(), !scene.reason.has_value());
      const int of_the_reason = scene.reason ? reasons[*scene.reason] : 1;
      EXPECT_GT(2 * of_the_reason, static_cast<int>(outcome.loops.size()));
    }
  }
}

TEST(LoopDetector, BrokenBoxesAndPosesAreSurvived) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto spoil = [nan](std::int64_t k, Frame* frame, AssociationFrame* associations) {
    if (k % 20 == 0) frame->T_odom_camera.t.x() = nan;
    for (int i = 0; i < 6; ++i) {
      Association association;
      association.class_id = i;
      association.landmark_id = i;
      association.box = i % 2 == 0 ? Box{nan, 10, 20, 30} : Box{10.0 * i, 10, 10.0 * i - 5, 30};
      associations->associations.push_back(association);
    }
  };
  const RunSetup setup = drifted_revisit(2);
  const std::vector<LoopClosure> loops = two_visits(setup, setup.desk, spoil);
  EXPECT_GE(accepted(loops), 5) << "what is not broken is recognised";
  for (const LoopClosure& loop : loops) {
    EXPECT_TRUE(loop.T_match_query.is_finite());
    EXPECT_TRUE(loop.covariance.allFinite());
  }
}

TEST(LoopOptions, NamesTheBadParameter) {
  EXPECT_TRUE(validate(LoopOptions())) << validate(LoopOptions()).message();
  for (const auto& [key, value] : std::map<std::string, std::string>{{"loop.mode", "fast"},
                                                                     {"loop.score", "best"},
                                                                     {"loop.scale", "some"},
                                                                     {"loop.min_gap_s", "-1"},
                                                                     {"loop.min_seen_share", "1.5"},
                                                                     {"loop.min_inliers", "2"},
                                                                     {"loop.ambiguity_ratio", "0.5"}}) {
    const auto options = make_options<LoopOptions>({{key, value}});
    EXPECT_FALSE(options);
    EXPECT_NE(options.message().find("'" + key + "' = '" + value + "'"), std::string::npos) << options.message();
  }
}

RunSetup revisit() {
  RunSetup setup;
  setup.desk = random_desk(1, 12);
  setup.visits = {{0.0, 12.0, 0.0, 80.0}, {30.0, 42.0, 60.0, -20.0}};
  setup.end_s = 42.0;
  return setup;
}

TEST(LoopExplanation, TellsWhatRefusedALoopOfPaperMode) {
  LoopFigures loop;
  loop.reason = LoopReason::kRefinement;
  loop.inliers = 4;
  loop.score = 0.3;
  loop.sigma_m = 0.25;
  LoopOptions options;
  options.mode = "paper";
  options.max_sigma_m = 0.05;
  EXPECT_EQ(describe(loop, options).substr(0, 40), "rejected: refinement, common landmarks 4");
  EXPECT_NE(describe(loop, options).find("sigma m 0.25 (<= 0.15)"), std::string::npos) << describe(loop, options);
}

TEST(LoopExplanation, TellsTheRecordOfEveryCandidate) {
  std::map<std::pair<std::int64_t, std::int64_t>, LoopExplanation> answers;
  const LoopOptions options;
  testing::RunOutcome outcome = run(options, revisit());
  run(options, revisit(), [&](const LoopDetector& detector) {
    for (const LoopClosure& loop : outcome.loops) {
      answers[{loop.query_keyframe_id, loop.match_keyframe_id}] =
          detector.explain(loop.query_keyframe_id, loop.match_keyframe_id);
    }
  });
  ASSERT_FALSE(answers.empty());
  int accepted = 0;
  for (const LoopClosure& loop : outcome.loops) {
    const LoopExplanation& answer = answers.at({loop.query_keyframe_id, loop.match_keyframe_id});
    EXPECT_EQ(answer.status, PairStatus::kVerified);
    ASSERT_TRUE(answer.closure.has_value());
    if (!loop.accepted) continue;
    ++accepted;
    EXPECT_TRUE(answer.closure->accepted) << "an accepted loop is not hidden by a later candidate of the same pair";
    EXPECT_GE(answer.closure->inliers, options.min_inliers);
    EXPECT_GT(answer.closure->sigma_m, 0.0);
    EXPECT_LE(answer.closure->sigma_m, options.max_sigma_m);
    EXPECT_NE(answer.text.find("accepted"), std::string::npos) << answer.text;
    EXPECT_NE(answer.text.find("sigma deg"), std::string::npos) << answer.text;
  }
  EXPECT_GT(accepted, 0);
}

TEST(LoopExplanation, SaysWhyAPairWasNotCompared) {
  run(LoopOptions(), revisit(), [](const LoopDetector& detector) {
    const auto status = [&detector](std::int64_t query, std::int64_t match) {
      const LoopExplanation answer = detector.explain(query, match);
      EXPECT_FALSE(answer.text.empty());
      return answer.status;
    };
    EXPECT_EQ(status(100000, 2), PairStatus::kUnknownKeyframe);
    EXPECT_EQ(status(3, -1), PairStatus::kUnknownKeyframe);
    EXPECT_EQ(status(2, 2), PairStatus::kWrongOrder);
    EXPECT_EQ(status(2, 5), PairStatus::kWrongOrder);
    const std::vector<LocalMap> submaps = detector.submaps();
    ASSERT_GE(submaps.size(), 3u);
    const LoopExplanation recent = detector.explain(submaps[1].keyframe_id, submaps[0].keyframe_id);
    EXPECT_EQ(recent.status, PairStatus::kTooRecent);
    ASSERT_TRUE(recent.closure.has_value()) << "it is compared for the answer all the same";
    EXPECT_GE(recent.closure->inliers, 6);
    EXPECT_NE(recent.text.find("compared now"), std::string::npos) << recent.text;
  });
}

TEST(LoopExplanation, AskingChangesNothing) {
  RunSetup asking = revisit();
  int asked = 0;
  asking.at_every_frame = [&asked](const LoopDetector& detector) {
    const std::vector<LocalMap> submaps = detector.submaps();
    if (submaps.size() < 2) return;
    const std::int64_t query = submaps.back().keyframe_id, match = submaps.front().keyframe_id;
    const LoopExplanation once = detector.explain(query, match), again = detector.explain(query, match);
    EXPECT_EQ(once.status, again.status);
    EXPECT_EQ(once.text, again.text);
    ++asked;
  };
  const auto first = run(LoopOptions(), revisit()), second = run(LoopOptions(), asking);
  EXPECT_GT(asked, 100);
  EXPECT_GT(first.accepted(), 0);
  ASSERT_EQ(first.loops.size(), second.loops.size());
  for (std::size_t i = 0; i < first.loops.size(); ++i) {
    EXPECT_EQ(first.loops[i].match_frame, second.loops[i].match_frame);
    EXPECT_EQ(first.loops[i].reason, second.loops[i].reason);
    EXPECT_EQ(first.loops[i].T_match_query.t, second.loops[i].T_match_query.t);
  }
}

TEST(LoopExplanation, TheClockOfAnEarlierSessionSaysNothing) {
  RunSetup setup = revisit();
  setup.end_s = 12.0;
  std::vector<LocalMap> submaps;
  run(LoopOptions(), setup, [&submaps](const LoopDetector& detector) { submaps = detector.submaps(); });
  ASSERT_GE(submaps.size(), 2U);
  std::vector<KeyframePose> keyframes;
  for (LocalMap& submap : submaps) {
    for (std::int64_t* id : {&submap.keyframe_id, &submap.frame_id, &submap.begin_frame, &submap.end_frame}) {
      *id -= 10'000;
    }
    keyframes.push_back({submap.keyframe_id, submap.frame_id, submap.stamp_ns, submap.T_odom_anchor});
  }
  LoopOptions options;
  options.enabled = false;
  setup.restored = {submaps, keyframes};
  run(options, setup, [&submaps](const LoopDetector& detector) {
    const std::int64_t match = submaps.front().keyframe_id;
    const LoopExplanation across = detector.explain(detector.submaps().back().keyframe_id, match);
    EXPECT_EQ(across.status, PairStatus::kNotAttempted) << across.text;
    EXPECT_NE(across.text.find("of two sessions"), std::string::npos) << across.text;
    const LoopExplanation within = detector.explain(submaps.back().keyframe_id, match);
    EXPECT_EQ(within.status, PairStatus::kTooRecent) << within.text;
  });
}

TEST(LoopExplanation, LoopClosingOffIsSaid) {
  LoopOptions options;
  options.enabled = false;
  run(options, revisit(), [](const LoopDetector& detector) {
    const std::vector<LocalMap> submaps = detector.submaps();
    const LoopExplanation answer = detector.explain(submaps.back().keyframe_id, submaps.front().keyframe_id);
    EXPECT_EQ(answer.status, PairStatus::kNotAttempted);
    EXPECT_TRUE(answer.closure && answer.closure->accepted) << answer.text;
  });
}

TEST(LoopExplanation, ABreakLeavesKeyframesWithoutASubmap) {
  RunSetup setup = revisit();
  setup.drift_is_break = true;
  setup.drift_from_s = 40.0;
  run(LoopOptions(), setup, [](const LoopDetector& detector) {
    std::int64_t last = 0;
    while (detector.explain(last + 1, 0).status != PairStatus::kUnknownKeyframe) ++last;
    EXPECT_EQ(detector.explain(last, 1).status, PairStatus::kNoSubmap);
  });
}

TEST(LoopExplanation, PaperModeToo) {
  LoopOptions options;
  options.mode = "paper";
  options.paper_min_gap_frames = 150;
  RunSetup setup = revisit();
  setup.same_ids = true;
  std::vector<LoopClosure> loops = run(options, setup).loops;
  ASSERT_FALSE(loops.empty());
  run(options, setup, [&loops](const LoopDetector& detector) {
    const LoopClosure& loop = loops.back();
    EXPECT_EQ(detector.explain(loop.query_keyframe_id, loop.match_keyframe_id).status, PairStatus::kVerified);
    EXPECT_EQ(detector.explain(2, 1).status, PairStatus::kNotAttempted);
  });
}

TEST(PairRecord, ForgetsTheEarliestQueries) {
  PairRecord record(4);
  for (std::int64_t query = 10; query < 14; ++query) {
    LoopClosure loop;
    loop.query_keyframe_id = query;
    loop.match_keyframe_id = 1;
    LoopClosure other = loop;
    other.match_keyframe_id = 2;
    record.add({loop, other});
  }
  EXPECT_EQ(record.find(10, 1), nullptr);
  EXPECT_EQ(record.find(11, 2), nullptr);
  EXPECT_NE(record.find(12, 1), nullptr);
  EXPECT_NE(record.find(13, 2), nullptr);
  EXPECT_EQ(record.find(13, 3), nullptr);
}

TEST(PairRecord, TellsWhatWasRefusedAndWhatIsNoMore) {
  PairRecord record(4);
  const auto decide = [&record](std::int64_t query, std::int64_t match, bool accepted) {
    LoopClosure loop;
    loop.query_keyframe_id = query;
    loop.match_keyframe_id = match;
    loop.accepted = accepted;
    record.add({loop});
  };
  const auto told = [&record](bool whole) {
    SubmapDelta delta;
    delta.is_whole = whole;
    record.take_delta(&delta);
    std::string text = std::to_string(delta.first_query) + ":";
    for (const LoopFigures& loop : delta.decided) {
      text += " " + std::to_string(loop.query_keyframe_id) + "-" + std::to_string(loop.match_keyframe_id);
      if (loop.accepted) text += "+";
    }
    return text;
  };
  EXPECT_EQ(told(true), "-1:");
  decide(10, 2, false);
  decide(10, 1, false);
  decide(10, 3, true);
  EXPECT_EQ(told(false), "10: 10-1 10-2") << "those that were accepted at once are the graph's to tell";
  EXPECT_EQ(told(false), "10:");
  decide(10, 2, true);
  decide(11, 1, false);
  EXPECT_EQ(told(false), "10: 10-2+ 11-1");
  decide(10, 2, false);
  EXPECT_EQ(told(false), "10:") << "once accepted is accepted";
  EXPECT_EQ(told(true), "10: 10-1 11-1");
  decide(10, 5, false);
  EXPECT_EQ(told(false), "11:") << "the earliest query is forgotten with all that it was compared with";
  LoopClosure loop;
  loop.query_keyframe_id = 12;
  loop.rms_m = std::nan("");
  record.add({loop});
  loop.rms_m = 0.0;
  loop.T_match_query.q.coeffs().setZero();
  record.add({loop});
  EXPECT_EQ(told(false), "11:") << "no figures";
}

}  // namespace
}  // namespace semantic_topo_loop::core
