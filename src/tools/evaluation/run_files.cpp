#include "tools/evaluation/run_files.h"

#include <cmath>
#include <functional>

#include "semantic_topo_loop/io/tum_trajectory.h"
#include "tools/evaluation/csv_table.h"

namespace semantic_topo_loop::core {
namespace {

/// Reads every row through `read_row`; the first failure of any becomes the error.
template <class T>
Result<std::vector<T>> read_rows(const std::string& path, const std::function<T(CsvTable&)>& read_row) {
  Result<CsvTable> table = CsvTable::read(path);
  if (!table) return table.error();
  std::vector<T> rows;
  for (std::size_t i = 0; i < table->size(); ++i) {
    table->select(i);
    rows.push_back(read_row(*table));
    if (!table->error().empty()) return Error{table->error()};
  }
  return rows;
}

Quaternion read_rotation(CsvTable& table) {
  const Quaternion q(table.number("qw"), table.number("qx"), table.number("qy"), table.number("qz"));
  if (!is_rotation(q)) table.reject("qw", "is part of a quaternion that is no rotation");
  return q.normalized();
}

MappedObject read_object(CsvTable& table) {
  MappedObject object;
  object.id = table.integer("id");
  object.class_id = static_cast<int>(table.integer("class_id"));
  object.label = table.text("label");
  object.center = table.vector("x", "y", "z");
  object.semi_axes = table.vector("a", "b", "c");
  object.state = table.text("state");
  object.observations = static_cast<int>(table.integer("observations"));
  if (object.state != "candidate" && object.state != "confirmed" && object.state != "retired") {
    table.reject("state", "must be candidate, confirmed or retired");
  }
  return object;
}

LoopRecord read_loop(CsvTable& table) {
  LoopRecord loop;
  loop.query_frame = table.integer("query_frame");
  loop.match_frame = table.integer("match_frame");
  loop.query_stamp_ns = table.stamp_ns("query_stamp");
  loop.match_stamp_ns = table.stamp_ns("match_stamp");
  loop.query_begin = table.integer("query_begin");
  loop.query_end = table.integer("query_end");
  loop.match_begin = table.integer("match_begin");
  loop.match_end = table.integer("match_end");
  loop.accepted = table.integer("accepted") == 1;
  loop.reason = table.text("reason");
  loop.score = table.number("score");
  loop.T_match_query = SE3(read_rotation(table), table.vector("x", "y", "z"));
  if (!loop.accepted && table.text("accepted") != "0") table.reject("accepted", "must be 0 or 1");
  return loop;
}

double sigma(CsvTable& table, const std::string& column, double usual) {
  constexpr double kNotComputed = -1.0;  // as loops.csv has it
  const double value = table.has(column) ? table.number(column) : kNotComputed;
  if (value == kNotComputed) return usual;
  if (!(value > 0.0)) table.reject(column, "must be > 0");
  return value;
}

LoopClosure read_given_loop(CsvTable& table) {
  const LoopRecord record = read_loop(table);
  LoopClosure loop;
  loop.query_frame = record.query_frame;
  loop.match_frame = record.match_frame;
  loop.query_stamp_ns = record.query_stamp_ns;
  loop.match_stamp_ns = record.match_stamp_ns;
  loop.query_begin = record.query_begin;
  loop.query_end = record.query_end;
  loop.match_begin = record.match_begin;
  loop.match_end = record.match_end;
  loop.accepted = record.accepted;
  loop.reason = record.accepted ? LoopReason::kAccepted : LoopReason::kTooFewObjects;
  loop.T_match_query = record.T_match_query;
  constexpr double kSigma_m = 0.05, kSigma_deg = 1.7;  // of a usual loop, where the file states none
  const double sigma_m = sigma(table, "sigma_m", kSigma_m), sigma_rad = radians(sigma(table, "sigma_deg", kSigma_deg));
  Vec6 variances;
  variances << Vec3::Constant(sigma_m * sigma_m / 3.0), Vec3::Constant(sigma_rad * sigma_rad / 3.0);
  loop.covariance = variances.asDiagonal();
  return loop;
}

KeyframePose read_keyframe(CsvTable& table) {
  KeyframePose keyframe;
  keyframe.keyframe_id = table.integer("keyframe_id");
  keyframe.frame_id = table.integer("frame_id");
  keyframe.stamp_ns = table.stamp_ns("stamp");
  keyframe.T_map_camera = SE3(read_rotation(table), table.vector("x", "y", "z"));
  return keyframe;
}

ReferenceObject read_reference(CsvTable& table) {
  ReferenceObject object;
  object.id = static_cast<int>(table.integer("id"));
  object.class_id = static_cast<int>(table.integer("label_id"));
  object.label = table.text("label");
  object.center = table.vector("x", "y", "z");
  object.semi_axes = table.vector("a", "b", "c");
  const std::string certainty = table.text("certainty");
  if (certainty == "probable") {
    object.certainty = Certainty::kProbable;
  } else if (certainty == "marginal") {
    object.certainty = Certainty::kMarginal;
  } else if (certainty != "certain") {
    table.reject("certainty", "must be certain, probable or marginal");
  }
  return object;
}

}  // namespace

Result<std::vector<MappedObject>> read_objects(const std::string& path) {
  return read_rows<MappedObject>(path, read_object);
}

Result<std::vector<LoopRecord>> read_loops(const std::string& path) { return read_rows<LoopRecord>(path, read_loop); }

Result<std::vector<LoopClosure>> read_given_loops(const std::string& path) {
  return read_rows<LoopClosure>(path, read_given_loop);
}

Result<std::vector<KeyframePose>> read_keyframes(const std::string& path) {
  return read_rows<KeyframePose>(path, read_keyframe);
}

Result<std::vector<ReferenceObject>> read_reference_objects(const std::string& path) {
  return read_rows<ReferenceObject>(path, read_reference);
}

Result<std::vector<std::int64_t>> read_keyframe_stamps(const std::string& path) {
  return read_rows<std::int64_t>(path, [](CsvTable& table) { return table.stamp_ns("stamp"); });
}

Result<Sightings> read_sightings(const std::string& directory) {
  const auto objects = read_objects(directory + "/objects.csv");
  if (!objects) return objects.error();
  const auto frames = read_tum_trajectory(directory + "/trajectory.txt");
  if (!frames) return frames.error();
  std::set<std::int64_t> confirmed;
  for (const MappedObject& object : *objects) {
    if (object.state == "confirmed") confirmed.insert(object.id);
  }
  Sightings sightings;
  const auto read_row = [&](CsvTable& table) {
    const std::int64_t frame = table.integer("frame_id"), id = table.integer("landmark_id");
    const bool is_known = frame >= 0 && frame < static_cast<std::int64_t>(frames->size());
    if (!is_known) table.reject("frame_id", "is no frame of trajectory.txt");
    if (is_known && confirmed.count(id) > 0) sightings[(*frames)[static_cast<std::size_t>(frame)].stamp_ns].insert(id);
    return id;
  };
  const auto rows = read_rows<std::int64_t>(directory + "/associations.csv", read_row);
  if (!rows) return rows.error();
  return sightings;
}

}  // namespace semantic_topo_loop::core
