#include "semantic_topo_loop/frontend/rgbd_frontend.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cstdint>
#include <map>
#include <opencv2/imgproc.hpp>

#include "geometry/descriptor.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_room.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera = SyntheticRoom::small_camera();
const SyntheticRoom kRoom(kCamera);
constexpr double kInterval_s = 0.0333333333;

/// The room seen from a place of the walk.
RgbdImage on_walk(int image) { return kRoom.render(stamp_of(image), pose_on_walk(kInterval_s * image)); }

SE3 true_motion(int from, int to) {
  return pose_on_walk(kInterval_s * from).inverse() * pose_on_walk(kInterval_s * to);
}

/// Error of a pose, m, where the map begins at image 0 of the walk.
double error_m(const TrackedImage& tracked, int image) {
  return (tracked.sample->T_odom_camera.t - true_motion(0, image).t).norm();
}

/// A front end that has followed the walk's first images.
RgbdFrontend after_walk(int images, const FrontendOptions& options = {}) {
  RgbdFrontend frontend(options, kCamera);
  for (int i = 0; i < images; ++i) EXPECT_TRUE(frontend.track(on_walk(i)).sample) << i;
  return frontend;
}

/// The other end of the room, which the walk never shows.
RgbdImage elsewhere(int image) {
  const SE3 T(so3_exp(Vec3(0.0, kPi, 0.0)), Vec3(0.0, 0.3, 0.5));
  return kRoom.render(stamp_of(image), T);
}

TEST(RgbdFrontend, FollowsAWalk) {
  RgbdFrontend frontend({}, kCamera);
  constexpr int kImages = 45;
  for (int i = 0; i < kImages; ++i) {
    const TrackedImage tracked = frontend.track(on_walk(i));
    ASSERT_TRUE(tracked.sample) << i;
    EXPECT_EQ(tracked.state, i == 0 ? TrackingState::kStarted : TrackingState::kTracked);
    EXPECT_EQ(tracked.sample->stamp_ns, stamp_of(i));
    EXPECT_FALSE(tracked.sample->is_break);
    EXPECT_FALSE(tracked.is_recalibrated);
    EXPECT_LT(error_m(tracked, i), 0.012) << i;
    EXPECT_LT(degrees(rotation_angle(tracked.sample->T_odom_camera.q, true_motion(0, i).q)), 0.3) << i;
    EXPECT_EQ(tracked.sample->covariance.has_value(), i > 0);
    if (i == 0) continue;
    const Eigen::SelfAdjointEigenSolver<Mat6> eigen(*tracked.sample->covariance);
    EXPECT_GT(eigen.eigenvalues().minCoeff(), 1e-9);
    EXPECT_LT(eigen.eigenvalues().maxCoeff(), 1e-3);
  }
  EXPECT_EQ(frontend.camera().fx, kCamera.fx);
}

TEST(RgbdFrontend, BeginsAnewWithTheFocalLengthItFound) {
  constexpr int kImages = 110, kStep = 2;  // 7 s at 15 Hz: focal lengths wait until the depth's registration is known
  Camera stated = kCamera;
  stated.fx = stated.fy = kCamera.fx / 0.9;
  // Turning about, which focal lengths are seen by: depth is known, so that shifts alone say nothing of them.
  const auto pose = [](int image) {
    const double t = kInterval_s * kStep * image;
    return SE3(so3_exp(Vec3(0.2 * std::sin(1.1 * t), 0.8 * std::sin(1.5 * t), 0.0)), Vec3(0.6 * std::sin(t), 0.0, 0.3));
  };
  std::vector<RgbdImage> images;
  for (int i = 0; i < kImages; ++i) images.push_back(kRoom.render(stamp_of(kStep * i), pose(i)));
  const auto is_recalibrated = [&images](RgbdFrontend* frontend) {
    for (const RgbdImage& image : images) {
      if (frontend->track(image).is_recalibrated) return true;
    }
    return false;
  };
  const auto rmse_m = [&](RgbdFrontend frontend) {
    double sum = 0.0;
    for (int i = 0; i < kImages; ++i) {
      const TrackedImage tracked = frontend.track(images[static_cast<std::size_t>(i)]);
      EXPECT_EQ(tracked.state, i == 0 ? TrackingState::kStarted : TrackingState::kTracked) << i;
      EXPECT_FALSE(tracked.is_recalibrated);
      if (tracked.sample) sum += (tracked.sample->T_odom_camera.t - (pose(0).inverse() * pose(i)).t).squaredNorm();
    }
    return std::sqrt(sum / kImages);
  };
  RgbdFrontend frontend({}, stated);
  int restarts = 0;
  for (; is_recalibrated(&frontend); ++restarts) frontend.begin_anew();
  EXPECT_GE(restarts, 1);
  EXPECT_LE(restarts, 4);
  EXPECT_NEAR(frontend.camera().fx, kCamera.fx, 0.03 * kCamera.fx);
  frontend.begin_anew();
  FrontendOptions as_stated;
  as_stated.self_calibration = false;
  EXPECT_LT(rmse_m(std::move(frontend)), 0.4 * rmse_m(RgbdFrontend(as_stated, stated)));
  RgbdFrontend uncorrected(as_stated, stated);
  EXPECT_FALSE(is_recalibrated(&uncorrected));
  EXPECT_EQ(uncorrected.camera().fx, stated.fx);
}

