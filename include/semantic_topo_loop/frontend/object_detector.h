#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct ObjectDetectorOptions {
  std::string model;
  std::string names;
  std::string layout = "auto";
  int input_px = 0;
  double score = 0.25;
  double nms_iou = 0.5;
  double rate_hz = 0.0;
  std::string backend = "cpu";
  int threads = 0;

  void visit(OptionVisitor& visitor) {
    visitor.module("detector");
    visitor("model", model, any(), "ONNX file of a YOLOX, YOLOv5 or YOLOv8; empty: no detector");
    visitor("names", names, any(),
            "file with the model's class names, one a line, which are looked up in the class table; empty: the model's "
            "classes are those ids of the table");
    visitor("layout", layout, one_of({"auto", "yolox", "yolov5", "yolov8"}),
            "of the model's output; auto: by its shape");
    visitor(
        "input_px", input_px, not_negative(),
        "width and height of the model's input; 0: as the model declares it, or 416 or 640, the first that it takes");
    visitor.live("score", score, share(), "boxes of lower scores are left out");
    visitor.live("nms_iou", nms_iou, share(), "of two boxes of a class that overlap more the better one stays");
    visitor.live(
        "rate_hz", rate_hz, not_negative(),
        "most images looked at in a second of their stamps; 0: all, in real time as many as there is time for");
    visitor("backend", backend, one_of({"cpu", "cuda", "opencl"}), "what computes; OpenCV must have been built for it");
    visitor("threads", threads, not_negative(), "of OpenCV, in the whole process; 0: as many as it likes");
    visitor.require("input_px", input_px % 32 == 0, "a multiple of 32, the coarsest cell of the models");
  }
};

/// Finds objects in images by a neural network of the YOLO family, run by OpenCV's DNN. The same image gives the same
/// boxes. Not thread-safe.
class ObjectDetector {
 public:
  /// Reads the model and tries it on an empty image.
  /// @return an error that names the file, and shape or line, for a model that cannot be read or does not take the
  /// input, an output of no known layout or with values that are none of it, or names of another number than the
  /// model's classes
  static Result<std::unique_ptr<ObjectDetector>> load(const ObjectDetectorOptions& options, const ClassTable& classes);
  ~ObjectDetector();
  ObjectDetector(const ObjectDetector&) = delete;
  ObjectDetector& operator=(const ObjectDetector&) = delete;

  /// Which of the model's classes are left out, or may be others than they are taken for; empty if none.
  const std::string& warning() const;
  /// Whether an image is to be looked at: at most `rate_hz` a second are, whatever the camera's rate. Asked once an
  /// image, in order.
  bool is_due(std::int64_t stamp_ns);
  /// The next image is due: images begin anew.
  void restart();
  /// From the next image on. @param options those that it has, but for live ones
  void set_options(const ObjectDetectorOptions& options);
  /// @param color CV_8UC3 as BGR, or CV_8UC1
  /// @param roll_rad how far the camera is rolled, clockwise as it sees, since the networks are trained on upright
  /// images: beyond 20 deg they are given the image turned back. Each box found there stands for the ellipse in it,
  /// whose box in the image is returned
  /// @return boxes in pixels of the image, cut at its border, in order of falling score; without those whose name the
  /// class table does not have
  /// @return an error for an image of another type or an empty one
  Result<std::vector<Detection>> detect(const cv::Mat& color, double roll_rad = 0.0);

 private:
  class Impl;
  explicit ObjectDetector(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace semantic_topo_loop::core
