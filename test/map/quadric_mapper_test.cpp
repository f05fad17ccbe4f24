#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "map/landmark_fitter.h"
#include "map/mapper_state.h"
#include "map/merging.h"
#include "map/motion_blur.h"
#include "map/quadric_fit.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "semantic_topo_loop/types/transform.h"
#include "support/look_at.h"
#include "support/mapper_fixture.h"
#include "support/two_rounds.h"

namespace semantic_topo_loop::core {
namespace {

using testing::look_at;

const Camera& kCamera = testing::kMapperCamera;

/// n cameras on an arc around the origin, 1.5 m away and 0.8 m up.
std::vector<SE3> arc(int n, double span_deg) {
  std::vector<SE3> poses;
  for (int i = 0; i < n; ++i) {
    const double angle = radians(span_deg) * i / (n - 1);
    poses.push_back(look_at(Vec3(1.5 * std::cos(angle), 1.5 * std::sin(angle), 0.8), Vec3::Zero()));
  }
  return poses;
}

std::vector<BoxView> views_of(const Ellipsoid& ellipsoid, const std::vector<SE3>& poses, double noise_px = 0.0) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::vector<BoxView> views;
  for (const SE3& pose : poses) {
    Box box = *project_box(ellipsoid, projection_matrix(kCamera, pose));
    for (double* edge : {&box.x1, &box.y1, &box.x2, &box.y2}) *edge += noise_px * noise(random);
    views.push_back({pose, box, 0, 0.0});
  }
  return views;
}

const Ellipsoid kCup{SE3(so3_exp(Vec3(0.0, 0.0, 0.4)), Vec3(0.05, -0.1, 0.02)), Vec3(0.05, 0.04, 0.08)};

TEST(QuadricFit, BoxJacobianEqualsNumericDerivative) {
  const Mat34 P = projection_matrix(kCamera, arc(5, 90.0)[1]);
  const Ellipsoid ellipsoid{SE3(so3_exp(Vec3(0.3, -0.2, 0.5)), Vec3(0.1, 0.0, 0.05)), Vec3(0.1, 0.05, 0.2)};
  BoxJacobian J;
  ASSERT_TRUE(project_box(ellipsoid, P, &J));
  constexpr double kStep = 1e-6;
  for (int k = 0; k < 3; ++k) {
    const Vec3 d = kStep * Vec3::Unit(k);
    const auto derivative = [&](const Ellipsoid& plus, const Ellipsoid& minus) {
      return Vec4((project_box(plus, P)->edges() - project_box(minus, P)->edges()) / (2.0 * kStep));
    };
    Ellipsoid plus = ellipsoid, minus = ellipsoid;
    plus.T_world_quadric.t += d;
    minus.T_world_quadric.t -= d;
    EXPECT_LT((derivative(plus, minus) - J.center.col(k)).norm(), 1e-3);
    plus = minus = ellipsoid;
    plus.T_world_quadric.q = so3_exp(d) * ellipsoid.T_world_quadric.q;
    minus.T_world_quadric.q = so3_exp(-d) * ellipsoid.T_world_quadric.q;
    EXPECT_LT((derivative(plus, minus) - J.rotation.col(k)).norm(), 1e-3);
    plus = minus = ellipsoid;
    plus.semi_axes(k) *= std::exp(kStep);
    minus.semi_axes(k) *= std::exp(-kStep);
    EXPECT_LT((derivative(plus, minus) - J.log_axes.col(k)).norm(), 1e-3);
  }
}

TEST(QuadricFit, RecoversAnEllipsoidFromExactBoxes) {
  const std::vector<BoxView> views = views_of(kCup, arc(20, 150.0));
  const std::optional<Ellipsoid> sphere = initialise_sphere(kCamera, views);
  ASSERT_TRUE(sphere);
  EXPECT_LT((sphere->center() - kCup.center()).norm(), 0.02);
  QuadricFitOptions options;
  options.max_iterations = 50;
  options.roundness_weight = 1e-6;
  const std::optional<QuadricFit> fit = refine_quadric(kCamera, views, *sphere, options);
  ASSERT_TRUE(fit);
  EXPECT_LT((fit->ellipsoid.center() - kCup.center()).norm(), 0.003);
  EXPECT_GT(fit->mean_iou, 0.97);
  EXPECT_LT((fit->ellipsoid.shape() - kCup.shape()).norm(), 0.3 * kCup.shape().norm());
}

TEST(QuadricFit, CovarianceCoversTheErrorAndShrinksWithViews) {
  const auto covariance = [](int n) {
    const std::vector<BoxView> views = views_of(kCup, arc(n, 60.0), 2.0);
    const std::optional<QuadricFit> fit = refine_quadric(kCamera, views, *initialise_sphere(kCamera, views));
    EXPECT_TRUE(fit);
    EXPECT_LT((fit->ellipsoid.center() - kCup.center()).norm(), 5.0 * std::sqrt(fit->center_covariance.trace()));
    return fit->center_covariance.trace();
  };
  EXPECT_LT(covariance(40), 0.6 * covariance(10));
}

TEST(QuadricFit, LeavesOutSidesCutByTheBorder) {
  std::vector<BoxView> views = views_of(kCup, arc(20, 120.0));
  for (std::size_t i = 0; i < views.size(); i += 2) {
    views[i].box.x1 += 30.0;  // what a border does to the left side
    views[i].truncated = kLeft;
  }
  const std::optional<QuadricFit> fit = refine_quadric(kCamera, views, kCup);
  ASSERT_TRUE(fit);
  EXPECT_LT((fit->ellipsoid.center() - kCup.center()).norm(), 0.005);
}

/// A chair seen from so near that no image shows it whole: only left, right and top sides bound it.
TEST(QuadricInitialisation, BoxesThatTheBorderCutsStillGiveTheSphere) {
  const Ellipsoid chair{SE3(Quaternion::Identity(), Vec3(0.1, 0.0, 0.0)), Vec3::Constant(0.4)};
  std::vector<BoxView> views = views_of(chair, arc(30, 60.0));
  for (std::size_t i = 0; i < views.size(); ++i) {
    views[i].box.y2 -= 80.0;
    views[i].truncated = kBottom;
    if (i % 3 != 0) continue;
    views[i].box.x1 += 50.0;
    views[i].truncated |= kLeft;
  }
  const std::optional<Ellipsoid> sphere = initialise_sphere(kCamera, views);
  ASSERT_TRUE(sphere);
  EXPECT_LT((sphere->center() - chair.center()).norm(), 0.03);
  EXPECT_NEAR(sphere->semi_axes.x(), 0.4, 0.03);
}

TEST(QuadricFit, RefusesDegenerateInput) {
  const std::vector<BoxView> still(5, views_of(kCup, {arc(5, 90.0)[0]})[0]);
  EXPECT_FALSE(initialise_sphere(kCamera, still));
  EXPECT_FALSE(initialise_sphere(kCamera, {}));
  EXPECT_FALSE(refine_quadric(kCamera, {}, kCup));
  Ellipsoid broken = kCup;
  broken.T_world_quadric.t.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(refine_quadric(kCamera, still, broken));
}

/// Objects seen from an arc.
class MapperTest : public testing::MapperFixture {
 protected:
  MapperTest()
      : MapperFixture({{41, "cup", ClassRole::kMovable, "vessel", 0.1},
                       {75, "vase", ClassRole::kMovable, "vessel", 0.2},
                       {73, "book", ClassRole::kMovable, "", 0.2},
                       {62, "tv", ClassRole::kStatic, "", 0.2}}) {}

