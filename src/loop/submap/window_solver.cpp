#include "loop/submap/window_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "geometry/least_squares.h"
#include "geometry/relative_pose.h"
#include "geometry/statistics.h"
#include "loop/submap/frozen_odometry.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

// Chosen on the shared drifted_real files of fr2_desk and fr3_office, judged on those in drifted, which are made
// differently.
constexpr double kKnotInterval_s = 0.45;  ///< poses are solved for this often: boxes of closer frames are off alike
constexpr double kDriftSpan_s = 3.0;      ///< for which a drift lasts
constexpr double kBoxWeight = 0.5;        ///< what is left of a box's by errors that neighbours share
constexpr double kBoxDoubt = 2.0;         ///< sigmas, from which on boxes count less (Cauchy)
/// m/s and rad/s: how a camera may move while the odometry stands still.
constexpr double kUnseenRate = 0.5;
constexpr std::size_t kMinViews = 4;
constexpr int kMaxCutSides = 2;
constexpr double kMinDepth_m = 0.15;    ///< of an object before the camera
constexpr double kUnseenChi2 = 2300.0;  ///< of an object behind the camera: more than any in view
/// Sigmas of where an object starts from (m) and of the logarithm of its extent.
constexpr double kStartSigma = 1.0;

/// What an odometry is at least off by, a root second or a second, and the degrees of freedom that this counts as.
constexpr double kLeast_m = 0.0005, kLeastCount = 3.0;
/// Metres that a radian is worth, since the boxes of few objects do not tell turning from moving: the distance at which
/// they are usually seen. Degrees of freedom by which errors of the two, and of both together, are held to each other.
constexpr double kLever_m = 1.4, kTogetherCount = 30.0;
constexpr double kMemory_s = 20.0;        ///< in which evidence is forgotten
constexpr double kLearnInterval_s = 0.6;  ///< windows closer in time say the same
constexpr double kBoxRate = 0.1;          ///< by which the boxes' errors are learnt, a window
constexpr std::size_t kMinSides = 80;     ///< of boxes, for that
constexpr double kMaxBoxFactor = 5.0;     ///< either way: boxes of a simulation may be exact

using Vec5 = Eigen::Matrix<double, 5, 1>;
using Mat5 = Eigen::Matrix<double, 5, 5>;
using Mat65 = Eigen::Matrix<double, 6, 5>;

Vec6 by_kind(double translation, double rotation) {
  Vec6 values;
  values << Vec3::Constant(translation), Vec3::Constant(rotation);
  return values;
}
double squared(double x) { return x * x; }

struct View {
  int knot = -1;
  Box box;                     ///< on the plane z = 1
  std::uint8_t truncated = 0;  ///< Truncation bits: these sides bound nothing
  double sigma = 1.0;

  bool bounds(int side) const { return (truncated & (1 << side)) == 0; }
  int cut_sides() const {
    int count = 0;
    for (int side = 0; side < 4; ++side) count += bounds(side) ? 0 : 1;
    return count;
  }
};

/// What stays in view of one object: its place (m), and the logarithms of half its width and height (log m), which
/// change so slowly with the direction it is seen from that they count as constant.
struct Track {
  Vec5 start = Vec5::Zero();
  std::vector<View> views;  ///< in order of their knots
};

struct Problem {
  std::vector<SE3> T_odom_knot;                 ///< as the odometry has them
  std::vector<std::optional<Vec6>> velocities;  ///< there: (m/s, rad/s), camera frame; nothing where frames are sparse
  std::vector<SE3> start;                       ///< as T_odom_knot, turned by what the boxes moved while it was frozen
  std::vector<double> times_s;
  std::vector<int> drift_of;     ///< of each step, from a knot to the next
  std::vector<double> frozen_s;  ///< of each step: for how long the odometry stood still though the view moved
  std::vector<Track> tracks;
  int anchor = 0;
  WindowNoise noise;

