#include "semantic_topo_loop/frontend/rgbd_image.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "semantic_topo_loop/types/text.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {
namespace {

/// The numbers of a text, or nullopt if something else is in it.
std::optional<std::vector<double>> numbers(const std::string& text) {
  std::vector<double> values;
  for (const std::string_view field : split_blanks(text)) {
    const std::optional<double> value = parse_double(field);
    if (!value || !std::isfinite(*value)) return std::nullopt;
    values.push_back(*value);
  }
  return values;
}

SE3 parse_pose(const std::vector<double>& v) {
  return {Quaternion(v[6], v[3], v[4], v[5]).normalized(), Vec3(v[0], v[1], v[2])};
}

constexpr float kNear_m = 0.3F;  ///< few depth cameras measure what is nearer: Kinects begin at 0.4 m
constexpr int kRangeStride_px = 8;

template <class Raw>
void multiply(const cv::Mat& raw, double factor, cv::Mat* product) {
  for (int v = 0; v < raw.rows; ++v) {
    const Raw* from = raw.ptr<Raw>(v);
    float* to = product->ptr<float>(v);
    for (int u = 0; u < raw.cols; ++u) to[u] = static_cast<float>(factor * from[u]);
  }
}

/// By every kRangeStride_px-th pixel of every such row, 4800 of a 640 x 480 image.
DepthRange range_of(const cv::Mat& depth_m, float max_m) {
  DepthRange range;
  for (int v = 0; v < depth_m.rows; v += kRangeStride_px) {
    for (int u = 0; u < depth_m.cols; u += kRangeStride_px) {
      const float z_m = depth_m.at<float>(v, u);
      if (!(z_m > 0.0F) || !std::isfinite(z_m)) continue;
      ++range.pixels;
      if (z_m > max_m) ++range.far;
      if (z_m < kNear_m) ++range.near;
    }
  }
  return range;
}

/// The depth image in metres, 0 where there is none, in its own pixels.
cv::Mat to_metres(const cv::Mat& depth, const DepthOptions& options, DepthRange* range) {
  const auto max_m = static_cast<float>(options.max_m);
  cv::Mat metres(depth.size(), CV_32FC1);
  if (depth.type() == CV_32FC1) {
    multiply<float>(depth, options.scale_correction, &metres);
  } else {
    multiply<std::uint16_t>(depth, options.scale_correction / options.scale, &metres);
    for (const double value : numbers(options.invalid_values).value_or(std::vector<double>())) {
      if (value > 0.0) metres.setTo(0.0, depth == value);
    }
  }
  *range = range_of(metres, max_m);
  range->is_in_metres = depth.type() == CV_32FC1;
  for (int v = 0; v < metres.rows; ++v) {
    float* row = metres.ptr<float>(v);
    for (int u = 0; u < metres.cols; ++u) row[u] = row[u] > 0.0F && row[u] <= max_m ? row[u] : 0.0F;  // false for NaN
  }
  return metres;
}

/// Depth seen by another camera, as the color camera would see it: nearest surface first, and of a surface the value
/// that lies nearest to the pixel; the nearest of all is too near. Each value is drawn on so many pixels around its
/// place, four or more, that no holes open between neighbours.
cv::Mat registered(const cv::Mat& depth_m, const Camera& color, const Camera& depth, const SE3& T_color_depth) {
  constexpr double kSurfaceShare = 0.03;  // depths that differ by less are of one: noise, and slope over a pixel
  cv::Mat result = cv::Mat::zeros(color.height, color.width, CV_32FC1);
  cv::Mat_<float> off_px(color.height, color.width, 0.0F);  ///< squared distance of the value from its pixel
  const int wide = std::max(2, static_cast<int>(color.fx / depth.fx) + 1);
  const int high = std::max(2, static_cast<int>(color.fy / depth.fy) + 1);
  for (int v = 0; v < depth_m.rows; ++v) {
    for (int u = 0; u < depth_m.cols; ++u) {
      const float z_m = depth_m.at<float>(v, u);
      if (z_m <= 0.0F) continue;
      const Vec3 p = T_color_depth * Vec3(z_m * depth.ray(Vec2(u, v)));
      if (p.z() <= 0.0) continue;
      const Vec2 pixel = color.distort(color.pixel(p));
      if (!(pixel.x() > -1.0 && pixel.y() > -1.0 && pixel.x() < color.width && pixel.y() < color.height)) continue;
      const int left = static_cast<int>(std::floor(pixel.x())) - (wide / 2 - 1);
      const int top = static_cast<int>(std::floor(pixel.y())) - (high / 2 - 1);
      for (int y = std::max(top, 0); y < std::min(top + high, color.height); ++y) {
        for (int x = std::max(left, 0); x < std::min(left + wide, color.width); ++x) {
          float& there = result.at<float>(y, x);
          const auto off = static_cast<float>((pixel - Vec2(x, y)).squaredNorm());
          const double step = p.z() - there;
          const bool is_of_it = std::abs(step) < kSurfaceShare * there;
          if (there > 0.0F && (is_of_it ? off >= off_px(y, x) : step > 0.0)) continue;
          there = static_cast<float>(p.z());
          off_px(y, x) = off;
        }
      }
    }
  }
  return result;
}

std::string describe(const char* field, const cv::Mat& image) {
  return std::string(field) + " image of " + std::to_string(image.cols) + " x " + std::to_string(image.rows) +
         " pixels of OpenCV type " + std::to_string(image.type());
}

}  // namespace