  MapUpdate end() {
    Frame frame;
    frame.frame_id = next_frame_;
    frame.is_end = true;
    mapper_.integrate(frame, {});
    MapCorrection correction;
    correction.frame_id = frame.frame_id;
    return mapper_.apply(correction);
  }

  /// A correction that moves keyframes, each the fifth of so many poses.
  /// @param poses laps of which were stepped through   @param last the newest keyframe that was solved for
  MapCorrection moved(std::int64_t first, std::int64_t last, const std::vector<SE3>& poses,
                      const SE3& T_new_old) const {
    MapCorrection correction;
    correction.frame_id = next_frame_;
    correction.changed = true;
    correction.valid_to_keyframe_id = last;
    for (std::int64_t id = first; id <= last; ++id) {
      correction.keyframes.push_back(
          {id, id * 5, 0, T_new_old * poses[static_cast<std::size_t>(id) * 5 % poses.size()]});
    }
    return correction;
  }
};

TEST_F(MapperTest, CandidateBecomesConfirmedWithViewsAndParallax) {
  const std::vector<SE3> poses = arc(60, 90.0);
  step(poses[0], {{0, 41, kCup}});
  ASSERT_NE(find(0), nullptr);
  EXPECT_EQ(find(0)->state, LandmarkState::kCandidate);
  EXPECT_FALSE(find(0)->ellipsoid);
  for (std::size_t i = 1; i < poses.size(); ++i) step(poses[i], {{0, 41, kCup}});
  ASSERT_TRUE(find(0)->ellipsoid);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_LT((find(0)->ellipsoid->center() - kCup.center()).norm(), 0.01);
  EXPECT_GT(find(0)->quality, 0.5);
  EXPECT_LE(find(0)->quality, 1.0);
}

TEST_F(MapperTest, ChangedOptionsJudgeWhatIsOutOfViewToo) {
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  QuadricMapperOptions options;
  options.confirm_seen_s = 60.0;
  mapper_.set_options(options);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "not before the next frame";
  const SE3 away(Quaternion::Identity(), Vec3(100.0, 0.0, 0.0));
  mapper_.set_fixed(true);
  EXPECT_TRUE(pass(away).changed.empty()) << "a map that is fixed stays as it is";
  mapper_.set_fixed(false);
  const MapUpdate update = pass(away);
  ASSERT_EQ(update.changed.size(), 1U);
  EXPECT_EQ(update.changed[0].state, LandmarkState::kCandidate);
  EXPECT_GT(update.map_version, update.base_version);
  EXPECT_TRUE(pass(away).changed.empty());
}

TEST_F(MapperTest, AFixedMapIsNotFittedAnew) {
  for (const SE3& pose : arc(57, 90.0)) step(pose, {{0, 41, kCup}});
  mapper_.set_fixed(true);
  const Ellipsoid before = *find(0)->ellipsoid;
  MapCorrection correction;  // that moves nothing
  correction.frame_id = next_frame_ - 1;
  correction.changed = true;
  correction.valid_to_keyframe_id = keyframe_id_;
  correction.keyframes = keyframes_;
  mapper_.apply(correction);
  pass(arc(2, 90.0)[0]);
  EXPECT_LT((find(0)->ellipsoid->shape() - before.shape()).norm(), 1e-12);
  end();
  EXPECT_LT((find(0)->ellipsoid->shape() - before.shape()).norm(), 1e-12);
  EXPECT_LT((find(0)->ellipsoid->center() - before.center()).norm(), 1e-12);
}

TEST_F(MapperTest, ChangedOptionsFit) {
  QuadricMapperOptions options;
  options.min_fit_iou = 1.0;
  mapper_.set_options(options);
  const std::vector<SE3> poses = arc(120, 120.0);
  for (std::size_t i = 0; i < 60; ++i) step(poses[i], {{0, 41, kCup}});
  EXPECT_FALSE(find(0)->ellipsoid);
  mapper_.set_options({});
  for (std::size_t i = 60; i < 120; ++i) step(poses[i], {{0, 41, kCup}});
  EXPECT_TRUE(find(0)->ellipsoid);
}

TEST_F(MapperTest, ASlowDetectorConfirmsAsSoonAsAFastOne) {
  for (const bool is_slow : {false, true}) {
    SCOPED_TRACE(is_slow);
    const std::int64_t id = is_slow ? 1 : 0;
    Ellipsoid cup = kCup;
    cup.T_world_quadric.t.x() += static_cast<double>(id);
    std::optional<std::size_t> confirmed_at;
    const std::vector<SE3> poses = arc(90, 90.0);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const SE3 pose(poses[i].q, poses[i].t + Vec3(static_cast<double>(id), 0.0, 0.0));
      if (is_slow && i % 3 != 0) {
        pass(pose);
      } else {
        step(pose, {{id, 41, cup}});
      }
      if (!confirmed_at && find(id) != nullptr && find(id)->state == LandmarkState::kConfirmed) confirmed_at = i;
    }
    ASSERT_TRUE(confirmed_at);
    EXPECT_LT(*confirmed_at, 60U);
  }
}

TEST_F(MapperTest, AParkedCameraLeavesTheViewsFromElsewhere) {
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  makes_keyframes_ = false;  // as of a camera that stands still
  for (int i = 0; i < 5000; ++i) step(poses.back(), {{0, 41, kCup}});
  end();
  const std::vector<Observation> boxes = mapper_.state().landmarks.at(0).observations;
  EXPECT_LE(boxes.size(), 1200U);
  const auto before = [](const Observation& box) { return box.frame_id < 55; };
  EXPECT_EQ(std::count_if(boxes.begin(), boxes.end(), before), 55) << "all that hang on keyframes of their own";
  EXPECT_GT(find(0)->baseline_deg, 50.0);
}

