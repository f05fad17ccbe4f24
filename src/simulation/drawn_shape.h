#pragma once

#include <vector>

#include "semantic_topo_loop/simulation/room.h"
#include "semantic_topo_loop/simulation/scene.h"

namespace semantic_topo_loop::core {

/// What a surface looks like; how is up to the painter.
enum class Paint {
  kWalls,
  kTableTop,
  kDarkMetal,
  kCover,    ///< of a book
  kScreen,   ///< of a monitor: pictures on the face towards +x, dark elsewhere
  kDisplay,  ///< of a small device, upwards
  kKeys,
  kDial,
  kGlaze,  ///< of pottery
  kLabel,  ///< of a bottle
  kPeel,
  kLeaves,
  kCloth,
  kFur,
};

/// A surface that rays meet: a box or an ellipsoid.
struct DrawnShape {
  bool is_box = true;
  int object = -1;           ///< index in Scene::objects; -1: furniture
  SE3 T_base_shape;          ///< base: the object's frame; the world for furniture
  Vec3 half = Vec3::Ones();  ///< semi-axes or half the edges, m
  Paint paint = Paint::kCloth;
};

/// Everything in the room. Round things are drawn as their ellipsoids. Things with corners are drawn as boxes whose
/// edges are shorter than the ellipsoid's axes, since a box of the same axes would stick out of the ellipsoid's outline
/// in most views: at `kBoxShare` the rectangles around both agree in the mean over all directions. The height is kept,
/// so that the box stands on the table and shares the ellipsoid's centre.
std::vector<DrawnShape> drawn_shapes(const Scene& scene);

constexpr double kBoxShare = 0.85;

}  // namespace semantic_topo_loop::core
