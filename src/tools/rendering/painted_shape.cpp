#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>

#include "tools/rendering/drawn_shape.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

cv::Scalar shade(const cv::Scalar& color, double factor) {
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

using Area = Canvas::Area;

const cv::Scalar kDark(38, 36, 35);
const cv::Scalar kPaper(232, 236, 238);

cv::Scalar tinted(double b, double g, double r, double spread, Random* random) {
  return shade({b, g, r}, random->uniform(1.0 - spread, 1.0 + spread));
}

/// Paints the faces of shapes on a canvas of their size.
struct Painter {
  Canvas& canvas;
  Random& random;  ///< of the canvas
  const Area all;

  void paint(Paint paint, Face face, const cv::Scalar& base) {
    const bool is_side = face != kTopFace && face != kBottomFace;
    switch (paint) {
      case Paint::kWalls:
        // A room is seen from inside: its bottom is the floor.
        return face == kBottomFace ? floor() : face == kTopFace ? ceiling() : wall();
      case Paint::kTableTop:
        return face == kTopFace ? table_top() : canvas.roughen(0.05, 0.06);
      case Paint::kCover:
        return is_side ? canvas.roughen(0.01, 0.1) : cover();
      case Paint::kScreen:
        return face == kFront ? screen() : canvas.patches(all, is_side ? 5 : 0, 0.03);
      case Paint::kDisplay:
        if (face == kTopFace) canvas.patches(all, 18, 0.02);
        return;
      case Paint::kKeys:
        if (face == kTopFace) keys();
        return;
      case Paint::kDial:
        if (is_side) dial();
        return;
      case Paint::kLabel:
        if (is_side) label();
        return;
      case Paint::kGlaze:
        return glaze();
      case Paint::kPeel:
        canvas.roughen(0.03, 0.05);
        return canvas.patches(all, 3, 0.008);
      case Paint::kLeaves:
        return tufts(base, 0.05, 0.6);
      case Paint::kFur:
        return tufts(base, 0.02, 0.3);
      case Paint::kCloth:
        tufts(base, 0.04, 0.35);
        return canvas.patches(all, 6, 0.08);
      case Paint::kDarkMetal:
        return canvas.roughen(0.03, 0.05);
    }
  }

  /// Posters and boards side by side at different heights, a skirting board below.
  void wall() {
    canvas.roughen(1.2, 0.022);
    for (double x = random.uniform(0.05, 0.4); x < all.width - 0.3;) {
      const double width = std::min(random.uniform(0.35, 1.0), all.width - x - 0.05);
      const double height = random.uniform(0.4, 0.9);
      canvas.poster({x, random.uniform(0.35, 0.95), width, height});
      // Some hang lower down, as shelves and sockets do.
      if (random.chance(0.7))
        canvas.poster({x + random.uniform(0.0, 0.2), all.height - random.uniform(0.7, 0.95), 0.3, 0.4});
      x += width + random.uniform(0.1, 0.5);
    }
    canvas.fill({0.0, all.height - 0.09, all.width, 0.09}, {90, 105, 120});
    canvas.roughen(0.03, 0.02);
  }

  /// Boards of different shades with a rug.
  void floor() {
    const double board_m = 0.14;
    for (double y = 0.0; y < all.height; y += board_m) {
      for (double x = -random.uniform(0.0, 1.2); x < all.width;) {
        const double length = random.uniform(0.5, 1.4);
        const Area board{std::max(x, 0.0), y, x + length - std::max(x, 0.0), board_m};
        canvas.fill(board, tinted(95, 130, 165, 0.25, &random));
        canvas.frame(board, 0.004, {45, 60, 80});
        x += length;
      }
    }
    for (int i = 0; i < static_cast<int>(all.width * all.height / 6.0) + 1; ++i) {
      const double width = random.uniform(0.6, 1.4), height = random.uniform(0.5, 1.0);
      const Area rug{random.uniform(0.0, std::max(0.1, all.width - width)),
                     random.uniform(0.0, std::max(0.1, all.height - height)), width, height};
      canvas.poster(rug);
    }
    canvas.roughen(0.3, 0.045);
  }

  void ceiling() {
    canvas.roughen(0.8, 0.015);
    for (double x = 0.6; x < all.width; x += 0.6) canvas.line(x, 0.0, x, all.height, 0.01, {150, 150, 150});
    for (double y = 0.6; y < all.height; y += 0.6) canvas.line(0.0, y, all.width, y, 0.01, {150, 150, 150});
    for (int i = 0; i < static_cast<int>(all.width * all.height / 4.0) + 1; ++i) {
      canvas.fill({random.uniform(0.0, all.width), random.uniform(0.0, all.height), 0.6, 0.3}, {252, 254, 255});
    }
  }

  /// Wood with papers, notes and stains.
  void table_top() {
    for (double x = 0.0; x < all.width; x += 0.03) {
      canvas.fill({x, 0.0, 0.03, all.height}, tinted(110, 150, 185, 0.07, &random));
    }
    const int papers = static_cast<int>(6.0 * all.width * all.height) + 2;
    for (int i = 0; i < papers; ++i) {
      const double width = random.uniform(0.10, 0.25), height = random.uniform(0.10, 0.30);
      const Area paper{random.uniform(0.0, all.width), random.uniform(0.0, all.height), width, height};
      canvas.fill(paper, random.chance(0.6) ? kPaper : shade(canvas.any_color(), 1.2));
      const Area inner{paper.x + 0.01, paper.y + 0.01, width - 0.02, height - 0.02};
      if (random.chance(0.7))
        canvas.text(inner, random.uniform(0.008, 0.025), {50, 45, 45});
      else
        canvas.patches(inner, 15, 0.06);
    }
    canvas.patches(all, static_cast<int>(30.0 * all.width * all.height), 0.02);
    canvas.roughen(0.2, 0.035);
  }

  void cover() {
    const double size = std::min(all.width, all.height);
    canvas.patches(all, random.integer(4, 14), 0.35 * size);
    canvas.text({0.08 * all.width, 0.05 * all.height, 0.84 * all.width, 0.4 * all.height}, 0.14 * size,
                canvas.any_color());
    canvas.frame(all, 0.01 * size + 0.001, canvas.any_color());
    canvas.roughen(0.03, 0.03);
  }

  void screen() {
    const double rim = 0.015;
    const Area screen{rim, rim, all.width - 2.0 * rim, all.height - 2.0 * rim};
    canvas.fill(screen, canvas.any_color());
    canvas.patches(screen, 30, 0.15);
    for (int i = 0; i < 3; ++i) {
      const Area window{rim + random.uniform(0.0, 0.5) * screen.width, rim + random.uniform(0.0, 0.5) * screen.height,
                        0.45 * screen.width, 0.45 * screen.height};
      canvas.fill(window, kPaper);
      canvas.text({window.x + 0.01, window.y + 0.01, window.width - 0.02, window.height - 0.02}, 0.018, kDark);
    }
  }

  void keys() {
    constexpr double kKey_m = 0.019;  // from key to key (ISO 9995)
    for (double y = 0.008; y + kKey_m < all.height; y += kKey_m) {
      for (double x = 0.008; x + kKey_m < all.width; x += kKey_m) {
        const double wide = random.chance(0.12) ? 2.0 : 1.0;
        canvas.fill({x, y, wide * kKey_m - 0.003, kKey_m - 0.003}, tinted(75, 72, 70, 0.5, &random));
        canvas.text({x + 0.004, y, 0.012, kKey_m}, 0.011, kPaper);
        x += (wide - 1.0) * kKey_m;
      }
    }
  }

  void dial() {
    const double radius = 0.45 * std::min(all.width, all.height);
    const double x = 0.5 * all.width, y = 0.5 * all.height;
    canvas.disc(x, y, radius, kPaper);
    for (int i = 0; i < 12; ++i) {
      const double a = 2.0 * kPi * i / 12.0;
      canvas.disc(x + 0.8 * radius * std::cos(a), y + 0.8 * radius * std::sin(a), i % 3 == 0 ? 0.006 : 0.003, kDark);
    }
    for (const double length : {0.5, 0.75}) {
      const double a = random.uniform(0.0, 2.0 * kPi);
      canvas.line(x, y, x + length * radius * std::cos(a), y + length * radius * std::sin(a), 0.004, kDark);
    }
  }

  void label() {
    const Area label{0.0, 0.3 * all.height, all.width, 0.4 * all.height};
    canvas.fill(label, canvas.any_color());
    canvas.patches(label, 6, 0.02);
    canvas.text({0.1 * all.width, label.y, 0.8 * all.width, label.height}, 0.022, kPaper);
  }

  void glaze() {
    const double stripe = 0.12 * all.height;
    for (double y = 0.2 * all.height; y < 0.8 * all.height; y += 2.0 * stripe) {
      canvas.mosaic({0.0, y, all.width, stripe}, 0.8 * stripe);
    }
    canvas.patches(all, 5, 0.02);
    canvas.roughen(0.03, 0.03);
  }

  /// Shapes of similar shades at the scale of leaves, tufts or folds.
  void tufts(const cv::Scalar& base, double size_m, double spread) {
    const int count = std::min(3000, static_cast<int>(3.0 * all.width * all.height / (size_m * size_m)));
    for (int i = 0; i < count; ++i) {
      const double x = random.uniform(0.0, all.width), y = random.uniform(0.0, all.height);
      const double a = random.uniform(0.0, 2.0 * kPi), length = random.uniform(0.5, 1.5) * size_m;
      canvas.line(x, y, x + length * std::cos(a), y + length * std::sin(a), random.uniform(0.15, 0.4) * size_m,
                  shade(base, random.uniform(1.0 - spread, 1.0 + spread)));
    }
    canvas.roughen(size_m, 0.05);
  }
};

/// Color that the faces of one shape share, BGR.
cv::Scalar base_color(Paint paint, Random* random) {
  switch (paint) {
    case Paint::kWalls:
      return tinted(190, 200, 205, 0.1, random);
    case Paint::kTableTop:
      return {70, 100, 130};
    case Paint::kDarkMetal:
    case Paint::kScreen:
    case Paint::kDisplay:
      return tinted(45, 42, 40, 0.3, random);
    case Paint::kKeys:
      return tinted(60, 58, 56, 0.4, random);
    case Paint::kPeel:
      return {random->uniform(20, 60), random->uniform(60, 150), random->uniform(190, 240)};
    case Paint::kLeaves:
      return tinted(45, 120, 60, 0.2, random);
    case Paint::kFur:
      return tinted(60, 100, 150, 0.2, random);
    default:
      return {random->uniform(40, 220), random->uniform(40, 220), random->uniform(40, 220)};
  }
}

/// Enough for the nearest view of each: a pixel at 1 m shows 2 mm.
float texels_per_m(Paint paint) {
  return paint == Paint::kWalls ? 250.0F : paint == Paint::kTableTop ? 600.0F : 700.0F;
}

/// The axes of the box (0 to 2) that lead across and down a face as seen from outside, and which way they do.
struct FaceAxes {
  int across, down;
  float across_sign, down_sign;
};
constexpr FaceAxes kFaceAxes[kFaces] = {{1, 2, 1.0F, -1.0F}, {1, 2, -1.0F, -1.0F}, {0, 2, -1.0F, -1.0F},
                                        {0, 2, 1.0F, -1.0F}, {1, 0, 1.0F, 1.0F},   {1, 0, 1.0F, -1.0F}};

using Texel = std::uint32_t;  ///< BGRX

/// Mixes the four bytes two at a time. This is where rendering spends most of its time.
/// @param weight of b, [0, 256]
Texel mix(Texel a, Texel b, Texel weight) {
  constexpr Texel kEven = 0x00ff00ff;  // the bytes in even places
  const Texel even = ((a & kEven) * (256 - weight) + (b & kEven) * weight) >> 8;
  const Texel odd = ((a >> 8) & kEven) * (256 - weight) + ((b >> 8) & kEven) * weight;
  return (even & kEven) | (odd & ~kEven);
}

Texel bilinear(const cv::Mat& image, float u, float v) {
  const float x = std::clamp(u * static_cast<float>(image.cols) - 0.5F, 0.0F, static_cast<float>(image.cols - 1));
  const float y = std::clamp(v * static_cast<float>(image.rows) - 0.5F, 0.0F, static_cast<float>(image.rows - 1));
  const auto x8 = static_cast<int>(256.0F * x), y8 = static_cast<int>(256.0F * y);
  const int x0 = x8 >> 8, y0 = y8 >> 8;
  const int right = x0 + 1 < image.cols ? 1 : 0;
  const Texel* top = image.ptr<Texel>(y0) + x0;
  const Texel* bottom = y0 + 1 < image.rows ? image.ptr<Texel>(y0 + 1) + x0 : top;
  const auto wx = static_cast<Texel>(x8 & 255), wy = static_cast<Texel>(y8 & 255);
  return mix(mix(top[0], top[right], wx), mix(bottom[0], bottom[right], wx), wy);
}

/// @param image CV_8UC3, BGR   @return it and its halvings, CV_8UC4
std::vector<cv::Mat> mip_map(const cv::Mat& image) {
  std::vector<cv::Mat> levels(1);
  cv::cvtColor(image, levels.front(), cv::COLOR_BGR2BGRA);
  while (std::max(levels.back().cols, levels.back().rows) > 1) {
    const cv::Size half(std::max(1, levels.back().cols / 2), std::max(1, levels.back().rows / 2));
    cv::Mat next;
    cv::resize(levels.back(), next, half, 0.0, 0.0, cv::INTER_AREA);
    levels.push_back(next);
  }
  return levels;
}

}  // namespace