TEST_F(MapperTest, WhatNobodyLookedForIsNotMissed) {
  const std::vector<SE3> poses = arc(120, 120.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  const double quality = find(0)->quality;
  for (int i = 0; i < 900; ++i) EXPECT_TRUE(pass(poses[static_cast<std::size_t>(i % 120)]).changed.empty());
  end();
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_GE(find(0)->quality, quality);
}

/// In real time a keyframe may be dropped: the boxes of its frames have nothing to hang on.
TEST_F(MapperTest, WhatIsSeenAfterALostKeyframeIsNotMissed) {
  const std::vector<SE3> poses = arc(120, 120.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  const int observations = find(0)->observations;
  makes_keyframes_ = false;
  keyframe_id_ = 1000;  // of which the mapper never heard
  for (std::size_t i = 0; i < 900; ++i) EXPECT_TRUE(step(poses[i % 120], {{0, 41, kCup}}).changed.empty());
  EXPECT_EQ(find(0)->observations, observations);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, ObjectWithoutParallaxStaysACandidate) {
  for (int i = 0; i < 60; ++i) step(arc(60, 1.0)[static_cast<std::size_t>(i)], {{0, 41, kCup}});
  EXPECT_EQ(find(0)->state, LandmarkState::kCandidate);
  EXPECT_FALSE(find(0)->ellipsoid);
}

TEST_F(MapperTest, DuplicatesOfOneObjectMerge) {
  const std::vector<SE3> poses = arc(120, 120.0);
  std::vector<LandmarkMerge> merges;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const MapUpdate update = step(poses[i], {{i < 60 ? 0 : 1, 41, kCup}});
    merges.insert(merges.end(), update.merged.begin(), update.merged.end());
  }
  const MapUpdate last = end();
  merges.insert(merges.end(), last.merged.begin(), last.merged.end());
  ASSERT_EQ(merges.size(), 1U);
  ASSERT_NE(find(merges[0].survivor_id), nullptr);
  EXPECT_EQ(find(merges[0].merged_id), nullptr);
  EXPECT_EQ(find(merges[0].survivor_id)->observations, 120);
}

TEST_F(MapperTest, ASmallThingThatStoodBesideALargeOneIsNoPartOfIt) {
  Ellipsoid large = kCup;
  large.semi_axes *= 3.0;
  const std::vector<SE3> poses = arc(300, 120.0);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    std::vector<Seen> seen{{0, 73, large}};
    if (i < 80) seen.push_back({1, 73, kCup});  // a fourth of the time, each with a box of its own
    step(poses[i], seen);
  }
  end();
  EXPECT_NE(find(0), nullptr);
  EXPECT_NE(find(1), nullptr);
}

/// A list of changes is to say that it is gone.
TEST_F(MapperTest, WhatWasAnObjectInTheSessionBeforeIsNoPartOfWhatTookItsPlace) {
  Ellipsoid large = kCup;
  large.semi_axes *= 3.0;
  large.T_world_quadric.t += Vec3(-0.06, 0.0, -0.1);
  const std::vector<SE3> poses = arc(300, 120.0);
  for (std::size_t i = 0; i < 60; ++i) step(poses[i], {{1, 73, kCup}});
  ASSERT_EQ(find(1)->state, LandmarkState::kConfirmed);
  begin_session();
  for (std::size_t i = 60; i < poses.size(); ++i) step(poses[i], {{0, 73, large}});
  end();
  EXPECT_NE(find(0), nullptr);
  EXPECT_NE(find(1), nullptr);
}

TEST_F(MapperTest, AConfirmedThingIsNoPartOfWhatIsNone) {
  Ellipsoid large = kCup;
  large.semi_axes *= 3.0;
  const std::vector<SE3> poses = arc(300, 120.0);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    step(poses[i], {i < 240 ? Seen{0, 73, large, kBottom} : Seen{1, 73, kCup}});
  }
  ASSERT_EQ(find(0)->state, LandmarkState::kCandidate) << "the border always cuts it";
  ASSERT_EQ(find(1)->state, LandmarkState::kConfirmed);
  end();
  EXPECT_NE(find(1), nullptr);
}

TEST_F(MapperTest, WhatNoImageShowsWholeIsNotConfirmed) {
  const std::vector<SE3> poses = arc(60, 90.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, 0.3, 0.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup, kBottom}, {1, 73, book}});
  EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
  ASSERT_TRUE(find(0)->ellipsoid) << "three sides bound it";
  EXPECT_GT(find(0)->quality, QuadricMapperOptions().confirm_quality);
  EXPECT_EQ(find(0)->state, LandmarkState::kCandidate);
}

TEST_F(MapperTest, WhatIsCutOnOneSideThenOnAnotherIsConfirmedUnlessItMayBeAPieceOfAnother) {
  const std::vector<SE3> poses = arc(60, 90.0);
  Ellipsoid apart = kCup, near = kCup;
  apart.T_world_quadric.t += Vec3(0.3, 0.3, 0.0);
  near.T_world_quadric.t += Vec3(0.0, 0.0, 1.5 * kCup.radius());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const std::uint8_t cut = i < 30 ? kBottom : kLeft;
    step(poses[i], {{0, 41, kCup}, {1, 41, near, cut}, {2, 41, apart, cut}});
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_EQ(find(1)->state, LandmarkState::kCandidate);
  EXPECT_EQ(find(2)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, UnrelatedClassesAtOnePlaceDoNotMerge) {
  const std::vector<SE3> poses = arc(120, 120.0);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    step(poses[i], {i % 2 == 0 ? Seen{0, 41, kCup} : Seen{1, 73, kCup}});
  }
  EXPECT_TRUE(end().merged.empty());
  ASSERT_NE(find(0), nullptr);
  ASSERT_NE(find(1), nullptr);
  EXPECT_LT((find(0)->ellipsoid->center() - find(1)->ellipsoid->center()).norm(), 0.01);
}

/// Many objects, each mapped three times: what is looked for beside a landmark is all that can be the same as it.
TEST_F(MapperTest, DuplicatesAreFoundAmongManyObjects) {
  constexpr int kObjects = 24;
  const std::vector<SE3> poses = arc(60, 90.0);
  for (int round = 0; round < 3; ++round) {
    for (const SE3& pose : poses) {
      std::vector<Seen> seen;
      for (int i = 0; i < kObjects; ++i) {
        Ellipsoid object = kCup;
        object.T_world_quadric.t += Vec3(0.14 * (i % 5 - 2), 0.14 * (i / 5 - 2), 0.0);
        if (i % 3 == round) object.semi_axes *= 1.2;
        seen.push_back({kObjects * round + i, 41, object});
      }
      step(pose, seen);
    }
  }
  end();
  EXPECT_EQ(mapper_.landmarks().size(), static_cast<std::size_t>(kObjects));
  for (const Landmark& landmark : mapper_.landmarks()) EXPECT_EQ(landmark.observations, 3 * 60) << landmark.id;
}

TEST_F(MapperTest, ObjectsSeenSideBySideDoNotMerge) {
  Ellipsoid neighbour = kCup;
  neighbour.T_world_quadric.t += Vec3(0.0, 0.11, 0.0);
  for (const SE3& pose : arc(120, 120.0)) step(pose, {{0, 41, kCup}, {1, 41, neighbour}});
  end();
  EXPECT_NE(find(0), nullptr);
  EXPECT_NE(find(1), nullptr);
}

TEST_F(MapperTest, ABoxGivenToANeighbourMeanwhileVetoesNoMerge) {
  Ellipsoid neighbour = kCup;
  neighbour.T_world_quadric.t += Vec3(0.0, 0.16, 0.0);
  for (const SE3& pose : arc(120, 120.0)) step(pose, {{0, 41, kCup}});
  // As while the odometry was wrong.
  for (const SE3& pose : arc(40, 60.0)) step(pose, {{0, 41, neighbour}, {1, 41, kCup}});
  end();
  ASSERT_NE(find(0), nullptr);
  EXPECT_EQ(find(1), nullptr);
  EXPECT_LT((find(0)->ellipsoid->center() - kCup.center()).norm(), 0.02);
}

