#include <geometry_msgs/TransformStamped.h>
#include <std_srvs/SetBool.h>

#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>

#include "pipeline/map_state.h"
#include "ros/frame_joiner.h"
#include "ros/stage.h"
#include "semantic_topo_loop/WhyLoop.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {
/// Looks for loops in each frame once its observation update is there; loop closing can be switched at run time.
class LoopDetectionNodelet : public StageWith<LoopDetectionParameters> {
 public:
  LoopDetectionNodelet() : StageWith("LoopDetection") {}
  ~LoopDetectionNodelet() override { stop(); }

 private:
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, AssociationsMessage::ConstPtr, MapUpdateMessage::ConstPtr>;
  static constexpr char kIncomplete[] = "dropped, frame, associations or map update missing";
  static constexpr char kAccepted[] = "loops accepted";

  void onInit() override {
    if (!start(2)) return;
    if (!load_earlier_map()) return;
    joiner_ = std::make_unique<Joiner>(queue_capacity());
    publisher_ = advertise<LoopsMessage>("loop_closures");
    for (const char* counter : {kIncomplete, kAccepted}) statistics().count(counter, 0);
    reset_session();
    serve("set_loop_closing", &LoopDetectionNodelet::on_switch);
    serve("why_loop", &LoopDetectionNodelet::on_why);
    serve_trigger("save_map", [this] {
      const core::Error nowhere{"parameter 'save_map_file' is empty: there is no place for the submaps"};
      return parameters_.save_map_file.empty() ? nowhere : save();
    });
    if (!parameters_.map_file.empty()) {
      relocalisation_publisher_ = advertise<geometry_msgs::TransformStamped>("earlier_map_from_odom", true);
    }
    if (!parameters_.save_map_file.empty()) {
      subscribe("map_corrections", Keep::kAlways, &LoopDetectionNodelet::on_correction);
      save_at_end([this] { report_written("submaps", save()); });
    }
    subscribe("quadric_map_updates", Keep::kAlways, &LoopDetectionNodelet::on_update);
    subscribe("associations", Keep::kDroppable, &LoopDetectionNodelet::on_associations);
    subscribe("frames", Keep::kDroppable, &LoopDetectionNodelet::on_frame);
    follow_sessions();
  }

  void reset_session() override {
    joiner_->clear();
    const std::lock_guard<std::mutex> lock(mutex_);
    detector_ = std::make_unique<core::LoopDetector>(options_.loop, classes());
    if (enabled_) detector_->set_enabled(*enabled_);
    if (!earlier_map_.empty()) detector_->set_earlier_map(earlier_map_);
    keyframes_.clear();
    T_map_odom_ = core::SE3();
    end_frame_id_ = -1;
  }

  /// @return false after fail()
  bool load_earlier_map() {
    if (parameters_.map_file.empty()) return true;
    if (options_.loop.mode != "graph") {
      return fail("parameter 'map_file' = '" + parameters_.map_file + "' needs loop/mode graph");
    }
    const auto map = core::read_map(parameters_.map_file, *classes());
    if (!map) return fail(map.message());
    earlier_map_ = (*map)->submaps_in_unit();
    if (earlier_map_.empty()) return fail(parameters_.map_file + ": holds no place to be found at");
    return true;
  }

  bool on_switch(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
    push("set_loop_closing", Keep::kAlways, [this, enabled = request.data != 0] {
      enabled_ = enabled;
      const std::lock_guard<std::mutex> lock(mutex_);
      detector_->set_enabled(enabled);
    });
    response.success = true;
    response.message =
        request.data ? "loop closing is on from the next frame" : "loop closing is off from the next frame";
    return true;
  }

