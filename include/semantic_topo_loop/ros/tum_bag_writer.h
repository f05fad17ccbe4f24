#pragma once

#include <string>

#include "semantic_topo_loop/simulation/sequence.h"

namespace semantic_topo_loop {

struct TumBagOptions {
  bool with_images = true;  ///< tiny grey /camera/rgb/image_color; else camera_info only
};

/// Pose of the colour camera's optical frame on the simulated rig, `/kinect` being what the mocap tracks.
core::SE3 tum_kinect_from_optical();

/// Writes a bag in the layout of the official TUM RGB-D bags, without depth: /camera/rgb/camera_info with the driver's
/// default intrinsics (fx = 525, not the calibration), /camera/rgb/image_color (rgb8, 8x6), and /tf as tf/tfMessage
/// with leading slashes: /world -> /kinect from the mocap at its rate, and the chain /kinect -> /openni_camera ->
/// /openni_rgb_frame -> /openni_rgb_optical_frame at a tenth of it. Chunks are compressed with bz2.
/// @return false, with path and cause in `error`, if the file cannot be written
bool write_tum_bag(const core::SimulatedSequence& sequence, const std::string& path, const TumBagOptions& options,
                   std::string* error);

}  // namespace semantic_topo_loop
