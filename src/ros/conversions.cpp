#include "semantic_topo_loop/ros/conversions.h"

#include <utility>

namespace semantic_topo_loop {
namespace {

using RowMajor6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

core::Mat6 to_matrix6(const boost::array<double, 36>& values) { return Eigen::Map<const RowMajor6>(values.data()); }

void fill(const core::Mat6& matrix, boost::array<double, 36>* values) {
  Eigen::Map<RowMajor6>(values->data()) = matrix;
}

template <class Message, class Core>
std::vector<Message> to_messages(const std::vector<Core>& items) {
  std::vector<Message> messages;
  messages.reserve(items.size());
  for (const Core& item : items) messages.push_back(to_msg(item));
  return messages;
}

template <class Core, class Message>
std::vector<Core> from_messages(const std::vector<Message>& messages) {
  std::vector<Core> items;
  items.reserve(messages.size());
  for (const Message& message : messages) items.push_back(from_msg(message));
  return items;
}

}  // namespace

Association to_msg(const core::Association& association) {
  Association message;
  message.detection_index = association.detection_index;
  message.landmark_id = association.landmark_id;
  message.level = static_cast<std::uint8_t>(association.level);
  message.class_id = association.class_id;
  message.score = association.score;
  message.box = to_msg(association.box);
  message.truncated = association.truncated;
  message.landmark_class_id = association.landmark_class_id;
  return message;
}

core::Association from_msg(const Association& message) {
  core::Association association;
  association.detection_index = message.detection_index;
  association.landmark_id = message.landmark_id;
  association.level = static_cast<core::AssociationLevel>(message.level);
  association.class_id = message.class_id;
  association.score = message.score;
  association.box = from_msg(message.box);
  association.truncated = message.truncated;
  association.landmark_class_id = message.landmark_class_id;
  return association;
}

KeyframePose to_msg(const core::KeyframePose& keyframe) {
  KeyframePose message;
  message.keyframe_id = keyframe.keyframe_id;
  message.frame_id = keyframe.frame_id;
  message.stamp_ns = keyframe.stamp_ns;
  message.map_from_camera = to_msg(keyframe.T_map_camera);
  message.scale = keyframe.scale;
  return message;
}

core::KeyframePose from_msg(const KeyframePose& message) {
  return {message.keyframe_id, message.frame_id, message.stamp_ns, from_msg(message.map_from_camera), message.scale};
}

LoopVerdict to_msg(const core::LoopVerdict& verdict) {
  LoopVerdict message;
  message.query_keyframe_id = verdict.query_keyframe_id;
  message.match_keyframe_id = verdict.match_keyframe_id;
  message.kept = verdict.kept;
  message.reason = verdict.reason;
  return message;
}

core::LoopVerdict from_msg(const LoopVerdict& message) {
  return {message.query_keyframe_id, message.match_keyframe_id, message.kept != 0, message.reason, false};
}

OdometryFault to_msg(const core::OdometryFault& fault) {
  OdometryFault message;
  message.from_keyframe_id = fault.from_keyframe_id;
  message.to_keyframe_id = fault.to_keyframe_id;
  message.is_break = fault.is_break;
  message.translation_m = fault.translation_m;
  message.rotation_rad = fault.rotation_rad;
  return message;
}

core::OdometryFault from_msg(const OdometryFault& message) {
  return {message.from_keyframe_id, message.to_keyframe_id, message.is_break != 0, message.translation_m,
          message.rotation_rad};
}

ObjectMatch to_msg(const core::ObjectMatch& match) {
  ObjectMatch message;
  message.query_landmark_id = match.query_landmark_id;
  message.match_landmark_id = match.match_landmark_id;
  return message;
}

core::ObjectMatch from_msg(const ObjectMatch& message) {
  return {message.query_landmark_id, message.match_landmark_id};
}

QuadricMerge to_msg(const core::LandmarkMerge& merge) {
  QuadricMerge message;
  message.merged_id = merge.merged_id;
  message.survivor_id = merge.survivor_id;
  return message;
}

core::LandmarkMerge from_msg(const QuadricMerge& message) { return {message.merged_id, message.survivor_id}; }

void to_msg(const core::Frame& frame, Frame* message) {
  message->header.stamp = to_ros_time(frame.stamp_ns);
  message->frame_id = frame.frame_id;
  message->keyframe_id = frame.keyframe_id;
  message->is_keyframe = frame.is_keyframe;
  message->is_break = frame.is_break;
  message->is_end = frame.is_end;
  message->odom_from_camera = to_msg(frame.T_odom_camera);
  message->has_covariance = frame.covariance.has_value();
  if (frame.covariance) fill(*frame.covariance, &message->covariance);
  to_msg(frame.camera, &message->camera);
  message->camera.header.stamp = message->header.stamp;
  message->has_points = frame.points_camera != nullptr;
  if (frame.points_camera) to_msg(*frame.points_camera, &message->points);
}

core::Frame from_msg(const Frame& message) {
  core::Frame frame;
  frame.frame_id = message.frame_id;
  frame.stamp_ns = to_stamp_ns(message.header.stamp);
  frame.keyframe_id = message.keyframe_id;
  frame.is_keyframe = message.is_keyframe != 0;
  frame.is_break = message.is_break != 0;
  frame.is_end = message.is_end != 0;
  frame.T_odom_camera = from_msg(message.odom_from_camera);
  if (message.has_covariance) frame.covariance = to_matrix6(message.covariance);
  frame.camera = from_msg(message.camera);
  if (message.has_points) {
    std::optional<std::vector<core::Vec3>> points = from_msg(message.points, nullptr);
    if (points) frame.points_camera = std::make_shared<const std::vector<core::Vec3>>(std::move(*points));
  }
  return frame;
}

void to_msg(const core::Frame& keyframe, Keyframe* message) {
  message->header.stamp = to_ros_time(keyframe.stamp_ns);
  message->keyframe_id = keyframe.keyframe_id;
  message->frame_id = keyframe.frame_id;
  message->odom_from_camera = to_msg(keyframe.T_odom_camera);
}

void to_msg(const std::vector<core::Detection>& detections, DetectionArray* message) {
  message->detections = to_messages<Detection>(detections);
}

std::vector<core::Detection> from_msg(const DetectionArray& message) {
  return from_messages<core::Detection>(message.detections);
}

void to_msg(const core::AssociationFrame& associations, AssociationArray* message) {
  message->frame_id = associations.frame_id;
  message->map_version = associations.map_version;
  message->duration_us = associations.duration_us;
  message->associations = to_messages<Association>(associations.associations);
}

core::AssociationFrame from_msg(const AssociationArray& message) {
  core::AssociationFrame associations;
  associations.frame_id = message.frame_id;
  associations.map_version = message.map_version;
  associations.duration_us = message.duration_us;
  associations.associations = from_messages<core::Association>(message.associations);
  return associations;
}

Quadric to_msg(const core::Landmark& landmark) {
  Quadric message;
  message.id = landmark.id;
  message.class_id = landmark.class_id;
  message.state = static_cast<std::uint8_t>(landmark.state);
  message.has_ellipsoid = landmark.ellipsoid.has_value();
  const core::Ellipsoid ellipsoid = landmark.ellipsoid.value_or(core::Ellipsoid());
  message.map_from_quadric = to_msg(ellipsoid.T_world_quadric);
  message.semi_axes = to_vector_msg(ellipsoid.semi_axes);
  Eigen::Map<RowMajor3>(message.center_covariance.data()) = landmark.center_covariance;
  message.anchor_keyframe_id = landmark.anchor_keyframe_id;
  message.observations = landmark.observations;
  message.baseline_deg = landmark.baseline_deg;
  message.mean_iou = landmark.mean_iou;
  message.quality = landmark.quality;
  return message;
}

core::Landmark from_msg(const Quadric& message) {
  core::Landmark landmark;
  landmark.id = message.id;
  landmark.class_id = message.class_id;
  landmark.state = static_cast<core::LandmarkState>(message.state);
  if (message.has_ellipsoid) {
    landmark.ellipsoid = core::Ellipsoid{from_msg(message.map_from_quadric), from_msg(message.semi_axes)};
  }
  landmark.center_covariance = Eigen::Map<const RowMajor3>(message.center_covariance.data());
  landmark.anchor_keyframe_id = message.anchor_keyframe_id;
  landmark.observations = message.observations;
  landmark.baseline_deg = message.baseline_deg;
  landmark.mean_iou = message.mean_iou;
  landmark.quality = message.quality;
  return landmark;
}

std::vector<Quadric> to_msg(const std::vector<core::Landmark>& landmarks) { return to_messages<Quadric>(landmarks); }

void to_msg(const core::MapUpdate& update, QuadricMapUpdate* message) {
  message->frame_id = update.frame_id;
  message->phase = static_cast<std::uint8_t>(update.phase);
  message->base_version = update.base_version;
  message->map_version = update.map_version;
  message->map_from_odom = to_msg(update.T_map_odom);
  message->changed = to_msg(update.changed);
  message->removed = update.removed;
  message->unmerged = to_messages<QuadricMerge>(update.unmerged);
  message->merged = to_messages<QuadricMerge>(update.merged);
  message->duration_us = update.duration_us;
}

core::MapUpdate from_msg(const QuadricMapUpdate& message) {
  core::MapUpdate update;
  update.frame_id = message.frame_id;
  update.phase = static_cast<core::MapUpdatePhase>(message.phase);
  update.base_version = message.base_version;
  update.map_version = message.map_version;
  update.T_map_odom = from_msg(message.map_from_odom);
  update.changed = from_messages<core::Landmark>(message.changed);
  update.removed = message.removed;
  update.unmerged = from_messages<core::LandmarkMerge>(message.unmerged);
  update.merged = from_messages<core::LandmarkMerge>(message.merged);
  update.duration_us = message.duration_us;
  return update;
}

core::MapUpdate from_msg(const QuadricMap& message) {
  core::MapUpdate update;
  update.map_version = message.map_version;
  update.T_map_odom = from_msg(message.map_from_odom);
  update.changed = from_messages<core::Landmark>(message.quadrics);
  return update;
}

LoopClosure to_msg(const core::LoopClosure& loop) {
  LoopClosure message;
  message.query_keyframe_id = loop.query_keyframe_id;
  message.match_keyframe_id = loop.match_keyframe_id;
  message.query_frame = loop.query_frame;
  message.match_frame = loop.match_frame;
  message.query_stamp_ns = loop.query_stamp_ns;
  message.match_stamp_ns = loop.match_stamp_ns;
  message.query_begin = loop.query_begin;
  message.query_end = loop.query_end;
  message.match_begin = loop.match_begin;
  message.match_end = loop.match_end;
  message.accepted = loop.accepted;
  message.reason = static_cast<std::uint8_t>(loop.reason);
  message.score = loop.score;
  message.second_score = loop.second_score;
  message.rms_m = loop.rms_m;
  message.spread_m = loop.spread_m;
  message.tilt_deg = loop.tilt_deg;
  message.reprojection_ratio = loop.reprojection_ratio;
  message.reprojected_objects = loop.reprojected_objects;
  message.explained_share = loop.explained_share;
  message.refine_residual = loop.refine_residual;
  message.refine_shift_m = loop.refine_shift_m;
  message.refine_shift_deg = loop.refine_shift_deg;
  message.sigma_m = loop.sigma_m;
  message.sigma_deg = loop.sigma_deg;
  message.inliers = loop.inliers;
  message.labels = loop.labels;
  message.match_from_query = to_msg(loop.T_match_query);
  fill(loop.covariance, &message.covariance);
  message.scale = loop.scale;
  Eigen::Map<core::Vec7>(message.scale_covariance.data()) = loop.scale_covariance;
  message.matches = to_messages<ObjectMatch>(loop.matches);
  message.in_earlier_map = loop.T_earlier_match.has_value();
  message.earlier_map_from_match = to_msg(loop.T_earlier_match.value_or(core::SE3()));
  return message;
}

core::LoopClosure from_msg(const LoopClosure& message) {
  core::LoopClosure loop;
  loop.query_keyframe_id = message.query_keyframe_id;
  loop.match_keyframe_id = message.match_keyframe_id;
  loop.query_frame = message.query_frame;
  loop.match_frame = message.match_frame;
  loop.query_stamp_ns = message.query_stamp_ns;
  loop.match_stamp_ns = message.match_stamp_ns;
  loop.query_begin = message.query_begin;
  loop.query_end = message.query_end;
  loop.match_begin = message.match_begin;
  loop.match_end = message.match_end;
  loop.accepted = message.accepted != 0;
  loop.reason = static_cast<core::LoopReason>(message.reason);
  loop.score = message.score;
  loop.second_score = message.second_score;
  loop.rms_m = message.rms_m;
  loop.spread_m = message.spread_m;
  loop.tilt_deg = message.tilt_deg;
  loop.reprojection_ratio = message.reprojection_ratio;
  loop.reprojected_objects = message.reprojected_objects;
  loop.explained_share = message.explained_share;
  loop.refine_residual = message.refine_residual;
  loop.refine_shift_m = message.refine_shift_m;
  loop.refine_shift_deg = message.refine_shift_deg;
  loop.sigma_m = message.sigma_m;
  loop.sigma_deg = message.sigma_deg;
  loop.inliers = message.inliers;
  loop.labels = message.labels;
  loop.T_match_query = from_msg(message.match_from_query);
  loop.covariance = to_matrix6(message.covariance);
  loop.scale = message.scale;
  loop.scale_covariance = Eigen::Map<const core::Vec7>(message.scale_covariance.data());
  loop.matches = from_messages<core::ObjectMatch>(message.matches);
  if (message.in_earlier_map != 0) loop.T_earlier_match = from_msg(message.earlier_map_from_match);
  return loop;
}

void to_msg(const std::vector<core::LoopClosure>& loops, LoopClosureArray* message) {
  message->closures = to_messages<LoopClosure>(loops);
}

std::vector<core::LoopClosure> from_msg(const LoopClosureArray& message) {
  return from_messages<core::LoopClosure>(message.closures);
}

OdometryReport to_msg(const core::OdometryReport& report) {
  OdometryReport message;
  message.stated_edges = report.stated_edges;
  message.translation_m = report.translation_m;
  message.rotation_rad = report.rotation_rad;
  message.steady_translation = report.steady_translation;
  message.steady_rotation_rad = report.steady_rotation_rad;
  message.scale = report.scale;
  message.loop_factor = report.loop_factor;
  message.faults = to_messages<OdometryFault>(report.faults);
  return message;
}

core::OdometryReport from_msg(const OdometryReport& message) {
  core::OdometryReport report;
  report.stated_edges = message.stated_edges;
  report.translation_m = message.translation_m;
  report.rotation_rad = message.rotation_rad;
  report.steady_translation = message.steady_translation;
  report.steady_rotation_rad = message.steady_rotation_rad;
  report.scale = message.scale;
  report.loop_factor = message.loop_factor;
  report.faults = from_messages<core::OdometryFault>(message.faults);
  return report;
}

void to_msg(const core::MapCorrection& correction, MapCorrection* message) {
  message->frame_id = correction.frame_id;
  message->changed = correction.changed;
  message->valid_to_keyframe_id = correction.valid_to_keyframe_id;
  message->map_from_odom_old = to_msg(correction.T_map_odom_old);
  message->map_from_odom = to_msg(correction.T_map_odom);
  message->scale = correction.scale;
  message->keyframes = to_messages<KeyframePose>(correction.keyframes);
  message->loops = to_messages<LoopVerdict>(correction.loops);
  message->odometry = to_msg(correction.odometry);
  message->duration_us = correction.duration_us;
}

core::MapCorrection from_msg(const MapCorrection& message) {
  core::MapCorrection correction;
  correction.frame_id = message.frame_id;
  correction.changed = message.changed != 0;
  correction.valid_to_keyframe_id = message.valid_to_keyframe_id;
  correction.T_map_odom_old = from_msg(message.map_from_odom_old);
  correction.T_map_odom = from_msg(message.map_from_odom);
  correction.scale = message.scale;
  correction.keyframes = from_messages<core::KeyframePose>(message.keyframes);
  correction.loops = from_messages<core::LoopVerdict>(message.loops);
  correction.odometry = from_msg(message.odometry);
  correction.duration_us = message.duration_us;
  return correction;
}

}  // namespace semantic_topo_loop
