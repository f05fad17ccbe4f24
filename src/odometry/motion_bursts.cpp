#include "odometry/motion_bursts.h"

#include <algorithm>
#include <cmath>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

// In seconds; chosen on recordings at 30 Hz.
constexpr std::array<double, 6> kLengths_s{0.033, 0.067, 0.133, 0.2, 0.267, 0.367};
constexpr double kSide_s = 1e-9 * kBurstNoticed_ns;  // before and as much after, the mean of which foretells
constexpr double kHistory_s = 20.0;                  // that say what is usual
constexpr double kMinHistory_s = 2.0;
constexpr std::size_t kMinHistory = 20;  // frames: of fewer, no tenth may be jumps
constexpr double kRefresh_s = 0.5;       // after which it is asked again, to save time
/// Times the usual difference: few motions of a hand-held camera are beyond the first, and a burst counts by a share
/// that grows from there to the second, so that what is learnt does not hang on one frame. Chosen on the drifted
/// recordings.
constexpr double kMinSigmas = 6.0, kCertainSigmas = 10.0;
constexpr double kDoubt = 3.0;  // times the usual difference: so much of a burst's size may be none of it (3 sigmas)

/// Sigma of each axis, by what nine of ten differences stay below: the worst tenth may be jumps or a shaky odometry's
/// own.
double usual(std::vector<double> norms) {
  constexpr double kNinthTenth = 2.5;  // of the norm of three, in sigmas: root of the 90 % quantile of chi^2, 6.25
  constexpr double kTiny = 1e-9;       // m or rad: a camera that stands still is no division by zero
  return quantile(std::move(norms), 0.9) / kNinthTenth + kTiny;
}

void add(const MotionBursts::SuspectedJump& more, MotionBursts::SuspectedJump* sum) {
  sum->motion += more.motion;
  sum->error_m += more.error_m;
  sum->error_rad += more.error_rad;
}

}  // namespace

MotionBursts::MotionBursts() {
  for (std::size_t i = 0; i < kLengths_s.size(); ++i) lengths_[i].time_s = kLengths_s[i];
}

void MotionBursts::push(const Frame& frame, std::size_t section) {
  const SE3& T_odom_camera = frame.T_odom_camera;
  const std::optional<SE3> T_odom_last = std::exchange(T_odom_last_, T_odom_camera);
  const std::int64_t elapsed_ns = frame.stamp_ns - std::exchange(last_stamp_ns_, frame.stamp_ns);
  if (!T_odom_last || elapsed_ns <= 0) return;
  const double dt_s = 1e-9 * static_cast<double>(elapsed_ns);
  // What the frames around a gap do says little of the motion over it.
  constexpr double kGap = 3.0;  // times the longest between the frames before
  const auto is_longer = [](const Motion& p, const Motion& q) { return p.dt_s < q.dt_s; };
  const auto longest = std::max_element(window_.begin(), window_.end(), is_longer);
  if (longest != window_.end() && dt_s > kGap * longest->dt_s) return window_.clear();
  if (frame.is_break) return;
  // What was missed is no burst, and says as little of the motions around it.
  if (frame.held_since_ns) return window_.clear();
  time_s_ += dt_s;
  window_.push_back({se3_log(T_odom_last->inverse() * T_odom_camera), T_odom_camera.q, dt_s, time_s_, section});
  constexpr double kSpan_s = kLengths_s.back() + 2.0 * kSide_s;
  while (window_.size() > 3 && window_[2].end_s < time_s_ - kSpan_s) window_.pop_front();
  Burst best;
  for (Length& length : lengths_) {
    Burst burst = judge(&length);
    if (burst.strength > kMinSigmas && burst.size > best.size) best = std::move(burst);
  }
  if (best.size > 0.0) remember(best);
}

