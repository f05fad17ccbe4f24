#pragma once

#include <optional>
#include <vector>

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

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
