#include "semantic_topo_loop/ros/tum_bag_writer.h"

#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <tf2_msgs/TFMessage.h>

#include "semantic_topo_loop/ros/conversions.h"

namespace semantic_topo_loop {

/// The message of the old tf package, which the official bags carry: tf2_msgs/TFMessage under its former name.
struct TfMessage {
  tf2_msgs::TFMessage message;
};

}  // namespace semantic_topo_loop

namespace ros {
namespace message_traits {

template <>
struct DataType<semantic_topo_loop::TfMessage> {
  static const char* value() { return "tf/tfMessage"; }
  static const char* value(const semantic_topo_loop::TfMessage&) { return value(); }
};
template <>
struct MD5Sum<semantic_topo_loop::TfMessage> {
  static const char* value() { return MD5Sum<tf2_msgs::TFMessage>::value(); }
  static const char* value(const semantic_topo_loop::TfMessage&) { return value(); }
};
template <>
struct Definition<semantic_topo_loop::TfMessage> {
  static const char* value() { return Definition<tf2_msgs::TFMessage>::value(); }
  static const char* value(const semantic_topo_loop::TfMessage&) { return value(); }
};

}  // namespace message_traits

namespace serialization {

template <>
struct Serializer<semantic_topo_loop::TfMessage> {
  template <class Stream>
  static void write(Stream& stream, const semantic_topo_loop::TfMessage& m) {
    Serializer<tf2_msgs::TFMessage>::write(stream, m.message);
  }
  static std::uint32_t serializedLength(const semantic_topo_loop::TfMessage& m) {
    return Serializer<tf2_msgs::TFMessage>::serializedLength(m.message);
  }
};

}  // namespace serialization
}  // namespace ros

namespace semantic_topo_loop {
namespace {

constexpr char kInfoTopic[] = "/camera/rgb/camera_info";
constexpr char kImageTopic[] = "/camera/rgb/image_color";
constexpr char kTfTopic[] = "/tf";
constexpr char kOpticalFrame[] = "/openni_rgb_optical_frame";
constexpr std::uint32_t kImageWidth = 8, kImageHeight = 6;
constexpr std::size_t kChainPeriod = 10;  ///< mocap samples

/// The camera as it hangs on the markers' rig: measured by nobody, but neither identity nor axis-aligned.
core::SE3 kinect_from_camera() { return {core::so3_exp({0.03, -0.05, 0.02}), {-0.012, 0.035, -0.048}}; }
core::SE3 camera_from_rgb() { return {core::Quaternion::Identity(), {0.0, -0.045, 0.0}}; }
/// x forward, y left, z up to x right, y down, z forward.
core::SE3 rgb_from_optical() { return {core::Quaternion(0.5, -0.5, 0.5, -0.5), core::Vec3::Zero()}; }

geometry_msgs::TransformStamped transform(std::int64_t stamp_ns, const char* parent, const char* child,
                                          const core::SE3& T_parent_child) {
  geometry_msgs::TransformStamped message;
  message.header.stamp = to_ros_time(stamp_ns);
  message.header.frame_id = parent;
  message.child_frame_id = child;
  message.transform.translation = to_vector_msg(T_parent_child.t);
  message.transform.rotation = to_msg(T_parent_child).orientation;
  return message;
}

/// The driver's default: no calibration.
sensor_msgs::CameraInfo camera_info(const core::Camera& camera) {
  core::Camera driver;
  driver.fx = driver.fy = 525.0;
  driver.cx = 0.5 * (camera.width - 1);
  driver.cy = 0.5 * (camera.height - 1);
  driver.width = camera.width;
  driver.height = camera.height;
  sensor_msgs::CameraInfo message;
  to_msg(driver, &message);
  message.header.frame_id = kOpticalFrame;
  return message;
}

sensor_msgs::Image grey_image() {
  sensor_msgs::Image image;
  image.header.frame_id = kOpticalFrame;
  image.width = kImageWidth;
  image.height = kImageHeight;
  image.encoding = sensor_msgs::image_encodings::RGB8;
  image.step = 3 * kImageWidth;
  image.data.assign(std::size_t{image.step} * image.height, 128);
  return image;
}

class TumBag {
 public:
  TumBag(const std::string& path, const core::Camera& camera, const TumBagOptions& options)
      : bag_(path, rosbag::bagmode::Write),
        with_images_(options.with_images),
        info_(camera_info(camera)),
        image_(grey_image()) {
    bag_.setCompression(rosbag::compression::BZ2);
  }

  void write_mocap(const core::StampedPose& pose) {
    const core::SE3 T_world_kinect = pose.T_world_camera * tum_kinect_from_optical().inverse();
    TfMessage mocap;
    mocap.message.transforms.push_back(transform(pose.stamp_ns, "/world", "/kinect", T_world_kinect));
    bag_.write(kTfTopic, to_ros_time(pose.stamp_ns), mocap);
    if (mocap_count_++ % kChainPeriod != 0) return;
    TfMessage chain;
    chain.message.transforms = {transform(pose.stamp_ns, "/kinect", "/openni_camera", kinect_from_camera()),
                                transform(pose.stamp_ns, "/openni_camera", "/openni_rgb_frame", camera_from_rgb()),
                                transform(pose.stamp_ns, "/openni_rgb_frame", kOpticalFrame, rgb_from_optical())};
    bag_.write(kTfTopic, to_ros_time(pose.stamp_ns), chain);
  }

  void write_image(std::int64_t stamp_ns) {
    const ros::Time stamp = to_ros_time(stamp_ns);
    info_.header.stamp = image_.header.stamp = stamp;
    info_.header.seq = image_.header.seq = image_count_++;
    bag_.write(kInfoTopic, stamp, info_);
    if (with_images_) bag_.write(kImageTopic, stamp, image_);
  }

  void close() { bag_.close(); }

 private:
  rosbag::Bag bag_;
  bool with_images_;
  sensor_msgs::CameraInfo info_;
  sensor_msgs::Image image_;
  std::size_t mocap_count_ = 0;
  std::uint32_t image_count_ = 0;
};

}  // namespace

core::SE3 tum_kinect_from_optical() { return kinect_from_camera() * camera_from_rgb() * rgb_from_optical(); }

bool write_tum_bag(const core::SimulatedSequence& sequence, const std::string& path, const TumBagOptions& options,
                   std::string* error) {
  try {
    TumBag bag(path, sequence.camera, options);
    std::size_t image = 0;
    for (const core::StampedPose& pose : sequence.mocap) {
      for (; image < sequence.truth.size() && sequence.truth[image].stamp_ns <= pose.stamp_ns; ++image) {
        bag.write_image(sequence.truth[image].stamp_ns);
      }
      bag.write_mocap(pose);
    }
    bag.close();
  } catch (const std::exception& exception) {
    if (error != nullptr) *error = path + ": cannot write the bag: " + exception.what();
    return false;
  }
  return true;
}

}  // namespace semantic_topo_loop
