#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "frontend/yolo_output.h"
#include "support/onnx_file.h"

namespace semantic_topo_loop::core::testing {

/// A network that finds rectangles of pure red, green and blue (its classes 0, 1, 2), with the input and the output of
/// a YOLO export. A row's box is found where its cell lies within the rectangle, by how far that goes on to all sides:
/// there may be only one in a row or column of the image.
struct TinyYolo {
  YoloLayout layout = YoloLayout::kYolox;
  int input_px = 128;
  std::vector<int> strides = {8, 16, 32};
  bool is_as_exported = false;  ///< with what older versions of OpenCV do not run (scripts/prepare_model)

  std::string onnx() const {
    OnnxGraph graph;
    // Colours are steep, so that edges which were scaled stay where they are.
    const bool is_yolox = layout == YoloLayout::kYolox, is_yolov8 = layout == YoloLayout::kYolov8;
    const double steep = is_yolox ? kSteep / 255.0 : kSteep;
    std::vector<std::vector<double>> colors(kClasses, {-0.5 * steep, -0.5 * steep, -0.5 * steep, -0.5 * kSteep});
    for (std::size_t i = 0; i < kClasses; ++i) colors[i][is_yolox ? kClasses - 1 - i : i] = steep;
    const std::string classes =
        graph.add("Sigmoid", {graph.linear(is_as_exported ? sliced(&graph) : "images", colors)});

    int rows = 0;
    std::vector<std::string> scales;
    for (const int stride : strides) {
      const int side = input_px / stride, cells = side * side;
      const std::string share =
          graph.add("AveragePool", {classes},
                    onnx_attribute("kernel_shape", {stride, stride}) + onnx_attribute("strides", {stride, stride}));
      // Channels: cells that the rectangle goes on to the left, right, up and down; share of the cell by class.
      const std::string features =
          graph.add("Concat", {reach(&graph, share, side, true), reach(&graph, share, side, false), share}, kByChannel);
      const std::string boxes =
          is_yolox ? boxes_in_cells(&graph, features, stride) : boxes_in_pixels(&graph, features, stride);
      std::string row = graph.add("Concat", {boxes, scores(&graph, features)}, kByChannel);
      if (!is_yolox) row = graph.add("Add", {row, corners(&graph, stride)});
      const int values = row_size();
      if (layout == YoloLayout::kYolov5) {  // three anchors a cell
        const std::string anchors =
            graph.reshape(graph.add("Concat", {row, row, row}, kByChannel), {1, 3, values, side, side});
        const std::string last = graph.add("Transpose", {anchors}, onnx_attribute("perm", {0, 1, 3, 4, 2}));
        scales.push_back(graph.reshape(last, {1, 3 * cells, values}));
      } else {
        scales.push_back(graph.reshape(row, {1, values, cells}));
      }
      rows += layout == YoloLayout::kYolov5 ? 3 * cells : cells;
    }
    std::string output = graph.add("Concat", scales, onnx_attribute("axis", layout == YoloLayout::kYolov5 ? 1 : 2));
    if (is_yolox) output = graph.add("Transpose", {output}, onnx_attribute("perm", {0, 2, 1}));
    if (is_as_exported) output = split(&graph, output, rows);
    return graph.model({1, kClasses, input_px, input_px}, output,
                       is_yolov8 ? std::vector{1, row_size(), rows} : std::vector{1, rows, row_size()},
                       !is_as_exported                 ? ""
                       : layout == YoloLayout::kYolov5 ? "['chair', 'unheard of', 'book']"  // as older exporters do
                                                       : "{0: 'chair', 1: 'unheard of', 2: 'book'}");
  }

 private:
  static constexpr int kClasses = 3;
  static constexpr double kSteep = 20.0;  ///< of a logistic function that decides
  inline static const std::string kByChannel = onnx_attribute("axis", 1);

  int row_size() const { return (layout == YoloLayout::kYolov8 ? 4 : 5) + kClasses; }

  /// The image, of slices with steps.
  std::string sliced(OnnxGraph* graph) const {
    std::vector<std::string> halves;
    const auto number = [graph](std::int64_t value) { return graph->constant<std::int64_t>({1}, {value}); };
    constexpr std::int64_t kToTheEnd = std::numeric_limits<std::int64_t>::max();
    for (const std::int64_t start : {0, 1}) {
      const std::string half = graph->add("Slice", {"images", number(start), number(kToTheEnd), number(3), number(2)});
      halves.push_back(graph->reshape(half, {1, kClasses, input_px, input_px / 2, 1}));
    }
    return graph->reshape(graph->add("Concat", halves, onnx_attribute("axis", 4)), {1, kClasses, input_px, input_px});
  }

