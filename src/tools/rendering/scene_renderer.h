#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "tools/rendering/drawn_shape.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// Where each pixel of a raw image looks; computed once a camera, since undistorting is slow.
struct PixelRays {
  explicit PixelRays(const Camera& of_camera);

  const Camera camera;
  cv::Mat rays;  ///< CV_32FC2: (x, y) of the ray with z = 1 through the middle of the pixel
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
struct SceneRenderer {
  /// @param seed of the textures, which stay on their surfaces
  SceneRenderer(const Scene& of_scene, const Room& of_room, std::uint64_t seed);

  /// @param time_s from the first image   @param with_color false: depth, cosine and objects only
  RenderedImage render(const PixelRays& rays, const SE3& T_world_camera, double time_s = 0.0,
                       bool with_color = true) const;

  const Scene scene;
  const Room room;
  std::vector<PaintedShape> shapes;
  PaintedShape walls;
};

/// Depth as a structured-light camera measures it, from an ideal rendering. Disparities of f b = 580 px x 7.5 cm have
/// noise of 0.05 px and steps of 1/8 px, which gives a standard deviation of about 1.4 mm at 1 m that grows with the
/// square of the range (Khoshelham and Elberink 2012). Outlines are ragged: each pixel looks up the depth of a random
/// neighbour (as in Handa et al. 2014). NaN where there is none: nearer than 0.4 m, at grazing incidence, where a
/// nearer surface hides the projector 7.5 cm beside the camera, and in one pixel of 500. Infinity where it is too far:
/// ever more pixels from 4.5 m, all from 6 m.
/// @param seed of this image   @return CV_32FC1, m
cv::Mat kinect_depth(const RenderedImage& ideal, const PixelRays& rays, std::uint64_t seed);

/// A color image with the softness of its lens, darker corners and noise.
/// @param seed of this image   @return CV_8UC3
cv::Mat kinect_color(const cv::Mat& ideal, std::uint64_t seed);

}  // namespace semantic_topo_loop::core
