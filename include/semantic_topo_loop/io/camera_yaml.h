#pragma once

#include <optional>
#include <string>

#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// Reads a calibration such as config/camera/tum_fr2.yaml: `fx, fy, cx, cy, width, height` (pixels) and `distortion`,
/// the five plumb-bob coefficients `[k1, k2, p1, p2, k3]`. Every key must be there.
/// @return nullopt, with file, line, key and value in `error`, for anything else
std::optional<Camera> read_camera(const std::string& path, std::string* error);
/// The text of such a file.
std::string format_camera(const Camera& camera);

}  // namespace semantic_topo_loop::core
