#pragma once

#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "ros/parameters.h"
#include "ros/playback.h"
#include "ros/rgbd_images.h"
#include "semantic_topo_loop/io/rgbd_recording.h"

namespace semantic_topo_loop {

/// Topics of the official TUM layout.
namespace tum_topic {
constexpr char kColor[] = "/camera/rgb/image_color", kDepth[] = "/camera/depth/image";
constexpr char kCameraInfo[] = "/camera/rgb/camera_info";
constexpr char kTf[] = "/tf", kStaticTf[] = "/tf_static";
}  // namespace tum_topic

/// Reads a bag in the official TUM layout, in one pass, without a master: the tum_topics, with `/world -> /kinect` of
/// /tf from the motion capture and the camera's chain below `/kinect`, or another camera's in /tf_static. Only the
/// motion capture's edge is changed, so that `kinect` has one parent. Leading slashes of frame ids are stripped. Images
/// out of order, those stamped after the one that follows, and colour images without depth where both are wanted, are
/// left out and said to be.
class TumBagSource {
 public:
  /// @param calibration replaces the recorded camera_info, which holds the driver's defaults
  /// @return an error that names file and cause if it cannot be played
  static core::Result<std::unique_ptr<TumBagSource>> open(const TumBagPlayback& options,
                                                          const std::optional<sensor_msgs::CameraInfo>& calibration);
  /// @return nullopt at the end
  std::optional<PlayerItem> next();
  core::Status end() const { return end_; }
  std::size_t size() const { return size_; }

 private:
  using Image = DepthPairing::Answer;  ///< without what is not played

  explicit TumBagSource(const TumBagPlayback& options) : options_(options), pairing_(options.max_depth_delay_s) {}
  /// @return what is wrong with it; empty: nothing
  std::string open_bag();
  bool is_due() const;
  void read_message(const rosbag::MessageInstance& message);
  void take_pairs();
  void take_transforms(const tf2_msgs::TFMessage& message, bool is_static);
  PlayerItem make_item(const Image& image);
  /// One image stamped far ahead would make all that follow look out of order.
  bool is_before_next(const std_msgs::Header& header, PlayerItem* item) const;
  bool is_in_order(const std_msgs::Header& header, PlayerItem* item);

  const TumBagPlayback options_;
  std::optional<sensor_msgs::CameraInfo> calibration_;
  rosbag::Bag bag_;
  std::unique_ptr<rosbag::View> view_;
  rosbag::View::iterator position_;
  ros::Time read_to_;  ///< time of recording of the last message read
  std::size_t size_ = 0;
  DepthPairing pairing_;
  std::deque<Image> images_;
  std::optional<ros::Time> last_stamp_;  ///< of the images given
  std::vector<tf2_msgs::TFMessage> transforms_;
  std::vector<geometry_msgs::TransformStamped> static_transforms_;
  core::Status end_;  ///< a fault that ended the reading; what was read before it is still played
};

/// The colour images of a bag in the official TUM layout, with their depth, as the player gives them to the
/// RgbdFrontend nodelet. Needs no master.
/// @return an error that names file and cause if it cannot be read
core::Result<core::RgbdRecording> open_tum_bag(const std::string& file, const core::Camera& camera,
                                               const core::DepthOptions& options);

/// Gives `take` the colour images of such a bag, CV_8UC3 as BGR or why one cannot be read, in the order in which they
/// were recorded, until it fails. Needs neither depth nor a master.
/// @return the error of `take` with the bag's name, or one that names file and cause if it cannot be read
core::Status for_each_color_image(
    const std::string& file,
    const std::function<core::Status(std::int64_t stamp_ns, const core::Result<cv::Mat>& color)>& take);

}  // namespace semantic_topo_loop