TEST_F(MapperTest, WhatWasSeenBesideOneThatWasMergedDoesNotMergeEither) {
  QuadricMapperOptions options;
  options.maintenance_interval_s = 1e6;  // duplicates are looked for at the end only
  mapper_ = QuadricMapper(options, classes_);
  Ellipsoid neighbour = kCup;
  neighbour.T_world_quadric.t += Vec3(0.0, 0.0, 0.08);
  for (const SE3& pose : arc(100, 120.0)) step(pose, {{0, 41, kCup}});
  for (const SE3& pose : arc(95, 120.0)) step(pose, {{0, 41, kCup}, {1, 41, neighbour}});
  for (const SE3& pose : arc(30, 120.0)) step(pose, {{0, 41, kCup}, {2, 41, neighbour}});
  for (const SE3& pose : arc(70, 120.0)) step(pose, {{2, 41, neighbour}});
  const MapUpdate update = end();
  ASSERT_EQ(update.merged.size(), 1U);
  EXPECT_EQ(update.merged[0].survivor_id, 2);
  EXPECT_EQ(update.merged[0].merged_id, 1);
}

TEST_F(MapperTest, WhileNobodyLooksNoCandidateGrowsOlder) {
  Ellipsoid far = kCup;
  far.T_world_quadric.t += Vec3(3.0, 3.0, 0.0);
  for (const SE3& pose : arc(15, 1.0)) step(pose, {{0, 41, kCup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kCandidate);
  clock_ns_ += 400'000'000'000;
  step(arc(15, 1.0).back(), {{1, 62, far}});
  EXPECT_NE(find(0), nullptr) << "after a pause";
}

TEST_F(MapperTest, StaleCandidateIsGivenUp) {
  step(arc(2, 1.0)[0], {{0, 41, kCup}});
  std::vector<std::int64_t> removed;
  for (const SE3& pose : arc(120, 120.0)) {
    const MapUpdate update = step(pose, {{1, 73, kCup}});
    removed.insert(removed.end(), update.removed.begin(), update.removed.end());
  }
  EXPECT_EQ(removed, std::vector<std::int64_t>{0});
}

TEST_F(MapperTest, BetweenTwoSessionsACandidateGrowsNoOlderWhateverTheClock) {
  QuadricMapperOptions options;
  options.forget_candidate_s = 2.0;
  std::vector<int> frames_kept;
  for (const std::int64_t pause_s : {0, 86'400, -86'400}) {
    mapper_ = QuadricMapper(options, classes_);
    keyframes_.clear();
    next_frame_ = 0;
    step(arc(2, 1.0)[0], {{0, 41, kCup}});
    begin_session(options);
    next_frame_ = 5;
    clock_ns_ += pause_s * 1'000'000'000;
    int kept = 0;
    for (const SE3& pose : arc(120, 120.0)) {
      const MapUpdate update = step(pose, {{1, 73, kCup}});
      if (!update.removed.empty()) break;
      ++kept;
    }
    frames_kept.push_back(kept);
  }
  EXPECT_EQ(frames_kept[1], frames_kept[0]);
  EXPECT_EQ(frames_kept[2], frames_kept[0]);
  EXPECT_GE(frames_kept[0], 60) << "2 s of looking";
  EXPECT_LT(frames_kept[0], 120);
}

TEST_F(MapperTest, ADetectorThatLooksEveryThreeSecondsLeavesAMap) {
  const std::vector<SE3> poses = arc(1800, 120.0);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const MapUpdate update = i % 90 == 0 ? step(poses[i], {{0, 41, kCup}}) : pass(poses[i]);
    EXPECT_TRUE(update.removed.empty()) << "frame " << i;
  }
  ASSERT_NE(find(0), nullptr);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, OfWhatIsUnseenForMinutesOnlyCandidatesAreGivenUp) {
  QuadricMapperOptions options;
  options.forget_unconfirmed_s = 6.0;
  mapper_ = QuadricMapper(options, classes_);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : arc(60, 90.0)) step(pose, {{0, 41, kCup}});
  for (const SE3& pose : arc(30, 1.0)) step(pose, {{1, 73, book}});  // without parallax
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  std::vector<std::int64_t> removed;
  const SE3 away = look_at(Vec3(1.5, 0.0, 0.8), Vec3(5.0, 0.0, 0.0));
  Ellipsoid far = kCup;
  far.T_world_quadric.t = Vec3(4.0, 0.0, 0.2);
  for (int i = 0; i < 240; ++i) {
    const MapUpdate update = step(away, {{2, 62, far}});
    removed.insert(removed.end(), update.removed.begin(), update.removed.end());
    if (i == 150) {
      EXPECT_NE(find(1), nullptr) << "after 5 s";
    }
  }
  EXPECT_EQ(removed, std::vector<std::int64_t>{1});
  EXPECT_NE(find(0), nullptr);
}

/// A list of changes is to say that it is gone.
TEST_F(MapperTest, WhatWasAnObjectInTheSessionBeforeIsNotGivenUp) {
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : arc(60, 90.0)) step(pose, {{0, 41, kCup}});
  for (const SE3& pose : arc(30, 1.0)) step(pose, {{1, 73, book}});  // without parallax
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  QuadricMapperOptions options;
  options.confirm_seen_s = 60.0;
  options.forget_unconfirmed_s = 1.0;
  begin_session(options);
  ASSERT_EQ(find(0)->state, LandmarkState::kCandidate);
  next_frame_ += 54000;  // half an hour
  const SE3 away = look_at(Vec3(1.5, 0.0, 0.8), Vec3(5.0, 0.0, 0.0));
  Ellipsoid far = kCup;
  far.T_world_quadric.t = Vec3(4.0, 0.0, 0.2);
  for (int i = 0; i < 60; ++i) step(away, {{2, 62, far}});
  EXPECT_NE(find(0), nullptr);
  EXPECT_EQ(find(1), nullptr) << "which never was one";
}

TEST(ExpectedLandmarks, WhatIsTooSmallForADetectorIsSoInWideImagesToo) {
  std::map<std::int64_t, MappedLandmark> landmarks;
  for (const double width_px : {10.0, 14.0}) {  // of an image 640 pixels wide
    MappedLandmark landmark;
    landmark.state.state = LandmarkState::kConfirmed;
    const double distance_m = 4.0, across_m = width_px / kCamera.fx * distance_m;
    const Vec3 center(width_px == 10.0 ? -1.0 : 1.0, 0.0, distance_m);
    landmark.state.ellipsoid = Ellipsoid{SE3(Quaternion::Identity(), center), Vec3::Constant(0.5 * across_m)};
    landmarks[static_cast<std::int64_t>(width_px)] = landmark;
  }
  for (const double scale : {1.0, 2.0}) {
    Frame frame;
    frame.camera = kCamera;
    for (double* value : {&frame.camera.fx, &frame.camera.fy, &frame.camera.cx, &frame.camera.cy}) *value *= scale;
    frame.camera.width = static_cast<int>(scale * kCamera.width);
    frame.camera.height = static_cast<int>(scale * kCamera.height);
    const std::vector<ExpectedLandmark> expected = expected_landmarks(landmarks, frame, nullptr, SE3(), {});
    ASSERT_EQ(expected.size(), 1U) << scale;
    EXPECT_EQ(expected[0].id, 14);
  }
}

