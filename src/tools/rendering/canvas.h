#pragma once

#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {

inline cv::Scalar shade(const cv::Scalar& color, double factor) {
  return {std::min(255.0, color[0] * factor), std::min(255.0, color[1] * factor), std::min(255.0, color[2] * factor)};
}

/// Draws on a picture of a given resolution; lengths in metres.
class Canvas {
 public:
  Canvas(const cv::Size& size, float texels_per_m, const cv::Scalar& background, Random* random)
      : image_(size, CV_8UC3, background), texels_per_m_(static_cast<double>(texels_per_m)), random_(random) {}

  /// A rectangle in metres from the upper left corner.
  struct Area {
    double x = 0.0, y = 0.0, width = 0.0, height = 0.0;
  };
  Area all() const { return {0.0, 0.0, image_.cols / texels_per_m_, image_.rows / texels_per_m_}; }

  void fill(const Area& area, const cv::Scalar& color) { image_(rect(area)).setTo(color); }

  void frame(const Area& area, double line_m, const cv::Scalar& color) {
    cv::rectangle(image_, rect(area), color, std::max(1, px(line_m)));
  }

  void disc(double x, double y, double radius, const cv::Scalar& color) {
    cv::circle(image_, {px(x), px(y)}, std::max(1, px(radius)), color, cv::FILLED, cv::LINE_AA);
  }

  void line(double x1, double y1, double x2, double y2, double line_m, const cv::Scalar& color) {
    cv::line(image_, {px(x1), px(y1)}, {px(x2), px(y2)}, color, std::max(1, px(line_m)), cv::LINE_AA);
  }

  /// Turned rectangles, triangles and discs of random colors and sizes up to `largest_m`.
  void patches(const Area& area, int count, double largest_m) {
    cv::Mat part = image_(rect(area));
    if (part.empty()) return;
    for (int i = 0; i < count; ++i) {
      const double u = random_->uniform();
      const double radius = std::max(1.0, largest_m * texels_per_m_ * (0.08 + 0.92 * u * u * u));
      const cv::Point2d center(random_->uniform() * part.cols, random_->uniform() * part.rows);
      const double turn = random_->uniform(0.0, 2.0 * kPi), slim = random_->uniform(0.25, 1.0);
      const int corners = random_->integer(3, 5);
      const cv::Scalar color = any_color();
      if (corners == 5) {
        cv::circle(part, center, static_cast<int>(0.6 * radius) + 1, color, cv::FILLED, cv::LINE_AA);
        continue;
      }
      std::vector<cv::Point> outline;
      for (int k = 0; k < corners; ++k) {
        const double a = 2.0 * kPi * k / corners + 0.3;
        const double x = radius * std::cos(a), y = slim * radius * std::sin(a);
        outline.emplace_back(static_cast<int>(center.x + x * std::cos(turn) - y * std::sin(turn)),
                             static_cast<int>(center.y + x * std::sin(turn) + y * std::cos(turn)));
      }
      cv::fillConvexPoly(part, outline, color, cv::LINE_AA);
    }
  }

  /// Rectangles of a board of `cell_m`, each of its own shade.
  void mosaic(const Area& area, double cell_m) {
    const cv::Scalar first = any_color(), second = any_color();
    for (double y = 0.0; y < area.height; y += cell_m) {
      for (double x = 0.0; x < area.width; x += cell_m) {
        const Area cell{area.x + x, area.y + y, std::min(cell_m, area.width - x), std::min(cell_m, area.height - y)};
        fill(cell, shade(random_->chance(0.5) ? first : second, random_->uniform(0.6, 1.2)));
      }
    }
  }

  /// Lines of words.
  void text(const Area& area, double line_m, const cv::Scalar& color) {
    cv::Mat part = image_(rect(area));
    if (part.empty()) return;
    // Hershey's capitals are about 22 px high at scale 1.
    const double scale = 0.6 * line_m * texels_per_m_ / 22.0;
    const int thickness = std::max(1, static_cast<int>(0.09 * line_m * texels_per_m_));
    for (int y = px(line_m); y <= part.rows; y += px(1.3 * line_m) + 1) {
      const int indent = random_->chance(0.2) ? px(2.0 * line_m) : 0;
      std::string words = word(random_);
      const int count = std::max(1, static_cast<int>(random_->uniform(0.4, 1.0) * area.width / (3.0 * line_m)));
      for (int i = 1; i < count; ++i) words += " " + word(random_);
      cv::putText(part, words, {indent, y}, cv::FONT_HERSHEY_SIMPLEX, scale, color, thickness, cv::LINE_AA);
    }
  }