TEST(RgbdFrontend, FeaturesArePointsOfTheMapWithWhatTheyLookLike) {
  RgbdFrontend frontend = after_walk(10);
  const TrackedImage before = frontend.track(on_walk(10)), tracked = frontend.track(on_walk(11));
  ASSERT_TRUE(before.sample && tracked.sample && before.sample->features && tracked.sample->features);
  EXPECT_GE(static_cast<int>(tracked.sample->features->size()), tracked.inliers);
  std::map<std::int64_t, const PointFeature*> shown;
  for (const PointFeature& feature : *before.sample->features) shown[feature.id] = &feature;
  const SE3 T_before_now = before.sample->T_odom_camera.inverse() * tracked.sample->T_odom_camera;
  std::size_t again = 0;
  for (const PointFeature& feature : *tracked.sample->features) {
    const auto earlier = shown.find(feature.id);
    if (earlier == shown.end()) continue;
    ++again;
    const Vec3 position = T_before_now * feature.position.cast<double>();
    EXPECT_LT((position - earlier->second->position.cast<double>()).norm(), 0.02) << feature.id;
    EXPECT_LT(hamming(feature.descriptor, earlier->second->descriptor), kMatchBits) << feature.id;
  }
  EXPECT_GT(2 * again, tracked.sample->features->size());
}

TEST(RgbdFrontend, PointsAreThoseOfTheDepthImageAndExactInFloat) {
  RgbdFrontend frontend({}, kCamera);
  RgbdImage image = on_walk(0);
  image.depth_m.at<float>(2, 2) = 0.0F;
  const TrackedImage tracked = frontend.track(image);
  ASSERT_TRUE(tracked.sample && tracked.sample->points_camera);
  const std::vector<Vec3>& points = *tracked.sample->points_camera;
  EXPECT_EQ(points.size(), static_cast<std::size_t>(kCamera.width / 4 * kCamera.height / 4 - 1));
  for (const Vec3& p : points) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto rounded = static_cast<float>(p[axis]);
      ASSERT_EQ(p[axis], static_cast<double>(rounded));
    }
  }
  const float z = image.depth_m.at<float>(2, 6);
  EXPECT_LT((points.front() - z * kCamera.ray(Vec2(6, 2))).norm(), 1e-6);
}

TEST(RgbdFrontend, SameImagesSamePosesForAnyNumberOfThreads) {
  const int threads = cv::getNumThreads();
  std::vector<std::vector<SE3>> runs;
  for (const int count : {1, 4}) {
    cv::setNumThreads(count);
    RgbdFrontend frontend({}, kCamera);
    runs.emplace_back();
    for (int i = 0; i < 24; ++i) runs.back().push_back(frontend.track(on_walk(2 * i)).sample->T_odom_camera);
  }
  cv::setNumThreads(threads);
  for (std::size_t i = 0; i < runs[0].size(); ++i) {
    EXPECT_EQ(runs[0][i].t, runs[1][i].t) << i;
    EXPECT_EQ(runs[0][i].q.coeffs(), runs[1][i].q.coeffs()) << i;
  }
}

