#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/Empty.h>
#include <std_msgs/String.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/transform_broadcaster.h>

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "ros/image_watch.h"
#include "ros/parameters.h"
#include "ros/pose_source.h"
#include "ros/stage.h"
#include "semantic_topo_loop/LoadMap.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"

namespace semantic_topo_loop {

/// What the front ends share: the session, which a front end alone starts, pauses and resumes, the order of images,
/// the calibration, and the frames, keyframes and tf that come of a pose. Every image is answered, by a frame or by a
/// FrameDone that says why there is none, but for those that are dropped since they come too fast, or as a session
/// begins.
///
/// A derived class calls Stage::start, `open`, makes its own subscriptions, then calls `follow_stream`.
class FrontendStage : public Stage {
 protected:
  explicit FrontendStage(std::string name) : Stage(std::move(name)) {}
  ~FrontendStage() override {
    stop();
    remove_link(map_);
  }

  /// Reads the calibration, advertises, and makes the session the worker's first task.
  /// @param transforms filled from tf; null if tf is neither read nor sent   @return false after fail()
  bool open(const core::KeyframeOptions& options, const FrontendParameters& parameters,
            std::shared_ptr<TfPoses> transforms);
  /// Follows tf, camera_info and the end of the stream, watches that images come and give frames, and lets the worker
  /// open the session: who hears of it takes this nodelet for ready. Who comes late may ask for the last command again,
  /// for the stages to acknowledge it.
  void follow_stream();

  /// A new session begins: forget the images that wait.
  virtual void forget() = 0;
  /// A camera_info came; its calibration is taken already.
  virtual void on_camera_stamp(std::int64_t /*stamp_ns*/) {}
  /// The topic on which an image should come at any time; empty: the derived class watches that itself.
  virtual std::string image_topic() const { return {}; }
  /// tf knows more than before.
  virtual void on_more_transforms() {}
  /// What the point map keeps of the keyframe that `emit` has just made; null: nothing. Asked for only if somebody
  /// listens.
  virtual std::shared_ptr<const core::KeyframePoints> keyframe_points() { return nullptr; }
  /// The stream has ended: call `emit_end` once every image is answered.
  virtual void on_end() = 0;

  /// Where the camera is in tf as its images have it, until a parameter or camera_info tells.
  void on_image_frame(const std::string& frame_id);
  /// @return whether an image is to be worked on; else it is answered. A jump back in time begins a session.
  bool accept(std::int64_t stamp_ns);
  /// @param rewind ask for the images of this session again, which a Player in lockstep gives
  void begin_session(const std::string& reason, bool rewind = false);
  /// @param camera of the frame; none: the image is answered by a failure
  /// @return whether the image has become a frame
  bool emit(const core::PoseSample& sample, const std::optional<core::Camera>& camera);
  void emit_end();
  /// Answers an image that gives no frame, and complains.
  void fail_image(std::int64_t stamp_ns, const std::string& cause, const std::string& detail,
                  std::uint8_t status = FrameDone::STATUS_FAILED);
  /// Whether it is wrong that no image comes.
  bool awaits_images() const;
  /// Whether images come from a Player, which alone can be asked for them again.
  bool is_played() const { return end_subscriber_.getNumPublishers() > 0; }
  const std::optional<core::Camera>& camera() const { return camera_; }
  /// That of the map that a session goes on with, where it has one.
  const core::Camera& map_camera() const { return map_.camera; }
  const std::string& camera_frame() const { return camera_frame_; }

 private:
  /// What the sessions to come go on with. @param file a map's, or empty   @return an error if it cannot be read
  core::Status set_map(const std::string& file, bool frozen);
  void make_builder(const core::Camera& camera);
  bool on_load_map(LoadMap::Request& request, LoadMap::Response& response);
  void publish_done(std::int64_t stamp_ns, std::uint8_t status) {
    Stage::publish_done(done_publisher_, to_ros_time(stamp_ns), -1, status);
  }
  void watch_images();
  void control(std::uint8_t command, const std::string& reason, bool rewind = false);
  void set_paused(bool is_paused);
  bool is_in_order(std::int64_t stamp_ns);
  /// Whether an image was on its way already when the recording was asked to begin anew.
  bool is_before_rewind(std::int64_t stamp_ns);

  void on_stream_end(const std_msgs::Empty::ConstPtr& /*message*/) {
    is_over_ = true;
    end_at_work_ = StageStatistics::Clock::now();
    on_end();
  }
  void on_working(const std_msgs::String::ConstPtr& stage) {
    if (end_at_work_ && stage->data != name()) end_at_work_ = StageStatistics::Clock::now();
  }
  /// Whether the stages still work on the end of the stream: a session that began now would take it from them.
  bool is_ending() const;
  void on_camera_info(const sensor_msgs::CameraInfo::ConstPtr& message);
  void on_transforms(const tf2_msgs::TFMessage::ConstPtr& message) { take_transforms(*message, false); }
  void on_static_transforms(const tf2_msgs::TFMessage::ConstPtr& message) { take_transforms(*message, true); }
  void take_transforms(tf2_msgs::TFMessage message, bool is_static);

  void publish_frame(core::Frame frame);
  void publish_odom_tf(const core::Frame& frame);

  core::KeyframeOptions keyframe_options_;
  FrontendParameters parameters_;
  std::shared_ptr<TfPoses> transforms_;  ///< if tf is read
  std::optional<core::FrameBuilder> builder_;
  std::optional<core::Camera> camera_;
  bool has_camera_file_ = false;
  std::string camera_frame_;
  std::optional<std::int64_t> last_stamp_ns_, last_frame_ns_;
  std::optional<std::int64_t> rewound_at_ns_;     ///< the last image before the rewind that this session waits for
  std::size_t before_rewind_ = 0;                 ///< images left out since
  std::optional<std::int64_t> unknown_since_ns_;  ///< tf did not know the camera first
  bool is_paused_ = false, is_localizing_ = false;
  bool is_over_ = false;  ///< the stream has ended, and no image came since
  /// Until the stages are through with that end: when one of them was heard of last.
  std::optional<StageStatistics::Clock::time_point> end_at_work_;
  ImageWatch image_watch_;
  ros::Subscriber end_subscriber_;
  /// The map that a session begins with.
  struct SessionMap {
    std::string file;      ///< as its sessions read it, see link_loaded_map; empty: none
    bool is_link = false;  ///< made for them
    bool frozen = false;
    std::int64_t next_frame_id = 0, next_keyframe_id = 0;
    core::Camera camera;
  };
  static void remove_link(const SessionMap& map);
  SessionMap map_;
  SessionControlPtr control_;  ///< the last command; never null once the worker runs
  std::unique_ptr<tf2_ros::TransformBroadcaster> broadcaster_;
  std::deque<ros::Time> sent_stamps_;  ///< of the transforms that it sent
  StageStatistics::Clock::time_point clock_missed_since_ = StageStatistics::Clock::now();
  ros::Publisher control_publisher_, frame_publisher_, keyframe_publisher_, points_publisher_, done_publisher_;
};

}  // namespace semantic_topo_loop
