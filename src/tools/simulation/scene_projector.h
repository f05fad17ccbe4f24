#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// What a camera sees of an ellipsoid without a detector's errors.
struct ObjectView {
  Box whole;             ///< raw (distorted) pixels, not clipped; far outside the image only roughly right
  Box box;               ///< the same around the unoccluded part, clipped to the image
  double visible = 0.0;  ///< share of the outline's area inside the image that nothing nearer hides, [0, 1]
  double inside = 0.0;   ///< share of `whole` that lies in the image, [0, 1]
};

/// Projects ellipsoids with occlusion by other ellipsoids and table tops.
class SceneProjector {
 public:
  /// @param scene must outlive the projector
  SceneProjector(const Scene& scene, const Camera& camera);

  /// @param time_s from the first image; where nothing moves, any
  /// @return one view an object, in order of Scene::objects; none if the object is behind or outside the image, or not
  ///         in the room
  std::vector<std::optional<ObjectView>> project(const SE3& T_world_camera, double time_s = 0.0) const;
  /// The raw box around an ellipsoid, not clipped and not occluded.
  std::optional<Box> raw_box(const Ellipsoid& ellipsoid, const SE3& T_world_camera) const;

 private:
  struct Caster;

  ObjectView view(const Box& whole, std::size_t object, const std::vector<Caster>& casters,
                  const SE3& T_world_camera) const;
  static std::vector<const Caster*> possible_hiders(std::size_t object, const std::vector<Caster>& casters);
  static bool is_hidden(const Vec3& ray, double range, const std::vector<const Caster*>& hiders);
  bool is_below_table(const Ellipsoid& ellipsoid) const;
  bool is_under_table(const Vec3& point_camera, const SE3& T_world_camera) const;
  Vec2 distort(const Vec2& pixel) const;

  const Scene* scene_;
  Camera camera_;
  Box undistorted_image_;  ///< where the lens model is known to hold
};

}  // namespace semantic_topo_loop::core
