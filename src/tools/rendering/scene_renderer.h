#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "tools/rendering/painted_shape.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// Where each pixel of a raw image looks; computed once a camera, since undistorting is slow.
class PixelRays {
 public:
  explicit PixelRays(const Camera& camera);

  const Camera& camera() const { return camera_; }
  /// CV_32FC2: (x, y) of the ray with z = 1 through the middle of the pixel.
  const cv::Mat& rays() const { return rays_; }

 private:
  Camera camera_;
  cv::Mat rays_;
};

/// What an ideal camera sees at one moment (global shutter).
struct RenderedImage {
  cv::Mat color;    ///< CV_8UC3, BGR; empty if not asked for
  cv::Mat depth_m;  ///< CV_32FC1, along the camera's z axis
  cv::Mat cosine;   ///< CV_32FC1, of the angle between the ray and the surface's normal, (0, 1]
  /// Of the shapes drawn, one an object in order of Scene::objects; none if no pixel shows it. `whole` is in pixels of
  /// the undistorted image.
  std::vector<std::optional<ObjectView>> objects;
};

/// Casts rays into a scene: textured room, tables and objects. Const and safe to share between threads.
class SceneRenderer {
 public:
  /// @param seed of the textures, which stay on their surfaces
  SceneRenderer(const Scene& scene, const Room& room, std::uint64_t seed);

  /// @param time_s from the first image   @param with_color false: depth, cosine and objects only
  RenderedImage render(const PixelRays& rays, const SE3& T_world_camera, double time_s = 0.0,
                       bool with_color = true) const;

 private:
  Scene scene_;
  Room room_;
  std::vector<PaintedShape> shapes_;
  PaintedShape walls_;
};

}  // namespace semantic_topo_loop::core
