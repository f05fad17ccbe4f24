#include "loop/submap/feature_alignment.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <map>
#include <random>
#include <utility>

#include "geometry/depth_points.h"
#include "geometry/descriptor.h"
#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kMaxFeatures = 500;
constexpr float kSearch_m = 0.5F;  ///< by which objects alone may be off, and what is far from the anchors more
constexpr double kClear = 0.85;    ///< share of the bits of the second most similar that the most similar differs by
constexpr int kMinPoints = 20;     ///< about where they should be
constexpr int kMinPointsAnywhere = 30;  ///< and of more than one thing, of which there may be two:
constexpr double kMinSpread_m = 0.2;
constexpr double kPixel = 2e-3;  ///< a pixel of 525 to the metre: across the ray
constexpr double kGate = 3.0;    ///< in standard deviations

/// Two features that look alike.
struct FeaturePair {
  Vec3 a, b;           ///< positions in the two submaps, m
  double sigma = 0.0;  ///< of a coordinate of their difference, m
};

double sigma_m(const Vec3& position) {
  const double range_m = position.norm();
  return std::hypot(kPixel * range_m, depth_sigma_m(range_m));
}

/// For each feature of `from` that of `to` which is most like it, or -1.
/// @param T_to_from about where it should be, or nullopt
std::vector<int> most_similar(const std::vector<PointFeature>& from, const std::vector<PointFeature>& to,
                              const std::optional<SE3>& T_to_from) {
  const Eigen::Matrix3f R = T_to_from.value_or(SE3()).rotation().cast<float>();
  const Eigen::Vector3f t = T_to_from.value_or(SE3()).t.cast<float>();
  std::vector<int> result;
  result.reserve(from.size());
  for (const PointFeature& feature : from) {
    const Eigen::Vector3f expected = R * feature.position + t;
    int best = std::numeric_limits<int>::max(), second = best, index = -1;
    for (std::size_t i = 0; i < to.size(); ++i) {
      if (T_to_from && (to[i].position - expected).squaredNorm() > kSearch_m * kSearch_m) continue;
      const int bits = hamming(feature.descriptor, to[i].descriptor);
      if (bits < best) {
        second = std::exchange(best, bits);
        index = static_cast<int>(i);
      } else {
        second = std::min(second, bits);
      }
    }
    result.push_back(best <= kSimilarBits && best < kClear * second ? index : -1);
  }
  return result;
}

/// Mutually most similar ones.
std::vector<FeaturePair> find_pairs(const std::vector<PointFeature>& a, const std::vector<PointFeature>& b,
                                    const std::optional<SE3>& T_a_b) {
  const std::vector<int> a_of_b = most_similar(b, a, T_a_b);
  const std::vector<int> b_of_a = most_similar(a, b, T_a_b ? std::optional(T_a_b->inverse()) : std::nullopt);
  std::vector<FeaturePair> pairs;
  for (std::size_t i = 0; i < b.size(); ++i) {
    if (a_of_b[i] < 0 || b_of_a[static_cast<std::size_t>(a_of_b[i])] != static_cast<int>(i)) continue;
    const Vec3 position_a = a[static_cast<std::size_t>(a_of_b[i])].position.cast<double>();
    const Vec3 position_b = b[i].position.cast<double>();
    pairs.push_back({position_a, position_b, std::hypot(sigma_m(position_a), sigma_m(position_b))});
  }
  return pairs;
}

double distance(const FeaturePair& pair, const SE3& T_a_b) { return (T_a_b * pair.b - pair.a).norm() / pair.sigma; }

int count(const std::vector<FeaturePair>& pairs, const SE3& T_a_b, double gate) {
  const auto agrees = [&](const FeaturePair& pair) { return distance(pair, T_a_b) < gate; };
  return static_cast<int>(std::count_if(pairs.begin(), pairs.end(), agrees));
}

/// Whether three pairs are at the same distances in both submaps, and far enough apart to tell a pose.
bool is_rigid(const std::array<const FeaturePair*, 3>& three) {
  constexpr double kApart_m = 0.1;
  for (std::size_t i = 0; i < 3; ++i) {
    const FeaturePair &p = *three[i], &q = *three[(i + 1) % 3];
    const double in_a = (p.a - q.a).norm(), in_b = (p.b - q.b).norm();
    if (in_a < kApart_m || std::abs(in_a - in_b) > kGate * std::hypot(p.sigma, q.sigma)) return false;
  }
  return true;
}

/// The pose of three pairs with which most agree.
std::optional<SE3> find_consensus(const std::vector<FeaturePair>& pairs, int min_points) {
  // Of 200 triples one is free of wrong pairs with 99 % if 30 % of them are right.
  constexpr int kMaxTested = 200, kDraws = 2000;
  constexpr double kWideGate = 2.0 * kGate;  // three points give a rough pose
  constexpr std::uint64_t kSeed = 20231108;  // any: the same input gives the same pose
  std::mt19937_64 generator(kSeed);
  std::optional<SE3> best;
  int best_count = min_points - 1;
  for (int draw = 0, tested = 0; draw < kDraws && tested < kMaxTested; ++draw) {
    std::array<const FeaturePair*, 3> three{};
    for (const FeaturePair*& pair : three) pair = &pairs[generator() % pairs.size()];
    if (!is_rigid(three)) continue;
    const auto alignment =
        align_points({three[0]->a, three[1]->a, three[2]->a}, {three[0]->b, three[1]->b, three[2]->b});
    if (!alignment) continue;
    ++tested;
    const int agreeing = count(pairs, alignment->T_a_b, kWideGate);
    if (agreeing <= best_count) continue;
    best_count = agreeing;
    best = alignment->T_a_b;
  }
  return best;
}