  std::size_t steps() const { return T_odom_knot.size() - 1; }
  double duration_s(std::size_t step) const { return times_s[step + 1] - times_s[step]; }
  SE3 odometry(std::size_t step) const { return T_odom_knot[step].inverse() * T_odom_knot[step + 1]; }
  bool is_frozen(std::size_t step) const { return frozen_s[step] > 0.0; }
  /// Of the errors of a step, the drift taken off.
  Vec6 step_variances(std::size_t step) const {
    const double unseen = kUnseenRate * frozen_s[step];
    return duration_s(step) * by_kind(squared(noise.step_m), squared(noise.step_rad)) +
           by_kind(squared(unseen), squared(unseen));
  }
};

struct Unknowns {
  std::vector<SE3> T_odom_knot;
  std::vector<Vec6> drifts;  ///< (translation m/s, rotation rad/s), camera frame
  std::vector<Vec5> objects;

  bool is_finite() const {
    return std::all_of(T_odom_knot.begin(), T_odom_knot.end(), [](const SE3& T) { return T.is_finite(); });
  }
};

/// Normal equations of knots, then drifts, with the objects apart: H step = -g, the lower triangle of H.
struct Equations {
  using Unknowns = core::Unknowns;

  Eigen::MatrixXd H;
  Eigen::VectorXd g;
  std::vector<Mat5> H_object;
  std::vector<Vec5> g_object;
  std::vector<std::vector<std::pair<Eigen::Index, Mat65>>> H_knot_object;  ///< by the knot's row
  double cost = 0.0;
  Eigen::MatrixXd S;  ///< of reduce()

  void reset(const Problem& problem, const Unknowns& unknowns) {
    const auto n = static_cast<Eigen::Index>(6 * (unknowns.T_odom_knot.size() + unknowns.drifts.size()));
    H.setZero(n, n);
    S.resize(n, n);
    g.setZero(n);
    H_object.assign(unknowns.objects.size(), Mat5::Identity() / squared(kStartSigma));
    g_object.clear();
    H_knot_object.resize(unknowns.objects.size());
    for (auto& by_knot : H_knot_object) by_knot.clear();  // their memory stays
    cost = 0.0;
    for (std::size_t k = 0; k < unknowns.objects.size(); ++k) {
      const Vec5 moved = unknowns.objects[k] - problem.tracks[k].start;
      g_object.push_back(moved / squared(kStartSigma));
      cost += moved.squaredNorm() / squared(kStartSigma);
    }
  }

  /// Eliminates the objects (Schur complement).
  /// @return information of knots and drifts, its lower triangle; its root, if the step was asked for. Here, not a copy
  Eigen::MatrixXd& reduce(double damping, const Unknowns& unknowns, Unknowns* next) {
    S.triangularView<Eigen::Lower>() = H;
    S.diagonal() *= 1.0 + damping;
    Eigen::VectorXd b = g;
    std::vector<Mat5> inverses;
    inverses.reserve(H_object.size());
    for (std::size_t k = 0; k < H_object.size(); ++k) {
      Mat5 object = H_object[k];
      object.diagonal() *= 1.0 + damping;
      inverses.push_back(object.inverse());
      for (std::size_t i = 0; i < H_knot_object[k].size(); ++i) {
        const auto& [row, by_row] = H_knot_object[k][i];
        const Mat65 W = by_row * inverses.back();
        b.segment<6>(row) -= W * g_object[k];
        for (std::size_t j = 0; j <= i; ++j) {
          const auto& [column, by_column] = H_knot_object[k][j];
          S.block<6, 6>(row, column).noalias() -= W * by_column.transpose();
        }
      }
    }
    if (next == nullptr) return S;
    const Eigen::VectorXd step = -Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(S).solve(b);  // in the place of S
    *next = unknowns;
    Eigen::Index row = 0;
    for (SE3& pose : next->T_odom_knot) {
      pose.t += step.segment<3>(row);
      pose.q = (so3_exp(step.segment<3>(row + 3)) * pose.q).normalized();
      row += 6;
    }
    for (Vec6& drift : next->drifts) {
      drift += step.segment<6>(row);
      row += 6;
    }
    for (std::size_t k = 0; k < H_object.size(); ++k) {
      Vec5 gradient = g_object[k];
      for (const auto& [knot, by_knot] : H_knot_object[k]) gradient += by_knot.transpose() * step.segment<6>(knot);
      next->objects[k] -= inverses[k] * gradient;
    }
    return S;
  }
};

