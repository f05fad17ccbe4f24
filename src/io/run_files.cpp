#include "semantic_topo_loop/io/run_files.h"

#include <cmath>

#include "io/csv.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kPosition[] = "x,y,z", kRotation[] = "qx,qy,qz,qw";

template <class Visitor>
void visit_columns(KeyframePose& keyframe, Visitor& visit) {
  visit("keyframe_id", keyframe.keyframe_id);
  visit("frame_id", keyframe.frame_id);
  visit.stamp("stamp", keyframe.stamp_ns);
  visit(kPosition, keyframe.T_map_camera.t);
  visit(kRotation, keyframe.T_map_camera.q);
}

template <class Visitor>
void visit_columns(MappedObject& object, Visitor& visit) {
  visit("id", object.id);
  visit("class_id", object.class_id);
  visit("label", object.label);
  visit(kPosition, object.center);
  visit.optional(kRotation, object.rotation);
  visit("a,b,c", object.semi_axes);
  visit("state", object.state);
  visit("observations", object.observations);
  visit.optional("baseline_deg", object.baseline_deg);
  visit.optional("mean_iou", object.mean_iou);
  visit.optional("quality", object.quality);
}

/// What a file must have is where and when the loop is, what was decided, and its pose; the rest is for people.
template <class Visitor>
void visit_columns(LoopFigures& loop, Visitor& visit) {
  visit("query_frame", loop.query_frame);
  visit("match_frame", loop.match_frame);
  visit.stamp("query_stamp", loop.query_stamp_ns);
  visit.stamp("match_stamp", loop.match_stamp_ns);
  visit("query_begin", loop.query_begin);
  visit("query_end", loop.query_end);
  visit("match_begin", loop.match_begin);
  visit("match_end", loop.match_end);
  visit("accepted", loop.accepted);
  visit.written("reason", std::string(to_string(loop.reason)));
  visit.written("score", loop.score);
  visit.written("inliers", loop.inliers);
  visit(kPosition, loop.T_match_query.t);
  visit(kRotation, loop.T_match_query.q);
  visit.written("labels", loop.labels);
  visit.written("second_score", loop.second_score);
  visit.written("rms_m", loop.rms_m);
  visit.written("spread_m", loop.spread_m);
  visit.written("tilt_deg", loop.tilt_deg);
  visit.written("reprojection_ratio", loop.reprojection_ratio);
  visit.written("reprojected_objects", loop.reprojected_objects);
  visit.written("explained_share", loop.explained_share);
  visit.written("refine_residual", loop.refine_residual);
  visit.written("refine_shift_m", loop.refine_shift_m);
  visit.written("refine_shift_deg", loop.refine_shift_deg);
  visit.written("sigma_m", loop.sigma_m);
  visit.written("sigma_deg", loop.sigma_deg);
}

template <class Visitor>
void visit_columns(LoopObjectRecord& row, Visitor& visit) {
  visit("query_frame", row.query_frame);
  visit("match_frame", row.match_frame);
  visit("query_end", row.query_end);
  visit("match_end", row.match_end);
  visit("is_query", row.is_query);
  visit("pair", row.pair);
  visit("landmark_id", row.object.landmark_id);
  visit("class_id", row.object.class_id);
  visit("label", row.label);
  visit(kPosition, row.object.position);
  visit("radius_m", row.object.radius_m);
}

template <class Row>
Row read_columns(CsvTable& table) {
  Row row;
  visit_columns(row, table);
  return row;
}

LoopRecord read_loop(CsvTable& table) {
  LoopRecord loop = read_columns<LoopRecord>(table);
  loop.score = table.number("score");
  table.optional("inliers", loop.inliers);
  table.optional("rms_m", loop.rms_m);
  loop.reason_text = table.text("reason");
  return loop;
}

MappedObject read_object(CsvTable& table) {
  MappedObject object = read_columns<MappedObject>(table);
  if (object.state != "candidate" && object.state != "confirmed" && object.state != "retired") {
    table.reject("state", "must be candidate, confirmed or retired");
  }
  return object;
}