/// Something with a texture of its own, 0.8 m from the camera, comes in from the left and goes out to the right.
RgbdImage with_passer(RgbdImage image, double left_px, int width_px) {
  static const RgbdImage kTexture = kRoom.render(0, SE3(so3_exp(Vec3(0.0, 2.0, 0.0)), Vec3(0.5, 0.0, 0.0)));
  const int left = static_cast<int>(left_px);
  for (int v = 20; v < image.gray.rows; ++v) {
    for (int u = std::max(0, left); u < std::min(image.gray.cols, left + width_px); ++u) {
      image.gray.at<std::uint8_t>(v, u) = kTexture.gray.at<std::uint8_t>(v, u - left);
      image.depth_m.at<float>(v, u) = 0.8F;
    }
  }
  return image;
}

TEST(RgbdFrontend, WhatMovesThroughTheViewIsNotFollowed) {
  constexpr int kBegin = 10, kPassing = 75, kWidth_px = 150;
  RgbdFrontend frontend = after_walk(kBegin);
  for (int i = kBegin; i < kBegin + kPassing + 5; ++i) {
    const double left_px = -kWidth_px + (kCamera.width + kWidth_px) * static_cast<double>(i - kBegin) / kPassing;
    const TrackedImage tracked = frontend.track(with_passer(on_walk(i), left_px, kWidth_px));
    ASSERT_EQ(tracked.state, TrackingState::kTracked) << i;
    EXPECT_LT(error_m(tracked, i), 0.03) << i;
  }
}

TEST(RgbdFrontend, BlackImageHasNoPoseAndTheNextIsFoundAgain) {
  RgbdFrontend frontend = after_walk(6);
  RgbdImage black = on_walk(6);
  black.gray.setTo(0);
  const TrackedImage none = frontend.track(black);
  EXPECT_EQ(none.state, TrackingState::kUnusable);
  EXPECT_FALSE(none.sample);
  const TrackedImage again = frontend.track(on_walk(7));
  EXPECT_EQ(again.state, TrackingState::kRelocalised);
  ASSERT_TRUE(again.sample);
  EXPECT_FALSE(again.sample->is_break);
  EXPECT_LT(error_m(again, 7), 0.012);
}

TEST(RgbdFrontend, ImageWithoutDepthIsTrackedButStartsNothing) {
  RgbdFrontend frontend({}, kCamera);
  RgbdImage image = on_walk(0);
  image.depth_m.setTo(0.0F);
  EXPECT_EQ(frontend.track(image).state, TrackingState::kUnusable);
  for (int i = 1; i < 6; ++i) frontend.track(on_walk(i));
  image = on_walk(6);
  image.depth_m.setTo(0.0F);
  const TrackedImage tracked = frontend.track(image);
  ASSERT_EQ(tracked.state, TrackingState::kTracked);
  EXPECT_LT((tracked.sample->T_odom_camera.t - true_motion(1, 6).t).norm(), 0.015);
  EXPECT_TRUE(tracked.sample->points_camera->empty());
}

TEST(RgbdFrontend, GapOfTwoSecondsIsBridged) {
  RgbdFrontend frontend = after_walk(8);
  RgbdImage image = kRoom.render(stamp_of(8 + 60), pose_on_walk(kInterval_s * 15));
  const TrackedImage tracked = frontend.track(image);
  ASSERT_EQ(tracked.state, TrackingState::kTracked);
  EXPECT_LT(error_m(tracked, 15), 0.02);
  EXPECT_TRUE(tracked.sample->is_continuous);
}

TEST(RgbdFrontend, ABadImageAfterAPauseIsNoNewBeginning) {
  RgbdFrontend frontend = after_walk(10);
  const auto late = [](RgbdImage image) {
    image.stamp_ns += 5'000'000'000;
    return image;
  };
  EXPECT_EQ(frontend.track(late(elsewhere(10))).state, TrackingState::kLost);
  const TrackedImage tracked = frontend.track(late(on_walk(11)));
  ASSERT_TRUE(tracked.sample);
  EXPECT_EQ(tracked.state, TrackingState::kRelocalised);
  EXPECT_FALSE(tracked.sample->is_break);
  EXPECT_LT(error_m(tracked, 11), 0.012);
}

