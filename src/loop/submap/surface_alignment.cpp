#include "loop/submap/surface_alignment.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// One round of the registration, from coarse to fine. The last one weighs what the surfaces say against the estimate
/// that it all began with; those before look for the place where they meet, and are held by it loosely.
struct Round {
  double radius_m;      ///< in which a surfel's partner is looked for
  double gate_m;        ///< of the distance along the normal
  double min_cosine;    ///< between the two normals
  std::size_t surfels;  ///< of b that are used
  int iterations;
  bool is_last;
};
constexpr std::array<Round, 4> kRounds = {{{0.4, 0.4, 0.5, 500, 12, false},
                                           {0.2, 0.2, 0.7, 800, 8, false},
                                           {0.15, 0.08, 0.8, 1000, 4, false},
                                           {0.15, 0.08, 0.8, 2000, 5, true}}};
constexpr float kNormalLength_m = 0.3F;    ///< by which normals count in the choice of partners: a face is no edge away
constexpr double kBlock_m = 0.5;           ///< surfels of one cube count as one measurement
constexpr std::size_t kMinMatches = 100;   ///< 0.4 m^2 of surface
constexpr double kSmallStep = 1e-5;        ///< m, rad
constexpr std::size_t kParts = 8;          ///< of a submap, by time: more than a pose has dimensions
constexpr double kMinSigma_m = 0.003;      ///< quantised depth at a metre
constexpr double kNormalError_rad = 0.05;  ///< of surfels far away, and of surfaces that are not quite flat

/// Finds surfels by place, in a grid of cubes as wide as the search radius, wider where there would be very many.
class SurfelGrid {
 public:
  SurfelGrid(const std::vector<Surfel>& surfels, double radius_m)
      : surfels_(surfels), radius_(static_cast<float>(radius_m)) {
    Eigen::Vector3f high = surfels.front().position;
    low_ = high;
    for (const Surfel& surfel : surfels) {
      low_ = low_.cwiseMin(surfel.position);
      high = high.cwiseMax(surfel.position);
    }
    constexpr float kMaxCells = 64.0F;  // along each axis: 1 MB
    cell_ = std::max(radius_, (high - low_).maxCoeff() / kMaxCells);
    size_ = ((high - low_) / cell_).array().floor().cast<int>() + 1;
    begin_.assign(static_cast<std::size_t>(size_.prod()) + 1, 0);
    std::vector<std::size_t> cell;
    cell.reserve(surfels.size());
    for (const Surfel& surfel : surfels) {
      const Eigen::Array3i at = cell_of(surfel.position);
      cell.push_back(number(at.x(), at.y(), at.z()));
      ++begin_[cell.back() + 1];
    }
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    order_.resize(surfels.size());
    std::vector<std::uint32_t> next = begin_;
    for (std::size_t i = 0; i < surfels.size(); ++i) order_[next[cell[i]]++] = static_cast<std::uint32_t>(i);
  }

  /// The nearest in place and normal within the radius; null if there is none.
  const Surfel* nearest(const Eigen::Vector3f& position, const Eigen::Vector3f& normal) const {
    const Surfel* best = nullptr;
    float least = std::numeric_limits<float>::infinity();
    const Eigen::Array3i at = cell_of(position);
    const Eigen::Array3i first = (at - 1).max(0), last = (at + 1).min(size_ - 1);
    for (int x = first.x(); x <= last.x(); ++x) {
      for (int y = first.y(); y <= last.y(); ++y) {
        if (first.z() > last.z()) continue;
        const std::uint32_t end = begin_[number(x, y, last.z()) + 1];
        for (std::uint32_t i = begin_[number(x, y, first.z())]; i < end; ++i) {
          const Surfel& surfel = surfels_[order_[i]];
          const float away = (surfel.position - position).squaredNorm();
          if (away > radius_ * radius_) continue;
          const float distance = away + kNormalLength_m * kNormalLength_m * (surfel.normal - normal).squaredNorm();
          if (distance >= least) continue;
          least = distance;
          best = &surfel;
        }
      }
    }
    return best;
  }

 private:
  Eigen::Array3i cell_of(const Eigen::Vector3f& position) const {
    return ((position - low_) / cell_).array().floor().max(-2.0F).min(1e6F).cast<int>();
  }
  std::size_t number(int x, int y, int z) const {
    return static_cast<std::size_t>((x * size_.y() + y) * size_.z() + z);
  }

  const std::vector<Surfel>& surfels_;
  float radius_, cell_;
  Eigen::Vector3f low_;
  Eigen::Array3i size_;
  std::vector<std::uint32_t> begin_, order_;
};

/// A surfel of b with its partner in a.
struct Match {
  double distance;  ///< along the common normal, m
  Vec6 J;           ///< of the distance by a right perturbation of T_a_b
  Vec3 position_b;
  std::size_t part_a, part_b;  ///< of the submaps, by the order of their surfels: that in which they were seen
};