  /// One of several kinds of pictures with a border.
  void poster(const Area& area) {
    const int kind = random_->index(4);
    const cv::Scalar ground = kind == 0 ? cv::Scalar(235, 238, 240) : any_color();
    fill(area, ground);
    const double margin = 0.06 * std::min(area.width, area.height);
    const Area inner{area.x + margin, area.y + margin, area.width - 2.0 * margin, area.height - 2.0 * margin};
    const double size = std::min(inner.width, inner.height);
    if (kind == 0) {
      text({inner.x, inner.y, inner.width, 0.25 * inner.height}, 0.12 * size, any_color());
      text({inner.x, inner.y + 0.3 * inner.height, 0.5 * inner.width, 0.7 * inner.height}, 0.05 * size, {40, 40, 40});
      patches({inner.x + 0.55 * inner.width, inner.y + 0.3 * inner.height, 0.45 * inner.width, 0.6 * inner.height}, 25,
              0.2 * size);
    } else if (kind == 1) {
      mosaic(inner, size * random_->uniform(0.06, 0.14));
      patches(inner, 12, 0.15 * size);
    } else {
      patches(inner, kind == 2 ? 120 : 40, (kind == 2 ? 0.12 : 0.35) * size);
      text({inner.x, inner.y + 0.82 * inner.height, inner.width, 0.15 * inner.height}, 0.1 * size, any_color());
    }
    frame(area, 0.015, shade(any_color(), 0.5));
  }

  /// Brightens and darkens by noise at every scale from the largest cell down to two texels.
  /// @param share of the brightness, standard deviation at each scale
  void roughen(double largest_cell_m, double share) {
    cv::Mat sum = cv::Mat::zeros(image_.size(), CV_32F);
    for (double cell = largest_cell_m * texels_per_m_; cell >= 2.0; cell *= 0.5)
      sum += noise(image_.size(), cell, random_);
    const float gain = static_cast<float>(share);
    for (int y = 0; y < image_.rows; ++y) {
      const float* factor = sum.ptr<float>(y);
      std::uint8_t* p = image_.ptr(y);
      for (int x = 0; x < 3 * image_.cols; ++x) {
        p[x] = cv::saturate_cast<std::uint8_t>(static_cast<float>(p[x]) * (1.0F + gain * factor[x / 3]));
      }
    }
  }

  cv::Scalar any_color() {
    cv::Scalar color;
    for (int i = 0; i < 3; ++i) color[i] = random_->uniform(20.0, 240.0);
    return color;
  }

  Random& random() { return *random_; }
  const cv::Mat& image() const { return image_; }

 private:
  /// Noise of one scale, CV_32F, mean 0, standard deviation about 1.
  static cv::Mat noise(const cv::Size& size, double cell_px, Random* random) {
    const cv::Size cells(std::max(2, static_cast<int>(size.width / cell_px) + 2),
                         std::max(2, static_cast<int>(size.height / cell_px) + 2));
    cv::Mat coarse(cells, CV_32F);
    // Uniform on [-sqrt(3), sqrt(3)] has a standard deviation of 1.
    for (int i = 0; i < coarse.rows * coarse.cols; ++i) {
      coarse.ptr<float>()[i] = static_cast<float>(random->uniform(-std::sqrt(3.0), std::sqrt(3.0)));
    }
    cv::Mat fine;
    const cv::Size whole(static_cast<int>(cells.width * cell_px) + 1, static_cast<int>(cells.height * cell_px) + 1);
    cv::resize(coarse, fine, cv::Size(std::max(whole.width, size.width), std::max(whole.height, size.height)), 0.0, 0.0,
               cv::INTER_LINEAR);
    return fine(cv::Rect(0, 0, size.width, size.height));
  }

  static std::string word(Random* random) {
    std::string text;
    const int letters = random->integer(2, 9);
    for (int i = 0; i < letters; ++i) text += static_cast<char>('a' + random->index(26));
    return text;
  }

  int px(double m) const { return static_cast<int>(std::lround(m * texels_per_m_)); }

  cv::Rect rect(const Area& area) const {
    const cv::Rect whole(0, 0, image_.cols, image_.rows);
    return cv::Rect(px(area.x), px(area.y), std::max(1, px(area.width)), std::max(1, px(area.height))) & whole;
  }

  cv::Mat image_;
  double texels_per_m_;
  Random* random_;
};

}  // namespace semantic_topo_loop::core