/// Errors of a step, the drift taken off, and its derivatives.
RelativePoseTerms step_terms(const Problem& problem, const Unknowns& unknowns, std::size_t step) {
  RelativePoseTerms terms =
      relative_pose_terms(unknowns.T_odom_knot[step], unknowns.T_odom_knot[step + 1], problem.odometry(step));
  terms.residual -= problem.duration_s(step) * unknowns.drifts[static_cast<std::size_t>(problem.drift_of[step])];
  return terms;
}

Eigen::Index drift_row(const Problem& problem, std::size_t drift) {
  return static_cast<Eigen::Index>(6 * (problem.T_odom_knot.size() + drift));
}

void add_odometry(const Problem& problem, const Unknowns& unknowns, Equations* equations) {
  Eigen::MatrixXd& H = equations->H;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    const double dt = problem.duration_s(i);
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const Vec6 weights = problem.step_variances(i).cwiseInverse();
    equations->cost += terms.residual.dot(weights.asDiagonal() * terms.residual);
    const Mat6 from = terms.J_from.transpose() * weights.asDiagonal();
    const Mat6 to = terms.J_to.transpose() * weights.asDiagonal();
    const auto a = static_cast<Eigen::Index>(6 * i), b = a + 6;
    const Eigen::Index d = drift_row(problem, static_cast<std::size_t>(problem.drift_of[i]));
    H.block<6, 6>(a, a) += from * terms.J_from;
    H.block<6, 6>(b, a) += to * terms.J_from;
    H.block<6, 6>(b, b) += to * terms.J_to;
    H.block<6, 6>(d, a) -= dt * from.transpose();
    H.block<6, 6>(d, b) -= dt * to.transpose();
    H.diagonal().segment<6>(d) += dt * dt * weights;
    equations->g.segment<6>(a) += from * terms.residual;
    equations->g.segment<6>(b) += to * terms.residual;
    equations->g.segment<6>(d) -= dt * weights.cwiseProduct(terms.residual);
  }
  const Vec6 weights = by_kind(1.0 / squared(problem.noise.drift_mps), 1.0 / squared(problem.noise.drift_radps));
  for (std::size_t k = 0; k < unknowns.drifts.size(); ++k) {
    equations->cost += unknowns.drifts[k].dot(weights.asDiagonal() * unknowns.drifts[k]);
    H.diagonal().segment<6>(drift_row(problem, k)) += weights;
    equations->g.segment<6>(drift_row(problem, k)) += weights.cwiseProduct(unknowns.drifts[k]);
  }
  constexpr double kFixed = 1e10;  // 1/m^2 and 1/rad^2: the anchor stays
  H.diagonal().segment<6>(6 * problem.anchor).array() += kFixed;
}

/// An object as its views share it.
struct SizedPoint {
  explicit SizedPoint(const Vec5& object) : center(object.head<3>()), half(object.tail<2>().array().exp()) {}

  Vec3 center;  ///< m
  Vec2 half;    ///< of its width and height, m
};

/// The same in the camera of a view.
struct Projection {
  Vec3 in_camera;
  Vec4 residual;  ///< sides predicted less those of the box, in sigmas; 0 where they are cut
};

std::optional<Projection> project(const View& view, const SE3& T_odom_camera, const SizedPoint& object) {
  const Vec3 p = T_odom_camera.q.conjugate() * (object.center - T_odom_camera.t);
  if (p.z() < kMinDepth_m) return std::nullopt;
  Projection projection{p, Vec4::Zero()};
  Vec4 sides;
  sides << p.head<2>() - object.half, p.head<2>() + object.half;
  const Vec4 off = (sides / p.z() - view.box.edges()) / view.sigma;
  for (int side = 0; side < 4; ++side) projection.residual(side) = view.bounds(side) ? off(side) : 0.0;
  return projection;
}

/// Of the sum over four sides, two of which make a place: what Cauchy's loss makes of it.
double box_loss(double squares) { return 2.0 * squared(kBoxDoubt) * std::log1p(0.5 * squares / squared(kBoxDoubt)); }

