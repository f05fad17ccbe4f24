#include <std_srvs/SetBool.h>

#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>

#include "semantic_topo_loop/WhyLoop.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/pipeline/stopwatch.h"
#include "semantic_topo_loop/ros/conversions.h"
#include "semantic_topo_loop/ros/frame_joiner.h"
#include "semantic_topo_loop/ros/stage.h"

namespace semantic_topo_loop {

/// Looks for loops in each frame once its observation update is there; loop closing can be switched at run time.
class LoopDetectionNodelet : public Stage {
 public:
  LoopDetectionNodelet() : Stage("LoopDetection") {}
  ~LoopDetectionNodelet() override { stop(); }

 private:
  using Joiner = FrameJoiner<Frame::ConstPtr, AssociationArray::ConstPtr, QuadricMapUpdate::ConstPtr>;
  static constexpr char kIncomplete[] = "dropped, frame, associations or map update missing";
  static constexpr char kAccepted[] = "loops accepted";

  void onInit() override {
    ClassStageParameters parameters;
    if (!start(&options_, &parameters, 2)) return;
    classes_ = load_classes(parameters.class_table);
    if (!classes_) return;
    joiner_ = std::make_unique<Joiner>(queue_capacity());
    publisher_ = advertise<LoopClosureArray>("loop_closures");
    for (const char* counter : {kIncomplete, kAccepted}) statistics().count(counter, 0);
    reset_session();
    keep_service(getPrivateNodeHandle().advertiseService("set_loop_closing", &LoopDetectionNodelet::on_switch, this));
    keep_service(getPrivateNodeHandle().advertiseService("why_loop", &LoopDetectionNodelet::on_why, this));
    subscribe("quadric_map_updates", Keep::kAlways, &LoopDetectionNodelet::on_update);
    subscribe("associations", Keep::kDroppable, &LoopDetectionNodelet::on_associations);
    subscribe("frames", Keep::kDroppable, &LoopDetectionNodelet::on_frame);
    follow_sessions();
  }

  void reset_session() override {
    joiner_->clear();
    const std::lock_guard<std::mutex> lock(mutex_);
    detector_ = std::make_unique<core::LoopDetector>(options_.loop, classes_);
    if (enabled_) detector_->set_enabled(*enabled_);
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

  /// Answers at once, between two frames: asking changes nothing, and waits for one frame's detection at most.
  bool on_why(WhyLoop::Request& request, WhyLoop::Response& response) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const core::LoopExplanation answer = detector_->explain(request.query_keyframe_id, request.match_keyframe_id);
    response.status = static_cast<std::uint8_t>(answer.status);
    response.explanation = answer.text;
    response.has_closure = answer.closure.has_value();
    if (answer.closure) response.closure = to_msg(*answer.closure);
    return true;
  }

  void on_frame(const Frame::ConstPtr& frame) { detect(joiner_->add<0>(frame->frame_id, frame)); }

  void on_associations(const AssociationArray::ConstPtr& associations) {
    detect(joiner_->add<1>(associations->frame_id, associations));
  }

  /// Updates are applied as they come, which is the order in which the map made them.
  void on_update(const QuadricMapUpdate::ConstPtr& update) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      detector_->apply(from_msg(*update));
    }
    if (update->phase == QuadricMapUpdate::PHASE_OBSERVATION) detect(joiner_->add<2>(update->frame_id, update));
  }

  void detect(const std::optional<Joiner::Set>& joined) {
    statistics().set(kIncomplete, joiner_->evicted());
    if (!joined) return;
    const Frame& frame = *std::get<0>(*joined);
    auto message = boost::make_shared<LoopClosureArray>();
    const std::vector<core::LoopClosure> loops =
        detect(from_msg(frame), from_msg(*std::get<1>(*joined)), &message->duration_us);
    to_msg(loops, message.get());
    message->header = make_header(frame.header.stamp, frame.camera_frame);
    message->session_id = session_id();
    message->frame_id = frame.frame_id;
    publisher_.publish(message);
    for (const core::LoopClosure& loop : loops) {
      statistics().count(loop.accepted ? kAccepted : std::string("loops rejected: ") + to_string(loop.reason));
    }
    count_processed();
  }

  std::vector<core::LoopClosure> detect(const core::Frame& frame, const core::AssociationFrame& associations,
                                        double* duration_us) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const core::Stopwatch stopwatch;
    std::vector<core::LoopClosure> loops = detector_->detect(frame, associations);
    *duration_us = stopwatch.elapsed_us();
    return loops;
  }

  core::Options options_;
  std::shared_ptr<const core::ClassTable> classes_;
  std::optional<bool> enabled_;  ///< as set by the service; none: as configured
  ros::Publisher publisher_;
  std::unique_ptr<Joiner> joiner_;
  std::mutex mutex_;  ///< guards detector_, which the worker feeds and ~why_loop asks
  std::unique_ptr<core::LoopDetector> detector_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::LoopDetectionNodelet, nodelet::Nodelet)
