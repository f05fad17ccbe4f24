#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct DriftOptions {
  std::string model = "smooth";
  double position_m = 0.3;
  double rotation_deg = 5.0;
  double scale_percent = 0.0;
  double global_scale = 1.0;

  void visit(OptionVisitor& visitor) {
    visitor.module("drift");
    visitor("model", model, one_of({"smooth", "jump"}),
            "smooth (steady drift) or jump (good locally, with three bursts of 8 frames)");
    visitor("position_m", position_m, not_negative(), "largest position error of the odometry; both 0: exact odometry");
    visitor("rotation_deg", rotation_deg, at_least(0).below(170), "largest rotation error of the odometry");
    visitor("scale_percent", scale_percent, not_negative(),
            "monocular odometry: largest change of its scale since the first pose, by a random walk");
    visitor("global_scale", global_scale, positive(), "monocular odometry: its units of length in a metre, at first");
  }
};

/// Replays the motion between consecutive poses with an error, so that the poses drift as an odometry's do: `smooth`
/// with a slowly varying rate, a scale error and noise, growing with motion; `jump` with little of that but three
/// bursts of 8 frames. The errors are scaled until the largest distance and angle from the truth are those asked for.
/// @param T_world_camera true poses, in time order
/// @return drifted poses in the same world, the first one exact; an error that names both levels if no drawn error
/// meets them (a rotation that alone moves the camera farther than the position level allows)
Result<std::vector<SE3>> drift_poses(const std::vector<SE3>& T_world_camera, const DriftOptions& options,
                                     std::uint64_t seed);

/// Replays the motion in a unit of length that is `global_scale` at first and then drifts as a monocular odometry's
/// does: a random walk of its logarithm along the path, whose largest change is log(1 + scale_percent / 100).
/// @return poses that begin at the same one; those given where there is nothing to change
std::vector<SE3> drift_scale(const std::vector<SE3>& T_world_camera, const DriftOptions& options, std::uint64_t seed);

/// How recorded detections are made worse, to measure what a detector's errors cost. The program checks the ranges.
struct PerturbationOptions {
  double drop = 0.0;     ///< share of boxes left out, [0, 1]
  double relabel = 0.0;  ///< share of boxes that get another class, [0, 1]
  double jitter = 0.0;   ///< standard deviation of a corner, share of the box's width (x) and height (y), [0, 1]
};

struct PerturbationCounts {
  int boxes = 0;  ///< of the input
  int dropped = 0;
  int relabelled = 0;  ///< of those not dropped
};

/// Corrupts every box by itself, in this order:
/// 1. drop: the box is left out with probability `drop`; an image keeps its place without boxes;
/// 2. relabel: with probability `relabel` the class becomes another one, uniform over the other classes of the input
///    (before anything was dropped); with one class only, labels stay;
/// 3. jitter: Gaussian errors, independent for x1, y1, x2 and y2. Corners that cross are swapped, so that boxes stay
///    boxes; they are not clipped, for the image's size is unknown here.
///
/// Every box takes the same random numbers whatever the options, so that one option leaves the others' effects as they
/// are: with the same seed, a larger `drop` leaves out more of the same boxes.
std::vector<DetectionFrame> perturb_detections(const std::vector<DetectionFrame>& frames,
                                               const PerturbationOptions& options, std::uint64_t seed,
                                               PerturbationCounts* counts);

/// The program checks the ranges.
struct FalseLoopOptions {
  int count = 10;              ///< loops
  int cluster_size = 1;        ///< loops of neighbouring keyframes that agree, as aliased places give them, > 0
  int min_gap_keyframes = 15;  ///< between query and match, > 0
  int window_frames = 200;     ///< of the evidence on either side
  double distance_m = 1.0;     ///< a loop contradicts the odometry by 1 to 2 times this
  double rotation_deg = 30.0;  ///< and by 1 to 2 times this angle about a random axis
  double sigma_m = 0.03;       ///< standard deviation that the loops state, of each axis, > 0
  double sigma_deg = 1.0;      ///< the same of the rotation, > 0
};

/// Keyframe ids of query and match.
using KeyframePairs = std::set<std::pair<std::int64_t, std::int64_t>>;

/// Accepted loops that are wrong, to be handed to a pose graph at their query frames. No two join the same keyframes.
/// @param keyframes with the poses of the odometry, in order
/// @param taken pairs that no loop joins   @return in order of the query frame; fewer than `count` if there is no room
std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed, KeyframePairs taken = {});

}  // namespace semantic_topo_loop::core
