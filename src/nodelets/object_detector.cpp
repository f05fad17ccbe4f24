#include "semantic_topo_loop/frontend/object_detector.h"

#include <image_transport/image_transport.h>
#include <sensor_msgs/image_encodings.h>

#include <memory>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <utility>
#include <vector>

#include "ros/rgbd_images.h"
#include "ros/stage.h"

namespace semantic_topo_loop {

/// Looks for objects in the newest colour image, or in lockstep in each. Every image has its DetectionArray, in order;
/// those that there was no time for are unanswered.
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
    if (!start(1)) return;
    auto detector = core::ObjectDetector::load(options_.detector, *classes());
    if (!detector) {
      fail(detector.message());
      return;
    }
    detector_ = *std::move(detector);
    statistics().count(kLeftOut, 0);
    publisher_ = advertise<DetectionsMessage>("detections_in");
    look_at_newest_ = once_in_queue([this] { look_at_newest(); });
    image_transport::ImageTransport transport(subscriber_node());
    constexpr std::uint32_t kImages = 10;  // that wait for the callback, which is short
    subscriber_ = transport.subscribe("color", kImages, &ObjectDetectorNodelet::on_image, this,
                                      {parameters_.color_transport, {}, getPrivateNodeHandle(), "color_transport"});
    follow_sessions();
  }

  void on_image(const sensor_msgs::ImageConstPtr& image) {
    if (parameters_.lockstep) return push("color", Keep::kAlways, [this, image] { look_at(*image); });
    statistics().count_input("color");
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (newest_) overtaken_.push_back(newest_->header);
      newest_ = image;
    }
    look_at_newest_();
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
    if (newest) look_at(*newest);
  }

  void look_at(const sensor_msgs::Image& image) {
    if (!detector_->is_due(to_stamp_ns(image.header.stamp))) return leave_out(image.header);
    core::Result<std::vector<core::Detection>> found = detect(image);
    if (!found) {
      complain("unusable images", found.message());
      return leave_out(image.header);
    }
    publish<DetectionsMessage>(publisher_, image.header, {0, false, *std::move(found)});
    count_processed();
  }

  core::Result<std::vector<core::Detection>> detect(const sensor_msgs::Image& image) {
    const core::Result<cv::Mat> pixels = to_mat(image, sensor_msgs::image_encodings::BGR8, "colour");
    if (!pixels) return pixels.error();
    return detector_->detect(*pixels);
  }

  void leave_out(const std_msgs::Header& header) {
    statistics().count(kLeftOut);
    publish<DetectionsMessage>(publisher_, header, {0, true, {}});
  }

  std::unique_ptr<core::ObjectDetector> detector_;
  ros::Publisher publisher_;
  image_transport::Subscriber subscriber_;
  std::function<void()> look_at_newest_;
  std::mutex mutex_;                         ///< guards all below
  sensor_msgs::ImageConstPtr newest_;        ///< that nobody has looked at yet
  std::vector<std_msgs::Header> overtaken_;  ///< of images before it, in order of arrival
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::ObjectDetectorNodelet, nodelet::Nodelet)
