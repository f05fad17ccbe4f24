#include "tools/evaluation/trajectory_evaluation.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// Of estimate and reference.
using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;

constexpr std::int64_t kMaxStampDifference_ns = 20000000 - 1;  // as TUM's tools
constexpr std::int64_t kInterval_ns = 1000000000;              // between the two poses of a relative error

/// Relative errors between each pair and the one nearest to the interval later, unless there is a gap or an end.
void relative_errors(const StampedPoses& estimate, const StampedPoses& reference, const IndexPairs& pairs, double scale,
                     TrajectoryEvaluation* result) {
  std::vector<double> translations, rotations;
  std::size_t later = 0;
  for (const auto& [i, j] : pairs) {
    const std::int64_t wanted_ns = estimate[i].stamp_ns + kInterval_ns;
    const auto late_ns = [&](std::size_t pair) { return estimate[pairs[pair].first].stamp_ns - wanted_ns; };
    const auto is_near = [&](std::size_t pair) {
      return pair < pairs.size() && std::abs(late_ns(pair)) <= kInterval_ns / 2;
    };
    // Pairs of one pose with several of the denser trajectory are equally late.
    while (later + 1 < pairs.size() &&
           (late_ns(later + 1) == late_ns(later) || std::abs(late_ns(later + 1)) < std::abs(late_ns(later)))) {
      ++later;
    }
    if (!is_near(later) || (late_ns(later) < 0 && !is_near(later + 1))) continue;
    const auto& [i2, j2] = pairs[later];
    SE3 motion = estimate[i].T_world_camera.inverse() * estimate[i2].T_world_camera;
    motion.t *= scale;
    const SE3 true_motion = reference[j].T_world_camera.inverse() * reference[j2].T_world_camera;
    const SE3 error = true_motion.inverse() * motion;
    translations.push_back(error.t.norm());
    rotations.push_back(degrees(rotation_angle(error.q, Quaternion::Identity())));
  }
  result->relative_m = error_statistics(std::move(translations));
  result->relative_deg = error_statistics(std::move(rotations));
}

/// How many poses are within the time of others.
std::size_t count_during(const StampedPoses& poses, const StampedPoses& others) {
  if (others.empty()) return 0;
  const std::int64_t begin_ns = others.front().stamp_ns, end_ns = others.back().stamp_ns;
  const auto is_during = [=](const StampedPose& pose) { return pose.stamp_ns >= begin_ns && pose.stamp_ns <= end_ns; };
  return static_cast<std::size_t>(std::count_if(poses.begin(), poses.end(), is_during));
}

/// Each pose of the sparser trajectory with the nearest of the denser: other pairs would share partners that are some
/// motion away.
IndexPairs pair_by_time(const StampedPoses& estimate, const StampedPoses& reference) {
  const bool is_denser = count_during(estimate, reference) > count_during(reference, estimate);
  const StampedPoses &sparse = is_denser ? reference : estimate, &dense = is_denser ? estimate : reference;
  IndexPairs pairs;
  for (std::size_t i = 0; i < sparse.size(); ++i) {
    const StampedPose* nearest = find_stamp(dense, sparse[i].stamp_ns, kMaxStampDifference_ns);
    if (nearest == nullptr) continue;
    const auto j = static_cast<std::size_t>(nearest - dense.data());
    pairs.emplace_back(is_denser ? j : i, is_denser ? i : j);
  }
  return pairs;
}

}  // namespace

ErrorStatistics error_statistics(std::vector<double> errors) {
  ErrorStatistics statistics;
  statistics.count = errors.size();
  if (errors.empty()) return statistics;
  double sum = 0.0, squares = 0.0;
  for (const double error : errors) {
    sum += error;
    squares += error * error;
  }
  const auto n = static_cast<double>(errors.size());
  std::sort(errors.begin(), errors.end());
  const std::size_t middle = errors.size() / 2;
  statistics.rmse = std::sqrt(squares / n);
  statistics.mean = sum / n;
  statistics.median = errors.size() % 2 == 1 ? errors[middle] : 0.5 * (errors[middle - 1] + errors[middle]);
  statistics.max = errors.back();
  return statistics;
}

Result<TrajectoryEvaluation> evaluate_trajectory(const StampedPoses& estimate, const StampedPoses& reference,
                                                 bool with_scale, const std::optional<Alignment>& known) {
  const IndexPairs pairs = pair_by_time(estimate, reference);
  std::vector<Vec3> points_reference, points_estimate;
  for (const auto& [i, j] : pairs) {
    points_estimate.push_back(estimate[i].T_world_camera.t);
    points_reference.push_back(reference[j].T_world_camera.t);
  }
  if (known && pairs.empty()) return Error{"no pose has a partner in time"};
  const std::optional<Alignment> alignment =
      known ? known : align_points(points_reference, points_estimate, with_scale);
  if (!alignment) {
    return Error{"cannot align the trajectories: " + std::to_string(pairs.size()) +
                 " poses have a partner in time (3 that are not on a line are needed)"};
  }
  TrajectoryEvaluation result;
  result.estimated = estimate.size();
  result.reference = reference.size();
  result.pairs = pairs.size();
  result.alignment = *alignment;
  std::vector<double> distances, angles;
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const Vec3 aligned = alignment->scale * (alignment->T_a_b.q * points_estimate[k]) + alignment->T_a_b.t;
    distances.push_back((aligned - points_reference[k]).norm());
    const auto& [i, j] = pairs[k];
    angles.push_back(
        degrees(rotation_angle(alignment->T_a_b.q * estimate[i].T_world_camera.q, reference[j].T_world_camera.q)));
    result.errors.push_back({estimate[i].stamp_ns, distances.back()});
  }
  result.absolute_m = error_statistics(std::move(distances));
  result.absolute_deg = error_statistics(std::move(angles));
  relative_errors(estimate, reference, pairs, alignment->scale, &result);
  return result;
}

}  // namespace semantic_topo_loop::core
