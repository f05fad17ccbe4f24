#include "frontend/image_features.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "frontend/depth_registration.h"
#include "geometry/depth_points.h"
#include "semantic_topo_loop/frontend/frontend_options.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFar = std::numeric_limits<int>::max();

struct TwoBest {
  int best = kFar, second = kFar, index = -1, level = -1, second_level = -1;
  void offer(int distance, int candidate, int candidate_level) {
    if (distance < best) {
      second = best, second_level = level;
      best = distance, index = candidate, level = candidate_level;
    } else if (distance < second) {
      second = distance, second_level = candidate_level;
    }
  }
};

/// Drops matches whose features turned otherwise than most: a camera turns all of them by about the same angle.
class RotationCheck {
 public:
  void add(std::size_t match, float from_deg, float to_deg) {
    float turn = to_deg - from_deg;
    if (turn < 0.0F) turn += 360.0F;
    const auto bin = static_cast<std::size_t>(turn * kBins / 360.0F) % kBins;
    bins_[bin].push_back(match);
  }
  void drop_others(std::vector<int>* matches) const {
    // A bin and its two neighbours: the turn may lie at the edge of a bin.
    std::size_t best = 0, most = 0;
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const std::size_t count =
          bins_[bin].size() + bins_[(bin + 1) % kBins].size() + bins_[(bin + kBins - 1) % kBins].size();
      if (count > most) most = count, best = bin;
    }
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const std::size_t distance = (bin + kBins - best) % kBins;
      if (distance <= 1 || distance == kBins - 1) continue;
      for (const std::size_t match : bins_[bin]) (*matches)[match] = -1;
    }
  }

 private:
  static constexpr std::size_t kBins = 24;  ///< of 15 deg: the orientation of a corner is known to several degrees
  std::array<std::vector<std::size_t>, kBins> bins_;
};

}  // namespace

void ImageFeatures::index(const Camera& camera) {
  constexpr int kCell_px = 20;  // about the radius of a search: few cells to visit, and few features in vain
  grid_ = PointGrid(camera.width / kCell_px + 1, camera.height / kCell_px + 1, kCell_px);
  grid_.sort(size(), [this](std::size_t i) -> const Vec2& { return features[i].pixel; });
}

void ImageFeatures::near(const Vec2& pixel, double radius_px, std::vector<int>* found) const {
  found->clear();
  if (features.empty()) return;
  const Box square{pixel.x() - radius_px, pixel.y() - radius_px, pixel.x() + radius_px, pixel.y() + radius_px};
  grid_.for_each_row(square, [&](std::uint32_t begin, std::uint32_t end) {
    for (std::uint32_t i = begin; i < end; ++i) {
      const std::uint32_t index = grid_.order()[i];
      const Vec2 offset = features[index].pixel - pixel;
      if (std::abs(offset.x()) <= radius_px && std::abs(offset.y()) <= radius_px) {
        found->push_back(static_cast<int>(index));
      }
    }
  });
}

std::vector<int> search(const std::vector<SearchItem>& items, const ImageFeatures& image,
                        const std::vector<bool>& is_taken, int max_bits, double ratio) {
  std::vector<int> matches(items.size(), -1), distance_of(image.size(), kFar), owner(image.size(), -1);
  std::vector<int> candidates;
  for (std::size_t i = 0; i < items.size(); ++i) {
    const SearchItem& item = items[i];
    image.near(item.pixel, item.radius_px, &candidates);
    TwoBest found;
    for (const int candidate : candidates) {
      const auto index = static_cast<std::size_t>(candidate);
      const int level = image.features[index].level;
      if (is_taken[index] || std::abs(level - item.level) > 1) continue;
      found.offer(hamming(item.descriptor, image.descriptors[index]), candidate, level);
    }
    if (found.best > max_bits) continue;
    if (found.second != kFar && found.second_level == found.level && found.best > ratio * found.second) continue;
    const auto index = static_cast<std::size_t>(found.index);
    if (found.best >= distance_of[index]) continue;
    if (owner[index] >= 0) matches[static_cast<std::size_t>(owner[index])] = -1;
    distance_of[index] = found.best;
    owner[index] = static_cast<int>(i);
    matches[i] = found.index;
  }
  RotationCheck check;
  for (std::size_t i = 0; i < items.size(); ++i) {
    if (matches[i] < 0 || items[i].angle_deg < 0.0F) continue;
    check.add(i, items[i].angle_deg, image.features[static_cast<std::size_t>(matches[i])].angle_deg);
  }
  check.drop_others(&matches);
  return matches;
}

