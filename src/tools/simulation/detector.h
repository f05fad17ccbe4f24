#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/simulation/random.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// The defaults resemble YOLOv5 on TUM's fr2_desk, measured against its reference objects: a box of 20-30 px is found
/// in 40 % of the frames, larger ones in 70-90 %; a miss lasts about half a second; 3 % wrong labels; 0.6 boxes a frame
/// that belong to no object, half of them seen in the next frame too; edges scatter by 1 px from frame to frame and by
/// 5-8 % of the box over the sequence.
struct DetectorOptions {
  double miss_rate = 0.15;
  double small_box_px = 24.0;
  double mislabel_rate = 0.03;
  double false_rate = 0.5;
  double jitter_px = 1.0;
  double jitter_ratio = 0.04;
  double persistence_s = 0.4;
  double min_visible = 0.4;
  double min_inside = 0.3;
  double min_score = 0.25;

  void visit(OptionVisitor& visitor) {
    visitor.module("detector");
    visitor("miss_rate", miss_rate, share(), "share of large, unoccluded objects missed");
    visitor("small_box_px", small_box_px, not_negative(), "box size at which half of the objects are missed");
    visitor("mislabel_rate", mislabel_rate, share(), "share of boxes with another class of the same group");
    visitor("false_rate", false_rate, between(0, 100), "mean number of boxes a frame that belong to no object");
    visitor("jitter_px", jitter_px, not_negative(), "standard deviation of box edges from frame to frame");
    visitor("jitter_ratio", jitter_ratio, share(), "standard deviation of slow edge errors, share of the box size");
    visitor("persistence_s", persistence_s, not_negative(), "time in which misses, labels and slow errors change");
    visitor("min_visible", min_visible, share(), "objects of which less than this share is unoccluded are missed");
    visitor("min_inside", min_inside, share(), "objects of which less than this share is in the image are missed");
    visitor("min_score", min_score, between(0, 0.9), "lowest score written");
  }
};

/// A box with the truth about it.
struct SimulatedDetection {
  Detection detection;
  int object = -1;  ///< index in Scene::objects; -1: false box
};

/// Turns views into the output of an object detector. Frames must be asked for in time order.
class DetectorModel {
 public:
  /// @param scene must outlive the model   @param rate_hz of the frames   @param classes for the groups of confusable
  /// ones
  DetectorModel(const Scene& scene, const Camera& camera, const ClassTable& classes, const DetectorOptions& options,
                double rate_hz, std::uint64_t seed);

  /// @param time_s from the first image; where nothing moves, any
  std::vector<SimulatedDetection> detect(const SE3& T_world_camera, double time_s = 0.0);
  /// The same of views that come from elsewhere, one an object in order of Scene::objects.
  std::vector<SimulatedDetection> detect(const SE3& T_world_camera,
                                         const std::vector<std::optional<ObjectView>>& views);

 private:
  /// Errors of one object that last: standard normal, first-order Markov.
  struct Mood {
    double miss = 0.0, label = 0.0, other_class = 0.0;
    Vec4 edges = Vec4::Zero();
  };
  struct Phantom {
    int class_id = -1;
    Ellipsoid ellipsoid;
  };

  void advance_moods();
  void advance_phantoms(const SE3& T_world_camera);
  std::optional<Detection> detect_object(std::size_t object, const ObjectView& view);
  Box jitter(const ObjectView& view, const Vec4& slow);
  int label(std::size_t object) const;

  const Scene* scene_;
  Camera camera_;
  SceneProjector projector_;
  DetectorOptions options_;
  std::vector<std::vector<int>> confusable_;  ///< an object's other possible classes
  double memory_;                             ///< correlation of moods from frame to frame
  double phantom_memory_;                     ///< probability that a false box survives to the next frame
  bool started_ = false;
  std::vector<Mood> moods_;
  std::vector<Phantom> phantoms_;
  Random random_;
};

}  // namespace semantic_topo_loop::core
