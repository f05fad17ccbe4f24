#include <map>
#include <memory>
#include <pluginlib/class_list_macros.hpp>

#include "pipeline/map_state.h"
#include "ros/frame_joiner.h"
#include "ros/map_view.h"
#include "ros/stage.h"
#include "semantic_topo_loop/association/object_associator.h"
#include "semantic_topo_loop/pipeline/object_slam.h"

namespace semantic_topo_loop {

/// Associates each frame's detections with landmarks, follows the quadric map, and says when a frame is done: it is the
/// last of the loop to change its state.
class ObjectAssociationNodelet : public StageWith<ClassStageParameters> {
 public:
  ObjectAssociationNodelet() : StageWith("ObjectAssociation") {}
  ~ObjectAssociationNodelet() override { stop(); }

 private:
  /// A frame that the end of the chain has not answered yet.
  struct Open {
    ros::Time stamp;
    bool is_end = false;
    bool associated = false;
  };

  void onInit() override {
    if (!start(2)) return;
    // A break is told by one frame alone, whose boxes may get lost.
    joiner_ = std::make_unique<Joiner>(queue_capacity(), [this](std::int64_t, const Joiner::Partial& partial) {
      if (const auto& frame = std::get<0>(partial)) send(**frame, associator_->pass(**frame));
    });
    associations_publisher_ = advertise<AssociationsMessage>("associations");
    done_publisher_ = advertise_done();
    for (const char* counter : {kIncomplete, kVersionGaps}) statistics().count(counter, 0);
    reset_session();
    serve_settings(&options_.association, [this] { associator_->set_options(options_.association); });
    subscribe("quadric_map_updates", Keep::kAlways, &ObjectAssociationNodelet::on_update);
    subscribe("detections", Keep::kDroppable, &ObjectAssociationNodelet::on_detections);
    subscribe("frames", Keep::kAlways, &ObjectAssociationNodelet::on_frame);
    follow_sessions();
  }

  void reset_session() override {
    associator_ = std::make_unique<core::ObjectAssociator>(options_.association, classes());
    follower_ = MapFollower();
    full_map_subscriber_.shutdown();
    joiner_->clear();
    open_.clear();
    has_frames_ = false;
    first_frame_id_ = 0;
    const auto map = session_map({true});
    if (!map) return;
    first_frame_id_ = map->graph.next_frame_id;
    take_over(follower_.follow(core::objects_of(*map, options_, classes())));
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    open_[frame->frame_id] = {frame->header.stamp, frame->is_end, false};
    if (!has_frames_ && frame->frame_id > first_frame_id_) {
      // Ids were given out before this nodelet was loaded, some to landmarks that the map has merged since.
      constexpr std::int64_t kMostPerFrame = 1000;
      associator_->count_from(kMostPerFrame * frame->frame_id);
      follower_.join_late();
      take_over({});
    }
    has_frames_ = true;
    associate(joiner_->add<0>(frame->frame_id, frame));
  }

  void on_detections(const DetectionsMessage::ConstPtr& detections) {
    associate(joiner_->add<1>(detections->frame_id, detections));
  }

  void associate(const std::optional<std::tuple<FrameMessage::ConstPtr, DetectionsMessage::ConstPtr>>& joined) {
    statistics().set_lost(kIncomplete, joiner_->evicted());
    if (!joined) return;
    const auto& [frame, detections] = *joined;
    open_[frame->frame_id].associated = true;
    send(*frame,
         detections->unanswered ? associator_->pass(*frame) : associator_->associate(*frame, detections->detections));
  }

  void send(const FrameMessage& frame, core::AssociationFrame associations) {
    publish<AssociationsMessage>(associations_publisher_, make_header(frame.header.stamp, frame.camera_frame),
                                 std::move(associations));
    count_processed();
  }

  void on_update(const MapUpdateMessage::ConstPtr& message) {
    take_over(follower_.follow(*message));
    if (message->phase == core::MapUpdatePhase::kCorrection) finish(message->frame_id);
  }

  void on_full_map(const MapMessage::ConstPtr& message) { take_over(follower_.recover(*message)); }

  /// Applies what the follower lets through; asks for the full map while there is a gap, and only then.
  void take_over(const std::vector<core::MapUpdate>& updates) {
    for (const core::MapUpdate& update : updates) associator_->apply(update);
    statistics().set(kVersionGaps, follower_.gaps());
    toggle(follower_.has_gap(), "quadric_map", Keep::kAlways, &ObjectAssociationNodelet::on_full_map,
           &full_map_subscriber_);
  }

  /// Corrections come in order of frames, so what is older and still open got lost on its way.
  void finish(std::int64_t frame_id) {
    for (auto it = open_.begin(); it != open_.end() && it->first <= frame_id; it = open_.erase(it)) {
      const Open& open = it->second;
      std::uint8_t status = FrameDone::STATUS_FAILED;
      if (open.associated) status = open.is_end ? FrameDone::STATUS_END : FrameDone::STATUS_PROCESSED;
      publish_done(done_publisher_, open.stamp, it->first, status, associator_->map_version());
    }
  }

  using Joiner = FrameJoiner<FrameMessage::ConstPtr, DetectionsMessage::ConstPtr>;
  static constexpr char kIncomplete[] = "dropped, frame or detections missing";
  static constexpr char kVersionGaps[] = "gaps between map versions";

  ros::Publisher associations_publisher_, done_publisher_;
  ros::Subscriber full_map_subscriber_;
  std::unique_ptr<Joiner> joiner_;
  std::unique_ptr<core::ObjectAssociator> associator_;
  MapFollower follower_;
  std::map<std::int64_t, Open> open_;  ///< by frame_id
  bool has_frames_ = false;            ///< of this session
  std::int64_t first_frame_id_ = 0;    ///< of this session
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::ObjectAssociationNodelet, nodelet::Nodelet)
