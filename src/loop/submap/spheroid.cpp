#include "loop/submap/spheroid.h"

#include <algorithm>
#include <cmath>

#include "geometry/depth_points.h"
#include "geometry/least_squares.h"
#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinDepthSquared = 1e-6;  ///< m^2: a spheroid that comes within a millimetre of the camera's plane
/// It starts from a triangulated centre, and what closes a loop is refined once more.
constexpr LeastSquaresOptions kFitSolver{8, 1e-3, 1e-4};
constexpr double kFitSigmaPx = 4.0;         ///< of a box edge, as the default of loop.refine_sigma_px
constexpr double kLogAxisPriorSigma = 0.5;  ///< a factor of 1.6: the boxes of a short arc leave the shape loose
constexpr double kMinHalfSize_m = 0.01;     ///< of an object at the start of its fit

/// Entry (i, j) of the dual conic with its derivatives by the log axes; those by the other vectors have one or two
/// numbers that are not 0.
struct ConicEntry {
  double value;
  Vec2 d_log_axes;
};

ConicEntry conic_entry(int i, int j, const Vec3& c, const Vec3& w, double a2, double b2) {
  const double diagonal = i == j ? 1.0 : 0.0;
  const double ww = w(i) * w(j);
  return {a2 * diagonal + (b2 - a2) * ww - c(i) * c(j), Vec2(2.0 * a2 * (diagonal - ww), 2.0 * b2 * ww)};
}

/// Derivative of f(v_i v_i, v_i v_z, v_z v_z) by v; with a multiple of v, of its products times that.
/// @param gradient of f
Eigen::RowVector3d by_products(const Vec3& gradient, int i, const Vec3& v) {
  Eigen::RowVector3d row = Eigen::RowVector3d::Zero();
  row(i) = gradient(0) * (2.0 * v(i)) + gradient(1) * v.z();
  row(2) = gradient(1) * v(i) + gradient(2) * (2.0 * v.z());
  return row;
}

/// Tangent lines u of C_ii - 2 u C_i2 + u^2 C_22 = 0; f(C_ii, C_i2, C_22) and its gradient.
struct Tangent {
  double u;
  Vec3 gradient;  ///< by C_ii, C_i2, C_22
};

std::optional<Tangent> tangent(double C_ii, double C_i2, double C_22, double sign) {
  const double discriminant = C_i2 * C_i2 - C_ii * C_22;
  if (!(discriminant > 1e-14)) return std::nullopt;
  const double root = std::sqrt(discriminant);
  const double u = (C_i2 + sign * root) / C_22;
  const double d_C_ii = -sign * 0.5 / root;
  const double d_C_i2 = (1.0 + sign * C_i2 / root) / C_22;
  const double d_C_22 = (-sign * 0.5 * C_ii / root - u) / C_22;
  return Tangent{u, Vec3(d_C_ii, d_C_i2, d_C_22)};
}

/// Half of a box's extent between two opposite sides; of those that are cut, it is the least that it can be.
class HalfSizes {
 public:
  void add(double half_m, bool is_cut) { (is_cut ? cut_ : whole_).push_back(half_m); }
  double log_of_usual() {
    const bool is_known = !whole_.empty() && 3 * whole_.size() >= cut_.size();
    const double half_m = is_known ? median(std::move(whole_)) : high(std::move(cut_));
    return std::log(std::max(half_m, kMinHalfSize_m));
  }

 private:
  /// A tenth are higher.
  static double high(std::vector<double> values) {
    const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 9 / 10);
    std::nth_element(values.begin(), at, values.end());
    return *at;
  }
  std::vector<double> whole_, cut_;
};

/// Half width and half height of the boxes at their depths, as logs.
Vec2 log_axes_of_boxes(const LocalMap& map, const std::vector<SubmapView>& views, const Vec3& center) {
  HalfSizes halves_x, halves_y;
  for (const SubmapView& view : views) {
    const double depth = map.frames[static_cast<std::size_t>(view.frame)].to_camera(center).z();
    halves_x.add(0.5 * depth * view.box.width(), (view.truncated & 0b0101) != 0);
    halves_y.add(0.5 * depth * view.box.height(), (view.truncated & 0b1010) != 0);
  }
  return {halves_x.log_of_usual(), halves_y.log_of_usual()};
}

/// Shared unknowns: centre and log axes. There are no blocks; their size says nothing.
using Equations = ArrowEquations<5, 5>;
using Unknowns = ArrowUnknowns<5, 5>;

/// The box edges and depths with soft-L1 weights and a weak prior on the axes.
struct FitProblem {
  const LocalMap& map;
  const std::vector<SubmapView>& views;
  Vec2 prior_log_axes;

