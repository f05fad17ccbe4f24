#include "semantic_topo_loop/geometry/motion_bursts.h"

#include <gtest/gtest.h>

#include <cmath>

#include "semantic_topo_loop/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

TEST(MotionBursts, FindsABurstAndNothingElse) {
  constexpr int kFrames = 300, kFramesPerSection = 5, kBurst = 150;
  constexpr double kInterval_s = 1.0 / 30.0;
  Random random(4);
  MotionBursts bursts;
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += 0.01 * std::sin(0.02 * k);
    if (k >= kBurst && k < kBurst + 5) motion(1) += 0.04;
    bursts.add(se3_exp(motion), kInterval_s, static_cast<std::size_t>(k / kFramesPerSection));
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

}  // namespace
}  // namespace semantic_topo_loop::core
