#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <nav_msgs/Path.h>
#include <tf2_ros/transform_broadcaster.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/map_state.h"
#include "ros/external_loops.h"
#include "ros/frame_joiner.h"
#include "ros/map_part_sender.h"
#include "ros/stage.h"
#include "semantic_topo_loop/SaveTrajectory.h"
#include "semantic_topo_loop/WithdrawLoop.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {
namespace {

/// Sends map -> odom at a fixed rate, dated as the newest frame, whatever the pose graph is doing. Thread-safe.
class MapOdomSender {
 public:
  /// @param tolerance_s how far the transform is dated ahead of the newest frame, so that listeners need not wait
  /// @param below send odom -> map instead
  MapOdomSender(std::string map_frame, double tolerance_s, bool below)
      : map_frame_(std::move(map_frame)), tolerance_ns_(std::llround(tolerance_s * 1e9)), below_(below) {}

  /// A frame has come, to which the transform of its session is taken to apply until the graph says otherwise.
  void follow(const FrameMessage::ConstPtr& frame) {
    const std::lock_guard<std::mutex> lock(mutex_);
    newest_ = frame;
  }
  void update(const core::SE3& T_map_odom, std::uint32_t session_id) {
    const std::lock_guard<std::mutex> lock(mutex_);
    T_map_odom_ = T_map_odom;
    session_id_ = session_id;
  }
  /// A new session, whose time may be another: nothing is sent before its first pose.
  void reset() {
    const std::lock_guard<std::mutex> lock(mutex_);
    session_id_.reset();
    sent_stamp_ns_ = -1;
  }

  /// Call at the wanted rate.
  void send() {
    geometry_msgs::TransformStamped message;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!newest_ || newest_->session_id != session_id_) return;
      // tf2 warns of a transform with the stamp of the one before: while no frame comes, one nanosecond makes it
      // another.
      sent_stamp_ns_ = std::max(newest_->stamp_ns + tolerance_ns_, sent_stamp_ns_ + 1);
      const std::string& odom_frame = newest_->header.frame_id;
      const std_msgs::Header header = make_header(to_ros_time(sent_stamp_ns_), below_ ? odom_frame : map_frame_);
      message = below_ ? make_transform(header, map_frame_, T_map_odom_.inverse())
                       : make_transform(header, odom_frame, T_map_odom_);
    }
    broadcaster_.sendTransform(message);
  }

 private:
  const std::string map_frame_;
  const std::int64_t tolerance_ns_;
  const bool below_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::mutex mutex_;  ///< guards all below
  core::SE3 T_map_odom_;
  std::optional<std::uint32_t> session_id_;  ///< of T_map_odom; none before the session's first pose
  FrameMessage::ConstPtr newest_;
  std::int64_t sent_stamp_ns_ = -1;
};

}  // namespace

/// Owns the keyframe poses: optimises them with the loops, and with the objects if they take part, publishes
/// corrections, paths and the transform from map to odometry.
class PoseGraphNodelet : public StageWith<PoseGraphParameters> {
 public:
  PoseGraphNodelet() : StageWith("PoseGraph") {}
  ~PoseGraphNodelet() override { stop(); }

 private:
  /// The last two are null where the objects take no part.
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, LoopsMessage::ConstPtr, AssociationsMessage::ConstPtr,
                             MapUpdateMessage::ConstPtr>;
  static constexpr double kPathPeriodS = 0.5;  ///< paths grow with the run: not with every frame
  static constexpr std::uint32_t kExternalQueue = 100;
  static constexpr char kWithoutLoops[] = "frames whose loop detection was lost";
  static constexpr char kLast[] = "last optimisation";
  static constexpr char kExternal[] = "external loops", kRefused[] = "external loops refused";

