#include <rosgraph_msgs/Clock.h>
#include <std_msgs/Empty.h>
#include <std_msgs/String.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <thread>

#include "ros/playback.h"
#include "ros/stage.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/pipeline/read_ahead.h"

namespace semantic_topo_loop {
namespace {

/// The stamps of a trajectory file.
PlayerSource play_stamps(core::StampedPoses trajectory, const sensor_msgs::CameraInfo& camera_info) {
  const std::size_t size = trajectory.size();
  auto next = [=, poses = std::move(trajectory), i = std::size_t{0}]() mutable -> std::optional<PlayerItem> {
    if (i == poses.size()) return std::nullopt;
    PlayerItem item;
    item.camera_info = camera_info;
    item.camera_info.header.stamp = to_ros_time(poses[i++].stamp_ns);
    return item;
  };
  return {std::move(next), [] { return core::Status(); }, size};
}

}  // namespace

/// Plays a recording through the chain: with credit, so that nothing is dropped and the result is offline's, or at a
/// rate. Says on `player_status` (latched) how it ended, for wait_for_player.
class PlayerNodelet : public StageWith<PlayerParameters> {
 public:
  PlayerNodelet() : StageWith("Player") {}

  ~PlayerNodelet() override {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
    stop();
  }

 private:
  using Clock = std::chrono::steady_clock;
  enum class Wait { kReady, kRewind, kStopped, kStalled };

  void onInit() override {
    if (!start(1)) {
      status_publisher_ = advertise<std_msgs::String>("player_status", true);
      set_status("failed: bad parameter");
      return;
    }
    const std::string frontend = parameters_.bag.plays_depth() ? "RgbdFrontend" : "PoseFrontend";
    ledger_ = std::make_unique<PlayerLedger>(frontend, parameters_.stage_names(), parameters_.await_results);
    publishes_clock_ = ros::param::param<bool>("/use_sim_time", false);
    if (publishes_clock_) clock_publisher_ = getNodeHandle().advertise<rosgraph_msgs::Clock>("/clock", 10);
    tf_publisher_ = getNodeHandle().advertise<tf2_msgs::TFMessage>("/tf", 1000);
    static_broadcaster_ = std::make_unique<tf2_ros::StaticTransformBroadcaster>();
    camera_info_publisher_ = advertise<sensor_msgs::CameraInfo>("camera_info");
    if (parameters_.bag.with_images) color_publisher_ = advertise<sensor_msgs::Image>("color");
    if (parameters_.bag.plays_depth()) depth_publisher_ = advertise<sensor_msgs::Image>("depth");
    end_publisher_ = advertise<std_msgs::Empty>("end_of_stream");
    query_publisher_ = advertise<std_msgs::Empty>("session_queries");
    status_publisher_ = advertise<std_msgs::String>("player_status", true);
    watch();
    thread_ = std::thread([this] { play(); });
  }

  void watch() {
    listen<SessionAck>("session_acks", [this](const SessionAck& ack) { ledger_->take(ack); });
    listen<FrameMessage>("frames", [this](const FrameMessage& frame) {
      ledger_->numbered(frame.session_id, frame.stamp_ns, frame.frame_id, frame.is_end);
    });
    follow<DetectionsMessage>("detections", PlayerLedger::kDetections);
    follow<AssociationsMessage>("associations", PlayerLedger::kAssociations);
    listen<MapUpdateMessage>("quadric_map_updates", [this](const MapUpdateMessage& update) {
      const bool completes = update.phase == core::MapUpdatePhase::kCorrection;
      ledger_->seen(completes ? PlayerLedger::kCompletions : PlayerLedger::kObservations, update.session_id,
                    update.frame_id);
    });
    follow<LoopsMessage>("loop_closures", PlayerLedger::kLoopClosures);
    follow<CorrectionMessage>("map_corrections", PlayerLedger::kCorrections);
    listen<FrameDone>("frame_done", [this](const FrameDone& done) {
      ledger_->done(done);
      last_progress_ = Clock::now();
    });
    // Nothing has stalled while somebody works, however long.
    listen<std_msgs::String>("working", [this](const std_msgs::String&) { last_progress_ = Clock::now(); });
    listen<std_msgs::String>("results_written", [this](const std_msgs::String&) { ledger_->results_written(); });
    listen<SessionControl>("session_control", [this](const SessionControl& control) {
      ledger_->take(control);
      last_progress_ = Clock::now();
    });
  }

  template <class Message, class Handler>
  void listen(const std::string& topic, Handler handler) {
    const boost::function<void(const boost::shared_ptr<const Message>&)> callback =
        [this, handler](const boost::shared_ptr<const Message>& message) {
          {
            const std::lock_guard<std::mutex> lock(mutex_);
            handler(*message);
          }
          changed_.notify_all();
        };
    keep_subscriber(subscriber_node().subscribe<Message>(topic, 1000, callback));
  }

  template <class Message>
  void follow(const std::string& topic, PlayerLedger::Link link) {
    listen<Message>(topic, [this, link](const Message& m) { ledger_->seen(link, m.session_id, m.frame_id); });
  }

