#include "tools/evaluation/trajectory_evaluation.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// Of estimate and reference.
using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;

constexpr std::int64_t kMaxStampDifference_ns = 20000000 - 1;  // as TUM's tools
constexpr std::int64_t kInterval_ns = 1000000000;              // between the two poses of a relative error

/// Relative errors between each pair and the first one at least the interval later, unless that is much later.
void relative_errors(const StampedPoses& estimate, const StampedPoses& reference, const IndexPairs& pairs, double scale,
                     TrajectoryEvaluation* result) {
  std::vector<double> translations, rotations;
  std::size_t later = 0;
  for (const auto& [i, j] : pairs) {
    while (later < pairs.size() && estimate[pairs[later].first].stamp_ns < estimate[i].stamp_ns + kInterval_ns) ++later;
    if (later == pairs.size()) break;
    const auto& [i2, j2] = pairs[later];
    if (estimate[i2].stamp_ns > estimate[i].stamp_ns + kInterval_ns + kInterval_ns / 2) continue;
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
  IndexPairs pairs;
  std::vector<Vec3> points_reference, points_estimate;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    const StampedPose* nearest = find_stamp(reference, estimate[i].stamp_ns, kMaxStampDifference_ns);
    if (nearest == nullptr) continue;
    pairs.emplace_back(i, static_cast<std::size_t>(nearest - reference.data()));
    points_estimate.push_back(estimate[i].T_world_camera.t);
    points_reference.push_back(nearest->T_world_camera.t);
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
