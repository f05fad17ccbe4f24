#include "io/map_tables.h"

#include <optional>
#include <utility>

#include "io/compression.h"
#include "io/json_field.h"
#include "io/map_codecs.h"

namespace semantic_topo_loop::core {
namespace {

// Each row ends with the checksum of what is before; null where it comes from a file that has none.
constexpr char kSchema[] = R"(
CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT NOT NULL, checksum INTEGER) WITHOUT ROWID;
CREATE TABLE session(first_keyframe INTEGER PRIMARY KEY, begin_ns INTEGER NOT NULL, end_ns INTEGER NOT NULL,
  checksum INTEGER);
CREATE TABLE class(id INTEGER PRIMARY KEY, name TEXT NOT NULL, checksum INTEGER);
CREATE TABLE keyframe(id INTEGER PRIMARY KEY, frame INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
  is_vertex INTEGER NOT NULL, x REAL NOT NULL, y REAL NOT NULL, z REAL NOT NULL,
  qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL, scale REAL NOT NULL,
  live_x REAL, live_y REAL, live_z REAL, live_qx REAL, live_qy REAL, live_qz REAL, live_qw REAL, checksum INTEGER);
CREATE TABLE edge(number INTEGER PRIMARY KEY, body BLOB NOT NULL, checksum INTEGER);
CREATE TABLE loop(number INTEGER PRIMARY KEY, query INTEGER NOT NULL, match INTEGER NOT NULL, kept INTEGER NOT NULL,
  reason TEXT NOT NULL, body BLOB NOT NULL, checksum INTEGER);
CREATE TABLE object(id INTEGER PRIMARY KEY, class INTEGER NOT NULL, state TEXT NOT NULL, observations INTEGER NOT NULL,
  quality REAL NOT NULL, x REAL, y REAL, z REAL, body BLOB NOT NULL, checksum INTEGER);
CREATE TABLE observation(object INTEGER, number INTEGER, frame INTEGER NOT NULL, source INTEGER NOT NULL,
  keyframe INTEGER NOT NULL, class INTEGER NOT NULL, x REAL NOT NULL, y REAL NOT NULL, z REAL NOT NULL,
  qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
  x1 REAL NOT NULL, y1 REAL NOT NULL, x2 REAL NOT NULL, y2 REAL NOT NULL, truncated INTEGER NOT NULL,
  near_m REAL NOT NULL, checksum INTEGER, PRIMARY KEY(object, number)) WITHOUT ROWID;
CREATE TABLE merge(number INTEGER PRIMARY KEY, merged INTEGER NOT NULL, survivor INTEGER NOT NULL,
  class INTEGER NOT NULL, observations INTEGER NOT NULL, frame INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
  undone_frame INTEGER, checksum INTEGER);
CREATE TABLE submap(frame INTEGER PRIMARY KEY, keyframe INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
  objects INTEGER NOT NULL, body BLOB NOT NULL, checksum INTEGER);
CREATE TABLE points(keyframe INTEGER PRIMARY KEY, sparse INTEGER NOT NULL, semi_dense INTEGER NOT NULL,
  body BLOB NOT NULL, checksum INTEGER);
CREATE TABLE refused_loop(query INTEGER, match INTEGER, query_ns INTEGER NOT NULL, match_ns INTEGER NOT NULL,
  reason TEXT NOT NULL, inliers INTEGER NOT NULL, body BLOB NOT NULL, checksum INTEGER,
  PRIMARY KEY(query, match)) WITHOUT ROWID;
)";

template <class T>
std::string packed(const T& value) {
  CborWriter writer;
  to_archive(value, &writer);
  return writer.take();
}

template <class T>
std::string as_text(const T& value) {
  return from_cbor(packed(value)).dump();
}

SqliteStatement& operator<<(SqliteStatement& statement, const SE3& pose) {
  for (int i = 0; i < 3; ++i) statement << pose.t(i);
  for (int i = 0; i < 4; ++i) statement << pose.q.coeffs()(i);
  return statement;
}

}  // namespace

void create_map_tables(SqliteFile* file) {
  file->run("PRAGMA application_id = " + std::to_string(kMapApplicationId) +
            "; PRAGMA user_version = " + std::to_string(kMapVersion));
  file->run(kSchema);
}

MapTables::MapTables(SqliteFile* file, const ClassTable& classes) : file_(file), classes_(classes) {}

const std::string* MapTables::Mirror::take(std::int64_t key, const std::string& body) {
  Row& row = rows.try_emplace(key).first->second;
  row.given = time;
  if (row.body == body) return nullptr;
  row.body = body;  // a copy is no longer than it must be
  return &row.body;
}