/// A mistake of the detector stays for as long as the camera hardly moves: of the views that expect it, few have a box.
TEST_F(MapperTest, WhatFewKeyframesFindIsNotConfirmedUnlessItWasSeenForLong) {
  struct Case {
    std::size_t frames;
    bool is_moving;
    LandmarkState state;
  };
  const std::vector<SE3> poses = arc(60, 90.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.4, 0.4, 0.0);
  std::int64_t tv = 10;
  for (const Case& c : {Case{60, true, LandmarkState::kConfirmed}, Case{60, false, LandmarkState::kCandidate},
                        Case{360, false, LandmarkState::kConfirmed}}) {
    mapper_ = QuadricMapper(QuadricMapperOptions{}, classes_);
    ++tv;
    for (std::size_t i = 0; i < c.frames; ++i) {
      makes_keyframes_ = c.is_moving || i < 5;
      step(poses[i % 60], {{tv, 62, kCup}});
    }
    makes_keyframes_ = true;
    for (std::size_t i = 0; i < 180; ++i) step(poses[i % 60], {{1, 73, book}});
    EXPECT_EQ(find(tv)->state, c.state) << c.frames << ' ' << c.is_moving;
    EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
  }
}

TEST_F(MapperTest, NeverSeenAgainWhereExpectedIsRetired) {
  const std::vector<SE3> poses = arc(60, 90.0);
  for (int i = 0; i < 11; ++i) step(poses[static_cast<std::size_t>(i) * 5], {{0, 41, kCup}});
  ASSERT_TRUE(find(0)->ellipsoid);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.4, 0.4, 0.0);
  for (int i = 0; i < 900; ++i) step(poses[static_cast<std::size_t>(i % 60)], {{1, 73, book}});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired);
  EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, WhatABlurredImageDoesNotShowHasNotGone) {
  const std::vector<SE3> poses = arc(120, 60.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  const auto look_for_s = [&](double seconds, double roll_rad_s) {
    for (int i = 0; i < static_cast<int>(30.0 * seconds); ++i) {
      const int k = i % 238;  // to and fro
      SE3 pose = poses[static_cast<std::size_t>(k < 120 ? k : 238 - k)];
      pose.q = pose.q * so3_exp(Vec3(0.1 * std::sin(roll_rad_s * i / 30.0), 0.0, 0.0));
      step(pose, {{1, 73, book}});
    }
    return find(0)->state;
  };
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_EQ(look_for_s(10.0, 30.0), LandmarkState::kConfirmed) << "nodding by 6 deg five times a second";
  EXPECT_EQ(look_for_s(10.0, 0.0), LandmarkState::kRetired);
}

TEST(MotionBlur, OfHowFarAThingMovesInTheImage) {
  Frame frame;
  frame.camera = kCamera;
  MotionBlur blur;
  blur.push(frame);
  const Vec3 ahead(0.0, 0.0, 2.0);
  EXPECT_EQ(blur.recall(ahead), 1.0) << "nothing is known of the motion yet";
  frame.stamp_ns = 33'333'333;
  frame.T_odom_camera.q = so3_exp(Vec3(0.0, 1.0 / 30.0, 0.0));
  blur.push(frame);  // 1 rad/s, 520 px/s, 10.4 px
  EXPECT_NEAR(blur.recall(ahead), 0.41, 0.03);
  frame.stamp_ns *= 2;
  const Vec3 thing = frame.T_odom_camera * ahead;
  frame.T_odom_camera.q = so3_exp(Vec3(0.0, 2.0 / 30.0, 0.0));
  frame.T_odom_camera.t = thing - frame.T_odom_camera.q * ahead;
  blur.push(frame);  // round the thing
  EXPECT_GT(blur.recall(ahead), 0.99);
  EXPECT_LT(blur.recall(Vec3(0.0, 0.0, 8.0)), 0.6) << "behind it";
  frame.stamp_ns += 1'000'000'000;
  frame.T_odom_camera = {};
  blur.push(frame);
  EXPECT_EQ(blur.recall(ahead), 1.0) << "too long ago";
}

TEST_F(MapperTest, WhatWasMovedIsRetiredWhereItWasAndWhatIsFixedIsNot) {
  const std::vector<SE3> poses = arc(120, 120.0);
  Ellipsoid tv = kCup, moved = kCup;
  tv.T_world_quadric.t += Vec3(-0.3, 0.3, 0.0);
  moved.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}, {1, 62, tv}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  ASSERT_EQ(find(1)->state, LandmarkState::kConfirmed);
  for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(i % 120)], {{2, 41, moved}});
  end();
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired);
  EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
  ASSERT_NE(find(2), nullptr);
  EXPECT_EQ(find(2)->state, LandmarkState::kConfirmed);
  EXPECT_LT((find(2)->ellipsoid->center() - moved.center()).norm(), 0.01);
}

TEST_F(MapperTest, WhatAWrongPoseHadRetiredMergesWithTheOneThatIsThereUnlessItLeftInAnEarlierSession) {
  const std::vector<SE3> poses = arc(120, 120.0);
  Ellipsoid tv = kCup;
  tv.T_world_quadric.t += Vec3(-0.3, 0.3, 0.0);
  for (const bool in_one_session : {true, false}) {
    mapper_ = QuadricMapper(QuadricMapperOptions(), classes_);
    for (const SE3& pose : poses) step(pose, {{0, 41, kCup}, {1, 62, tv}});
    for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(i % 120)], {{1, 62, tv}});
    ASSERT_EQ(find(0)->state, LandmarkState::kRetired);
    if (!in_one_session) begin_session();
    for (const SE3& pose : poses) step(pose, {{2, 41, kCup}, {1, 62, tv}});
    end();
    ASSERT_NE(find(0), nullptr);
    EXPECT_EQ(find(0)->state, in_one_session ? LandmarkState::kConfirmed : LandmarkState::kRetired);
    EXPECT_EQ(find(0)->observations, in_one_session ? 240 : 120);
    EXPECT_EQ(find(2) == nullptr, in_one_session);
  }
}

TEST_F(MapperTest, WhatWasSeenBeforeABreakIsNotMissedBeforeACorrectionSaysWhereItIs) {
  const std::vector<SE3> poses = arc(120, 120.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  is_break_ = true;  // elsewhere, and the odometry counts on as if it were here
  for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(i % 120)], {{1, 73, book}});
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  const std::int64_t first = keyframes_.front().keyframe_id, last = keyframes_.back().keyframe_id;
  MapCorrection correction;
  correction.changed = true;
  for (const LoopVerdict& loop : {LoopVerdict{0, first + 1, first, true}, LoopVerdict{1, last, first, false}}) {
    correction.loops = {loop};
    mapper_.apply(correction);
    for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(i % 120)], {{1, 73, book}});
    EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "no loop that is kept leads over the break";
  }
  correction.loops = {{1, last, first, true}};
  mapper_.apply(correction);
  for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(i % 120)], {{1, 73, book}});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired);
}

