#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <vector>

#include "loop/graph/box_tracker.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

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
