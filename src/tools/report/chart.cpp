#include "tools/report/chart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kLeft = 52.0, kRight = 14.0, kTop = 24.0, kBottom = 40.0;  // around the inner space, px

double position(const Axis& axis, double value) {
  if (!axis.is_log) return (value - axis.min) / (axis.max - axis.min);
  return std::log(std::max(value, axis.min) / axis.min) / std::log(axis.max / axis.min);
}

std::string point(const Vec2& p) { return px(p.x()) + ',' + px(p.y()); }

std::string polyline(const std::vector<Vec2>& points, const std::string& color, const std::string& attributes) {
  if (points.empty()) return {};
  std::string text =
      "<polyline fill=\"none\" stroke-linecap=\"round\" stroke=\"" + color + "\" " + attributes + " points=\"";
  for (const Vec2& p : points) text += point(p) + ' ';
  if (points.size() == 1) text += point(points.front()) + ' ';  // a dot: a line of one point is not drawn
  text.back() = '"';
  return text + "/>\n";
}

std::string tick_text(const Vec2& at, const char* anchor, const std::string& label) {
  return "<text x=\"" + px(at.x()) + "\" y=\"" + px(at.y()) + "\" text-anchor=\"" + anchor + "\">" + escaped(label) +
         "</text>\n";
}

/// What is between two ends of a line.
std::vector<std::vector<Vec2>> parts(const std::vector<Vec2>& values) {
  std::vector<std::vector<Vec2>> result(1);
  for (const Vec2& value : values) {
    if (value.allFinite()) {
      result.back().push_back(value);
    } else {
      result.emplace_back();
    }
  }
  return result;
}

std::vector<Tick> log_ticks(const Axis& axis) {
  constexpr double kFewDecades = 3.0;
  const double decades = std::log10(axis.max / axis.min);
  std::vector<double> factors = {1.0};
  if (decades <= kFewDecades) factors = {1.0, 2.0, 5.0};
  std::vector<Tick> result;
  for (double power = std::floor(std::log10(axis.min)); power <= std::log10(axis.max); ++power) {
    for (const double factor : factors) {
      const double value = factor * std::pow(10.0, power);
      constexpr int kDigits = 6;
      if (value >= axis.min && value <= axis.max) result.push_back({value, format_general(value, kDigits)});
    }
  }
  return result;
}

}  // namespace

std::string escaped(std::string_view text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '"':
        result += "&quot;";
        break;
      case '\'':
        result += "&#39;";
        break;
      default:
        result += c;
    }
  }
  return result;
}

std::string px(double value) {
  std::string text = format_fixed(value, 1);
  if (text.size() > 2 && text.compare(text.size() - 2, 2, ".0") == 0) text.resize(text.size() - 2);
  return text == "-0" ? "0" : text;
}

std::string svg_circle(const Vec2& center_px, double radius_px, const std::string& attributes) {
  return "<circle cx=\"" + px(center_px.x()) + "\" cy=\"" + px(center_px.y()) + "\" r=\"" + px(radius_px) + "\" " +
         attributes + "/>\n";
}

std::string svg_line(const Vec2& from_px, const Vec2& to_px, const std::string& attributes) {
  return "<line x1=\"" + px(from_px.x()) + "\" y1=\"" + px(from_px.y()) + "\" x2=\"" + px(to_px.x()) + "\" y2=\"" +
         px(to_px.y()) + "\" " + attributes + "/>\n";
}

Axis axis_over(std::string title, const std::vector<double>& values, bool is_log) {
  constexpr double kMargin = 0.04;
  double min = std::numeric_limits<double>::infinity(), max = -min;
  for (const double value : values) {
    if (!std::isfinite(value) || (is_log && value <= 0.0)) continue;
    min = std::min(min, value);
    max = std::max(max, value);
  }
  if (min > max) return {std::move(title), is_log ? 0.1 : 0.0, 1.0, is_log};
  if (is_log) {
    const double factor = std::max(std::pow(max / min, kMargin), 1.2);
    return {std::move(title), min / factor, max * factor, true};
  }
  double margin = kMargin * (max - min);
  if (!(margin > 0.0)) margin = std::max(0.5 * std::abs(max), 0.5);
  return {std::move(title), min - margin, max + margin, false};
}

