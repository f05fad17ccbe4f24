#include <nav_msgs/Odometry.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Empty.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/transform_broadcaster.h>

#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <set>
#include <string>

#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/ros/conversions.h"
#include "semantic_topo_loop/ros/pose_frontend_parameters.h"
#include "semantic_topo_loop/ros/pose_odometry.h"
#include "semantic_topo_loop/ros/pose_source.h"
#include "semantic_topo_loop/ros/pose_tf.h"
#include "semantic_topo_loop/ros/stage.h"

namespace semantic_topo_loop {

/// Makes a Frame of each image stamp for which the odometry has a pose, and owns the session: it alone starts, pauses
/// and resumes. Images and the end of the stream are answered in order; each waits at most `pose_timeout_s`.
class PoseFrontendNodelet : public Stage {
 public:
  PoseFrontendNodelet() : Stage("PoseFrontend") {}
  ~PoseFrontendNodelet() override { stop(); }

 private:
  using Clock = std::chrono::steady_clock;
  struct Trigger {
    std::int64_t stamp_ns = 0;
    Clock::time_point deadline;
    bool is_end = false;
  };

  void onInit() override;
  bool open_source();
  void subscribe_all();
  void advertise_services();
  template <class Message>
  void listen(const std::string& topic, std::uint32_t queue_size, void (PoseFrontendNodelet::*handler)(const Message&));
  void add_service(const std::string& service, const std::string& answer, void (PoseFrontendNodelet::*handler)());

  void begin_session(const std::string& reason);
  void control(std::uint8_t command, const std::string& reason);
  void reset() { begin_session("reset was called"); }
  void pause();
  void resume();

  /// Somebody came late: repeats the last command, for the stages to acknowledge it once more.
  void on_query(const std_msgs::Empty& /*message*/) { control_publisher_.publish(control_); }
  void on_camera_info(const sensor_msgs::CameraInfo& message);
  void on_detections(const DetectionArray& message) { take_trigger(to_stamp_ns(message.header.stamp)); }
  void on_transforms(const tf2_msgs::TFMessage& message) { take_transforms(message, false); }
  void on_static_transforms(const tf2_msgs::TFMessage& message) { take_transforms(message, true); }
  void take_transforms(const tf2_msgs::TFMessage& message, bool is_static);
  void on_odometry(const nav_msgs::Odometry& message);
  void on_points(const sensor_msgs::PointCloud2ConstPtr& message);
  void on_end(const std_msgs::Empty& message);

  void take_trigger(std::int64_t stamp_ns);
  bool is_in_order(std::int64_t stamp_ns);
  /// Answers what can be answered, in order.
  void resolve();
  /// @return false if the trigger must wait on
  bool resolve(const Trigger& trigger);
  bool take_points(const Trigger& trigger, bool is_late, core::PoseSample* sample);
  void emit(const core::PoseSample& sample);
  void emit_end();
  void publish_frame(const core::Frame& frame);
  void publish_odom_tf(const core::Frame& frame);
  void publish_done(std::int64_t stamp_ns, std::uint8_t status);
  /// Counts, and warns at the first time.
  void complain(const std::string& cause, const std::string& detail);

