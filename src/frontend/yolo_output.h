#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// How the rows of a network's output are to be read. `cells` are those of strides 8, 16 and 32 on the input.
enum class YoloLayout {
  kYolox,   ///< 1 x cells x (5 + classes): centre in its cell, log size in strides, objectness, scores
  kYolov5,  ///< 1 x 3 cells x (5 + classes): centre and size in pixels, objectness, scores
  kYolov8,  ///< 1 x (4 + classes) x cells: centre and size in pixels, scores
};

/// Such as "1 x 3549 x 85".
std::string shape_of(const cv::Mat& output);

/// The layout that has the output's shape.
/// @param input_px side of the input   @param stated "yolox", "yolov5", "yolov8", or "auto" for whichever fits
/// @return an error that names the shape if it has not
Result<YoloLayout> find_yolo_layout(const cv::Mat& output, int input_px, const std::string& stated);
/// @param output of any image   @return an error if it has the layout's shape, but cannot be its values
Status check_yolo_values(const cv::Mat& output, YoloLayout layout);
int yolo_class_count(const cv::Mat& output, YoloLayout layout);

/// The best class of each row whose score is not below `min_score`.
/// @param output CV_32FC1 of the layout's shape
/// @return boxes in pixels of the input; `class_id` counts the model's classes from 0
std::vector<Detection> read_yolo(const cv::Mat& output, YoloLayout layout, int input_px, double min_score);

/// Class by class the boxes that no better one overlaps by more, in order of falling score; the first of equals is the
/// better one.
std::vector<Detection> suppress_overlapping(std::vector<Detection> detections, double max_iou);

}  // namespace semantic_topo_loop::core
