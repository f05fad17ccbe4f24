#include "ros/playback.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

constexpr std::uint32_t kSession = 7;
constexpr std::int64_t kInterval_ns = 33'000'000;

std::int64_t stamp_of(int image) { return 1'000'000'000 + image * kInterval_ns; }

/// A session whose first images are on their way, those that the front end has numbered as frames.
PlayerLedger playing(int images, const std::vector<int>& numbered) {
  PlayerLedger ledger("RgbdFrontend", {}, false);
  SessionControl start;
  start.session_id = kSession;
  start.command = SessionControl::COMMAND_START;
  ledger.take(start);
  for (int image = 0; image < images; ++image) ledger.sent(stamp_of(image));
  for (std::size_t k = 0; k < numbered.size(); ++k) {
    ledger.numbered(kSession, stamp_of(numbered[k]), static_cast<std::int64_t>(k), false);
  }
  return ledger;
}

FrameDone done(int image, std::uint8_t status) {
  FrameDone done;
  done.header.stamp = to_ros_time(stamp_of(image));
  done.session_id = kSession;
  done.status = status;
  return done;
}

TEST(PlayerLedger, AFrameThatLeavesTheChainAnswersAllBeforeIt) {
  PlayerLedger ledger = playing(4, {0, 2, 3});
  ledger.done(done(2, FrameDone::STATUS_PROCESSED));
  EXPECT_EQ(ledger.in_flight(), 1U);
  EXPECT_EQ(ledger.frames_done(), 1U);
}

TEST(PlayerLedger, ARefusedImageAnswersThoseThatTheFrontEndDropped) {
  PlayerLedger ledger = playing(4, {0});
  ledger.done(done(3, FrameDone::STATUS_NO_POSE));
  EXPECT_EQ(ledger.in_flight(), 1U) << "the frame is still in the chain, two images were dropped";
  EXPECT_EQ(ledger.frames_done(), 1U);
  EXPECT_EQ(ledger.frames_without_pose(), 1U);
  ledger.done(done(0, FrameDone::STATUS_PROCESSED));
  EXPECT_EQ(ledger.in_flight(), 0U);
}

TEST(PlayerLedger, AnImageThatIsRefusedOutOfTurnAnswersForItselfAlone) {
  PlayerLedger ledger = playing(3, {});
  ledger.done(done(2, FrameDone::STATUS_FAILED));
  EXPECT_EQ(ledger.in_flight(), 2U);
}

TEST(PlayerLedger, NamesTheStageThatTheOldestFrameWaitsFor) {
  PlayerLedger ledger = playing(3, {1});  // the first one was dropped
  EXPECT_EQ(ledger.silent_stage(), "DetectionIngestion");
  ledger.seen(PlayerLedger::kDetections, kSession, 0);
  EXPECT_EQ(ledger.silent_stage(), "ObjectAssociation");
  ledger.done(done(1, FrameDone::STATUS_PROCESSED));
  EXPECT_EQ(ledger.silent_stage(), "RgbdFrontend");
}

}  // namespace
}  // namespace semantic_topo_loop