std::vector<int> match_anywhere(const ImageFeatures& a, const std::vector<bool>& wanted, const ImageFeatures& b,
                                double max_motion_px) {
  // Loose, for the pose that is sought from these matches may have most of them wrong, but must have the right ones.
  constexpr int kMaxBits = 80;     // between kSimilarBits and kMatchBits
  constexpr double kRatio = 0.95;  // of the best to the second best: ties only are left out
  constexpr int kMaxLevels = 3;    // 1.2^3: nearer or farther by 1.7 times
  std::vector<TwoBest> of_a(a.size()), of_b(b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (!wanted[i]) continue;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const Vec2 motion = b.features[j].pixel - a.features[i].pixel;
      if (motion.cwiseAbs().maxCoeff() > max_motion_px) continue;
      if (std::abs(a.features[i].level - b.features[j].level) > kMaxLevels) continue;
      const int distance = hamming(a.descriptors[i], b.descriptors[j]);
      of_a[i].offer(distance, static_cast<int>(j), 0);
      of_b[j].offer(distance, static_cast<int>(i), 0);
    }
  }
  std::vector<int> matches(a.size(), -1);
  RotationCheck check;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const TwoBest& found = of_a[i];
    if (found.index < 0 || found.best > kMaxBits || found.best > kRatio * found.second) continue;
    const auto j = static_cast<std::size_t>(found.index);
    if (of_b[j].index != static_cast<int>(i)) continue;
    matches[i] = found.index;
    check.add(i, a.features[i].angle_deg, b.features[j].angle_deg);
  }
  check.drop_others(&matches);
  return matches;
}

