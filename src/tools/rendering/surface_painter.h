#pragma once

#include <opencv2/core.hpp>

#include "tools/rendering/drawn_shape.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {

/// What one face shows, CV_8UC3: up in the picture is +z on the sides. No two calls with the same generator give the
/// same picture.
/// @param size px   @param texels_per_m of the picture   @param base see base_colour
cv::Mat paint_face(Paint paint, Face face, const cv::Size& size, float texels_per_m, const cv::Scalar& base,
                   Random* random);

/// Colour that the faces of one shape share, BGR.
cv::Scalar base_colour(Paint paint, Random* random);

}  // namespace semantic_topo_loop::core