  /// @return false if a view cannot see the spheroid
  bool operator()(const Unknowns& unknowns, Equations* equations) const {
    const Vec3 center = unknowns.shared.head<3>();
    const Vec2 log_axes = unknowns.shared.tail<2>();
    Equations::MatS& H = equations->H_shared;
    Equations::VecS& g = equations->g_shared;
    H.setZero();
    g.setZero();
    const Vec2 prior = (log_axes - prior_log_axes) / kLogAxisPriorSigma;
    H.diagonal().tail<2>().setConstant(1.0 / (kLogAxisPriorSigma * kLogAxisPriorSigma));
    g.tail<2>() = prior / kLogAxisPriorSigma;
    equations->cost = prior.squaredNorm();
    for (const SubmapView& view : views) {
      const LocalFrame& frame = map.frames[static_cast<std::size_t>(view.frame)];
      const auto projection =
          project_spheroid(frame.to_camera(center), frame.R_camera_local * map.up.direction, log_axes);
      if (!projection) return false;
      Vec4 scale = Vec4(frame.focal_px.x(), frame.focal_px.y(), frame.focal_px.x(), frame.focal_px.y()) / kFitSigmaPx;
      leave_out_cut(view, &scale);
      Eigen::Matrix<double, 4, 5> J;
      J << projection->d_center * frame.R_camera_local, projection->d_log_axes;
      J = scale.asDiagonal() * J;
      const Vec4 r = scale.cwiseProduct(projection->edges - view.box.edges());
      const Vec4 root = (Vec4::Ones() + r.cwiseAbs2()).cwiseSqrt();
      const Vec4 weight = root.cwiseInverse();
      equations->cost += 2.0 * (root.sum() - 4.0);
      H += J.transpose() * weight.asDiagonal() * J;
      g += J.transpose() * weight.cwiseProduct(r);
      if (view.depth_m > 0.0) add_depth(view, frame, center, equations);
    }
    return std::isfinite(equations->cost);
  }

  static void add_depth(const SubmapView& view, const LocalFrame& frame, const Vec3& center, Equations* equations) {
    const double sigma = depth_sigma_m(view), r = (frame.to_camera(center).z() - view.depth_m) / sigma;
    const Vec3 J = frame.R_camera_local.row(2).transpose() / sigma;
    const double root = std::sqrt(1.0 + r * r);
    equations->cost += 2.0 * (root - 1.0);
    equations->H_shared.topLeftCorner<3, 3>() += J * J.transpose() / root;
    equations->g_shared.head<3>() += J * (r / root);
  }
};

}  // namespace

std::optional<SpheroidProjection> project_spheroid(const Vec3& c, const Vec3& w, const Vec2& log_axes) {
  const double a2 = std::exp(2.0 * log_axes(0)), b2 = std::exp(2.0 * log_axes(1));
  const ConicEntry C_22 = conic_entry(2, 2, c, w, a2, b2);
  if (!(c.z() > 0.0) || !(C_22.value < -kMinDepthSquared)) return std::nullopt;
  SpheroidProjection projection;
  for (int i = 0; i < 2; ++i) {
    const ConicEntry C_ii = conic_entry(i, i, c, w, a2, b2);
    const ConicEntry C_i2 = conic_entry(i, 2, c, w, a2, b2);
    for (int side = 0; side < 2; ++side) {
      // C_22 < 0, so the smaller tangent has the positive root.
      const auto line = tangent(C_ii.value, C_i2.value, C_22.value, side == 0 ? 1.0 : -1.0);
      if (!line) return std::nullopt;
      const int row = 2 * side + i;
      const Vec3& g = line->gradient;
      projection.edges(row) = line->u;
      projection.d_center.row(row) = by_products(g, i, -c);
      projection.d_axis.row(row) = by_products(g, i, (b2 - a2) * w);
      projection.d_log_axes.row(row) =
          (g(0) * C_ii.d_log_axes + g(1) * C_i2.d_log_axes + g(2) * C_22.d_log_axes).transpose();
    }
  }
  return projection;
}

std::optional<Box> spheroid_box(const Vec3& c, const Vec3& w, const Vec2& log_axes) {
  const double a2 = std::exp(2.0 * log_axes(0)), b2 = std::exp(2.0 * log_axes(1));
  const double C_22 = a2 + (b2 - a2) * w.z() * w.z() - c.z() * c.z();
  if (!(c.z() > 0.0) || !(C_22 < -kMinDepthSquared)) return std::nullopt;
  double edges[4];
  for (int i = 0; i < 2; ++i) {
    const double C_ii = a2 + (b2 - a2) * w(i) * w(i) - c(i) * c(i);
    const double C_i2 = (b2 - a2) * w(i) * w.z() - c(i) * c.z();
    const double discriminant = C_i2 * C_i2 - C_ii * C_22;
    if (!(discriminant > 0.0)) return std::nullopt;
    const double root = std::sqrt(discriminant);
    edges[i] = (C_i2 + root) / C_22;
    edges[2 + i] = (C_i2 - root) / C_22;
  }
  return Box{edges[0], edges[1], edges[2], edges[3]};
}

void leave_out_cut(const SubmapView& view, Vec4* weights) {
  for (int side = 0; side < 4; ++side) {
    if ((view.truncated & 1 << side) != 0) (*weights)(side) = 0.0;
  }
}

double depth_sigma_m(const SubmapView& view) {
  constexpr double kNoise_m = 0.01, kNoiseShare = 0.1;  // of what is in the middle of the box, by its size
  const double radius_m = 0.5 * view.depth_m * view.box.size();
  return kNoise_m + kNoiseShare * radius_m + depth_sigma_m(view.depth_m);
}

std::optional<SpheroidFit> fit_spheroid(const LocalMap& map, const std::vector<SubmapView>& views, const Vec3& center) {
  const FitProblem problem{map, views, log_axes_of_boxes(map, views, center)};
  Unknowns unknowns;
  unknowns.shared << center, problem.prior_log_axes;
  Equations equations;
  if (!minimise(kFitSolver, problem, &unknowns, &equations)) return std::nullopt;
  const Equations::MatS inverse = equations.H_shared.ldlt().solve(Equations::MatS::Identity());
  SpheroidFit fit;
  fit.spheroid.center = unknowns.shared.head<3>();
  fit.spheroid.log_axes = unknowns.shared.tail<2>();
  fit.center_covariance = inverse.topLeftCorner<3, 3>();
  if (!fit.spheroid.center.allFinite() || !fit.center_covariance.allFinite()) return std::nullopt;
  return fit;
}

}  // namespace semantic_topo_loop::core