TEST_F(MapperTest, WhatIsNotDetectedFromBehindOrWhileHiddenHasNotGone) {
  const std::vector<SE3> poses = arc(120, 60.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  for (int i = 0; i < 600; ++i) {
    const double angle = radians(180.0 + 0.1 * i);
    step(look_at(Vec3(1.5 * std::cos(angle), 1.5 * std::sin(angle), 0.8), Vec3::Zero()), {{1, 73, book}});
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "from behind";
  Ellipsoid person = kCup;  // stands between the cup and every camera
  person.semi_axes *= 3.0;
  for (int i = 0; i < 600; ++i) {
    const SE3& pose = poses[static_cast<std::size_t>(i % 120)];
    person.T_world_quadric.t = kCup.center() + 0.5 * (pose.t - kCup.center());
    step(pose, {{-1, 0, person}, {1, 73, book}});
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "hidden";
  Ellipsoid screen = kCup;  // a landmark; from these places it covers the cup
  screen.T_world_quadric.t = kCup.center() + 0.5 * (poses[60].t - kCup.center());
  screen.semi_axes = Vec3::Constant(0.25);
  for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(50 + i % 20)], {{2, 62, screen}});
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "behind a landmark";
  const SE3 aside(so3_exp(Vec3(0.0, radians(22.0), 0.0)), Vec3::Zero());
  for (int i = 0; i < 600; ++i) step(poses[static_cast<std::size_t>(50 + i % 20)] * aside, {{2, 62, screen}});
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "behind one that the border cuts";
}

TEST_F(MapperTest, WhatWasHardlySeenIsNotGivenUpBeforeItWasExpectedForSomeTime) {
  MappedLandmark landmark;
  landmark.sightings.seen_s = 0.01;
  landmark.sightings.expected_s = 5.0;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kCandidate);
  landmark.sightings.expected_s = 10.0;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kRetired);
}

