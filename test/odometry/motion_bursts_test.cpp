#include "odometry/motion_bursts.h"

#include <gtest/gtest.h>

#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFrames = 300, kFramesPerSection = 5;
constexpr std::int64_t kIntervalNs = 33'333'333;

/// A shaky camera that turns on its way; from frame `first` on the odometry adds `jump` in equal parts over `frames`.
/// @return what it added, in the axes of the odometry
Vec6 feed(MotionBursts* bursts, int first, int frames, const Vec6& jump) {
  Random random(4);
  SE3 pose;
  Vec6 added = Vec6::Zero();
  bursts->push({0, pose}, false, 0);
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += 0.01 * std::sin(0.02 * k);
    motion(5) += 0.02;
    pose = pose * se3_exp(motion);
    if (k >= first && k < first + frames) {
      pose = pose * se3_exp(jump / frames);
      added.head<3>() += pose.q * jump.head<3>() / frames;
      added.tail<3>() += pose.q * jump.tail<3>() / frames;
    }
    bursts->push({(k + 1) * kIntervalNs, pose}, false, static_cast<std::size_t>(k / kFramesPerSection));
  }
  return added;
}

TEST(MotionBursts, FindsHowFarABurstJumpedAndNothingElse) {
  Vec6 jump;
  jump << 0.05, 0.15, -0.08, 0.03, -0.04, 0.02;
  for (const int frames : {1, 3, 5, 8, 11}) {
    MotionBursts bursts;
    const Vec6 added = feed(&bursts, 148, frames, jump);
    Vec6 sum = Vec6::Zero();
    double error_m = 0.0, error_rad = 0.0;
    for (std::size_t i = 0; i <= kFrames / kFramesPerSection; ++i) {
      const MotionBursts::Suspect suspect = bursts.suspect(i);
      const bool is_within = i >= 147 / kFramesPerSection && i <= (150 + static_cast<std::size_t>(frames)) / 5;
      if (!is_within) {
        EXPECT_LT(suspect.motion.norm(), 0.003) << i;
      }
      sum += suspect.motion;
      error_m += suspect.error_m;
      error_rad += suspect.error_rad;
    }
    EXPECT_LT((sum - added).head<3>().norm(), 0.02) << frames;
    EXPECT_LT((sum - added).tail<3>().norm(), 0.03) << frames;
    EXPECT_GT(error_m, 0.0005);
    EXPECT_LT(error_m, 0.02);
    EXPECT_GT(error_rad, 0.0005);
    EXPECT_LT(error_rad, 0.03);
  }
}

TEST(MotionBursts, AShakyHandIsNoBurst) {
  MotionBursts bursts;
  feed(&bursts, 0, 0, Vec6::Zero());
  for (std::size_t i = 0; i <= kFrames / kFramesPerSection; ++i) {
    EXPECT_LT(bursts.suspect(i).motion.head<3>().norm(), 0.003) << i;
    EXPECT_LT(bursts.suspect(i).motion.tail<3>().norm(), 0.01) << i;
  }
}

TEST(MotionBursts, ABreakIsNoBurstAndAPoseThatIsNotLaterNoMotion) {
  constexpr int kBreak = 150;
  Random random(4);
  MotionBursts bursts;
  SE3 pose;
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    pose = pose * se3_exp(motion);
    if (k == kBreak) pose.t.x() += 5.0;
    bursts.push({k * kIntervalNs, pose}, k == kBreak, 0);
    pose.t.y() += 1.0;
    bursts.push({k * kIntervalNs, pose}, false, 0);
  }
  EXPECT_LT(bursts.suspect(0).motion.head<3>().norm(), 0.005);
}

}  // namespace
}  // namespace semantic_topo_loop::core
