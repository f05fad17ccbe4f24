#include "semantic_topo_loop/io/map_file.h"

#include <Eigen/LU>
#include <functional>
#include <set>
#include <utility>
#include <vector>

#include "io/archive.h"
#include "io/sqlite_file.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {

// --- what the members of each struct are called -------------------------------------------------------------------

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
struct Codec<LandmarkState> {
  static Json write(LandmarkState value) { return static_cast<int>(value); }
  static void read(const JsonField& field, LandmarkState* value) {
    const int number = field.small_integer();
    if (number < 0 || number > static_cast<int>(LandmarkState::kRetired)) return field.reject("is no state");
    *value = static_cast<LandmarkState>(number);
  }
};

template <>
struct Codec<SeenFrom> {
  static Json write(const SeenFrom& value) { return to_archive(value.smallest_px()); }
  static void read(const JsonField& field, SeenFrom* value) {
    SeenFrom::Bins bins{};
    from_archive(field, &bins);
    *value = SeenFrom(bins);
  }
};

/// By its camera's rotation and place, from which the rest follows.
template <>
struct Codec<LocalFrame> {
  static Json write(const LocalFrame& value) {
    return {{"frame_id", value.frame_id},
            {"camera_from_anchor_rotation", to_archive(value.R_camera_local)},
            {"position", to_archive(value.position)},
            {"focal_px", to_archive(value.focal_px)},
            {"image", to_archive(value.image)},
            {"boxes", to_archive(value.boxes)}};
  }
  static void read(const JsonField& field, LocalFrame* value) {
    from_archive(field.member("frame_id"), &value->frame_id);
    from_archive(field.member("camera_from_anchor_rotation"), &value->R_camera_local);
    from_archive(field.member("position"), &value->position);
    from_archive(field.member("focal_px"), &value->focal_px);
    from_archive(field.member("image"), &value->image);
    from_archive(field.member("boxes"), &value->boxes);
    constexpr double kTolerance = 1e-6;
    if (!value->R_camera_local.isUnitary(kTolerance) || value->R_camera_local.determinant() < 0.0) {
      field.member("camera_from_anchor_rotation").reject("is no rotation");
    }
    value->t_camera_local = -value->R_camera_local * value->position;
    if (!(value->focal_px.minCoeff() > 0.0)) field.member("focal_px").reject("must be > 0");
  }
};

}  // namespace archive

// The members' own names.
#define VISIT_MEMBERS(Struct, ...)                    \
  template <class Visitor>                            \
  void visit_members(Struct& value, Visitor& visit) { \
    __VA_ARGS__                                       \
  }
#define MEMBER(name) visit(#name, value.name);

VISIT_MEMBERS(Camera, MEMBER(fx) MEMBER(fy) MEMBER(cx) MEMBER(cy) MEMBER(width) MEMBER(height) MEMBER(distortion))
VISIT_MEMBERS(LoopVerdict, MEMBER(number) MEMBER(query_keyframe_id) MEMBER(match_keyframe_id) MEMBER(kept)
                               MEMBER(reason) MEMBER(is_extra))
VISIT_MEMBERS(EdgeCovariance, MEMBER(given) MEMBER(translation) MEMBER(rotation) MEMBER(suspected_jumps))
VISIT_MEMBERS(OdometryEdge,
              MEMBER(T_from_to) MEMBER(path_m) MEMBER(rotation_rad) MEMBER(covariance) MEMBER(is_break) MEMBER(frozen_s)
                  MEMBER(suspected_jump) MEMBER(jump_error_m) MEMBER(jump_error_rad) MEMBER(joined))
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
VISIT_MEMBERS(Landmark,
              MEMBER(id) MEMBER(class_id) MEMBER(state) MEMBER(ellipsoid) MEMBER(center_covariance)
                  MEMBER(anchor_keyframe_id) MEMBER(observations) MEMBER(baseline_deg) MEMBER(mean_iou) MEMBER(quality))
