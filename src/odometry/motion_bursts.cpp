#include "odometry/motion_bursts.h"

#include <algorithm>
#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

// All counts of frames below stand for times at 30 Hz, the rate of the recordings on which they were chosen.
constexpr std::array<std::size_t, 6> kLengths{1, 2, 4, 6, 8, 11};  // frames: bursts of up to 0.4 s
constexpr std::size_t kSide = 5;         // frames before and as many after, whose mean foretells: a sixth of a second
constexpr std::size_t kHistory = 600;    // frames that say what is usual: 20 s
constexpr std::size_t kMinHistory = 60;  // frames before which nothing is usual: 2 s
constexpr std::size_t kRefresh = 16;     // frames after which it is asked again: half a second, to save time
/// Times the usual difference: few motions of a hand-held camera are beyond the first, and a burst counts by a share
/// that grows from there to the second, so that what is learnt does not hang on one frame. Chosen on the drifted
/// recordings.
constexpr double kMinSigmas = 6.0, kCertainSigmas = 10.0;
constexpr double kDoubt = 3.0;  // times the usual difference: so much of a burst's size may be none of it (3 sigmas)

/// Sigma of each axis, by what nine of ten differences stay below: the worst tenth may be jumps or a shaky odometry's
/// own.
double usual(const boost::circular_buffer<double>& history) {
  std::vector<double> norms(history.begin(), history.end());
  constexpr double kNinthTenth = 2.5;  // of the norm of three, in sigmas: root of the 90 % quantile of chi^2, 6.25
  const auto at = norms.begin() + static_cast<std::ptrdiff_t>(norms.size() * 9 / 10);
  std::nth_element(norms.begin(), at, norms.end());
  constexpr double kTiny = 1e-9;  // m or rad: a camera that stands still is no division by zero
  return *at / kNinthTenth + kTiny;
}

void add(const MotionBursts::SuspectedJump& more, MotionBursts::SuspectedJump* sum) {
  sum->motion += more.motion;
  sum->error_m += more.error_m;
  sum->error_rad += more.error_rad;
}

}  // namespace

MotionBursts::MotionBursts() {
  for (std::size_t i = 0; i < kLengths.size(); ++i) {
    lengths_[i].frames = kLengths[i];
    for (auto* history : {&lengths_[i].translations, &lengths_[i].rotations}) history->set_capacity(kHistory);
  }
}

void MotionBursts::push(const Frame& frame, std::size_t section) {
  const SE3& T_odom_camera = frame.T_odom_camera;
  const std::optional<SE3> T_odom_last = std::exchange(T_odom_last_, T_odom_camera);
  const std::int64_t elapsed_ns = frame.stamp_ns - std::exchange(last_stamp_ns_, frame.stamp_ns);
  if (!T_odom_last || frame.is_break || elapsed_ns <= 0) return;
  // What was missed is no burst, and says as little of the motions around it.
  if (frame.held_since_ns) return window_.clear();
  const double dt_s = 1e-9 * static_cast<double>(elapsed_ns);
  // What the frames around a gap do says little of the motion over it.
  constexpr double kGap = 3.0;  // times the longest between the frames before
  const auto is_longer = [](const Motion& p, const Motion& q) { return p.dt_s < q.dt_s; };
  const auto longest = std::max_element(window_.begin(), window_.end(), is_longer);
  if (longest != window_.end() && dt_s > kGap * longest->dt_s) return window_.clear();
  window_.push_back({se3_log(T_odom_last->inverse() * T_odom_camera) / dt_s, T_odom_camera.q, dt_s, section});
  ++count_;
  if (window_.size() > kLengths.back() + 2 * kSide) window_.pop_front();
  Burst best;
  for (Length& length : lengths_) {
    if (window_.size() < length.frames + 2 * kSide) continue;
    Burst burst = judge(&length);
    if (burst.strength > kMinSigmas && burst.size > best.size) best = std::move(burst);
  }
  if (best.size > 0.0) remember(best);
}

