#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// What the point map takes in and keeps.
struct PointMapOptions {
  int semi_dense_max = 3000;
  double voxel_m = 0.02;
  int points_max = 2000000;

  void visit(OptionVisitor& visitor) {
    visitor.module("point_map");
    visitor("semi_dense_max", semi_dense_max, at_least(1), "points taken from the edges of a keyframe's image, about");
    visitor("voxel_m", voxel_m, positive(),
            "of the semi-dense points of a keyframe, one is kept in a cube of this size");
    visitor("points_max", points_max, at_least(1),
            "points kept; beyond, those of the oldest keyframes are thinned, again and again");
  }
};

/// The points of one keyframe.
struct PointsOfKeyframe {
  std::int64_t keyframe_id = -1;
  std::shared_ptr<const KeyframePoints> points;
};

/// What a point map and a map's file keep of a keyframe's points: what is finite, of the semi-dense ones one in a cube.
KeyframePoints reduced(const KeyframePoints& points, const PointMapOptions& options);

/// The points of a map, in the map frame, m.
struct MapPoints {
  std::vector<Eigen::Vector3f> sparse;  ///< one for each point of a front end, in order of session and id
  std::vector<Eigen::Vector3f> semi_dense;
};

/// The points of the pose-point-object map. They hang on their keyframes and move with them when the map is corrected.
class PointMap {
 public:
  explicit PointMap(const PointMapOptions& options) : options_(options) {}

  /// What comes from here on is of a further session, whose front end numbers its points anew.
  /// @param begin_at where its first camera stands for now, as PoseGraph::restore has it
  void begin_session(const std::optional<Vec3>& begin_at = {}) {
    ++session_;
    T_map_odom_ = SE3();
    begin_at_ = begin_at;
  }
  /// Takes in a keyframe of an earlier session. @param S_map_camera where it is
  void restore(const PointsOfKeyframe& keyframe, const Sim3& S_map_camera);
  /// Takes in the points of a keyframe, and where a session begins.
  void add(const Frame& frame);
  /// Moves the keyframes.
  void apply(const MapCorrection& correction);

  MapPoints points() const;
  std::size_t keyframes() const { return keyframes_.size(); }
  /// Points kept, those that several keyframes see counted with each.
  std::size_t size() const { return size_; }

 private:
  struct Keyframe {
    SE3 T_odom_camera;
    Sim3 S_map_camera;  ///< the scale is the map's units of length in one of the odometry, 1 unless it is free
    KeyframePoints points;
    int session = 0;
    int thinnings = 0;
  };

  void insert(std::int64_t keyframe_id, Keyframe keyframe);
  void bound();

  PointMapOptions options_;
  SE3 T_map_odom_;
  std::optional<Vec3> begin_at_;  ///< where the first camera is to stand, until it comes
  double scale_ = 1.0;            ///< of new keyframes
  int session_ = 0;
  std::map<std::int64_t, Keyframe> keyframes_;
  std::size_t size_ = 0;
};

}  // namespace semantic_topo_loop::core
