#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// What the point map takes in and keeps.
struct PointMapOptions {
  int semi_dense_max = 3000;
  double voxel_m = 0.02;
  int points_max = 2000000;

  template <class Visitor>
  void visit(Visitor& visitor) {
    visitor("point_map.semi_dense_max", semi_dense_max, "points taken from the edges of a keyframe's image, about");
    visitor("point_map.voxel_m", voxel_m, "of the semi-dense points of a keyframe, one is kept in a cube of this size");
    visitor("point_map.points_max", points_max,
            "points kept; beyond, those of the oldest keyframes are thinned, again and again");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop::core
