#pragma once

#include <algorithm>

#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// By what lengths in pixels, which are stated for an image 640 pixels wide, are longer in this one. In a narrower
/// image they stay: what it shows is blurred as far, and a detector sees it enlarged.
inline double pixel_factor(const Camera& camera) { return std::max(1.0, camera.width / 640.0); }

}  // namespace semantic_topo_loop::core
