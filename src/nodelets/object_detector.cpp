#include "semantic_topo_loop/frontend/object_detector.h"

#include <sensor_msgs/image_encodings.h>

#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <utility>
#include <vector>

#include "geometry/up_estimator.h"
#include "ros/rgbd_images.h"
#include "ros/stage.h"

namespace semantic_topo_loop {

/// Looks for objects in the newest colour image, or in lockstep in each that has a pose. Every image has its
/// DetectionArray, in order; those that nobody looked at are unanswered. Frames tell how the camera is rolled: in
/// lockstep each image's own, else the last one.
class ObjectDetectorNodelet : public StageWith<ObjectDetectorParameters> {
 public:
  ObjectDetectorNodelet() : StageWith("ObjectDetector") {}
  ~ObjectDetectorNodelet() override {
    subscriber_.shutdown();
    stop();
  }

 private:
  static constexpr char kLeftOut[] = "images left out";

  void onInit() override {
    if (!start(2)) return;
    auto detector = core::ObjectDetector::load(options_.detector, *classes());
    if (!detector) {
      fail(detector.message());
      return;
    }
    detector_ = *std::move(detector);
    if (!detector_->warning().empty()) NODELET_WARN("%s", detector_->warning().c_str());
    constexpr std::uint32_t kImages = 10;  // that wait for the callback, which is short
    auto subscriber =
        subscribe_to_images(subscriber_node(), getPrivateNodeHandle(), "color", parameters_.color_transport, kImages,
                            [this](const sensor_msgs::ImageConstPtr& image) { on_image(image); });
    if (!subscriber) {
      fail(subscriber.message());
      return;
    }
    subscriber_ = *std::move(subscriber);
    statistics().count(kLeftOut, 0);
    publisher_ = advertise<DetectionsMessage>("detections_in");
    serve_settings(&options_.detector, [this] { detector_->set_options(options_.detector); });
    subscribe("frames", Keep::kAlways, &ObjectDetectorNodelet::on_frame);
    follow_sessions();
  }

  void reset_session() override {
    up_ = std::make_unique<core::UpEstimator>(options_.loop.up_window_s);
    waiting_.clear();
    roll_rad_.clear();
    size_px_.reset();
    detector_->restart();
  }

  void on_image(const sensor_msgs::ImageConstPtr& image) {
    if (parameters_.lockstep) {
      return push("color", Keep::kAlways, [this, image] {
        // A recording that begins anew: nobody waits for the others any longer.
        while (!waiting_.empty() && waiting_.back()->header.stamp > image->header.stamp) waiting_.pop_back();
        waiting_.push_back(image);
        look_at_waiting();
        // No player sends so many before it is answered: these are, by failures.
        for (; waiting_.size() > queue_capacity(); waiting_.pop_front()) leave_out(waiting_.front()->header);
      });
    }
    bool is_awaited = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      is_awaited = newest_ != nullptr;
      if (is_awaited) overtaken_.push_back(newest_->header);
      newest_ = image;
    }
    // A task waits for whichever is the newest then.
    if (is_awaited) return statistics().count_input("color");
    push("color", Keep::kPinned, [this] { look_at_newest(); });
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    const bool has_pose = !frame->is_end && frame->T_odom_camera.is_finite();
    if (has_pose) up_->push(*frame);
    if (has_pose) size_px_ = {frame->camera.width, frame->camera.height};
    if (!parameters_.lockstep) roll_rad_.clear();
    // No image comes after the end.
    const ros::Time stamp = frame->is_end ? ros::TIME_MAX : frame->header.stamp;
    roll_rad_[stamp] = has_pose ? up_->roll_rad(frame->T_odom_camera.q) : 0.0;
    if (parameters_.lockstep) look_at_waiting();
    while (roll_rad_.size() > queue_capacity()) roll_rad_.erase(roll_rad_.begin());
  }

  /// Images whose frame has come, or a later one, so that none will.
  void look_at_waiting() {
    for (; !waiting_.empty(); waiting_.pop_front()) {
      const sensor_msgs::Image& image = *waiting_.front();
      const auto frame = roll_rad_.lower_bound(image.header.stamp);
      roll_rad_.erase(roll_rad_.begin(), frame);
      if (frame == roll_rad_.end()) return;
      if (frame->first == image.header.stamp) {
        look_at(image, frame->second);
      } else {
        leave_out(image.header);
      }
    }
  }

  void look_at_newest() {
    std::vector<std_msgs::Header> overtaken;
    sensor_msgs::ImageConstPtr newest;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      overtaken.swap(overtaken_);
      newest.swap(newest_);
    }
    for (const std_msgs::Header& header : overtaken) leave_out(header);
    if (newest) look_at(*newest, roll_rad_.empty() ? 0.0 : roll_rad_.begin()->second);
  }

  void look_at(const sensor_msgs::Image& image, double roll_rad) {
    if (!detector_->is_due(to_stamp_ns(image.header.stamp))) return leave_out(image.header);
    core::Result<std::vector<core::Detection>> found = detect(image, roll_rad);
    if (!found) {
      complain("unusable images", found.message());
      return leave_out(image.header);
    }
    publish<DetectionsMessage>(publisher_, image.header, {0, false, *std::move(found)});
    count_processed();
  }

  core::Result<std::vector<core::Detection>> detect(const sensor_msgs::Image& image, double roll_rad) {
    const core::Result<cv::Mat> pixels = to_mat(image, sensor_msgs::image_encodings::BGR8, "colour");
    if (!pixels) return pixels.error();
    if (size_px_ && *size_px_ != std::pair(pixels->cols, pixels->rows)) {
      return core::Error{"of " + std::to_string(pixels->cols) + " x " + std::to_string(pixels->rows) +
                         " px, but the calibration of the frames' camera is for " + std::to_string(size_px_->first) +
                         " x " + std::to_string(size_px_->second)};
    }
    return detector_->detect(*pixels, roll_rad);
  }

  void leave_out(const std_msgs::Header& header) {
    statistics().count(kLeftOut);
    publish<DetectionsMessage>(publisher_, header, {0, true, {}});
  }

  std::unique_ptr<core::ObjectDetector> detector_;
  ros::Publisher publisher_;
  image_transport::Subscriber subscriber_;
  std::unique_ptr<core::UpEstimator> up_;
  std::optional<std::pair<int, int>> size_px_;      ///< of the frames' camera
  std::deque<sensor_msgs::ImageConstPtr> waiting_;  ///< lockstep: for their frames
  std::map<ros::Time, double> roll_rad_;            ///< by stamp: of frames whose image may still come, or the last one
  std::mutex mutex_;                                ///< guards all below
  sensor_msgs::ImageConstPtr newest_;               ///< that nobody has looked at yet
  std::vector<std_msgs::Header> overtaken_;         ///< of images before it, in order of arrival
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::ObjectDetectorNodelet, nodelet::Nodelet)
