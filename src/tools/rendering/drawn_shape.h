#pragma once

#include <vector>

#include "tools/rendering/room.h"
#include "tools/simulation/scene.h"

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

/// Faces of a box in its own axes; of an ellipsoid, the parts nearest to them.
enum Face : int { kFront, kBack, kLeftFace, kRightFace, kTopFace, kBottomFace };  ///< +x, -x, +y, -y, +z, -z
constexpr int kFaces = 6;

/// @param p on the surface, in units of `half`
inline Face face_of(const Eigen::Vector3f& p) {
  const Eigen::Vector3f size = p.cwiseAbs();
  const int axis = size.x() >= size.y() ? (size.x() >= size.z() ? 0 : 2) : (size.y() >= size.z() ? 1 : 2);
  return static_cast<Face>(2 * axis + (p[axis] < 0.0F ? 1 : 0));
}

/// A surface that rays meet: a box or an ellipsoid.
struct DrawnShape {
  bool is_box = true;
  int object = -1;           ///< index in Scene::objects; -1: furniture
  SE3 T_base_shape;          ///< base: the object's frame; the world for furniture
  Vec3 half = Vec3::Ones();  ///< semi-axes or half the edges, m
  Paint paint = Paint::kCloth;
};

/// Everything in the room. Round things are drawn as their ellipsoids. Things with corners are drawn as boxes that are
/// kBoxShare as wide and deep as the ellipsoid, since a box of the same axes would stick out of the ellipsoid's outline
/// in most views: so both are as wide in the mean over all sides. The height is kept, so that a box stands on the table
/// and shares the ellipsoid's centre; seen from 10 to 45 degrees above, the rectangle around it is a quarter taller.
std::vector<DrawnShape> drawn_shapes(const Scene& scene);

constexpr double kBoxShare = 0.8;

}  // namespace semantic_topo_loop::core