std::vector<Tick> ticks(const Axis& axis, int count) {
  if (axis.is_log) return log_ticks(axis);
  constexpr double kDenser = 0.75;  // rather some more than half as many
  const double rough = (axis.max - axis.min) / count;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  double step = 10.0 * power;
  for (const double factor : {5.0, 2.0, 1.0}) {
    if (factor * power >= kDenser * rough) step = factor * power;
  }
  const int decimals = std::max(0, static_cast<int>(-std::floor(std::log10(step) + 1e-9)));
  std::vector<Tick> result;
  for (double i = std::ceil(axis.min / step); i * step <= axis.max; ++i) {
    result.push_back({i * step, format_fixed(i * step + 0.0, decimals)});
  }
  return result;
}

Chart::Chart(const Vec2& size_px, Axis x, Axis y)
    : x_(std::move(x)), y_(std::move(y)), size_(size_px), inner_(size_px - Vec2(kLeft + kRight, kTop + kBottom)) {}

Chart Chart::plan(double width_px, double height_max, const Extent& extent) {
  constexpr double kMargin = 0.05, kMinSize_m = 0.5, kMinHeight = 0.4;
  const Vec2 min = extent.is_empty() ? Vec2(0.0, 0.0) : extent.min, max = extent.is_empty() ? min : extent.max;
  const Vec2 center = 0.5 * (min + max);
  Vec2 size = ((1.0 + 2.0 * kMargin) * (max - min)).cwiseMax(kMinSize_m);
  const double width = width_px - kLeft - kRight;
  const double height = width * std::clamp(size.y() / size.x(), kMinHeight, height_max);
  // What is narrower than the space for it gets more to its sides.
  if (size.y() * width < size.x() * height) size.y() = size.x() * height / width;
  if (size.y() * width > size.x() * height) size.x() = size.y() * width / height;
  const Vec2 low = center - 0.5 * size, high = center + 0.5 * size;
  return {{width_px, height + kTop + kBottom}, {"x, m", low.x(), high.x()}, {"y, m", low.y(), high.y()}};
}

Vec2 Chart::to_px(const Vec2& value) const {
  return {position(x_, value.x()) * inner_.x(), (1.0 - position(y_, value.y())) * inner_.y()};
}

void Chart::line(const std::vector<Vec2>& values, const std::string& color, const std::string& attributes) {
  constexpr double kVisible_px = 0.7;
  for (const std::vector<Vec2>& part : parts(values)) {
    std::vector<Vec2> points;
    for (const Vec2& value : part) {
      const Vec2 p = to_px(value);
      if (points.empty() || &value == &part.back() || (p - points.back()).norm() >= kVisible_px) points.push_back(p);
    }
    add(polyline(points, color, attributes));
  }
}

void Chart::series(const std::vector<Vec2>& values, const std::string& color, const std::string& attributes) {
  for (const std::vector<Vec2>& part : parts(values)) {
    std::vector<Vec2> points;
    for (std::size_t begin = 0, end = 0; begin < part.size(); begin = end) {
      const double column = std::floor(to_px(part[begin]).x());
      Vec2 lowest = to_px(part[begin]), highest = lowest;
      for (; end < part.size() && std::floor(to_px(part[end]).x()) == column; ++end) {
        const Vec2 p = to_px(part[end]);
        if (p.y() < lowest.y()) lowest = p;
        if (p.y() > highest.y()) highest = p;
      }
      if (lowest.x() > highest.x()) std::swap(lowest, highest);
      points.push_back(lowest);
      if (highest != lowest) points.push_back(highest);
    }
    add(polyline(points, color, attributes));
  }
}