namespace {

// ORB (Rublee, Rabaud, Konolige and Bradski 2011).
constexpr int kPatchRadius_px = 15;  ///< of orientation and descriptor
constexpr int kBorder_px = 19;       ///< a descriptor's pairs of pixels lie within +-13 px, turned within 13 sqrt(2)
constexpr int kFastRadius_px = 3;    ///< of the circle that a corner is found by

/// Weights of a patch's pixels in its moments, in rows of a length that the compiler makes vectors of.
struct RoundPatch {
  static constexpr std::size_t kRows = 2 * kPatchRadius_px + 1, kColumns = kRows + 1;
  using Weights = std::array<std::array<std::int16_t, kColumns>, kRows>;
  Weights of_u{}, of_v{};  ///< 0 outside of the circle
  RoundPatch() {
    for (int v = -kPatchRadius_px; v <= kPatchRadius_px; ++v) {
      const int half = static_cast<int>(std::floor(std::sqrt(kPatchRadius_px * kPatchRadius_px - v * v)));
      for (int u = -half; u <= half; ++u) {
        const auto row = static_cast<std::size_t>(v + kPatchRadius_px),
                   column = static_cast<std::size_t>(u + kPatchRadius_px);
        of_u[row][column] = static_cast<std::int16_t>(u);
        of_v[row][column] = static_cast<std::int16_t>(v);
      }
    }
  }
};

/// Direction from the corner to the centroid of its patch's brightness.
float orientation_deg(const cv::Mat& image, int x, int y) {
  static const RoundPatch patch;
  int m10 = 0, m01 = 0;
  for (std::size_t row = 0; row < RoundPatch::kRows; ++row) {
    const std::uint8_t* pixels =
        image.ptr<std::uint8_t>(y - kPatchRadius_px + static_cast<int>(row)) + x - kPatchRadius_px;
    const auto &of_u = patch.of_u[row], &of_v = patch.of_v[row];
    for (std::size_t column = 0; column < RoundPatch::kColumns; ++column) {
      const auto brightness = static_cast<std::int16_t>(pixels[column]);
      m10 += of_u[column] * brightness;
      m01 += of_v[column] * brightness;
    }
  }
  return cv::fastAtan2(static_cast<float>(m01), static_cast<float>(m10));
}

/// Cells of an image that are about as many as the corners that are wanted of it.
class CornerCells {
 public:
  CornerCells(const cv::Size& size, int wanted)
      : size_(size), cell_px_(std::max(1.0, std::sqrt(static_cast<double>(size.area()) / wanted))) {}
  int columns() const { return static_cast<int>(size_.width / cell_px_) + 1; }
  int rows() const { return static_cast<int>(size_.height / cell_px_) + 1; }
  std::size_t count() const { return static_cast<std::size_t>(columns() * rows()); }
  std::size_t of(const cv::Point2f& pixel) const {
    return static_cast<std::size_t>(static_cast<int>(pixel.y / cell_px_) * columns() +
                                    static_cast<int>(pixel.x / cell_px_));
  }
  /// The pixels of some cells of a row and so many around them.
  cv::Rect pixels(int row, int first, int end, int around) const {
    const auto edge = [this](int cell) { return static_cast<int>(std::floor(cell * cell_px_)); };
    const cv::Point low(edge(first) - around, edge(row) - around),
        high(edge(end) + 1 + around, edge(row + 1) + 1 + around);
    return cv::Rect(low, high) & cv::Rect(cv::Point(), size_);
  }

 private:
  cv::Size size_;
  double cell_px_;
};

/// The strongest corner of each cell, then the second strongest, and so on, until enough are chosen: even over the
/// image, and the best where there is much to choose from.
/// @param known where a cell has a corner of this response, others of less may be missing; 0: none are
/// @return fewer if it could matter that they are
std::vector<cv::KeyPoint> spread(std::vector<cv::KeyPoint> corners, const CornerCells& cells, int wanted, float known) {
  constexpr float kTaken = -1.0F;  // instead of a contrast
  std::vector<cv::KeyPoint> chosen;
  std::vector<std::size_t> cell_of(corners.size());
  std::transform(corners.begin(), corners.end(), cell_of.begin(),
                 [&cells](const cv::KeyPoint& corner) { return cells.of(corner.pt); });
  for (bool is_first = true; static_cast<int>(chosen.size()) < wanted; is_first = false) {
    std::vector<cv::KeyPoint*> strongest(cells.count(), nullptr);
    for (std::size_t i = 0; i < corners.size(); ++i) {
      cv::KeyPoint*& other = strongest[cell_of[i]];
      if (corners[i].response > (other != nullptr ? other->response : kTaken)) other = &corners[i];
    }
    const std::size_t before = chosen.size();
    for (cv::KeyPoint* corner : strongest) {
      if (corner == nullptr || (!is_first && corner->response < known)) continue;
      chosen.push_back(*corner);
      corner->response = kTaken;
    }
    std::sort(chosen.begin() + static_cast<std::ptrdiff_t>(before), chosen.end(),
              [](const cv::KeyPoint& a, const cv::KeyPoint& b) {
                return std::make_tuple(-a.response, a.pt.y, a.pt.x) < std::make_tuple(-b.response, b.pt.y, b.pt.x);
              });
    if (!is_first && known > 0.0F) break;
  }
  if (static_cast<int>(chosen.size()) > wanted) chosen.resize(static_cast<std::size_t>(wanted));
  return chosen;
}

/// Adds corners of cells that have none.
void add_weak_corners(const cv::Mat& image, const CornerCells& cells, int threshold,
                      std::vector<cv::KeyPoint>* corners) {
  std::vector<bool> has_strong(cells.count(), false);
  for (const cv::KeyPoint& corner : *corners) has_strong[cells.of(corner.pt)] = true;
  std::vector<cv::KeyPoint> found;
  const auto columns = static_cast<std::size_t>(cells.columns());
  for (int row = 0; row < cells.rows(); ++row) {
    const std::size_t begin_of_row = static_cast<std::size_t>(row) * columns;
    for (std::size_t first = 0, end = 0; first < columns; first = end + 1) {
      for (end = first; end < columns && !has_strong[begin_of_row + end];) ++end;
      // With the circle around a corner, and the neighbours that it is compared with.
      const cv::Rect part = cells.pixels(row, static_cast<int>(first), static_cast<int>(end), kFastRadius_px + 1);
      if (end == first || part.width <= 2 * kFastRadius_px || part.height <= 2 * kFastRadius_px) continue;
      cv::FAST(image(part), found, threshold, true);
      for (cv::KeyPoint& corner : found) {
        corner.pt += cv::Point2f(part.tl());
        const std::size_t cell = cells.of(corner.pt);
        if (cell >= begin_of_row + first && cell < begin_of_row + end) corners->push_back(corner);
      }
    }
  }
}

}  // namespace

