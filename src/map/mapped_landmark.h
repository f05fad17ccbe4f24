#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <vector>

#include "geometry/depth_points.h"
#include "map/quadric_fit.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// S_map_keyframe by keyframe_id; the scale, 1 unless it is free, is the map's units of length in one of the odometry.
using KeyframePlaces = std::map<std::int64_t, Sim3>;

/// A box of a landmark, hung on the keyframe of its frame so that it follows corrections.
struct Observation {
  std::int64_t frame_id = -1;
  std::int64_t source_id = -1;  ///< the landmark that association named; another than the holder's after a merge
  std::int64_t keyframe_id = -1;
  int class_id = -1;
  BoxView view;  ///< with the keyframe for a world, in the odometry's unit of length
};

/// The time that a frame stands for at most: a slow detector's interval.
constexpr double kStepMax_s = 0.2;

/// From how many keyframes a landmark was found, and from how many it was expected without. Time does not tell: a
/// mistake of the detector stays for as long as the camera hardly moves.
struct Views {
  int found = 0, missed = 0;
  std::int64_t keyframe_id = -1;  ///< the last one
  bool is_found = false;          ///< from there

  void add(std::int64_t keyframe, bool has_box) {
    if (keyframe != keyframe_id) {
      keyframe_id = keyframe;
      is_found = has_box;
      ++(has_box ? found : missed);
    } else if (has_box && !is_found) {
      is_found = true;
      --missed;
      ++found;
    }
  }
  /// 1 where nothing was counted yet, as in maps of before.
  double found_share() const { return found > 0 ? static_cast<double>(found) / (found + missed) : 1.0; }
};

/// How long a landmark was seen and should have been. Time, not counts, so that 6 Hz and 30 Hz behave alike. Where
/// depth tells of what one box shows, the time that it was seen is weighed by the detector's score.
struct Sightings {
  double seen_s = 0.0;            ///< with a box
  double whole_s = 0.0;           ///< with a box that the image border does not cut
  double expected_s = 0.0;        ///< in view, large enough and not hidden
  double placed_s = 0.0;          ///< with a box that depth places
  Vec4 bounded_s = Vec4::Zero();  ///< for each side, with a box that is not cut there
  /// Expected from where it had been seen before: with a box, without one, and without one since the last box.
  double familiar_seen_s = 0.0, familiar_missed_s = 0.0, missed_since_s = 0.0;
  /// Of familiar_seen_s, where depth shows its inside, as the seat of a chair.
  double hollow_s = 0.0;
  /// In view where depth shows what lies behind it: while it had a box (it has holes, or is misplaced), and without a
  /// box since the last one (it has gone; of what is not hollow, its inside tells the same).
  double transparent_s = 0.0, seen_through_since_s = 0.0;
  Views views;

  bool is_hollow() const { return hollow_s > 0.5 * familiar_seen_s; }
  /// Of the time with a box, that in which depth showed that nothing is there.
  double hole_share() const {
    const double holes_s = transparent_s + (is_hollow() ? 0.0 : hollow_s);
    return holes_s > 0.0 ? holes_s / std::max(seen_s, holes_s) : 0.0;
  }

  /// Whether depth has told most of the time where it is.
  bool is_placed() const { return placed_s > 0.5 * seen_s; }
  /// Of the side that was cut most. Maps of before counted sides only where depth places.
  double least_bounded_s() const { return std::max(whole_s, bounded_s.minCoeff()); }
  double seen_share() const { return expected_s > 0.0 ? seen_s / expected_s : 1.0; }
  /// Of familiar views; without the last absence, which says nothing of the time before.
  double familiar_s() const { return familiar_seen_s + (familiar_missed_s - missed_since_s); }
  /// Of these, those with a box, 1 if there are none.
  double familiar_share() const { return familiar_seen_s > 0.0 ? familiar_seen_s / familiar_s() : 1.0; }
  /// @param sign -1 to take back what was added
  void add(const Sightings& other, double sign = 1.0) {
    seen_s += sign * other.seen_s;
    whole_s += sign * other.whole_s;
    placed_s += sign * other.placed_s;
    bounded_s += sign * other.bounded_s;
    familiar_seen_s += sign * other.familiar_seen_s;
    familiar_missed_s += sign * other.familiar_missed_s;
    hollow_s += sign * other.hollow_s;
    transparent_s += sign * other.transparent_s;
    views.found += sign > 0.0 ? other.views.found : -other.views.found;
    views.missed += sign > 0.0 ? other.views.missed : -other.views.missed;
  }
};

