#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

#include "tools/rendering/scene_renderer.h"

namespace semantic_topo_loop::core {

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
