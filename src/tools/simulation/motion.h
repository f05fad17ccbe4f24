#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/simulation/random.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

struct TrajectoryOptions {
  std::string model = "handheld";
  double duration_s = 60.0;
  double rate_hz = 30.0;
  double lap_s = 36.0;
  int first_desk = 1;
  int desks = 0;
  double arc_deg = 360.0;
  double distance_m = 1.6;
  double height_m = 1.45;
  double wander_m = 0.15;
  double shake_m = 0.003;
  double shake_deg = 0.4;
  double parked_share = 0.0;

  void visit(OptionVisitor& visitor) {
    visitor.module("trajectory");
    visitor("model", model, one_of({"handheld", "robot"}),
            "handheld (looks at the desks, wanders and shakes) or robot (wheels, a fixed camera that looks ahead and "
            "aside; stops to look around)");
    visitor("duration_s", duration_s, positive(), "length of the sequence");
    visitor("rate_hz", rate_hz, positive(), "images per second");
    visitor("lap_s", lap_s, positive(), "time of one lap around the desks; what comes later revisits");
    visitor("first_desk", first_desk, at_least(1), "office, house: the desk where the row that is visited begins");
    visitor("desks", desks, not_negative(), "office, house: how many desks are visited; 0: all from the first one on");
    visitor("arc_deg", arc_deg, above(0).at_most(360),
            "handheld: less than 360 swings to and fro over that share of a lap");
    visitor("distance_m", distance_m, at_least(0.5), "horizontal distance from the desks' middle line");
    visitor("height_m", height_m, at_least(0.9).below(10), "mean height of the camera above the floor");
    visitor("wander_m", wander_m, between(0, 0.3), "slow deviation of position and of the point looked at");
    visitor("shake_m", shake_m, between(0, 0.1), "shake of the hand, standard deviation in position");
    visitor("shake_deg", shake_deg, between(0, 10), "shake of the hand, standard deviation in rotation");
    visitor("parked_share", parked_share, between(0, 0.9), "robot: share of every half hour, its end, that it stands");
    visitor.require("duration_s", duration_s * rate_hz >= 2.0 && duration_s * rate_hz < 1e6,
                    "long enough for 2 and short enough for 1e6 images");
  }
};

/// How a camera moves through a scene: the pose T_world_camera of its optical frame (x right, y down, z forward).
/// Continuous in time, so that any sensor can sample it.
using CameraTrajectory = std::function<SE3(double time_s)>;

/// By TrajectoryOptions::model: a handheld camera goes round the desks at a steady pace and looks at them, wandering
/// and shaking. A wheeled robot drives round the desks: it heads where it goes, its camera keeps its height and its
/// tilt and is mounted turned towards the desks; every few seconds it stops and turns to and fro on the spot.
CameraTrajectory make_trajectory(const Scene& scene, const TrajectoryOptions& options, std::uint64_t seed);

/// What moves in a scene while the camera looks.
struct DynamicsOptions {
  int persons = 0;
  int moved_objects = 0, removed_objects = 0, new_objects = 0;
  double move_time_s = 36.0;

  bool changes_objects() const { return moved_objects + removed_objects + new_objects > 0; }
  void visit(OptionVisitor& visitor) {
    visitor.module("dynamics");
    visitor("persons", persons, between(0, 10000), "people who walk through the view, one after the other");
    visitor("moved_objects", moved_objects, not_negative(),
            "small objects, cups first, that are moved to another place");
    visitor("removed_objects", removed_objects, not_negative(), "objects, chairs first, that are taken away");
    visitor("new_objects", new_objects, not_negative(), "small objects, bottles first, that are there only then");
    visitor("move_time_s", move_time_s, positive(), "when they are moved, taken away or brought");
  }
};

/// Adds motion to a scene at rest.
/// - People cross the view at walking pace at times spread evenly over the sequence, in turn behind what the camera
/// looks
///   at and before it, where they hide it. They are in the room only while they walk, and pass through furniture.
/// - Moved objects are at their first place until `move_time_s` and from then on at another one, on another desk if
///   there is one, else at least half a metre away on the same. An object that finds no free place is not moved.
///   Removed ones are there until then, new ones from then on.
///
/// @param trajectory of the camera, in the scene
void add_dynamics(const DynamicsOptions& options, const CameraTrajectory& trajectory, double duration_s,
                  std::uint64_t seed, Scene* scene);

}  // namespace semantic_topo_loop::core