void add_view(const View& view, const SE3& T_odom_camera, std::size_t k, const SizedPoint& object,
              Equations* equations) {
  const std::optional<Projection> projection = project(view, T_odom_camera, object);
  if (!projection) {
    equations->cost += kBoxWeight * box_loss(kUnseenChi2);
    return;
  }
  const Vec4& r = projection->residual;
  equations->cost += kBoxWeight * box_loss(r.squaredNorm());
  const double weight = kBoxWeight / (1.0 + 0.5 * r.squaredNorm() / squared(kBoxDoubt));
  const Vec3& p = projection->in_camera;
  const Vec2& half = object.half;
  const double z = p.z();
  Eigen::Matrix<double, 4, 3> by_point;
  by_point << 1.0, 0.0, -(p.x() - half.x()) / z, 0.0, 1.0, -(p.y() - half.y()) / z, 1.0, 0.0, -(p.x() + half.x()) / z,
      0.0, 1.0, -(p.y() + half.y()) / z;
  Eigen::Matrix<double, 4, 5> J_object;
  J_object.leftCols<3>() = by_point * T_odom_camera.rotation().transpose();
  J_object.rightCols<2>() << -half.x(), 0.0, 0.0, -half.y(), half.x(), 0.0, 0.0, half.y();
  J_object /= z * view.sigma;
  for (int side = 0; side < 4; ++side) {
    if (!view.bounds(side)) J_object.row(side).setZero();
  }
  Eigen::Matrix<double, 4, 6> J_knot;
  J_knot << -J_object.leftCols<3>(), J_object.leftCols<3>() * hat(object.center - T_odom_camera.t);
  const Eigen::Index row = 6 * view.knot;
  const Eigen::Matrix<double, 6, 4> weighted_knot = weight * J_knot.transpose();
  const Eigen::Matrix<double, 5, 4> weighted_object = weight * J_object.transpose();
  equations->H.block<6, 6>(row, row).noalias() += weighted_knot * J_knot;
  equations->g.segment<6>(row).noalias() += weighted_knot * r;
  equations->H_object[k].noalias() += weighted_object * J_object;
  equations->g_object[k].noalias() += weighted_object * r;
  equations->H_knot_object[k].emplace_back(row, weighted_knot * J_object);
}

/// The depth along the ray of the wholest view at which all views agree best.
Vec5 start_of(const std::vector<View>& views, const std::vector<SE3>& T_odom_knot) {
  const View& wholest = *std::min_element(views.begin(), views.end(),
                                          [](const View& p, const View& q) { return p.cut_sides() < q.cut_sides(); });
  constexpr double kNearest_m = 0.5, kFarthest_m = 6.0, kRatio = 1.2, kUsual_m = 2.0;
  constexpr double kUsualWeight = 0.1;  // hardly any: where nothing else tells
  constexpr double kTolerance = 3.0;    // times the sigmas: the odometry is as it is
  constexpr double kLargeFactor = 1e3;
  const Vec2 center = wholest.box.center();
  Vec5 best = Vec5::Zero();
  double least = std::numeric_limits<double>::infinity();
  for (double z = kNearest_m; z < kFarthest_m; z *= kRatio) {
    Vec5 object;
    object << T_odom_knot[static_cast<std::size_t>(wholest.knot)] * Vec3(z * center.x(), z * center.y(), z),
        std::log(0.5 * z * wholest.box.width()), std::log(0.5 * z * wholest.box.height());
    const SizedPoint sized(object);
    double cost = kUsualWeight * squared(std::log(z / kUsual_m));
    double factor = 1.0;                                              // of several views, for one logarithm
    for (std::size_t i = 0; i < views.size() && cost < least; ++i) {  // no view makes it less
      const auto projection = project(views[i], T_odom_knot[static_cast<std::size_t>(views[i].knot)], sized);
      factor *= 1.0 + (projection ? projection->residual.squaredNorm() : kUnseenChi2) / (2.0 * squared(kTolerance));
      if (factor < kLargeFactor && i + 1 < views.size()) continue;
      cost += std::log(factor);
      factor = 1.0;
    }
    if (cost >= least) continue;
    least = cost;
    best = object;
  }
  return best;
}

