#include "semantic_topo_loop/io/map_file.h"

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "io/compression.h"
#include "io/json_field.h"
#include "io/map_codecs.h"
#include "io/map_tables.h"
#include "io/sqlite_file.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/map_database.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kTables[] = "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name";

void require(const Status& status, SqliteFile* file) {
  if (!status) file->reject(status.message());
}

/// @param place of the body, for messages
template <class T>
void unpack(SqliteFile* file, const std::string& place, const std::string& body, T* value) {
  const auto* const begin = reinterpret_cast<const std::uint8_t*>(body.data());
  CborReader reader(place, begin, begin + body.size());
  from_archive(&reader, value);
  if (!reader.is_fine()) file->reject(reader.problem());
}

template <class T>
void read_meta(const std::string& key, SqliteFile* file, T* value) {
  SqliteStatement select(file, "SELECT value FROM meta WHERE key = '" + key + "'");
  if (!select.next()) return file->reject("meta has no '" + key + "'");
  constexpr int kDeepest = 64;  // writing CBOR calls itself for each level
  const auto is_shallow = [](int depth, Json::parse_event_t, const Json&) { return depth < kDeepest; };
  const Json json = Json::parse(select.bytes(0), is_shallow, false);
  std::string body;  // empty: damaged
  if (!json.is_discarded()) Json::to_cbor(json, body);
  unpack(file, "meta '" + key + "'", body, value);
}

std::string row_name(const char* table, const SqliteStatement& row) { return std::string(table) + ' ' + row.bytes(0); }

/// Bodies of a table's rows, in order.
/// @param name of a row, an expression   @param key what they are in order of; null: the name
template <class T>
std::vector<T> read_bodies(const char* table, const char* name, SqliteFile* file, const char* key = nullptr) {
  std::vector<T> values;
  SqliteStatement rows(
      file, std::string("SELECT ") + name + ", body FROM " + table + " ORDER BY " + (key != nullptr ? key : name));
  while (rows.next()) unpack(file, row_name(table, rows), rows.bytes(1), &values.emplace_back());
  return values;
}

/// From a column on: x, y, z, qx, qy, qz, qw.
SE3 read_pose(const SqliteStatement& row, int column) {
  const auto next = [&row, &column] { return row.number(column++); };
  const Vec3 t = {next(), next(), next()};
  const double x = next(), y = next(), z = next(), w = next();
  return {Quaternion(w, x, y, z), t};
}

bool is_place(const SE3& T) {
  constexpr double kFarthest_m = 1e100;  // beyond, products are no numbers any more
  return T.is_finite() && is_rotation(T.q) && T.t.norm() < kFarthest_m;
}

Status check_truncation(std::int64_t truncated) {
  constexpr std::int64_t kAllSides = kLeft | kTop | kRight | kBottom;
  if (truncated >= 0 && truncated <= kAllSides) return {};
  return Error{"truncated = " + std::to_string(truncated) + " must be a sum of 1, 2, 4, 8"};
}

std::vector<MappedLandmark> read_objects(SqliteFile* file) {
  std::vector<MappedLandmark> landmarks;
  for (LandmarkRecord& record : read_bodies<LandmarkRecord>("object", "id", file)) {
    static_cast<LandmarkRecord&>(landmarks.emplace_back()) = std::move(record);
  }
  SqliteStatement rows(file,
                       "SELECT object, number, frame, source, keyframe, class, x, y, z, qx, qy, qz, qw, x1, y1, x2, "
                       "y2, truncated, near_m FROM observation ORDER BY object, number");
  auto landmark = landmarks.begin();
  while (rows.next()) {
    const auto name = [&] {
      return "observation " + std::to_string(rows.integer(1)) + " of object " + std::to_string(rows.integer(0));
    };
    while (landmark != landmarks.end() && landmark->state.id < rows.integer(0)) ++landmark;
    if (landmark == landmarks.end() || landmark->state.id != rows.integer(0)) {
      file->reject(name() + ": there is no such object");
      return {};
    }
    if (rows.integer(1) != static_cast<std::int64_t>(landmark->observations.size())) {
      file->reject(name() + " does not follow the one before");
    }
    Observation& observation = landmark->observations.emplace_back();
    BoxView& view = observation.view;
    observation.frame_id = rows.integer(2);
    observation.source_id = rows.integer(3);
    observation.keyframe_id = rows.integer(4);
    observation.class_id = static_cast<int>(rows.integer(5));
    view.T_world_camera = read_pose(rows, 6);
    view.box = {rows.number(13), rows.number(14), rows.number(15), rows.number(16)};
    const std::int64_t truncated = rows.integer(17);
    view.truncated = static_cast<std::uint8_t>(truncated);
    view.near_m = rows.number(18);
    if (!view.T_world_camera.is_finite() || !is_rotation(view.T_world_camera.q)) file->reject(name() + " has no pose");
    if (!view.box.is_finite()) file->reject(name() + " has no box");
    if (const Status sides = check_truncation(truncated); !sides) file->reject(name() + ": " + sides.message());
  }
  return landmarks;
}

