#pragma once

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "geometry/depth_points.h"
#include "map/mapper_state.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/quadric_mapper.h"

namespace semantic_topo_loop::core::testing {

inline const Camera kMapperCamera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};

/// Feeds a mapper with the exact boxes of objects, under landmark ids of the test's choice.
class MapperFixture : public ::testing::Test {
 protected:
  explicit MapperFixture(std::vector<ObjectClass> classes)
      : classes_(std::make_shared<const ClassTable>(*ClassTable::create(std::move(classes)))),
        mapper_(QuadricMapperOptions{}, classes_) {}

  struct Seen {
    std::int64_t id;
    int class_id;
    Ellipsoid ellipsoid;
    std::uint8_t truncated = 0;  ///< sides said to be cut by the border
    double score = 1.0;
  };

  Frame next_frame(const SE3& pose) {
    Frame frame;
    frame.frame_id = next_frame_;
    frame.stamp_ns = clock_ns_ + next_frame_ * 33333333;
    frame.is_keyframe = makes_keyframes_ && next_frame_ % 5 == 0;
    if (frame.is_keyframe) {
      keyframe_id_ = next_frame_ / 5;
      keyframes_.push_back({keyframe_id_, frame.frame_id, frame.stamp_ns, pose});
    }
    frame.keyframe_id = keyframe_id_;
    frame.T_odom_camera = pose;
    frame.camera = kMapperCamera;
    frame.is_break = std::exchange(is_break_, false);
    ++next_frame_;
    return frame;
  }

  MapUpdate step(const SE3& pose, const std::vector<Seen>& seen,
                 std::shared_ptr<const std::vector<Vec3>> points_camera = nullptr) {
    Frame frame = next_frame(pose);
    frame.points_camera = std::move(points_camera);
    AssociationFrame associations;
    associations.frame_id = frame.frame_id;
    for (const Seen& object : seen) {
      Association association;
      association.landmark_id = object.id;
      if (object.id < 0) association.level = AssociationLevel::kIgnored;
      association.class_id = association.landmark_class_id = object.class_id;
      association.truncated = object.truncated;
      association.score = object.score;
      association.box = *project_box(object.ellipsoid, projection_matrix(kMapperCamera, pose));
      if (frame.points_camera) {
        const auto placements = place(FramePoints(*frame.points_camera, frame.camera), association.box);
        if (placements.size() == 1) association.near_m = placements.front().center.z();
      }
      associations.associations.push_back(association);
    }
    return mapper_.integrate(frame, associations);
  }

  /// The detector does not look.
  MapUpdate pass(const SE3& pose) {
    const Frame frame = next_frame(pose);
    return mapper_.integrate(frame, AssociationFrame::without_answer(frame.frame_id));
  }

  /// A later session goes on with the map, in the frame of the one before.
  void begin_session(const QuadricMapperOptions& options = {}) {
    MapperState state = mapper_.state();
    mapper_ = QuadricMapper(options, classes_);
    mapper_.restore(std::move(state), keyframes_);
  }

  const Landmark* find(std::int64_t id) {
    for (const Landmark& landmark : mapper_.landmarks()) {
      if (landmark.id == id) return &(found_[id] = landmark);
    }
    return nullptr;
  }

  std::shared_ptr<const ClassTable> classes_;
  QuadricMapper mapper_;
  std::map<std::int64_t, Landmark> found_;  ///< as last looked for
  std::vector<KeyframePose> keyframes_;
  std::int64_t next_frame_ = 0, keyframe_id_ = 0;
  std::int64_t clock_ns_ = 0;    ///< at frame 0
  bool makes_keyframes_ = true;  ///< every fifth frame is one
  bool is_break_ = false;        ///< the next frame
};

}  // namespace semantic_topo_loop::core::testing
