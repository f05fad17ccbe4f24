#include "apps/tum_bag_writer.h"

#include <cv_bridge/cv_bridge.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>

#include <boost/make_shared.hpp>
#include <memory>
#include <opencv2/imgproc.hpp>

#include "ros/conversions.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/text_file.h"
#include "tools/rendering/rgbd_sequence.h"

namespace semantic_topo_loop {
namespace {

constexpr char kDepthInfoTopic[] = "/camera/depth/camera_info";
constexpr char kCameraFrame[] = "/openni_camera";
constexpr char kOpticalFrame[] = "/openni_rgb_optical_frame";
constexpr char kDepthOpticalFrame[] = "/openni_depth_optical_frame";  ///< of depth that is not registered
constexpr int kThumbnailWidth = 8, kThumbnailHeight = 6;
constexpr std::size_t kChainPeriod = 10;  ///< mocap samples

/// The camera as it hangs on the markers' rig: measured by nobody, but neither identity nor axis-aligned.
core::SE3 kinect_from_camera() { return {core::so3_exp({0.03, -0.05, 0.02}), {-0.012, 0.035, -0.048}}; }
core::SE3 camera_from_rgb() { return {core::Quaternion::Identity(), {0.0, -0.045, 0.0}}; }
/// x forward, y left, z up to x right, y down, z forward.
core::SE3 rgb_from_optical() { return {core::Quaternion(0.5, -0.5, 0.5, -0.5), core::Vec3::Zero()}; }

/// The official bags carry the message of the old tf package: tf2_msgs/TFMessage under its former name.
boost::shared_ptr<ros::M_string> old_tf_connection() {
  return boost::make_shared<ros::M_string>(
      ros::M_string{{"type", "tf/tfMessage"},
                    {"md5sum", ros::message_traits::md5sum<tf2_msgs::TFMessage>()},
                    {"message_definition", ros::message_traits::definition<tf2_msgs::TFMessage>()}});
}

geometry_msgs::TransformStamped transform(std::int64_t stamp_ns, const char* parent, const char* child,
                                          const core::SE3& T_parent_child) {
  return make_transform(make_header(to_ros_time(stamp_ns), parent), child, T_parent_child);
}

/// The driver's default: no calibration.
sensor_msgs::CameraInfo camera_info(const core::Camera& camera, const char* frame) {
  core::Camera driver;
  driver.fx = driver.fy = 525.0;
  driver.cx = 0.5 * (camera.width - 1);
  driver.cy = 0.5 * (camera.height - 1);
  driver.width = camera.width;
  driver.height = camera.height;
  sensor_msgs::CameraInfo message;
  to_msg(driver, &message);
  message.header.frame_id = frame;
  return message;
}

sensor_msgs::ImagePtr image_message(const cv::Mat& image, const char* frame, const std::string& encoding) {
  std_msgs::Header header;
  header.frame_id = frame;
  return cv_bridge::CvImage(header, encoding, image).toImageMsg();
}

rosbag::compression::CompressionType compression_of(const std::string& name) {
  if (name == "none") return rosbag::compression::Uncompressed;
  return name == "lz4" ? rosbag::compression::LZ4 : rosbag::compression::BZ2;
}

class TumBag {
 public:
  TumBag(const core::SimulatedSequence& sequence, const TumBagOptions& options)
      : sequence_(sequence),
        options_(options),
        depth_frame_(options.rendering.depth_offset_m == 0.0 ? kOpticalFrame : kDepthOpticalFrame),
        info_(camera_info(sequence.camera, kOpticalFrame)),
        depth_info_(camera_info(sequence.camera, depth_frame_)) {}
  ~TumBag() {
    try {
      bag_->close();
    } catch (const std::exception&) {
      static_cast<void>(bag_.release());  // its destructor would try again, and end the program by what it throws
    }
  }
  TumBag(const TumBag&) = delete;
  TumBag& operator=(const TumBag&) = delete;

  /// Everything in order of time.
  /// @return an error if an image cannot be read
  core::Status write(const std::string& path) {
    bag_->open(path, rosbag::bagmode::Write);
    bag_->setCompression(compression_of(options_.compression));
    const core::StampedPoses &colors = sequence_.truth, &depths = sequence_.depth;
    std::size_t color = 0, depth = 0;
    for (const core::StampedPose& pose : sequence_.mocap) {
      for (;;) {
        const bool has_color = color < colors.size() && colors[color].stamp_ns <= pose.stamp_ns;
        const bool has_depth = depth < depths.size() && depths[depth].stamp_ns <= pose.stamp_ns;
        if (!has_color && !has_depth) break;
        const bool is_color = has_color && (!has_depth || colors[color].stamp_ns <= depths[depth].stamp_ns);
        const core::Status written = is_color ? write_color(color++) : write_depth(depth++);
        if (!written) return written;
      }
      write_mocap(pose);
    }
    bag_->close();
    return {};
  }