/// Of those that move with the vertex before them, whose place in the map is not in the file.
void place_keyframes(SqliteFile* file, std::vector<GraphKeyframe>* keyframes) {
  const KeyframePose* vertex = nullptr;
  for (GraphKeyframe& keyframe : *keyframes) {
    KeyframePose& pose = keyframe.pose;
    if (!keyframe.T_vertex_keyframe) {
      vertex = &pose;
    } else if (vertex == nullptr) {
      return file->reject("keyframe " + std::to_string(pose.keyframe_id) + " has no vertex before it");
    } else {
      pose.T_map_camera = vertex->T_map_camera * *keyframe.T_vertex_keyframe;
      pose.scale = vertex->scale;
    }
  }
}

std::vector<GraphKeyframe> read_keyframes(std::int64_t version, SqliteFile* file) {
  const bool has_live = version > 4, has_places = version > 6;
  std::vector<GraphKeyframe> keyframes;
  SqliteStatement rows(file, std::string("SELECT id, frame, stamp_ns, x, y, z, qx, qy, qz, qw, scale, ") +
                                 (has_places ? "is_vertex" : "vertex_from_keyframe") +
                                 (has_live ? ", live_x, live_y, live_z, live_qx, live_qy, live_qz, live_qw" : "") +
                                 " FROM keyframe ORDER BY id");
  while (rows.next()) {
    GraphKeyframe& keyframe = keyframes.emplace_back();
    KeyframePose& pose = keyframe.pose;
    pose.keyframe_id = rows.integer(0);
    pose.frame_id = rows.integer(1);
    pose.stamp_ns = rows.integer(2);
    pose.T_map_camera = read_pose(rows, 3);
    pose.scale = rows.number(10);
    if (!is_place(pose.T_map_camera) || !(pose.scale > 0.0)) file->reject(row_name("keyframe", rows) + " has no pose");
    constexpr int kVertexColumn = 11, kLiveColumn = 12;
    if (has_live && !rows.is_null(kLiveColumn)) {
      keyframe.T_map_live = read_pose(rows, kLiveColumn);
      if (!is_place(*keyframe.T_map_live)) file->reject(row_name("keyframe", rows) + " has no live pose");
    }
    if (has_places) {
      if (rows.integer(kVertexColumn) == 0) keyframe.T_vertex_keyframe = pose.T_map_camera;
    } else if (!rows.is_null(kVertexColumn)) {
      unpack(file, row_name("keyframe", rows) + " vertex_from_keyframe", rows.bytes(kVertexColumn),
             &keyframe.T_vertex_keyframe.emplace());
    }
  }
  if (has_places) place_keyframes(file, &keyframes);
  return keyframes;
}

std::vector<LoggedMerge> read_merges(SqliteFile* file) {
  std::vector<LoggedMerge> merges;
  SqliteStatement rows(file,
                       "SELECT number, merged, survivor, class, observations, frame, stamp_ns, undone_frame FROM merge "
                       "ORDER BY number");
  while (rows.next()) {
    LoggedMerge& merge = merges.emplace_back();
    merge.number = rows.integer(0);
    merge.merge = {rows.integer(1), rows.integer(2)};
    merge.merged_class_id = static_cast<int>(rows.integer(3));
    merge.merged_observations = static_cast<int>(rows.integer(4));
    merge.frame_id = rows.integer(5);
    merge.stamp_ns = rows.integer(6);
    constexpr int kUndoneColumn = 7;
    if (!rows.is_null(kUndoneColumn)) merge.undone_frame_id = rows.integer(kUndoneColumn);
  }
  return merges;
}

std::vector<PointsOfKeyframe> read_points(SqliteFile* file) {
  std::vector<PointsOfKeyframe> points;
  SqliteStatement rows(file, "SELECT keyframe, body FROM points ORDER BY keyframe");
  while (rows.next()) {
    auto of_keyframe = std::make_shared<KeyframePoints>();
    unpack(file, row_name("points", rows), inflated(rows.bytes(1)), of_keyframe.get());
    points.push_back({rows.integer(0), std::move(of_keyframe)});
  }
  return points;
}