std::string Chart::axes() const {
  constexpr double kPxPerTick = 80.0, kPxPerRow = 42.0, kGap = 6.0, kFont = 11.0;
  std::string lines, texts;
  for (const Tick& tick : ticks(x_, std::max(2, static_cast<int>(inner_.x() / kPxPerTick)))) {
    const double x = kLeft + position(x_, tick.value) * inner_.x();
    lines += svg_line({x, kTop}, {x, kTop + inner_.y()});
    texts += tick_text({x, kTop + inner_.y() + kGap + kFont}, "middle", tick.label);
  }
  for (const Tick& tick : ticks(y_, std::max(2, static_cast<int>(inner_.y() / kPxPerRow)))) {
    const double y = kTop + (1.0 - position(y_, tick.value)) * inner_.y();
    lines += svg_line({kLeft, y}, {kLeft + inner_.x(), y});
    texts += tick_text({kLeft - kGap, y + 0.35 * kFont}, "end", tick.label);
  }
  texts += tick_text({kLeft + inner_.x(), size_.y() - kGap}, "end", x_.title);
  texts += tick_text({kGap, kFont + 1.0}, "start", y_.title);
  return "<g class=\"grid\">" + lines + "</g>\n<g class=\"ticks\">" + texts + "</g>\n";
}

std::string Chart::svg(const std::string& name) const {
  const std::string size = px(size_.x()) + ' ' + px(size_.y());
  return "<svg class=\"chart\" role=\"img\" viewBox=\"0 0 " + size + "\" aria-label=\"" + escaped(name) + "\">\n" +
         axes() + "<svg x=\"" + px(kLeft) + "\" y=\"" + px(kTop) + "\" width=\"" + px(inner_.x()) + "\" height=\"" +
         px(inner_.y()) + "\">\n" + content_ + "</svg>\n</svg>\n";
}

std::string legend(const std::vector<LegendEntry>& entries) {
  constexpr std::array<const char*, 5> kClasses = {"line", "dash", "dot", "ring", "cross"};
  std::string html = "<div class=\"legend\">";
  for (const LegendEntry& entry : entries) {
    html += std::string("<span><i class=\"") + kClasses[entry.mark] + "\" style=\"color:" + entry.color + "\"></i>" +
            escaped(entry.text) + "</span>";
  }
  return html + "</div>\n";
}

std::string LabelPlacer::place(const std::string& text, const Vec2& center_px, const Vec2& reach_px,
                               const std::string& attributes, double font_px) {
  constexpr double kLetter = 0.56, kGap_px = 3.0;  // a letter's width of the font's size, in the mean
  const Vec2 half(0.5 * kLetter * font_px * static_cast<double>(text.size()), 0.5 * font_px);
  // Above, below, to the sides, at the corners, and on it.
  constexpr double kCorner = 0.75;
  const std::vector<Vec2> directions = {{0, -1},
                                        {0, 1},
                                        {1, 0},
                                        {-1, 0},
                                        {kCorner, -kCorner},
                                        {-kCorner, -kCorner},
                                        {kCorner, kCorner},
                                        {-kCorner, kCorner},
                                        {0, 0}};
  Area best{};
  double least = std::numeric_limits<double>::infinity();
  for (const Vec2& direction : directions) {
    const Vec2 away = reach_px + half + Vec2::Constant(kGap_px);
    const Vec2 at = center_px + Vec2(direction.x() * away.x(), direction.y() * away.y());
    const Area area{at - half, at + half};
    const double cost_of_area = cost(area);
    if (cost_of_area >= least) continue;
    least = cost_of_area;
    best = area;
  }
  taken_.push_back(best);
  const Vec2 middle = 0.5 * (best.min + best.max);
  return "<text x=\"" + px(middle.x()) + "\" y=\"" + px(middle.y() + 0.35 * font_px) + "\" " + attributes + ">" +
         escaped(text) + "</text>\n";
}

/// Area that other names cover, px^2; much more where the space ends.
double LabelPlacer::cost(const Area& area) const {
  constexpr double kOutside = 1e6;
  const bool is_inside =
      (area.min.array() >= space_.min.array()).all() && (area.max.array() <= space_.max.array()).all();
  double covered = is_inside ? 0.0 : kOutside;
  for (const Area& other : taken_) {
    const Vec2 common = (area.max.cwiseMin(other.max) - area.min.cwiseMax(other.min)).cwiseMax(0.0);
    covered += common.x() * common.y();
  }
  return covered;
}

}  // namespace semantic_topo_loop::core
