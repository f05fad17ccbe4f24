#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

namespace semantic_topo_loop::core {

/// Reads the items of a recording in a thread of its own, some ahead of who uses them, in their order.
template <class Item>
class ReadAhead {
 public:
  /// @param read called on that thread alone, until it gives nullopt   @param capacity items held at most
  ReadAhead(std::function<std::optional<Item>()> read, std::size_t capacity)
      : read_(std::move(read)), capacity_(capacity), thread_([this] { run(); }) {}
  ~ReadAhead() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  ReadAhead(const ReadAhead&) = delete;
  ReadAhead& operator=(const ReadAhead&) = delete;

  /// Waits for the next item. @return nullopt at the end
  std::optional<Item> next() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return !items_.empty() || is_at_end_; });
    if (items_.empty()) return std::nullopt;
    std::optional<Item> item = std::move(items_.front());
    items_.pop_front();
    changed_.notify_all();
    return item;
  }

 private:
  void run() {
    while (true) {
      std::optional<Item> item = read_();
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [this] { return stop_ || items_.size() < capacity_; });
      if (stop_) return;
      is_at_end_ = !item;
      if (item) items_.push_back(std::move(*item));
      changed_.notify_all();
      if (is_at_end_) return;
    }
  }

  const std::function<std::optional<Item>()> read_;
  const std::size_t capacity_;
  std::mutex mutex_;  ///< guards all below but the thread
  std::condition_variable changed_;
  std::deque<Item> items_;
  bool is_at_end_ = false;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace semantic_topo_loop::core