void MapTables::finish(const char* table, const char* key, Mirror* mirror) {
  SqliteStatement remove(file_, std::string("DELETE FROM ") + table + " WHERE " + key + " = ?");
  for (auto it = mirror->rows.begin(); it != mirror->rows.end();) {
    if (it->second.given == mirror->time) {
      ++it;
    } else {
      (remove << it->first).run();
      it = mirror->rows.erase(it);
    }
  }
  ++mirror->time;
}

void MapTables::write_meta(const std::string& key, const std::string& value) {
  (SqliteStatement(file_, "INSERT OR REPLACE INTO meta VALUES(?, ?, ?)") << key << value).run_with_checksum();
}

void MapTables::name_class(int class_id) {
  if (!named_.insert(class_id).second) return;
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO class VALUES(?, ?, ?)");
  (insert << static_cast<std::int64_t>(class_id) << classes_.name(class_id)).run_with_checksum();
}

void MapTables::write(const GraphState& graph, bool is_whole) {
  if (is_whole) file_->run("DELETE FROM keyframe; DELETE FROM session");
  if (!has_graph_) file_->run("DELETE FROM edge; DELETE FROM loop");
  has_graph_ = true;
  write_meta("next_frame", as_text(graph.next_frame_id));
  write_meta("accepted_loops", as_text(graph.accepted_loops));
  write_meta("noise", as_text(graph.noise));
  write_meta("loose_factor", as_text(graph.loose_factor));
  SqliteStatement sessions(file_, "INSERT OR REPLACE INTO session VALUES(?, ?, ?, ?)");
  for (const Session& session : graph.sessions) {
    (sessions << session.first_keyframe_id << session.begin_ns << session.end_ns).run_with_checksum();
  }
  SqliteStatement keyframes(
      file_, "INSERT OR REPLACE INTO keyframe VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (const GraphKeyframe& keyframe : graph.keyframes) {
    const KeyframePose& pose = keyframe.pose;
    keyframes << pose.keyframe_id << pose.frame_id << pose.stamp_ns;
    keyframes << static_cast<std::int64_t>(!keyframe.T_vertex_keyframe);
    keyframes << keyframe.T_vertex_keyframe.value_or(pose.T_map_camera) << pose.scale;
    if (keyframe.T_map_live) keyframes << *keyframe.T_map_live;
    keyframes.run_with_checksum();
  }
  SqliteStatement edges(file_, "INSERT OR REPLACE INTO edge VALUES(?, ?, ?)");
  for (std::size_t i = 0; i < graph.edges.size(); ++i) {
    const auto number = static_cast<std::int64_t>(i);
    if (const std::string* body = edges_.take(number, packed(graph.edges[i])))
      (edges << number).blob(*body).run_with_checksum();
  }
  finish("edge", "number", &edges_);
  SqliteStatement loops(file_, "INSERT OR REPLACE INTO loop VALUES(?, ?, ?, ?, ?, ?, ?)");
  for (const RememberedLoop& loop : graph.loops) {
    const LoopVerdict& told = loop.told;
    const std::string* const body = loops_.take(told.number, packed(loop));
    if (body == nullptr) continue;
    loops << told.number << told.query_keyframe_id << told.match_keyframe_id << static_cast<std::int64_t>(told.kept);
    (loops << told.reason).blob(*body).run_with_checksum();
  }
  finish("loop", "number", &loops_);
}

void MapTables::write_configuration(const std::string& text) {
  // Names of files may be no UTF-8.
  write_meta("configuration", printable(Json(text)));
}

void MapTables::write(const Camera& camera) { write_meta("camera", as_text(camera)); }

void MapTables::write(const LandmarkRecord& record, const std::vector<Observation>& observations, std::size_t first) {
  const Landmark& state = record.state;
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO object VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  name_class(state.class_id);
  insert << state.id << static_cast<std::int64_t>(state.class_id) << std::string(to_string(state.state));
  insert << static_cast<std::int64_t>(state.observations) << state.quality;
  for (int i = 0; i < 3; ++i) {
    if (state.ellipsoid) {
      insert << state.ellipsoid->center()(i);
    } else {
      insert << nullptr;
    }
  }
  insert.blob(packed(record)).run_with_checksum();
  auto number = static_cast<std::int64_t>(first);
  (SqliteStatement(file_, "DELETE FROM observation WHERE object = ? AND number >= ?") << state.id << number).run();
  SqliteStatement rows(file_,
                       "INSERT INTO observation VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (const Observation& observation : observations) {
    const BoxView& view = observation.view;
    name_class(observation.class_id);
    rows << state.id << number++ << observation.frame_id << observation.source_id << observation.keyframe_id;
    rows << static_cast<std::int64_t>(observation.class_id) << view.T_world_camera;
    rows << view.box.x1 << view.box.y1 << view.box.x2 << view.box.y2;
    (rows << static_cast<std::int64_t>(view.truncated) << view.near_m).run_with_checksum();
  }
}

