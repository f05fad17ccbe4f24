#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <vector>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/local_map.h"
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

struct ObservedFrame {
  std::int64_t frame_id = -1;
  std::int64_t keyframe_id = -1;
  std::int64_t stamp_ns = 0;
  bool is_keyframe = false;
  SE3 T_odom_camera;
  Vec2 focal_px = Vec2::Ones();
  Box image;  ///< the image's rectangle on the plane z = 1
  std::vector<ObservedBox> boxes;
};

/// Which landmark the ids of merged landmarks stand for.
class LandmarkRedirects {
 public:
  /// Takes over the merges of an update and those that it takes back.
  void apply(const MapUpdate& update);
  std::int64_t resolve(std::int64_t id) const;
  /// All ids that stand for the landmark of this id, ascending.
  std::vector<std::int64_t> aliases(std::int64_t id) const;

 private:
  std::map<std::int64_t, std::int64_t> survivor_;
  std::map<std::int64_t, std::vector<std::int64_t>> merged_into_;
};

/// The last seconds of frames with their boxes; starts afresh at a break of the odometry.
class ObservationWindow {
 public:
  /// @param interval_s frames closer to the last kept one are left out unless they are keyframes
  ObservationWindow(double span_s, double interval_s, LabelTable labels);

  /// @return true if the frame was taken in
  bool push(const Frame& frame, const AssociationFrame& associations);
  void set_span(double span_s);
  void clear() { frames_.clear(); }
  const std::deque<ObservedFrame>& frames() const { return frames_; }

 private:
  ObservedFrame observe(const Frame& frame, const AssociationFrame& associations);

  std::int64_t span_ns_, interval_ns_;
  LabelTable labels_;
  BoxTracker tracker_;
  std::deque<ObservedFrame> frames_;
  std::int64_t last_sampled_ns_ = 0;
};

}  // namespace semantic_topo_loop::core
