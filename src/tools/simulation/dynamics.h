#pragma once

#include <cstdint>
#include <string>

#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/simulation/scene.h"
#include "tools/simulation/trajectory.h"

namespace semantic_topo_loop::core {

/// What moves in a scene while the camera looks.
struct DynamicsOptions {
  int persons = 0;
  int moved_objects = 0;
  double move_time_s = 36.0;

  void visit(OptionVisitor& visitor) {
    visitor("dynamics.persons", persons, between(0, 100), "people who walk through the view, one after the other");
    visitor("dynamics.moved_objects", moved_objects, not_negative(),
            "small objects, cups first, that are moved to another place");
    visitor("dynamics.move_time_s", move_time_s, positive(), "when they are moved");
  }
};

/// Adds motion to a scene at rest.
/// - People cross the view at walking pace at times spread evenly over the sequence, in turn between the camera and
/// what
///   it looks at, so that they hide it, and behind that. They are in the room only while they walk, and pass through
///   furniture.
/// - Moved objects are at their first place until `move_time_s` and from then on at another one, on another desk if
///   there is one, else at least half a metre away on the same. An object that finds no free place is not moved.
///
/// @param trajectory of the camera, in the scene
void add_dynamics(const DynamicsOptions& options, const CameraTrajectory& trajectory, double duration_s,
                  std::uint64_t seed, Scene* scene);

}  // namespace semantic_topo_loop::core
