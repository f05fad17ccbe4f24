#pragma once

#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// The text, as HTML and SVG show it: what has a meaning for them is replaced.
std::string escaped(std::string_view text);

/// A coordinate or a length in px, to a tenth.
std::string px(double value);

/// SVG elements.
std::string svg_circle(const Vec2& center_px, double radius_px, const std::string& attributes = {});
std::string svg_line(const Vec2& from_px, const Vec2& to_px, const std::string& attributes = {});

/// The box around what is to be seen.
struct Extent {
  Vec2 min = Vec2::Constant(std::numeric_limits<double>::infinity()), max = -min;

  /// @param reach half the size of what is there
  void add(const Vec2& point, const Vec2& reach = Vec2::Zero()) {
    min = min.cwiseMin(point - reach);
    max = max.cwiseMax(point + reach);
  }
  bool is_empty() const { return min.x() > max.x(); }
};

/// A value that ends a line: what follows begins another one.
inline Vec2 line_break() { return Vec2::Constant(std::numeric_limits<double>::quiet_NaN()); }

struct Axis {
  std::string title;  ///< with its unit
  double min = 0.0, max = 1.0;
  bool is_log = false;
};

/// An axis from the least to the greatest value, with a little more on both sides, and never empty. On a logarithmic
/// one values that are not positive are passed over.
Axis axis_over(std::string title, const std::vector<double>& values, bool is_log = false);

struct Tick {
  double value = 0.0;
  std::string label;
};

/// Round numbers on an axis, about `count` of them: 1, 2 or 5 times a power of ten apart, or, on a logarithmic axis,
/// powers of ten and, of few decades, 2 and 5 times these.
std::vector<Tick> ticks(const Axis& axis, int count);

/// A chart as an SVG element: two axes, and what is drawn between them. Positions of what is drawn are in px from the
/// top left corner of the space between the axes, which cuts off what is beyond it.
class Chart {
 public:
  /// @param size_px of the whole picture
  Chart(const Vec2& size_px, Axis x, Axis y);
  /// A map seen from above: both axes in metres of one size.
  /// @param height_max of the space between the axes, in widths of it: what is to be seen decides how high it is
  /// @param extent of what is to be seen, m; may be empty
  static Chart plan(double width_px, double height_max, const Extent& extent);

  Vec2 to_px(const Vec2& value) const;
  /// Of the space between the axes, px.
  const Vec2& inner() const { return inner_; }
  double px_per_m() const { return inner_.x() / (x_.max - x_.min); }

  /// An SVG element.
  void add(const std::string& element) { content_ += element; }
  /// A line through values, up to each line_break(). Those are left out that nobody would see.
  void line(const std::vector<Vec2>& values, const std::string& color, const std::string& attributes = {});
  /// The same for many values over an increasing x: of each px the least and the greatest.
  void series(const std::vector<Vec2>& values, const std::string& color, const std::string& attributes = {});

  /// @param name what a reader who does not see it is told
  std::string svg(const std::string& name) const;

 private:
  std::string axes() const;

  Axis x_, y_;
  Vec2 size_, inner_;
  std::string content_;
};

/// One entry of a legend: a mark of that color.
struct LegendEntry {
  std::string color, text;
  enum Mark { kLine, kDash, kDot, kRing, kCross } mark = kLine;
};

/// HTML, to stand above a picture.
std::string legend(const std::vector<LegendEntry>& entries);

/// Places names beside what they name, so that they do not cover each other as far as that can be.
class LabelPlacer {
 public:
  /// @param min_px, max_px corners of the space for them
  LabelPlacer(const Vec2& min_px, const Vec2& max_px) : space_{min_px, max_px} {}
  /// @param reach_px half the size of what is named   @param attributes among them a class that centres the text
  /// @param font_px the size that it will have   @return an SVG element
  std::string place(const std::string& text, const Vec2& center_px, const Vec2& reach_px, const std::string& attributes,
                    double font_px = 11.0);

 private:
  struct Area {
    Vec2 min, max;
  };
  double cost(const Area& area) const;

  Area space_;
  std::vector<Area> taken_;
};

}  // namespace semantic_topo_loop::core
