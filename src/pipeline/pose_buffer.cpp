#include "semantic_topo_loop/pipeline/pose_buffer.h"

#include <array>
#include <cmath>
#include <sstream>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

std::int64_t to_nanoseconds(double seconds) { return static_cast<std::int64_t>(std::llround(seconds * 1e9)); }

/// @return empty if the pose can be used
std::string find_fault(const SE3& pose) {
  std::ostringstream fault;
  if (!pose.t.allFinite()) {
    fault << "translation (" << pose.t.transpose() << ") is not finite";
  } else if (!pose.q.coeffs().allFinite()) {
    fault << "quaternion (" << pose.q.coeffs().transpose() << ") is not finite";
  } else if (!is_rotation(pose.q)) {
    fault << "quaternion (" << pose.q.coeffs().transpose() << ") has norm " << pose.q.norm() << ", not 1";
  }
  return fault.str();
}

}  // namespace

PoseBuffer::PoseBuffer(double max_gap_s, double keep_s)
    : max_gap_ns_(to_nanoseconds(max_gap_s)), keep_ns_(to_nanoseconds(keep_s)) {}

core::Status PoseBuffer::add(std::int64_t stamp_ns, const SE3& pose) {
  std::string fault = find_fault(pose);
  if (fault.empty() && !samples_.empty() && stamp_ns < newest_ns() - keep_ns_) fault = "is older than what is kept";
  if (fault.empty() && !samples_.try_emplace(stamp_ns, pose.q.normalized(), pose.t).second) {
    fault = "has a stamp that is there already";
  }
  if (!fault.empty()) return Error{"pose at stamp " + std::to_string(stamp_ns) + " ns: " + fault};
  samples_.erase(samples_.begin(), samples_.lower_bound(newest_ns() - keep_ns_));
  return {};
}

PoseBuffer::Answer PoseBuffer::at(std::int64_t stamp_ns) const {
  const auto after = samples_.lower_bound(stamp_ns);
  if (after == samples_.end()) return {Status::kNotYet, {}};
  if (after->first == stamp_ns) return {Status::kFound, after->second};
  if (after == samples_.begin()) return {Status::kTooOld, {}};
  const auto before = std::prev(after);
  const std::int64_t gap_ns = after->first - before->first;
  if (gap_ns > max_gap_ns_) return {Status::kGap, {}};
  const double ratio = static_cast<double>(stamp_ns - before->first) / static_cast<double>(gap_ns);
  return {Status::kFound, interpolate(before->second, after->second, ratio)};
}

bool PoseBuffer::is_continuous(std::int64_t from_ns, std::int64_t to_ns) const {
  auto sample = samples_.upper_bound(from_ns);
  if (sample == samples_.begin() || samples_.lower_bound(to_ns) == samples_.end()) return false;
  for (--sample; sample->first < to_ns; ++sample) {
    if (std::next(sample)->first - sample->first > max_gap_ns_) return false;
  }
  return true;
}

const char* describe(PoseBuffer::Status status) {
  constexpr std::array<const char*, 4> kNames = {"found", "no pose has arrived that is as new as this stamp",
                                                 "this stamp is older than the first pose",
                                                 "the poses around this stamp are too far apart"};
  return kNames.at(static_cast<std::size_t>(status));
}

}  // namespace semantic_topo_loop::core
