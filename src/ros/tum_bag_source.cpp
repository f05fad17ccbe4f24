#include "semantic_topo_loop/ros/tum_bag_source.h"

#include <rosbag/exceptions.h>
#include <rosbag/query.h>
#include <sensor_msgs/Image.h>

#include <algorithm>
#include <exception>

#include "semantic_topo_loop/ros/conversions.h"

namespace semantic_topo_loop {
namespace {

constexpr char kImageTopic[] = "/camera/rgb/image_color";
constexpr char kCameraInfoTopic[] = "/camera/rgb/camera_info";
constexpr char kTfTopic[] = "/tf";
constexpr char kMocapFrame[] = "world";
constexpr char kRigFrame[] = "kinect";

std::string explain(const std::string& file, const std::string& cause) {
  return "bag '" + file + "': " + (cause.empty() ? "cannot be read" : cause);
}

}  // namespace

std::unique_ptr<TumBagSource> TumBagSource::open(const TumBagPlayback& options,
                                                 const std::optional<sensor_msgs::CameraInfo>& calibration,
                                                 std::string* error) {
  std::unique_ptr<TumBagSource> source(new TumBagSource(options));
  source->calibration_ = calibration;
  std::string problem;
  try {
    source->open_bag();
    if (source->size_ > 0) return source;
    problem = "holds no message on " + std::string(options.stamps == "image" ? kImageTopic : kCameraInfoTopic);
  } catch (const rosbag::BagUnindexedException&) {
    problem = "has no index, as after an aborted recording or download; `rosbag reindex` may repair it";
  } catch (const std::exception& exception) {
    problem = std::string("is no bag, or truncated: ") + exception.what();
  }
  if (error != nullptr) *error = explain(options.file, problem);
  return nullptr;
}

void TumBagSource::open_bag() {
  bag_.open(options_.file, rosbag::bagmode::Read);
  const std::string stamp_topic = options_.stamps == "image" ? kImageTopic : kCameraInfoTopic;
  size_ = rosbag::View(bag_, rosbag::TopicQuery(stamp_topic)).size();
  std::vector<std::string> topics = {kTfTopic, kCameraInfoTopic};
  if (stamp_topic == kImageTopic) topics.emplace_back(kImageTopic);
  view_ = std::make_unique<rosbag::View>(bag_, rosbag::TopicQuery(topics));
  position_ = view_->begin();
}

std::optional<PlayerItem> TumBagSource::next(std::string* error) {
  try {
    while (position_ != view_->end() && (images_.empty() || !is_due(images_.front()))) {
      read_message(*position_);
      ++position_;
    }
  } catch (const std::exception& exception) {
    position_ = view_->end();
    images_.clear();
    if (error != nullptr) *error = explain(options_.file, std::string("is damaged: ") + exception.what());
    return std::nullopt;
  }
  if (images_.empty()) return std::nullopt;
  const Image image = images_.front();
  images_.pop_front();
  return make_item(image);
}

bool TumBagSource::is_due(const Image& image) const {
  return read_to_ - image.received > ros::Duration(options_.lookahead_s);
}

void TumBagSource::read_message(const rosbag::MessageInstance& message) {
  read_to_ = message.getTime();
  if (message.getTopic() == kTfTopic) {
    if (const auto transforms = message.instantiate<tf2_msgs::TFMessage>()) take_transforms(*transforms);
    return;
  }
  if (const auto camera_info = message.instantiate<sensor_msgs::CameraInfo>()) {
    if (options_.stamps == "camera_info") images_.push_back({message.getTime(), camera_info->header});
    if (!calibration_) calibration_ = *camera_info;
  } else if (const auto image = message.instantiate<sensor_msgs::Image>()) {
    images_.push_back({message.getTime(), image->header});
  }
}

void TumBagSource::take_transforms(const tf2_msgs::TFMessage& message) {
  tf2_msgs::TFMessage taken;
  for (geometry_msgs::TransformStamped transform : message.transforms) {
    transform.header.frame_id = strip_leading_slash(transform.header.frame_id);
    transform.child_frame_id = strip_leading_slash(transform.child_frame_id);
    if (transform.header.frame_id == kMocapFrame && transform.child_frame_id == kRigFrame) {
      if (options_.mocap_tf == "drop") continue;
      transform.header.frame_id = options_.odom_frame;
    }
    taken.transforms.push_back(transform);
  }
  if (!taken.transforms.empty()) transforms_.push_back(std::move(taken));
}

PlayerItem TumBagSource::make_item(const Image& image) {
  PlayerItem item;
  item.transforms.swap(transforms_);
  if (calibration_) item.camera_info = *calibration_;
  item.camera_info.header = image.header;
  item.camera_info.header.frame_id = strip_leading_slash(image.header.frame_id);
  return item;
}

}  // namespace semantic_topo_loop
