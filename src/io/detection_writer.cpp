#include "semantic_topo_loop/io/detection_writer.h"

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kCoordinateDecimals = 4;
constexpr int kScoreDecimals = 6;

std::string json_box(const Detection& detection) {
  std::string text = "{\"category_id\": " + std::to_string(detection.class_id) +
                     ", \"detection_score\": " + format_fixed(detection.score, kScoreDecimals) + ", \"bbox\": [";
  const Vec4 edges = detection.box.edges();
  for (int i = 0; i < edges.size(); ++i) text += (i == 0 ? "" : ", ") + format_fixed(edges[i], kCoordinateDecimals);
  return text + "]}";
}

std::string json_frame(const DetectionFrame& frame) {
  std::string text = "{\"file_name\": \"" + format_stamp(frame.stamp_ns) + ".png\", \"detections\": [";
  for (std::size_t i = 0; i < frame.detections.size(); ++i) {
    text += (i == 0 ? "" : ", ") + json_box(frame.detections[i]);
  }
  return text + "]}";
}

std::string yolo_line(const Detection& detection) {
  std::string text = std::to_string(detection.class_id);
  const Box& box = detection.box;
  for (const double value : {box.x1, box.y1, box.width(), box.height()}) {
    text += ' ' + format_fixed(value, kCoordinateDecimals);
  }
  return text + ' ' + format_fixed(detection.score, kScoreDecimals) + '\n';
}

}  // namespace

bool write_detections_json(const std::string& path, const std::vector<DetectionFrame>& frames, std::string* error) {
  std::string text = "[";
  for (std::size_t i = 0; i < frames.size(); ++i) text += (i == 0 ? "" : ",\n") + json_frame(frames[i]);
  return write_text_file(path, text + "]\n", error);
}

bool write_detections_yolo(const std::string& directory, const std::vector<DetectionFrame>& frames,
                           std::string* error) {
  if (!make_directory(directory, error)) return false;
  for (const DetectionFrame& frame : frames) {
    std::string text;
    for (const Detection& detection : frame.detections) text += yolo_line(detection);
    if (!write_text_file(directory + "/" + format_stamp(frame.stamp_ns) + ".txt", text, error)) return false;
  }
  return true;
}

}  // namespace semantic_topo_loop::core
