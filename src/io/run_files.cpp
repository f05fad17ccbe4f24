#include "semantic_topo_loop/io/run_files.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

#include "io/csv.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kPosition[] = "x,y,z", kRotation[] = "qx,qy,qz,qw";

template <class Row, class Listed>
using IfRowOf = std::enable_if_t<std::is_same_v<std::remove_const_t<Row>, Listed>>;

template <class Keyframe, class Visitor, class = IfRowOf<Keyframe, KeyframePose>>
void visit_columns(Keyframe& keyframe, Visitor& visit) {
  visit("keyframe_id", keyframe.keyframe_id);
  visit("frame_id", keyframe.frame_id);
  visit.stamp("stamp", keyframe.stamp_ns);
  visit(kPosition, keyframe.T_map_camera.t);
  visit(kRotation, keyframe.T_map_camera.q);
}

template <class Object, class Visitor, class = IfRowOf<Object, MappedObject>, class = void>
void visit_columns(Object& object, Visitor& visit) {
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

/// The fields of a loop (visit_fields) that loops.csv has, in the order of its columns. A stamp's column is named
/// without the unit and in seconds, the pose has seven columns, each other field the one of its name.
constexpr std::array<const char*, 26> kLoopFields = {"query_frame",
                                                     "match_frame",
                                                     "query_stamp_ns",
                                                     "match_stamp_ns",
                                                     "query_begin",
                                                     "query_end",
                                                     "match_begin",
                                                     "match_end",
                                                     "accepted",
                                                     "reason",
                                                     "score",
                                                     "inliers",
                                                     "match_from_query",
                                                     "labels",
                                                     "second_score",
                                                     "rms_m",
                                                     "spread_m",
                                                     "tilt_deg",
                                                     "reprojection_ratio",
                                                     "reprojected_objects",
                                                     "explained_share",
                                                     "refine_residual",
                                                     "refine_shift_m",
                                                     "refine_shift_deg",
                                                     "sigma_m",
                                                     "sigma_deg"};

bool is_stamp(const std::string& field) { return field == "query_stamp_ns" || field == "match_stamp_ns"; }

std::string column_of(const std::string& field) { return is_stamp(field) ? field.substr(0, field.size() - 3) : field; }

/// Calls `visit(column, value)` with the index in kLoopFields for every field that the file has.
template <class Loop, class Visit>
void visit_loop_fields(Loop& loop, const Visit& visit) {
  // Where the fields stand in the file, found once: runs have many rows.
  static const std::vector<std::size_t> kColumns = [] {
    std::vector<std::size_t> columns;
    const auto add = [&columns](const std::string& name, const auto&) {
      const auto found = std::find(kLoopFields.begin(), kLoopFields.end(), name);
      columns.push_back(static_cast<std::size_t>(found - kLoopFields.begin()));
    };
    const LoopFigures none;
    visit_fields(none, add);
    return columns;
  }();
  std::size_t field = 0;
  visit_fields(loop, [&](const char*, auto& value) {
    const std::size_t column = kColumns[field++];
    if (column < kLoopFields.size()) visit(column, value);
  });
}

/// Shows a field of a loop to a CsvWriter or CsvReader.
template <class Visitor, class Value>
void show(const char* field, Value& value, Visitor* visitor) {
  if constexpr (std::is_same_v<std::remove_const_t<Value>, SE3>) {
    (*visitor)(kPosition, value.t);
    (*visitor)(kRotation, value.q);
  } else if constexpr (std::is_same_v<std::remove_const_t<Value>, LoopReason>) {
    if constexpr (std::is_same_v<Visitor, CsvWriter>) (*visitor)(field, std::string(to_string(value)));
  } else if constexpr (std::is_same_v<std::remove_const_t<Value>, std::int64_t>) {
    is_stamp(field) ? visitor->stamp(column_of(field).c_str(), value) : (*visitor)(field, value);
  } else {
    (*visitor)(field, value);
  }
}

/// What a file must have: where and when the loop is, what was decided, and its pose.
constexpr std::size_t kScore = 10, kPose = 12;  ///< of kLoopFields; all before the score are needed

void read_loop_fields(CsvTable* table, LoopFigures* loop) {
  CsvReader reader(table);
  visit_loop_fields(*loop, [&reader](std::size_t column, auto& value) {
    if (column < kScore || column == kPose) show(kLoopFields[column], value, &reader);
  });
}

LoopRecord read_loop(CsvTable& table) {
  LoopRecord loop;
  read_loop_fields(&table, &loop);
  loop.score = table.number("score");
  loop.reason_text = table.text("reason");
  return loop;
}

KeyframePose read_keyframe(CsvTable& table) {
  KeyframePose keyframe;
  CsvReader reader(&table);
  visit_columns(keyframe, reader);
  return keyframe;
}

MappedObject read_object(CsvTable& table) {
  MappedObject object;
  CsvReader reader(&table);
  visit_columns(object, reader);
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
  LoopClosure loop;
  read_loop_fields(&table, &loop);
  loop.reason = loop.accepted ? LoopReason::kAccepted : LoopReason::kTooFewObjects;
  constexpr double kSigma_m = 0.05, kSigma_deg = 1.7;  // as the loops of a desk usually state
  const double sigma_m = sigma(table, "sigma_m", kSigma_m), sigma_rad = radians(sigma(table, "sigma_deg", kSigma_deg));
  Vec6 variances;
  variances << Vec3::Constant(sigma_m * sigma_m / 3.0), Vec3::Constant(sigma_rad * sigma_rad / 3.0);
  loop.covariance = variances.asDiagonal();
  return loop;
}

template <class Row>
std::string header_of() {
  CsvHeader header;
  const Row row;
  visit_columns(row, header);
  return header.end();
}

template <class Row>
std::string row_of(const Row& row) {
  CsvWriter writer;
  visit_columns(row, writer);
  return writer.text() + '\n';
}

}  // namespace

std::string keyframe_table_header() { return header_of<KeyframePose>(); }
std::string object_table_header() { return header_of<MappedObject>(); }
std::string table_row(const KeyframePose& keyframe) { return row_of(keyframe); }
std::string table_row(const MappedObject& object) { return row_of(object); }

std::string loop_table_header() {
  CsvRow header;
  for (const std::string field : kLoopFields) {
    if (field == "match_from_query") {
      header.add(kPosition).add(kRotation);
    } else {
      header.add(column_of(field));
    }
  }
  return header.end();
}

std::string table_row(const LoopFigures& loop) {
  std::array<CsvWriter, kLoopFields.size()> cells;
  visit_loop_fields(
      loop, [&cells](std::size_t column, const auto& value) { show(kLoopFields[column], value, &cells[column]); });
  CsvRow row;
  for (const CsvWriter& cell : cells) row.add(cell.text());
  return row.end();
}

Result<std::vector<KeyframePose>> read_keyframes(const std::string& path) {
  return read_csv<KeyframePose>(path, read_keyframe);
}

Result<std::vector<MappedObject>> read_objects(const std::string& path) {
  return read_csv<MappedObject>(path, read_object);
}

Result<std::vector<LoopRecord>> read_loops(const std::string& path) { return read_csv<LoopRecord>(path, read_loop); }

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
