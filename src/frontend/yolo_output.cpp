#include "frontend/yolo_output.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <utility>

namespace semantic_topo_loop::core {
namespace {

constexpr std::array<int, 3> kStrides = {8, 16, 32};
constexpr std::array<const char*, 3> kNames = {"yolox", "yolov5", "yolov8"};  ///< in the order of YoloLayout

/// A cell of the grid over the input.
struct Cell {
  int x, y, stride;
};

std::vector<Cell> grid(int input_px) {
  std::vector<Cell> cells;
  for (const int stride : kStrides) {
    for (int y = 0; y < input_px / stride; ++y) {
      for (int x = 0; x < input_px / stride; ++x) cells.push_back({x, y, stride});
    }
  }
  return cells;
}

bool fits(const cv::Mat& output, int cells, YoloLayout layout) {
  if (output.dims != 3 || output.size[0] != 1 || output.type() != CV_32FC1) return false;
  switch (layout) {
    case YoloLayout::kYolox:
      return output.size[1] == cells && output.size[2] > 5;
    case YoloLayout::kYolov5:
      return output.size[1] == 3 * cells && output.size[2] > 5;
    case YoloLayout::kYolov8:
      return output.size[2] == cells && output.size[1] > 4;
  }
  return false;
}

/// One row a candidate, by layout.
cv::Mat rows_of(const cv::Mat& output, YoloLayout layout) {
  const cv::Mat rows(output.size[1], output.size[2], CV_32FC1, const_cast<float*>(output.ptr<float>()));
  return layout == YoloLayout::kYolov8 ? cv::Mat(rows.t()) : rows;
}

}  // namespace

std::string shape_of(const cv::Mat& output) {
  std::string text;
  for (int i = 0; i < output.dims; ++i) text += (i == 0 ? "" : " x ") + std::to_string(output.size[i]);
  return text;
}

Result<YoloLayout> find_yolo_layout(const cv::Mat& output, int input_px, const std::string& stated) {
  const int cells = static_cast<int>(grid(input_px).size());
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    const auto layout = static_cast<YoloLayout>(i);
    if ((stated == "auto" || stated == kNames[i]) && fits(output, cells, layout)) return layout;
  }
  return Error{"the output is " + shape_of(output) + ", which is not " +
               (stated == "auto" ? "the shape of a YOLOX, YOLOv5 or YOLOv8" : "that of " + stated)};
}

int yolo_class_count(const cv::Mat& output, YoloLayout layout) {
  return layout == YoloLayout::kYolov8 ? output.size[1] - 4 : output.size[2] - 5;
}

Status check_yolo_values(const cv::Mat& output, YoloLayout layout) {
  constexpr double kRounding = 1e-3, kMostLogSize = 10.0;  // in strides: 170,000 px and more
  const cv::Mat rows = rows_of(output, layout);
  const auto range = [&rows](int first, int end) {
    double low = 0.0, high = 0.0;
    cv::minMaxLoc(rows.colRange(first, end), &low, &high);
    return std::pair(low, high);
  };
  const auto [low, high] = range(4, rows.cols);
  if (low < -kRounding || high > 1.0 + kRounding) {
    std::ostringstream text;
    text << "the output " << shape_of(output) << " has scores from " << low << " to " << high
         << ", not from 0 to 1: it is of another network, or of one that gives more than boxes";
    return Error{text.str()};
  }
  if (layout == YoloLayout::kYolox && range(2, 4).second > kMostLogSize) {
    return Error{"the output " + shape_of(output) +
                 " has boxes in pixels, a YOLOX's are in cells: export it without decoding"};
  }
  return {};
}

std::vector<Detection> read_yolo(const cv::Mat& output, YoloLayout layout, int input_px, double min_score) {
  const bool is_yolov8 = layout == YoloLayout::kYolov8, is_yolox = layout == YoloLayout::kYolox;
  const cv::Mat rows = rows_of(output, layout);
  const std::vector<Cell> cells = is_yolox ? grid(input_px) : std::vector<Cell>();
  const int first_score = is_yolov8 ? 4 : 5;
  std::vector<Detection> detections;
  for (int i = 0; i < rows.rows; ++i) {
    const float* const row = rows.ptr<float>(i);
    const float* const best = std::max_element(row + first_score, row + rows.cols);
    const double score = static_cast<double>(*best) * (is_yolov8 ? 1.0 : static_cast<double>(row[4]));
    if (!(score >= min_score)) continue;
    double x = static_cast<double>(row[0]), y = static_cast<double>(row[1]);
    double width = static_cast<double>(row[2]), height = static_cast<double>(row[3]);
    if (is_yolox) {
      const Cell& cell = cells[static_cast<std::size_t>(i)];
      x = (x + cell.x) * cell.stride;
      y = (y + cell.y) * cell.stride;
      width = std::exp(width) * cell.stride;
      height = std::exp(height) * cell.stride;
    }
    detections.push_back({static_cast<int>(best - row) - first_score,
                          std::min(score, 1.0),
                          {x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height}});
  }
  return detections;
}

std::vector<Detection> suppress_overlapping(std::vector<Detection> detections, double max_iou) {
  std::stable_sort(detections.begin(), detections.end(),
                   [](const Detection& a, const Detection& b) { return a.score > b.score; });
  std::vector<Detection> kept;
  for (const Detection& detection : detections) {
    const auto covers = [&](const Detection& better) {
      return better.class_id == detection.class_id && iou(better.box, detection.box) > max_iou;
    };
    if (std::none_of(kept.begin(), kept.end(), covers)) kept.push_back(detection);
  }
  return kept;
}

}  // namespace semantic_topo_loop::core
