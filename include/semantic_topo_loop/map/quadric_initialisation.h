#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/map/quadric_fit.h"

namespace semantic_topo_loop::core {

/// Largest angle between two of the lines from the cameras to the point, deg.
double parallax_deg(const std::vector<BoxView>& views, const Vec3& point_world);
/// A sphere from several boxes. Each side of a box that the image border does not cut is the trace of a plane through
/// the camera that touches the object: n'(X - camera) = r, linear in the centre X and in the half-width and half-height
/// r, solved by least squares with Cauchy weights. A box that is cut still counts with its other sides.
/// @return nullopt for fewer than 2 views, views without parallax, or a centre behind many of the cameras
std::optional<Ellipsoid> initialise_sphere(const Camera& camera, const std::vector<BoxView>& views);
/// An ellipsoid from one box and the points of the object's surface that were seen inside it (camera frame, m): centre
/// at the points' robust depth, image-aligned axes from the box, depth axis their mean.
std::optional<Ellipsoid> initialise_from_points(const Camera& camera, const BoxView& view,
                                                const std::vector<Vec3>& points_camera);

}  // namespace semantic_topo_loop::core