/// A stated error of a loop that is given; `usual` where there is none.
double sigma(CsvTable& table, const std::string& column, double usual) {
  constexpr double kNotComputed = -1.0;
  const double value = table.has(column) ? table.number(column) : kNotComputed;
  if (value == kNotComputed) return usual;
  if (!(value > 0.0)) table.reject(column, "must be > 0");
  return value;
}

LoopClosure read_given_loop(CsvTable& table) {
  LoopClosure loop = read_columns<LoopClosure>(table);
  loop.reason = loop.accepted ? LoopReason::kAccepted : LoopReason::kTooFewObjects;
  constexpr double kSigma_m = 0.05, kSigma_deg = 1.7;  // as the loops of a desk usually state
  const double sigma_m = sigma(table, "sigma_m", kSigma_m), sigma_rad = radians(sigma(table, "sigma_deg", kSigma_deg));
  Vec6 variances;
  variances << Vec3::Constant(sigma_m * sigma_m / 3.0), Vec3::Constant(sigma_rad * sigma_rad / 3.0);
  loop.covariance = variances.asDiagonal();
  return loop;
}

template <class Row>
std::string row_of(Row row, bool is_header = false) {
  CsvWriter writer(is_header);
  visit_columns(row, writer);
  return writer.end();
}

}  // namespace

MappedObject mapped_object(const Landmark& landmark, const ClassTable& classes) {
  MappedObject object;
  object.id = landmark.id;
  object.class_id = landmark.class_id;
  object.label = classes.name(landmark.class_id);
  object.center = landmark.ellipsoid->T_world_quadric.t;
  object.rotation = landmark.ellipsoid->T_world_quadric.q;
  object.semi_axes = landmark.ellipsoid->semi_axes;
  object.state = to_string(landmark.state);
  object.observations = landmark.observations;
  object.baseline_deg = landmark.baseline_deg;
  object.mean_iou = landmark.mean_iou;
  object.quality = landmark.quality;
  return object;
}

std::string keyframe_table_header() { return row_of(KeyframePose(), true); }
std::string object_table_header() { return row_of(MappedObject(), true); }
std::string loop_object_table_header() { return row_of(LoopObjectRecord(), true); }
std::string loop_table_header() { return row_of(LoopFigures(), true); }
std::string table_row(const KeyframePose& keyframe) { return row_of(keyframe); }
std::string table_row(const MappedObject& object) { return row_of(object); }
std::string table_row(const LoopFigures& loop) { return row_of(loop); }

std::string loop_object_rows(const LoopClosure& loop, const ClassTable& classes) {
  std::string rows;
  for (const auto* objects : {&loop.query_objects, &loop.match_objects}) {
    for (std::size_t i = 0; i < objects->size(); ++i) {
      const SubmapObject& object = (*objects)[i];
      const int pair = i < loop.matches.size() ? static_cast<int>(i) : -1;
      rows += row_of(LoopObjectRecord{loop.query_frame, loop.match_frame, loop.query_end, loop.match_end,
                                      objects == &loop.query_objects, pair, object, classes.name(object.class_id)});
    }
  }
  return rows;
}

Result<std::vector<KeyframePose>> read_keyframes(const std::string& path) {
  return read_csv<KeyframePose>(path, read_columns<KeyframePose>);
}

Result<std::vector<MappedObject>> read_objects(const std::string& path) {
  return read_csv<MappedObject>(path, read_object);
}

Result<std::vector<LoopRecord>> read_loops(const std::string& path) { return read_csv<LoopRecord>(path, read_loop); }

Result<std::vector<LoopObjectRecord>> read_loop_objects(const std::string& path) {
  return read_csv<LoopObjectRecord>(path, read_columns<LoopObjectRecord>);
}

Result<std::vector<LoopClosure>> read_given_loops(const std::string& path) {
  return read_csv<LoopClosure>(path, read_given_loop);
}

Status write_given_loops(const std::string& path, const std::vector<LoopClosure>& loops) {
  std::string text = loop_table_header();
  for (LoopClosure loop : loops) {
    const Vec6 variances = loop.covariance.diagonal();
    loop.sigma_m = std::sqrt(variances.head<3>().sum());
    loop.sigma_deg = degrees(std::sqrt(variances.tail<3>().sum()));
    text += table_row(loop);
  }
  return write_text_file(path, text);
}

}  // namespace semantic_topo_loop::core
