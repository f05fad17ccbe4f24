#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/text.h"
#include "tools/perturbation/perturbation.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kBursts = 3;
constexpr std::size_t kBurstFrames = 8;  // 0.3 s at 30 Hz: blur, or a person who walks through the view

/// The error of one step in the camera frame: `scaled` parts are multiplied until the level is met, `fixed` ones are
/// not.
struct StepError {
  Vec3 rotation_scaled = Vec3::Zero(), rotation_fixed = Vec3::Zero();        ///< rad
  Vec3 translation_scaled = Vec3::Zero(), translation_fixed = Vec3::Zero();  ///< m
};

/// A rate that varies around 1 through five random support points over the whole sequence.
class SlowRate {
 public:
  explicit SlowRate(Random* random) {
    for (double& value : support_) value = 1.0 + 0.4 * random->normal();
  }
  double at(double share) const {
    const double x = share * static_cast<double>(support_.size() - 1);
    const std::size_t i = std::min(support_.size() - 2, static_cast<std::size_t>(x));
    const double ratio = x - static_cast<double>(i);
    return (1.0 - ratio) * support_[i] + ratio * support_[i + 1];
  }

 private:
  std::array<double, 5> support_{};
};

/// A trajectory as steps, and how errors of the steps add up.
struct Replay {
  explicit Replay(const std::vector<SE3>& T_world_camera) : truth(T_world_camera) {
    double mean_angle = 0.0;
    for (std::size_t i = 1; i < T_world_camera.size(); ++i) {
      motion.push_back(T_world_camera[i - 1].inverse() * T_world_camera[i]);
      mean_step_m += motion.back().t.norm();
      mean_angle += so3_log(motion.back().q).norm();
    }
    const double count = static_cast<double>(std::max<std::size_t>(1, motion.size()));
    // A camera at rest has no steps to compare with; its drift is then even.
    mean_step_m = std::max(mean_step_m / count, 1e-9);
    mean_angle = std::max(mean_angle / count, 1e-9);
    for (const SE3& step : motion) {
      const double relative = 0.5 * (step.t.norm() / mean_step_m + so3_log(step.q).norm() / mean_angle);
      activity.push_back(0.3 + 0.7 * relative);
    }
  }

  std::vector<SE3> integrate(const std::vector<StepError>& errors, double rotation_scale,
                             double translation_scale) const {
    std::vector<SE3> poses{truth.front()};
    poses.reserve(truth.size());
    for (std::size_t i = 0; i < motion.size(); ++i) {
      const StepError& e = errors[i];
      const SE3 error(so3_exp(rotation_scale * e.rotation_scaled + e.rotation_fixed),
                      translation_scale * e.translation_scaled + e.translation_fixed);
      poses.push_back(poses.back() * motion[i] * error);
    }
    return poses;
  }
  /// Largest angle from the truth, rad.
  double rotation_error(const std::vector<SE3>& poses) const {
    double worst = 0.0;
    for (std::size_t i = 0; i < poses.size(); ++i) worst = std::max(worst, rotation_angle(poses[i].q, truth[i].q));
    return worst;
  }

  const std::vector<SE3>& truth;
  std::vector<SE3> motion;
  std::vector<double> activity;  ///< how lively each step is compared with the mean one, at least 0.3
  double mean_step_m = 0.0;
};

/// The steady translation error keeps its direction in the world: fixed to a camera that goes in circles it would
/// cancel over a lap, and a given level would mean absurd errors of every single step.
std::vector<StepError> smooth_errors(const Replay& replay, Random* random) {
  std::vector<StepError> errors(replay.motion.size());
  const Vec3 rotation_axis = random->direction();
  const Vec3 translation_axis = random->direction();
  const double scale_error = random->normal();
  const SlowRate rotation_rate(random);
  const SlowRate translation_rate(random);
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(std::max<std::size_t>(1, errors.size() - 1));
    const Vec3 rotation_noise = 0.5 * random->normal3();
    const Vec3 translation_noise = 0.5 * random->normal3();
    errors[i].rotation_scaled = replay.activity[i] * (rotation_axis * rotation_rate.at(share) + rotation_noise);
    const Vec3 translation_bias = replay.truth[i + 1].q.conjugate() * translation_axis * translation_rate.at(share);
    errors[i].translation_scaled = replay.activity[i] * (translation_bias + translation_noise) +
                                   scale_error * replay.motion[i].t / replay.mean_step_m;
  }
  return errors;
}

