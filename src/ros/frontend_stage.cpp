#include "ros/frontend_stage.h"

#include <std_srvs/SetBool.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <utility>

#include "pipeline/map_state.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/io/map_database.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop {
namespace {

constexpr std::uint32_t kTfQueue = 1000;  ///< seconds of tf at the rate of a robot with many joints

}  // namespace

bool FrontendStage::open(const core::KeyframeOptions& options, const FrontendParameters& parameters,
                         std::shared_ptr<TfPoses> transforms) {
  keyframe_options_ = options;
  parameters_ = parameters;
  transforms_ = std::move(transforms);
  camera_frame_ = parameters_.camera_frame;
  if (!parameters_.camera_file.empty()) {
    const core::Result<core::Camera> camera = core::read_camera(parameters_.camera_file);
    if (!camera) return fail(camera.message());
    camera_ = *camera;
    has_camera_file_ = true;
  }
  if (const core::Status map = set_map(parameters_.map_file, parameters_.frozen); !map) return fail(map.message());
  frame_publisher_ = advertise<FrameMessage>("frames");
  keyframe_publisher_ = advertise<Keyframe>("keyframes");
  points_publisher_ = advertise<KeyframePointsMessage>("keyframe_points");
  done_publisher_ = advertise_done();
  if (parameters_.publish_odom_tf) broadcaster_ = std::make_unique<tf2_ros::TransformBroadcaster>();
  control_publisher_ = advertise<SessionControl>("session_control", true);
  // Before anything can arrive.
  push("start", Keep::kPinned, [this] { begin_session("start"); });
  const auto add_service = [this](const std::string& service, const std::string& answer, const Worker::Task& task) {
    serve_trigger(service, [this, service, answer, task] {
      push(service, Keep::kPinned, task);
      return answer;
    });
  };
  add_service("reset", "a new session begins", [this] { begin_session("reset was called"); });
  add_service("pause", "images are left out until ~resume", [this] { set_paused(true); });
  add_service("resume", "images are taken again", [this] { set_paused(false); });
  serve("load_map", &FrontendStage::on_load_map);
  serve<std_srvs::SetBool::Request, std_srvs::SetBool::Response>(
      "set_localization_mode", [this](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
        push("set_localization_mode", Keep::kPinned, [this, wanted = request.data != 0] {
          is_localizing_ = wanted;
          control(SessionControl::COMMAND_LOCALIZATION, wanted ? "the map is fixed" : "the map grows");
        });
        response.success = true;
        response.message = request.data != 0 ? "the map is fixed from now on" : "the map grows from now on";
        return true;
      });
  return true;
}

core::Status FrontendStage::set_map(const std::string& file, bool frozen) {
  SessionMap next;
  if (!file.empty()) {
    std::error_code code;
    const std::string absolute = std::filesystem::absolute(file, code).lexically_normal().string();
    const auto loaded = core::link_loaded_map(absolute);
    if (!loaded) return loaded.error();
    next.file = *loaded;
    next.is_link = *loaded != absolute;
    next.frozen = frozen;
    const auto map = core::read_map(next.file, *classes());
    const bool has_no_place = map && frozen && (*map)->submaps.empty();
    if (!map || has_no_place) {
      if (next.file != map_.file) remove_link(next);
      if (has_no_place) return core::Error{file + ": holds no place to be found at"};
      std::string problem = map.message();
      if (problem.rfind(next.file, 0) == 0) problem.replace(0, next.file.size(), absolute);  // not of the link's name
      return core::Error{problem};
    }
    next.camera = (*map)->objects.camera;
    if (!frozen) {
      next.next_frame_id = (*map)->graph.next_frame_id;
      next.next_keyframe_id = (*map)->graph.next_keyframe_id();
    }
  }
  if (next.file != map_.file) remove_link(map_);
  map_ = next;
  return {};
}

void FrontendStage::remove_link(const SessionMap& map) {
  std::error_code code;
  if (map.is_link) std::filesystem::remove(map.file, code);
}

bool FrontendStage::on_load_map(LoadMap::Request& request, LoadMap::Response& response) {
  const core::Result<std::string> place = path_below(parameters_.save_dir, request.path, parameters_.allow_any_path);
  answer(place, &response);
  if (!place) return true;
  const auto loaded = ask("load_map", [this, file = *place, frozen = request.frozen != 0] {
    const core::Status map = set_map(file, frozen);
    if (map) begin_session("load_map was called");
    if (!map) complain("maps that were not loaded", map.message());  // who asked may not have waited
    return map;
  });
  if (!loaded) answer(core::Result<std::string>(core::Error{*place + ": is still being read"}), &response);
  if (loaded && !*loaded) answer(core::Result<std::string>(loaded->error()), &response);
  return true;
}

