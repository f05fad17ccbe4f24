#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "io/archive.h"
#include "pipeline/map_state.h"

namespace semantic_topo_loop::core {

// What the members of a map's structs are called in its file.

namespace archive {

template <>
inline constexpr bool is_row<Observation> = true;
template <>
inline constexpr bool is_row<BoxView> = true;
template <>
inline constexpr bool is_row<ObservedBox> = true;
template <>
inline constexpr bool is_row<SubmapView> = true;
template <>
inline constexpr bool is_row<Surfel> = true;
template <>
inline constexpr bool is_row<PointFeature> = true;
template <>
inline constexpr bool is_row<KeyframePose> = true;
template <>
inline constexpr bool is_row<GraphKeyframe> = true;
template <>
inline constexpr bool is_row<LoopFigures> = true;

/// Of an enum by its number.
/// @param rule that numbers break which it does not have
template <class Enum>
void read_enum(CborReader* reader, Enum last, const char* rule, Enum* value) {
  const std::uint8_t* const at = reader->at();
  const std::int64_t number = reader->integer();
  if (number < 0 || number > static_cast<std::int64_t>(last)) return reader->reject(at, rule);
  *value = static_cast<Enum>(number);
}

template <>
struct Codec<LandmarkState> {
  static void write(LandmarkState value, CborWriter* writer) { writer->integer(static_cast<int>(value)); }
  static void read(CborReader* reader, LandmarkState* value) {
    read_enum(reader, LandmarkState::kRetired, "is no state", value);
  }
};

template <>
struct Codec<LoopReason> {
  static void write(LoopReason value, CborWriter* writer) { writer->integer(static_cast<int>(value)); }
  static void read(CborReader* reader, LoopReason* value) {
    read_enum(reader, LoopReason::kFoundBySource, "is no reason", value);
  }
};

/// As signed numbers, which a reader takes.
template <>
struct Codec<Descriptor> {
  using Words = std::array<std::int64_t, std::tuple_size_v<Descriptor>>;
  static void write(const Descriptor& value, CborWriter* writer) {
    Words words{};
    std::copy(value.begin(), value.end(), words.begin());
    to_archive(words, writer);
  }
  static void read(CborReader* reader, Descriptor* value) {
    Words words{};
    from_archive(reader, &words);
    std::copy(words.begin(), words.end(), value->begin());
  }
};

template <>
struct Codec<SeenFrom> {
  static void write(const SeenFrom& value, CborWriter* writer) { to_archive(value.smallest_px(), writer); }
  static void read(CborReader* reader, SeenFrom* value) {
    SeenFrom::Bins bins{};
    from_archive(reader, &bins);
    *value = SeenFrom(bins);
  }
};

/// By its camera's rotation and place, from which the rest follows.
template <>
struct Codec<LocalFrame> {
  static void write(const LocalFrame& value, CborWriter* writer) { write_members(value, writer); }
  static void read(CborReader* reader, LocalFrame* value) {
    const std::uint8_t* const at = reader->at();
    read_members(reader, value);
    constexpr double kTolerance = 1e-6;
    if (!value->R_camera_local.isUnitary(kTolerance) || value->R_camera_local.determinant() < 0.0) {
      reader->reject(at, "has a camera_from_anchor_rotation that is none");
    }
    value->t_camera_local = -value->R_camera_local * value->position;
    if (!(value->focal_px.minCoeff() > 0.0)) reader->reject(at, "must have a focal_px > 0");
  }
};

/// In whole millimetres, each point as the way from the one before: neighbours are near, and compress well.
class PointsOfWays {
 public:
  /// @param point_of the place of each of `points`
  template <class Point, class PointOf>
  static void write(const std::vector<Point>& points, const PointOf& point_of, CborWriter* writer) {
    writer->array(3 * points.size());
    std::array<std::int64_t, 3> last{};
    for (const Point& point : points) {
      for (std::size_t k = 0; k < 3; ++k) {
        const double metres = static_cast<double>(point_of(point)(static_cast<Eigen::Index>(k)));
        const std::int64_t now = std::llround(std::clamp(1e3 * metres, -kMost, kMost));
        writer->integer(now - std::exchange(last[k], now));
      }
    }
  }
  static std::vector<Eigen::Vector3f> read(CborReader* reader) {
    const std::uint8_t* const at = reader->at();
    std::vector<Eigen::Vector3f> points;
    Eigen::Vector3d last = Eigen::Vector3d::Zero();
    Eigen::Index k = 0;
    reader->elements([&] {
      last(k) += reader->number();
      if (k == 2) points.push_back((1e-3 * last).cast<float>());
      k = (k + 1) % 3;
    });
    if (k != 0) reader->reject(at, "must have three numbers a point");
    return points;
  }