VISIT_MEMBERS(Sightings, MEMBER(seen_s) MEMBER(whole_s) MEMBER(expected_s) MEMBER(placed_s) MEMBER(bounded_s)
                             MEMBER(familiar_seen_s) MEMBER(familiar_missed_s) MEMBER(missed_since_s)
                                 MEMBER(transparent_s) MEMBER(seen_through_since_s))
VISIT_MEMBERS(BoxView, MEMBER(T_world_camera) MEMBER(box) MEMBER(truncated) MEMBER(near_m))
VISIT_MEMBERS(Observation, MEMBER(frame_id) MEMBER(source_id) MEMBER(keyframe_id) MEMBER(class_id) MEMBER(view))
VISIT_MEMBERS(MappedLandmark, MEMBER(state) MEMBER(seen_beside) MEMBER(sightings) MEMBER(seen_from)
                                  MEMBER(last_stamp_ns) MEMBER(next_fit_at) MEMBER(observations))
VISIT_MEMBERS(UpDirection, MEMBER(direction) MEMBER(certain))
VISIT_MEMBERS(Spheroid, MEMBER(center) MEMBER(log_axes))
VISIT_MEMBERS(ObservedBox, MEMBER(landmark_id) MEMBER(class_id) MEMBER(box) MEMBER(truncated) MEMBER(depth_m))
VISIT_MEMBERS(SubmapView, MEMBER(frame) MEMBER(box) MEMBER(depth_m) MEMBER(truncated))
VISIT_MEMBERS(LocalObject, MEMBER(landmark_id) MEMBER(class_id) MEMBER(spheroid) MEMBER(covariance) MEMBER(frames_seen)
                               MEMBER(seen_share) MEMBER(parallax_deg) MEMBER(views))
VISIT_MEMBERS(Surfel, MEMBER(position) MEMBER(normal))
VISIT_MEMBERS(LocalMap, MEMBER(keyframe_id) MEMBER(frame_id) MEMBER(stamp_ns) MEMBER(begin_frame) MEMBER(end_frame)
                            MEMBER(end_ns) MEMBER(span_s) MEMBER(drift_rad_s) MEMBER(T_odom_anchor) MEMBER(up)
                                MEMBER(frames) MEMBER(check_frames) MEMBER(objects) MEMBER(surfels))

#undef MEMBER
#undef VISIT_MEMBERS

namespace {

constexpr std::int64_t kApplicationId = 0x53544c6d;  // "STLm"
constexpr std::int64_t kVersion = 1;
constexpr char kSchema[] =
    "CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;"
    "CREATE TABLE session(first_keyframe INTEGER PRIMARY KEY, begin_ns INTEGER, end_ns INTEGER);"
    "CREATE TABLE class(id INTEGER PRIMARY KEY, name TEXT NOT NULL);"
    "CREATE TABLE keyframe(id INTEGER PRIMARY KEY, frame INTEGER, stamp_ns INTEGER, x REAL, y REAL, z REAL, qx REAL, "
    "qy REAL, qz REAL, qw REAL, scale REAL, vertex_from_keyframe BLOB);"
    "CREATE TABLE edge(number INTEGER PRIMARY KEY, body BLOB NOT NULL);"
    "CREATE TABLE loop(number INTEGER PRIMARY KEY, query INTEGER, match INTEGER, kept INTEGER, reason TEXT, "
    "body BLOB NOT NULL);"
    "CREATE TABLE object(id INTEGER PRIMARY KEY, class INTEGER, state TEXT, observations INTEGER, quality REAL, x "
    "REAL, "
    "y REAL, z REAL, body BLOB NOT NULL);"
    "CREATE TABLE submap(number INTEGER PRIMARY KEY, keyframe INTEGER, stamp_ns INTEGER, objects INTEGER, "
    "body BLOB NOT NULL);";

// --- writing ------------------------------------------------------------------------------------------------------

template <class T>
std::string packed(const T& value) {
  std::string bytes;
  Json::to_cbor(to_archive(value), bytes);
  return bytes;
}

void write_meta(const MapState& map, SqliteFile* file) {
  SqliteStatement insert(file, "INSERT INTO meta VALUES(?, ?)");
  const auto write = [&insert](const std::string& key, const Json& value) { (insert << key << value.dump()).run(); };
  write("next_frame", map.next_frame_id);
  write("accepted_loops", map.graph.accepted_loops);
  write("noise", to_archive(map.graph.noise));
  write("loose_factor", map.graph.loose_factor);
  write("camera", to_archive(map.objects.camera));
}

std::set<int> classes_of(const MapState& map) {
  std::set<int> ids;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    ids.insert(landmark.state.class_id);
    for (const Observation& observation : landmark.observations) ids.insert(observation.class_id);
  }
  for (const LocalMap& submap : map.submaps) {
    for (const LocalObject& object : submap.objects) ids.insert(object.class_id);
    for (const LocalFrame& frame : submap.frames) {
      for (const ObservedBox& box : frame.boxes) ids.insert(box.class_id);
    }
  }
  return ids;
}