  core::Options options_;
  PoseFrontendParameters parameters_;
  std::shared_ptr<PoseSource> source_;
  std::shared_ptr<TfPoses> transforms_;      ///< if tf is read
  std::shared_ptr<OdometryPoses> odometry_;  ///< if source_ is odometry
  std::optional<core::FrameBuilder> builder_;
  std::optional<core::Camera> camera_;
  bool has_camera_file_ = false;
  std::string camera_frame_;
  std::deque<Trigger> pending_;
  std::map<std::int64_t, sensor_msgs::PointCloud2ConstPtr> points_;
  std::optional<std::int64_t> last_stamp_ns_;
  bool is_paused_ = false;
  SessionControlPtr control_;  ///< the last command
  std::set<std::string> complaints_;
  std::unique_ptr<tf2_ros::TransformBroadcaster> broadcaster_;
  ros::Publisher control_publisher_, frame_publisher_, keyframe_publisher_, done_publisher_;
};

void PoseFrontendNodelet::onInit() {
  if (!start(&options_, &parameters_, 2) || !open_source()) return;
  frame_publisher_ = advertise<Frame>("frames");
  keyframe_publisher_ = advertise<Keyframe>("keyframes");
  done_publisher_ = advertise<FrameDone>("frame_done");
  if (parameters_.publish_odom_tf) broadcaster_ = std::make_unique<tf2_ros::TransformBroadcaster>();
  control_publisher_ = advertise<SessionControl>("session_control", true);
  advertise_services();
  subscribe_all();
  // Last: who hears of the session takes this nodelet for ready.
  push("start", Keep::kAlways, [this] { begin_session("start"); });
}

bool PoseFrontendNodelet::open_source() {
  std::string error;
  if (!parameters_.camera_file.empty()) {
    camera_ = core::read_camera(parameters_.camera_file, &error);
    if (!camera_) {
      fail(error);
      return false;
    }
    has_camera_file_ = true;
  }
  camera_frame_ = parameters_.camera_frame;
  if (parameters_.pose_source == "file") {
    std::optional<core::StampedPoses> trajectory = core::read_tum_trajectory(parameters_.trajectory_file, &error);
    if (!trajectory) {
      fail(error);
      return false;
    }
    source_ = std::make_shared<FilePoses>(std::move(*trajectory));
  }
  if (parameters_.needs_tf()) {
    transforms_ = std::make_shared<TfPoses>(parameters_.odom_frame, parameters_.max_pose_gap_s);
  }
  if (parameters_.pose_source == "odometry") {
    odometry_ = std::make_shared<OdometryPoses>(transforms_, parameters_.max_pose_gap_s);
    source_ = odometry_;
  }
  if (!source_) source_ = transforms_;
  return true;
}

template <class Message>
void PoseFrontendNodelet::listen(const std::string& topic, std::uint32_t queue_size,
                                 void (PoseFrontendNodelet::*handler)(const Message&)) {
  using ConstPtr = boost::shared_ptr<const Message>;
  const boost::function<void(const ConstPtr&)> callback = [this, topic, handler](const ConstPtr& message) {
    push(topic, Keep::kAlways, [this, handler, message] { (this->*handler)(*message); });
  };
  keep_subscriber(getNodeHandle().subscribe<Message>(topic, queue_size, callback));
}

void PoseFrontendNodelet::subscribe_all() {
  constexpr std::uint32_t kTfQueue = 1000;
  const auto queue_size = static_cast<std::uint32_t>(queue_capacity());
  if (transforms_) {
    listen<tf2_msgs::TFMessage>("/tf_static", kTfQueue, &PoseFrontendNodelet::on_static_transforms);
    listen<tf2_msgs::TFMessage>("/tf", kTfQueue, &PoseFrontendNodelet::on_transforms);
  }
  if (odometry_) listen<nav_msgs::Odometry>("odometry", kTfQueue, &PoseFrontendNodelet::on_odometry);
  if (parameters_.use_points) {
    const boost::function<void(const sensor_msgs::PointCloud2ConstPtr&)> callback =
        [this](const sensor_msgs::PointCloud2ConstPtr& message) {
          push("points", Keep::kDroppable, [this, message] { on_points(message); });
        };
    keep_subscriber(getNodeHandle().subscribe<sensor_msgs::PointCloud2>("points", queue_size, callback));
  }
  listen<std_msgs::Empty>("session_queries", queue_size, &PoseFrontendNodelet::on_query);
  listen<std_msgs::Empty>("end_of_stream", queue_size, &PoseFrontendNodelet::on_end);
  if (parameters_.trigger == "detections") {
    listen<DetectionArray>("detections_in", queue_size, &PoseFrontendNodelet::on_detections);
  }
  listen<sensor_msgs::CameraInfo>("camera_info", queue_size, &PoseFrontendNodelet::on_camera_info);
  constexpr double kDeadlinePeriodS = 0.02;
  start_timer(kDeadlinePeriodS, [this] { resolve(); });
}

void PoseFrontendNodelet::add_service(const std::string& service, const std::string& answer,
                                      void (PoseFrontendNodelet::*handler)()) {
  using Request = std_srvs::Trigger::Request;
  using Response = std_srvs::Trigger::Response;
  const boost::function<bool(Request&, Response&)> callback = [this, service, answer, handler](Request&,
                                                                                               Response& response) {
    push(service, Keep::kAlways, [this, handler] { (this->*handler)(); });
    response.success = true;
    response.message = answer;
    return true;
  };
  keep_service(getPrivateNodeHandle().advertiseService(service, callback));
}

void PoseFrontendNodelet::advertise_services() {
  add_service("reset", "a new session begins", &PoseFrontendNodelet::reset);
  add_service("pause", "images are left out until ~resume", &PoseFrontendNodelet::pause);
  add_service("resume", "images are taken again", &PoseFrontendNodelet::resume);
}

void PoseFrontendNodelet::begin_session(const std::string& reason) {
  builder_.reset();
  source_->reset();
  const auto is_image = [](const Trigger& trigger) { return !trigger.is_end; };
  pending_.erase(std::remove_if(pending_.begin(), pending_.end(), is_image), pending_.end());
  last_stamp_ns_.reset();
  is_paused_ = false;
  control(SessionControl::COMMAND_START, reason);
}

void PoseFrontendNodelet::control(std::uint8_t command, const std::string& reason) {
  auto message = boost::make_shared<SessionControl>();
  // Wall time: it tells sessions apart when this nodelet was loaded again, and is no stamp of data.
  const ros::WallTime now = ros::WallTime::now();
  message->header.stamp = ros::Time(now.sec, now.nsec);
  message->session_id = (control_ ? control_->session_id : 0) + (command == SessionControl::COMMAND_START ? 1 : 0);
  message->command = command;
  message->reason = reason;
  NODELET_INFO("session %u: %s", message->session_id, reason.c_str());
  control_ = message;
  control_publisher_.publish(control_);
}

void PoseFrontendNodelet::pause() {
  if (is_paused_) return;
  is_paused_ = true;
  control(SessionControl::COMMAND_PAUSE, "pause was called");
}

void PoseFrontendNodelet::resume() {
  if (!is_paused_) return;
  is_paused_ = false;
  control(SessionControl::COMMAND_RESUME, "resume was called");
}

void PoseFrontendNodelet::on_camera_info(const sensor_msgs::CameraInfo& message) {
  if (parameters_.camera_frame.empty()) camera_frame_ = strip_leading_slash(message.header.frame_id);
  if (!has_camera_file_) {
    std::string error;
    camera_ = checked_camera(message, &error);
    if (!camera_) complain("camera_info without a usable calibration", error + "; give camera_file");
    if (camera_ && builder_) builder_->set_camera(*camera_);
  }
  if (parameters_.trigger == "camera_info") take_trigger(to_stamp_ns(message.header.stamp));
}

void PoseFrontendNodelet::take_transforms(const tf2_msgs::TFMessage& message, bool is_static) {
  std::string error;
  if (!transforms_->add(message, is_static, &error)) complain("bad transforms", error);
  resolve();
}

void PoseFrontendNodelet::on_odometry(const nav_msgs::Odometry& message) {
  std::string error;
  if (!odometry_->add(message, &error)) complain("bad odometry", error);
  resolve();
}

void PoseFrontendNodelet::on_points(const sensor_msgs::PointCloud2ConstPtr& message) {
  constexpr std::size_t kKept = 10;
  points_[to_stamp_ns(message->header.stamp)] = message;
  if (points_.size() > kKept) points_.erase(points_.begin());
  resolve();
}

void PoseFrontendNodelet::on_end(const std_msgs::Empty&) {
  Trigger end;
  end.is_end = true;
  pending_.push_back(end);
  resolve();
}

void PoseFrontendNodelet::take_trigger(std::int64_t stamp_ns) {
  if (is_paused_) {
    statistics().count("images left out while paused");
    publish_done(stamp_ns, FrameDone::STATUS_FAILED);
    return;
  }
  if (!is_in_order(stamp_ns)) return;
  last_stamp_ns_ = stamp_ns;
  const std::chrono::duration<double> timeout(parameters_.pose_timeout_s);
  pending_.push_back({stamp_ns, Clock::now() + std::chrono::duration_cast<Clock::duration>(timeout), false});
  if (pending_.size() > queue_capacity() && !pending_.front().is_end) {
    complain("images dropped, too many wait for their pose", "raise queue_size or lower pose_timeout_s");
    publish_done(pending_.front().stamp_ns, FrameDone::STATUS_FAILED);
    pending_.pop_front();
  }
  resolve();
}

bool PoseFrontendNodelet::is_in_order(std::int64_t stamp_ns) {
  constexpr std::int64_t kJumpBackNs = 1000000000;
  if (!last_stamp_ns_ || stamp_ns > *last_stamp_ns_) return true;
  const std::string detail =
      "stamp " + std::to_string(stamp_ns) + " ns after " + std::to_string(*last_stamp_ns_) + " ns";
  if (stamp_ns < *last_stamp_ns_ - kJumpBackNs) {
    NODELET_WARN("time jumped back: %s", detail.c_str());
    begin_session("time jumped back");
    return true;
  }
  complain(stamp_ns == *last_stamp_ns_ ? "images with the stamp of the one before" : "images out of order", detail);
  publish_done(stamp_ns, FrameDone::STATUS_FAILED);
  return false;
}

void PoseFrontendNodelet::resolve() {
  while (!pending_.empty() && resolve(pending_.front())) pending_.pop_front();
}

bool PoseFrontendNodelet::resolve(const Trigger& trigger) {
  if (trigger.is_end) {
    emit_end();
    return true;
  }
  PoseSource::Answer answer = source_->at(trigger.stamp_ns, camera_frame_);
  const bool is_late = Clock::now() >= trigger.deadline;
  if (answer.status == PoseSource::Status::kNotYet && !is_late) return false;
  if (answer.status != PoseSource::Status::kFound) {
    complain("images without a pose", answer.problem);
    publish_done(trigger.stamp_ns, FrameDone::STATUS_NO_POSE);
    return true;
  }
  if (!take_points(trigger, is_late, &answer.sample)) return false;
  emit(answer.sample);
  return true;
}

bool PoseFrontendNodelet::take_points(const Trigger& trigger, bool is_late, core::PoseSample* sample) {
  if (!parameters_.use_points) return true;
  const auto it = points_.lower_bound(trigger.stamp_ns - kStampToleranceNs);
  if (it == points_.end() || it->first > trigger.stamp_ns + kStampToleranceNs) {
    if (is_late)
      complain("images without points", "no cloud within 1 us of " + std::to_string(trigger.stamp_ns) + " ns");
    return is_late;
  }
  const std::string frame = strip_leading_slash(it->second->header.frame_id);
  std::string error = "cloud in frame '" + frame + "', not in the camera's '" + camera_frame_ + "'";
  std::optional<std::vector<core::Vec3>> points;
  if (frame == camera_frame_) points = from_msg(*it->second, &error);
  if (points) {
    sample->points_camera = std::make_shared<const std::vector<core::Vec3>>(std::move(*points));
  } else {
    complain("unusable points", error);
  }
  points_.erase(points_.begin(), std::next(it));
  return true;
}

void PoseFrontendNodelet::emit(const core::PoseSample& sample) {
  if (!camera_) {
    complain("images without a calibration", "neither camera_file nor a usable camera_info");
    publish_done(sample.stamp_ns, FrameDone::STATUS_FAILED);
    return;
  }
  if (!builder_) builder_.emplace(options_.keyframe, *camera_);
  std::string error;
  const std::optional<core::Frame> frame = builder_->build(sample, &error);
  if (!frame) {
    complain("images left out", error);
    publish_done(sample.stamp_ns, FrameDone::STATUS_FAILED);
    return;
  }
  if (frame->is_break && frame->frame_id > 0) statistics().count("breaks of the odometry");
  publish_frame(*frame);
  if (broadcaster_) publish_odom_tf(*frame);
  count_processed();
}

void PoseFrontendNodelet::emit_end() {
  if (!builder_) builder_.emplace(options_.keyframe, camera_.value_or(core::Camera()));
  publish_frame(builder_->end());
}

void PoseFrontendNodelet::publish_frame(const core::Frame& frame) {
  auto message = boost::make_shared<Frame>();
  to_msg(frame, message.get());
  message->header.frame_id = parameters_.odom_frame;
  message->session_id = control_->session_id;
  message->camera_frame = camera_frame_;
  message->camera.header.frame_id = camera_frame_;
  message->points.header = make_header(message->header.stamp, camera_frame_);
  if (frame.is_keyframe) {
    auto keyframe = boost::make_shared<Keyframe>();
    to_msg(frame, keyframe.get());
    keyframe->header.frame_id = parameters_.odom_frame;
    keyframe->session_id = control_->session_id;
    keyframe_publisher_.publish(keyframe);
  }
  frame_publisher_.publish(message);
}

void PoseFrontendNodelet::publish_odom_tf(const core::Frame& frame) {
  core::SE3 T_odom_child = frame.T_odom_camera;
  const std::string child = parameters_.base_frame.empty() ? camera_frame_ : parameters_.base_frame;
  if (child != camera_frame_) {
    const std::optional<core::SE3> T_camera_base = transforms_->find(camera_frame_, child, frame.stamp_ns);
    if (!T_camera_base) {
      complain("no tf from the camera to base_frame", "'" + camera_frame_ + "' to '" + child + "'");
      return;
    }
    T_odom_child = T_odom_child * *T_camera_base;
  }
  geometry_msgs::TransformStamped transform;
  transform.header = make_header(to_ros_time(frame.stamp_ns), parameters_.odom_frame);
  transform.child_frame_id = child;
  const geometry_msgs::Pose pose = to_msg(T_odom_child);
  transform.transform.rotation = pose.orientation;
  transform.transform.translation = to_vector_msg(T_odom_child.t);
  broadcaster_->sendTransform(transform);
}

void PoseFrontendNodelet::publish_done(std::int64_t stamp_ns, std::uint8_t status) {
  auto message = boost::make_shared<FrameDone>();
  message->header.stamp = to_ros_time(stamp_ns);
  message->session_id = control_->session_id;
  message->frame_id = -1;
  message->status = status;
  message->stage = name();
  done_publisher_.publish(message);
}

void PoseFrontendNodelet::complain(const std::string& cause, const std::string& detail) {
  statistics().count(cause);
  if (complaints_.insert(cause).second) {
    NODELET_WARN("%s: %s (further ones are counted in the diagnostics)", cause.c_str(), detail.c_str());
  }
}

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::PoseFrontendNodelet, nodelet::Nodelet)
