#include "ros/tum_bag.h"

#include <rosbag/exceptions.h>
#include <rosbag/query.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>

#include <exception>
#include <utility>

#include "ros/bag_structure.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {
namespace {

constexpr char kMocapFrame[] = "world";
constexpr char kRigFrame[] = "kinect";

std::string explain(const std::string& file, const std::string& cause) {
  return "bag '" + file + "': " + (cause.empty() ? "cannot be read" : cause);
}

/// @return why nothing of a topic can be played; empty: it can
template <class Message>
std::string check_topic(const rosbag::Bag& bag, const std::string& topic) {
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  if (view.size() == 0) return "holds no message on " + topic;
  std::string types;
  for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
    if (connection->md5sum == ros::message_traits::md5sum<Message>()) return {};
    types += (types.empty() ? "" : ", ") + connection->datatype;
  }
  return "holds " + types + " on " + topic + ", which must be " + ros::message_traits::datatype<Message>();
}

}  // namespace

core::Result<std::unique_ptr<TumBagSource>> TumBagSource::open(
    const TumBagPlayback& options, const std::optional<sensor_msgs::CameraInfo>& calibration) {
  std::unique_ptr<TumBagSource> source(new TumBagSource(options));
  source->calibration_ = calibration;
  std::string problem;
  try {
    problem = source->open_bag();
    if (problem.empty()) return source;
  } catch (const rosbag::BagUnindexedException&) {
    problem = "has no index, as after an aborted recording or download; `rosbag reindex` may repair it";
  } catch (const std::exception& exception) {
    problem = std::string("is no bag, or truncated: ") + exception.what();
  }
  return core::Error{explain(options.file, problem)};
}

std::string TumBagSource::open_bag() {
  if (const core::Status intact = check_bag_structure(options_.file); !intact) return intact.message();
  bag_.open(options_.file, rosbag::bagmode::Read);
  const bool has_image_stamps = options_.stamps == "image";
  const std::string stamp_topic = has_image_stamps ? tum_topic::kColor : tum_topic::kCameraInfo;
  std::string problem = has_image_stamps ? check_topic<sensor_msgs::Image>(bag_, stamp_topic)
                                         : check_topic<sensor_msgs::CameraInfo>(bag_, stamp_topic);
  if (!problem.empty()) return problem;
  size_ = rosbag::View(bag_, rosbag::TopicQuery(stamp_topic)).size();
  std::vector<std::string> topics = {tum_topic::kTf, tum_topic::kStaticTf, tum_topic::kCameraInfo};
  if (has_image_stamps) topics.emplace_back(tum_topic::kColor);
  if (options_.plays_depth()) {
    topics.emplace_back(tum_topic::kDepth);
    problem = check_topic<sensor_msgs::Image>(bag_, tum_topic::kDepth);
    if (!problem.empty()) return problem + ": without depth, poses must come from elsewhere";
  }
  view_ = std::make_unique<rosbag::View>(bag_, rosbag::TopicQuery(topics));
  position_ = view_->begin();
  return {};
}

std::optional<PlayerItem> TumBagSource::next() {
  try {
    while (position_ != view_->end() && !is_due()) {
      read_message(*position_);
      ++position_;
    }
  } catch (const std::exception& exception) {
    position_ = view_->end();
    end_ = core::Error{explain(options_.file, std::string("is damaged: ") + exception.what())};
  }
  if (images_.empty() && options_.plays_depth()) {
    pairing_.finish();
    take_pairs();
  }
  if (images_.empty()) return std::nullopt;
  const Image image = images_.front();
  images_.pop_front();
  return make_item(image);
}

bool TumBagSource::is_due() const {
  return !images_.empty() && read_to_ - images_.front().received > ros::Duration(options_.lookahead_s);
}

void TumBagSource::read_message(const rosbag::MessageInstance& message) {
  read_to_ = message.getTime();
  const bool is_static = message.getTopic() == tum_topic::kStaticTf;
  if (is_static || message.getTopic() == tum_topic::kTf) {
    if (const auto transforms = message.instantiate<tf2_msgs::TFMessage>()) take_transforms(*transforms, is_static);
    return;
  }
  if (const auto camera_info = message.instantiate<sensor_msgs::CameraInfo>()) {
    if (options_.stamps == "camera_info") images_.push_back({message.getTime(), camera_info->header, {}, {}});
    if (!calibration_) calibration_ = *camera_info;
  } else if (const auto image = message.instantiate<sensor_msgs::Image>()) {
    if (message.getTopic() == tum_topic::kDepth) {
      pairing_.add_depth(image);
    } else if (options_.plays_depth()) {
      pairing_.add_color(message.getTime(), image);
    } else {
      images_.push_back({message.getTime(), image->header, options_.with_images ? image : nullptr, {}});
    }
    take_pairs();
  }
}