std::vector<Match> find_matches(const SurfelGrid& grid, const std::vector<Surfel>& a, const std::vector<Surfel>& b,
                                const SE3& T_a_b, const Round& round) {
  const Mat3 R_a_b = T_a_b.rotation();
  const Eigen::Matrix3f R = R_a_b.cast<float>();
  const Eigen::Vector3f t = T_a_b.t.cast<float>();
  const std::size_t step = (b.size() + round.surfels - 1) / round.surfels;
  std::vector<Match> matches;
  matches.reserve(b.size() / step + 1);
  for (std::size_t i = 0; i < b.size(); i += step) {
    const Eigen::Vector3f position = R * b[i].position + t, normal = R * b[i].normal;
    const Surfel* partner = grid.nearest(position, normal);
    if (partner == nullptr || static_cast<double>(partner->normal.dot(normal)) < round.min_cosine) continue;
    const Vec3 n = (partner->normal + normal).cast<double>().normalized();
    const double distance = n.dot((position - partner->position).cast<double>());
    if (std::abs(distance) > round.gate_m) continue;
    const Vec3 position_b = b[i].position.cast<double>(), n_b = R_a_b.transpose() * n;
    const auto number_a = static_cast<std::size_t>(partner - a.data());
    Match match{distance, Vec6::Zero(), position_b, kParts * number_a / a.size(), kParts * i / b.size()};
    match.J << n_b, position_b.cross(n_b);
    matches.push_back(match);
  }
  return matches;
}

double robust_sigma(const std::vector<Match>& matches) {
  std::vector<double> distances;
  distances.reserve(matches.size());
  for (const Match& match : matches) distances.push_back(std::abs(match.distance));
  return std::max(1.4826 * median(std::move(distances)), kMinSigma_m);
}

/// How many matches make one independent measurement: those of one cube err together.
double redundancy(const std::vector<Match>& matches) {
  std::set<std::tuple<int, int, int>> blocks;
  for (const Match& match : matches) {
    const Eigen::Array3i block = (match.position_b / kBlock_m).array().floor().cast<int>();
    blocks.emplace(block.x(), block.y(), block.z());
  }
  return static_cast<double>(matches.size()) / static_cast<double>(std::max<std::size_t>(blocks.size(), 1));
}

struct NormalEquations {
  Mat6 H = Mat6::Zero();
  Vec6 g = Vec6::Zero();
};

/// Takes out the directions that only errors of the normals seem to measure, as those along a bare wall.
/// @param noise what such errors are expected to add to H
/// @param lever_m that makes a rotation as large as a translation
void keep_observed(const Mat6& noise, double lever_m, NormalEquations* equations) {
  constexpr double kMaxNoiseShare = 0.5;
  Vec6 unit;
  unit << Vec3::Ones(), Vec3::Constant(lever_m);
  const Mat6 to_m = unit.cwiseInverse().asDiagonal(), from_m = unit.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Mat6> solver(to_m * equations->H * to_m);
  Mat6 kept = Mat6::Zero();
  for (int i = 0; i < 6; ++i) {
    const Vec6 v = solver.eigenvectors().col(i);
    if (v.dot(to_m * noise * to_m * v) < kMaxNoiseShare * solver.eigenvalues()(i)) kept += v * v.transpose();
  }
  equations->H = from_m * kept * to_m * equations->H * to_m * kept * from_m;
  equations->g = from_m * kept * to_m * equations->g;
}

/// What was seen at one time errs together, by odometry that drifts and depth that is distorted: how much, the parts of
/// a submap say, seen one after the other, by how far they pull apart (a clustered sandwich estimate).
struct Pulls {
  std::array<Vec6, kParts> g = {};
  std::array<double, kParts> weight = {};

  Pulls() { g.fill(Vec6::Zero()); }
  void add(std::size_t part, double w, const Vec6& pull) {
    g[part] += pull;
    weight[part] += w;
  }
  /// Of the gradient.
  Mat6 covariance() const {
    Vec6 sum = Vec6::Zero();
    double weights = 0.0;
    for (std::size_t k = 0; k < kParts; ++k) {
      sum += g[k];
      weights += weight[k];
    }
    Mat6 result = Mat6::Zero();
    for (std::size_t k = 0; k < kParts; ++k) {
      const Vec6 beyond = g[k] - weight[k] / weights * sum;
      result.noalias() += beyond * beyond.transpose();
    }
    return static_cast<double>(kParts) / static_cast<double>(kParts - 1) * result;
  }
};

