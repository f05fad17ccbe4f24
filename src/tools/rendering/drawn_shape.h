#pragma once

#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "semantic_topo_loop/types/stamp.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// Floor, four walls and ceiling around a scene: a box seen from inside.
struct Room {
  SE3 T_world_room;          ///< middle of the box; z up, x and y along the first desk's
  Vec3 half = Vec3::Ones();  ///< half the length of its edges, m
};

/// The smallest room with its floor at z = 0 that keeps the walls clear of furniture and of the camera.
/// @param camera_path T_world_camera
Room room_around(const Scene& scene, const StampedPoses& camera_path);

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

// --- what surfaces look like (painted_shape.cpp) ------------------------------------------------------------------

struct Color {
  float b = 0.0F, g = 0.0F, r = 0.0F;
};

/// A shape with the pictures on its six faces, looked up at the size of a pixel's footprint.
class PaintedShape {
 public:
  /// @param inside  the shape is a room: its faces are seen from inside
  PaintedShape(const DrawnShape& shape, bool inside, std::uint64_t seed, std::uint64_t index);

  const DrawnShape& shape() const { return shape_; }
  /// @param p on the surface, in units of `half`, of that face   @param footprint_m width of what a pixel shows
  Color color(const Eigen::Vector3f& p, Face face, float footprint_m) const;

 private:
  DrawnShape shape_;
  bool inside_;
  std::array<std::vector<cv::Mat>, kFaces> textures_;  ///< by Face: a picture and its halvings (mip map), CV_8UC4
};

}  // namespace semantic_topo_loop::core
