#pragma once

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

struct SceneOptions {
  std::string layout = "desk";
  int desks = 3;
  bool identical_desks = false;

  void visit(OptionVisitor& visitor) {
    visitor("scene.layout", layout, one_of({"desk", "office"}), "desk (one large desk) or office (a row of desks)");
    visitor("scene.desks", desks, between(1, 50), "office: number of desks");
    visitor("scene.identical_desks", identical_desks, "office: every desk carries the same objects at the same places");
  }
};

/// A stretch of an object's life; it ends when the next one begins.
struct ObjectPhase {
  double begin_s = 0.0;          ///< from the first image
  bool is_present = true;        ///< false: not in the room
  SE3 T_world_object;            ///< at begin_s
  Vec3 velocity = Vec3::Zero();  ///< world frame, m/s
};

/// A labelled object. Its z axis is vertical.
struct SceneObject {
  int class_id = -1;                ///< COCO, 0..79
  Ellipsoid ellipsoid;              ///< of an object that moves: where it is at last
  std::vector<ObjectPhase> phases;  ///< in order of time; empty: always at rest

  /// Where it is at a time; nullopt if it is not in the room then.
  std::optional<Ellipsoid> at(double time_s) const;
  /// True if it is in the room, at rest, from some time to the end.
  bool stays() const;
};

/// A rectangular table top; x is its depth (front at +x), y its width, z up, origin in the middle of the surface.
struct Desk {
  SE3 T_world_desk;
  double half_depth_m = 0.0;
  double half_width_m = 0.0;
};

/// A room in a z-up world whose floor is z = 0.
struct Scene {
  std::vector<Desk> desks;
  std::vector<SceneObject> objects;
};

/// Lays out desks and fills them with objects of plausible sizes. Every object rests on a table top or on the floor,
/// and no two overlap (their footprints keep a gap); an object that finds no free place is left out.
Scene make_scene(const SceneOptions& options, std::uint64_t seed);

}  // namespace semantic_topo_loop::core