/// Frames that poses are solved for, the first, the last and the anchor among them.
std::vector<std::size_t> knots_of(const std::deque<ObservedFrame>& window, std::size_t anchor) {
  std::vector<std::size_t> knots;
  for (std::size_t i = 0; i < window.size(); ++i) {
    const bool is_due =
        knots.empty() ||
        1e-9 * static_cast<double>(window[i].stamp_ns - window[knots.back()].stamp_ns) >= kKnotInterval_s;
    if (is_due || i == anchor || i + 1 == window.size()) knots.push_back(i);
  }
  return knots;
}

double seconds_into(const std::deque<ObservedFrame>& window, std::size_t frame) {
  return 1e-9 * static_cast<double>(window[frame].stamp_ns - window.front().stamp_ns);
}

/// From the frame before to the frame after, if they are close enough to tell. @param window two frames at least
std::optional<Vec6> velocity_at(const std::deque<ObservedFrame>& window, std::size_t frame) {
  constexpr double kMaxSpan_s = 0.4;
  const std::size_t from = frame == 0 ? 0 : frame - 1, to = std::min(frame + 1, window.size() - 1);
  const double span_s = seconds_into(window, to) - seconds_into(window, from);
  if (span_s > kMaxSpan_s) return std::nullopt;
  const SE3 &T_odom_from = window[from].T_odom_camera, &T_odom_to = window[to].T_odom_camera;
  Vec6 motion;
  motion << window[frame].T_odom_camera.q.conjugate() * (T_odom_to.t - T_odom_from.t),
      so3_log(T_odom_from.q.conjugate() * T_odom_to.q);
  return motion / span_s;
}

/// Where the knots are if the odometry stands as it is, and turns by the boxes while it is frozen.
/// @param frozen see frozen_motions
void start_knots(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots,
                 const std::vector<bool>& frozen, Problem* problem) {
  problem->start = problem->T_odom_knot;
  problem->frozen_s.assign(problem->steps(), 0.0);
  for (std::size_t step = 0; step < problem->steps(); ++step) {
    Quaternion turn = Quaternion::Identity();
    for (std::size_t i = knots[step]; i < knots[step + 1]; ++i) {
      if (!frozen[i]) continue;
      problem->frozen_s[step] += seconds_into(window, i + 1) - seconds_into(window, i);
      turn = turn * turn_by_boxes(window[i], window[i + 1]);
    }
    problem->start[step + 1] = problem->start[step] * problem->odometry(step) * SE3(turn, Vec3::Zero());
  }
  const auto anchor = static_cast<std::size_t>(problem->anchor);
  const SE3 T_odom_start = problem->T_odom_knot[anchor] * problem->start[anchor].inverse();
  for (SE3& pose : problem->start) pose = T_odom_start * pose;
}

Problem make_problem(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots, std::size_t anchor,
                     const std::vector<bool>& frozen, const WindowNoise& noise) {
  Problem problem;
  problem.noise = noise;
  std::map<std::int64_t, Track> tracks;
  for (std::size_t k = 0; k < knots.size(); ++k) {
    const ObservedFrame& frame = window[knots[k]];
    if (knots[k] == anchor) problem.anchor = static_cast<int>(k);
    problem.T_odom_knot.push_back(frame.T_odom_camera);
    problem.velocities.push_back(velocity_at(window, knots[k]));
    problem.times_s.push_back(seconds_into(window, knots[k]));
    for (const ObservedBox& box : frame.boxes) {
      View view{static_cast<int>(k), box.box, box.truncated, 0.0};
      if (view.cut_sides() > kMaxCutSides) continue;
      view.sigma = noise.box_factor * box_sigma(box.box, frame.focal_px);
      tracks[box.track_id].views.push_back(view);
    }
  }
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    problem.drift_of.push_back(static_cast<int>(0.5 * (problem.times_s[i] + problem.times_s[i + 1]) / kDriftSpan_s));
  }
  start_knots(window, knots, frozen, &problem);
  for (auto& [id, track] : tracks) {
    if (track.views.size() < kMinViews) continue;
    track.start = start_of(track.views, problem.start);
    problem.tracks.push_back(std::move(track));
  }
  return problem;
}