/// Errors that all surfels of a submap have in common: distortions of the depth, of which a fit leaves about the share
/// that it takes for motion, over surfaces some metres wide; and drift of the odometry between the anchor and other
/// frames.
Mat6 systematic_covariance(double sigma_m, double drift_rad) {
  constexpr double kMetrePerSigma_m = 1.5, kRadianPerSigma_m = 1.0, kDepth_m = 2.0;
  const Vec2 translation_m(kMetrePerSigma_m * sigma_m, kDepth_m * drift_rad);
  const Vec2 rotation_rad(kRadianPerSigma_m * sigma_m, drift_rad);
  Vec6 variance;
  variance << Vec3::Constant(translation_m.squaredNorm()), Vec3::Constant(rotation_rad.squaredNorm());
  return variance.asDiagonal();
}

/// Of the odometry in both submaps, rad: a quarter of the span is the mean time from its middle.
double drift_rad(const LocalMap& a, const LocalMap& b) {
  return 0.25 * std::hypot(a.drift_rad_s * a.span_s, b.drift_rad_s * b.span_s);
}

/// Gauss-Newton with Geman-McClure weights, in the measure of what the matches really tell: H and g are multiplied by
/// H M^-1, M being the covariance of g. The matches of one cube count as one (uneven surfaces, quantised depth); in the
/// last round, what a submap's surfels have in common and what its parts disagree about count too.
NormalEquations linearise(const std::vector<Match>& matches, double sigma, bool is_last, double drift) {
  NormalEquations equations;
  Mat6 noise = Mat6::Zero();
  Pulls pulls_a, pulls_b;
  double weights = 0.0, square_levers = 0.0;
  for (const Match& match : matches) {
    const double ratio = match.distance / (3.0 * sigma), root = 1.0 / (1.0 + ratio * ratio), w = root * root;
    const Vec6 pull = w * match.distance * match.J;
    equations.H.noalias() += w * match.J * match.J.transpose();
    equations.g += pull;
    pulls_a.add(match.part_a, w, pull);
    pulls_b.add(match.part_b, w, pull);
    const Vec3 normal = match.J.head<3>();
    Eigen::Matrix<double, 6, 3> J_by_normal;
    J_by_normal << Mat3::Identity(), hat(match.position_b);
    noise.noalias() += w * J_by_normal * (Mat3::Identity() - normal * normal.transpose()) * J_by_normal.transpose();
    weights += w;
    square_levers += w * match.position_b.squaredNorm();
  }
  Mat6 M = sigma * sigma * redundancy(matches) * equations.H;
  if (is_last) {
    M += pulls_a.covariance() + pulls_b.covariance() + equations.H * systematic_covariance(sigma, drift) * equations.H;
  }
  M.diagonal().array() += 1e-9 * M.trace();  // what noiseless planes leave free
  keep_observed(kNormalError_rad * kNormalError_rad * noise, std::sqrt(square_levers / weights), &equations);
  const Mat6 measure = M.ldlt().solve(equations.H).transpose();  // H M^-1
  equations.g = measure * equations.g;
  equations.H = measure * equations.H;
  return equations;
}

/// Of the estimate that the registration began with: e = log(T_0^-1 T).
void add_prior(const SE3& T_0, const Mat6& information, const SE3& T, NormalEquations* equations) {
  const Vec6 e = se3_log(T_0.inverse() * T);
  Mat6 J = Mat6::Zero();
  J.topLeftCorner<3, 3>() = (T_0.q.conjugate() * T.q).toRotationMatrix();
  J.bottomRightCorner<3, 3>() = right_jacobian_inverse(e.tail<3>());
  equations->H.noalias() += J.transpose() * information * J;
  equations->g.noalias() += J.transpose() * information * e;
}

/// What the cameras of a submap see of its surfels, coarsely: the nearest in each cell of an image.
class DepthView {
 public:
  DepthView(const LocalFrame& frame, const std::vector<Surfel>& surfels) : frame_(frame) {
    columns_ = cells(frame.image.width());
    rows_ = cells(frame.image.height());
    depth_.assign(static_cast<std::size_t>(columns_ * rows_), std::numeric_limits<double>::infinity());
    for (const Surfel& surfel : surfels) {
      const Vec3 p = frame.to_camera(surfel.position.cast<double>());
      if (p.z() < kNear_m || (frame.R_camera_local * surfel.normal.cast<double>()).dot(p) > 0.0) continue;
      const double u = p.x() / p.z(), v = p.y() / p.z(), r = kSplat_m / p.z();
      for (int row = std::max(0, cell(v - r - frame.image.y1));
           row <= std::min(rows_ - 1, cell(v + r - frame.image.y1)); ++row) {
        for (int column = std::max(0, cell(u - r - frame.image.x1));
             column <= std::min(columns_ - 1, cell(u + r - frame.image.x1)); ++column) {
          double& depth = depth_[static_cast<std::size_t>(row * columns_ + column)];
          depth = std::min(depth, p.z());
        }
      }
    }
  }

