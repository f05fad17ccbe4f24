#include <nav_msgs/Odometry.h>
#include <sensor_msgs/PointCloud2.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <deque>
#include <map>
#include <memory>
#include <pluginlib/class_list_macros.hpp>
#include <string>

#include "ros/detector_messages.h"
#include "ros/frontend_stage.h"
#include "ros/pose_source.h"
#include "semantic_topo_loop/io/tum_trajectory.h"

namespace semantic_topo_loop {

/// Makes a Frame of each image stamp for which the odometry has a pose. Images and the end of the stream are answered
/// in order; each waits at most `pose_timeout_s`.
class PoseFrontendNodelet : public StageWith<PoseFrontendParameters, FrontendStage> {
 public:
  PoseFrontendNodelet() : StageWith("PoseFrontend") {}
  ~PoseFrontendNodelet() override { stop(); }

 private:
  using Clock = std::chrono::steady_clock;
  struct Trigger {
    std::int64_t stamp_ns = 0;
    Clock::time_point deadline;
    bool is_end = false;
  };

  void onInit() override {
    if (!start(2) || !open_source()) return;
    if (!open(options_.keyframe, parameters_, transforms_)) return;
    constexpr std::uint32_t kOdometryQueue = 1000;  // seconds, at the rate of an inertial odometry
    const auto queue_size = static_cast<std::uint32_t>(queue_capacity());
    if (odometry_) listen("odometry", Keep::kAlways, kOdometryQueue, &PoseFrontendNodelet::on_odometry);
    if (parameters_.use_points) listen("points", Keep::kDroppable, queue_size, &PoseFrontendNodelet::on_points);
    if (parameters_.trigger == "detections") {
      listen("detections_in", Keep::kAlways, queue_size, &PoseFrontendNodelet::on_detections);
    }
    follow_stream();
    constexpr double kDeadlinePeriodS = 0.02;  // below the time between two images
    start_timer(kDeadlinePeriodS, [this] { resolve(); });
  }

  bool open_source() {
    if (parameters_.pose_source == "file") {
      core::Result<core::StampedPoses> trajectory = core::read_tum_trajectory(parameters_.trajectory_file);
      if (!trajectory) return fail(trajectory.message());
      source_ = std::make_shared<FilePoses>(std::move(*trajectory));
    }
    if (parameters_.needs_tf()) {
      transforms_ = std::make_shared<TfPoses>(parameters_.odom_frame, parameters_.max_pose_gap_s);
    }
    if (parameters_.pose_source == "odometry") {
      odometry_ = std::make_shared<OdometryPoses>(transforms_, parameters_.max_pose_gap_s, parameters_.base_frame);
      source_ = odometry_;
    }
    if (!source_) source_ = transforms_;
    return true;
  }

  void forget() override {
    source_->reset();
    const auto is_image = [](const Trigger& trigger) { return !trigger.is_end; };
    pending_.erase(std::remove_if(pending_.begin(), pending_.end(), is_image), pending_.end());
  }

  void on_camera_stamp(std::int64_t stamp_ns) override {
    if (parameters_.trigger == "camera_info") take_trigger(stamp_ns);
  }

  std::string image_topic() const override {
    return getNodeHandle().resolveName(parameters_.trigger == "detections" ? "detections_in" : "camera_info");
  }

  void on_more_transforms() override { resolve(); }

  void on_end() override {
    pending_.push_back({0, {}, true});
    resolve();
  }

  void on_detections(const DetectorMessage::ConstPtr& message) {
    // Of the stamp alone: DetectionIngestion reads the boxes, and knows the classes.
    const auto detections = read_detector_message(*message, {}, [](auto&&...) {});
    if (!detections) return complain("messages that are no detections", "on detections_in: " + detections.message());
    take_trigger(detections->stamp_ns);
  }

  void on_odometry(const nav_msgs::Odometry::ConstPtr& message) {
    if (const core::Status added = odometry_->add(*message); !added) complain("bad odometry", added.message());
    if (message->child_frame_id.empty() && parameters_.base_frame.empty()) {
      complain("odometry without a child_frame_id",
               "taken for the poses of the camera's optical frame; else give base_frame");
    }
    // Where we send that frame ourselves it may have any name.
    const std::string frame = strip_leading_slash(message->header.frame_id);
    const bool is_other = !frame.empty() && frame != parameters_.odom_frame && !parameters_.publish_odom_tf;
    warn_while("frame", is_other
                            ? "odometry in frame '" + frame + "', but odom_frame = '" + parameters_.odom_frame + "'"
                            : std::string());
    resolve();
  }