void write_graph(const GraphState& graph, SqliteFile* file) {
  SqliteStatement keyframes(file, "INSERT INTO keyframe VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (const auto& [pose, T_vertex_keyframe] : graph.keyframes) {
    keyframes << pose.keyframe_id << pose.frame_id << pose.stamp_ns;
    for (int i = 0; i < 3; ++i) keyframes << pose.T_map_camera.t(i);
    for (int i = 0; i < 4; ++i) keyframes << pose.T_map_camera.q.coeffs()(i);
    keyframes << pose.scale;
    if (T_vertex_keyframe) keyframes.blob(packed(*T_vertex_keyframe));
    keyframes.run();
  }
  SqliteStatement edges(file, "INSERT INTO edge VALUES(?, ?)");
  for (std::size_t i = 0; i < graph.edges.size(); ++i) {
    (edges << static_cast<std::int64_t>(i)).blob(packed(graph.edges[i])).run();
  }
  SqliteStatement loops(file, "INSERT INTO loop VALUES(?, ?, ?, ?, ?, ?)");
  for (const RememberedLoop& loop : graph.loops) {
    const LoopVerdict& told = loop.told;
    loops << told.number << told.query_keyframe_id << told.match_keyframe_id << static_cast<std::int64_t>(told.kept);
    (loops << told.reason).blob(packed(loop)).run();
  }
}

void write_objects(const MapperState& objects, SqliteFile* file) {
  SqliteStatement insert(file, "INSERT INTO object VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (const MappedLandmark& landmark : objects.landmarks) {
    const Landmark& state = landmark.state;
    insert << state.id << static_cast<std::int64_t>(state.class_id) << std::string(to_string(state.state));
    insert << static_cast<std::int64_t>(state.observations) << state.quality;
    for (int i = 0; i < 3; ++i) {
      if (state.ellipsoid) {
        insert << state.ellipsoid->center()(i);
      } else {
        insert << nullptr;
      }
    }
    insert.blob(packed(landmark)).run();
  }
}

void write_submaps(const std::vector<LocalMap>& submaps, SqliteFile* file) {
  SqliteStatement insert(file, "INSERT INTO submap VALUES(?, ?, ?, ?, ?)");
  for (std::size_t i = 0; i < submaps.size(); ++i) {
    insert << static_cast<std::int64_t>(i) << submaps[i].keyframe_id << submaps[i].stamp_ns;
    (insert << static_cast<std::int64_t>(submaps[i].objects.size())).blob(packed(submaps[i])).run();
  }
}

// --- reading ------------------------------------------------------------------------------------------------------

/// @return discarded if it is none
Json from_cbor(const std::string& bytes) {
  try {
    return Json::from_cbor(bytes);
  } catch (const Json::exception&) {  // some it throws whether or not it may
    return Json(Json::value_t::discarded);
  }
}