TEST_F(MapperTest, WhatIsTooFarToBeLookedForIsNotMissed) {
  const Ellipsoid screen{SE3(), Vec3::Constant(0.4)};
  const auto from = [](double distance_m, double angle_deg) {
    const double angle = radians(angle_deg);
    return look_at(distance_m * Vec3(std::cos(angle), std::sin(angle), 0.3), Vec3::Zero());
  };
  for (int i = 0; i < 90; ++i) step(from(4.0, i), {{0, 62, screen}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  for (int i = 0; i < 900; ++i) {
    const SE3 pose = from(12.0, 0.1 * i);
    const Ellipsoid something_near{SE3(Quaternion::Identity(), pose * Vec3(0.3, 0.2, 1.0)), Vec3::Constant(0.05)};
    step(pose, {{-1, 41, something_near}});
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, WhatDepthShowsToBeHiddenHasNotGone) {
  const std::vector<SE3> poses = arc(120, 60.0);
  Ellipsoid book = kCup;
  book.T_world_quadric.t += Vec3(0.3, -0.3, 0.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  for (int i = 0; i < 600; ++i) {
    const SE3& pose = poses[static_cast<std::size_t>(i % 120)];
    const Vec3 cup_camera = pose.inverse() * kCup.center();
    auto screen = std::make_shared<std::vector<Vec3>>();  // halfway, over the whole cup
    for (int k = 0; k < 100; ++k) {
      screen->push_back(0.5 * cup_camera + Vec3(0.006 * (k % 10 - 5), 0.01 * (k / 10 - 5), 0.0));
    }
    step(pose, {{1, 73, book}}, screen);
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
}

TEST_F(MapperTest, AnEllipsoidOfAnotherSizeThanItsClassIsRefused) {
  Ellipsoid huge = kCup;
  huge.semi_axes *= 8.0;
  for (const SE3& pose : arc(60, 90.0)) step(pose, {{0, 41, huge}});
  EXPECT_FALSE(find(0)->ellipsoid);
}

/// A wrong loop closure lays one cup upon another; when it is taken back, so is the merge.
TEST_F(MapperTest, MergeIsUndoneWhenACorrectionPullsTheTwoApart) {
  QuadricMapperOptions options;
  options.maintenance_interval_s = 1e6;  // duplicates are looked for at the end only
  mapper_ = QuadricMapper(options, classes_);
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  for (const SE3& pose : poses) step(pose, {{1, 41, kCup}});
  const Landmark first = *find(0);
  ASSERT_NE(find(1), nullptr);
  const Landmark second = *find(1);
  const MapUpdate merge = end();
  ASSERT_EQ(merge.merged.size(), 1U);
  ASSERT_EQ(mapper_.landmarks().size(), 1U);

  const SE3 T_new_old(Quaternion::Identity(), Vec3(1.0, 0.0, 0.0));
  MapCorrection correction = moved(12, 23, poses, T_new_old);
  correction.T_map_odom = T_new_old;
  const MapUpdate update = mapper_.apply(correction);
  ASSERT_EQ(update.unmerged.size(), 1U);
  EXPECT_EQ(update.unmerged[0].merged_id, merge.merged[0].merged_id);
  ASSERT_NE(find(0), nullptr);
  ASSERT_NE(find(1), nullptr);
  EXPECT_EQ(find(0)->observations, first.observations);
  EXPECT_EQ(find(1)->observations, second.observations);
  EXPECT_EQ(find(0)->class_counts[0].count, first.observations);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
  EXPECT_LT((find(0)->ellipsoid->center() - kCup.center()).norm(), 0.01);
  EXPECT_LT((find(1)->ellipsoid->center() - T_new_old * kCup.center()).norm(), 0.01);
}

TEST_F(MapperTest, AWrongMergeIsUndoneAfterItsSurvivorHasGoneIntoAnother) {
  QuadricMapperOptions options;
  options.maintenance_interval_s = 1e6;  // duplicates are looked for at the end, and once more
  options.retire_missed_s = 1e6;
  mapper_ = QuadricMapper(options, classes_);
  const std::vector<SE3> poses = arc(60, 90.0);
  const auto laps = [&](std::int64_t id, int count) {
    for (int lap = 0; lap < count; ++lap) {
      for (const SE3& pose : poses) step(pose, {{id, 41, kCup}});
    }
  };
  laps(0, 2);
  laps(1, 1);  // keyframes 24 to 35
  const Landmark second = *find(1);
  ASSERT_EQ(end().merged.size(), 1U);
  laps(2, 4);
  options.maintenance_interval_s = 1e-3;
  mapper_.set_options(options);
  const MapUpdate merge = step(poses[0], {});
  ASSERT_EQ(merge.merged.size(), 1U);
  ASSERT_EQ(merge.merged[0].survivor_id, 2);
  ASSERT_EQ(mapper_.landmarks().size(), 1U);
  const int all = find(2)->observations;

  const SE3 T_new_old(so3_exp(Vec3(0.0, 0.0, 1.0)), Vec3(1.0, 0.0, 0.0));
  const MapUpdate update = mapper_.apply(moved(24, 35, poses, T_new_old));
  ASSERT_EQ(update.unmerged.size(), 1U);
  EXPECT_EQ(update.unmerged[0].merged_id, 1);
  ASSERT_NE(find(1), nullptr);
  EXPECT_EQ(find(1)->observations, second.observations);
  EXPECT_EQ(find(2)->observations, all - second.observations);
  EXPECT_EQ(find(2)->class_counts[0].count, all - second.observations);
  EXPECT_LT((find(1)->ellipsoid->center() - T_new_old * kCup.center()).norm(), 0.01);
  EXPECT_LT((find(2)->ellipsoid->center() - kCup.center()).norm(), 0.01);

  // The other merge was of what is left of the survivor.
  ++next_frame_;
  const SE3 T_newer_old(Quaternion::Identity(), Vec3(-1.0, 0.0, 0.0));
  ASSERT_EQ(mapper_.apply(moved(0, 23, poses, T_newer_old)).unmerged.size(), 1U);
  ASSERT_NE(find(0), nullptr);
  EXPECT_EQ(find(0)->observations, 120);
  EXPECT_EQ(find(2)->observations, 240);
}

TEST_F(MapperTest, TheCovarianceOfWhatACorrectionTurnsTurnsWithIt) {
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  const Mat3 before = find(0)->center_covariance;
  const SE3 T_new_old(so3_exp(Vec3(0.0, 0.0, 0.5 * kPi)), Vec3(1.0, 0.0, 0.0));
  MapCorrection correction = moved(0, 11, poses, T_new_old);
  correction.T_map_odom = T_new_old;
  mapper_.apply(correction);
  const Mat3 R = T_new_old.q.toRotationMatrix();
  EXPECT_LT((find(0)->center_covariance - R * before * R.transpose()).norm(), 1e-9 * before.norm());
  EXPECT_GT((find(0)->center_covariance - before).norm(), 0.1 * before.norm()) << "it is no ball";
}

/// The id of what was merged away is given out again in the next session, which undoes a merge of its own.
TEST_F(MapperTest, AMergeUndoneTakesNoBoxesOfAnEarlierSession) {
  QuadricMapperOptions options;
  options.maintenance_interval_s = 1e6;  // duplicates are looked for at the end only
  mapper_ = QuadricMapper(options, classes_);
  const auto map_as = [this](std::int64_t id) {
    for (const SE3& pose : arc(60, 90.0)) step(pose, {{id, 41, kCup}});
  };
  map_as(0);
  map_as(1);
  ASSERT_EQ(end().merged.size(), 1U);
  ASSERT_NE(find(0), nullptr);
  begin_session(options);
  const std::size_t first = keyframes_.size();
  map_as(1);
  ASSERT_EQ(end().merged.size(), 1U);

  const SE3 T_new_old(Quaternion::Identity(), Vec3(1.0, 0.0, 0.0));
  MapCorrection correction;
  correction.frame_id = next_frame_;
  correction.changed = true;
  correction.T_map_odom = T_new_old;
  correction.valid_to_keyframe_id = keyframe_id_;
  for (std::size_t i = first; i < keyframes_.size(); ++i) {
    correction.keyframes.push_back(keyframes_[i]);
    correction.keyframes.back().T_map_camera = T_new_old * keyframes_[i].T_map_camera;
  }
  ASSERT_EQ(mapper_.apply(correction).unmerged.size(), 1U);
  const MapperState state = mapper_.state();
  ASSERT_EQ(state.landmarks.size(), 2U);
  EXPECT_EQ(state.landmarks[0].observations.size(), 120U);
  EXPECT_EQ(state.landmarks[1].observations.size(), 60U);
  ASSERT_EQ(state.merges.size(), 2U) << "of both sessions, and what was taken back";
  for (const LoggedMerge& merge : state.merges) {
    EXPECT_EQ(merge.merge.merged_id, 1);
    EXPECT_EQ(merge.merge.survivor_id, 0);
    EXPECT_EQ(merge.merged_class_id, 41);
    EXPECT_EQ(merge.merged_observations, 60);
  }
  EXPECT_EQ(state.merges[0].number, 0);
  EXPECT_EQ(state.merges[0].frame_id, 120);
  EXPECT_EQ(state.merges[0].stamp_ns, 119LL * 33333333);
  EXPECT_FALSE(state.merges[0].undone_frame_id.has_value());
  EXPECT_EQ(state.merges[1].number, 1);
  EXPECT_EQ(state.merges[1].undone_frame_id, std::optional<std::int64_t>(next_frame_));
}

TEST(MergeLog, TellsWhatIsNewAndForgetsTheFirst) {
  MergeLog log(3);
  const auto told = [&log](bool whole) {
    MapperDelta delta;
    delta.is_whole = whole;
    log.take_delta(&delta);
    std::string text = std::to_string(delta.first_merge) + ":";
    for (const LoggedMerge& merge : delta.merges) {
      text += " " + std::to_string(merge.number) + (merge.undone_frame_id ? "-" : "");
    }
    return text;
  };
  const auto add = [&log](std::int64_t merged_id) {
    LoggedMerge merge;
    merge.merge = {merged_id, 0};
    log.add(merge);
  };
  EXPECT_EQ(told(true), "0:");
  add(5);
  add(6);
  EXPECT_EQ(told(false), "0: 0 1");
  log.take_back({5, 0}, 70);
  add(5);
  EXPECT_EQ(told(false), "0: 0- 2") << "they may merge again";
  log.take_back({9, 0}, 71);
  EXPECT_EQ(told(false), "0:");
  log.take_back({5, 0}, 72);
  add(7);
  EXPECT_EQ(told(false), "1: 2- 3");
  EXPECT_EQ(told(true), "1: 1 2- 3");
  EXPECT_EQ(log.merges()[1].undone_frame_id, std::optional<std::int64_t>(72));
  MergeLog later(3);
  later.restore(log.merges());
  later.add({});
  EXPECT_EQ(later.merges().back().number, 4) << "goes on";
  EXPECT_EQ(later.merges().size(), 3U);
}

/// A landmark is given up with what its neighbours know of it: as its own neighbour it would be read while it goes.
TEST(MergeHistory, ALandmarkIsNotSeenBesideItself) {
  MappedLandmark survivor, merged;
  survivor.state.id = 1;
  merged.state.id = 2;
  survivor.seen_beside = {{2, 3}, {7, 4}};
  merged.seen_beside = {{1, 3}, {7, 2}};
  merged.state.observations = 5;
  MergeHistory history;
  history.join({}, merged, &survivor);
  EXPECT_EQ(survivor.seen_beside, (std::map<std::int64_t, int>{{2, 3}, {7, 6}}));
  survivor.state.observations += 1;  // so that it is not simply what it was
  const MappedLandmark back = history.split({}, 0, &survivor);
  EXPECT_EQ(back.seen_beside, merged.seen_beside);
  EXPECT_EQ(survivor.seen_beside, (std::map<std::int64_t, int>{{2, 3}, {7, 4}}));
}

TEST_F(MapperTest, LandmarksMoveWithTheirKeyframesAndVersionsChain) {
  std::uint64_t version = mapper_.map_version();
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) {
    const MapUpdate update = step(pose, {{0, 41, kCup}});
    EXPECT_EQ(update.base_version, version);
    version = update.map_version;
  }
  const SE3 T_new_old(so3_exp(Vec3(0.0, 0.1, 0.3)), Vec3(1.0, -2.0, 0.5));
  MapCorrection correction = moved(0, 9, poses, T_new_old);  // the last two keyframes are newer than the solution
  correction.frame_id = next_frame_ - 1;
  correction.T_map_odom = T_new_old;
  const Vec3 before = find(0)->ellipsoid->center();
  const MapUpdate update = mapper_.apply(correction);
  EXPECT_EQ(update.base_version, version);
  EXPECT_GT(update.map_version, version);
  EXPECT_LT((find(0)->ellipsoid->center() - T_new_old * before).norm(), 1e-9);
  // Frames after the correction see the object where it now is.
  step(poses[0], {{0, 41, kCup}});
  end();
  EXPECT_LT((find(0)->ellipsoid->center() - T_new_old * kCup.center()).norm(), 0.01);
}

/// A camera that came to count in a unit of half the length has mapped everything twice as large.
TEST_F(MapperTest, LandmarksGrowWithTheScaleOfTheirKeyframes) {
  const std::vector<SE3> poses = arc(60, 90.0);
  for (const SE3& pose : poses) step(pose, {{0, 41, kCup}});
  const Ellipsoid before = *find(0)->ellipsoid;
  constexpr double kScale = 0.5;
  const Sim3 S_new_old(SE3(so3_exp(Vec3(0.0, 0.1, 0.3)), Vec3(1.0, -2.0, 0.5)), kScale);
  const auto corrected = [&](const SE3& T_odom_camera) { return S_new_old.pose(T_odom_camera); };
  MapCorrection correction;
  correction.frame_id = next_frame_ - 1;
  correction.changed = true;
  correction.scale = kScale;
  correction.T_map_odom = corrected(poses.back()) * poses.back().inverse();
  correction.valid_to_keyframe_id = 11;
  for (std::int64_t id = 0; id <= 11; ++id) {
    correction.keyframes.push_back({id, id * 5, 0, corrected(poses[static_cast<std::size_t>(id) * 5]), kScale});
  }
  mapper_.apply(correction);
  EXPECT_LT((find(0)->ellipsoid->center() - S_new_old * before.center()).norm(), 1e-9);
  EXPECT_LT((find(0)->ellipsoid->semi_axes - kScale * before.semi_axes).norm(), 1e-12);
  // The fit from the views, which hang on the keyframes in the odometry's unit, says the same.
  end();
  EXPECT_LT((find(0)->ellipsoid->center() - S_new_old * kCup.center()).norm(), 0.01);
  EXPECT_LT((find(0)->ellipsoid->semi_axes - kScale * before.semi_axes).norm(), 0.005);
}

/// A run of two rounds through a mapper and a pose graph: what a loop closure merges comes apart when the loop is
/// withdrawn.
class MappedRounds : public TwoRounds {
 public:
  MappedRounds()
      : TwoRounds([this](const Frame& frame, const AssociationFrame& associations,
                         const std::vector<LoopClosure>& loops) { process(frame, associations, loops); }),
        mapper_(QuadricMapperOptions(), classes()),
        graph_(PoseGraphOptions()) {}

  void end() { process(end_frame(), {}, {}); }
  PoseGraph& graph() { return graph_; }
  std::vector<Landmark> landmarks() const { return mapper_.landmarks(); }
  int merged() const { return merged_; }
  int unmerged() const { return unmerged_; }

 private:
  static std::shared_ptr<const ClassTable> classes() {
    return std::make_shared<ClassTable>(*ClassTable::create({{kCup, "cup", ClassRole::kMovable, "", 0.1}}));
  }
  void process(const Frame& frame, const AssociationFrame& associations, const std::vector<LoopClosure>& loops) {
    count(mapper_.integrate(frame, associations));
    count(mapper_.apply(graph_.process(frame, loops)));
  }
  void count(const MapUpdate& update) {
    merged_ += static_cast<int>(update.merged.size());
    unmerged_ += static_cast<int>(update.unmerged.size());
  }

  QuadricMapper mapper_;
  PoseGraph graph_;
  int merged_ = 0, unmerged_ = 0;
};

TEST(ClosureUndo, TheMapIsAsBeforeWhenTheLoopsAreWithdrawn) {
  MappedRounds with, without;
  for (MappedRounds* run : {&with, &without}) run->both_rounds();
  ASSERT_EQ(with.landmarks().size(), 2U);
  with.idle(TwoRounds::loops());
  EXPECT_EQ(with.merged(), 1);
  ASSERT_EQ(with.landmarks().size(), 1U) << "one cup, seen twice";
  EXPECT_LT((with.landmarks().front().ellipsoid->center() - TwoRounds::cup().center()).norm(), 0.1);

  for (const LoopClosure& loop : TwoRounds::loops()) {
    EXPECT_TRUE(with.graph().withdraw(loop.query_keyframe_id, loop.match_keyframe_id));
  }
  with.idle({});
  without.idle({});
  without.idle({});
  with.end();
  without.end();
  EXPECT_EQ(with.unmerged(), 1);
  EXPECT_EQ(without.merged(), 0);
  const std::vector<Landmark> now = with.landmarks(), before = without.landmarks();
  ASSERT_EQ(now.size(), 2U);
  ASSERT_EQ(before.size(), 2U);
  for (std::size_t i = 0; i < now.size(); ++i) {
    EXPECT_EQ(now[i].id, before[i].id);
    EXPECT_EQ(now[i].class_id, before[i].class_id);
    EXPECT_EQ(now[i].state, before[i].state);
    EXPECT_EQ(now[i].observations, before[i].observations);
    EXPECT_NEAR(now[i].quality, before[i].quality, 0.01);
    ASSERT_TRUE(now[i].ellipsoid && before[i].ellipsoid);
    EXPECT_LT((now[i].ellipsoid->center() - before[i].ellipsoid->center()).norm(), 1e-3);
    EXPECT_LT((now[i].ellipsoid->shape() - before[i].ellipsoid->shape()).norm(),
              0.02 * before[i].ellipsoid->shape().norm());
  }
}

TEST(SeenFrom, DirectionsTurnWithTheMap) {
  const Vec3 direction(1.0, 0.25, -0.75);
  const Quaternion quarter = so3_exp(Vec3(0.0, 0.0, 0.5 * M_PI));
  SeenFrom seen;
  seen.add(direction, 40.0);
  EXPECT_TRUE(seen.covers(direction, 40.0));
  EXPECT_FALSE(seen.covers(direction, 39.0)) << "farther away";
  EXPECT_FALSE(seen.covers(quarter * direction, 40.0));
  seen.turn(quarter);
  EXPECT_TRUE(seen.covers(quarter * direction, 40.0));
  EXPECT_FALSE(seen.covers(direction, 40.0));
  // By less than half a bin nothing changes.
  seen.turn(so3_exp(Vec3(0.05, -0.05, 0.05)));
  EXPECT_TRUE(seen.covers(quarter * direction, 40.0));
}

TEST(QuadricMapperOptions, RejectsValuesOutOfRangeByName) {
  QuadricMapperOptions options;
  options.merge_iou = 1.5;
  EXPECT_EQ(validate(options).message(), "parameter 'mapping.merge_iou' = '1.5' must be in [0, 1]");
}

TEST(MapperState, WhoIsNoMoreVetoesNoMergeOfTheOneWithItsId) {
  std::vector<MappedLandmark> landmarks(2);
  landmarks[0].state.id = 1;
  landmarks[0].seen_beside = {{2, 5}, {7, 200}};
  landmarks[1].state.id = 2;
  landmarks[1].seen_beside = {{1, 5}};
  forget_gone_neighbours(&landmarks);
  EXPECT_EQ(landmarks[0].seen_beside, (std::map<std::int64_t, int>{{2, 5}}));
  EXPECT_EQ(landmarks[1].seen_beside, (std::map<std::int64_t, int>{{1, 5}}));
}

}  // namespace
}  // namespace semantic_topo_loop::core