/// Little drift between the bursts: 2 deg and 1 % of the way over the sequence, less if the level asked for is low.
std::vector<StepError> jump_errors(const Replay& replay, const DriftOptions& options, Random* random) {
  std::vector<StepError> errors(replay.motion.size());
  const double count = static_cast<double>(errors.size());
  for (int burst = 0; burst < kBursts; ++burst) {
    const auto begin = static_cast<std::size_t>(random->uniform(0.1, 0.9) * count);
    const Vec3 rotation = random->direction() / kBurstFrames;
    const Vec3 translation = random->direction() / kBurstFrames;
    for (std::size_t i = begin; i < std::min(begin + kBurstFrames, errors.size()); ++i) {
      errors[i].rotation_scaled += rotation;
      errors[i].translation_scaled += translation;
    }
  }
  const double rotation_level = std::min(1.0, options.rotation_deg / 5.0);
  const double translation_level = std::min(1.0, options.position_m / 0.3);
  const Vec3 rotation_axis = random->direction();
  const double scale_error = 0.01 * random->normal();
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const Vec3 rotation_noise = radians(0.01) * random->normal3();
    const Vec3 translation_noise = 0.0002 * random->normal3();
    errors[i].rotation_fixed =
        rotation_level * (radians(2.0) / count * replay.activity[i] * rotation_axis + rotation_noise);
    errors[i].translation_fixed = translation_level * (scale_error * replay.motion[i].t + translation_noise);
  }
  return errors;
}

/// Between a scale whose error is within the level and one whose error is not.
template <class Error>
double crossing(const Error& error, double inside, double outside, double level, int iterations) {
  for (int i = 0; i < iterations; ++i) {
    const double middle = 0.5 * (inside + outside);
    (error(middle) > level ? outside : inside) = middle;
  }
  return inside;
}

/// The largest scale in [0, infinity) whose error stays within the level, for an error that grows with the scale.
template <class Error>
double scale_to_level(const Error& error, double level) {
  double low = 0.0, high = 1e-4;
  for (int i = 0; i < 30 && error(high) <= level; ++i) {
    low = high;
    high *= 2.0;
  }
  return crossing(error, low, high, level, 30);
}

/// The largest distance from the truth as a function of the translation errors' scale, for given rotations: positions
/// are linear in the scale, so the function is convex.
class PositionError {
 public:
  PositionError(const Replay& replay, const std::vector<StepError>& errors, double rotation_scale)
      : truth_(replay.truth),
        at_zero_(replay.integrate(errors, rotation_scale, 0.0)),
        at_one_(replay.integrate(errors, rotation_scale, 1.0)) {}

  double operator()(double scale) const {
    double worst = 0.0;
    for (std::size_t i = 0; i < at_zero_.size(); ++i) {
      worst = std::max(worst, (at_zero_[i].t + scale * (at_one_[i].t - at_zero_[i].t) - truth_[i].t).norm());
    }
    return worst;
  }

  /// The scale nearest to zero, of either sign, at which the error is `level`; none if it is always larger. Where the
  /// rotation alone moves the camera too far, a translation error that pulls back is as good as any.
  std::optional<double> reach(double level) const {
    double slope = 1e-12;
    for (std::size_t i = 0; i < at_zero_.size(); ++i) slope = std::max(slope, (at_one_[i].t - at_zero_[i].t).norm());
    const double bound = (level + (*this)(0.0)) / slope;
    const double lowest = minimiser(bound);
    if ((*this)(lowest) > level) return std::nullopt;
    const double positive = crossing(*this, lowest, bound, level, kIterations);
    const double negative = crossing(*this, lowest, -bound, level, kIterations);
    return std::abs(positive) < std::abs(negative) ? positive : negative;
  }