void FrontendStage::make_builder(const core::Camera& camera) {
  builder_.emplace(keyframe_options_, camera);
  builder_->count_from(map_.next_frame_id, map_.next_keyframe_id);
}

void FrontendStage::follow_stream() {
  const auto queue_size = static_cast<std::uint32_t>(queue_capacity());
  if (transforms_) {
    listen("/tf_static", Keep::kAlways, kTfQueue, &FrontendStage::on_static_transforms);
    listen("/tf", Keep::kAlways, kTfQueue, &FrontendStage::on_transforms);
  }
  const boost::function<void(const std_msgs::Empty::ConstPtr&)> query =
      [repeat = once_in_queue([this] { control_publisher_.publish(control_); })](const auto&) { repeat(); };
  keep_subscriber(subscriber_node().subscribe<std_msgs::Empty>("session_queries", queue_size, query));
  end_subscriber_ = listen("end_of_stream", Keep::kPinned, queue_size, &FrontendStage::on_stream_end);
  listen("working", Keep::kDroppable, queue_size, &FrontendStage::on_working);
  const boost::function<void(const FrameDone::ConstPtr&)> hear_done = [this](const FrameDone::ConstPtr& done) {
    if (done->status != FrameDone::STATUS_END) return;
    push("frame_done", Keep::kPinned, [this, session = done->session_id] {
      if (session == session_id()) end_at_work_.reset();
    });
  };
  keep_subscriber(subscriber_node().subscribe<FrameDone>("frame_done", kRoomForState * queue_size, hear_done));
  listen("camera_info", Keep::kAlways, queue_size, &FrontendStage::on_camera_info);
  start_timer(ImageWatch::kPeriodS, [this] { watch_images(); });
  open_queue();
}

bool FrontendStage::awaits_images() const {
  // Before the first /clock nobody plays yet; a player waits for slow stages, and says itself who has stalled.
  return !is_paused_ && !is_over_ && ros::Time::isValid() && !is_played();
}

void FrontendStage::watch_images() {
  if (is_paused_ || is_over_) image_watch_ = {};
  warn_while("images", image_watch_.tick(awaits_images() ? image_topic() : std::string()));
  constexpr std::chrono::seconds kPatience(5);
  const auto now = StageStatistics::Clock::now();
  if (ros::Time::isValid() || is_played()) clock_missed_since_ = now;
  warn_while("clock",
             now - clock_missed_since_ < kPatience
                 ? std::string()
                 : "use_sim_time is true, but no time has come on /clock for 5 s; what a playback left behind goes by "
                   "`rosparam delete /use_sim_time` and a new start");
}

void FrontendStage::begin_session(const std::string& reason, bool rewind) {
  builder_.reset();
  forget();
  rewound_at_ns_ = rewind ? last_stamp_ns_ : std::nullopt;
  before_rewind_ = 0;
  last_stamp_ns_.reset();
  last_frame_ns_.reset();
  is_paused_ = is_over_ = false;
  end_at_work_.reset();
  control(SessionControl::COMMAND_START, reason, rewind);
}

void FrontendStage::control(std::uint8_t command, const std::string& reason, bool rewind) {
  auto message = boost::make_shared<SessionControl>();
  // Wall time: it tells sessions apart when this nodelet was loaded again, and is no stamp of data.
  const ros::WallTime now = ros::WallTime::now();
  message->header.stamp = ros::Time(now.sec, now.nsec);
  if (command == SessionControl::COMMAND_START) set_session(session_id() + 1);
  message->session_id = session_id();
  message->command = command;
  message->reason = reason;
  message->rewind = rewind;
  message->map_file = map_.file;
  message->frozen = map_.frozen;
  message->localization = is_localizing_;
  NODELET_INFO("session %u: %s", message->session_id, reason.c_str());
  control_ = message;
  control_publisher_.publish(control_);
}

void FrontendStage::set_paused(bool is_paused) {
  if (is_paused == is_paused_) return;
  is_paused_ = is_paused;
  control(is_paused ? SessionControl::COMMAND_PAUSE : SessionControl::COMMAND_RESUME,
          is_paused ? "pause was called" : "resume was called");
}

