#pragma once

#include <optional>
#include <vector>

#include "association/track_store.h"
#include "geometry/depth_points.h"
#include "semantic_topo_loop/association/associator_options.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// A detection ready to be associated.
struct PreparedDetection : Association {
  Box visible;                        ///< the box, clipped to the image
  std::vector<Placement> placements;  ///< in the map frame; where the frame has points; two if depth leaves it open
};

/// The placement of those of a detection that is nearest to a landmark, where it can be it: how near that is, 1 on the
/// landmark's centre.
struct NearestPlacement {
  double closeness = 0.0;
  const Placement* placement = nullptr;  ///< null if none can be the landmark
};
NearestPlacement nearest_placement(const Track& track, const PreparedDetection& detection);

/// A track that this frame may see, with what its prediction needs.
struct TrackInFrame {
  const Track* track = nullptr;
  std::optional<Box> projection;  ///< box of its quadric, clipped to the image; none without quadric or out of view
  bool is_recent = false;         ///< its last box still tells where it may be
};

/// What every level looks at.
struct AssociationContext {
  const AssociatorOptions& options;
  const ClassTable& classes;
  const Frame* frame = nullptr;
  std::int64_t answer = -1;       ///< which of the detector's answers this is, counted from 0
  std::int64_t first_answer = 0;  ///< since a break or a long pause: boxes of earlier ones tell no place
  double interval_s = 0.0;        ///< since the answer before
  Mat34 P_image_map = Mat34::Zero();
  Box image = {};  ///< of the frame's camera, undistorted
  std::vector<PreparedDetection> detections = {};
  std::vector<TrackInFrame> tracks = {};
};

/// How well a detection fits a track; 0 where it does not.
using AssociationScore = double (*)(const AssociationContext& context, const TrackInFrame& candidate,
                                    const PreparedDetection& detection);

/// Level 1 of the MLV-ODA cascade (SemanticTopoLoop, multi-level verification for object data association): IoU with
/// the box of the previous frame, same label, above delta1.
double score_2d(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection);

/// Level 2: label posterior over the landmarks of the previous frame, after Mu et al. 2016: an existing landmark i has
/// n_i / (N + alpha) p(label|i) p(z|i), a new one alpha / (N + alpha) p0(label) p0(z). The score is the log ratio of
/// the two, plus one, where positive. With `pro_new_object = paper` p0 is left out, as the paper prints it.
double score_posterior(const AssociationContext& context, const TrackInFrame& candidate,
                       const PreparedDetection& detection);

/// Level 3 over the landmarks of the last M keyframes: IoU with the projected quadric above delta2; for landmarks
/// without a quadric the share of their map points inside the box above delta3.
double score_3d(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection);

/// Whether depth puts two boxes of one image on one thing, though it may have two names: one box in the other, near
/// each other and of about one size.
bool show_one_thing(const PreparedDetection& a, const PreparedDetection& b);

/// Score of the joint one-to-one assignment: box overlap (quadric or last box) times label agreement, above the gates
/// of the levels. Where depth tells where the box's object is, it must be where the landmark is, and a landmark of
/// any label in the same place with the same size is it. Measured far more robust to missed and mislabelled boxes than
/// the cascade (docs/paper.md).
double score_joint(const AssociationContext& context, const TrackInFrame& candidate,
                   const PreparedDetection& detection);

/// JDA, the baseline that the paper compares with: the distances of all cues added up, (1 - IoU with the box of the
/// previous frame) + (1 - IoU with the projected quadric) + (0 for the same label, else 1), in one assignment over all
/// landmarks. The score is how far the sum stays below the gate.
double score_jda(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection);

}  // namespace semantic_topo_loop::core