  void on_points(const sensor_msgs::PointCloud2ConstPtr& message) {
    const std::int64_t stamp_ns = to_stamp_ns(message->header.stamp);
    points_.erase(points_.upper_bound(stamp_ns + kJumpBack_ns), points_.end());
    points_[stamp_ns] = message;
    // Clouds wait for their image, at a high rate as long as that waits for its pose.
    constexpr std::size_t kKept = 10;
    const std::int64_t oldest_ns = stamp_ns - std::llround(1e9 * parameters_.pose_timeout_s);
    while (points_.size() > kKept && (points_.begin()->first < oldest_ns || points_.size() > queue_capacity())) {
      points_.erase(points_.begin());
    }
    resolve();
  }

  void take_trigger(std::int64_t stamp_ns) {
    if (!accept(stamp_ns)) return;
    const std::chrono::duration<double> timeout(parameters_.pose_timeout_s);
    pending_.push_back({stamp_ns, Clock::now() + std::chrono::duration_cast<Clock::duration>(timeout), false});
    if (pending_.size() > queue_capacity() && !pending_.front().is_end) {
      fail_image(pending_.front().stamp_ns, "images dropped, too many wait for their pose",
                 "raise queue_size or lower pose_timeout_s");
      pending_.pop_front();
    }
    resolve();
  }

  /// Answers what can be answered, in order.
  void resolve() {
    while (!pending_.empty() && resolve(pending_.front())) pending_.pop_front();
  }

  /// @return false if the trigger must wait on
  bool resolve(const Trigger& trigger) {
    if (trigger.is_end) {
      emit_end();
      return true;
    }
    PoseSource::Answer answer = source_->at(trigger.stamp_ns, camera_frame());
    const bool is_late = Clock::now() >= trigger.deadline;
    if (answer.status == PoseSource::Status::kNotYet && !is_late) return false;
    if (answer.status != PoseSource::Status::kFound) {
      fail_image(trigger.stamp_ns, "images without a pose", answer.problem, FrameDone::STATUS_NO_POSE);
      return true;
    }
    if (!take_points(trigger, is_late, &answer.sample)) return false;
    if (emit(answer.sample, camera())) source_->use(trigger.stamp_ns);
    return true;
  }

  bool take_points(const Trigger& trigger, bool is_late, core::PoseSample* sample) {
    if (!parameters_.use_points) return true;
    const auto it = points_.lower_bound(trigger.stamp_ns - kStampTolerance_ns);
    if (it == points_.end() || it->first > trigger.stamp_ns + kStampTolerance_ns) {
      // Clouds that are fewer than the images come in order, too.
      const bool is_past = it != points_.end() && it->first <= trigger.stamp_ns + kJumpBack_ns;
      if (!is_late && !is_past) return false;
      complain("images without points", "no cloud within 1 us of " + std::to_string(trigger.stamp_ns) + " ns");
      return true;
    }
    const std::string frame = strip_leading_slash(it->second->header.frame_id);
    core::Result<std::vector<core::Vec3>> points =
        core::Error{"cloud in frame '" + frame + "', not in the camera's '" + camera_frame() + "'"};
    if (frame == camera_frame()) points = from_msg(*it->second);
    if (points) {
      sample->points_camera = std::make_shared<const std::vector<core::Vec3>>(*std::move(points));
    } else {
      complain("unusable points", points.message());
    }
    points_.erase(points_.begin(), std::next(it));
    return true;
  }

  std::shared_ptr<PoseSource> source_;
  std::shared_ptr<TfPoses> transforms_;      ///< if tf is read
  std::shared_ptr<OdometryPoses> odometry_;  ///< if source_ is odometry
  std::deque<Trigger> pending_;
  std::map<std::int64_t, sensor_msgs::PointCloud2ConstPtr> points_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::PoseFrontendNodelet, nodelet::Nodelet)