  enum class Sight { kNone, kAgrees, kSeenThrough };
  /// @param position, normal of a surfel of the other submap, in this one's frame   @return none if it is hidden, or
  /// seen too flat or not at all
  Sight look(const Vec3& position, const Vec3& normal) const {
    const Vec3 p = frame_.to_camera(position);
    if (p.z() < kNear_m || (frame_.R_camera_local * normal).dot(p) > -kMinSlant * p.norm()) return Sight::kNone;
    const int column = cell(p.x() / p.z() - frame_.image.x1), row = cell(p.y() / p.z() - frame_.image.y1);
    if (column < 0 || column >= columns_ || row < 0 || row >= rows_) return Sight::kNone;
    const double depth = depth_[static_cast<std::size_t>(row * columns_ + column)];
    if (!std::isfinite(depth)) return Sight::kNone;
    const double tolerance = kTolerance_m + kToleranceShare * p.z();
    if (p.z() < depth - tolerance) return Sight::kSeenThrough;
    return p.z() < depth + tolerance ? Sight::kAgrees : Sight::kNone;
  }

 private:
  static constexpr double kCell = 0.06;            ///< on the plane z = 1: 30 px of a Kinect
  static constexpr double kNear_m = 0.3;           ///< nearer, depth cameras see nothing
  static constexpr double kSplat_m = 0.08;         ///< radius: surfels are up to 0.1 m apart
  static constexpr double kMinSlant = 0.3;         ///< cosine: on surfaces seen flatter, a cell holds many depths
  static constexpr double kTolerance_m = 0.1;      ///< the poses that are judged are good to a few centimetres,
  static constexpr double kToleranceShare = 0.03;  ///< and to two degrees
  static int cells(double length) { return std::clamp(static_cast<int>(std::ceil(length / kCell)), 1, 100); }
  static int cell(double offset) { return static_cast<int>(std::floor(offset / kCell)); }

  const LocalFrame& frame_;
  int columns_, rows_;
  std::vector<double> depth_;
};

void compare_one_way(const LocalMap& viewer, const LocalMap& seen, const SE3& T_viewer_seen, SurfaceAgreement* sum) {
  std::vector<DepthView> views;
  for (const int i : viewer.check_frames)
    views.emplace_back(viewer.frames[static_cast<std::size_t>(i)], *viewer.surfels);
  const Mat3 R = T_viewer_seen.rotation();
  for (const Surfel& surfel : *seen.surfels) {
    const Vec3 position = T_viewer_seen * surfel.position.cast<double>(), normal = R * surfel.normal.cast<double>();
    int agrees = 0, seen_through = 0;
    for (const DepthView& view : views) {
      const DepthView::Sight sight = view.look(position, normal);
      agrees += sight == DepthView::Sight::kAgrees ? 1 : 0;
      seen_through += sight == DepthView::Sight::kSeenThrough ? 1 : 0;
    }
    if (agrees + seen_through == 0) continue;
    ++sum->judged;
    if (seen_through > agrees) ++sum->contradicted;
  }
}

}  // namespace

std::optional<SurfaceAlignment> align_surfaces(const LocalMap& map_a, const LocalMap& map_b, const SE3& T_a_b,
                                               const Mat6& covariance) {
  const std::vector<Surfel>&a = *map_a.surfels, &b = *map_b.surfels;
  if (a.empty() || b.empty()) return std::nullopt;
  const Mat6 information = covariance.llt().solve(Mat6::Identity());
  const double drift = drift_rad(map_a, map_b);
  SurfaceAlignment result;
  result.T_a_b = T_a_b;
  for (const Round& round : kRounds) {
    const SurfelGrid grid(a, round.radius_m);
    for (int i = 0; i < round.iterations; ++i) {
      const std::vector<Match> matches = find_matches(grid, a, b, result.T_a_b, round);
      if (matches.size() < kMinMatches) return std::nullopt;
      NormalEquations equations = linearise(matches, robust_sigma(matches), round.is_last, drift);
      add_prior(T_a_b, information, result.T_a_b, &equations);
      const Eigen::LDLT<Mat6> ldlt(equations.H);
      const Vec6 step = -ldlt.solve(equations.g);
      if (!step.allFinite()) return std::nullopt;
      result.T_a_b = result.T_a_b * se3_exp(step);
      result.covariance = ldlt.solve(Mat6::Identity());
      if (step.norm() < kSmallStep) break;
    }
  }
  return result;
}

SurfaceAgreement compare_surfaces(const LocalMap& a, const LocalMap& b, const SE3& T_a_b) {
  SurfaceAgreement agreement;
  compare_one_way(a, b, T_a_b, &agreement);
  compare_one_way(b, a, T_a_b.inverse(), &agreement);
  return agreement;
}

}  // namespace semantic_topo_loop::core
