#include <memory>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <string>

#include "pipeline/map_state.h"
#include "ros/stage.h"
#include "semantic_topo_loop/SavePoints.h"
#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/map/point_map.h"

namespace semantic_topo_loop {
/// Keeps the points of the keyframes, which move with the map's corrections. Publishes them only while somebody
/// listens.
class PointMappingNodelet : public StageWith<PointMappingParameters> {
 public:
  PointMappingNodelet() : StageWith("PointMapping") {}
  ~PointMappingNodelet() override { stop(); }

 private:
  void onInit() override {
    if (!start(2)) return;
    reset_session();
    sparse_.open<sensor_msgs::PointCloud2>(getNodeHandle(), "map_points_sparse", queue_capacity());
    semi_dense_.open<sensor_msgs::PointCloud2>(getNodeHandle(), "map_points_semi_dense", queue_capacity());
    serve("save_points", &PointMappingNodelet::on_save);
    subscribe("keyframe_points", Keep::kAlways, &PointMappingNodelet::on_points);
    subscribe("map_corrections", Keep::kAlways, &PointMappingNodelet::on_correction);
    start_timer(1.0 / parameters_.rate_hz, [this] { publish(); });
    follow_sessions();
  }

  void reset_session() override {
    stamp_ = ros::Time();
    const std::lock_guard<std::mutex> lock(mutex_);
    map_ = std::make_unique<core::PointMap>(options_.point_map);
    if (const auto map = session_map({false, false, true})) core::restore_points(*map, map_.get());
    mark_changed();
  }

  void on_points(const KeyframePointsMessage::ConstPtr& message) {
    if (!message->keyframe_points) {
      return complain("unusable points of keyframes",
                      "keyframe " + std::to_string(message->keyframe_id) + ": " + message->problem);
    }
    stamp_ = message->header.stamp;
    if (session().localization) return;  // the map stays as it is
    const std::lock_guard<std::mutex> lock(mutex_);
    map_->add(*message);
    mark_changed();
    count_processed();
  }

  void on_correction(const CorrectionMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    map_->apply(*message);  // one that changes nothing may say where the next keyframe hangs
    if (message->changed) mark_changed();
  }

  bool on_save(SavePoints::Request& request, SavePoints::Response& response) {
    const core::Result<std::string> place = path_below(parameters_.save_dir, request.path, parameters_.allow_any_path);
    const core::MapPoints points = snapshot();
    const auto write = [&points](const std::string& path) { return core::write_point_cloud(path, points); };
    answer(place ? write_to(*place, write) : place, &response);
    return true;
  }

  core::MapPoints snapshot() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return map_->points();
  }

  void publish() {
    const bool sparse_due = sparse_.is_due(), semi_dense_due = semi_dense_.is_due();
    if (!sparse_due && !semi_dense_due) return;
    const core::MapPoints points = snapshot();
    if (sparse_due) sparse_.publish(cloud(points.sparse));
    if (semi_dense_due) semi_dense_.publish(cloud(points.semi_dense));
  }

  sensor_msgs::PointCloud2::Ptr cloud(const std::vector<Eigen::Vector3f>& points) const {
    auto message = boost::make_shared<sensor_msgs::PointCloud2>();
    to_cloud(points, message.get());
    message->header = make_header(stamp_, parameters_.map_frame);
    return message;
  }

  void mark_changed() {
    sparse_.mark_changed();
    semi_dense_.mark_changed();
  }

  LazyPublisher sparse_, semi_dense_;  ///< worker thread only
  ros::Time stamp_;
  std::mutex mutex_;  ///< guards map_, which the worker fills and the service reads
  std::unique_ptr<core::PointMap> map_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::PointMappingNodelet, nodelet::Nodelet)