 private:
  void write_mocap(const core::StampedPose& pose) {
    const core::SE3 T_world_kinect = pose.T_world_camera * tum_kinect_from_optical().inverse();
    tf2_msgs::TFMessage mocap;
    mocap.transforms.push_back(transform(pose.stamp_ns, "/world", "/kinect", T_world_kinect));
    bag_->write(tum_topic::kTf, to_ros_time(pose.stamp_ns), mocap, tf_connection_);
    if (mocap_count_++ % kChainPeriod != 0) return;
    tf2_msgs::TFMessage chain;
    chain.transforms = {transform(pose.stamp_ns, "/kinect", kCameraFrame, kinect_from_camera()),
                        transform(pose.stamp_ns, kCameraFrame, "/openni_rgb_frame", camera_from_rgb()),
                        transform(pose.stamp_ns, "/openni_rgb_frame", kOpticalFrame, rgb_from_optical())};
    if (depth_frame_ != kOpticalFrame) {
      const core::SE3 T_rgb_depth =
          rgb_from_optical() * core::color_from_depth(options_.rendering) * rgb_from_optical().inverse();
      chain.transforms.push_back(
          transform(pose.stamp_ns, kCameraFrame, "/openni_depth_frame", camera_from_rgb() * T_rgb_depth));
      chain.transforms.push_back(
          transform(pose.stamp_ns, "/openni_depth_frame", kDepthOpticalFrame, rgb_from_optical()));
    }
    bag_->write(tum_topic::kTf, to_ros_time(pose.stamp_ns), chain, tf_connection_);
  }

  core::Status write_color(std::size_t frame) {
    const std::int64_t stamp_ns = sequence_.truth[frame].stamp_ns;
    write(tum_topic::kCameraInfo, frame, stamp_ns, &info_);
    if (!options_.with_images) return {};
    core::Result<cv::Mat> image(cv::Mat(kThumbnailHeight, kThumbnailWidth, CV_8UC3, cv::Scalar::all(128.0)));
    if (has_rendered_images()) image = core::read_rendered_color(sequence_, options_.image_directory, frame);
    if (!image) return image.error();
    // The official bags hold rgb8.
    cv::cvtColor(*image, *image, cv::COLOR_BGR2RGB);
    write(tum_topic::kColor, frame, stamp_ns, image_message(*image, kOpticalFrame, "rgb8").get());
    return {};
  }

  core::Status write_depth(std::size_t frame) {
    if (!has_rendered_images()) return {};
    const std::int64_t stamp_ns = sequence_.depth[frame].stamp_ns;
    const core::Result<cv::Mat> depth_m =
        core::read_rendered_depth(sequence_, options_.rendering, options_.image_directory, frame);
    if (!depth_m) return depth_m.error();
    write(kDepthInfoTopic, frame, stamp_ns, &depth_info_);
    write(tum_topic::kDepth, frame, stamp_ns, image_message(*depth_m, depth_frame_, "32FC1").get());
    return {};
  }

  bool has_rendered_images() const { return options_.with_images && !options_.image_directory.empty(); }

  template <class Message>
  void write(const char* topic, std::size_t frame, std::int64_t stamp_ns, Message* message) {
    message->header.stamp = to_ros_time(stamp_ns);
    message->header.seq = static_cast<std::uint32_t>(frame);
    bag_->write(topic, message->header.stamp, *message);
  }

  std::unique_ptr<rosbag::Bag> bag_ = std::make_unique<rosbag::Bag>();
  const core::SimulatedSequence& sequence_;
  const TumBagOptions& options_;
  const char* depth_frame_;
  sensor_msgs::CameraInfo info_, depth_info_;
  const boost::shared_ptr<ros::M_string> tf_connection_ = old_tf_connection();
  std::size_t mocap_count_ = 0;
};

}  // namespace

core::SE3 tum_kinect_from_optical() { return kinect_from_camera() * camera_from_rgb() * rgb_from_optical(); }

core::Status write_tum_bag(const core::SimulatedSequence& sequence, const std::string& path,
                           const TumBagOptions& options) {
  return core::replace_file(path, [&](const std::string& temporary) -> core::Status {
    try {
      return TumBag(sequence, options).write(temporary);
    } catch (const std::exception& exception) {
      return core::Error{path + ": cannot write the bag: " + exception.what()};
    }
  });
}

}  // namespace semantic_topo_loop
