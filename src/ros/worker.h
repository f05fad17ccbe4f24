#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>

namespace semantic_topo_loop {

/// Whether a task may be given up when its stage cannot keep up.
enum class Keep {
  kDroppable,  ///< a frame's data: the oldest goes when the queue is full, counted
  kAlways,     ///< state that later tasks build on, as map updates: goes only where a stage has stopped, counted
  kPinned,     ///< sessions, timers, the end of a stream: without them nothing would go on
};

/// Of what is not droppable so many times as many are held, in roscpp's queues and in the worker's.
constexpr std::uint32_t kRoomForState = 16;

/// A bounded queue and one thread that runs its tasks in order of arrival, once it was started. Pushing never waits.
class Worker {
 public:
  using Task = std::function<void()>;
  using ErrorHandler = std::function<void(const std::string& what)>;

  /// @param capacity droppable tasks held, at least 1   @param on_error called on the worker's thread for a task that
  /// threw; the next task runs all the same
  Worker(std::size_t capacity, ErrorHandler on_error);
  ~Worker() { close(); }
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  void start();
  /// Drops the oldest droppable task when `capacity` of them wait, and the oldest that is not pinned when kRoomForState
  /// times as many tasks of any kind do. After close() nothing is taken.
  /// @param topic what brought the task, to count drops by
  void push(Task task, Keep keep = Keep::kDroppable, const std::string& topic = {});
  /// Forgets what waits, lets the running task end, and joins the thread. Never call it from a task.
  void close();

  /// Tasks dropped, by topic.
  std::map<std::string, std::uint64_t> dropped() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return dropped_;
  }
  std::size_t size() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return queue_.size();
  }
  /// Whether a task is running.
  bool is_busy() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return is_busy_;
  }

 private:
  struct Entry {
    Task task;
    Keep keep;
    std::string topic;
  };
  void run();
  /// Drops the oldest task of at most this kind, if there is one.
  void drop(Keep most);

  const std::size_t capacity_;
  const ErrorHandler on_error_;
  mutable std::mutex mutex_;  ///< guards all below but thread_
  std::condition_variable wake_;
  std::deque<Entry> queue_;
  std::size_t droppable_ = 0;
  std::map<std::string, std::uint64_t> dropped_;
  bool is_busy_ = false;
  bool closed_ = false;
  std::thread thread_;
};

}  // namespace semantic_topo_loop
