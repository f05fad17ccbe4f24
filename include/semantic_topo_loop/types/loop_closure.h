#pragma once

#include <cstdint>
#include <optional>
#include <type_traits>
#include <vector>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Why a candidate was accepted or rejected.
enum class LoopReason : std::uint8_t {
  kAccepted = 0,
  kTooFewObjects = 1,  ///< a submap or the common set is too small
  kTooFewInliers = 2,
  kTooFewLabels = 3,
  kDegenerate = 4,      ///< objects on a line or in a point
  kResidual = 5,        ///< alignment error too large
  kAmbiguous = 6,       ///< a second, different alignment or place explains nearly as much
  kReprojection = 7,    ///< the matched objects do not reproject onto the detections
  kMirrored = 8,        ///< the cameras lie on different sides of the objects' plane
  kTilt = 9,            ///< the local up directions disagree
  kRefinement = 10,     ///< the refinement on boxes failed or moved too far
  kLowScore = 11,       ///< paper mode: below the score threshold
  kInconsistent = 12,   ///< paper mode: not repeated over consecutive keyframes
  kOutranked = 13,      ///< passed every test on the alignment, but a better candidate speaks for its place
  kContradicted = 14,   ///< surfaces of one submap are where the other's cameras see through
  kFoundBySource = 15,  ///< accepted, not by objects: found by points, in the odometry's source or not, or from outside
};

const char* to_string(LoopReason reason);

struct ObjectMatch {
  std::int64_t query_landmark_id = -1;
  std::int64_t match_landmark_id = -1;
};

/// An object of one of the two submaps of a loop, as it was when the loop was looked for.
struct SubmapObject {
  std::int64_t landmark_id = -1;
  int class_id = -1;
  Vec3 position = Vec3::Zero();  ///< of its centre, in the camera at query_frame or match_frame, m
  double radius_m = 0.0;         ///< semi-axis across the vertical
};

/// What is told of a loop candidate that reached verification: two keyframes and how the later one (query) sees the
/// earlier (match). Figures that are -1 were not computed, because an earlier test had failed. Long runs keep many.
struct LoopFigures {
  std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
  std::int64_t query_frame = -1, match_frame = -1;  ///< frame_id of the two keyframes
  std::int64_t query_stamp_ns = 0, match_stamp_ns = 0;
  std::int64_t query_begin = -1, query_end = -1;  ///< first and last frame_id of the evidence
  std::int64_t match_begin = -1, match_end = -1;
  bool accepted = false;
  LoopReason reason = LoopReason::kTooFewObjects;
  double score = 0.0;
  double second_score = 0.0;  ///< of the best distinct alternative
  double rms_m = 0.0;
  double spread_m = 0.0;             ///< second singular value of the matched objects' spread
  double tilt_deg = -1.0;            ///< between the two up directions; 0 if one of them is uncertain
  double reprojection_ratio = -1.0;  ///< matched over expected boxes, the worse of both ways, as the next two
  int reprojected_objects = -1;      ///< objects that reproject onto detections
  double explained_share = -1.0;     ///< of the detections
  double refine_residual = -1.0;     ///< median box residual after refinement, standard deviations
  double refine_shift_m = -1.0;      ///< how far the refinement moved the alignment
  double refine_shift_deg = -1.0;    ///< and turned it
  double sigma_m = -1.0;             ///< stated error of the translation: root of the covariance's trace
  double sigma_deg = -1.0;           ///< and of the rotation
  int inliers = 0;                   ///< matched objects; points of a kFoundBySource
  int labels = 0;                    ///< different classes among the matched objects
  SE3 T_match_query;                 ///< of the cameras at query_frame and match_frame
  /// Of the match's unit of length over the query's: p_match = scale * (q * p_query) + t, with (q, t) = T_match_query.
  double scale = 1.0;

  /// @param covariance of T_match_query
  void state_sigmas(const Mat6& covariance);
};

/// False if some figure is no number, or the pose no pose.
bool is_finite(const LoopFigures& loop);

/// A loop candidate with what it takes to close it.
struct LoopClosure : LoopFigures {
  Mat6 covariance = Mat6::Identity();  ///< of T_match_query: (translation m, rotation rad), right
  /// Of log scale with (translation, rotation, log scale); zero if the scale was not measured.
  Vec7 scale_covariance = Vec7::Zero();
  std::vector<ObjectMatch> matches;
  /// All objects of the two submaps: those of `matches` first, in its order. Empty where submaps play no part.
  std::vector<SubmapObject> query_objects, match_objects;
  /// Set if the match is a submap of an earlier run, to which all match_ fields then refer: the pose of its anchor in
  /// that run's map.
  std::optional<SE3> T_earlier_match;
};

/// Calls `visit(name, field)` for every field, by the names and in the order of LoopClosure.msg: the one list of them
/// for messages.
/// @param loop LoopFigures, or LoopClosure with the fields that only it has; const or not
template <class Loop, class Visitor>
void visit_fields(Loop& loop, Visitor&& visit) {
  constexpr bool kIsWhole = std::is_base_of_v<LoopClosure, std::remove_const_t<Loop>>;
  visit("query_keyframe_id", loop.query_keyframe_id);
  visit("match_keyframe_id", loop.match_keyframe_id);
  visit("query_frame", loop.query_frame);
  visit("match_frame", loop.match_frame);
  visit("query_stamp_ns", loop.query_stamp_ns);
  visit("match_stamp_ns", loop.match_stamp_ns);
  visit("query_begin", loop.query_begin);
  visit("query_end", loop.query_end);
  visit("match_begin", loop.match_begin);
  visit("match_end", loop.match_end);
  visit("accepted", loop.accepted);
  visit("reason", loop.reason);
  visit("score", loop.score);
  visit("second_score", loop.second_score);
  visit("rms_m", loop.rms_m);
  visit("spread_m", loop.spread_m);
  visit("tilt_deg", loop.tilt_deg);
  visit("reprojection_ratio", loop.reprojection_ratio);
  visit("reprojected_objects", loop.reprojected_objects);
  visit("explained_share", loop.explained_share);
  visit("refine_residual", loop.refine_residual);
  visit("refine_shift_m", loop.refine_shift_m);
  visit("refine_shift_deg", loop.refine_shift_deg);
  visit("sigma_m", loop.sigma_m);
  visit("sigma_deg", loop.sigma_deg);
  visit("inliers", loop.inliers);
  visit("labels", loop.labels);
  visit("match_from_query", loop.T_match_query);
  if constexpr (kIsWhole) visit("covariance", loop.covariance);
  visit("scale", loop.scale);
  if constexpr (kIsWhole) {
    visit("scale_covariance", loop.scale_covariance);
    visit("matches", loop.matches);
    visit("query_objects", loop.query_objects);
    visit("match_objects", loop.match_objects);
    visit("earlier_map_from_match", loop.T_earlier_match);
  }
}

/// Where a run is in the map of an earlier one, by the accepted loops into it since the odometry last broke or jumped.
struct Relocalisation {
  SE3 T_earlier_odom;  ///< the run's odometry frame in the earlier run's map
  int agreeing = 0;    ///< loops that say so
  int total = 0;       ///< the last thousand at most
};

}  // namespace semantic_topo_loop::core