PaintedShape::PaintedShape(const DrawnShape& shape, bool inside, std::uint64_t seed, std::uint64_t index)
    : shape_(shape), inside_(inside) {
  Random random(seed, index);
  const cv::Scalar base = base_color(shape.paint, &random);
  const float resolution = texels_per_m(shape.paint);
  for (std::size_t i = 0; i < kFaces; ++i) {
    const Vec2 size_m(2.0 * shape.half[kFaceAxes[i].across], 2.0 * shape.half[kFaceAxes[i].down]);
    const Vec2 texels = static_cast<double>(resolution) * size_m;
    const cv::Size size(std::max(2, static_cast<int>(texels.x())), std::max(2, static_cast<int>(texels.y())));
    Canvas canvas(size, resolution, base, &random);
    Painter{canvas, random, canvas.all()}.paint(shape.paint, static_cast<Face>(i), base);
    textures_[i] = mip_map(canvas.image());
  }
}

Color PaintedShape::color(const Eigen::Vector3f& p, Face face, float footprint_m) const {
  // Across and down the face as seen from outside, each in [-1, 1].
  const float scale = 1.0F / p.cwiseAbs().maxCoeff();
  const Eigen::Vector3f q = scale * p;
  const FaceAxes& axes = kFaceAxes[face];
  const float across = axes.across_sign * q[axes.across], down = axes.down_sign * q[axes.down];
  const float u = 0.5F + 0.5F * (inside_ ? -across : across), v = 0.5F + 0.5F * down;

  const std::vector<cv::Mat>& levels = textures_[static_cast<std::size_t>(face)];
  const auto top = static_cast<float>(levels.size() - 1);
  const float footprint = std::max(footprint_m * texels_per_m(shape_.paint), 1.0F);
  const auto level8 = static_cast<Texel>(256.0F * std::clamp(std::log2(footprint), 0.0F, top));
  const std::size_t lower = level8 >> 8;
  Texel texel = bilinear(levels[lower], u, v);
  if ((level8 & 255) != 0) texel = mix(texel, bilinear(levels[lower + 1], u, v), level8 & 255);
  return {static_cast<float>(texel & 255), static_cast<float>((texel >> 8) & 255),
          static_cast<float>((texel >> 16) & 255)};
}

}  // namespace semantic_topo_loop::core
