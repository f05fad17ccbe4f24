#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <vector>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/solved_motion.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Follows boxes from frame to frame by their overlap, the camera's rotation taken out. What belongs together within a
/// few seconds comes from the images alone: landmarks change with every correction of the map, and what loops are found
/// must not.
class BoxTracker {
 public:
  /// @param q_odom_camera the camera's rotation, any world   @param scores of the detector   @param boxes of one frame;
  /// the track is filled in, and its class, that with the highest sum of scores so far, put for the detected one
  void follow(std::int64_t stamp_ns, const Quaternion& q_odom_camera, const std::vector<double>& scores,
              std::vector<ObservedBox>* boxes);
  /// Ends all tracks.
  void clear() { tracks_.clear(); }

 private:
  struct Track {
    std::int64_t id = -1;
    std::int64_t stamp_ns = 0;
    std::int64_t answer = 0;  ///< of the detector, at that stamp
    Quaternion q_odom_camera = Quaternion::Identity();
    Box box;
    std::map<int, double> classes;  ///< sums of scores
  };
  /// Indices of the tracks, one a box, -1 for none.
  std::vector<int> match(const Quaternion& q_odom_camera, const std::vector<ObservedBox>& boxes) const;

  std::vector<Track> tracks_;  ///< in order of id
  std::int64_t next_id_ = 0;
  std::int64_t answer_ = 0;
};

/// What the sides of a box are usually off by (1 sigma), on the plane z = 1.
double box_sigma(const Box& box, const Vec2& focal_px);

struct ObservedFrame {
  std::int64_t frame_id = -1;
  std::int64_t keyframe_id = -1;
  std::int64_t stamp_ns = 0;
  bool is_keyframe = false;
  SE3 T_odom_camera;
  MissedMotion missed;           ///< since the frame before
  Vec2 focal_px = Vec2::Ones();  ///< of the image made 640 pixels wide, if it is wider
  Box image;                     ///< the image's rectangle on the plane z = 1
  std::vector<ObservedBox> boxes;
  /// Camera frame, m; of two frames a second, if they come with points. Null for all others.
  std::shared_ptr<const std::vector<Eigen::Vector3f>> points;
  std::shared_ptr<const std::vector<PointFeature>> features;  ///< of the same frames, if they come with any
};

/// The last seconds of frames with their boxes; starts afresh at a break of the odometry.
class ObservationWindow {
 public:
  /// @param interval_s frames closer to the last kept one are left out unless they are keyframes
  ObservationWindow(double span_s, double interval_s, ClassTable classes);

  /// @return true if the frame was taken in; one that the detector did not look at never is
  bool push(const Frame& frame, const AssociationFrame& associations);
  void set_span(double span_s);
  void clear() {
    frames_.clear();
    tracker_.clear();
  }
  const std::deque<ObservedFrame>& frames() const { return frames_; }

 private:
  ObservedFrame observe(const Frame& frame, const AssociationFrame& associations);

  std::int64_t span_ns_, interval_ns_;
  ClassTable classes_;
  BoxTracker tracker_;
  std::deque<ObservedFrame> frames_;
  std::int64_t last_sampled_ns_ = 0;
  std::int64_t last_points_ns_ = 0;
};

/// Where the camera was at the image of a frame: the odometry's pose of `delay_s` later, between frames of the window;
/// before the first and after the last one it goes on as it came.
/// @param window frames in order of time, two at least
SE3 pose_at_image(const std::deque<ObservedFrame>& window, std::size_t frame, double delay_s);
/// All frames of the window there.
std::deque<ObservedFrame> undelayed(std::deque<ObservedFrame> window, double delay_s);

}  // namespace semantic_topo_loop::core