  /// The output, of parts whose sizes are an input; of boxes that are taken from a constant, times one of a lower rank.
  std::string split(OnnxGraph* graph, const std::string& output, int rows) const {
    const bool is_yolov8 = layout == YoloLayout::kYolov8;
    const std::string axis = onnx_attribute("axis", is_yolov8 ? 1 : 2);
    const std::vector<std::string> parts =
        graph->split(output, graph->constant<std::int64_t>({2}, {4, row_size() - 4}), axis);
    const std::vector<int> shape = is_yolov8 ? std::vector{1, 4, rows} : std::vector{1, rows, 4};
    const std::string ten = graph->constant(shape, std::vector<float>(static_cast<std::size_t>(4 * rows), 10.0F));
    const std::string boxes = graph->add("Sub", {ten, graph->add("Sub", {ten, parts[0]})});
    const std::string one =
        graph->constant({1, shape[2]}, std::vector<float>(static_cast<std::size_t>(shape[2]), 1.0F));
    return graph->add("Concat", {graph->add("Mul", {boxes, one}), parts[1]}, axis);
  }

  /// How much lies before and behind each cell, with half of its own, on its line.
  static std::string reach(OnnxGraph* graph, const std::string& share, int side, bool along_x) {
    const int kernel = 2 * side - 1;
    std::vector<float> weights;
    for (const bool before : {true, false}) {
      for (int color = 0; color < kClasses; ++color) {
        for (int k = 0; k < kernel; ++k) {
          const int offset = before ? side - 1 - k : k - (side - 1);
          weights.push_back(offset > 0 ? 1.0F : offset == 0 ? 0.5F : 0.0F);
        }
      }
    }
    const std::vector<int> shape = along_x ? std::vector{1, kernel} : std::vector{kernel, 1};
    const int pad_x = along_x ? side - 1 : 0, pad_y = along_x ? 0 : side - 1;
    return graph->add("Conv", {share, graph->constant({2, kClasses, shape[0], shape[1]}, weights)},
                      onnx_attribute("kernel_shape", shape) + onnx_attribute("pads", {pad_y, pad_x, pad_y, pad_x}));
  }

  /// A cell that is covered in full has a score near 1, one of three quarters 0.5.
  std::string scores(OnnxGraph* graph, const std::string& features) const {
    const double s = kSteep, half = -0.5 * s, most = -0.75 * s;
    const std::vector<std::vector<double>> alone = {
        {0, 0, 0, 0, s, 0, 0, most}, {0, 0, 0, 0, 0, s, 0, most}, {0, 0, 0, 0, 0, 0, s, most}};
    const std::vector<std::vector<double>> after_objectness = {{0, 0, 0, 0, s, s, s, most},
                                                               {0, 0, 0, 0, s, 0, 0, half},
                                                               {0, 0, 0, 0, 0, s, 0, half},
                                                               {0, 0, 0, 0, 0, 0, s, half}};
    const bool is_yolov8 = layout == YoloLayout::kYolov8;
    return graph->add("Sigmoid", {graph->linear(features, is_yolov8 ? alone : after_objectness)});
  }

  /// Relative to the cell's corner.
  static std::string boxes_in_pixels(OnnxGraph* graph, const std::string& features, int stride) {
    const double s = stride, h = 0.5 * s;
    return graph->linear(
        features,
        {{-h, h, 0, 0, 0, 0, 0, h}, {0, 0, -h, h, 0, 0, 0, h}, {s, s, 0, 0, 0, 0, 0, 0}, {0, 0, s, s, 0, 0, 0, 0}});
  }

  /// Where the cells' corners are, in pixels, to be added to what else there is.
  std::string corners(OnnxGraph* graph, int stride) const {
    const int side = input_px / stride, cells = side * side;
    std::vector<float> values(static_cast<std::size_t>(row_size() * cells), 0.0F);
    for (int i = 0; i < cells; ++i) {
      values[static_cast<std::size_t>(i)] = static_cast<float>(stride * (i % side));
      values[static_cast<std::size_t>(cells + i)] = static_cast<float>(stride * (i / side));
    }
    return graph->constant({1, row_size(), side, side}, values);
  }

  std::string boxes_in_cells(OnnxGraph* graph, const std::string& features, int stride) const {
    const std::string centers =
        graph->linear(features, {{-0.5, 0.5, 0, 0, 0, 0, 0, 0.5}, {0, 0, -0.5, 0.5, 0, 0, 0, 0.5}});
    // The logarithm of a size in whole pixels, as a sum of steps.
    std::vector<std::vector<double>> steps,
        sums(2, std::vector<double>(static_cast<std::size_t>(2 * input_px - 1), 0.0));
    for (int px = 1; px < input_px; ++px) {
      const double w = kSteep * stride, bias = -kSteep * (px + 0.5), rise = std::log((px + 1.0) / px);
      sums[0][steps.size()] = sums[1][steps.size() + 1] = rise;
      steps.push_back({w, w, 0, 0, 0, 0, 0, bias});
      steps.push_back({0, 0, w, w, 0, 0, 0, bias});
    }
    for (std::vector<double>& sum : sums) sum.back() = -std::log(stride);
    const std::string sizes = graph->linear(graph->add("Sigmoid", {graph->linear(features, steps)}), sums);
    return graph->add("Concat", {centers, sizes}, kByChannel);
  }
};

}  // namespace semantic_topo_loop::core::testing