void FrontendStage::on_camera_info(const sensor_msgs::CameraInfo::ConstPtr& message) {
  const bool names_frame = !message->header.frame_id.empty();
  if (parameters_.camera_frame.empty() && names_frame) camera_frame_ = strip_leading_slash(message->header.frame_id);
  if (!has_camera_file_) {
    const core::Result<core::Camera> camera = checked_camera(*message);
    camera_ = camera ? std::optional(*camera) : std::nullopt;
    if (!camera) complain("camera_info without a usable calibration", camera.message() + "; give camera_file");
  }
  on_camera_stamp(to_stamp_ns(message->header.stamp));
}

void FrontendStage::on_image_frame(const std::string& frame_id) {
  if (camera_frame_.empty()) camera_frame_ = strip_leading_slash(frame_id);
}

void FrontendStage::take_transforms(tf2_msgs::TFMessage message, bool is_static) {
  // Who sends odom -> camera hears it, too: it would be a second parent of a camera whose mount is told later.
  const auto is_own = [this](const geometry_msgs::TransformStamped& transform) {
    if (!broadcaster_ || strip_leading_slash(transform.header.frame_id) != parameters_.odom_frame) return false;
    if (std::find(sent_stamps_.begin(), sent_stamps_.end(), transform.header.stamp) == sent_stamps_.end()) {
      complain("transforms of another odometry", "somebody else sends '" + parameters_.odom_frame + "' -> '" +
                                                     strip_leading_slash(transform.child_frame_id) +
                                                     "', too: set pose_source to tf, or publish_odom_tf to false");
    }
    return true;
  };
  auto& transforms = message.transforms;
  transforms.erase(std::remove_if(transforms.begin(), transforms.end(), is_own), transforms.end());
  if (const core::Status added = transforms_->add(message, is_static); !added) {
    complain("bad transforms", added.message());
  }
  on_more_transforms();
}

bool FrontendStage::accept(std::int64_t stamp_ns) {
  if (is_paused_) {
    statistics().count("images left out while paused");
    publish_done(stamp_ns, FrameDone::STATUS_FAILED);
    return false;
  }
  if (is_over_) {
    // What was on its way still is late; a camera that goes on begins anew, since frames after the end would be
    // nobody's.
    constexpr std::int64_t kLate_ns = 1'000'000'000;
    const bool is_late =
        last_stamp_ns_ && stamp_ns > *last_stamp_ns_ - kJumpBack_ns && stamp_ns <= *last_stamp_ns_ + kLate_ns;
    if (is_late || is_ending()) {
      fail_image(stamp_ns, "images after the end of the stream", "stamp " + std::to_string(stamp_ns) + " ns");
      return false;
    }
    begin_session("images after the end of the stream");
  }
  image_watch_.hear_image();
  if (is_before_rewind(stamp_ns)) {
    fail_image(stamp_ns, "images left out before a rewind", "they were on their way already");
    return false;
  }
  if (!is_in_order(stamp_ns)) return false;
  last_stamp_ns_ = stamp_ns;
  return true;
}

bool FrontendStage::is_ending() const {
  // Who works is heard each second. Longer silence: nobody is there to say that the end is through.
  constexpr std::chrono::seconds kSilence(3);
  return end_at_work_ && StageStatistics::Clock::now() - *end_at_work_ < kSilence;
}

bool FrontendStage::is_before_rewind(std::int64_t stamp_ns) {
  if (!rewound_at_ns_) return false;
  // No player has more on their way: these come from a camera, which cannot be rewound.
  const bool is_live = before_rewind_ == queue_capacity();
  if (stamp_ns <= *rewound_at_ns_ || is_live) rewound_at_ns_.reset();
  before_rewind_ += rewound_at_ns_ ? 1 : 0;
  return rewound_at_ns_.has_value();
}

bool FrontendStage::is_in_order(std::int64_t stamp_ns) {
  if (!last_stamp_ns_ || stamp_ns > *last_stamp_ns_) return true;
  const std::string detail =
      "stamp " + std::to_string(stamp_ns) + " ns after " + std::to_string(*last_stamp_ns_) + " ns";
  if (stamp_ns == 0) {
    fail_image(stamp_ns, "images without a stamp", detail);
    return false;
  }
  const bool is_far_behind = stamp_ns < *last_stamp_ns_ - kJumpBack_ns;
  if (is_far_behind && last_frame_ns_ && stamp_ns > *last_frame_ns_ - kJumpBack_ns) {
    statistics().count("images before the stamp of one that was far ahead");
    return true;  // which made no frame: that time jumped ahead, and not back
  }
  if (is_far_behind) {
    NODELET_WARN("time jumped back: %s", detail.c_str());
    begin_session("time jumped back");
    return true;
  }
  fail_image(stamp_ns, stamp_ns == *last_stamp_ns_ ? "images with the stamp of the one before" : "images out of order",
             detail);
  return false;
}

