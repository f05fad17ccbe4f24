#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <string>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// How a depth image is read.
struct DepthOptions {
  double scale = 1000.0;
  std::string invalid_values = "0 65535";
  double max_m = 8.0;
  double scale_correction = 1.0;
  std::string color_from_depth;
  std::string intrinsics;

  void visit(OptionVisitor& visitor) {
    visitor.module("depth");
    visitor("scale", scale, positive(), "16UC1: units a metre; 1000 for millimetres, 5000 in TUM's PNG files");
    visitor("invalid_values", invalid_values, {are_raw_values, "whole numbers in [0, 65535]"},
            "16UC1: values that mean no depth, apart from each other by blanks");
    visitor("max_m", max_m, positive(), "farther depth is left out: its noise grows with the square");
    visitor("scale_correction", scale_correction, positive(), "factor on every depth; TUM's freiburg2 needs 0.96");
    visitor("color_from_depth", color_from_depth,
            {is_pose_or_empty, "empty or 'x y z qx qy qz qw' with a unit quaternion"},
            "T_color_depth, 'x y z qx qy qz qw', m, of depth that is not registered to the color camera; else empty");
    visitor("intrinsics", intrinsics, {is_pinhole_or_empty, "empty or 'fx fy cx cy' with fx, fy > 0"},
            "'fx fy cx cy', px, of the depth camera where color_from_depth is given; empty: the color camera's");
    visitor.require("intrinsics", is_blank(intrinsics) || !is_blank(color_from_depth),
                    "empty where depth.color_from_depth is");
  }
  static bool are_raw_values(const std::string& text);
  static bool is_pose_or_empty(const std::string& text);
  static bool is_pinhole_or_empty(const std::string& text);
  static bool is_blank(const std::string& text);
};

/// Where the depth of images lies, by some of its pixels: a wrong scale puts it out of reach, or before one's nose.
struct DepthRange {
  std::int64_t pixels = 0;    ///< with a depth
  std::int64_t far = 0;       ///< of these, beyond depth.max_m and therefore left out
  std::int64_t near = 0;      ///< of these, nearer than 0.3 m, where few depth cameras measure
  bool is_in_metres = false;  ///< 32FC1, which depth.scale does not concern

  void add(const DepthRange& other);
  /// Names the share of depth that is out of reach and the parameters to look at; empty if there is nothing unusual.
  std::string warning(const DepthOptions& options) const;
};

/// An image with its depth, as the front end works on it.
struct RgbdImage {
  std::int64_t stamp_ns = 0;
  cv::Mat gray;     ///< CV_8UC1, raw (distorted) pixels
  cv::Mat depth_m;  ///< CV_32FC1 of the same size: m along the color camera's z axis; 0 where there is none
  DepthRange depth_range;
};

/// Brings images as cameras send them into the front end's form.
/// @param color CV_8UC1, or CV_8UC3 as BGR   @param depth CV_16UC1 in units of `scale`, or CV_32FC1 in metres, NaN or
/// <= 0 where there is none   @param camera the color camera
/// @return an error that names stamp, field and value for an empty image, one of another size than the camera's, or one
/// of another type
Result<RgbdImage> make_rgbd_image(std::int64_t stamp_ns, const cv::Mat& color, const cv::Mat& depth,
                                  const Camera& camera, const DepthOptions& options);

}  // namespace semantic_topo_loop::core