/// How far the points that agree are apart, in the second of their main directions, m.
double spread_m(const std::vector<FeaturePair>& pairs, const SE3& T_a_b) {
  std::vector<Vec3> a, b;
  for (const FeaturePair& pair : pairs) {
    if (distance(pair, T_a_b) >= kGate) continue;
    a.push_back(pair.a);
    b.push_back(pair.b);
  }
  const std::optional<Alignment> alignment = align_points(a, b);
  return alignment ? alignment->spread_m()(1) : 0.0;
}

/// Gauss-Newton with Geman-McClure weights.
std::optional<FeatureAlignment> refine(const std::vector<FeaturePair>& pairs, const SE3& T_a_b) {
  constexpr int kIterations = 10;
  FeatureAlignment result;
  result.T_a_b = T_a_b;
  for (int i = 0; i < kIterations; ++i) {
    Mat6 H = Mat6::Zero();
    Vec6 g = Vec6::Zero();
    const Mat3 R = result.T_a_b.rotation();
    for (const FeaturePair& pair : pairs) {
      const double ratio = distance(pair, result.T_a_b) / kGate, root = 1.0 / (1.0 + ratio * ratio);
      const double weight = root * root / (pair.sigma * pair.sigma);
      Eigen::Matrix<double, 3, 6> J;
      J << R, -R * hat(pair.b);
      H.noalias() += weight * J.transpose() * J;
      g.noalias() += weight * J.transpose() * (result.T_a_b * pair.b - pair.a);
    }
    const Eigen::LDLT<Mat6> ldlt(H);
    const Vec6 step = -ldlt.solve(g);
    if (!step.allFinite()) return std::nullopt;
    result.T_a_b = result.T_a_b * se3_exp(step);
    result.covariance = ldlt.solve(Mat6::Identity());
    if (step.norm() < 1e-6) break;
  }
  result.points = count(pairs, result.T_a_b, kGate);
  return result;
}

}  // namespace

std::shared_ptr<const std::vector<PointFeature>> make_features(const std::deque<ObservedFrame>& window,
                                                               std::size_t anchor) {
  struct Shown {
    Vec3 sum = Vec3::Zero();
    int times = 0;
    std::int64_t from_anchor_ns = std::numeric_limits<std::int64_t>::max();
    Descriptor descriptor{};
  };
  std::map<std::int64_t, Shown> points;
  const SE3 T_anchor_odom = window[anchor].T_odom_camera.inverse();
  for (const ObservedFrame& frame : window) {
    if (!frame.features) continue;
    const SE3 T_anchor_camera = T_anchor_odom * frame.T_odom_camera;
    const std::int64_t from_anchor_ns = std::abs(frame.stamp_ns - window[anchor].stamp_ns);
    for (const PointFeature& feature : *frame.features) {
      Shown& shown = points[feature.id];
      shown.sum += T_anchor_camera * feature.position.cast<double>();
      ++shown.times;
      if (from_anchor_ns >= shown.from_anchor_ns) continue;
      shown.from_anchor_ns = from_anchor_ns;
      shown.descriptor = feature.descriptor;
    }
  }
  if (points.empty()) return nullptr;
  std::vector<std::pair<int, std::int64_t>> often;
  often.reserve(points.size());
  for (const auto& [id, shown] : points) often.emplace_back(-shown.times, id);
  std::sort(often.begin(), often.end());
  often.resize(std::min(often.size(), kMaxFeatures));
  auto features = std::make_shared<std::vector<PointFeature>>();
  for (const auto& [times, id] : often) {
    const Shown& shown = points.at(id);
    const Vec3 mean = shown.sum / static_cast<double>(shown.times);
    features->push_back({id, mean.cast<float>(), shown.descriptor});
  }
  return features;
}

std::optional<FeatureAlignment> align_features(const LocalMap& a, const LocalMap& b, const std::optional<SE3>& T_a_b) {
  const std::vector<FeaturePair> pairs = find_pairs(*a.features, *b.features, T_a_b);
  const int min_points = T_a_b ? kMinPoints : kMinPointsAnywhere;
  if (static_cast<int>(pairs.size()) < min_points) return std::nullopt;
  const std::optional<SE3> consensus = find_consensus(pairs, min_points);
  if (!consensus) return std::nullopt;
  std::optional<FeatureAlignment> result = refine(pairs, *consensus);
  if (!result || result->points < min_points) return std::nullopt;
  if (!T_a_b && spread_m(pairs, result->T_a_b) < kMinSpread_m) return std::nullopt;
  constexpr double kMostSigma_m = 0.05, kMostSigma_rad = 0.05;  // beyond, as along one edge, surfaces know better
  const Mat6& C = result->covariance;
  if (std::sqrt(C.topLeftCorner<3, 3>().trace()) > kMostSigma_m) return std::nullopt;
  if (std::sqrt(C.bottomRightCorner<3, 3>().trace()) > kMostSigma_rad) return std::nullopt;
  constexpr double kSigma_m = 0.01, kSigma_rad = 0.005;  // of what the map around is bent
  result->covariance.diagonal().head<3>().array() += kSigma_m * kSigma_m;
  result->covariance.diagonal().tail<3>().array() += kSigma_rad * kSigma_rad;
  return result;
}

}  // namespace semantic_topo_loop::core
