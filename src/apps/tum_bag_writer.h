#pragma once

#include <string>

#include "tools/simulation/sequence.h"

namespace semantic_topo_loop {

struct TumBagOptions {
  bool with_images = true;  ///< /camera/rgb/image_color; else camera_info only
  /// Of render_sequence: its color images, with their depth as /camera/depth/image. Empty: tiny gray images, no depth.
  std::string image_directory;
  core::RenderingOptions rendering;  ///< that these images were rendered with
  std::string compression = "bz2";   ///< of chunks: bz2 as the official bags, lz4 or none
};

/// Pose of the color camera's optical frame on the simulated rig, `/kinect` being what the mocap tracks.
core::SE3 tum_kinect_from_optical();

/// Writes a bag in the layout of the official TUM RGB-D bags: /camera/rgb/camera_info with the driver's default
/// intrinsics (fx = 525, not the calibration), /camera/rgb/image_color (rgb8), and /tf as tf/tfMessage with leading
/// slashes: /world -> /kinect from the mocap at its rate, and the chain /kinect -> /openni_camera -> /openni_rgb_frame
/// -> /openni_rgb_optical_frame at a tenth of it. With rendered images also /camera/depth/camera_info and
/// /camera/depth/image (32FC1, metres, NaN where there is none), in the color camera's frame, or in
/// /openni_depth_optical_frame with its place in the chain if depth is not registered.
/// @return an error, with path and cause, if the file cannot be written or an image not be read: what was there stays
core::Status write_tum_bag(const core::SimulatedSequence& sequence, const std::string& path,
                           const TumBagOptions& options);

}  // namespace semantic_topo_loop
