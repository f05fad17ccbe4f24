#include "semantic_topo_loop/io/tum_trajectory.h"

#include <array>
#include <cmath>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kColumns = 8;
constexpr std::array<const char*, kColumns> kNames = {"stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"};

/// The error is without file and line.
Result<StampedPose> parse_pose(std::string_view line) {
  const std::vector<std::string_view> fields = split_blanks(line);
  if (fields.size() != kColumns) {
    return Error{std::to_string(fields.size()) + " columns instead of 8 (stamp tx ty tz qx qy qz qw)"};
  }
  const std::optional<std::int64_t> stamp_ns = parse_stamp(fields[0]);
  if (!stamp_ns) return Error{"stamp '" + std::string(fields[0]) + "' is no decimal number of seconds"};
  std::array<double, kColumns> v{};
  for (std::size_t i = 1; i < kColumns; ++i) {
    const std::optional<double> value = parse_double(fields[i]);
    if (!value || !std::isfinite(*value)) {
      return Error{std::string(kNames[i]) + " '" + std::string(fields[i]) + "' is no finite number"};
    }
    v[i] = *value;
  }
  const Quaternion q(v[7], v[4], v[5], v[6]);
  if (!is_rotation(q)) {
    return Error{"quaternion of norm " + format_general(q.norm(), 6) + " is no rotation"};
  }
  return StampedPose{*stamp_ns, SE3(q.normalized(), Vec3(v[1], v[2], v[3]))};
}

Result<StampedPoses> read_poses(const std::string& path, bool allow_repeated_stamps) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  StampedPoses trajectory;
  for (const TextLine& line : content_lines(*text)) {
    const Result<StampedPose> pose = parse_pose(line.text);
    if (!pose) return Error{at_line(path, line.number, pose.message())};
    if (allow_repeated_stamps && !trajectory.empty() && pose->stamp_ns == trajectory.back().stamp_ns) {
      trajectory.pop_back();
    }
    if (!trajectory.empty() && pose->stamp_ns <= trajectory.back().stamp_ns) {
      return Error{at_line(path, line.number,
                           "stamp " + format_stamp(pose->stamp_ns) + " is not after the one before, " +
                               format_stamp(trajectory.back().stamp_ns))};
    }
    trajectory.push_back(*pose);
  }
  if (trajectory.empty()) return Error{path + ": contains no pose"};
  return trajectory;
}

}  // namespace

Result<StampedPoses> read_tum_trajectory(const std::string& path) { return read_poses(path, false); }

Result<StampedPoses> read_tum_ground_truth(const std::string& path) { return read_poses(path, true); }

std::string format_tum_pose(const StampedPose& pose) {
  std::string line = format_stamp(pose.stamp_ns);
  const Vec3& t = pose.T_world_camera.t;
  const Quaternion& q = pose.T_world_camera.q;
  constexpr int kDecimals = 9;
  for (const double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) {
    line += ' ' + format_fixed(value, kDecimals);
  }
  return line;
}

Status write_tum_trajectory(const std::string& path, const StampedPoses& trajectory) {
  std::string text;
  for (const StampedPose& pose : trajectory) text += format_tum_pose(pose) + '\n';
  return write_text_file(path, text);
}

}  // namespace semantic_topo_loop::core
