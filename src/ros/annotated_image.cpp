#include "ros/annotated_image.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <string>

#include "ros/markers.h"

namespace semantic_topo_loop {
namespace {

constexpr int kThin = 1, kThick = 2;  // px

cv::Scalar class_bgr(int class_id) {
  constexpr double kFull = 255.0;
  const std_msgs::ColorRGBA color = class_color(class_id, 1.0);
  return {kFull * color.b, kFull * color.g, kFull * color.r};
}

cv::Mat undistort(const cv::Mat& raw, const core::Camera& camera) {
  const cv::Matx33d K(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
  const auto& d = camera.distortion;
  cv::Mat undistorted;
  cv::undistort(raw, undistorted, K, cv::Vec<double, 5>(d[0], d[1], d[2], d[3], d[4]));
  return undistorted;
}

void draw_text(const std::string& text, cv::Point at, const cv::Scalar& color, cv::Mat* image) {
  constexpr double kSize = 0.45;
  const cv::Size size = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, kSize, kThin, nullptr);
  at.x = std::max(0, std::min(at.x, image->cols - size.width));
  at.y = std::max(size.height, at.y);
  cv::putText(*image, text, at, cv::FONT_HERSHEY_SIMPLEX, kSize, cv::Scalar::all(0.0), kThick + kThin, cv::LINE_AA);
  cv::putText(*image, text, at, cv::FONT_HERSHEY_SIMPLEX, kSize, color, kThin, cv::LINE_AA);
}

void draw_object(const core::Landmark& landmark, const core::Mat34& P_image_map, int thickness, cv::Mat* image) {
  const std::optional<core::Conic> conic = core::project(landmark.ellipsoid->dual(), P_image_map);
  if (!conic) return;
  const std::optional<cv::RotatedRect> ellipse = ellipse_of(*conic);
  constexpr float kMostSizes = 4.0F;  // of the image: OpenCV draws in small integers
  const auto most = kMostSizes * static_cast<float>(std::max(image->cols, image->rows));
  if (!ellipse || std::max(ellipse->size.width, ellipse->size.height) > most) return;
  if ((ellipse->boundingRect() & cv::Rect(0, 0, image->cols, image->rows)).empty()) return;
  cv::ellipse(*image, *ellipse, class_bgr(landmark.class_id), thickness, cv::LINE_AA);
}

}  // namespace

std::optional<cv::RotatedRect> ellipse_of(const core::Conic& C_dual_image) {
  // C* ~ [S - c c^T, -c; -c^T, -1] of the ellipse (x - c)^T S^-1 (x - c) = 1.
  const double scale = -C_dual_image(2, 2);
  if (!(scale > 0.0)) return std::nullopt;
  const core::Vec2 center = -C_dual_image.topRightCorner<2, 1>() / scale;
  const Eigen::Matrix2d shape = C_dual_image.topLeftCorner<2, 2>() / scale + center * center.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(shape);
  if (!(axes.eigenvalues()(0) > 0.0) || !center.allFinite()) return std::nullopt;
  const core::Vec2 size = 2.0 * axes.eigenvalues().cwiseSqrt();
  const core::Vec2 first = axes.eigenvectors().col(0);
  const double angle_deg = core::degrees(std::atan2(first.y(), first.x()));
  return cv::RotatedRect(cv::Point2f(static_cast<float>(center.x()), static_cast<float>(center.y())),
                         cv::Size2f(static_cast<float>(size.x()), static_cast<float>(size.y())),
                         static_cast<float>(angle_deg));
}

core::Status annotate(const core::Frame& frame, const core::AssociationFrame& associations, const MapView& view,
                      const core::ClassTable& classes, cv::Mat* image) {
  const core::Camera& camera = frame.camera;
  if (image->cols != camera.width || image->rows != camera.height) {
    const auto size = [](int width, int height) { return std::to_string(width) + " x " + std::to_string(height); };
    return core::Error{"colour image of " + size(image->cols, image->rows) + ", the calibration is for " +
                       size(camera.width, camera.height)};
  }
  if (camera.has_distortion()) *image = undistort(*image, camera);
  std::set<std::int64_t> detected;
  for (const core::Association& association : associations.associations) {
    if (association.landmark_id >= 0) detected.insert(view.survivor(association.landmark_id));
  }
  const core::Mat34 P_image_map = core::projection_matrix(camera, view.T_map_odom() * frame.T_odom_camera);
  for (const auto& [id, landmark] : view.landmarks()) {
    const bool is_detected = detected.count(id) > 0;
    const bool is_shown = is_detected ? landmark.state != core::LandmarkState::kRetired
                                      : landmark.state == core::LandmarkState::kConfirmed;
    if (landmark.ellipsoid && is_shown) draw_object(landmark, P_image_map, is_detected ? kThick : kThin, image);
  }
  for (const core::Association& association : associations.associations) {
    if (!association.box.is_valid()) continue;  // out of view
    const core::Box box = core::clip(association.box, camera.width - 1, camera.height - 1);
    const cv::Point from(cvRound(box.x1), cvRound(box.y1)), to(cvRound(box.x2), cvRound(box.y2));
    const bool has_landmark = association.landmark_id >= 0;
    constexpr double kGrey = 150.0;
    const cv::Scalar color = has_landmark ? class_bgr(association.landmark_class_id) : cv::Scalar::all(kGrey);
    cv::rectangle(*image, from, to, color, kThin);
    std::string text = classes.name(association.class_id);
    if (has_landmark) text += " " + std::to_string(view.survivor(association.landmark_id));
    draw_text(text, {from.x, from.y - kThick}, color, image);
  }
  return {};
}

}  // namespace semantic_topo_loop