/// @return an error that names a class that the table has not, or by another name
Status check_classes(const ClassTable& classes, SqliteFile* file) {
  SqliteStatement rows(file, "SELECT id, name FROM class ORDER BY id");
  while (rows.next()) {
    const auto id = static_cast<int>(rows.integer(0));
    const std::string name = rows.bytes(1);
    if (!classes.is_mappable(id)) {
      return Error{"class " + std::to_string(id) + " ('" + name +
                   "') is no class that becomes a landmark in the class table"};
    }
    if (classes.name(id) != name) {
      return Error{"class " + std::to_string(id) + " is '" + name + "' in the map and '" + classes.name(id) +
                   "' in the class table"};
    }
  }
  return {};
}

/// Completes a submap by what is not in the file.
Status complete(const ClassTable& classes, LocalMap* submap) {
  const auto is_frame = [submap](int frame) { return frame >= 0 && frame < static_cast<int>(submap->frames.size()); };
  if (!(submap->up.direction.norm() > 0.5)) return Error{"up is no direction"};
  for (const int frame : submap->check_frames) {
    if (!is_frame(frame)) return Error{"check_frames: " + std::to_string(frame) + " is no index of a frame"};
  }
  for (LocalFrame& frame : submap->frames) {
    for (ObservedBox& box : frame.boxes) {
      if (const Status sides = check_truncation(box.truncated); !sides) return sides;
      if (!classes.is_mappable(box.class_id)) return Error{"a box has class " + std::to_string(box.class_id)};
      box.label = classes.label(box.class_id);
    }
  }
  for (LocalObject& object : submap->objects) {
    constexpr double kMaxLogAxis = 10.0;  // 22 km
    if (!(object.spheroid.log_axes.cwiseAbs().maxCoeff() < kMaxLogAxis))
      return Error{"log_axes must be logs of metres"};
    if (!classes.is_mappable(object.class_id)) return Error{"an object has class " + std::to_string(object.class_id)};
    object.label = classes.label(object.class_id);
    for (const SubmapView& view : object.views) {
      if (!is_frame(view.frame)) return Error{"a view has frame " + std::to_string(view.frame) + ", not there"};
      if (const Status sides = check_truncation(view.truncated); !sides) return sides;
    }
  }
  return {};
}

Status check_objects(const std::vector<MappedLandmark>& landmarks, const ClassTable& classes) {
  for (const MappedLandmark& landmark : landmarks) {
    const std::string name = "object " + std::to_string(landmark.state.id);
    const std::optional<Ellipsoid>& ellipsoid = landmark.state.ellipsoid;
    if (!classes.is_mappable(landmark.state.class_id)) {
      return Error{name + " has class " + std::to_string(landmark.state.class_id)};
    }
    for (const Observation& observation : landmark.observations) {
      if (!classes.is_mappable(observation.class_id)) {
        return Error{"an observation of " + name + " has class " + std::to_string(observation.class_id)};
      }
    }
    if (ellipsoid && !(ellipsoid->semi_axes.minCoeff() > 0.0)) return Error{name + " has an axis <= 0"};
    const bool has_place = landmark.state.state == LandmarkState::kConfirmed || landmark.state.mean_iou > 0.0;
    if (has_place && !ellipsoid) return Error{name + " has no ellipsoid"};
  }
  return {};
}

/// Older files have how long a freeze lasted, and nothing of how well is known what was missed.
void know_what_was_missed(OdometryEdge* edge) {
  constexpr double kRate = 0.15;  // m/s and rad/s, 1 sigma
  const double sigma = kRate * edge->missed.frozen_s;
  if (edge->missed.covariance.isZero(0.0)) edge->missed.covariance = isotropic_covariance(sigma * sigma, sigma * sigma);
}

/// What SQLite does not see: bits that changed within a row.
void check_rows(SqliteFile* file) {
  SqliteStatement tables(file, kTables);
  while (tables.next()) {
    const std::string table = tables.bytes(0);
    SqliteStatement rows(file, "SELECT * FROM " + table);
    while (rows.next()) {
      if (!rows.is_intact())
        return file->reject(row_name(table.c_str(), rows) + " is damaged: not what its checksum says");
    }
  }
}

