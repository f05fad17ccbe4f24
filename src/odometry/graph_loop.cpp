#include "odometry/graph_loop.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "geometry/relative_pose.h"
#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

double interval_overlap(std::int64_t a_begin, std::int64_t a_end, std::int64_t b_begin, std::int64_t b_end) {
  const std::int64_t shared = std::min(a_end, b_end) - std::max(a_begin, b_begin) + 1;
  const std::int64_t all = std::max(a_end, b_end) - std::min(a_begin, b_begin) + 1;
  return shared > 0 ? static_cast<double>(shared) / static_cast<double>(all) : 0.0;
}

Mat7 joint_covariance(const Mat6& covariance, const Vec7& with_scale) {
  Mat7 joint;
  joint.topLeftCorner<6, 6>() = covariance;
  joint.col(6) = with_scale;
  joint.row(6) = with_scale.transpose();
  return joint;
}

bool is_scale_covariance(const Mat6& covariance, const Vec7& with_scale) {
  if (!with_scale.allFinite()) return false;
  // What the pose leaves open of the scale.
  const Vec6 cross = with_scale.head<6>();
  return with_scale(6) - cross.dot(covariance.llt().solve(cross)) > 0.0;
}

const char* fault(const LoopClosure& closure, int query_vertex, int match_vertex) {
  if (query_vertex < 0) return "its query keyframe is unknown";
  if (match_vertex < 0) return "its match keyframe is unknown";
  if (query_vertex == match_vertex) return "its keyframes are the same";
  if (!closure.T_match_query.is_finite()) return "its pose is not finite";
  constexpr double kMaxNormError = 1e-3;  // rounding of a text file leaves far less: such a quaternion is a mistake
  if (std::abs(closure.T_match_query.q.norm() - 1.0) > kMaxNormError) return "its quaternion is not of unit length";
  if (!is_covariance(closure.covariance)) return "its covariance is not positive definite";
  if (!std::isfinite(closure.scale) || closure.scale <= 0.0) return "its scale is not positive";
  const bool has_scale = !closure.scale_covariance.isZero(0.0);
  if (has_scale && !is_scale_covariance(closure.covariance, closure.scale_covariance))
    return "the covariance of its scale is not positive definite";
  return nullptr;
}

/// The loop the other way round.
void invert(GraphLoop* loop) {
  const SE3 T = loop->T_from_to;
  const Sim3 S_inverse = loop->S_from_to().inverse();
  std::swap(loop->from, loop->to);
  if (loop->scale == 1.0 && !loop->has_scale()) {
    loop->T_from_to = T.inverse();
    loop->covariance = inverse_covariance(T, loop->covariance);
    return;
  }
  // As inverse_covariance, in the other unit; a scale error moves the end of the inverse along itself.
  Mat7 carry = Mat7::Identity();
  carry.topLeftCorner<6, 6>() = transport(T.inverse());
  carry.topRows<3>() *= S_inverse.scale;
  carry.topRightCorner<3, 1>() = T.q * S_inverse.T.t;
  const Mat7 joint = carry * joint_covariance(loop->covariance, loop->scale_covariance) * carry.transpose();
  loop->T_from_to = S_inverse.T;
  loop->scale = S_inverse.scale;
  loop->covariance = joint.topLeftCorner<6, 6>();
  loop->scale_covariance = joint.col(6);
}

}  // namespace

Mat7 similarity_sqrt_info(const GraphLoop& loop) {
  Mat7 sqrt_info = Mat7::Zero();
  if (!loop.has_scale()) {
    sqrt_info.topLeftCorner<6, 6>() = square_root_information(loop.covariance);
    return sqrt_info;
  }
  const Mat7 information = joint_covariance(loop.covariance, loop.scale_covariance).inverse();
  return (0.5 * (information + information.transpose())).llt().matrixU();
}

