#pragma once

#include "association/track.h"
#include "semantic_topo_loop/association/associator_options.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

/// A level of the MLV-ODA cascade (SemanticTopoLoop, multi-level verification for object data association): how well a
/// detection fits a track, 0 where the level does not join them.
class AssociationLevelScorer {
 public:
  virtual ~AssociationLevelScorer() = default;
  virtual AssociationLevel level() const = 0;
  virtual double score(const AssociationContext& context, const TrackInFrame& candidate,
                       const PreparedDetection& detection) const = 0;
};

/// 2D level: IoU with the box of the previous frame, same label, above delta1.
class Level2d final : public AssociationLevelScorer {
 public:
  explicit Level2d(const AssociatorOptions& options) : iou_min_(options.iou_2d_min) {}
  AssociationLevel level() const override { return AssociationLevel::k2d; }
  double score(const AssociationContext& context, const TrackInFrame& candidate,
               const PreparedDetection& detection) const override;

 private:
  double iou_min_;
};

/// Label posterior over the landmarks of the previous frame, after Mu et al. 2016: an existing landmark i has
/// n_i / (N + alpha) p(label|i) p(z|i), a new one alpha / (N + alpha) p0(label) p0(z). The score is the log ratio of
/// the two, plus one, where positive. `paper` leaves p0 out, as the paper prints it.
class LevelPosterior final : public AssociationLevelScorer {
 public:
  LevelPosterior(const AssociatorOptions& options, std::size_t class_count)
      : options_(options), class_count_(static_cast<double>(class_count)) {}
  AssociationLevel level() const override { return AssociationLevel::kPosterior; }
  double score(const AssociationContext& context, const TrackInFrame& candidate,
               const PreparedDetection& detection) const override;

 private:
  AssociatorOptions options_;
  double class_count_;
};

/// 3D level over the landmarks of the last M keyframes: IoU with the projected quadric above delta2; for landmarks
/// without a quadric the share of their map points inside the box above delta3.
class Level3d final : public AssociationLevelScorer {
 public:
  explicit Level3d(const AssociatorOptions& options) : options_(options) {}
  AssociationLevel level() const override { return AssociationLevel::k3d; }
  double score(const AssociationContext& context, const TrackInFrame& candidate,
               const PreparedDetection& detection) const override;

 private:
  AssociatorOptions options_;
};

/// Score of the joint one-to-one assignment: box overlap (quadric or last box) times label agreement, above the gates
/// of the levels. Measured far more robust to missed and mislabelled boxes than the cascade (docs/algorithms.md).
class JointScorer {
 public:
  JointScorer(const AssociatorOptions& options, const ClassTable& classes) : options_(options), classes_(classes) {}
  double score(const AssociationContext& context, const TrackInFrame& candidate,
               const PreparedDetection& detection) const;

 private:
  double label_agreement(const Track& track, int class_id) const;

  AssociatorOptions options_;
  const ClassTable& classes_;
};

/// JDA, the baseline that the paper compares with: the distances of all cues added up, (1 - IoU with the box of the
/// previous frame) + (1 - IoU with the projected quadric) + (0 for the same label, else 1), in one assignment over all
/// landmarks. The score is how far the sum stays below the gate.
class JdaScorer {
 public:
  explicit JdaScorer(const AssociatorOptions& options) : distance_max_(options.jda_distance_max) {}
  double score(const AssociationContext& context, const TrackInFrame& candidate,
               const PreparedDetection& detection) const;

 private:
  double distance_max_;
};

/// Share of the points (map frame, m) that project into the box.
double share_of_points_in_box(const std::vector<Vec3>& points_map, const Mat34& P_image_map, const Box& box);

}  // namespace semantic_topo_loop::core