TEST(RgbdFrontend, LostElsewhereAndFoundAgain) {
  RgbdFrontend frontend = after_walk(15);
  for (int i = 15; i < 25; ++i) {
    const TrackedImage tracked = frontend.track(elsewhere(i));
    EXPECT_EQ(tracked.state, TrackingState::kLost);
    EXPECT_FALSE(tracked.sample);
  }
  const TrackedImage tracked = frontend.track(on_walk(25));
  ASSERT_EQ(tracked.state, TrackingState::kRelocalised);
  EXPECT_FALSE(tracked.sample->is_break);
  EXPECT_TRUE(tracked.sample->is_continuous);
  EXPECT_LT(error_m(tracked, 25), 0.02);
}

TEST(RgbdFrontend, PutElsewhereItIsFoundAtOnceByWhatLooksAlike) {
  constexpr int kTurn = 80;  // images, once round
  const auto turned = [](int image) { return SE3(so3_exp(Vec3(0.0, 2.0 * kPi * image / kTurn, 0.0)), Vec3::Zero()); };
  RgbdFrontend frontend({}, kCamera);
  int next = 0;
  for (; next < kTurn; ++next) {
    ASSERT_TRUE(frontend.track(kRoom.render(stamp_of(next), turned(next))).sample) << next;
  }
  for (const int target : {20, 60, 35, 50, 10}) {
    RgbdImage covered = on_walk(next++);
    covered.gray.setTo(0);
    EXPECT_EQ(frontend.track(covered).state, TrackingState::kUnusable);
    const TrackedImage found = frontend.track(kRoom.render(stamp_of(next++), turned(target)));
    ASSERT_EQ(found.state, TrackingState::kRelocalised) << target;
    EXPECT_LT(found.sample->T_odom_camera.t.norm(), 0.05) << target;
  }
}

TEST(RgbdFrontend, LostForLongItStartsAnewWithABreak) {
  FrontendOptions options;
  options.restart_after_s = 0.2;
  RgbdFrontend frontend = after_walk(8, options);
  int lost = 0;
  TrackedImage tracked;
  for (int i = 8; i < 20; ++i) {
    tracked = frontend.track(elsewhere(i));
    if (tracked.sample) break;
    ++lost;
  }
  EXPECT_GE(lost, 5);
  ASSERT_TRUE(tracked.sample);
  EXPECT_EQ(tracked.state, TrackingState::kStarted);
  EXPECT_TRUE(tracked.sample->is_break);
  EXPECT_FALSE(tracked.sample->covariance);
  const SE3 last = tracked.sample->T_odom_camera;
  EXPECT_LT((last.t - true_motion(0, 7).t).norm(), 0.012);  // where it was seen last
  tracked = frontend.track(elsewhere(20));
  ASSERT_EQ(tracked.state, TrackingState::kTracked);
  EXPECT_LT((tracked.sample->T_odom_camera.t - last.t).norm(), 1e-3);
}

TEST(RgbdFrontend, IsLostForNoLongerThanItIsOld) {
  for (const int followed : {0, 2}) {
    RgbdFrontend frontend({}, kCamera);
    int next = 0;
    while (next <= followed) EXPECT_TRUE(frontend.track(elsewhere(next++)).sample);
    for (int lost = 0; lost < std::max(1, followed); ++lost)
      EXPECT_EQ(frontend.track(on_walk(next++)).state, TrackingState::kLost);
    const TrackedImage again = frontend.track(on_walk(next++));
    ASSERT_EQ(again.state, TrackingState::kStarted) << followed;
    EXPECT_TRUE(again.sample->is_break);
    const TrackedImage tracked = frontend.track(on_walk(next));
    ASSERT_EQ(tracked.state, TrackingState::kTracked);
    const SE3 motion = again.sample->T_odom_camera.inverse() * tracked.sample->T_odom_camera;
    EXPECT_LT((motion.t - true_motion(next - 1, next).t).norm(), 0.012);
  }
}