/// From where a landmark was seen: directions in bins of about 25 deg, with the smallest box that showed it there. What
/// was never detected from behind or from afar has not gone when it is not detected there again.
class SeenFrom {
 public:
  void add(const Vec3& direction_map, double box_size_px) {
    float& smallest = smallest_px_[bin(direction_map)];
    const auto size = static_cast<float>(box_size_px);
    smallest = smallest == 0.0F ? size : std::min(smallest, size);
  }
  void add(const SeenFrom& other) {
    for (std::size_t i = 0; i < smallest_px_.size(); ++i) {
      const float theirs = other.smallest_px_[i];
      float& ours = smallest_px_[i];
      if (theirs > 0.0F) ours = ours == 0.0F ? theirs : std::min(ours, theirs);
    }
  }
  /// With the map: what was seen from a direction was seen from where that is now.
  void turn(const Quaternion& q_new_old) {
    SeenFrom turned;
    for (std::size_t i = 0; i < smallest_px_.size(); ++i) {
      if (smallest_px_[i] > 0.0F) turned.add(q_new_old * middle(i), static_cast<double>(smallest_px_[i]));
    }
    *this = turned;
  }
  /// With the camera: as large as a box there is in the pixels of another.
  void scale(double factor) {
    for (float& smallest : smallest_px_) smallest *= static_cast<float>(factor);
  }
  bool covers(const Vec3& direction_map, double box_size_px) const {
    const float smallest = smallest_px_[bin(direction_map)];
    return smallest > 0.0F && box_size_px >= static_cast<double>(smallest);
  }

  /// By far, from wherever: a detector finds nothing below a size of its own.
  bool is_smaller_than_ever(double box_size_px) const {
    constexpr float kByFar = 0.7F;
    const auto is_smaller = [box_size_px](float smallest) {
      return smallest == 0.0F || box_size_px < static_cast<double>(kByFar * smallest);
    };
    const auto is_known = [](float smallest) { return smallest > 0.0F; };
    return std::any_of(smallest_px_.begin(), smallest_px_.end(), is_known) &&
           std::all_of(smallest_px_.begin(), smallest_px_.end(), is_smaller);
  }

  static constexpr int kSteps = 4;  // along each side of a cube's face
  using Bins = std::array<float, 6 * kSteps * kSteps>;
  /// Smallest boxes by direction, px; 0 where it was not seen from.
  const Bins& smallest_px() const { return smallest_px_; }
  explicit SeenFrom(const Bins& smallest_px = {}) : smallest_px_(smallest_px) {}

 private:
  static std::size_t bin(const Vec3& direction) {
    Eigen::Index axis = 0;
    const double largest = direction.cwiseAbs().maxCoeff(&axis);
    const auto step = [&](Eigen::Index i) {
      return std::clamp(static_cast<int>(0.5 * kSteps * (1.0 + direction(i) / largest)), 0, kSteps - 1);
    };
    const int face = static_cast<int>(axis) + (direction(axis) < 0.0 ? 3 : 0);
    return static_cast<std::size_t>((face * kSteps + step((axis + 1) % 3)) * kSteps + step((axis + 2) % 3));
  }