bool FrontendStage::emit(const core::PoseSample& sample, const std::optional<core::Camera>& camera) {
  if (!camera) {
    fail_image(sample.stamp_ns, "images without a calibration", "neither camera_file nor a usable camera_info");
    return false;
  }
  if (!builder_) make_builder(*camera);
  builder_->set_camera(*camera);
  if (builder_->is_held(sample)) {
    fail_image(sample.stamp_ns, "images between the poses of a slower odometry",
               "its pose at stamp " + std::to_string(sample.stamp_ns) + " ns is the last one again",
               FrameDone::STATUS_NO_POSE);
    return false;
  }
  core::Result<core::Frame> frame = builder_->build(sample);
  if (!frame) {
    fail_image(sample.stamp_ns, "images left out", frame.message());
    return false;
  }
  if (frame->is_break && frame->frame_id > map_.next_frame_id) statistics().count("breaks of the odometry");
  if (frame->is_keyframe && points_publisher_.getNumSubscribers() > 0) frame->keyframe_points = keyframe_points();
  image_watch_.hear_frame();
  last_frame_ns_ = sample.stamp_ns;
  publish_frame(*frame);
  if (broadcaster_) publish_odom_tf(*frame);
  count_processed();
  return true;
}

void FrontendStage::emit_end() {
  if (!builder_) make_builder(camera_.value_or(core::Camera()));
  publish_frame(builder_->end());
}

void FrontendStage::publish_frame(core::Frame frame) {
  const ros::Time stamp = to_ros_time(frame.stamp_ns);
  const std_msgs::Header header = make_header(stamp, parameters_.odom_frame);
  if (frame.is_keyframe) {
    auto keyframe = boost::make_shared<Keyframe>();
    keyframe->header = header;
    keyframe->session_id = session_id();
    keyframe->keyframe_id = frame.keyframe_id;
    keyframe->frame_id = frame.frame_id;
    keyframe->odom_from_camera = to_msg(frame.T_odom_camera);
    keyframe_publisher_.publish(keyframe);
  }
  if (frame.keyframe_points)
    publish<KeyframePointsMessage>(points_publisher_, make_header(stamp, camera_frame_), {frame, {}});
  frame.keyframe_points.reset();
  publish<FrameMessage>(frame_publisher_, header, {std::move(frame), camera_frame_});
}

void FrontendStage::publish_odom_tf(const core::Frame& frame) {
  core::SE3 T_odom_child = frame.T_odom_camera;
  if (camera_frame_.empty()) {
    complain("no tf without the camera's frame", "images and camera_info name none; give camera_frame");
    return;
  }
  std::string child = parameters_.base_frame.empty() ? transforms_->root(camera_frame_) : parameters_.base_frame;
  if (!transforms_->is_mounted(camera_frame_)) {
    // Its place on the robot may come yet. If it does not, the camera is all that there is to move.
    constexpr std::int64_t kPatience_ns = 1'000'000'000;
    if (!unknown_since_ns_) unknown_since_ns_ = frame.stamp_ns;
    if (std::abs(frame.stamp_ns - *unknown_since_ns_) < kPatience_ns) return;  // of any session: once is enough
    if (child != camera_frame_) {
      complain("tf sent to the camera, whose place on base_frame is unknown",
               "nothing in tf has '" + camera_frame_ + "' below '" + child + "'");
    }
    child = camera_frame_;
  }
  if (child != camera_frame_) {
    const std::optional<core::SE3> T_camera_base = transforms_->find(camera_frame_, child, frame.stamp_ns);
    if (!T_camera_base) {
      complain("no tf from the camera to base_frame", "'" + camera_frame_ + "' to '" + child + "'");
      return;
    }
    T_odom_child = T_odom_child * *T_camera_base;
  }
  const std_msgs::Header header = make_header(to_ros_time(frame.stamp_ns), parameters_.odom_frame);
  sent_stamps_.push_back(header.stamp);
  if (sent_stamps_.size() > kTfQueue) sent_stamps_.pop_front();
  broadcaster_->sendTransform(make_transform(header, child, T_odom_child));
}

void FrontendStage::fail_image(std::int64_t stamp_ns, const std::string& cause, const std::string& detail,
                               std::uint8_t status) {
  complain(cause, detail);
  image_watch_.hear_failure(cause + ": " + detail);
  publish_done(stamp_ns, status);
}

}  // namespace semantic_topo_loop