Result<GraphLoop> make_graph_loop(const LoopClosure& closure, int query_vertex, int match_vertex) {
  if (const char* why = fault(closure, query_vertex, match_vertex)) {
    return Error{"loop of keyframes " + std::to_string(closure.query_keyframe_id) + " and " +
                 std::to_string(closure.match_keyframe_id) + " refused: " + why};
  }
  GraphLoop loop;
  loop.query_keyframe_id = closure.query_keyframe_id;
  loop.match_keyframe_id = closure.match_keyframe_id;
  const bool has_windows = closure.query_begin >= 0 && closure.query_end >= closure.query_begin &&
                           closure.match_begin >= 0 && closure.match_end >= closure.match_begin;
  loop.query_begin = has_windows ? closure.query_begin : closure.query_frame;
  loop.query_end = has_windows ? closure.query_end : closure.query_frame;
  loop.match_begin = has_windows ? closure.match_begin : closure.match_frame;
  loop.match_end = has_windows ? closure.match_end : closure.match_frame;
  loop.from = match_vertex;
  loop.to = query_vertex;
  loop.T_from_to = SE3(closure.T_match_query.q.normalized(), closure.T_match_query.t);
  loop.covariance = closure.covariance;
  loop.scale = closure.scale;
  loop.scale_covariance = closure.scale_covariance;
  if (loop.from > loop.to) invert(&loop);
  return loop;
}

GraphLoop carried(GraphLoop loop, const Carrier& from, const Carrier& to) {
  loop.from = from.vertex;
  loop.to = to.vertex;
  if (from.T_vertex_keyframe) loop.T_from_to = *from.T_vertex_keyframe * loop.T_from_to;
  if (to.T_vertex_keyframe) {
    const SE3 T_keyframe_vertex = to.T_vertex_keyframe->inverse();
    const Mat6 carry = transport(T_keyframe_vertex);
    loop.T_from_to = loop.T_from_to * T_keyframe_vertex;
    loop.covariance = carry * loop.covariance * carry.transpose();
  }
  return loop;
}

double shared_evidence(const GraphLoop& a, const GraphLoop& b) {
  return interval_overlap(a.query_begin, a.query_end, b.query_begin, b.query_end) *
         interval_overlap(a.match_begin, a.match_end, b.match_begin, b.match_end);
}

std::vector<double> redundancy(const std::vector<GraphLoop>& loops, const std::vector<bool>& counts) {
  std::vector<double> sums(loops.size(), 1.0);
  const auto is_in = [&counts](std::size_t i) { return counts.empty() || counts[i]; };
  for (std::size_t i = 0; i < loops.size(); ++i) {
    for (std::size_t j = 0; j < i && is_in(i); ++j) {
      if (!is_in(j)) continue;
      const double shared = shared_evidence(loops[i], loops[j]);
      sums[i] += shared;
      sums[j] += shared;
    }
  }
  return sums;
}

std::vector<std::vector<std::size_t>> loop_clusters(const std::vector<GraphLoop>& loops,
                                                    const std::vector<bool>& counts) {
  std::vector<std::vector<std::size_t>> clusters;
  std::vector<bool> is_left = counts;
  for (std::size_t first = 0; first < loops.size(); ++first) {
    if (!is_left[first]) continue;
    std::vector<std::size_t> cluster{first};
    is_left[first] = false;
    for (std::size_t i = 0; i < cluster.size(); ++i) {
      for (std::size_t other = 0; other < loops.size(); ++other) {
        if (!is_left[other] || shared_evidence(loops[cluster[i]], loops[other]) <= 0.0) continue;
        cluster.push_back(other);
        is_left[other] = false;
      }
    }
    std::sort(cluster.begin(), cluster.end());
    clusters.push_back(std::move(cluster));
  }
  return clusters;
}

std::vector<GraphLoop> some_kept(const std::vector<GraphLoop>& loops, const std::vector<bool>& kept,
                                 std::size_t count) {
  std::vector<GraphLoop> all;
  for (std::size_t k = 0; k < loops.size(); ++k) {
    if (kept[k]) all.push_back(loops[k]);
  }
  return evenly_taken(std::move(all), count);
}

double chi_squared(const GraphLoop& loop, const std::vector<SE3>& T_map_vertex) {
  const Vec6 e = relative_pose_residual(T_map_vertex[static_cast<std::size_t>(loop.from)],
                                        T_map_vertex[static_cast<std::size_t>(loop.to)], loop.T_from_to);
  return (square_root_information(loop.covariance) * e).squaredNorm();
}

}  // namespace semantic_topo_loop::core
