#pragma once

#include <cstdint>
#include <map>

#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Poses of one moving frame in time order, read at any stamp between two of them. Interpolates over gaps of at most
/// `max_gap_s` and never extrapolates: a pose that nobody measured is worse than none.
class PoseBuffer {
 public:
  enum class Status {
    kFound,
    kNotYet,  ///< newer than every sample: a later one may still bracket it
    kTooOld,  ///< older than every sample
    kGap,     ///< the samples around it are too far apart
  };
  struct Answer {
    Status status = Status::kNotYet;
    SE3 pose;  ///< if found
  };

  /// @param max_gap_s between the two samples around a stamp, > 0   @param keep_s samples older than the newest one by
  /// more are forgotten
  explicit PoseBuffer(double max_gap_s, double keep_s = 60.0);

  /// Takes a sample; one that arrives out of order is sorted in.
  /// @return an error, with the stamp and the value, for a non-finite pose, a quaternion whose norm is off by
  /// more than 1 %, a stamp that is there already, or one that is older than what is kept
  core::Status add(std::int64_t stamp_ns, const SE3& pose);
  Answer at(std::int64_t stamp_ns) const;
  void clear() { samples_.clear(); }
  bool empty() const { return samples_.empty(); }
  /// Whether no two samples around and between these stamps are too far apart.
  bool is_continuous(std::int64_t from_ns, std::int64_t to_ns) const;
  bool has(std::int64_t stamp_ns) const { return samples_.count(stamp_ns) > 0; }
  /// Of the newest sample; the buffer must not be empty.
  std::int64_t newest_ns() const { return samples_.rbegin()->first; }

 private:
  std::int64_t max_gap_ns_;
  std::int64_t keep_ns_;
  std::map<std::int64_t, SE3> samples_;
};

/// What a status means to the user: "the poses around this stamp are too far apart".
const char* describe(PoseBuffer::Status status);

}  // namespace semantic_topo_loop::core