/// What ends kSide frames ago.
MotionBursts::Burst MotionBursts::judge(Length* length) const {
  const std::size_t end = window_.size() - kSide, begin = end - length->frames;
  Vec6 before = Vec6::Zero(), after = Vec6::Zero();
  for (std::size_t i = 0; i < kSide; ++i) {
    before += window_[begin - 1 - i].rate / kSide;
    after += window_[end + i].rate / kSide;
  }
  const Vec6 foretold = 0.5 * (before + after);
  Vec6 sum = Vec6::Zero();
  double time = 0.0;
  for (std::size_t i = begin; i < end; ++i) {
    sum += window_[i].dt_s * window_[i].rate;
    time += window_[i].dt_s;
  }
  const Vec6 excess_before = sum - time * before, excess_after = sum - time * after;
  sum -= time * foretold;
  const double translation = sum.head<3>().norm(), rotation = sum.tail<3>().norm();
  Burst burst;
  if (length->translations.size() >= kMinHistory) {
    if (length->sigma_m == 0.0 || length->count % kRefresh == 0) {
      length->sigma_m = usual(length->translations);
      length->sigma_rad = usual(length->rotations);
    }
    const auto along = [length, &sum](const Vec6& motion) {
      return motion.head<3>().dot(sum.head<3>()) / (length->sigma_m * length->sigma_m) +
             motion.tail<3>().dot(sum.tail<3>()) / (length->sigma_rad * length->sigma_rad);
    };
    // What stands out of one side only is that side's burst.
    const bool is_here = std::min(along(excess_before), along(excess_after)) > 0.5 * along(sum);
    burst.strength = is_here ? std::sqrt(along(sum)) : 0.0;
    const Length& unit = lengths_.front();
    burst.size = (1.0 - kDoubt / std::max(burst.strength, kDoubt)) *
                 std::hypot(translation / unit.sigma_m, rotation / unit.sigma_rad);
  }
  length->translations.push_back(translation);
  length->rotations.push_back(rotation);
  ++length->count;
  if (burst.strength <= kMinSigmas) return burst;
  burst.begin = count_ - window_.size() + begin;
  burst.end = count_ - window_.size() + end;
  const double share = std::min(1.0, (burst.strength - kMinSigmas) / (kCertainSigmas - kMinSigmas));
  for (std::size_t i = begin; i < end; ++i) {
    const Motion& motion = window_[i];
    const Vec6 excess = share * motion.dt_s * (motion.rate - foretold);
    SuspectedJump jump;
    jump.motion << motion.q_odom_camera * excess.head<3>(), motion.q_odom_camera * excess.tail<3>();
    jump.error_m = share * length->sigma_m / static_cast<double>(length->frames);
    jump.error_rad = share * length->sigma_rad / static_cast<double>(length->frames);
    burst.jumps.emplace_back(motion.section, jump);
  }
  return burst;
}

/// Of bursts one of which may have swayed what the frames around the other foretell the greatest counts.
void MotionBursts::remember(const Burst& burst) {
  if (burst.begin > greatest_.end + kSide) settle();
  if (burst.size > greatest_.size) greatest_ = burst;
}

void MotionBursts::settle() {
  for (const auto& [section, jump] : greatest_.jumps) {
    if (jumps_.size() <= section) jumps_.resize(section + 1);
    add(jump, &jumps_[section]);
  }
  greatest_ = Burst();
}

MotionBursts::SuspectedJump MotionBursts::suspected_jump(std::size_t section) const {
  SuspectedJump sum = section < jumps_.size() ? jumps_[section] : SuspectedJump();
  for (const auto& [of_section, jump] : greatest_.jumps) {
    if (of_section == section) add(jump, &sum);
  }
  return sum;
}

bool BurstWatch::push(const Frame& frame) {
  constexpr int kFramesPerSection = 15;       // longer than any burst; half a second at 30 Hz
  constexpr double kMinTranslation_m = 0.05;  // less does not spoil a submap; finds the bursts of drifted recordings
  constexpr double kMinRotation_rad = 0.06;   // as much at about a metre
  bursts_.push(frame, section_);
  // A burst may lie across the border of two sections.
  Vec6 jump = bursts_.suspected_jump(section_).motion;
  if (section_ > 0) jump += bursts_.suspected_jump(section_ - 1).motion;
  const bool jumped = jump.head<3>().norm() > kMinTranslation_m || jump.tail<3>().norm() > kMinRotation_rad;
  constexpr std::size_t kBeyond = 2;  // what is still to come of this burst belongs to the old sections
  if (jumped || ++frames_ == kFramesPerSection) {
    section_ += jumped ? kBeyond : 1;
    frames_ = 0;
  }
  return jumped;
}

}  // namespace semantic_topo_loop::core
