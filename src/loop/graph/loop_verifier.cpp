#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "loop/graph/graph_detector.h"
#include "loop/submap/spheroid.h"
#include "loop/submap/submap_builder.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kObjectSeenShare = 0.3;  ///< of the frames that should see an object: detectors miss it in many
constexpr int kMinExpected = 2;           ///< frames that should see it; one alone may be hidden or cut

/// The best overlap of a projected box with a detection of the label; marks the detection if it is enough.
bool find_detection(const LocalFrame& frame, const Box& projected, int label, double min_iou,
                    std::vector<bool>* explained) {
  double best = 0.0;
  std::size_t best_index = 0;
  const Box visible = clip(projected, frame.image);
  for (std::size_t k = 0; k < frame.boxes.size(); ++k) {
    if (frame.boxes[k].label != label) continue;
    const double overlap = iou(visible, frame.boxes[k].box);
    if (overlap > best) {
      best = overlap;
      best_index = k;
    }
  }
  if (best <= min_iou) return false;
  (*explained)[best_index] = true;
  return true;
}

Vec3 mean_position(const LocalMap& map) {
  Vec3 mean = Vec3::Zero();
  for (const LocalFrame& frame : map.frames) mean += frame.position / static_cast<double>(map.frames.size());
  return mean;
}

LoopReason check_alignment(const GraphMatch& match, bool has_surfaces, double second_score,
                           const LoopOptions& options) {
  const int min_inliers =
      has_surfaces ? std::min(options.min_inliers, options.min_confirmed_inliers) : options.min_inliers;
  if (static_cast<int>(match.pairs.size()) < min_inliers) return LoopReason::kTooFewInliers;
  if (match.classes < options.min_labels) return LoopReason::kTooFewLabels;
  if (match.spread_m(1) < options.min_spread_m) return LoopReason::kDegenerate;
  if (match.rms_m > options.max_rms_m) return LoopReason::kResidual;
  if (match.score < options.ambiguity_ratio * second_score) return LoopReason::kAmbiguous;
  return LoopReason::kAccepted;
}

/// Projects b's objects into a's check frames.
Reprojection reproject(const LocalMap& a, const LocalMap& b, const SE3& T_a_b, const LoopOptions& options) {
  const Mat3 R_a_b = T_a_b.rotation();
  std::vector<std::vector<bool>> explained;
  for (const int f : a.check_frames) {
    explained.emplace_back(a.frames[static_cast<std::size_t>(f)].boxes.size(), false);
  }
  Reprojection result;
  double expected_total = 0.0, matched_total = 0.0;
  for (const LocalObject& object : b.objects) {
    const Vec3 center = R_a_b * object.spheroid.center + T_a_b.t;
    const Vec3 axis = R_a_b * b.up.direction;
    int expected = 0, matched = 0;
    for (std::size_t k = 0; k < a.check_frames.size(); ++k) {
      const LocalFrame& frame = a.frames[static_cast<std::size_t>(a.check_frames[k])];
      if (!in_view(frame, center, options.max_depth_m)) continue;
      const auto box = spheroid_box(frame.to_camera(center), frame.R_camera_local * axis, object.spheroid.log_axes);
      if (!box) continue;
      ++expected;
      if (find_detection(frame, *box, object.label, options.reprojection_iou, &explained[k])) ++matched;
    }
    if (expected < kMinExpected) continue;
    expected_total += expected * object.seen_share;
    matched_total += matched;
    if (matched > kObjectSeenShare * expected) ++result.objects;
  }
  std::size_t detections = 0, explained_detections = 0;
  for (const std::vector<bool>& flags : explained) {
    detections += flags.size();
    explained_detections += static_cast<std::size_t>(std::count(flags.begin(), flags.end(), true));
  }
  if (expected_total > 0.0) result.ratio = matched_total / expected_total;
  if (detections > 0) result.explained = static_cast<double>(explained_detections) / static_cast<double>(detections);
  return result;
}

/// Both ways, each figure the worse.
Reprojection reproject_both(const LocalMap& a, const LocalMap& b, const SE3& T_a_b, const LoopOptions& options) {
  const Reprojection there = reproject(a, b, T_a_b, options);
  const Reprojection back = reproject(b, a, T_a_b.inverse(), options);
  return {std::min(there.ratio, back.ratio), std::min(there.objects, back.objects),
          std::min(there.explained, back.explained)};
}

}  // namespace

Verdict verify_alignment(const LocalMap& a, const LocalMap& b, const GraphMatch& match, double second_score,
                         const LoopOptions& options) {
  Verdict verdict;
  verdict.reason = check_alignment(match, a.surfels && b.surfels, second_score, options);
  verdict.tilt_deg = degrees(tilt(a, b, match.T_a_b));
  if (verdict.reason != LoopReason::kAccepted) return verdict;
  if (is_mirrored(a, b, match, options.max_rms_m)) {
    verdict.reason = LoopReason::kMirrored;
  } else if (verdict.tilt_deg > options.max_tilt_deg) {
    verdict.reason = LoopReason::kTilt;
  } else {
    verdict.reprojection = reproject_both(a, b, match.T_a_b, options);
    const bool explains = verdict.reprojection->ratio > options.min_reprojection_ratio &&
                          verdict.reprojection->objects >= options.min_reprojected_objects &&
                          verdict.reprojection->explained > options.min_explained_share;
    if (!explains) verdict.reason = LoopReason::kReprojection;
  }
  return verdict;
}

bool is_mirrored(const LocalMap& a, const LocalMap& b, const GraphMatch& match, double max_rms_m) {
  Vec3 middle = Vec3::Zero();
  std::vector<Vec3> points;
  for (const NodePair& pair : match.pairs) {
    points.push_back(a.object(pair.a).spheroid.center);
    points.push_back(match.T_a_b * b.object(pair.b).spheroid.center);
  }
  for (const Vec3& point : points) middle += point / static_cast<double>(points.size());
  Mat3 scatter = Mat3::Zero();
  for (const Vec3& point : points) scatter += (point - middle) * (point - middle).transpose();
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(scatter / static_cast<double>(points.size()));
  if (solver.eigenvalues()(0) > max_rms_m * max_rms_m) return false;
  const Vec3 normal = solver.eigenvectors().col(0);
  const double side_a = normal.dot(mean_position(a) - middle);
  const double side_b = normal.dot(match.T_a_b * mean_position(b) - middle);
  return side_a * side_b < 0.0;
}

double tilt(const LocalMap& a, const LocalMap& b, const SE3& T_a_b) {
  if (!a.up.certain || !b.up.certain) return 0.0;
  return std::acos(std::clamp(a.up.direction.dot(T_a_b.q * b.up.direction), -1.0, 1.0));
}

}  // namespace semantic_topo_loop::core
