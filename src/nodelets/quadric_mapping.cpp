#include <memory>
#include <pluginlib/class_list_macros.hpp>

#include "ros/frame_joiner.h"
#include "ros/stage.h"
#include "semantic_topo_loop/map/quadric_mapper.h"

namespace semantic_topo_loop {
/// Keeps the quadric map and publishes its deltas, and the whole of it now and then for late listeners.
class QuadricMappingNodelet : public StageWith<QuadricMappingParameters> {
 public:
  QuadricMappingNodelet() : StageWith("QuadricMapping") {}
  ~QuadricMappingNodelet() override { stop(); }

 private:
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, AssociationsMessage::ConstPtr>;
  static constexpr double kFullMapPeriodS = 1.0;  ///< how long a late listener waits for the map
  static constexpr char kIncomplete[] = "dropped, frame or associations missing";

  void onInit() override {
    if (!start(2)) return;
    joiner_ = std::make_unique<Joiner>(queue_capacity());
    update_publisher_ = advertise<MapUpdateMessage>("quadric_map_updates");
    map_publisher_ = advertise<MapMessage>("quadric_map", true);
    statistics().count(kIncomplete, 0);
    reset_session();
    subscribe("map_corrections", Keep::kAlways, &QuadricMappingNodelet::on_correction);
    subscribe("associations", Keep::kDroppable, &QuadricMappingNodelet::on_associations);
    subscribe("frames", Keep::kDroppable, &QuadricMappingNodelet::on_frame);
    start_timer(kFullMapPeriodS, [this] { publish_map(); });
    follow_sessions();
  }

  void reset_session() override {
    mapper_ = std::make_unique<core::QuadricMapper>(options_.mapping, classes());
    joiner_->clear();
    published_version_ = 0;
  }

  void on_frame(const FrameMessage::ConstPtr& frame) { integrate(joiner_->add<0>(frame->frame_id, frame)); }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    integrate(joiner_->add<1>(associations->frame_id, associations));
  }

  void integrate(const std::optional<std::tuple<FrameMessage::ConstPtr, AssociationsMessage::ConstPtr>>& joined) {
    statistics().set(kIncomplete, joiner_->evicted());
    if (!joined) return;
    const auto& [frame, associations] = *joined;
    publish(mapper_->integrate(*frame, *associations), frame->header.stamp);
    count_processed();
  }

  void on_correction(const CorrectionMessage::ConstPtr& correction) {
    publish(mapper_->apply(*correction), correction->header.stamp);
    if (correction->changed) publish_map();
  }

  void publish(core::MapUpdate update, const ros::Time& stamp) {
    last_stamp_ = stamp;
    Stage::publish<MapUpdateMessage>(update_publisher_, make_header(stamp, parameters_.map_frame), std::move(update));
  }

  /// The whole map, unless that version is out already.
  void publish_map() {
    if (mapper_->map_version() == published_version_) return;
    published_version_ = mapper_->map_version();
    FullMap map;
    map.map_version = published_version_;
    map.T_map_odom = mapper_->T_map_odom();
    map.changed = mapper_->landmarks();
    Stage::publish<MapMessage>(map_publisher_, make_header(last_stamp_, parameters_.map_frame), std::move(map));
  }

  ros::Publisher update_publisher_, map_publisher_;
  std::unique_ptr<Joiner> joiner_;
  std::unique_ptr<core::QuadricMapper> mapper_;
  std::uint64_t published_version_ = 0;
  ros::Time last_stamp_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::QuadricMappingNodelet, nodelet::Nodelet)
