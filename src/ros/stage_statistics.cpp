#include "ros/stage_statistics.h"

#include <algorithm>

namespace semantic_topo_loop {
namespace {

constexpr std::size_t kLatencies = 512;  ///< of the last frames: some 17 s at 30 Hz

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto rank = static_cast<std::size_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(rank), values.end());
  return values[rank];
}

}  // namespace

void StageStatistics::count_input(const std::string& topic) {
  const std::lock_guard<std::mutex> lock(mutex_);
  ++inputs_[topic];
}

void StageStatistics::count_processed(Clock::time_point arrival) {
  const double latency_ms = std::chrono::duration<double, std::milli>(Clock::now() - arrival).count();
  const std::lock_guard<std::mutex> lock(mutex_);
  ++processed_;
  if (latencies_ms_.size() < kLatencies) {
    latencies_ms_.push_back(latency_ms);
  } else {
    latencies_ms_[next_latency_] = latency_ms;
    next_latency_ = (next_latency_ + 1) % kLatencies;
  }
}

void StageStatistics::count(const std::string& counter, std::uint64_t n) {
  const std::lock_guard<std::mutex> lock(mutex_);
  counters_[counter] += n;
}

bool StageStatistics::count_first(const std::string& counter) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return ++counters_[counter] == 1;
}

void StageStatistics::set(const std::string& counter, std::uint64_t value) {
  const std::lock_guard<std::mutex> lock(mutex_);
  counters_[counter] = value;
}

void StageStatistics::set_failure(const std::string& failure) {
  const std::lock_guard<std::mutex> lock(mutex_);
  failure_ = failure;
}

StageStatistics::Snapshot StageStatistics::take_snapshot() {
  const std::lock_guard<std::mutex> lock(mutex_);
  const Clock::time_point now = Clock::now();
  const double elapsed_s = std::max(1e-3, std::chrono::duration<double>(now - last_snapshot_).count());
  Snapshot snapshot;
  for (const auto& [topic, n] : inputs_) {
    snapshot.input_rates_hz[topic] = static_cast<double>(n - inputs_before_[topic]) / elapsed_s;
  }
  snapshot.processed = processed_;
  snapshot.processed_hz = static_cast<double>(processed_ - processed_before_) / elapsed_s;
  snapshot.counters = counters_;
  snapshot.latency_p50_ms = percentile(latencies_ms_, 0.50);
  snapshot.latency_p95_ms = percentile(latencies_ms_, 0.95);
  snapshot.failure = failure_;
  inputs_before_ = inputs_;
  processed_before_ = processed_;
  last_snapshot_ = now;
  return snapshot;
}

}  // namespace semantic_topo_loop
