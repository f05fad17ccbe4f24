#include "ros/stage_statistics.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop {
namespace {

TEST(StageStatistics, CountsInputsFramesAndNamedCounters) {
  StageStatistics statistics;
  statistics.count("dropped", 0);
  statistics.count("loops");
  statistics.count("loops", 2);
  statistics.set("queue", 7);
  for (int i = 0; i < 3; ++i) statistics.count_input("frames");
  statistics.count_processed(StageStatistics::Clock::now());
  const StageStatistics::Snapshot snapshot = statistics.take_snapshot();
  EXPECT_EQ(snapshot.counters.at("dropped"), 0u);
  EXPECT_EQ(snapshot.counters.at("loops"), 3u);
  EXPECT_EQ(snapshot.counters.at("queue"), 7u);
  EXPECT_EQ(snapshot.processed, 1u);
  EXPECT_GT(snapshot.input_rates_hz.at("frames"), 0.0);
  EXPECT_EQ(snapshot.failure, "");
}

TEST(StageStatistics, RatesCoverOnlyTheTimeSinceTheLastLook) {
  StageStatistics statistics;
  statistics.count_input("frames");
  statistics.take_snapshot();
  const StageStatistics::Snapshot snapshot = statistics.take_snapshot();
  EXPECT_EQ(snapshot.input_rates_hz.at("frames"), 0.0);
  EXPECT_EQ(snapshot.processed_hz, 0.0);
}

TEST(StageStatistics, LatencyPercentilesAreOfTheLastFrames) {
  using std::chrono::hours;
  StageStatistics statistics;
  // 1000 old frames of ten hours each are forgotten; then 512 of which one in ten took an hour.
  constexpr double kHourMs = 3600e3;
  for (int i = 0; i < 1000; ++i) statistics.count_processed(StageStatistics::Clock::now() - hours(10));
  for (int i = 0; i < 512; ++i) {
    statistics.count_processed(StageStatistics::Clock::now() - hours(i % 10 == 0 ? 1 : 0));
  }
  const StageStatistics::Snapshot snapshot = statistics.take_snapshot();
  EXPECT_LT(snapshot.latency_p50_ms, kHourMs);
  EXPECT_GE(snapshot.latency_p95_ms, kHourMs);
  EXPECT_LT(snapshot.latency_p95_ms, 10.0 * kHourMs);
}

TEST(StageStatistics, KeepsTheFailure) {
  StageStatistics statistics;
  statistics.set_failure("parameter 'x' = 1 must be 2");
  EXPECT_EQ(statistics.take_snapshot().failure, "parameter 'x' = 1 must be 2");
}

}  // namespace
}  // namespace semantic_topo_loop