bool solve(const Problem& problem, Unknowns* unknowns, Equations* equations, Equations* spare) {
  unknowns->T_odom_knot = problem.start;
  unknowns->drifts.assign(static_cast<std::size_t>(problem.drift_of.back()) + 1, Vec6::Zero());
  for (const Track& track : problem.tracks) unknowns->objects.push_back(track.start);
  const auto linearise = [&problem](const Unknowns& at, Equations* normal) {
    normal->reset(problem, at);
    add_odometry(problem, at, normal);
    for (std::size_t k = 0; k < problem.tracks.size(); ++k) {
      const SizedPoint object(at.objects[k]);
      for (const View& view : problem.tracks[k].views) {
        add_view(view, at.T_odom_knot[static_cast<std::size_t>(view.knot)], k, object, normal);
      }
    }
    return std::isfinite(normal->cost);
  };
  LeastSquaresOptions options;
  const auto is_frozen = [](double seconds) { return seconds > 0.0; };
  const bool starts_far = std::any_of(problem.frozen_s.begin(), problem.frozen_s.end(), is_frozen);
  options.max_iterations = starts_far ? 12 : 4;
  options.min_decrease = 1e-2;  // of a window that is solved again, a little later
  return minimise(options, linearise, unknowns, equations, spare);
}

/// Median squared residual of a side over that of a normal distribution; nullopt where there are few.
std::optional<double> box_variance(const Problem& problem, const Unknowns& unknowns) {
  std::vector<double> squares;
  for (std::size_t k = 0; k < problem.tracks.size(); ++k) {
    const SizedPoint object(unknowns.objects[k]);
    for (const View& view : problem.tracks[k].views) {
      const auto projection = project(view, unknowns.T_odom_knot[static_cast<std::size_t>(view.knot)], object);
      for (int side = 0; side < 4 && projection; ++side) {
        if (view.bounds(side)) squares.push_back(squared(projection->residual(side)));
      }
    }
  }
  constexpr double kMedianChi2 = 0.455;
  if (squares.size() < kMinSides) return std::nullopt;
  return median(std::move(squares)) / kMedianChi2;
}

/// Adds errors that were found: their squares over their durations, and of each degree of freedom the part that the
/// boxes determine, which is what their covariance leaves of the prior's.
/// @param all of the kind, in sigmas of the prior
void add(const Vec6& error, const Vec6& variances, const Vec6& prior, double per_square, VarianceEvidence* translation,
         VarianceEvidence* rotation, VarianceEvidence* all) {
  const Vec6 determined = Vec6::Ones() - variances.cwiseQuotient(prior);
  translation->squares += per_square * error.head<3>().squaredNorm();
  rotation->squares += per_square * error.tail<3>().squaredNorm();
  translation->count += determined.head<3>().sum();
  rotation->count += determined.tail<3>().sum();
  all->squares += error.dot(error.cwiseQuotient(prior));
  all->count += determined.sum();
}

/// R of R^T R = information^-1, lower triangular: of it and of L no more is computed than is not zero.
/// @param information its lower triangle, in blocks of 6; overwritten
Eigen::MatrixXd covariance_root(Eigen::MatrixXd* information) {
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(*information);
  const auto n = information->rows();
  Eigen::MatrixXd root = Eigen::MatrixXd::Identity(n, n);
  for (Eigen::Index begin = 0; begin < n; begin += 6) {
    auto column = root.block(begin, begin, n - begin, 6);
    llt.matrixLLT().bottomRightCorner(n - begin, n - begin).triangularView<Eigen::Lower>().solveInPlace(column);
  }
  return root;
}