std::vector<cv::KeyPoint> find_corners(const cv::Mat& image, int threshold, int wanted, int strong) {
  if (wanted <= 0) return {};
  const CornerCells cells(image.size(), wanted);
  std::vector<cv::KeyPoint> corners;
  if (strong > threshold) {
    cv::FAST(image, corners, strong, true);
    if (static_cast<int>(corners.size()) > wanted) {
      add_weak_corners(image, cells, threshold, &corners);
      std::vector<cv::KeyPoint> chosen = spread(std::move(corners), cells, wanted, static_cast<float>(strong));
      if (static_cast<int>(chosen.size()) == wanted) return chosen;
    }
  }
  cv::FAST(image, corners, threshold, true);
  return static_cast<int>(corners.size()) > wanted ? spread(std::move(corners), cells, wanted, 0.0F) : corners;
}

namespace {

void extract_level(const cv::Mat& image, int level, double scale, int wanted, const FrontendOptions& options,
                   const Camera& camera, std::vector<cv::Vec2f>* raw_pixels, ImageFeatures* result) {
  // Sizes are whole numbers, so that the two axes are not scaled by exactly the same.
  const double scale_x = static_cast<double>(camera.width) / image.cols;
  const double scale_y = static_cast<double>(camera.height) / image.rows;
  if (image.cols <= 2 * kBorder_px || image.rows <= 2 * kBorder_px) return;
  const int margin = kBorder_px - kFastRadius_px;
  const cv::Rect inner(margin, margin, image.cols - 2 * margin, image.rows - 2 * margin);
  std::vector<cv::KeyPoint> corners = find_corners(image(inner), options.corner_threshold, wanted);
  for (cv::KeyPoint& corner : corners) {
    corner.pt.x += static_cast<float>(margin);
    corner.pt.y += static_cast<float>(margin);
    corner.angle = orientation_deg(image, static_cast<int>(corner.pt.x), static_cast<int>(corner.pt.y));
    corner.octave = 0;
  }
  // One level, no border of its own: every corner keeps its place in the list.
  const cv::Ptr<cv::ORB> orb = cv::ORB::create(wanted, 1.2F, 1, 0, 0, 2, cv::ORB::FAST_SCORE);
  cv::Mat descriptors;
  orb->compute(image, corners, descriptors);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    // Pixel centres are whole numbers, so that half a pixel is moved before and after scaling.
    const cv::Vec2f raw(static_cast<float>((corners[i].pt.x + 0.5) * scale_x - 0.5),
                        static_cast<float>((corners[i].pt.y + 0.5) * scale_y - 0.5));
    ImageFeature feature;
    feature.pixel = camera.undistort(Vec2(raw[0], raw[1]));
    feature.level = level;
    feature.scale = scale;
    feature.angle_deg = corners[i].angle;
    Descriptor descriptor;
    std::memcpy(descriptor.data(), descriptors.ptr(static_cast<int>(i)), sizeof(descriptor));
    raw_pixels->push_back(raw);
    result->features.push_back(feature);
    result->descriptors.push_back(descriptor);
  }
}