TEST(RgbdFrontend, StartsAnewEverMoreRarelyWhereNothingCanBeFollowed) {
  RgbdFrontend frontend({}, kCamera);
  int started = 0;
  constexpr int kImages = 90;
  for (int i = 0; i < kImages; ++i) {
    RgbdImage image = on_walk(0);
    image.stamp_ns = stamp_of(i);
    cv::Mat noise(kCamera.height / 4, kCamera.width / 4, CV_8UC1);
    cv::RNG(static_cast<std::uint64_t>(i + 1)).fill(noise, cv::RNG::UNIFORM, 0, 256);
    cv::resize(noise, image.gray, image.gray.size(), 0.0, 0.0, cv::INTER_NEAREST);
    started += frontend.track(image).state == TrackingState::kStarted ? 1 : 0;
  }
  EXPECT_GE(started, 2);
  EXPECT_LE(started, 8) << "each time it waits for as long as it is old";
}

/// A front end that has followed the walk, was lost and has begun anew at the other end of the room.
RgbdFrontend begun_anew(int walked, int* next_image) {
  FrontendOptions options;
  options.restart_after_s = 0.2;
  RgbdFrontend frontend = after_walk(walked, options);
  TrackedImage tracked;
  for (*next_image = walked; !tracked.sample && *next_image < walked + 20; ++*next_image) {
    tracked = frontend.track(elsewhere(*next_image));
  }
  EXPECT_EQ(tracked.state, TrackingState::kStarted);
  return frontend;
}

TEST(RgbdFrontend, WhatItSawBeforeItBeganAnewIsFoundAgain) {
  constexpr int kWalked = 15;
  int next = 0;
  RgbdFrontend frontend = begun_anew(kWalked, &next);
  const TrackedImage again = frontend.track(kRoom.render(stamp_of(next), pose_on_walk(kInterval_s * 7)));
  ASSERT_EQ(again.state, TrackingState::kLost) << "the new map is asked first";
  TrackedImage found;
  for (int i = 0; i < 5 && !found.sample; ++i) {
    found = frontend.track(kRoom.render(stamp_of(++next), pose_on_walk(kInterval_s * 7)));
  }
  ASSERT_EQ(found.state, TrackingState::kRelocalised);
  EXPECT_TRUE(found.sample->is_break) << "how the two maps lie to each other is not known";
  EXPECT_FALSE(found.sample->is_continuous);
  EXPECT_LT(error_m(found, 7), 0.012) << "in the first map";
  ASSERT_TRUE(found.sample->source_loop);
  EXPECT_LT(found.sample->source_loop->stamp_ns, stamp_of(kWalked));
  EXPECT_LT((found.sample->source_loop->T_odom_camera.t - true_motion(0, 7).t).norm(), 0.012);
}

TEST(RgbdFrontend, AMapFromBeforeALossJoinsTheNewOneWithoutAJump) {
  constexpr int kWalked = 15, kTurn = 40, kStay = 20, kTowards = 7;
  int next = 0;
  RgbdFrontend frontend = begun_anew(kWalked, &next);
  const SE3 T_room_target = pose_on_walk(kInterval_s * kTowards);
  SE3 T_room_before, T_odom_before;
  std::vector<SourceLoop> loops;
  for (int i = 1; i <= kTurn + kStay; ++i, ++next) {
    const double share = std::min(1.0, i / static_cast<double>(kTurn));
    const SE3 T_room_camera(so3_exp(Vec3(0.0, kPi * (1.0 - share), 0.0)) * T_room_target.q,
                            (1.0 - share) * Vec3(0.0, 0.3, 0.5) + share * T_room_target.t);
    const TrackedImage tracked = frontend.track(kRoom.render(stamp_of(next), T_room_camera));
    ASSERT_EQ(tracked.state, TrackingState::kTracked) << i;
    EXPECT_FALSE(tracked.sample->is_break) << i;
    const SE3 true_step = T_room_before.inverse() * T_room_camera;
    const SE3 step = T_odom_before.inverse() * tracked.sample->T_odom_camera;
    if (i > 1) {
      EXPECT_LT((step.t - true_step.t).norm(), 0.03) << i;
    }
    T_room_before = T_room_camera;
    T_odom_before = tracked.sample->T_odom_camera;
    if (!tracked.sample->source_loop) continue;
    loops.push_back(*tracked.sample->source_loop);
    const SE3 truth = pose_on_walk(0.0).inverse() * T_room_camera;  // in the first map
    EXPECT_LT((loops.back().T_odom_camera.t - truth.t).norm(), 0.02) << i;
    EXPECT_LT(degrees(rotation_angle(loops.back().T_odom_camera.q, truth.q)), 0.5) << i;
    EXPECT_LT(loops.back().stamp_ns, stamp_of(kWalked)) << i;
    EXPECT_GE(loops.back().points, 60) << i;
  }
  EXPECT_EQ(loops.size(), 2U) << "seen twice alike, the maps are one";
}

