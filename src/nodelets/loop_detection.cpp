#include <geometry_msgs/TransformStamped.h>
#include <std_srvs/SetBool.h>

#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>

#include "odometry/odometry_delay.h"
#include "pipeline/map_state.h"
#include "ros/frame_joiner.h"
#include "ros/map_part_sender.h"
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
    // A break, and what the odometry's source found, are told by one frame alone, whose boxes may get lost.
    joiner_ = std::make_unique<Joiner>(queue_capacity(), [this](std::int64_t id, const Joiner::Partial& partial) {
      if (const auto& frame = std::get<0>(partial)) detect(**frame, core::AssociationFrame::without_answer(id));
    });
    publisher_ = advertise<LoopsMessage>("loop_closures");
    for (const char* counter : {kIncomplete, kAccepted}) statistics().count(counter, 0);
    reset_session();
    serve_settings(&options_.loop, [this] { take_options(); });
    serve("set_loop_closing", &LoopDetectionNodelet::on_switch);
    serve("why_loop", &LoopDetectionNodelet::on_why);
    map_parts_.open(getNodeHandle(), queue_capacity());
    subscribe("map_corrections", Keep::kAlways, &LoopDetectionNodelet::on_correction);
    subscribe("quadric_map_updates", Keep::kAlways, &LoopDetectionNodelet::on_update);
    subscribe("associations", Keep::kDroppable, &LoopDetectionNodelet::on_associations);
    subscribe("frames", Keep::kAlways, &LoopDetectionNodelet::on_frame);
    follow_sessions();
  }

  void reset_session() override {
    joiner_->clear();
    // Latched: who comes must not hear where the session before was.
    relocalisation_publisher_.shutdown();
    relocalisation_publisher_ = advertise<geometry_msgs::TransformStamped>("earlier_map_from_odom", true);
    const std::lock_guard<std::mutex> lock(mutex_);
    detector_ = std::make_unique<core::LoopDetector>(options_.loop, classes());
    map_parts_.reset_session();
    take_map();
  }

  void take_map() {
    const std::string& file = session().map_file;
    if (file.empty()) return;
    if (options_.loop.mode != "graph") {
      fail("a session that goes on with the map '" + file + "' needs loop/mode graph");
      return;
    }
    const auto map = core::read_map(file, *classes(), {true, true, false});
    if (!map) {
      fail(map.message());
      return;
    }
    if (session().frozen) return detector_->set_earlier_map((*map)->submaps_in_unit());
    detector_->restore((*map)->submaps_in_parts(), (*map)->keyframe_poses(), (*map)->refused);
    detector_->apply(core::objects_of(**map, options_, classes()));
  }

  void set_localization(bool localization) override {
    const std::lock_guard<std::mutex> lock(mutex_);
    detector_->set_fixed(localization);
  }

  void take_options() {
    const std::lock_guard<std::mutex> lock(mutex_);
    detector_->set_options(options_.loop);
  }

  bool on_switch(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
    const bool enabled = request.data != 0;
    const core::Status changed = change_settings({{"loop.enabled", enabled ? "true" : "false"}});
    response.success = static_cast<bool>(changed);
    response.message = !changed  ? changed.message()
                       : enabled ? "loop closing is on from the next frame"
                                 : "loop closing is off from the next frame";
    return true;
  }

  void on_correction(const CorrectionMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    map_parts_.follow(message->header, session_id(), message->frame_id,
                      [this](bool whole, core::MapDelta* delta) { delta->submaps = detector_->take_delta(whole); });
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
    if (frame->is_end) map_parts_.set_end(frame->frame_id);
    take(joiner_->add<0>(frame->frame_id, frame));
  }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    take(joiner_->add<1>(associations->frame_id, associations));
  }

  /// Updates are applied as they come, which is the order in which the map made them.
  void on_update(const MapUpdateMessage::ConstPtr& update) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      detector_->apply(*update);
    }
    if (update->phase == core::MapUpdatePhase::kObservation) take(joiner_->add<2>(update->frame_id, update));
  }

  void take(const std::optional<Joiner::Set>& joined) {
    statistics().set_lost(kIncomplete, joiner_->evicted());
    if (joined) detect(*std::get<0>(*joined), *std::get<1>(*joined));
  }

  void detect(const FrameMessage& frame, const core::AssociationFrame& associations) {
    FrameLoops loops;
    loops.frame_id = frame.frame_id;
    double delay_s = 0.0;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      const core::Stopwatch stopwatch;
      loops.closures = detector_->detect(frame, associations);
      loops.motions = detector_->motions();
      loops.duration_us = stopwatch.elapsed_us();
      loops.relocalisation = detector_->relocalisation();
      delay_s = detector_->odometry_delay_s();
    }
    warn_while("odometry", core::describe_delay(delay_s));
    bool relocalised = false;
    for (const core::LoopClosure& loop : loops.closures) {
      relocalised = relocalised || (loop.accepted && loop.T_earlier_match);
      statistics().count(loop.accepted ? kAccepted : std::string("loops rejected: ") + to_string(loop.reason));
    }
    if (relocalised && loops.relocalisation) publish_relocalisation(frame, *loops.relocalisation);
    publish<LoopsMessage>(publisher_, make_header(frame.header.stamp, frame.camera_frame), std::move(loops));
    count_processed();
  }

  void publish_relocalisation(const FrameMessage& frame, const core::Relocalisation& found) {
    const std_msgs::Header header = make_header(frame.header.stamp, parameters_.earlier_map_frame);
    relocalisation_publisher_.publish(boost::make_shared<geometry_msgs::TransformStamped>(
        make_transform(header, frame.header.frame_id, found.T_earlier_odom)));
    NODELET_INFO_ONCE("the run's place in the earlier map is known, by %d of %d loops", found.agreeing, found.total);
  }

  ros::Publisher publisher_, relocalisation_publisher_;
  std::unique_ptr<Joiner> joiner_;
  MapPartSender map_parts_{MapPart::STAGE_LOOP_DETECTION};
  std::mutex mutex_;  ///< guards the detector, which the worker feeds, and ~why_loop asks
  std::unique_ptr<core::LoopDetector> detector_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::LoopDetectionNodelet, nodelet::Nodelet)
