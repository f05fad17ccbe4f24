#pragma once

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

/// Which landmarks are one object.
class DuplicateTest {
 public:
  DuplicateTest(const QuadricMapperOptions& options, const ClassTable& classes)
      : options_(options), classes_(classes) {}

  /// True if b, the less observed one, is the same object as a: class group, overlap of b's boxes with a's projection,
  /// not seen side by side.
  bool is_duplicate(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const;
  /// True if b is a part of a that the detector boxed alone: little seen, inside a much-seen one of its class group.
  bool is_part(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const;
  /// Centres farther apart than this belong to two objects, whatever their boxes say.
  static double reach_m(const Ellipsoid& a, const Ellipsoid& b);

 private:
  const QuadricMapperOptions& options_;
  const ClassTable& classes_;
};

}  // namespace semantic_topo_loop::core