 private:
  static constexpr int kIterations = 60;  ///< (2/3)^60 of the interval: below rounding in the files

  /// In [-bound, bound], by ternary search.
  double minimiser(double bound) const {
    double low = -bound, high = bound;
    for (int i = 0; i < kIterations; ++i) {
      const double third = (high - low) / 3.0;
      if ((*this)(low + third) < (*this)(high - third)) {
        high -= third;
      } else {
        low += third;
      }
    }
    return 0.5 * (low + high);
  }

  const std::vector<SE3>& truth_;
  std::vector<SE3> at_zero_, at_one_;
};

std::optional<std::vector<SE3>> scale_errors(const Replay& replay, const std::vector<StepError>& errors,
                                             const DriftOptions& options) {
  const auto rotation_error = [&](double s) { return replay.rotation_error(replay.integrate(errors, s, 0.0)); };
  const double level_rad = radians(options.rotation_deg);
  constexpr double kRounding = 1e-6;  // rad
  if (rotation_error(0.0) > level_rad + kRounding) return std::nullopt;
  const double rotation_scale = scale_to_level(rotation_error, level_rad);
  const std::optional<double> translation_scale =
      PositionError(replay, errors, rotation_scale).reach(options.position_m);
  if (!translation_scale) return std::nullopt;
  return replay.integrate(errors, rotation_scale, *translation_scale);
}

}  // namespace

Result<std::vector<SE3>> drift_poses(const std::vector<SE3>& T_world_camera, const DriftOptions& options,
                                     std::uint64_t seed) {
  if (T_world_camera.size() < 2 || (options.position_m == 0.0 && options.rotation_deg == 0.0)) return T_world_camera;
  const Replay replay(T_world_camera);
  Random random(seed);
  constexpr int kMaxDraws = 50;  // of errors; if none of so many meets both levels, these contradict each other
  for (int i = 0; i < kMaxDraws; ++i) {
    const std::vector<StepError> errors =
        options.model == "jump" ? jump_errors(replay, options, &random) : smooth_errors(replay, &random);
    if (auto poses = scale_errors(replay, errors, options)) return *std::move(poses);
  }
  return Error{"parameter 'drift.position_m' = '" + format_general(options.position_m, 6) +
               "' cannot be met: a rotation drift of 'drift.rotation_deg' = '" +
               format_general(options.rotation_deg, 6) + "' always moves the camera farther"};
}

std::vector<SE3> drift_scale(const std::vector<SE3>& T_world_camera, const DriftOptions& options, std::uint64_t seed) {
  if (T_world_camera.size() < 2 || (options.scale_percent == 0.0 && options.global_scale == 1.0)) return T_world_camera;
  Random random(seed);
  std::vector<double> walk{0.0};  // one a motion
  double largest = 0.0;
  for (std::size_t i = 1; i < T_world_camera.size(); ++i) {
    const double step_m = (T_world_camera[i].t - T_world_camera[i - 1].t).norm();
    walk.push_back(walk.back() + std::sqrt(step_m) * random.normal());
    largest = std::max(largest, std::abs(walk.back()));
  }
  const double level = std::log(1.0 + 0.01 * options.scale_percent) / std::max(largest, 1e-12);
  std::vector<SE3> poses{T_world_camera.front()};
  for (std::size_t i = 1; i < T_world_camera.size(); ++i) {
    SE3 motion = T_world_camera[i - 1].inverse() * T_world_camera[i];
    motion.t *= options.global_scale * std::exp(level * walk[i]);
    poses.push_back(poses.back() * motion);
  }
  return poses;
}

}  // namespace semantic_topo_loop::core
