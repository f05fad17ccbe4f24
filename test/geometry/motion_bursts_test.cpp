#include "semantic_topo_loop/geometry/motion_bursts.h"

#include <gtest/gtest.h>

#include <cmath>

#include "semantic_topo_loop/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

TEST(MotionBursts, FindsABurstAndNothingElse) {
  constexpr int kFrames = 300, kFramesPerSection = 5, kBurst = 150;
  constexpr std::int64_t kIntervalNs = 33'333'333;
  Random random(4);
  MotionBursts bursts;
  SE3 pose;
  bursts.push({0, pose}, false, 0);
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += 0.01 * std::sin(0.02 * k);
    if (k >= kBurst && k < kBurst + 5) motion(1) += 0.04;
    pose = pose * se3_exp(motion);
    bursts.push({(k + 1) * kIntervalNs, pose}, false, static_cast<std::size_t>(k / kFramesPerSection));
  }
  for (std::size_t i = 0; i < kFrames / kFramesPerSection; ++i) {
    if (i == kBurst / kFramesPerSection) {
      EXPECT_NEAR(bursts.suspect(i).head<3>().norm(), 0.2, 0.02);
    } else {
      EXPECT_LT(bursts.suspect(i).head<3>().norm(), 0.005) << i;
    }
  }
  EXPECT_EQ(bursts.suspect(kFrames), Vec6(Vec6::Zero()));
}

TEST(MotionBursts, ABreakIsNoBurstAndAPoseThatIsNotLaterNoMotion) {
  constexpr int kFrames = 200, kBreak = 150;
  constexpr std::int64_t kIntervalNs = 33'333'333;
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
  EXPECT_LT(bursts.suspect(0).head<3>().norm(), 0.005);
}

}  // namespace
}  // namespace semantic_topo_loop::core