/// How late the odometry's poses are, seen as an unknown of the problem at its solution: by a delay the odometry of a
/// step is off by what the velocities at its ends differ, and one step of Gauss and Newton finds it.
/// @param root see covariance_root   @param excess on the odometry's variances   @param delay_s taken out before
/// @param elapsed_s since a window told
void learn_delay(const Problem& problem, const Unknowns& unknowns, const Eigen::MatrixXd& root, double excess,
                 double delay_s, double elapsed_s, OdometryDelay* delay) {
  Eigen::VectorXd by_unknowns = Eigen::VectorXd::Zero(root.rows());
  double gradient = 0.0, information = 0.0;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    const std::optional<Vec6>&from = problem.velocities[i], &to = problem.velocities[i + 1];
    if (problem.is_frozen(i) || !from || !to) continue;
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const Vec6 by_delay = transport(problem.odometry(i)) * *from - *to;
    const Vec6 weighted = by_delay.cwiseQuotient(problem.step_variances(i));
    gradient += weighted.dot(terms.residual);
    information += weighted.dot(by_delay);
    const auto row = static_cast<Eigen::Index>(6 * i);
    by_unknowns.segment<6>(row) += terms.J_from.transpose() * weighted;
    by_unknowns.segment<6>(row + 6) += terms.J_to.transpose() * weighted;
    by_unknowns.segment<6>(drift_row(problem, static_cast<std::size_t>(problem.drift_of[i]))) -=
        problem.duration_s(i) * weighted;
  }
  information -= (root.triangularView<Eigen::Lower>() * by_unknowns).squaredNorm();
  // Windows overlap: what a part of the time tells counts once.
  const double new_share = std::min(1.0, elapsed_s / (problem.times_s.back() - problem.times_s.front()));
  delay->add(delay_s - gradient / information, new_share * information / excess, elapsed_s);
}

void learn(const Problem& problem, const Unknowns& unknowns, double delay_s, double elapsed_s, Equations* equations,
           WindowEvidence* evidence) {
  const Eigen::MatrixXd root = covariance_root(&equations->reduce(0.0, unknowns, nullptr));
  if (!root.allFinite()) return;
  const auto variances = [&root](Eigen::Index row) -> Vec6 { return root.middleCols<6>(row).colwise().squaredNorm(); };
  const WindowNoise& noise = problem.noise;
  VarianceEvidence of_steps, of_drifts;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    if (problem.is_frozen(i)) continue;
    const double dt = problem.duration_s(i);
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const auto row = static_cast<Eigen::Index>(6 * i);
    const Eigen::Index drift = drift_row(problem, static_cast<std::size_t>(problem.drift_of[i]));
    // Above the first of these rows the root is zero.
    const Eigen::Index rows = root.rows() - row;
    const Eigen::Matrix<double, Eigen::Dynamic, 6> left =
        root.block<Eigen::Dynamic, 6>(row, row, rows, 6) * terms.J_from.transpose() +
        root.block<Eigen::Dynamic, 6>(row, row + 6, rows, 6) * terms.J_to.transpose() -
        dt * root.block<Eigen::Dynamic, 6>(row, drift, rows, 6);
    add(terms.residual, left.colwise().squaredNorm(), problem.step_variances(i), 1.0 / dt, &evidence->step_translation,
        &evidence->step_rotation, &of_steps);
  }
  for (std::size_t k = 0; k < unknowns.drifts.size(); ++k) {
    add(unknowns.drifts[k], variances(drift_row(problem, k)),
        by_kind(squared(noise.drift_mps), squared(noise.drift_radps)), 1.0, &evidence->drift_translation,
        &evidence->drift_rotation, &of_drifts);
  }
  // While the odometry's noise is not learnt yet, it is worse than told.
  const double excess = std::max({1.0, of_steps.squares / of_steps.count, of_drifts.squares / of_drifts.count});
  learn_delay(problem, unknowns, root, excess, delay_s, elapsed_s, &evidence->delay);
  const auto last = static_cast<Eigen::Index>(6 * problem.steps());
  const double ends = variances(0).tail<3>().mean() + variances(last).tail<3>().mean();
  evidence->doubt_radps = std::sqrt(2.0 * ends) / (problem.times_s.back() - problem.times_s.front());
  if (const std::optional<double> variance = box_variance(problem, unknowns)) {
    const double factor = evidence->box_factor * std::sqrt(1.0 + kBoxRate * (*variance - 1.0));
    evidence->box_factor = std::clamp(factor, 1.0 / kMaxBoxFactor, kMaxBoxFactor);
  }
}

