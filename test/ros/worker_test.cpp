#include "ros/worker.h"

#include <gtest/gtest.h>

#include <future>
#include <stdexcept>
#include <vector>

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
  std::vector<int> order;
  for (int i = 0; i < 500; ++i) {
    worker.push([&order, i] { order.push_back(i); }, i % 3 == 0 ? Keep::kAlways : Keep::kDroppable);
  }
  drain(&worker);
  ASSERT_EQ(order.size(), 500u);
  for (int i = 0; i < 500; ++i) EXPECT_EQ(order[static_cast<std::size_t>(i)], i);
  EXPECT_EQ(worker.dropped(), 0u);
}

TEST(Worker, DropsTheOldestDroppableWhenFull) {
  Gate gate;
  Worker worker(3, {});
  gate.block(&worker);
  std::vector<int> order;
  worker.push([&order] { order.push_back(100); }, Keep::kAlways);
  for (int i = 0; i < 8; ++i) worker.push([&order, i] { order.push_back(i); });
  EXPECT_EQ(worker.dropped(), 5u);
  gate.open();
  drain(&worker);
  EXPECT_EQ(order, (std::vector<int>{100, 5, 6, 7}));
}

TEST(Worker, BoundsEvenWhatIsKept) {
  Gate gate;
  Worker worker(2, {});
  gate.block(&worker);
  for (int i = 0; i < 1000; ++i) worker.push([] {}, Keep::kAlways);
  EXPECT_EQ(worker.size(), 32u);
  EXPECT_EQ(worker.dropped(), 968u);
  gate.open();
}

TEST(Worker, SurvivesATaskThatThrows) {
  std::vector<std::string> errors;
  Worker worker(10, [&errors](const std::string& what) { errors.push_back(what); });
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

}  // namespace
}  // namespace semantic_topo_loop
