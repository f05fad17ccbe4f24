#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace semantic_topo_loop {

/// Counters of one stage for its diagnostics. Thread-safe.
class StageStatistics {
 public:
  using Clock = std::chrono::steady_clock;

  /// A look at the counters; rates are since the previous look.
  struct Snapshot {
    std::map<std::string, double> input_rates_hz;
    double processed_hz = 0.0;
    std::uint64_t processed = 0;
    std::map<std::string, std::uint64_t> counters;
    double latency_p50_ms = 0.0, latency_p95_ms = 0.0;  ///< of the last 512 frames
    std::string failure;                                ///< empty while the stage works
  };

  void count_input(const std::string& topic);
  void count_processed(Clock::time_point arrival);
  /// Adds to a named counter ("incomplete frames"), which is shown even while it is zero once declared.
  void count(const std::string& counter, std::uint64_t n = 1);
  /// Counts one. @return whether it is the counter's first
  bool count_first(const std::string& counter);
  /// Sets a named counter that somebody else counts.
  void set(const std::string& counter, std::uint64_t value);
  void set_failure(const std::string& failure);
  Snapshot take_snapshot();

 private:
  std::mutex mutex_;  ///< guards all below
  std::map<std::string, std::uint64_t> inputs_, inputs_before_;
  std::map<std::string, std::uint64_t> counters_;
  std::uint64_t processed_ = 0, processed_before_ = 0;
  std::vector<double> latencies_ms_;  ///< ring of the last frames
  std::size_t next_latency_ = 0;
  std::string failure_;
  Clock::time_point last_snapshot_ = Clock::now();
};

}  // namespace semantic_topo_loop