void DepthRange::add(const DepthRange& other) {
  pixels += other.pixels;
  far += other.far;
  near += other.near;
  is_in_metres = other.is_in_metres;
}

std::string DepthRange::warning(const DepthOptions& options) const {
  constexpr std::int64_t kMinPixels = 40'000;  // of about ten images
  constexpr double kMostShare = 0.2;           // a hall's end or a hand before the camera are less
  if (pixels < kMinPixels) return "";
  const double all = static_cast<double>(pixels);
  const double far_share = static_cast<double>(far) / all, near_share = static_cast<double>(near) / all;
  std::ostringstream text;
  if (far_share > kMostShare) {
    text << std::lround(100.0 * far_share) << " % of the depth lies beyond depth.max_m = " << options.max_m
         << " m and is left out";
  } else if (near_share > kMostShare) {
    text << std::lround(100.0 * near_share) << " % of the depth is nearer than " << kNear_m
         << " m, where few depth cameras measure";
  } else {
    return "";
  }
  if (is_in_metres) {
    text << ": are the 32FC1 images in metres (depth.scale_correction = " << options.scale_correction << ")?";
  } else {
    text << ": is depth.scale = " << options.scale << " right (1000 for millimetres, 5000 in TUM's PNG files)?";
  }
  return text.str();
}

bool DepthOptions::are_raw_values(const std::string& text) {
  const std::optional<std::vector<double>> values = numbers(text);
  return values && std::all_of(values->begin(), values->end(), [](double value) {
           return value >= 0.0 && value <= 65535.0 && value == std::floor(value);
         });
}

bool DepthOptions::is_pose_or_empty(const std::string& text) {
  const std::optional<std::vector<double>> pose = numbers(text);
  return pose && (pose->empty() || (pose->size() == 7 && is_rotation(Quaternion(pose->data() + 3))));
}

bool DepthOptions::is_pinhole_or_empty(const std::string& text) {
  const std::optional<std::vector<double>> pinhole = numbers(text);
  return pinhole && (pinhole->empty() || (pinhole->size() == 4 && (*pinhole)[0] > 0.0 && (*pinhole)[1] > 0.0));
}

bool DepthOptions::is_blank(const std::string& text) { return numbers(text).value_or(std::vector<double>()).empty(); }

Result<RgbdImage> make_rgbd_image(std::int64_t stamp_ns, const cv::Mat& color, const cv::Mat& depth,
                                  const Camera& camera, const DepthOptions& options) {
  const auto fail = [stamp_ns](const std::string& message) {
    return Error{"stamp " + std::to_string(stamp_ns) + " ns: " + message};
  };
  const std::string wanted = std::to_string(camera.width) + " x " + std::to_string(camera.height);
  if (color.cols != camera.width || color.rows != camera.height || color.empty()) {
    return fail(describe("color", color) + ", but the camera has " + wanted);
  }
  if (color.type() != CV_8UC1 && color.type() != CV_8UC3) return fail(describe("color", color) + ", not 8UC1 or 8UC3");
  const std::optional<std::vector<double>> pose = numbers(options.color_from_depth);
  const bool is_registered = !pose || pose->empty();
  if (depth.empty() || (is_registered && depth.size() != color.size())) {
    return fail(describe("depth", depth) + ", but the camera has " + wanted);
  }
  if (depth.type() != CV_16UC1 && depth.type() != CV_32FC1) {
    return fail(describe("depth", depth) + ", not 16UC1 or 32FC1");
  }
  RgbdImage image;
  image.stamp_ns = stamp_ns;
  if (color.type() == CV_8UC3) {
    cv::cvtColor(color, image.gray, cv::COLOR_BGR2GRAY);
  } else {
    image.gray = color.clone();
  }
  image.depth_m = to_metres(depth, options, &image.depth_range);
  if (is_registered) return image;
  Camera depth_camera = camera;
  depth_camera.distortion = {};
  const std::vector<double> pinhole = numbers(options.intrinsics).value_or(std::vector<double>());
  if (pinhole.size() == 4) {
    depth_camera.fx = pinhole[0], depth_camera.fy = pinhole[1], depth_camera.cx = pinhole[2];
    depth_camera.cy = pinhole[3];
  } else if (depth.size() != color.size()) {
    return fail(describe("depth", depth) + ", but the camera has " + wanted + ", and depth.intrinsics is empty");
  }
  image.depth_m = registered(image.depth_m, camera, depth_camera, parse_pose(*pose));
  return image;
}

}  // namespace semantic_topo_loop::core