void TumBagSource::take_pairs() {
  while (const std::optional<Image> pair = pairing_.take()) images_.push_back(*pair);
}

void TumBagSource::take_transforms(const tf2_msgs::TFMessage& message, bool is_static) {
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
  if (is_static) {
    static_transforms_.insert(static_transforms_.end(), taken.transforms.begin(), taken.transforms.end());
  } else if (!taken.transforms.empty()) {
    transforms_.push_back(std::move(taken));
  }
}

PlayerItem TumBagSource::make_item(const Image& image) {
  PlayerItem item;
  item.transforms.swap(transforms_);
  item.static_transforms.swap(static_transforms_);
  if (calibration_) item.camera_info = *calibration_;
  item.camera_info.header = image.header;
  item.camera_info.header.frame_id = strip_leading_slash(image.header.frame_id);
  if (!options_.with_images || !is_before_next(image.header, &item) || !is_in_order(image.header, &item)) return item;
  item.color = image.color;
  if (!options_.with_depth) return item;
  if (!image.depth) {
    item.left_out = "colour images without depth";
    item.detail = "none within " + std::to_string(options_.max_depth_delay_s) + " s of stamp " +
                  core::format_stamp(to_stamp_ns(image.header.stamp));
    return item;
  }
  // The two belong together now: whoever joins them by stamp shall not have to guess again.
  image.depth->header.stamp = image.header.stamp;
  item.depth = image.depth;
  return item;
}

bool TumBagSource::is_before_next(const std_msgs::Header& header, PlayerItem* item) const {
  if (images_.empty()) return true;
  const ros::Time& next = images_.front().header.stamp;
  if (header.stamp <= next || (last_stamp_ && next <= *last_stamp_)) return true;
  item->left_out = "images stamped after the next one";
  item->detail =
      "stamp " + core::format_stamp(to_stamp_ns(header.stamp)) + " before " + core::format_stamp(to_stamp_ns(next));
  return false;
}

bool TumBagSource::is_in_order(const std_msgs::Header& header, PlayerItem* item) {
  if (!last_stamp_ || header.stamp > *last_stamp_) {
    last_stamp_ = header.stamp;
    return true;
  }
  item->left_out = "images out of order";
  item->detail = "stamp " + core::format_stamp(to_stamp_ns(header.stamp)) + " after " +
                 core::format_stamp(to_stamp_ns(*last_stamp_));
  return false;
}

core::Result<core::RgbdRecording> open_tum_bag(const std::string& file, const core::Camera& camera,
                                               const core::DepthOptions& options) {
  TumBagPlayback playback;
  playback.file = file;
  playback.with_images = true;
  core::Result<std::unique_ptr<TumBagSource>> opened = TumBagSource::open(playback, std::nullopt);
  if (!opened) return opened.error();
  const std::shared_ptr<TumBagSource> source = *std::move(opened);
  const auto next = [source, camera, options]() -> core::Result<std::optional<core::RgbdReading>> {
    const std::optional<PlayerItem> item = source->next();
    if (!item && !source->end()) return source->end().error();
    if (!item) return std::optional<core::RgbdReading>();
    core::RgbdReading reading{core::Error{item->detail}, item->left_out, {}};
    if (!item->left_out.empty()) return std::optional(std::move(reading));
    reading.image = make_rgbd_image(*item->color, *item->depth, camera, options);
    reading.color = [color = item->color] { return to_mat(*color, sensor_msgs::image_encodings::BGR8, "colour"); };
    return std::optional(std::move(reading));
  };
  return core::RgbdRecording{next, source->size()};
}

core::Status for_each_color_image(
    const std::string& file,
    const std::function<core::Status(std::int64_t stamp_ns, const core::Result<cv::Mat>& color)>& take) {
  if (const core::Status intact = check_bag_structure(file); !intact) {
    return core::Error{explain(file, intact.message())};
  }
  std::size_t images = 0;
  try {
    const rosbag::Bag bag(file);
    for (const rosbag::MessageInstance& message : rosbag::View(bag, rosbag::TopicQuery(tum_topic::kColor))) {
      const auto image = message.instantiate<sensor_msgs::Image>();
      if (!image) continue;
      const core::Status taken =
          take(to_stamp_ns(image->header.stamp), to_mat(*image, sensor_msgs::image_encodings::BGR8, "colour"));
      if (!taken) return core::Error{explain(file, taken.message())};
      ++images;
    }
  } catch (const std::exception& exception) {
    return core::Error{explain(file, std::string("is no bag, or damaged: ") + exception.what())};
  }
  if (images == 0) return core::Error{explain(file, std::string("holds no image on ") + tum_topic::kColor)};
  return {};
}

}  // namespace semantic_topo_loop
