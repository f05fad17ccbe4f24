#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A box to be followed.
struct TrackedBox {
  Box box;  ///< on the plane z = 1 of the camera
  int class_id = -1;
  double score = 0.0;          ///< of the detector
  std::int64_t track_id = -1;  ///< filled in
  int track_class_id = -1;     ///< filled in: the class with the highest sum of scores on the track so far
};

/// Follows boxes from frame to frame by their overlap, the camera's rotation taken out. What belongs together within a
/// few seconds comes from the images alone: landmarks change with every correction of the map, and what loops are found
/// must not.
class BoxTracker {
 public:
  /// @param q_odom_camera the camera's rotation, any world   @param boxes of one frame; tracks are filled in
  void follow(std::int64_t stamp_ns, const Quaternion& q_odom_camera, std::vector<TrackedBox>* boxes);
  /// Ends all tracks.
  void clear() { tracks_.clear(); }

 private:
  struct Track {
    std::int64_t id = -1;
    std::int64_t stamp_ns = 0;
    Quaternion q_odom_camera = Quaternion::Identity();
    Box box;
    std::map<int, double> classes;  ///< sums of scores
  };
  /// Indices of the tracks, one a box, -1 for none.
  std::vector<int> match(const Quaternion& q_odom_camera, const std::vector<TrackedBox>& boxes) const;

  std::vector<Track> tracks_;  ///< in order of id
  std::int64_t next_id_ = 0;
};

}  // namespace semantic_topo_loop::core
