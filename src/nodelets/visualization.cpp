#include <cv_bridge/cv_bridge.h>
#include <image_transport/image_transport.h>
#include <sensor_msgs/image_encodings.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <memory>
#include <optional>
#include <pluginlib/class_list_macros.hpp>

#include "pipeline/map_state.h"
#include "ros/annotated_image.h"
#include "ros/frame_joiner.h"
#include "ros/map_view.h"
#include "ros/markers.h"
#include "ros/rgbd_images.h"
#include "ros/stage.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/pipeline/object_slam.h"

namespace semantic_topo_loop {
/// Shows the map in rviz. Follows the deltas at all times, since a late listener wants the whole, but reads frames and
/// associations and images, and makes markers and pictures, only while somebody listens.
class VisualizationNodelet : public StageWith<VisualizationParameters> {
 public:
  VisualizationNodelet() : StageWith("Visualization") {}
  ~VisualizationNodelet() override { stop(); }

 private:
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, AssociationsMessage::ConstPtr, sensor_msgs::ImageConstPtr>;
  using ImageSet = Joiner::Set;

  void onInit() override {
    if (!start(2)) return;
    const auto open = [this](const char* topic, LazyPublisher* publisher) {
      publisher->open<visualization_msgs::MarkerArray>(getNodeHandle(), topic, queue_capacity());
    };
    open("markers/quadrics", &quadrics_);
    open("markers/labels", &labels_);
    open("markers/topology", &topology_);
    open("markers/loops", &loops_);
    open("markers/keyframes", &keyframes_);
    loop_map_.open<LoopMap>(getNodeHandle(), "loop_map", queue_capacity());
    annotated_ = image_transport::ImageTransport(getNodeHandle()).advertise("annotated_image", 1);
    joiner_ = std::make_unique<Joiner>(queue_capacity());
    tf_broadcaster_ = std::make_unique<tf2_ros::StaticTransformBroadcaster>();
    subscribe("keyframes", Keep::kAlways, &VisualizationNodelet::on_keyframe);
    subscribe("loop_closures", Keep::kAlways, &VisualizationNodelet::on_loops);
    subscribe("map_corrections", Keep::kAlways, &VisualizationNodelet::on_correction);
    subscribe("quadric_map_updates", Keep::kAlways, &VisualizationNodelet::on_update);
    start_timer(1.0 / parameters_.rate_hz, [this] { publish(); });
    serve_settings(&parameters_, [this] { mark_all_changed(); });
    follow_sessions();
  }

  void reset_session() override {
    stamp_ = ros::Time();
    view_ = MapView();
    follower_ = MapFollower();
    joiner_->clear();
    sent_upright_.reset();
    if (const auto map = session_map({true})) {
      for (const core::KeyframePose& pose : map->keyframe_poses()) {
        view_.add_earlier_keyframe(pose.keyframe_id, pose.T_map_camera);
      }
      take_over(follower_.follow(core::objects_of(*map, options_, classes())));
    }
    mark_all_changed();
  }

  void mark_all_changed() {
    for (LazyPublisher* publisher : {&quadrics_, &labels_, &topology_, &loops_, &loop_map_, &keyframes_}) {
      publisher->mark_changed();
    }
  }

  void on_update(const MapUpdateMessage::ConstPtr& message) {
    stamp_ = message->header.stamp;
    take_over(follower_.follow(*message));
    if (message->phase == core::MapUpdatePhase::kCorrection) count_processed();
  }

  void on_full_map(const MapMessage::ConstPtr& message) { take_over(follower_.recover(*message)); }

  void take_over(const std::vector<core::MapUpdate>& updates) {
    for (const core::MapUpdate& update : updates) {
      view_.apply(update);
      if (update.map_version == update.base_version) continue;
      for (LazyPublisher* publisher : {&quadrics_, &labels_, &topology_}) publisher->mark_changed();
    }
    toggle(follower_.has_gap(), "quadric_map", Keep::kDroppable, &VisualizationNodelet::on_full_map,
           &full_map_subscriber_);
  }

  void on_correction(const CorrectionMessage::ConstPtr& message) {
    view_.apply(*message);
    if (!message->changed) return;
    for (LazyPublisher* publisher : {&labels_, &loops_, &loop_map_, &keyframes_}) publisher->mark_changed();
  }

  void on_keyframe(const Keyframe::ConstPtr& message) {
    view_.add_keyframe(message->keyframe_id, from_msg(message->odom_from_camera));
    keyframes_.mark_changed();
  }

  void on_loops(const LoopsMessage::ConstPtr& message) {
    if (message->closures.empty()) return;
    view_.add_loops(message->closures);
    loops_.mark_changed();
    loop_map_.mark_changed();
  }