/// What ends kSide_s ago.
MotionBursts::Burst MotionBursts::judge(Length* length) const {
  // The border between two motions that lies about so long before another; nullopt if that is before the window.
  const auto border_before = [this](std::size_t border, double time_s) -> std::optional<std::size_t> {
    double passed_s = 0.0;
    for (std::size_t i = border; i-- > 0;) {
      passed_s += window_[i].dt_s;
      if (passed_s + 0.5 * window_[i].dt_s > time_s) return i;
    }
    return std::nullopt;
  };
  const std::size_t now = window_.size();
  const auto end = border_before(now, kSide_s);
  const auto begin = end ? border_before(*end, length->time_s) : std::nullopt;
  const auto first = begin ? border_before(*begin, kSide_s) : std::nullopt;
  if (!first) return {};
  struct Stretch {
    Vec6 twist = Vec6::Zero();
    double time_s = 0.0;
  };
  const auto stretch = [this](std::size_t from, std::size_t to) {
    Stretch sum;
    for (std::size_t i = from; i < to; ++i) {
      sum.twist += window_[i].twist;
      sum.time_s += window_[i].dt_s;
    }
    return sum;
  };
  const Stretch within = stretch(*begin, *end), before = stretch(*first, *begin), after = stretch(*end, now);
  const Vec6 rate_before = before.twist / before.time_s, rate_after = after.twist / after.time_s;
  const Vec6 foretold = 0.5 * (rate_before + rate_after);
  const Vec6 excess = within.twist - within.time_s * foretold;
  const double translation_m = excess.head<3>().norm(), rotation_rad = excess.tail<3>().norm();
  Burst burst;
  const double dt_s = window_.back().dt_s;
  if (length->known_s >= kMinHistory_s && length->last.size() >= kMinHistory) {
    length->outdated_s += dt_s;
    if (length->sigma_m == 0.0 || length->outdated_s >= kRefresh_s) length->refresh();
    const auto along = [length, &excess](const Vec6& motion) {
      return motion.head<3>().dot(excess.head<3>()) / (length->sigma_m * length->sigma_m) +
             motion.tail<3>().dot(excess.tail<3>()) / (length->sigma_rad * length->sigma_rad);
    };
    const Vec6 beside_before = within.twist - within.time_s * rate_before;
    const Vec6 beside_after = within.twist - within.time_s * rate_after;
    // What stands out of one side only is that side's burst.
    const bool is_here = std::min(along(beside_before), along(beside_after)) > 0.5 * along(excess);
    burst.strength = is_here ? std::sqrt(along(excess)) : 0.0;
    const Length& unit = lengths_.front();
    burst.size = (1.0 - kDoubt / std::max(burst.strength, kDoubt)) *
                 std::hypot(translation_m / unit.sigma_m, rotation_rad / unit.sigma_rad);
  }
  length->remember({translation_m, rotation_rad, dt_s});
  if (burst.strength <= kMinSigmas) return burst;
  burst.end_s = window_[*end - 1].end_s;
  burst.begin_s = burst.end_s - within.time_s;
  const double share = std::min(1.0, (burst.strength - kMinSigmas) / (kCertainSigmas - kMinSigmas));
  for (std::size_t i = *begin; i < *end; ++i) {
    const Motion& motion = window_[i];
    const Vec6 jumped = share * (motion.twist - motion.dt_s * foretold);
    SuspectedJump jump;
    jump.motion << motion.q_odom_camera * jumped.head<3>(), motion.q_odom_camera * jumped.tail<3>();
    jump.error_m = share * length->sigma_m * motion.dt_s / within.time_s;
    jump.error_rad = share * length->sigma_rad * motion.dt_s / within.time_s;
    burst.jumps.emplace_back(motion.section, jump);
  }
  return burst;
}

void MotionBursts::Length::remember(const Difference& difference) {
  last.push_back(difference);
  for (known_s += difference.dt_s; known_s > kHistory_s; last.pop_front()) known_s -= last.front().dt_s;
}

void MotionBursts::Length::refresh() {
  std::vector<double> translations, rotations;
  for (const Difference& difference : last) {
    translations.push_back(difference.translation_m);
    rotations.push_back(difference.rotation_rad);
  }
  sigma_m = usual(std::move(translations));
  sigma_rad = usual(std::move(rotations));
  outdated_s = 0.0;
}

/// Of bursts one of which may have swayed what the frames around the other foretell the greatest counts.
void MotionBursts::remember(const Burst& burst) {
  if (burst.begin_s > greatest_.end_s + kSide_s) settle();
  if (burst.size > greatest_.size) greatest_ = burst;
}

void MotionBursts::settle() {
  for (const auto& [section, jump] : greatest_.jumps) add(jump, &jumps_[section]);
  greatest_ = Burst();
}

MotionBursts::SuspectedJump MotionBursts::suspected_jump(std::size_t section) const {
  const auto settled = jumps_.find(section);
  SuspectedJump sum = settled != jumps_.end() ? settled->second : SuspectedJump();
  for (const auto& [of_section, jump] : greatest_.jumps) {
    if (of_section == section) add(jump, &sum);
  }
  return sum;
}

std::optional<Vec6> BurstWatch::push(const Frame& frame) {
  constexpr std::int64_t kSection_ns = 500'000'000;  // longer than any burst
  constexpr double kMinTranslation_m = 0.05;  // less does not spoil a submap; finds the bursts of drifted recordings
  constexpr double kMinRotation_rad = 0.06;   // as much at about a metre
  bursts_.push(frame, section_);
  // A burst may lie across the border of two sections.
  Vec6 jump = bursts_.suspected_jump(section_).motion;
  if (section_ > 0) jump += bursts_.suspected_jump(section_ - 1).motion;
  const bool jumped = jump.head<3>().norm() > kMinTranslation_m || jump.tail<3>().norm() > kMinRotation_rad;
  constexpr std::size_t kBeyond = 2;  // what is still to come of this burst belongs to the old sections
  if (jumped || frame.stamp_ns - section_ns_ >= kSection_ns) {
    section_ += jumped ? kBeyond : 1;
    section_ns_ = frame.stamp_ns;
  }
  if (!jumped) return std::nullopt;
  return jump;
}

}  // namespace semantic_topo_loop::core