  /// @return absolute path of the file
  core::Result<std::string> save() {
    core::MapState map;  // of the submaps alone
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      map.submaps = detector_->submaps();
      std::vector<core::KeyframePose> keyframes;
      for (const auto& [id, pose] : keyframes_) keyframes.push_back(pose);
      core::move_to_map(keyframes, T_map_odom_, &map.submaps);
      core::rescale(keyframes, &map.submaps);
      set_unsaved(false);
    }
    return write_to(parameters_.save_map_file,
                    [&](const std::string& file) { return core::write_map(file, map, *classes()); });
  }

  void on_correction(const CorrectionMessage::ConstPtr& message) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      T_map_odom_ = message->T_map_odom;
      for (const core::KeyframePose& pose : message->keyframes) keyframes_[pose.keyframe_id] = pose;
      set_unsaved(true);
    }
    if (message->frame_id == end_frame_id_) report_written("submaps", save());
  }

  /// Answers at once, between two frames: asking changes nothing, and waits for one frame's detection at most.
  bool on_why(WhyLoop::Request& request, WhyLoop::Response& response) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const core::LoopExplanation answer = detector_->explain(request.query_keyframe_id, request.match_keyframe_id);
    response.status = static_cast<std::uint8_t>(answer.status);
    response.explanation = answer.text;
    response.has_closure = answer.closure.has_value();
    if (answer.closure) response.closure = to_generated<LoopClosure>(*answer.closure);
    return true;
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    if (frame->is_end) end_frame_id_ = frame->frame_id;
    detect(joiner_->add<0>(frame->frame_id, frame));
  }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    detect(joiner_->add<1>(associations->frame_id, associations));
  }

  /// Updates are applied as they come, which is the order in which the map made them.
  void on_update(const MapUpdateMessage::ConstPtr& update) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      detector_->apply(*update);
    }
    if (update->phase == core::MapUpdatePhase::kObservation) detect(joiner_->add<2>(update->frame_id, update));
  }

  void detect(const std::optional<Joiner::Set>& joined) {
    statistics().set(kIncomplete, joiner_->evicted());
    if (!joined) return;
    const FrameMessage& frame = *std::get<0>(*joined);
    FrameLoops loops;
    loops.frame_id = frame.frame_id;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      const core::Stopwatch stopwatch;
      loops.closures = detector_->detect(frame, *std::get<1>(*joined));
      loops.motions = detector_->motions();
      loops.duration_us = stopwatch.elapsed_us();
    }
    bool relocalised = false;
    for (const core::LoopClosure& loop : loops.closures) {
      relocalised = relocalised || (loop.accepted && loop.T_earlier_match);
      statistics().count(loop.accepted ? kAccepted : std::string("loops rejected: ") + to_string(loop.reason));
    }
    publish<LoopsMessage>(publisher_, make_header(frame.header.stamp, frame.camera_frame), std::move(loops));
    if (relocalised) publish_relocalisation(frame);
    count_processed();
  }

  void publish_relocalisation(const FrameMessage& frame) {
    std::optional<core::Relocalisation> found;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      found = detector_->relocalisation();
    }
    if (!found) return;
    const std_msgs::Header header = make_header(frame.header.stamp, parameters_.earlier_map_frame);
    relocalisation_publisher_.publish(boost::make_shared<geometry_msgs::TransformStamped>(
        make_transform(header, frame.header.frame_id, found->T_earlier_odom)));
    NODELET_INFO_ONCE("the run's place in the earlier map is known, by %d of %d loops", found->agreeing, found->total);
  }

  std::optional<bool> enabled_;  ///< as set by the service; none: as configured
  std::vector<core::LocalMap> earlier_map_;
  ros::Publisher publisher_, relocalisation_publisher_;
  std::unique_ptr<Joiner> joiner_;
  std::int64_t end_frame_id_ = -1;  ///< of the session's END frame, once it came
  std::mutex mutex_;                ///< guards all below, which the worker feeds, and ~why_loop and ~save_map ask
  std::unique_ptr<core::LoopDetector> detector_;
  std::map<std::int64_t, core::KeyframePose> keyframes_;  ///< as last solved, by keyframe_id
  core::SE3 T_map_odom_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::LoopDetectionNodelet, nodelet::Nodelet)