  void play() try {
    core::Status end;
    Wait wait = Wait::kRewind;
    while (wait == Wait::kRewind) {
      const core::Result<PlayerSource> source = open_source();
      if (!source) {
        fail(source.message());
        set_status("failed: " + source.message());
        return;
      }
      if (!wait_for_stages()) return;
      NODELET_INFO("playing %zu images", source->size);
      set_status("playing");
      wait = play_images(*source, &end);
    }
    if (wait != Wait::kReady) return;
    if (!end) NODELET_ERROR("the recording ends early: %s; what was mapped is kept", end.message().c_str());
    if (!play_end()) return;
    if (end && has_no_pose()) {
      end = core::Error{"no image has a pose"};
      NODELET_ERROR("%s", end.message().c_str());
    }
    set_status(end ? "finished" : "failed: " + end.message());
  } catch (const std::exception& exception) {
    fail(exception.what());
    set_status(std::string("failed: ") + exception.what());
  }

  core::Result<PlayerSource> open_source() const {
    std::optional<sensor_msgs::CameraInfo> calibration;
    if (!parameters_.camera_file.empty()) {
      const core::Result<core::Camera> camera = core::read_camera(parameters_.camera_file);
      if (!camera) return camera.error();
      calibration.emplace();
      to_msg(*camera, &*calibration);
      calibration->header.frame_id = parameters_.camera_frame;
    }
    if (parameters_.mode == "bag") {
      constexpr double kRecordingDelayS = 0.2;  // by which a message may stand in the bag after its stamp
      TumBagPlayback bag = parameters_.bag;
      bag.lookahead_s = parameters_.max_pose_gap_s + kRecordingDelayS;
      core::Result<std::unique_ptr<TumBagSource>> opened = TumBagSource::open(bag, calibration);
      if (!opened) return opened.error();
      const std::shared_ptr<TumBagSource> source = *std::move(opened);
      return PlayerSource{[source] { return source->next(); }, [source] { return source->end(); }, source->size()};
    }
    core::Result<core::StampedPoses> trajectory = core::read_tum_trajectory(parameters_.trajectory_file);
    if (!trajectory) return trajectory.error();
    return play_stamps(*std::move(trajectory), *calibration);
  }

  bool wait_for_stages() {
    constexpr auto kQueryPeriod = std::chrono::milliseconds(300);  // the session is announced again so often
    const auto deadline = Clock::now() + std::chrono::duration<double>(parameters_.startup_timeout_s);
    const auto is_up = [this] { return stop_ || (ledger_->missing_stages().empty() && are_images_heard()); };
    std::unique_lock<std::mutex> lock(mutex_);
    // Stages that were there before us have acknowledged the session unheard: it is repeated for us.
    while (!is_up() && Clock::now() < deadline) {
      lock.unlock();
      query_publisher_.publish(boost::make_shared<std_msgs::Empty>());
      lock.lock();
      changed_.wait_for(lock, kQueryPeriod, is_up);
    }
    if (stop_) return false;
    if (is_up()) return true;
    std::string missing;
    for (const std::string& stage : ledger_->missing_stages()) missing += (missing.empty() ? "" : ", ") + stage;
    if (missing.empty()) missing = "nobody subscribes to camera_info and the images";
    lock.unlock();
    NODELET_FATAL("nothing was played: not up after %.0f s: %s", parameters_.startup_timeout_s, missing.c_str());
    set_status("failed: not up: " + missing);
    return false;
  }

  /// Topics connect at their own pace: an image that nobody hears yet would be awaited for ever.
  bool are_images_heard() const {
    if (!parameters_.bag.with_images) return true;
    return camera_info_publisher_.getNumSubscribers() > 0 && color_publisher_.getNumSubscribers() > 0 &&
           (!parameters_.bag.plays_depth() || depth_publisher_.getNumSubscribers() > 0);
  }

  /// Plays every image, in lockstep until each has left the chain.
  /// @param end how the recording ended
  Wait play_images(const PlayerSource& source, core::Status* end) {
    constexpr auto kReportPeriod = std::chrono::seconds(5);
    constexpr std::size_t kItemsAhead = 15;  // half a second of colour and depth images, 32 MB
    // Read in a thread of its own: compressed chunks of a bag take longer than a frame.
    core::ReadAhead<PlayerItem> items(source.next, kItemsAhead);
    Clock::time_point reported = Clock::now();
    std::size_t played = 0;
    while (const std::optional<PlayerItem> item = items.next()) {
      if (!item->left_out.empty()) {
        publish_transforms(*item);
        complain(item->left_out, item->detail);
        continue;
      }
      const Wait wait = wait_for_turn(to_stamp_ns(item->camera_info.header.stamp));
      if (wait != Wait::kReady) return wait;
      publish(*item);
      ++played;
      if (Clock::now() - reported > kReportPeriod) {
        reported = Clock::now();
        NODELET_INFO("image %zu of %zu", played, source.size);
      }
    }
    *end = source.end();
    // The end of the stream must not overtake an image that still waits for its pose.
    return wait_until([this] { return ledger_->in_flight() == 0; });
  }