TEST(RgbdFrontend, WhatItSawBeforeASpellOfFewPointsIsFoundAgain) {
  constexpr int kWalked = 20, kSpell = 20, kAfter = 10;
  FrontendOptions options;
  options.self_calibration = false;
  RgbdFrontend frontend = after_walk(kWalked, options);
  int weak = 0, loops = 0;
  for (int i = kWalked; i < kWalked + kSpell + kAfter; ++i) {
    RgbdImage image = on_walk(i);
    const bool is_dim = i < kWalked + kSpell;
    if (is_dim) image.gray.convertTo(image.gray, -1, 0.1, 100.0);
    const TrackedImage tracked = frontend.track(image);
    ASSERT_EQ(tracked.state, TrackingState::kTracked) << i;
    EXPECT_FALSE(tracked.sample->is_break) << i;
    if (is_dim && tracked.inliers < 3 * options.min_inliers) ++weak;
    if (!tracked.sample->source_loop) continue;
    ++loops;
    const SourceLoop& loop = *tracked.sample->source_loop;
    EXPECT_LT((loop.T_odom_camera.t - true_motion(0, i).t).norm(), 0.02) << i;
    EXPECT_LT(degrees(rotation_angle(loop.T_odom_camera.q, true_motion(0, i).q)), 0.5) << i;
  }
  EXPECT_GT(weak, 5);
  EXPECT_GT(loops, 0);
}

TEST(RgbdFrontend, ALossAfterASpellOfFewPointsIsNoBreakOfWhatItSawBefore) {
  constexpr int kWalked = 20, kSpell = 4;
  FrontendOptions options;
  options.self_calibration = false;
  RgbdFrontend frontend = after_walk(kWalked, options);
  for (int i = kWalked; i < kWalked + kSpell; ++i) {
    RgbdImage image = on_walk(i);
    image.gray.convertTo(image.gray, -1, 0.1, 100.0);
    const TrackedImage tracked = frontend.track(image);
    ASSERT_EQ(tracked.state, TrackingState::kTracked) << i;
    EXPECT_LT(tracked.inliers, 3 * options.min_inliers) << i;
  }
  RgbdImage black = on_walk(kWalked + kSpell);
  black.gray.setTo(0);
  ASSERT_EQ(frontend.track(black).state, TrackingState::kUnusable);
  const TrackedImage found = frontend.track(kRoom.render(stamp_of(kWalked + kSpell + 1), pose_on_walk(0.0)));
  ASSERT_EQ(found.state, TrackingState::kRelocalised);
  EXPECT_FALSE(found.sample->is_break);
  EXPECT_TRUE(found.sample->covariance);
  EXPECT_LT(error_m(found, 0), 0.02);
}

TEST(RgbdFrontend, UncertaintyGrowsWithTheTimeNotWithTheImages) {
  constexpr int kBegin = 15, kEnd = 45;              // a second, once points are proven
  Vec2 variances[2] = {Vec2::Zero(), Vec2::Zero()};  // of translation and of rotation
  for (const int stride : {1, 3}) {
    RgbdFrontend frontend({}, kCamera);
    for (int i = 0; i <= kEnd; i += stride) {
      const TrackedImage tracked = frontend.track(on_walk(i));
      ASSERT_TRUE(tracked.sample) << i;
      if (i <= kBegin) continue;
      const Mat6& covariance = *tracked.sample->covariance;
      variances[stride / 3] +=
          Vec2(covariance.topLeftCorner<3, 3>().trace(), covariance.bottomRightCorner<3, 3>().trace());
    }
  }
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(std::log(variances[1](i) / variances[0](i)), 0.0, 0.5) << i;
}

