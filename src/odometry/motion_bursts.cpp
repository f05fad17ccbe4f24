#include "odometry/motion_bursts.h"

#include <algorithm>
#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::array<std::size_t, 6> kLengths{1, 2, 4, 6, 8, 11};  // frames
constexpr std::size_t kSide = 5;         // frames before and as many after, whose mean foretells
constexpr std::size_t kHistory = 600;    // frames that say what is usual
constexpr std::size_t kMinHistory = 60;  // before that nothing is
constexpr std::size_t kRefresh = 16;     // frames after which it is asked again
constexpr double kSuspicious = 6.0;      // times the usual difference: few motions of a hand-held camera are beyond
constexpr double kCertain = 10.0;
constexpr double kDoubt = 3.0;  // times the usual difference: so much of a burst's size may be none of it

/// Sigma of each axis, by what nine of ten differences stay below: the worst tenth may be jumps or a shaky odometry's
/// own.
double usual(std::vector<double> norms) {
  constexpr double kNinthTenth = 2.5;  // of the norm of three, in sigmas
  const auto at = norms.begin() + static_cast<std::ptrdiff_t>(norms.size() * 9 / 10);
  std::nth_element(norms.begin(), at, norms.end());
  constexpr double kTiny = 1e-9;
  return *at / kNinthTenth + kTiny;
}

void put(double value, std::size_t turn, std::vector<double>* history) {
  if (history->size() < kHistory) {
    history->push_back(value);
  } else {
    (*history)[turn % kHistory] = value;
  }
}

void add(const MotionBursts::Suspect& more, MotionBursts::Suspect* sum) {
  sum->motion += more.motion;
  sum->error_m += more.error_m;
  sum->error_rad += more.error_rad;
}

}  // namespace

MotionBursts::MotionBursts() {
  for (std::size_t i = 0; i < kLengths.size(); ++i) lengths_[i].frames = kLengths[i];
}

void MotionBursts::push(const StampedPose& pose, bool is_break, std::size_t section) {
  const std::optional<StampedPose> last = last_;
  last_ = pose;
  if (!last || is_break || pose.stamp_ns <= last->stamp_ns) return;
  const double dt_s = 1e-9 * static_cast<double>(pose.stamp_ns - last->stamp_ns);
  window_.push_back(
      {se3_log(last->T_world_camera.inverse() * pose.T_world_camera) / dt_s, pose.T_world_camera.q, dt_s, section});
  ++count_;
  if (window_.size() > kLengths.back() + 2 * kSide) window_.pop_front();
  Burst best;
  for (Length& length : lengths_) {
    if (window_.size() < length.frames + 2 * kSide) continue;
    Burst burst = judge(&length);
    if (burst.strength > kSuspicious && burst.size > best.size) best = std::move(burst);
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
    if (length->sigma_m == 0.0 || length->next % kRefresh == 0) {
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
  put(translation, length->next, &length->translations);
  put(rotation, length->next, &length->rotations);
  ++length->next;
  if (burst.strength <= kSuspicious) return burst;
  burst.begin = count_ - window_.size() + begin;
  burst.end = count_ - window_.size() + end;
  const double share = std::min(1.0, (burst.strength - kSuspicious) / (kCertain - kSuspicious));
  for (std::size_t i = begin; i < end; ++i) {
    const Motion& motion = window_[i];
    const Vec6 excess = share * motion.dt_s * (motion.rate - foretold);
    Suspect suspect;
    suspect.motion << motion.q_odom_camera * excess.head<3>(), motion.q_odom_camera * excess.tail<3>();
    suspect.error_m = share * length->sigma_m / static_cast<double>(length->frames);
    suspect.error_rad = share * length->sigma_rad / static_cast<double>(length->frames);
    burst.suspects.emplace_back(motion.section, suspect);
  }
  return burst;
}

/// Of bursts one of which may have swayed what the frames around the other foretell the greatest counts.
void MotionBursts::remember(const Burst& burst) {
  if (burst.begin > greatest_.end + kSide) settle();
  if (burst.size > greatest_.size) greatest_ = burst;
}

void MotionBursts::settle() {
  for (const auto& [section, suspect] : greatest_.suspects) {
    if (suspects_.size() <= section) suspects_.resize(section + 1);
    add(suspect, &suspects_[section]);
  }
  greatest_ = Burst();
}

MotionBursts::Suspect MotionBursts::suspect(std::size_t section) const {
  Suspect sum = section < suspects_.size() ? suspects_[section] : Suspect();
  for (const auto& [of_section, suspect] : greatest_.suspects) {
    if (of_section == section) add(suspect, &sum);
  }
  return sum;
}

}  // namespace semantic_topo_loop::core