/// The text of JSON or the bytes of CBOR into a value. @param place of it, for messages
template <class T>
void unpack(SqliteFile* file, const std::string& place, const Json& json, T* value) {
  if (!file->is_fine()) return;
  if (json.is_discarded()) return file->reject(place + " is damaged");
  std::string problem;
  from_archive(JsonField(json, place, &problem, false), value);
  if (problem.empty()) return;
  problem.clear();  // once more, to say where
  from_archive(JsonField(json, place, &problem), value);
  file->reject(problem);
}
template <class T>
void unpack(SqliteFile* file, const std::string& place, const std::string& bytes, T* value) {
  unpack(file, place, from_cbor(bytes), value);
}

template <class T>
void read_meta(const std::string& key, SqliteFile* file, T* value) {
  SqliteStatement select(file, "SELECT value FROM meta WHERE key = '" + key + "'");
  if (!select.next()) return file->reject("meta has no '" + key + "'");
  unpack(file, "meta '" + key + "'", Json::parse(select.bytes(0), nullptr, false), value);
}

std::string row_name(const char* table, const SqliteStatement& row) {
  return std::string(table) + ' ' + std::to_string(row.integer(0));
}

/// Bodies of a table's rows, in order. @param column of the body
template <class T>
std::vector<T> read_bodies(const char* table, const char* key, SqliteFile* file) {
  std::vector<T> values;
  SqliteStatement rows(file, std::string("SELECT ") + key + ", body FROM " + table + " ORDER BY " + key);
  while (rows.next()) unpack(file, row_name(table, rows), rows.bytes(1), &values.emplace_back());
  return values;
}

std::vector<GraphKeyframe> read_keyframes(SqliteFile* file) {
  std::vector<GraphKeyframe> keyframes;
  SqliteStatement rows(file,
                       "SELECT id, frame, stamp_ns, x, y, z, qx, qy, qz, qw, scale, vertex_from_keyframe FROM keyframe "
                       "ORDER BY id");
  while (rows.next()) {
    GraphKeyframe& keyframe = keyframes.emplace_back();
    KeyframePose& pose = keyframe.pose;
    pose.keyframe_id = rows.integer(0);
    pose.frame_id = rows.integer(1);
    pose.stamp_ns = rows.integer(2);
    pose.T_map_camera.t = {rows.number(3), rows.number(4), rows.number(5)};
    pose.T_map_camera.q = Quaternion(rows.number(9), rows.number(6), rows.number(7), rows.number(8));
    pose.scale = rows.number(10);
    const bool is_fine = pose.T_map_camera.is_finite() && is_rotation(pose.T_map_camera.q) && pose.scale > 0.0;
    if (!is_fine) file->reject(row_name("keyframe", rows) + " has no pose");
    constexpr int kVertexColumn = 11;
    if (rows.is_null(kVertexColumn)) continue;
    unpack(file, row_name("keyframe", rows) + " vertex_from_keyframe", rows.bytes(kVertexColumn),
           &keyframe.T_vertex_keyframe.emplace());
  }
  return keyframes;
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

Status check_truncation(std::uint8_t truncated) {
  constexpr int kAllSides = kLeft | kTop | kRight | kBottom;
  if (truncated > kAllSides) return Error{"truncated = " + std::to_string(truncated) + " must be a sum of 1, 2, 4, 8"};
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
    if (ellipsoid && !(ellipsoid->semi_axes.minCoeff() > 0.0)) return Error{name + " has an axis <= 0"};
    for (const Observation& observation : landmark.observations) {
      if (const Status sides = check_truncation(observation.view.truncated); !sides) {
        return Error{name + ": " + sides.message()};
      }
    }
  }
  return {};
}

