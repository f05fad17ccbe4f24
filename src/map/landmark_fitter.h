#pragma once

#include <optional>
#include <vector>

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

/// Largest angle between two of the lines from the cameras to the point, deg.
double parallax_deg(const std::vector<BoxView>& views, const Vec3& point_world);
/// A sphere from several boxes. Each side of a box that the image border does not cut is the trace of a plane through
/// the camera that touches the object: n'(X - camera) = r, linear in the centre X and in the half-width and half-height
/// r, solved by least squares with Cauchy weights. A box that is cut still counts with its other sides.
/// @return nullopt for fewer than 2 views, views without parallax, or a centre behind many of the cameras
std::optional<Ellipsoid> initialise_sphere(const Camera& camera, const std::vector<BoxView>& views);
/// An ellipsoid from one box with depth; of a box that is cut, from what is seen. Two axes are along the image, from
/// the box at the depth of the near side; the third is such that the object is as deep as it is wide and high in the
/// mean, drawn halfway towards the volume of its class's typical size where that is known.
/// @param size_prior_m typical diameter, 0 if unknown   @return nullopt without depth
std::optional<Ellipsoid> initialise_from_depth(const Camera& camera, const BoxView& view, double size_prior_m);

/// Gives a landmark its ellipsoid from its boxes.
class LandmarkFitter {
 public:
  LandmarkFitter(const QuadricMapperOptions& options, const ClassTable& classes)
      : options_(options), classes_(classes) {}

  /// Initialises or refines; leaves the landmark's ellipsoid alone if the views do not bear one.
  /// @return true if the ellipsoid changed
  bool fit(const ViewSource& source, MappedLandmark* landmark) const;

 private:
  std::optional<Ellipsoid> start(const Camera& camera, const std::vector<BoxView>& views, const Landmark& state) const;
  std::vector<BoxView> fit_views(const ViewSource& source, const MappedLandmark& landmark) const;
  bool is_sane(const QuadricFit& fit, int class_id) const;

  const QuadricMapperOptions& options_;
  const ClassTable& classes_;
};

}  // namespace semantic_topo_loop::core