 private:
  static constexpr double kMost = 1e9;  // 1,000 km
};

template <>
struct Codec<KeyframePoints> {
  static void write(const KeyframePoints& value, CborWriter* writer) {
    writer->map(3);
    writer->text("sparse_id_steps");
    writer->array(value.sparse.size());
    std::int64_t last = 0;
    for (const SparsePoint& point : value.sparse) writer->integer(point.id - std::exchange(last, point.id));
    writer->text("sparse_mm_steps");
    PointsOfWays::write(
        value.sparse, [](const SparsePoint& point) { return point.point_camera; }, writer);
    writer->text("semi_dense_mm_steps");
    PointsOfWays::write(
        value.semi_dense, [](const Eigen::Vector3f& point) { return point; }, writer);
  }
  static void read(CborReader* reader, KeyframePoints* value) {
    const std::uint8_t* const at = reader->at();
    std::vector<std::int64_t> steps;
    std::vector<Eigen::Vector3f> sparse;
    CborReader::Members members(reader);
    members.member("sparse_id_steps", [&] { from_archive(reader, &steps); });
    members.member("sparse_mm_steps", [&] { sparse = PointsOfWays::read(reader); });
    members.member("semi_dense_mm_steps", [&] { value->semi_dense = PointsOfWays::read(reader); });
    if (steps.size() != sparse.size()) return reader->reject(at, "has not one of sparse_id_steps a point");
    std::int64_t id = 0;
    for (std::size_t i = 0; i < steps.size(); ++i) value->sparse.push_back({id += steps[i], sparse[i]});
  }
};

}  // namespace archive

template <class Visitor>
void visit_members(LoopFigures& value, Visitor& visit) {
  visit_fields(value, visit);
}

// The members' own names.
#define VISIT_MEMBERS(Struct, ...)                    \
  template <class Visitor>                            \
  void visit_members(Struct& value, Visitor& visit) { \
    __VA_ARGS__                                       \
  }
#define MEMBER_AS(name, member) visit(name, value.member);
#define LATER_MEMBER_AS(name, member) visit.later(name, value.member);
#define MEMBER(name) MEMBER_AS(#name, name)
#define LATER_MEMBER(name) LATER_MEMBER_AS(#name, name)

VISIT_MEMBERS(Camera, MEMBER(fx) MEMBER(fy) MEMBER(cx) MEMBER(cy) MEMBER(width) MEMBER(height) MEMBER(distortion))
VISIT_MEMBERS(LoopVerdict, MEMBER(number) MEMBER(query_keyframe_id) MEMBER(match_keyframe_id) MEMBER(kept)
                               MEMBER(reason) MEMBER(is_extra))
VISIT_MEMBERS(EdgeCovariance, MEMBER(given) MEMBER(translation) MEMBER(rotation) MEMBER(suspected_jumps))
VISIT_MEMBERS(OdometryEdge, MEMBER(T_from_to) MEMBER(path_m) MEMBER(rotation_rad) MEMBER(covariance) MEMBER(is_break)
                                MEMBER_AS("frozen_s", missed.frozen_s) LATER_MEMBER_AS("slipped_s", missed.slipped_s)
                                    LATER_MEMBER_AS("missed_covariance", missed.covariance) MEMBER(suspected_jump)
                                        MEMBER(jump_error_m) MEMBER(jump_error_rad) MEMBER(joined))
VISIT_MEMBERS(GraphLoop,
              MEMBER(from) MEMBER(to) MEMBER(T_from_to) MEMBER(covariance) MEMBER(scale) MEMBER(scale_covariance)
                  MEMBER(query_keyframe_id) MEMBER(match_keyframe_id) MEMBER(had_support) MEMBER(query_begin)
                      MEMBER(query_end) MEMBER(match_begin) MEMBER(match_end))
VISIT_MEMBERS(RememberedLoop, MEMBER(told) MEMBER(is_told) MEMBER(loop) MEMBER(refusal) MEMBER(is_in_graph)
                                  MEMBER(may_vote) MEMBER(kept))
VISIT_MEMBERS(OdometryNoise, MEMBER(translation_m) MEMBER(rotation_rad) MEMBER(steady_translation)
                                 MEMBER(steady_rotation_rad) MEMBER(scale) MEMBER(jump_prior))
VISIT_MEMBERS(OdometryJump, MEMBER(edge) MEMBER(translation_m) MEMBER(rotation_rad))
VISIT_MEMBERS(NoiseEstimate, MEMBER(odometry) MEMBER(loop_factor) MEMBER(jumps))
VISIT_MEMBERS(Ellipsoid, MEMBER(T_world_quadric) MEMBER(semi_axes))
VISIT_MEMBERS(ClassCount, MEMBER(class_id) MEMBER(count))
VISIT_MEMBERS(Landmark, MEMBER(id) MEMBER(class_id) MEMBER(state) MEMBER(ellipsoid) MEMBER(center_covariance)
                            MEMBER(anchor_keyframe_id) MEMBER(observations) MEMBER(baseline_deg) MEMBER(mean_iou)
                                MEMBER(quality) LATER_MEMBER(class_counts))
VISIT_MEMBERS(Views, MEMBER(found) MEMBER(missed))
VISIT_MEMBERS(Sightings,
              MEMBER(seen_s) MEMBER(whole_s) MEMBER(expected_s) MEMBER(placed_s) MEMBER(bounded_s)
                  MEMBER(familiar_seen_s) MEMBER(familiar_missed_s) MEMBER(missed_since_s) LATER_MEMBER(hollow_s)
                      MEMBER(transparent_s) MEMBER(seen_through_since_s) LATER_MEMBER(views))
VISIT_MEMBERS(BoxView, MEMBER(T_world_camera) MEMBER(box) MEMBER(truncated) MEMBER(near_m))
VISIT_MEMBERS(Observation, MEMBER(frame_id) MEMBER(source_id) MEMBER(keyframe_id) MEMBER(class_id) MEMBER(view))
VISIT_MEMBERS(LandmarkRecord, MEMBER(state) MEMBER(seen_beside) MEMBER(sightings) MEMBER(seen_from)
                                  MEMBER(last_stamp_ns) MEMBER(next_fit_at) LATER_MEMBER(was_confirmed))
VISIT_MEMBERS(UpDirection, MEMBER(direction) MEMBER(certain))
VISIT_MEMBERS(Spheroid, MEMBER(center) MEMBER(log_axes))
VISIT_MEMBERS(ObservedBox, MEMBER(landmark_id) MEMBER(class_id) MEMBER(box) MEMBER(truncated) MEMBER(depth_m))
VISIT_MEMBERS(LocalFrame, MEMBER(frame_id) MEMBER_AS("camera_from_anchor_rotation", R_camera_local) MEMBER(position)
                              MEMBER(focal_px) MEMBER(image) MEMBER(boxes))
VISIT_MEMBERS(SubmapView, MEMBER(frame) MEMBER(box) MEMBER(depth_m) MEMBER(truncated))
VISIT_MEMBERS(LocalObject, MEMBER(landmark_id) MEMBER(class_id) MEMBER(spheroid) MEMBER(covariance) MEMBER(frames_seen)
                               MEMBER(seen_share) MEMBER(parallax_deg) MEMBER(views))
VISIT_MEMBERS(Surfel, MEMBER(position) MEMBER(normal))
VISIT_MEMBERS(PointFeature, MEMBER(id) MEMBER(position) MEMBER(descriptor))
VISIT_MEMBERS(LocalMap, MEMBER(keyframe_id) MEMBER(frame_id) MEMBER(stamp_ns) MEMBER(begin_frame) MEMBER(end_frame)
                            MEMBER(end_ns) MEMBER(span_s) MEMBER(drift_rad_s) MEMBER(up) MEMBER(frames)
                                MEMBER(check_frames) MEMBER(objects) MEMBER(surfels) LATER_MEMBER(features))

VISIT_MEMBERS(KeyframePose, MEMBER(keyframe_id) MEMBER(frame_id) MEMBER(stamp_ns) MEMBER(T_map_camera) MEMBER(scale))
VISIT_MEMBERS(GraphKeyframe, MEMBER(pose) MEMBER(T_vertex_keyframe) MEMBER(T_map_live))
VISIT_MEMBERS(Session, MEMBER(first_keyframe_id) MEMBER(begin_ns) MEMBER(end_ns))
VISIT_MEMBERS(GraphState, MEMBER(sessions) MEMBER(next_frame_id) MEMBER(keyframes) MEMBER(edges) MEMBER(loops)
                              MEMBER(accepted_loops) MEMBER(noise) MEMBER(loose_factor))
VISIT_MEMBERS(GraphDelta, MEMBER(is_whole) MEMBER(state))
VISIT_MEMBERS(LandmarkDelta, MEMBER(record) MEMBER(first) MEMBER(observations))
VISIT_MEMBERS(LandmarkMerge, MEMBER(merged_id) MEMBER(survivor_id))
VISIT_MEMBERS(LoggedMerge, MEMBER(number) MEMBER(merge) MEMBER(merged_class_id) MEMBER(merged_observations)
                               MEMBER(frame_id) MEMBER(stamp_ns) MEMBER(undone_frame_id))
VISIT_MEMBERS(MapperDelta,
              MEMBER(is_whole) MEMBER(camera) MEMBER(changed) MEMBER(removed) MEMBER(merges) MEMBER(first_merge))
VISIT_MEMBERS(SubmapDelta, MEMBER(is_whole) MEMBER(added) MEMBER(forgotten) MEMBER(decided) MEMBER(first_query))
VISIT_MEMBERS(PointsOfKeyframe, MEMBER(keyframe_id) MEMBER(points))
VISIT_MEMBERS(MapDelta, MEMBER(graph) MEMBER(objects) MEMBER(submaps) MEMBER(points))

#undef MEMBER
#undef LATER_MEMBER
#undef MEMBER_AS
#undef LATER_MEMBER_AS
#undef VISIT_MEMBERS

}  // namespace semantic_topo_loop::core
