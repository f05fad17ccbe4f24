#pragma once

#include <cstdint>
#include <limits>
#include <opencv2/core.hpp>
#include <optional>
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

/// A shape as the rays of one camera meet it: the unit cube or unit sphere after p_camera -> scale * p_camera + origin.
struct CastShape {
  Eigen::Matrix3f scale = Eigen::Matrix3f::Identity();
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();
  Eigen::Matrix3f R_camera_shape = Eigen::Matrix3f::Identity();
  Eigen::Vector3f inverse_half = Eigen::Vector3f::Ones();
  bool is_box = true;
  int shape = -1;   ///< index of the drawn shape
  int object = -1;  ///< of that shape
  Box bounds;       ///< holds every ray (x, y, 1) that can hit

  Eigen::Vector3f point(const Eigen::Vector3f& ray, float depth) const { return depth * (scale * ray) + origin; }
  /// Unit normal in the camera frame at a point of the surface (in units of `half`) and its face, outwards.
  Eigen::Vector3f normal(const Eigen::Vector3f& point, Face face) const {
    if (!is_box) return (R_camera_shape * point.cwiseProduct(inverse_half)).normalized();
    const Eigen::Vector3f axis = R_camera_shape.col(face / 2);
    return face % 2 == 0 ? axis : Eigen::Vector3f(-axis);
  }
};

/// @return nullopt if no part of the shape lies in front of the camera
std::optional<CastShape> cast_shape(const DrawnShape& shape, const SE3& T_camera_shape, int index);

/// A ray has z = 1, so that the distance in its lengths is the depth. Infinity if it misses.
constexpr float kMiss = std::numeric_limits<float>::infinity();
float depth_of_entry(const CastShape& shape, const Eigen::Vector3f& ray);
/// Where a ray leaves a box that it starts in.
float depth_of_exit(const CastShape& shape, const Eigen::Vector3f& ray);

// --- what surfaces look like (painted_shape.cpp) ------------------------------------------------------------------

struct Color {
  float b = 0.0F, g = 0.0F, r = 0.0F;
};

/// A picture on a flat rectangle with its halvings (mip map), looked up at the size of a pixel's footprint.
class SurfaceTexture {
 public:
  /// @param image CV_8UC3, BGR   @param texels_per_m its resolution on the surface
  SurfaceTexture(const cv::Mat& image, float texels_per_m);

  /// @param u,v in [0, 1] across and down the picture   @param footprint_m width of what is averaged
  Color sample(float u, float v, float footprint_m) const;

 private:
  std::vector<cv::Mat> levels_;  ///< CV_8UC4
  float texels_per_m_ = 1.0F;
};

/// A shape with the pictures on its six faces.
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
  std::vector<SurfaceTexture> textures_;  ///< by Face
};

}  // namespace semantic_topo_loop::core