void MapTables::write(const LoggedMerge& merge) {
  name_class(merge.merged_class_id);
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO merge VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)");
  insert << merge.number << merge.merge.merged_id << merge.merge.survivor_id;
  insert << static_cast<std::int64_t>(merge.merged_class_id) << static_cast<std::int64_t>(merge.merged_observations);
  insert << merge.frame_id << merge.stamp_ns;
  if (merge.undone_frame_id) insert << *merge.undone_frame_id;
  insert.run_with_checksum();
}

void MapTables::write(const LocalMap& submap) {
  for (const LocalObject& object : submap.objects) name_class(object.class_id);
  for (const LocalFrame& frame : submap.frames) {
    for (const ObservedBox& box : frame.boxes) name_class(box.class_id);
  }
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO submap VALUES(?, ?, ?, ?, ?, ?)");
  insert << submap.frame_id << submap.keyframe_id << submap.stamp_ns;
  (insert << static_cast<std::int64_t>(submap.objects.size())).blob(packed(submap)).run_with_checksum();
}

void MapTables::write_refused(const LoopFigures& loop) {
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO refused_loop VALUES(?, ?, ?, ?, ?, ?, ?, ?)");
  insert << loop.query_keyframe_id << loop.match_keyframe_id << loop.query_stamp_ns << loop.match_stamp_ns;
  (insert << std::string(to_string(loop.reason)) << static_cast<std::int64_t>(loop.inliers))
      .blob(packed(loop))
      .run_with_checksum();
}

void MapTables::write(const PointsOfKeyframe& keyframe) {
  SqliteStatement insert(file_, "INSERT OR REPLACE INTO points VALUES(?, ?, ?, ?, ?)");
  insert << keyframe.keyframe_id << static_cast<std::int64_t>(keyframe.points->sparse.size());
  insert << static_cast<std::int64_t>(keyframe.points->semi_dense.size());
  insert.blob(compressed(packed(*keyframe.points))).run_with_checksum();
}

void MapTables::write(const MapDelta& delta) {
  for (const PointsOfKeyframe& keyframe : delta.points) write(keyframe);
  if (delta.graph) write(delta.graph->state, delta.graph->is_whole);
  if (delta.objects) {
    if (delta.objects->is_whole) file_->run("DELETE FROM object; DELETE FROM observation; DELETE FROM merge");
    write(delta.objects->camera);
    for (const char* sql : {"DELETE FROM object WHERE id = ?", "DELETE FROM observation WHERE object = ?"}) {
      SqliteStatement remove(file_, sql);
      for (const std::int64_t id : delta.objects->removed) (remove << id).run();
    }
    for (const LandmarkDelta& landmark : delta.objects->changed) {
      write(landmark.record, landmark.observations, landmark.first);
    }
    (SqliteStatement(file_, "DELETE FROM merge WHERE number < ?") << delta.objects->first_merge).run();
    for (const LoggedMerge& merge : delta.objects->merges) write(merge);
  }
  if (!delta.submaps) return;
  if (delta.submaps->is_whole) file_->run("DELETE FROM submap; DELETE FROM refused_loop");
  SqliteStatement forget(file_, "DELETE FROM submap WHERE frame = ?");
  for (const std::int64_t frame_id : delta.submaps->forgotten) (forget << frame_id).run();
  for (const LocalMap& submap : delta.submaps->added) write(submap);
  (SqliteStatement(file_, "DELETE FROM refused_loop WHERE query < ?") << delta.submaps->first_query).run();
  SqliteStatement accept(file_, "DELETE FROM refused_loop WHERE query = ? AND match = ?");
  for (const LoopFigures& loop : delta.submaps->decided) {
    if (loop.accepted) {
      (accept << loop.query_keyframe_id << loop.match_keyframe_id).run();
    } else {
      write_refused(loop);
    }
  }
}

std::vector<std::uint8_t> pack(const MapDelta& delta) {
  const std::string bytes = packed(delta);
  return {bytes.begin(), bytes.end()};
}

std::shared_ptr<const MapDelta> unpack_map_delta(const std::vector<std::uint8_t>& bytes) {
  CborReader reader("part of a map", bytes.data(), bytes.data() + bytes.size());
  auto delta = std::make_shared<MapDelta>();
  from_archive(&reader, delta.get());
  return reader.is_fine() ? delta : nullptr;
}

}  // namespace semantic_topo_loop::core