/// Depth around a raw pixel: none where the surroundings, `reach` pixels each way, are no one surface.
/// @param center of the pixel in the depth image
void measure_depth(const cv::Mat& depth_m, const Vec2& center, int reach, ImageFeature* feature) {
  constexpr int kMinValues = 13;        // half of the grid
  constexpr double kStepShare = 0.06;   // of the depth: 8 px wide, a slope of more than 75 deg, or a step
  constexpr double kRounding_m = 1e-3;  // of depth in whole millimetres, and what calibration leaves
  constexpr double kNoiseRange = 4.0;   // the range of 25 values is four sigmas
  constexpr double kSlopeShare = 0.25;  // sigma of a uniform distribution over the range: 1 / sqrt(12), and a bit less
  const int u0 = static_cast<int>(std::lround(center.x())), v0 = static_cast<int>(std::lround(center.y()));
  std::array<float, 25> values{};
  std::size_t count = 0;
  for (int row = -2; row <= 2; ++row) {
    for (int column = -2; column <= 2; ++column) {
      const int u = u0 + column * reach / 2, v = v0 + row * reach / 2;
      if (u < 0 || v < 0 || u >= depth_m.cols || v >= depth_m.rows) continue;
      const float z = depth_m.at<float>(v, u);
      if (z > 0.0F) values[count++] = z;
    }
  }
  if (count < kMinValues) return;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(count / 2);
  std::nth_element(values.begin(), middle, values.begin() + static_cast<std::ptrdiff_t>(count));
  const double z = *middle;
  const auto [lowest, highest] =
      std::minmax_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(count));
  const double spread_m = *highest - *lowest;
  const double noise_m = depth_sigma_m(z) + kRounding_m;
  if (spread_m > kStepShare * z + kNoiseRange * noise_m) return;
  const double slope_m = kSlopeShare * std::max(0.0, spread_m - kNoiseRange * noise_m);
  feature->depth_m = z;
  feature->depth_sigma_m = std::hypot(noise_m, slope_m);
}

}  // namespace

ImageFeatures extract_features(const RgbdImage& image, const FrontendOptions& options, const Camera& camera,
                               const DepthRegistration& registration) {
  ImageFeatures result;
  std::vector<cv::Vec2f> raw_pixels;
  const double ratio = 1.0 / options.scale_factor;
  double share = (1.0 - ratio) / (1.0 - std::pow(ratio, options.levels));
  cv::Mat level_image = image.gray;
  for (int level = 0; level < options.levels; ++level) {
    const double scale = std::pow(options.scale_factor, level);
    if (level > 0) {
      const cv::Size size(static_cast<int>(std::lround(image.gray.cols / scale)),
                          static_cast<int>(std::lround(image.gray.rows / scale)));
      if (size.width <= 2 * kBorder_px || size.height <= 2 * kBorder_px) break;
      cv::Mat smaller;
      cv::resize(level_image, smaller, size, 0.0, 0.0, cv::INTER_LINEAR);
      level_image = smaller;
    }
    const int wanted = static_cast<int>(std::lround(options.features * share));
    extract_level(level_image, level, scale, wanted, options, camera, &raw_pixels, &result);
    share *= ratio;
  }
  for (std::size_t i = 0; i < result.size(); ++i) {
    const Vec2 center = registration.find_depth(camera, Vec2(raw_pixels[i][0], raw_pixels[i][1]), image.depth_m);
    measure_depth(image.depth_m, center, std::max(options.registration_px, 1), &result.features[i]);
  }
  result.index(camera);
  return result;
}

}  // namespace semantic_topo_loop::core
