#include "loop/paper/paper_score.h"

#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinVector = 1e-6;  ///< m; two nodes in one place have no direction

bool is_usable(const CommonNode& start, const CommonNode& end) {
  const double query = (end.center_query - start.center_query).norm();
  const double match = (end.center_match - start.center_match).norm();
  return query > kMinVector && match > kMinVector;  // false for NaN as well
}

/// Calls f(transform, rho) for every ordered pair of nodes; rho is that of the starting node.
template <class F>
void for_each_vector(const std::vector<CommonNode>& nodes, F f) {
  for (const CommonNode& start : nodes) {
    for (const CommonNode& end : nodes) {
      if (&start != &end && is_usable(start, end)) f(vector_transform(start, end), start.quality);
    }
  }
}

}  // namespace

Mat3 rotation_between(const Vec3& from, const Vec3& to) {
  const Vec3 a = from.normalized(), b = to.normalized();
  const Vec3 cross = a.cross(b);
  const double sine = cross.norm(), cosine = a.dot(b);
  if (sine > 1e-9) {
    const Mat3 K = hat(cross / sine);
    return Mat3::Identity() + sine * K + (1.0 - cosine) * K * K;
  }
  if (cosine > 0.0) return Mat3::Identity();
  int least = 0;
  a.cwiseAbs().minCoeff(&least);
  const Vec3 axis = a.cross(Vec3::Unit(least)).normalized();
  return 2.0 * axis * axis.transpose() - Mat3::Identity();
}

VectorTransform vector_transform(const CommonNode& start, const CommonNode& end) {
  const Vec3 query = end.center_query - start.center_query;
  const Vec3 match = end.center_match - start.center_match;
  VectorTransform transform;
  transform.R = rotation_between(query, match);
  transform.scale = match.norm() / query.norm();
  transform.angle_rad = std::atan2(query.cross(match).norm(), query.dot(match));
  transform.t = start.center_match - transform.scale * transform.R * start.center_query;
  return transform;
}

double printed_score(const std::vector<CommonNode>& nodes) {
  constexpr double kRotationNorm = 1.0;
  double sum = 0.0;
  for_each_vector(nodes, [&sum](const VectorTransform& vector, double rho) {
    sum += rho * std::exp(-0.5 * std::abs(vector.scale * kRotationNorm + vector.t.norm() - 1.0));
  });
  return sum;
}

double corrected_score(const std::vector<CommonNode>& nodes) {
  double sum = 0.0;
  int vectors = 0;
  for_each_vector(nodes, [&](const VectorTransform& vector, double rho) {
    sum += rho * std::exp(-0.5 * (std::abs(1.0 - vector.scale) + vector.angle_rad + vector.t.norm()));
    ++vectors;
  });
  return vectors > 0 ? sum / vectors : 0.0;
}

}  // namespace semantic_topo_loop::core