  void onInit() override {
    if (!start(2)) return;
    // Keyframes are the graph's vertices: a frame whose loop message got lost still goes in.
    joiner_ = std::make_unique<Joiner>(queue_capacity(), [this](std::int64_t, const Joiner::Partial& partial) {
      if (std::get<0>(partial)) process(**std::get<0>(partial), {}, std::get<2>(partial).value_or(nullptr));
    });
    correction_publisher_ = advertise<CorrectionMessage>("map_corrections");
    odometry_path_.open<nav_msgs::Path>(getNodeHandle(), "path_odometry", queue_capacity());
    corrected_path_.open<nav_msgs::Path>(getNodeHandle(), "path_corrected", queue_capacity());
    for (const char* counter : {kWithoutLoops, kExternal, kRefused}) statistics().count(counter, 0);
    reset_session();
    if (parameters_.publish_tf) {
      tf_sender_ = std::make_unique<MapOdomSender>(parameters_.map_frame, parameters_.tf_tolerance_s,
                                                   parameters_.map_below_odom);
      ros::NodeHandle node(getNodeHandle());
      node.setCallbackQueue(&tf_thread_.queue);
      keep_subscriber(node.subscribe("frames", 1, &MapOdomSender::follow, tf_sender_.get()));
      keep_timer(
          1.0 / parameters_.tf_rate_hz, [this] { tf_sender_->send(); }, &tf_thread_);
    }
    map_parts_.open(getNodeHandle(), queue_capacity());
    serve_settings(&options_.pose_graph, [this] { graph_->set_options(options_.pose_graph); });
    serve("withdraw_loop", &PoseGraphNodelet::on_withdraw);
    serve("save_trajectory", &PoseGraphNodelet::on_save_trajectory);
    listen("external_loops", Keep::kAlways, kExternalQueue, &PoseGraphNodelet::on_external_loop);
    subscribe("loop_closures", Keep::kAlways, &PoseGraphNodelet::on_loops);
    if (has_objects()) {
      subscribe("associations", Keep::kAlways, &PoseGraphNodelet::on_associations);
      subscribe("quadric_map_updates", Keep::kAlways, &PoseGraphNodelet::on_update);
    }
    subscribe("frames", Keep::kAlways, &PoseGraphNodelet::on_frame);
    start_timer(kPathPeriodS, [this] { publish_paths(); });
    follow_sessions();
  }

  void reset_session() override {
    graph_ = std::make_unique<core::PoseGraph>(options_.pose_graph);
    joiner_->clear();
    late_loops_.clear();
    external_loops_.end();
    is_kept_.clear();
    statistics().set_text(kLast, "none");
    odometry_keyframes_.clear();
    last_frame_.reset();
    map_parts_.reset_session();
    restored_keyframes_ = 0;
    is_joined_ = false;
    if (tf_sender_) tf_sender_->reset();
    const auto map = session_map({has_objects()});
    if (!map) return;
    if (const core::Status has_scale = map->check_scale(options_.pose_graph); !has_scale) {
      fail(session().map_file + ": " + has_scale.message());
      return;
    }
    core::restore_graph(*map, graph_.get());
    graph_->apply(core::objects_of(*map, options_, classes()));
    restored_keyframes_ = map->graph.next_keyframe_id();
  }

  bool on_save_trajectory(SaveTrajectory::Request& request, SaveTrajectory::Response& response) {
    const core::Result<std::string> place = path_below(parameters_.save_dir, request.path, parameters_.allow_any_path);
    const auto poses = ask("save_trajectory", [this] { return trajectory(); });
    const auto write = [&poses](const std::string& path) -> core::Status {
      return poses ? core::write_tum_trajectory(path, *poses) : core::Error{"the pose graph is busy: ask again"};
    };
    answer(place ? write_to(*place, write) : place, &response);
    return true;
  }

  /// The keyframes of this session.
  core::StampedPoses trajectory() const {
    core::StampedPoses poses;
    for (const core::KeyframePose& keyframe : graph_->keyframes()) {
      if (keyframe.keyframe_id >= restored_keyframes_) poses.push_back({keyframe.stamp_ns, keyframe.T_map_camera});
    }
    return poses;
  }

