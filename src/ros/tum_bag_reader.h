#pragma once

#include <memory>
#include <string>

#include "semantic_topo_loop/io/rgbd_recording.h"

namespace semantic_topo_loop {

/// The colour images of a bag in the official TUM layout, with their depth, as the player gives them to the
/// RgbdFrontend nodelet. Needs no master.
/// @return null, with the file and cause in `error`, if it cannot be read
std::unique_ptr<core::RgbdRecording> open_tum_bag(const std::string& file, const core::Camera& camera,
                                               const core::DepthOptions& options, std::string* error);

}  // namespace semantic_topo_loop