void read_all(const ClassTable& classes, SqliteFile* file, MapState* map) {
  if (file->number("PRAGMA application_id") != kApplicationId) return file->reject("is no map of semantic_topo_loop");
  if (const std::int64_t version = file->number("PRAGMA user_version"); version != kVersion) {
    return file->reject("is a map of version " + std::to_string(version) + "; this program reads " +
                        std::to_string(kVersion));
  }
  SqliteStatement checked(file, "PRAGMA quick_check(1)");
  if (checked.next() && checked.bytes(0) != "ok") return file->reject("is damaged: " + checked.bytes(0));
  const auto require = [file](const Status& status) {
    if (!status) file->reject(status.message());
  };
  require(check_classes(classes, file));
  read_meta("next_frame", file, &map->next_frame_id);
  read_meta("accepted_loops", file, &map->graph.accepted_loops);
  read_meta("noise", file, &map->graph.noise);
  read_meta("loose_factor", file, &map->graph.loose_factor);
  read_meta("camera", file, &map->objects.camera);
  SqliteStatement sessions(file, "SELECT first_keyframe, begin_ns, end_ns FROM session ORDER BY first_keyframe");
  while (sessions.next()) {
    map->sessions.push_back({sessions.integer(0), sessions.integer(1), sessions.integer(2)});
  }
  map->graph.keyframes = read_keyframes(file);
  map->graph.edges = read_bodies<OdometryEdge>("edge", "number", file);
  map->graph.loops = read_bodies<RememberedLoop>("loop", "number", file);
  map->objects.landmarks = read_bodies<MappedLandmark>("object", "id", file);
  map->submaps = read_bodies<LocalMap>("submap", "number", file);
  if (!file->is_fine()) return;
  require(check(*map));
  require(check_objects(map->objects.landmarks, classes));
  if (!map->objects.landmarks.empty()) require(map->objects.camera.check());
  for (std::size_t i = 0; i < map->submaps.size(); ++i) {
    if (const Status completed = complete(classes, &map->submaps[i]); !completed) {
      return file->reject("submap " + std::to_string(i) + ": " + completed.message());
    }
  }
}

}  // namespace

Status write_map(const std::string& path, const MapState& map, const ClassTable& classes) {
  return replace_file(path, [&](const std::string& temporary) -> Status {
    SqliteFile file(temporary, SqliteFile::Mode::kWrite);
    file.run("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA application_id = " +
             std::to_string(kApplicationId) + "; PRAGMA user_version = " + std::to_string(kVersion) + "; BEGIN");
    file.run(kSchema);
    write_meta(map, &file);
    SqliteStatement sessions(&file, "INSERT INTO session VALUES(?, ?, ?)");
    for (const Session& session : map.sessions) {
      (sessions << session.first_keyframe_id << session.begin_ns << session.end_ns).run();
    }
    SqliteStatement names(&file, "INSERT INTO class VALUES(?, ?)");
    for (const int id : classes_of(map)) (names << static_cast<std::int64_t>(id) << classes.name(id)).run();
    write_graph(map.graph, &file);
    write_objects(map.objects, &file);
    write_submaps(map.submaps, &file);
    file.run("COMMIT");
    return file.is_fine() ? Status() : Error{file.problem()};
  });
}

Status dump_map(const std::string& path, std::ostream& out) {
  SqliteFile file(path, SqliteFile::Mode::kRead);
  SqliteStatement tables(&file, "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name");
  while (tables.next()) {
    const std::string table = tables.bytes(0);
    SqliteStatement rows(&file, "SELECT * FROM " + table + " ORDER BY 1");
    while (rows.next()) {
      out << table;
      for (int column = 0; column < rows.columns(); ++column) {
        out << ' ' << (rows.is_blob(column) ? from_cbor(rows.bytes(column)).dump() : rows.bytes(column));
      }
      out << '\n';
    }
  }
  return file.is_fine() ? Status() : Error{file.problem()};
}

Result<std::shared_ptr<const MapState>> read_map(const std::string& path, const ClassTable& classes) {
  SqliteFile file(path, SqliteFile::Mode::kRead);
  auto map = std::make_shared<MapState>();
  if (file.is_fine()) read_all(classes, &file, map.get());
  if (!file.is_fine()) return Error{file.problem()};
  return std::shared_ptr<const MapState>(std::move(map));
}

}  // namespace semantic_topo_loop::core