  /// Asks the worker, which owns the graph, and waits for its answer.
  bool on_withdraw(WithdrawLoop::Request& request, WithdrawLoop::Response& response) {
    const auto is_found =
        ask("withdraw_loop", [this, query = request.query_keyframe_id, match = request.match_keyframe_id] {
          return graph_->withdraw(query, match);
        });
    if (!is_found) {
      response.message = "the pose graph is busy; the loop is withdrawn when it comes to it";
      return true;
    }
    const std::string name =
        std::to_string(request.query_keyframe_id) + " and " + std::to_string(request.match_keyframe_id);
    response.success = *is_found;
    response.message = response.success ? "the loop of keyframes " + name + " is out from the next frame"
                                        : "there is no accepted loop of keyframes " + name;
    return true;
  }

  bool has_objects() const { return options_.pose_graph.objects != "off"; }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    if (!has_objects()) {
      joiner_->add<2>(frame->frame_id, nullptr);
      joiner_->add<3>(frame->frame_id, nullptr);
    }
    process(joiner_->add<0>(frame->frame_id, frame));
  }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    process(joiner_->add<2>(associations->frame_id, associations));
  }

  /// Updates are applied as they come, which is the order in which the map made them.
  void on_update(const MapUpdateMessage::ConstPtr& update) {
    graph_->apply(*update);
    if (update->phase == core::MapUpdatePhase::kObservation) process(joiner_->add<3>(update->frame_id, update));
  }

  /// Loops of a frame that went in without them are added with the next frame.
  void on_loops(const LoopsMessage::ConstPtr& loops) {
    if (!joiner_->is_past(loops->frame_id)) return process(joiner_->add<1>(loops->frame_id, loops));
    graph_->refine(loops->motions);
    late_loops_.insert(late_loops_.end(), loops->closures.begin(), loops->closures.end());
  }

  void on_external_loop(const ExternalLoop::ConstPtr& loop) {
    statistics().count(kExternal);
    external_loops_.add(loop);
  }

  void process(const std::optional<Joiner::Set>& joined) {
    statistics().set_lost(kWithoutLoops, joiner_->evicted());
    if (!joined) return;
    const auto& [frame, loops, associations, update] = *joined;
    graph_->refine(loops->motions);
    process(*frame, loops->closures, associations);
  }

  /// @param associations null: none
  void process(const FrameMessage& frame, const std::vector<core::LoopClosure>& frame_loops,
               const AssociationsMessage::ConstPtr& associations) {
    if (associations) graph_->observe(frame, *associations);
    std::vector<core::LoopClosure> loops = std::exchange(late_loops_, {});
    loops.insert(loops.end(), frame_loops.begin(), frame_loops.end());
    external_loops_.add(frame);
    core::MapCorrection correction = graph_->process(frame, loops, external_loops_.take());
    if (!last_frame_) T_map_begin_ = correction.T_map_odom_old;
    if (frame.is_end) external_loops_.end();
    announce_joining(correction);
    if (correction.changed) show_optimisation(correction, frame.stamp_ns);
    if (tf_sender_) tf_sender_->update(graph_->T_map_odom(), session_id());
    publish<CorrectionMessage>(correction_publisher_, make_header(frame.header.stamp, parameters_.map_frame),
                               std::move(correction));
    last_frame_ = stamped(frame.header.stamp, frame.T_odom_camera);
    if (frame.is_keyframe) {
      odometry_keyframes_.push_back(stamped(frame.header.stamp, T_map_begin_ * frame.T_odom_camera));
    }
    odometry_path_.mark_changed();
    corrected_path_.mark_changed();
    if (frame.is_end) map_parts_.set_end(frame.frame_id);
    map_parts_.follow(frame.header, session_id(), frame.frame_id,
                      [this](bool whole, core::MapDelta* delta) { delta->graph = graph_->take_delta(whole); });
    if (frame.is_end) publish_paths();  // the recording may be over before the timer comes round
    count_processed();
  }

  void announce_joining(const core::MapCorrection& correction) {
    for (const core::LoopVerdict& loop : correction.loops) {
      const bool is_into_map =
          loop.query_keyframe_id >= restored_keyframes_ && loop.match_keyframe_id < restored_keyframes_;
      if (is_joined_ || !loop.kept || !is_into_map) continue;
      is_joined_ = true;
      NODELET_INFO(
          "joined the map of earlier sessions at keyframe %ld: the transform from map to odometry jumps by %.2f m",
          static_cast<long>(loop.query_keyframe_id), (correction.T_map_odom.t - correction.T_map_odom_old.t).norm());
    }
  }

  /// In the diagnostics. @param stamp_ns of the correction's frame
  void show_optimisation(const core::MapCorrection& correction, std::int64_t stamp_ns) {
    for (const core::LoopVerdict& loop : correction.loops) is_kept_[loop.number] = loop.kept;
    const auto kept = std::count_if(is_kept_.begin(), is_kept_.end(), [](const auto& loop) { return loop.second; });
    const auto rejected = static_cast<std::ptrdiff_t>(is_kept_.size()) - kept;
    statistics().set_text(kLast, "stamp " + core::format_stamp(stamp_ns) + ", " +
                                     core::format_fixed(1e-3 * correction.duration_us, 2) + " ms, " +
                                     std::to_string(correction.keyframes.size()) + " keyframes moved, " +
                                     std::to_string(kept) + " loops kept, " + std::to_string(rejected) + " rejected");
  }

  geometry_msgs::PoseStamped stamped(const ros::Time& stamp, const core::SE3& T_map_camera) const {
    geometry_msgs::PoseStamped pose;
    pose.header = make_header(stamp, parameters_.map_frame);
    pose.pose = to_msg(T_map_camera);
    return pose;
  }

  /// The session's path through its keyframes and the last frame; the odometry's, too, begins where the session begins
  /// in the map, so that they can be compared.
  void publish_paths() {
    if (!last_frame_) return;
    const core::SE3 T_odom_camera = from_msg(last_frame_->pose);
    const auto last = [&](const core::SE3& T_map_odom) {
      return stamped(last_frame_->header.stamp, T_map_odom * T_odom_camera);
    };
    if (odometry_path_.is_due()) publish_path(odometry_keyframes_, last(T_map_begin_), &odometry_path_);
    if (!corrected_path_.is_due()) return;
    std::vector<geometry_msgs::PoseStamped> poses;
    for (const core::KeyframePose& keyframe : graph_->keyframes()) {
      if (keyframe.keyframe_id < restored_keyframes_) continue;
      poses.push_back(stamped(to_ros_time(keyframe.stamp_ns), keyframe.T_map_camera));
    }
    publish_path(poses, last(graph_->T_map_odom()), &corrected_path_);
  }

  static void publish_path(const std::vector<geometry_msgs::PoseStamped>& poses, const geometry_msgs::PoseStamped& last,
                           LazyPublisher* publisher) {
    auto path = boost::make_shared<nav_msgs::Path>();
    path->header = last.header;
    constexpr std::size_t kMost = 1000;  // nav_msgs/Path knows no deltas
    const std::size_t step = thinning(poses.size(), kMost);
    for (std::size_t i = 0; i < poses.size(); i += step) path->poses.push_back(poses[i]);
    path->poses.push_back(last);
    publisher->publish(path);
  }

  ros::Publisher correction_publisher_;
  LazyPublisher odometry_path_, corrected_path_;
  std::unique_ptr<MapOdomSender> tf_sender_;
  CallbackThread tf_thread_;  ///< stopped before the sender goes: to stop a timer does not wait for its task
  std::unique_ptr<Joiner> joiner_;
  std::unique_ptr<core::PoseGraph> graph_;
  MapPartSender map_parts_{MapPart::STAGE_POSE_GRAPH};
  std::vector<core::LoopClosure> late_loops_;
  ExternalLoops external_loops_{[this](const std::string& problem) { complain(kRefused, problem); }};
  std::int64_t restored_keyframes_ = 0;   ///< ids below are of earlier sessions
  core::SE3 T_map_begin_;                 ///< from the odometry's frame, before any correction
  bool is_joined_ = false;                ///< a loop into them is kept
  std::map<std::int64_t, bool> is_kept_;  ///< by number of the loop, as the optimiser said last
  std::vector<geometry_msgs::PoseStamped> odometry_keyframes_;
  std::optional<geometry_msgs::PoseStamped> last_frame_;  ///< in the odometry's frame
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::PoseGraphNodelet, nodelet::Nodelet)