  void on_frame(const FrameMessage::ConstPtr& message) {
    view_.set_frame(*message);
    keyframes_.mark_changed();
    if (color_subscriber_) annotate_image(joiner_->add<0>(to_stamp_ns(message->header.stamp), message));
  }

  void on_associations(const AssociationsMessage::ConstPtr& message) {
    view_.set_view(*message);
    topology_.mark_changed();
    if (color_subscriber_) annotate_image(joiner_->add<1>(to_stamp_ns(message->header.stamp), message));
  }

  void on_image(const sensor_msgs::ImageConstPtr& image) {
    push("color", Keep::kDroppable, [this, image] {
      if (color_subscriber_) annotate_image(joiner_->add<2>(to_stamp_ns(image->header.stamp), image));
    });
  }

  void annotate_image(const std::optional<ImageSet>& joined) {
    if (!joined) return;
    const auto& [frame, associations, color] = *joined;
    core::Result<cv::Mat> image = to_mat(*color, sensor_msgs::image_encodings::BGR8, "colour");
    if (!image) return complain("unusable images", image.message());
    const core::Status status = annotate(*frame, *associations, view_, *classes(), &*image);
    if (!status) return complain("unusable images", status.message());
    annotated_.publish(cv_bridge::CvImage(color->header, sensor_msgs::image_encodings::BGR8, *image).toImageMsg());
  }

  void toggle_images(bool wanted) {
    if (wanted == are_images_wanted_) return;
    are_images_wanted_ = wanted;
    if (!wanted) {
      color_subscriber_.shutdown();
      warn_while("color", "");
      return;
    }
    joiner_->clear();
    constexpr std::uint32_t kImages = 10;  // that wait for the callback, which is short
    auto subscriber =
        subscribe_to_images(subscriber_node(), getPrivateNodeHandle(), "color", parameters_.color_transport, kImages,
                            [this](const sensor_msgs::ImageConstPtr& image) { on_image(image); });
    if (subscriber) color_subscriber_ = *std::move(subscriber);
    // The markers need no images.
    if (!subscriber) warn_while("color", "no annotated_image: " + subscriber.message());
  }

  /// For viewers, whose z is up: the map's need not be.
  void send_upright_frame() {
    const std::optional<core::SE3> T_map_upright = view_.T_map_upright();
    if (parameters_.upright_frame.empty() || !T_map_upright) return;
    constexpr double kSameAngleRad = 0.02, kSameDistanceM = 0.02;  // what nobody sees in a viewer
    const bool same = sent_upright_ && core::rotation_angle(sent_upright_->q, T_map_upright->q) < kSameAngleRad &&
                      (sent_upright_->t - T_map_upright->t).norm() < kSameDistanceM;
    if (same) return;
    sent_upright_ = T_map_upright;
    const std_msgs::Header header = make_header(stamp_, parameters_.map_frame);
    tf_broadcaster_->sendTransform(make_transform(header, parameters_.upright_frame, *T_map_upright));
  }

  void publish() {
    send_upright_frame();
    const bool images_wanted = annotated_.getNumSubscribers() > 0;
    toggle_images(images_wanted);
    toggle(images_wanted || keyframes_.has_listeners(), "frames", Keep::kDroppable, &VisualizationNodelet::on_frame,
           &frame_subscriber_);
    toggle(images_wanted || topology_.has_listeners(), "associations", Keep::kDroppable,
           &VisualizationNodelet::on_associations, &association_subscriber_);
    const std_msgs::Header header = make_header(stamp_, parameters_.map_frame);
    const MarkerSizes& sizes = parameters_.sizes;
    if (quadrics_.is_due()) quadrics_.publish(make_quadric_markers(view_, header));
    if (labels_.is_due()) labels_.publish(make_label_markers(view_, header, *classes(), sizes));
    if (topology_.is_due()) topology_.publish(make_topology_markers(view_, header, sizes));
    if (loops_.is_due()) loops_.publish(make_loop_markers(view_, header, sizes));
    if (loop_map_.is_due()) loop_map_.publish(make_loop_map(view_, header, session_id()));
    if (keyframes_.is_due()) keyframes_.publish(make_keyframe_markers(view_, header, sizes));
  }

  LazyPublisher quadrics_, labels_, topology_, loops_, loop_map_, keyframes_;
  image_transport::Publisher annotated_;
  image_transport::Subscriber color_subscriber_;
  bool are_images_wanted_ = false;
  std::unique_ptr<Joiner> joiner_;  ///< by stamp
  ros::Subscriber frame_subscriber_, association_subscriber_, full_map_subscriber_;
  std::unique_ptr<tf2_ros::StaticTransformBroadcaster> tf_broadcaster_;
  std::optional<core::SE3> sent_upright_;
  MapView view_;
  MapFollower follower_;
  ros::Time stamp_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::VisualizationNodelet, nodelet::Nodelet)
