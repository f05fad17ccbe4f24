#include "ros/stage.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <future>
#include <stdexcept>
#include <string>
#include <vector>

#include "ros/frame_joiner.h"
#include "ros/worker.h"
#include "support/test_files.h"

namespace semantic_topo_loop {
namespace {

/// Keeps the worker busy until it is opened. Must outlive the worker.
class Gate {
 public:
  void block(Worker* worker) {
    worker->push([this] {
      entered_.set_value();
      opened_.get_future().wait();
    });
    entered_.get_future().wait();
  }
  void open() { opened_.set_value(); }

 private:
  std::promise<void> entered_, opened_;
};

/// Waits until all that was pushed has run.
void drain(Worker* worker) {
  std::promise<void> done;
  worker->push([&done] { done.set_value(); }, Keep::kAlways);
  done.get_future().wait();
}

TEST(Worker, RunsInOrderOfArrival) {
  Worker worker(1000, {});
  worker.start();
  std::vector<int> order;
  for (int i = 0; i < 500; ++i) {
    worker.push([&order, i] { order.push_back(i); }, i % 3 == 0 ? Keep::kAlways : Keep::kDroppable);
  }
  drain(&worker);
  ASSERT_EQ(order.size(), 500u);
  for (int i = 0; i < 500; ++i) EXPECT_EQ(order[static_cast<std::size_t>(i)], i);
  EXPECT_TRUE(worker.dropped().empty());
}

TEST(Worker, DropsTheOldestDroppableWhenFull) {
  Gate gate;
  Worker worker(3, {});
  worker.start();
  gate.block(&worker);
  std::vector<int> order;
  worker.push([&order] { order.push_back(100); }, Keep::kAlways);
  for (int i = 0; i < 8; ++i) worker.push([&order, i] { order.push_back(i); }, Keep::kDroppable, i < 2 ? "a" : "b");
  EXPECT_EQ(worker.dropped(), (std::map<std::string, std::uint64_t>{{"a", 2}, {"b", 3}}));
  gate.open();
  drain(&worker);
  EXPECT_EQ(order, (std::vector<int>{100, 5, 6, 7}));
}

TEST(Worker, BoundsEvenWhatIsKeptButNeverDropsWhatIsPinned) {
  Gate gate;
  Worker worker(2, {});
  worker.start();
  gate.block(&worker);
  std::vector<int> pinned;
  worker.push([&pinned] { pinned.push_back(0); }, Keep::kPinned, "timer");
  for (int i = 0; i < 1000; ++i) worker.push([] {}, Keep::kAlways, "updates");
  EXPECT_EQ(worker.size(), 32u);
  EXPECT_EQ(worker.dropped(), (std::map<std::string, std::uint64_t>{{"updates", 969}}));
  for (int i = 1; i < 50; ++i) worker.push([&pinned, i] { pinned.push_back(i); }, Keep::kPinned, "session");
  EXPECT_EQ(worker.size(), 50u) << "pinned ones take the place of the others, and more if need be";
  gate.open();
  drain(&worker);
  ASSERT_EQ(pinned.size(), 50u);
  for (int i = 0; i < 50; ++i) EXPECT_EQ(pinned[static_cast<std::size_t>(i)], i);
}

TEST(Worker, KeepsWhatComesBeforeItIsStarted) {
  Worker worker(10, {});
  std::vector<int> order;
  for (int i = 0; i < 3; ++i) worker.push([&order, i] { order.push_back(i); });
  EXPECT_FALSE(worker.is_busy());
  EXPECT_EQ(worker.size(), 3u);
  worker.start();
  drain(&worker);
  EXPECT_EQ(order, (std::vector<int>{0, 1, 2}));
}

TEST(Worker, SaysWhileItWorks) {
  Gate gate;
  Worker worker(10, {});
  worker.start();
  gate.block(&worker);
  EXPECT_TRUE(worker.is_busy());
  gate.open();
  while (worker.is_busy()) std::this_thread::yield();
}

TEST(Worker, SurvivesATaskThatThrows) {
  std::vector<std::string> errors;
  Worker worker(10, [&errors](const std::string& what) { errors.push_back(what); });
  worker.start();
  worker.push([] { throw std::runtime_error("bad frame"); });
  worker.push([] { throw 1; });
  bool ran = false;
  worker.push([&ran] { ran = true; });
  drain(&worker);
  EXPECT_TRUE(ran);
  EXPECT_EQ(errors, (std::vector<std::string>{"bad frame", "unknown exception"}));
}

TEST(Worker, CloseForgetsWhatWaitsAndTakesNothingMore) {
  Gate gate;
  Worker worker(10, {});
  worker.start();
  gate.block(&worker);
  bool ran = false;
  worker.push([&ran] { ran = true; });
  std::thread closer([&worker] { worker.close(); });
  while (worker.size() > 0) std::this_thread::yield();
  gate.open();
  closer.join();
  worker.push([&ran] { ran = true; });
  worker.close();
  EXPECT_FALSE(ran);
  EXPECT_EQ(worker.size(), 0u);
}

TEST(Stage, PathsOfServicesLieBelowTheirDirectoryByLinksToo) {
  struct Open : Stage {
    using Stage::path_below;
  };
  const core::TestDirectory directory;
  const std::string root = directory.path("maps");
  std::filesystem::create_directory(root);
  std::filesystem::create_symlink(directory.path("elsewhere.db"), root + "/link.db");  // which is not there
  EXPECT_EQ(*Open::path_below(root, "a.db", false), std::filesystem::canonical(root).string() + "/a.db");
  for (const char* outside : {"../a.db", "/etc/passwd", "link.db", "."}) {
    EXPECT_NE(Open::path_below(root, outside, false).message().find("is not below"), std::string::npos) << outside;
  }
  EXPECT_TRUE(Open::path_below(root, "../a.db", true));
}

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

TEST(StageStatistics, KeepsTheFailureWhateverElseSucceeds) {
  StageStatistics statistics;
  statistics.set_failure("stage", "no such map");
  statistics.set_failure("results", "disk full");
  EXPECT_EQ(statistics.take_snapshot().failure, "disk full; no such map");
  statistics.set_failure("results", "");
  EXPECT_EQ(statistics.take_snapshot().failure, "no such map");
}

TEST(StageStatistics, WarnsOfLossesWhileTheyGoOn) {
  using std::chrono::seconds;
  StageStatistics statistics;
  const StageStatistics::Clock::time_point begin = StageStatistics::Clock::now();
  const auto warns_after = [&](int s) { return !statistics.take_snapshot(begin + seconds(s)).warnings.empty(); };
  statistics.count("dropped, other session");
  statistics.set_lost("dropped", 0);
  EXPECT_FALSE(warns_after(0));
  statistics.set_lost("dropped", 3);
  EXPECT_TRUE(warns_after(9));
  EXPECT_FALSE(warns_after(60)) << "over";
  statistics.set_lost("dropped", 3);
  EXPECT_FALSE(warns_after(60)) << "nothing new";
  statistics.count_lost("never arrived", 2);
  EXPECT_EQ(statistics.take_snapshot().warnings, std::vector<std::string>{"frames were lost"});
  EXPECT_EQ(statistics.take_snapshot().counters.at("never arrived"), 2u);
}

TEST(StageStatistics, ShowsTextsAsTheyWereSetLast) {
  StageStatistics statistics;
  for (const char* text : {"none", "4 ms"}) statistics.set_text("last optimisation", text);
  EXPECT_EQ(statistics.take_snapshot().texts.at("last optimisation"), "4 ms");
}

using Joiner = FrameJoiner<int, std::string>;

TEST(FrameJoiner, JoinsInWhateverOrderTheKindsCome) {
  Joiner joiner(10);
  EXPECT_FALSE(joiner.add<0>(0, 10));
  const auto first = joiner.add<1>(0, "a");
  ASSERT_TRUE(first);
  EXPECT_EQ(*first, Joiner::Set(10, "a"));
  EXPECT_FALSE(joiner.add<1>(1, "b"));
  const auto second = joiner.add<0>(1, 11);
  ASSERT_TRUE(second);
  EXPECT_EQ(*second, Joiner::Set(11, "b"));
  EXPECT_EQ(joiner.size(), 0u);
}

TEST(FrameJoiner, EvictsOlderIncompleteFramesWhenANewerCompletes) {
  std::vector<std::int64_t> evicted;
  Joiner joiner(10, [&evicted](std::int64_t frame_id, const Joiner::Partial& partial) {
    evicted.push_back(frame_id);
    EXPECT_EQ(std::get<0>(partial).has_value(), frame_id != 2);
    EXPECT_EQ(std::get<1>(partial).has_value(), frame_id == 2);
  });
  joiner.add<0>(1, 1);
  joiner.add<1>(2, "two");
  joiner.add<0>(4, 4);
  joiner.add<0>(3, 3);
  ASSERT_TRUE(joiner.add<1>(3, "three"));
  EXPECT_EQ(evicted, (std::vector<std::int64_t>{1, 2}));
  EXPECT_EQ(joiner.evicted(), 2u);
  EXPECT_EQ(joiner.size(), 1u);
  ASSERT_TRUE(joiner.add<1>(4, "four"));
}

TEST(FrameJoiner, DoesNotGoBack) {
  Joiner joiner(10);
  joiner.add<0>(5, 5);
  ASSERT_TRUE(joiner.add<1>(5, "five"));
  EXPECT_TRUE(joiner.is_past(5));
  EXPECT_FALSE(joiner.is_past(6));
  EXPECT_FALSE(joiner.add<0>(4, 4));
  EXPECT_FALSE(joiner.add<1>(4, "four"));
}

TEST(FrameJoiner, IsBounded) {
  Joiner joiner(3);
  for (int i = 0; i < 10; ++i) joiner.add<0>(i, i);
  EXPECT_EQ(joiner.size(), 3u);
  EXPECT_EQ(joiner.evicted(), 7u);
  EXPECT_FALSE(joiner.add<1>(6, "evicted already"));
  EXPECT_TRUE(joiner.add<1>(7, "oldest held"));
}

TEST(FrameJoiner, ClearBeginsAnew) {
  Joiner joiner(3);
  joiner.add<0>(5, 5);
  joiner.add<1>(5, "five");
  joiner.add<0>(6, 6);
  joiner.clear();
  joiner.add<0>(0, 0);
  EXPECT_TRUE(joiner.add<1>(0, "zero"));
}

}  // namespace
}  // namespace semantic_topo_loop