  /// A direction in the middle of a bin.
  static Vec3 middle(std::size_t bin) {
    const auto step = [](std::size_t i) { return (2.0 * static_cast<double>(i % kSteps) + 1.0) / kSteps - 1.0; };
    const auto face = static_cast<Eigen::Index>(bin / (kSteps * kSteps));
    Vec3 direction;
    direction(face % 3) = face < 3 ? 1.0 : -1.0;
    direction((face + 1) % 3) = step(bin / kSteps);
    direction((face + 2) % 3) = step(bin);
    return direction;
  }

  Bins smallest_px_;
};

/// What is known of a landmark beside its boxes.
struct LandmarkRecord {
  Landmark state;
  std::map<std::int64_t, int> seen_beside;  ///< frames in which another landmark had a separate box
  Sightings sightings;
  SeenFrom seen_from;
  std::int64_t last_stamp_ns = 0;
  int next_fit_at = 0;
  bool was_confirmed = false;  ///< when the session before ended
};

struct MappedLandmark : LandmarkRecord {
  std::vector<Observation> observations;  ///< bounded: thinned when too many, where most are
  double seen_at_s = 0.0;                 ///< when it had its last box, in the time that somebody looked this session
};

/// The corrected keyframes and the camera: what turns observations into views.
class ViewSource {
 public:
  ViewSource(const Camera& camera, const KeyframePlaces& S_map_keyframe)
      : camera_(camera), S_map_keyframe_(S_map_keyframe) {}

  const Camera& camera() const { return camera_; }
  BoxView view(const Observation& observation) const {
    const Sim3& S_map_keyframe = S_map_keyframe_.at(observation.keyframe_id);
    const BoxView& view = observation.view;
    // Depth is in the odometry's unit of length, as its translations are.
    return {S_map_keyframe.pose(view.T_world_camera), view.box, view.truncated, S_map_keyframe.scale * view.near_m};
  }
  std::vector<BoxView> views(const std::vector<Observation>& observations) const {
    std::vector<BoxView> result;
    result.reserve(observations.size());
    for (const Observation& observation : observations) result.push_back(view(observation));
    return result;
  }

 private:
  const Camera& camera_;
  const KeyframePlaces& S_map_keyframe_;
};

struct ExpectedLandmark {
  std::int64_t id = -1;
  double size_px = 0.0;       ///< of its projected box, as far as it is in view
  double share = 1.0;         ///< of its projected box that is in view
  bool is_seen_into = false;  ///< depth shows what lies between its near and its far side
  bool is_seen_through =
      false;  ///< depth shows what lies behind it: behind its near side, or its far side if it is hollow
};

constexpr double kFullyVisibleShare = 0.8;  // of a projection's area inside the image, from which on it is not cut

/// The landmarks that should have a box in this frame: in view, large enough, as near as association looks, and
/// hidden by nothing known: not by a nearer landmark, not by the box of something that is no landmark (a person), and,
/// where the frame has points, not by points in front of it. What points see through need not be fully in view.
/// @param points of the frame; null without   @param least_share of a projection that must be in view
/// @return in order of id
std::vector<ExpectedLandmark> expected_landmarks(const std::map<std::int64_t, MappedLandmark>& landmarks,
                                                 const Frame& frame, const FramePoints* points, const SE3& T_map_camera,
                                                 const AssociationFrame& associations,
                                                 double least_share = kFullyVisibleShare);

/// rho in [0, 1]: 1 for an object well seen from all around, 0 for a guess.
///   rho = mean IoU (1 - e^(-baseline / 15 deg)) (1 - e^(-seen / 0.7 s)) / (1 + sigma / 5 cm),
/// with sigma the root mean variance of the centre; without the baseline where depth places it.
double landmark_quality(const MappedLandmark& landmark);

/// Candidate, confirmed or retired, from what is known now; only what is movable can have gone.
LandmarkState life_cycle_state(const MappedLandmark& landmark, const QuadricMapperOptions& options, bool is_movable);

}  // namespace semantic_topo_loop::core