void read_all(const ClassTable& classes, MapParts parts, SqliteFile* file, MapState* map) {
  file->run("BEGIN");  // one state of it, whoever else writes
  if (file->number("PRAGMA application_id") != kMapApplicationId)
    return file->reject("is no map of semantic_topo_loop");
  const std::int64_t version = file->number("PRAGMA user_version");
  if (version < 1 || version > kMapVersion) {
    return file->reject("is a map of version " + std::to_string(version) + "; this program reads 1 to " +
                        std::to_string(kMapVersion));
  }
  SqliteStatement checked(file, "PRAGMA quick_check(1)");
  if (checked.next() && checked.bytes(0) != "ok") return file->reject("is damaged: " + checked.bytes(0));
  if (version > 5) check_rows(file);
  require(check_classes(classes, file), file);
  read_meta("configuration", file, &map->configuration);
  read_meta("next_frame", file, &map->graph.next_frame_id);
  read_meta("accepted_loops", file, &map->graph.accepted_loops);
  read_meta("noise", file, &map->graph.noise);
  read_meta("loose_factor", file, &map->graph.loose_factor);
  read_meta("camera", file, &map->objects.camera);
  SqliteStatement sessions(file, "SELECT first_keyframe, begin_ns, end_ns FROM session ORDER BY first_keyframe");
  while (sessions.next()) {
    map->graph.sessions.push_back({sessions.integer(0), sessions.integer(1), sessions.integer(2)});
  }
  map->graph.keyframes = read_keyframes(version, file);
  map->graph.edges = read_bodies<OdometryEdge>("edge", "number", file);
  for (OdometryEdge& edge : map->graph.edges) know_what_was_missed(&edge);
  map->graph.loops = read_bodies<RememberedLoop>("loop", "number", file);
  if (parts.objects) map->objects.landmarks = read_objects(file);
  if (parts.objects && version > 3) map->objects.merges = read_merges(file);
  if (parts.submaps) map->submaps = read_bodies<LocalMap>("submap", "frame", file);
  if (parts.points && version > 1) map->points = read_points(file);
  if (parts.submaps && version > 2) {
    map->refused = read_bodies<LoopFigures>("refused_loop", "query || ' to ' || match", file, "query, match");
  }
  if (!file->is_fine()) return;
  map->left_out = leave_out_unplaced(map);
  require(check(*map), file);
  require(check_objects(map->objects.landmarks, classes), file);
  for (const LoggedMerge& merge : map->objects.merges) {
    if (classes.is_mappable(merge.merged_class_id)) continue;
    file->reject("merge " + std::to_string(merge.number) + " has class " + std::to_string(merge.merged_class_id));
  }
  if (!map->objects.landmarks.empty()) require(map->objects.camera.check(), file);
  for (std::size_t i = 0; i < map->submaps.size(); ++i) {
    if (const Status completed = complete(classes, &map->submaps[i]); !completed) {
      return file->reject("submap " + std::to_string(map->submaps[i].frame_id) + ": " + completed.message());
    }
  }
}

}  // namespace

Status write_map(const std::string& path, const MapState& map, const ClassTable& classes) {
  return replace_map(path, [&](const std::string& temporary) -> Status {
    SqliteFile file(temporary, SqliteFile::Mode::kWrite);
    file.run("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; BEGIN");
    create_map_tables(&file);
    MapTables tables(&file, classes);
    tables.write_configuration(map.configuration);
    tables.write(map.graph, true);
    tables.write(map.objects.camera);
    for (const MappedLandmark& landmark : map.objects.landmarks) tables.write(landmark, landmark.observations, 0);
    for (const LoggedMerge& merge : map.objects.merges) tables.write(merge);
    for (const LocalMap& submap : map.submaps) tables.write(submap);
    for (const PointsOfKeyframe& keyframe : map.points) tables.write(keyframe);
    for (const LoopFigures& loop : map.refused) tables.write_refused(loop);
    file.run("COMMIT");
    return file.is_fine() ? Status() : Error{file.problem()};
  });
}

Status dump_map(const std::string& path, std::ostream& out) {
  SqliteFile file(path, SqliteFile::Mode::kRead);
  const int checksums = file.number("PRAGMA user_version") > 5 ? 1 : 0;  // which follow from the rest
  SqliteStatement tables(&file, kTables);
  while (tables.next()) {
    const std::string table = tables.bytes(0);
    SqliteStatement rows(&file, "SELECT * FROM " + table + " ORDER BY 1, 2");
    while (rows.next()) {
      out << table;
      for (int column = 0; column < rows.columns() - checksums; ++column) {
        constexpr int kDigits = 17;  // all of a double
        out << ' ';
        if (rows.is_blob(column)) {
          const std::string blob = rows.bytes(column);
          out << printable(from_cbor(is_compressed(blob) ? inflated(blob) : blob));
        } else {
          out << (rows.is_real(column) ? format_general(rows.number(column), kDigits) : rows.bytes(column));
        }
      }
      out << '\n';
    }
  }
  return file.is_fine() ? Status() : Error{file.problem()};
}

Result<std::shared_ptr<const MapState>> read_map(const std::string& path, const ClassTable& classes, MapParts parts) {
  SqliteFile file(path, SqliteFile::Mode::kRead);
  auto map = std::make_shared<MapState>();
  if (file.is_fine()) read_all(classes, parts, &file, map.get());
  if (!file.is_fine()) return Error{file.problem()};
  return std::shared_ptr<const MapState>(std::move(map));
}

}  // namespace semantic_topo_loop::core
