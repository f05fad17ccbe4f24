#include "ros/worker.h"

#include <algorithm>
#include <exception>
#include <utility>

namespace semantic_topo_loop {

Worker::Worker(std::size_t capacity, ErrorHandler on_error)
    : capacity_(std::max<std::size_t>(capacity, 1)), on_error_(std::move(on_error)) {}

void Worker::start() {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!closed_ && !thread_.joinable()) thread_ = std::thread([this] { run(); });
}

void Worker::push(Task task, Keep keep, const std::string& topic) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (closed_) return;
    // Of the capacity, for tasks that must not be dropped: with so many waiting the stage has stopped, and memory
    // counts.
    if (queue_.size() >= kRoomForState * capacity_) drop(Keep::kAlways);
    if (keep == Keep::kDroppable) {
      if (droppable_ == capacity_) drop(Keep::kDroppable);
      ++droppable_;
    }
    queue_.push_back({std::move(task), keep, topic});
  }
  wake_.notify_one();
}

void Worker::drop(Keep most) {
  const auto oldest =
      std::find_if(queue_.begin(), queue_.end(), [most](const Entry& entry) { return entry.keep <= most; });
  if (oldest == queue_.end()) return;
  if (oldest->keep == Keep::kDroppable) --droppable_;
  ++dropped_[oldest->topic];
  queue_.erase(oldest);
}

void Worker::close() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    closed_ = true;
    queue_.clear();
    droppable_ = 0;
  }
  wake_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Worker::run() {
  while (true) {
    Entry entry;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      is_busy_ = false;
      wake_.wait(lock, [this] { return closed_ || !queue_.empty(); });
      if (closed_) return;
      entry = std::move(queue_.front());
      queue_.pop_front();
      if (entry.keep == Keep::kDroppable) --droppable_;
      is_busy_ = true;
    }
    try {
      entry.task();
    } catch (const std::exception& exception) {
      if (on_error_) on_error_(exception.what());
    } catch (...) {
      if (on_error_) on_error_("unknown exception");
    }
  }
}

}  // namespace semantic_topo_loop
