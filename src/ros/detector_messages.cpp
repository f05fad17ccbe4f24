#include "ros/detector_messages.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "ros/conversions.h"
#include "semantic_topo_loop/ros/messages.h"
#ifdef STL_HAS_VISION_MSGS
#include <vision_msgs/Detection2DArray.h>
#endif
#ifdef STL_HAS_DARKNET_ROS_MSGS
#include <darknet_ros_msgs/BoundingBoxes.h>
#endif

namespace semantic_topo_loop {
namespace {

using core::DetectionProblem;

core::DetectionFrame convert(const DetectionsMessage& message, const core::ClassTable& /*classes*/,
                             const core::OnLeftOut& /*on_left_out*/) {
  return {to_stamp_ns(message.header.stamp), message.detections, message.unanswered};
}

#ifdef STL_HAS_VISION_MSGS
/// The upright rectangle around a turned one. A negative size stays negative, so that the box is left out.
core::Box to_box(const vision_msgs::BoundingBox2D& box) {
  const double c = std::abs(std::cos(box.center.theta)), s = std::abs(std::sin(box.center.theta));
  const double half_width = 0.5 * (c * box.size_x + s * box.size_y);
  const double half_height = 0.5 * (s * box.size_x + c * box.size_y);
  return {box.center.x - half_width, box.center.y - half_height, box.center.x + half_width, box.center.y + half_height};
}

/// Of the image, where the message says it: detectors stamp the array by their own clock, too.
ros::Time image_stamp(const vision_msgs::Detection2DArray& message) {
  if (message.detections.empty()) return message.header.stamp;
  const vision_msgs::Detection2D& first = message.detections.front();
  if (!first.source_img.header.stamp.isZero()) return first.source_img.header.stamp;
  return first.header.stamp.isZero() ? message.header.stamp : first.header.stamp;
}

core::DetectionFrame convert(const vision_msgs::Detection2DArray& message, const core::ClassTable& /*classes*/,
                             const core::OnLeftOut& on_left_out) {
  core::DetectionFrame frame{to_stamp_ns(image_stamp(message)), {}};
  for (std::size_t i = 0; i < message.detections.size(); ++i) {
    const auto& results = message.detections[i].results;
    const auto best = std::max_element(results.begin(), results.end(),
                                       [](const auto& a, const auto& b) { return a.score < b.score; });
    if (best == results.end()) {
      on_left_out(i, DetectionProblem::kUnknownClass, "results is empty");
      continue;
    }
    using Limits = std::numeric_limits<int>;  // beyond lies no id of a table
    const auto id =
        std::clamp(static_cast<std::int64_t>(best->id), std::int64_t{Limits::min()}, std::int64_t{Limits::max()});
    frame.detections.push_back({static_cast<int>(id), best->score, to_box(message.detections[i].bbox)});
  }
  return frame;
}
#endif

#ifdef STL_HAS_DARKNET_ROS_MSGS
/// By name: ids count the classes of the network, which may be some of the table's.
core::DetectionFrame convert(const darknet_ros_msgs::BoundingBoxes& message, const core::ClassTable& classes,
                             const core::OnLeftOut& on_left_out) {
  core::DetectionFrame frame{to_stamp_ns(message.image_header.stamp), {}};
  for (std::size_t i = 0; i < message.bounding_boxes.size(); ++i) {
    const darknet_ros_msgs::BoundingBox& box = message.bounding_boxes[i];
    const core::ObjectClass* found = classes.find(box.Class);
    if (found == nullptr) {
      on_left_out(i, DetectionProblem::kUnknownClass, "class '" + box.Class + "'");
      continue;
    }
    frame.detections.push_back({found->id,
                                box.probability,
                                {static_cast<double>(box.xmin), static_cast<double>(box.ymin),
                                 static_cast<double>(box.xmax), static_cast<double>(box.ymax)}});
  }
  return frame;
}
#endif

/// Tries one type after the other.
template <class... Messages>
struct Reader {
  static core::Result<core::DetectionFrame> read(const DetectorMessage& message, const core::ClassTable& classes,
                                                 const core::OnLeftOut& on_left_out) {
    std::optional<core::DetectionFrame> frame;
    std::string known;
    const auto attempt = [&](auto* type) {
      using Message = std::remove_pointer_t<decltype(type)>;
      const std::string name = ros::message_traits::datatype<Message>();
      known += (known.empty() ? "" : ", ") + name;
      if (name == message.getDataType()) frame = convert(*message.instantiate<Message>(), classes, on_left_out);
    };
    try {
      (attempt(static_cast<Messages*>(nullptr)), ...);
    } catch (const ros::Exception& exception) {  // another version's sum, or bytes that end too early
      return core::Error{message.getDataType() + ": " + exception.what()};
    }
    if (frame && frame->stamp_ns == 0) return core::Error{message.getDataType() + ": header.stamp is 0"};
    if (frame) return *std::move(frame);
    return core::Error{"type " + message.getDataType() + ", but this build reads " + known};
  }
};

}  // namespace

core::Result<core::DetectionFrame> read_detector_message(const DetectorMessage& message,
                                                         const core::ClassTable& classes,
                                                         const core::OnLeftOut& on_left_out) {
  return Reader<
#ifdef STL_HAS_VISION_MSGS
      vision_msgs::Detection2DArray,
#endif
#ifdef STL_HAS_DARKNET_ROS_MSGS
      darknet_ros_msgs::BoundingBoxes,
#endif
      DetectionsMessage>::read(message, classes, on_left_out);
}

}  // namespace semantic_topo_loop