  bool play_end() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      last_progress_ = Clock::now();
      ledger_->end_sent();
    }
    end_publisher_.publish(boost::make_shared<std_msgs::Empty>());
    if (wait_until([this] { return ledger_->is_end_done(); }) != Wait::kReady) return false;
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto sent = static_cast<unsigned long>(ledger_->frames_sent());
    const auto done = static_cast<unsigned long>(ledger_->frames_done());
    const unsigned long dropped = sent - std::min(sent, done);
    statistics().set("images dropped by the chain", dropped);
    NODELET_INFO("the chain is through with %lu of %lu images, %lu of them without a pose; %lu dropped (%.2f %%)", done,
                 sent, static_cast<unsigned long>(ledger_->frames_without_pose()), dropped,
                 sent > 0 ? 100.0 * static_cast<double>(dropped) / static_cast<double>(sent) : 0.0);
    return true;
  }

  bool has_no_pose() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return ledger_->frames_sent() > 0 && ledger_->frames_without_pose() == ledger_->frames_sent();
  }

  Wait wait_for_turn(std::int64_t stamp_ns) {
    if (parameters_.lockstep) {
      return wait_until([this] { return ledger_->in_flight() < static_cast<std::size_t>(parameters_.credit); });
    }
    const Wait wait = wait_until([] { return true; });
    if (wait != Wait::kReady) return wait;
    if (!rate_origin_) rate_origin_ = {Clock::now(), stamp_ns};
    const std::chrono::duration<double> offset(1e-9 * static_cast<double>(stamp_ns - rate_origin_->second) /
                                               parameters_.rate);
    const auto due = rate_origin_->first + std::chrono::duration_cast<Clock::duration>(offset);
    return wait_until([due] { return Clock::now() >= due; });
  }

  template <class Predicate>
  Wait wait_until(Predicate predicate) {
    constexpr auto kPoll = std::chrono::milliseconds(2);  // far below the time between two images
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      if (stop_) return Wait::kStopped;
      // At a rate a recording goes on, as a camera does.
      if (ledger_->take_rewind() && parameters_.lockstep) return Wait::kRewind;
      if (!ledger_->is_paused()) {
        if (predicate()) return Wait::kReady;
        if (is_stalled()) {
          const std::string stage = ledger_->silent_stage();
          lock.unlock();
          NODELET_FATAL("playback ends: stage %s has been silent for %.0f s", stage.c_str(),
                        parameters_.stall_timeout_s);
          set_status("stalled: " + stage);
          return Wait::kStalled;
        }
      } else {
        last_progress_ = Clock::now();
        rate_origin_.reset();
      }
      changed_.wait_for(lock, kPoll);
    }
  }

  bool is_stalled() const {
    if (ledger_->in_flight() == 0 && !ledger_->awaits_end()) return false;
    return Clock::now() - last_progress_ > std::chrono::duration<double>(parameters_.stall_timeout_s);
  }

  void publish(const PlayerItem& item) {
    if (publishes_clock_) {
      auto clock = boost::make_shared<rosgraph_msgs::Clock>();
      clock->clock = item.camera_info.header.stamp;
      clock_publisher_.publish(clock);
    }
    publish_transforms(item);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (ledger_->in_flight() == 0) last_progress_ = Clock::now();
      ledger_->sent(to_stamp_ns(item.camera_info.header.stamp));
    }
    camera_info_publisher_.publish(boost::make_shared<sensor_msgs::CameraInfo>(item.camera_info));
    if (item.color) color_publisher_.publish(item.color);
    if (item.depth) depth_publisher_.publish(item.depth);
    statistics().count("images played");
  }

  void publish_transforms(const PlayerItem& item) {
    if (!item.static_transforms.empty()) static_broadcaster_->sendTransform(item.static_transforms);
    for (const tf2_msgs::TFMessage& transforms : item.transforms) {
      tf_publisher_.publish(boost::make_shared<tf2_msgs::TFMessage>(transforms));
    }
  }

  void set_status(const std::string& status) {
    auto message = boost::make_shared<std_msgs::String>();
    message->data = status;
    status_publisher_.publish(message);
  }

  ros::Publisher clock_publisher_, tf_publisher_, camera_info_publisher_, end_publisher_, query_publisher_;
  ros::Publisher status_publisher_, color_publisher_, depth_publisher_;
  std::unique_ptr<tf2_ros::StaticTransformBroadcaster> static_broadcaster_;
  bool publishes_clock_ = false;
  std::optional<std::pair<Clock::time_point, std::int64_t>> rate_origin_;  ///< playback thread only

  std::mutex mutex_;  ///< guards all below but the thread; held for moments only
  std::condition_variable changed_;
  std::unique_ptr<PlayerLedger> ledger_;
  Clock::time_point last_progress_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::PlayerNodelet, nodelet::Nodelet)