void forget(double time_s, WindowEvidence* evidence) {
  const double share = std::exp(-time_s / kMemory_s);
  for (VarianceEvidence* part : {&evidence->step_translation, &evidence->step_rotation, &evidence->drift_translation,
                                 &evidence->drift_rotation}) {
    part->squares *= share;
    part->count *= share;
  }
}

double variance(const VarianceEvidence& evidence, double prior, double count) {
  return (evidence.squares + count * prior) / (evidence.count + count);
}

/// Sigmas of two kinds of errors that are usually as large, a radian being worth kLever_m.
std::pair<double, double> sigmas(const VarianceEvidence& translation, const VarianceEvidence& rotation) {
  const double lever2 = squared(kLever_m);
  const VarianceEvidence both{translation.squares + lever2 * rotation.squares, translation.count + rotation.count};
  const double together = variance(both, squared(kLeast_m), 2.0 * kLeastCount);
  return {std::sqrt(variance(translation, together, kTogetherCount)),
          std::sqrt(variance(rotation, together / lever2, kTogetherCount))};
}

}  // namespace

struct WindowSolver::Memory {
  Equations equations, spare;
};

WindowSolver::WindowSolver() : memory_(std::make_unique<Memory>()) {}
WindowSolver::~WindowSolver() = default;

WindowNoise WindowSolver::noise() const {
  WindowNoise noise;
  std::tie(noise.step_m, noise.step_rad) = sigmas(evidence_.step_translation, evidence_.step_rotation);
  std::tie(noise.drift_mps, noise.drift_radps) = sigmas(evidence_.drift_translation, evidence_.drift_rotation);
  noise.box_factor = evidence_.box_factor;
  return noise;
}

std::optional<double> WindowSolver::span_s(double sigma_rad) const {
  if (!(evidence_.doubt_radps > 0.0)) return std::nullopt;
  return 2.0 * sigma_rad / evidence_.doubt_radps;
}

std::deque<ObservedFrame> WindowSolver::solve(std::deque<ObservedFrame> window, std::size_t anchor) {
  applied_delay_s_ = 0.0;
  const auto is_in_order = [](const ObservedFrame& p, const ObservedFrame& q) { return p.stamp_ns < q.stamp_ns; };
  if (std::adjacent_find(window.begin(), window.end(), std::not_fn(is_in_order)) != window.end()) return window;
  const std::vector<std::size_t> knots = knots_of(window, anchor);
  if (knots.size() < kMinViews) return window;
  applied_delay_s_ = delay_s();
  window = undelayed(std::move(window), applied_delay_s_);
  const std::vector<bool> frozen = frozen_motions(window);
  const Problem problem = make_problem(window, knots, anchor, frozen, noise());
  Unknowns unknowns;
  if (!core::solve(problem, &unknowns, &memory_->equations, &memory_->spare)) return window;
  const double since_s = 1e-9 * static_cast<double>(window.back().stamp_ns - learnt_ns_);
  if (learnt_ns_ == 0 || since_s >= kLearnInterval_s) {
    forget(since_s, &evidence_);
    learn(problem, unknowns, applied_delay_s_, since_s, &memory_->equations, &evidence_);
    learnt_ns_ = window.back().stamp_ns;
  }
  std::size_t step = 0;
  for (std::size_t i = 0; i < window.size(); ++i) {
    while (step + 1 < problem.steps() && knots[step + 1] <= i) ++step;
    const double share = (seconds_into(window, i) - problem.times_s[step]) / problem.duration_s(step);
    const SE3& T_odom_knot = unknowns.T_odom_knot[step];
    const SE3 T_knot_camera = problem.T_odom_knot[step].inverse() * window[i].T_odom_camera;
    window[i].T_odom_camera =
        T_odom_knot * motion_on_the_way(T_knot_camera, problem.odometry(step),
                                        T_odom_knot.inverse() * unknowns.T_odom_knot[step + 1], share);
    if (i > 0 && frozen[i - 1]) window[i].frozen_s = seconds_into(window, i) - seconds_into(window, i - 1);
  }
  return window;
}

}  // namespace semantic_topo_loop::core