TEST(RgbdFrontend, OfALostImageItIsToldHowFarItCame) {
  RgbdFrontend frontend = after_walk(10);
  RgbdImage image = on_walk(10);
  cv::randu(image.gray(cv::Rect(0, 0, image.gray.cols * 19 / 20, image.gray.rows)), 0, 255);
  const TrackedImage tracked = frontend.track(image);
  ASSERT_EQ(tracked.state, TrackingState::kLost) << tracked.inliers;
  EXPECT_GT(tracked.matches, 0);
}

TEST(RgbdFrontend, WhatItSawBeforeItDriftedIsFoundAgainAcrossTheOffset) {
  // Full turns with a focal length that is too long close some degrees off: 15, or not many pixels more than points are
  // looked for around.
  constexpr int kTurn = 150;  // images, once round
  const auto turned = [](int image) { return SE3(so3_exp(Vec3(0.0, 2.0 * kPi * image / kTurn, 0.0)), Vec3::Zero()); };
  for (const double too_long : {1.04, 1.015}) {
    Camera stated = kCamera;
    stated.fx *= too_long;
    stated.fy *= too_long;
    FrontendOptions options;
    options.self_calibration = false;
    RgbdFrontend frontend(options, stated);
    int loops = 0;
    for (int i = 0; i < kTurn + 15; ++i) {
      const TrackedImage tracked = frontend.track(kRoom.render(stamp_of(i), turned(i)));
      ASSERT_EQ(tracked.state, i == 0 ? TrackingState::kStarted : TrackingState::kTracked) << i;
      if (!tracked.sample->source_loop) continue;
      ++loops;
      const SourceLoop& loop = *tracked.sample->source_loop;
      EXPECT_GE(i, kTurn - 20) << "where the turn closes";
      EXPECT_LT(loop.stamp_ns, stamp_of(20)) << i;
      EXPECT_GE(loop.points, 60) << i;
      const double off_deg = degrees(rotation_angle(tracked.sample->T_odom_camera.q, turned(i).q));
      EXPECT_GT(off_deg, 120.0 * (too_long - 1.0)) << i;
      EXPECT_LT(degrees(rotation_angle(loop.T_odom_camera.q, turned(i).q)), 0.3 * off_deg) << i;
    }
    EXPECT_GT(loops, 0) << too_long;
    EXPECT_LT(loops, 4) << "two sightings each";
  }
}

TEST(RgbdFrontend, DistortedImages) {
  Camera camera = kCamera;
  camera.distortion = {0.2, -0.5, 0.002, -0.001, 0.3};
  const SyntheticRoom room(camera);
  RgbdFrontend frontend({}, camera);
  for (int i = 0; i < 12; ++i) {
    const TrackedImage tracked = frontend.track(room.render(stamp_of(i), pose_on_walk(2.0 * kInterval_s * i)));
    ASSERT_TRUE(tracked.sample) << i;
    EXPECT_LT(error_m(tracked, 2 * i), 0.012) << i;
  }
}

TEST(TrackingReport, CountsAndNames) {
  TrackingReport report;
  TrackedImage image;
  image.state = TrackingState::kStarted;
  image.sample.emplace();
  report.add(image);
  image.state = TrackingState::kTracked;
  report.add(image);
  EXPECT_EQ(report.warning(), "");
  image.state = TrackingState::kLost;
  report.add(image);
  report.add(image);
  report.add_unreadable("rgb/7.png: no such file");
  image.state = TrackingState::kStarted;
  image.sample->is_break = true;
  report.add(image);
  EXPECT_EQ(report.images, 6);
  EXPECT_EQ(report.restarts, 1);
  EXPECT_EQ(report.warning(),
            "of 6 images: 2 lost, 1 unreadable, 1 starts anew (first unreadable: rgb/7.png: no such file)");
}

TEST(FrontendOptions, BadValuesAreNamed) {
  FrontendOptions options;
  EXPECT_TRUE(validate(options)) << validate(options).message();
  options.scale_factor = 1.0;
  EXPECT_EQ(validate(options).message(), "parameter 'frontend.scale_factor' = '1' must be in (1, 2]");
  options = {};
  options.max_keyframes = 3;
  EXPECT_EQ(validate(options).message(),
            "parameter 'frontend.max_keyframes' = '3' must be >= 2 frontend.window_keyframes");
}

}  // namespace
}  // namespace semantic_topo_loop::core
