#include "semantic_topo_loop/io/map_file.h"

#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "io/json_field.h"
#include "io/sqlite_file.h"
#include "odometry/odometry_edge.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/map_database.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/package_config.h"
#include "support/simulated_run.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

/// Makes of a map without keyframes that move with others one of version 5, which has no checksums: what else is wrong
/// is not all that they say.
constexpr char kAsOf5[] = "ALTER TABLE keyframe ADD COLUMN vertex_from_keyframe BLOB; PRAGMA user_version = 5; ";

/// A map of a desk that was gone round twice.
const MapState& desk() {
  static const std::shared_ptr<const MapState> map = [] {
    SimulationOptions options;
    options.scene.layout = "desk";
    options.trajectory.duration_s = 30.0;
    options.trajectory.rate_hz = 10.0;
    const SimulatedSequence sequence =
        checked(simulate(options, checked(read_camera(STL_CONFIG_DIR "/camera/tum_fr2.yaml")), *shared_coco()));
    MapState made = *testing::map_of(sequence, 0, sequence.odometry.size(), shared_coco());
    made.graph.edges[0].missed = {0.5, 0.25, isotropic_covariance(0.01, 0.02)};
    return std::make_shared<const MapState>(std::move(made));
  }();
  return *map;
}

std::string dump_of(const std::string& path) {
  std::ostringstream text;
  EXPECT_EQ(dump_map(path, text).message(), "");
  return text.str();
}

class MapFile : public ::testing::Test {
 protected:
  void SetUp() override { ASSERT_EQ(write_map(path_, desk(), *shared_coco()).message(), ""); }
  /// The error that the map gives once a statement has changed it.
  std::string error_after(const std::string& sql) {
    change(sql);
    return error();
  }
  void change(const std::string& sql) const {
    std::filesystem::remove(path_);  // which the change before may have made none of ours
    EXPECT_EQ(write_map(path_, desk(), *shared_coco()).message(), "");
    sqlite3* database = nullptr;
    EXPECT_EQ(sqlite3_open(path_.c_str(), &database), SQLITE_OK);
    for (const std::string& statement : {std::string(kAsOf5), sql}) {
      EXPECT_EQ(sqlite3_exec(database, statement.c_str(), nullptr, nullptr, nullptr), SQLITE_OK) << statement;
    }
    sqlite3_close(database);
  }
  /// What is said behind the path, in one line.
  std::string error() const {
    const std::string message = read_map(path_, *shared_coco()).message();
    EXPECT_EQ(message.find(path_ + ": "), 0U) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    return message.substr(std::min(message.size(), path_.size() + 2));
  }
  std::string error_with(const std::string& table, const std::string& pointer, const Json& value) {
    change_body(table, pointer, value);
    return error();
  }
  /// One value of the first packed body of a table.
  void change_body(const std::string& table, const std::string& pointer, const Json& value) {
    sqlite3* database = nullptr;
    EXPECT_EQ(write_map(path_, desk(), *shared_coco()).message(), "");
    EXPECT_EQ(sqlite3_open(path_.c_str(), &database), SQLITE_OK);
    sqlite3_stmt* select = nullptr;
    sqlite3_prepare_v2(database, ("SELECT rowid, body FROM " + table + " LIMIT 1").c_str(), -1, &select, nullptr);
    EXPECT_EQ(sqlite3_step(select), SQLITE_ROW);
    const auto* bytes = static_cast<const std::uint8_t*>(sqlite3_column_blob(select, 1));
    Json body = Json::from_cbor(bytes, bytes + sqlite3_column_bytes(select, 1));
    const std::int64_t row = sqlite3_column_int64(select, 0);
    sqlite3_finalize(select);
    EXPECT_TRUE(body.contains(Json::json_pointer(pointer))) << pointer << " " << body.dump().substr(0, 500);
    body[Json::json_pointer(pointer)] = value;
    const std::vector<std::uint8_t> packed = Json::to_cbor(body);
    sqlite3_stmt* update = nullptr;
    sqlite3_prepare_v2(database, ("UPDATE " + table + " SET body = ?, checksum = NULL WHERE rowid = ?").c_str(), -1,
                       &update, nullptr);
    sqlite3_bind_blob(update, 1, packed.data(), static_cast<int>(packed.size()), SQLITE_STATIC);
    sqlite3_bind_int64(update, 2, row);
    EXPECT_EQ(sqlite3_step(update), SQLITE_DONE);
    sqlite3_finalize(update);
    sqlite3_close(database);
  }

  TestDirectory directory_;
  const std::string path_ = directory_.path("map.db");
};

TEST_F(MapFile, WhatIsReadAndWrittenAgainIsTheSameToTheLastBit) {
  const auto read = read_map(path_, *shared_coco());
  ASSERT_TRUE(read) << read.message();
  const MapState &a = desk(), &b = **read;
  ASSERT_GT(a.graph.loops.size(), 10U);
  ASSERT_GT(a.submaps.size(), 3U);
  EXPECT_EQ(a.graph.sessions.size(), 1U);
  EXPECT_EQ(b.graph.next_frame_id, 301);  // the end is a frame, too
  ASSERT_EQ(a.graph.keyframes.size(), b.graph.keyframes.size());
  EXPECT_EQ(a.graph.keyframes.back().pose.T_map_camera.t, b.graph.keyframes.back().pose.T_map_camera.t);
  EXPECT_EQ(a.graph.edges[0].missed.slipped_s, b.graph.edges[0].missed.slipped_s);
  EXPECT_EQ(a.graph.edges[0].missed.covariance, b.graph.edges[0].missed.covariance);
  ASSERT_EQ(a.objects.landmarks.size(), b.objects.landmarks.size());
  EXPECT_EQ(a.submaps[0].objects[0].label, b.submaps[0].objects[0].label);
  EXPECT_TRUE(a.submaps[0].frames[2].t_camera_local.isApprox(b.submaps[0].frames[2].t_camera_local, 1e-12));
  const std::string again = directory_.path("again.db");
  ASSERT_EQ(write_map(again, b, *shared_coco()).message(), "");
  const std::string dump = dump_of(path_);
  EXPECT_GT(dump.size(), 100'000U);
  EXPECT_TRUE(dump == dump_of(again));
  EXPECT_TRUE(read_whole(path_) == read_whole(again));
}

TEST_F(MapFile, KeepsSurfacesAndFeatures) {
  MapState map = desk();
  const Eigen::Vector3f normal = Eigen::Vector3f(1.0F, -2.0F, 2.0F) / 3.0F;
  map.submaps[0].surfels =
      std::make_shared<const std::vector<Surfel>>(std::vector<Surfel>{{{0.1F, -0.2F, 1.5F}, normal}});
  const Eigen::Vector3f position(0.3F, -0.1F, 1.2F);
  const Descriptor descriptor{1, ~std::uint64_t{0}, std::uint64_t{1} << 63, 0};
  map.submaps[0].features =
      std::make_shared<const std::vector<PointFeature>>(std::vector<PointFeature>{{5, position, descriptor}});
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  ASSERT_NE(read->submaps[0].surfels, nullptr);
  EXPECT_EQ((*read->submaps[0].surfels)[0].position, map.submaps[0].surfels->front().position);
  EXPECT_EQ((*read->submaps[0].surfels)[0].normal, normal);
  EXPECT_EQ(read->submaps[1].surfels, nullptr);
  ASSERT_NE(read->submaps[0].features, nullptr);
  const PointFeature& feature = (*read->submaps[0].features)[0];
  EXPECT_EQ(feature.id, 5);
  EXPECT_EQ(feature.position, position);
  EXPECT_EQ(feature.descriptor, descriptor);
  EXPECT_EQ(read->submaps[1].features, nullptr);
}

TEST_F(MapFile, KeepsPointsToTheMillimetre) {
  MapState map = desk();
  KeyframePoints points;
  points.sparse = {{5, {0.1F, -0.2F, 1.5F}}, {3000000000, {0.1234F, 0.0F, 70.0F}}};
  points.semi_dense = {{-1.0F, 0.0015F, 2.0F}, {-1.0F, 1e30F, 2.1F}};
  map.points = {{2, std::make_shared<const KeyframePoints>(points)}};
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  ASSERT_EQ(read->points.size(), 1U);
  EXPECT_EQ(read->points[0].keyframe_id, 2);
  const KeyframePoints& again = *read->points[0].points;
  ASSERT_EQ(again.sparse.size(), 2U);
  EXPECT_EQ(again.sparse[0].id, 5);
  EXPECT_EQ(again.sparse[0].point_camera, points.sparse[0].point_camera);
  EXPECT_EQ(again.sparse[1].id, 3000000000);
  EXPECT_LT((again.sparse[1].point_camera - points.sparse[1].point_camera).norm(), 6e-4F);
  ASSERT_EQ(again.semi_dense.size(), 2U);
  EXPECT_EQ(again.semi_dense[0], Eigen::Vector3f(-1.0F, 0.002F, 2.0F));
  EXPECT_EQ(again.semi_dense[1], Eigen::Vector3f(-1.0F, 1e6F, 2.1F)) << "the farthest";
  const std::string dump = dump_of(path_);
  EXPECT_NE(dump.find("\"sparse_id_steps\":[5,2999999995]"), std::string::npos);
  ASSERT_EQ(write_map(path_, *read, *shared_coco()).message(), "");
  EXPECT_TRUE(dump_of(path_) == dump) << "what was rounded once stays";
  map.points[0].keyframe_id = 100000;
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->left_out, 1U) << "of a keyframe that the graph does not have";
}

TEST_F(MapFile, KeepsPosesAsTheyWereToldFirst) {
  MapState map = desk();
  const SE3 T_map_live(so3_exp(Vec3(0.1, -0.2, 0.3)), Vec3(0.1 + 0.2, 2.0, 3.0));
  map.graph.keyframes[2].T_map_live = T_map_live;
  map.graph.keyframes[3].T_map_live.reset();
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  ASSERT_TRUE(read->graph.keyframes[2].T_map_live.has_value());
  EXPECT_EQ(read->graph.keyframes[2].T_map_live->t, T_map_live.t);
  EXPECT_EQ(read->graph.keyframes[2].T_map_live->q.coeffs(), T_map_live.q.coeffs());
  EXPECT_FALSE(read->graph.keyframes[3].T_map_live.has_value());
  EXPECT_EQ(error_after("UPDATE keyframe SET live_qw = 9.0 WHERE id = 2"), "keyframe 2 has no live pose");
}

TEST_F(MapFile, KeepsWhichObjectsWereMerged) {
  MapState map = desk();
  map.objects.merges = {{3, {8, 2}, 41, 12, 100, 5'000'000'001, std::nullopt},
                        {4, {9, 2}, 41, 7, 110, 5'000'000'002, 120},
                        {5, {9, 2}, 41, 7, 301, 5'000'000'003, std::nullopt}};
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  EXPECT_EQ(read->left_out, 1U) << "newer than the graph";
  ASSERT_EQ(read->objects.merges.size(), 2U);
  const LoggedMerge& merge = read->objects.merges[1];
  EXPECT_EQ(merge.number, 4);
  EXPECT_EQ(merge.merge.merged_id, 9);
  EXPECT_EQ(merge.merge.survivor_id, 2);
  EXPECT_EQ(merge.merged_class_id, 41);
  EXPECT_EQ(merge.merged_observations, 7);
  EXPECT_EQ(merge.frame_id, 110);
  EXPECT_EQ(merge.stamp_ns, 5'000'000'002);
  EXPECT_EQ(merge.undone_frame_id, std::optional<std::int64_t>(120));
  EXPECT_FALSE(read->objects.merges[0].undone_frame_id.has_value());
  EXPECT_NE(dump_of(path_).find("merge 3 8 2 41 12 100 5000000001 \n"), std::string::npos);
  SqliteFile(path_, SqliteFile::Mode::kWrite)
      .run(std::string(kAsOf5) + "UPDATE merge SET class = 9999 WHERE number = 4");
  EXPECT_EQ(error(), "merge 4 has class 9999");
}

/// A candidate that loop detection refused.
LoopFigures refused_between(std::int64_t query, std::int64_t match) {
  LoopFigures loop;
  loop.query_keyframe_id = query;
  loop.match_keyframe_id = match;
  loop.query_stamp_ns = 5'000'000'001;
  loop.reason = LoopReason::kTilt;
  loop.inliers = 7;
  loop.rms_m = 0.1 + 0.2;
  loop.T_match_query = {so3_exp(Vec3(0.1, -0.2, 0.3)), Vec3(1.0, 2.0, 3.0)};
  return loop;
}

TEST_F(MapFile, KeepsWhatLoopDetectionRefused) {
  MapState map = desk();
  map.refused = {refused_between(5, 2), refused_between(10, 3), refused_between(5, 1), refused_between(100000, 1)};
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  EXPECT_EQ(read->left_out, 1U) << "of a keyframe that the graph does not have";
  ASSERT_EQ(read->refused.size(), 3U);
  const LoopFigures& loop = read->refused[1];
  EXPECT_EQ(read->refused[0].match_keyframe_id, 1);
  EXPECT_EQ(loop.query_keyframe_id, 5);
  EXPECT_EQ(loop.match_keyframe_id, 2);
  EXPECT_EQ(loop.query_stamp_ns, 5'000'000'001);
  EXPECT_EQ(loop.reason, LoopReason::kTilt);
  EXPECT_EQ(loop.inliers, 7);
  EXPECT_EQ(loop.rms_m, 0.1 + 0.2);
  EXPECT_FALSE(loop.accepted);
  EXPECT_EQ(loop.T_match_query.q.coeffs(), map.refused[0].T_match_query.q.coeffs());
  EXPECT_NE(dump_of(path_).find("refused_loop 5 2 5000000001 0 tilt 7 ["), std::string::npos);
  SqliteFile(path_, SqliteFile::Mode::kWrite)
      .run(std::string(kAsOf5) + "UPDATE refused_loop SET body = x'ff' WHERE match = 2");
  EXPECT_EQ(error(), "refused_loop 5 to 2 is damaged");
}

TEST_F(MapFile, KeyframesThatMoveWithOthersArePlacedByThese) {
  MapState map;
  GraphState& graph = map.graph;
  graph.keyframes.assign(desk().graph.keyframes.begin(), desk().graph.keyframes.begin() + 3);
  graph.edges = {desk().graph.edges[0]};
  graph.next_frame_id = desk().graph.next_frame_id;
  const SE3 T_vertex_keyframe(so3_exp(Vec3(0.1, -0.2, 0.3)), Vec3(1.0, 2.0, 3.0));
  graph.keyframes[0].pose.scale = 1.5;
  graph.keyframes[1].T_vertex_keyframe = T_vertex_keyframe;
  ASSERT_EQ(write_map(path_, map, *shared_coco()).message(), "");
  const auto read = checked(read_map(path_, *shared_coco()));
  ASSERT_EQ(read->graph.keyframes.size(), 3U);
  const GraphKeyframe& keyframe = read->graph.keyframes[1];
  EXPECT_EQ(keyframe.T_vertex_keyframe->t, T_vertex_keyframe.t);
  const SE3 T_map_camera = read->graph.keyframes[0].pose.T_map_camera * T_vertex_keyframe;
  EXPECT_EQ(keyframe.pose.T_map_camera.t, T_map_camera.t);
  EXPECT_EQ(keyframe.pose.T_map_camera.q.coeffs(), T_map_camera.q.coeffs());
  EXPECT_EQ(keyframe.pose.scale, 1.5);
  SqliteFile(path_, SqliteFile::Mode::kWrite).run("UPDATE keyframe SET is_vertex = 0, checksum = NULL WHERE id = 0");
  EXPECT_EQ(error(), "keyframe 0 has no vertex before it");
}

TEST_F(MapFile, OfAnOlderVersionIsRead) {
  const std::string of_4 =
      "CREATE TABLE old AS SELECT id, frame, stamp_ns, x, y, z, qx, qy, qz, qw, scale, vertex_from_keyframe "
      "FROM keyframe; DROP TABLE keyframe; ALTER TABLE old RENAME TO keyframe; ";
  const std::string of_3 = of_4 + "DROP TABLE merge; ", of_2 = of_3 + "DROP TABLE refused_loop; ";
  change(of_4 + "PRAGMA user_version = 4");
  const auto without_live = checked(read_map(path_, *shared_coco()));
  EXPECT_EQ(without_live->graph.keyframes[2].pose.T_map_camera.t, desk().graph.keyframes[2].pose.T_map_camera.t);
  EXPECT_FALSE(without_live->graph.keyframes[2].T_map_live.has_value());
  for (const std::string& changes : {of_3 + "PRAGMA user_version = 3", of_2 + "PRAGMA user_version = 2"}) {
    change(changes);
    EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), desk().graph.keyframes.size());
  }
  change(of_2 + "DROP TABLE points; PRAGMA user_version = 1");
  const auto read = read_map(path_, *shared_coco());
  ASSERT_TRUE(read) << read.message();
  EXPECT_EQ((*read)->graph.keyframes.size(), desk().graph.keyframes.size());
  EXPECT_TRUE((*read)->points.empty());
  change_body("edge", "/missed_covariance", std::vector<double>(36, 0.0));  // as good as not there
  const std::shared_ptr<const MapState> frozen = checked(read_map(path_, *shared_coco()));
  EXPECT_EQ(frozen->graph.edges[0].missed.frozen_s, 0.5);
  EXPECT_TRUE(frozen->graph.edges[0].missed.covariance.isApprox(0.075 * 0.075 * Mat6::Identity()));
}

TEST_F(MapFile, ABitThatChangedIsDamageOrOfNoMatter) {
  SqliteFile(path_, SqliteFile::Mode::kWrite).run("UPDATE keyframe SET x = x + 1e-9 WHERE id = 2");
  EXPECT_EQ(error(), "keyframe 2 is damaged: not what its checksum says");
  ASSERT_EQ(write_map(path_, desk(), *shared_coco()).message(), "");
  const std::string whole = read_whole(path_), dump = dump_of(path_);
  std::mt19937 random(5);
  int damaged = 0;
  for (int i = 0; i < 200; ++i) {
    std::string changed = whole;
    const std::uint32_t bit = 1U << random() % 8;
    char& byte = changed[random() % changed.size()];
    byte = static_cast<char>(byte ^ static_cast<char>(bit));
    directory_.write("map.db", changed);
    if (!read_map(path_, *shared_coco())) {
      ++damaged;
    } else {
      EXPECT_TRUE(dump_of(path_) == dump) << "not seen";
    }
  }
  EXPECT_GT(damaged, 150);
}

TEST_F(MapFile, NamesWhatIsWrong) {
  EXPECT_EQ(error_after("PRAGMA user_version = 9"), "is a map of version 9; this program reads 1 to 7");
  EXPECT_EQ(error_after("INSERT INTO points VALUES(0, 0, 0, x'78', NULL)"), "points 0 is damaged");
  EXPECT_EQ(error_after("PRAGMA application_id = 9"), "is no map of semantic_topo_loop");
  EXPECT_EQ(error_after("DELETE FROM meta WHERE key = 'noise'"), "meta has no 'noise'");
  EXPECT_EQ(error_after("UPDATE meta SET value = '{' WHERE key = 'noise'"), "meta 'noise' is damaged");
  EXPECT_EQ(error_after("UPDATE meta SET value = '\"far\"' WHERE key = 'next_frame'"),
            "meta 'next_frame' = \"far\" must be an integer");
  const std::string opened(200000, '['), closed(200000, ']');
  EXPECT_EQ(error_after("UPDATE meta SET value = '" + opened + closed + "' WHERE key = 'noise'"),
            "meta 'noise' is damaged");
  EXPECT_EQ(error_after("DROP TABLE edge"), "no such table: edge");
  EXPECT_EQ(error_after("UPDATE edge SET body = x'00' WHERE number = 3"), "edge 3 = 0 must be an object");
  EXPECT_EQ(error_after("UPDATE edge SET body = x'ff' WHERE number = 3"), "edge 3 is damaged");
  std::string arrays_in_arrays;
  for (int i = 0; i < 200000; ++i) arrays_in_arrays += "81";
  EXPECT_EQ(error_after("UPDATE edge SET body = x'" + arrays_in_arrays + "01' WHERE number = 3"), "edge 3 is damaged");
  EXPECT_EQ(error_after("UPDATE keyframe SET qw = 9.0 WHERE id = 2"), "keyframe 2 has no pose");
  EXPECT_EQ(error_after("UPDATE keyframe SET frame = 1000 WHERE id = 2"),
            "keyframe 2 is of frame 1000, but the next frame is 301");
  EXPECT_NE(error_after("DELETE FROM keyframe WHERE id = 2").find("edges do not join"), std::string::npos);
  EXPECT_EQ(error_after("UPDATE class SET name = 'spoke' WHERE name = 'cup'"),
            "class 41 is 'spoke' in the map and 'cup' in the class table");
  EXPECT_EQ(error_after("UPDATE class SET id = 1000 WHERE name = 'cup'"),
            "class 1000 ('cup') is no class that becomes a landmark in the class table");
}

TEST_F(MapFile, NamesTheFieldOfAPackedRow) {
  EXPECT_EQ(error_with("edge", "/path_m", nullptr), "edge 0.path_m = null must be a finite number");
  EXPECT_EQ(error_with("edge", "/T_from_to/6", 5.0), "edge 0.T_from_to holds a quaternion that is no rotation");
  EXPECT_EQ(error_with("loop", "/loop/to", 100000), "loop 0 joins vertices that are not there");
  EXPECT_EQ(error_with("loop", "/loop/from", -4294967296), "loop 0.loop.from = -4294967296 is out of range");
  EXPECT_EQ(error_with("loop", "/loop/covariance/0", 0.0), "loop 0 has a covariance that is not positive definite");
  const std::string of_edge = "edge 0 has a covariance that is not positive definite, or a negative path";
  EXPECT_EQ(error_with("edge", "/path_m", -1e3), of_edge);
  EXPECT_EQ(error_with("edge", "/missed_covariance/0", -1.0), of_edge);
  const std::string covariance = "loop 0 has a covariance that is not positive definite";
  EXPECT_EQ(error_with("loop", "/loop/covariance/0", -1.0), covariance);
  const std::string id = std::to_string(desk().objects.landmarks.front().state.id);
  EXPECT_EQ(error_with("object", "/state/state", 3), "object " + id + ".state.state = 3 is no state");
  EXPECT_EQ(error_with("object", "/state/ellipsoid", nullptr), "object " + id + " has no ellipsoid");
  EXPECT_EQ(error_with("object", "/seen_from/3", "far"),
            "object " + id + ".seen_from[3] = \"far\" must be a finite number");
  const std::string submap = "submap " + std::to_string(desk().submaps.front().frame_id);
  EXPECT_EQ(error_with("submap", "/objects/0/views/0/0", 100000), submap + ": a view has frame 100000, not there");
  EXPECT_EQ(error_with("submap", "/objects/0/class_id", 0), submap + ": an object has class 0");
  EXPECT_EQ(error_with("submap", "/check_frames/0", -1), submap + ": check_frames: -1 is no index of a frame");
  EXPECT_EQ(error_with("submap", "/frames/3/focal_px/0", 0.0), submap + ".frames[3] must have a focal_px > 0");
}

TEST_F(MapFile, NamesTheObservationThatIsWrong) {
  const std::string id = std::to_string(desk().objects.landmarks.front().state.id);
  const auto error = [&](const std::string& change, int number = 2) {
    return error_after("UPDATE observation SET " + change + " WHERE object = " + id +
                       " AND number = " + std::to_string(number));
  };
  const std::string name = "observation 2 of object " + id;
  EXPECT_EQ(error("truncated = 16"), name + ": truncated = 16 must be a sum of 1, 2, 4, 8");
  EXPECT_EQ(error("truncated = -1"), name + ": truncated = -1 must be a sum of 1, 2, 4, 8");
  EXPECT_EQ(error("qw = 3.0"), name + " has no pose");
  EXPECT_EQ(error("x = 9e999"), name + " has no pose");
  EXPECT_EQ(error("y2 = 9e999"), name + " has no box");
  EXPECT_EQ(error("class = 9999"), "an observation of object " + id + " has class 9999");
  EXPECT_EQ(error("number = 90000"), "observation 3 of object " + id + " does not follow the one before");
  EXPECT_EQ(error("object = 90000"), "observation 3 of object " + id + " does not follow the one before");
  EXPECT_EQ(error_after("DELETE FROM object WHERE id = " + id),
            "observation 0 of object " + id + ": there is no such object");
}

TEST_F(MapFile, WhatIsNewerThanTheGraphIsLeftOut) {
  const auto read_after = [this](const std::string& sql) {
    change(sql);
    return checked(read_map(path_, *shared_coco()));
  };
  const MappedLandmark& landmark = desk().objects.landmarks.front();
  const std::string id = std::to_string(landmark.state.id);
  const auto without_box = read_after("UPDATE observation SET frame = 301 WHERE number = 2 AND object = " + id);
  EXPECT_EQ(without_box->left_out, 1U);
  EXPECT_EQ(without_box->objects.landmarks.front().observations.size(), landmark.observations.size() - 1);
  const auto unseen = read_after("UPDATE observation SET keyframe = 777 WHERE object = " + id);
  EXPECT_EQ(unseen->left_out, landmark.observations.size());
  EXPECT_EQ(unseen->objects.landmarks.size(), desk().objects.landmarks.size() - 1);
  MapState later = desk();
  later.submaps.back().keyframe_id = 777;
  ASSERT_EQ(write_map(path_, later, *shared_coco()).message(), "");
  const auto without_submap = checked(read_map(path_, *shared_coco()));
  EXPECT_EQ(without_submap->left_out, 1U);
  EXPECT_EQ(without_submap->submaps.size(), desk().submaps.size() - 1);
}

/// Runs in a process of somebody who may not write to what may only be read, which root may.
/// @return whether it gave true
bool as_nobody(const std::function<bool()>& run) {
  const pid_t child = ::fork();
  if (child == 0) {
    constexpr uid_t kNobody = 65534;
    const bool is_nobody = ::geteuid() != 0 || (::setgid(kNobody) == 0 && ::setuid(kNobody) == 0);
    ::_exit(is_nobody && run() ? 0 : 1);
  }
  int status = 1;
  ::waitpid(child, &status, 0);
  return status == 0;
}

/// A map on a medium that is not written to.
class ReadOnlyMapFile : public MapFile {
 protected:
  using Permissions = std::filesystem::perms;
  ~ReadOnlyMapFile() override {
    std::error_code none;
    std::filesystem::permissions(folder_, Permissions::owner_all, none);
  }
  /// Files go into a folder, in which nothing can be written then.
  void keep(const std::vector<std::string>& files) {
    std::filesystem::permissions(directory_.path(""), Permissions::owner_all | Permissions::others_exec);
    std::filesystem::create_directory(folder_);
    constexpr auto kRead = Permissions::owner_read | Permissions::others_read;
    for (const std::string& file : files) {
      const std::string copy = folder_ + file.substr(file.rfind('/'));
      std::filesystem::copy_file(file, copy);
      std::filesystem::permissions(copy, kRead);
    }
    std::filesystem::permissions(folder_, kRead | Permissions::owner_exec | Permissions::others_exec);
  }
  /// A folder where everybody may write.
  std::string place_for_all() {
    const std::string folder = directory_.path("for all");
    std::filesystem::permissions(directory_.path(""), Permissions::owner_all | Permissions::others_exec);
    std::filesystem::create_directory(folder);
    std::filesystem::permissions(folder, Permissions::all);
    return folder;
  }
  const std::string folder_ = directory_.path("100% read?only");
  const std::string kept_ = folder_ + "/map.db";
};

TEST_F(ReadOnlyMapFile, IsRead) {
  keep({path_});
  EXPECT_TRUE(as_nobody([this] {
    const auto map = read_map(kept_, *shared_coco());
    std::ostringstream dump;
    return map && (*map)->submaps.size() == desk().submaps.size() && dump_map(kept_, dump) &&
           *link_loaded_map(kept_) == kept_;
  }));
  EXPECT_TRUE(as_nobody([this] { return write_map(kept_, desk(), *shared_coco()).message().find(kept_ + ": ") == 0; }));
  EXPECT_TRUE(read_whole(kept_) == read_whole(path_));
}

/// As on a medium that has no links: of files that are another user's, systems may allow none.
TEST_F(ReadOnlyMapFile, IsCopiedWhereItIsReplacedAndCannotBeLinked) {
  const std::string shared = place_for_all() + "/map.db";
  std::filesystem::copy_file(path_, shared);
  EXPECT_TRUE(as_nobody([&] {
    const auto loaded = link_loaded_map(shared);
    return loaded && *loaded != shared && loaded_map(*loaded) == shared && std::filesystem::remove(shared) &&
           (*read_map(*loaded, *shared_coco()))->submaps.size() == desk().submaps.size();
  }));
}

TEST_F(ReadOnlyMapFile, IsNoPlaceForAMapThoughItCanBeWrittenItself) {
  keep({path_});
  std::filesystem::permissions(kept_, Permissions::others_read | Permissions::others_write);
  EXPECT_TRUE(as_nobody([this] { return check_map_place(kept_).message().find(kept_) == 0; }));
}

/// As a writer that was killed leaves it.
TEST_F(ReadOnlyMapFile, IsReadThoughItWasNotClosed) {
  SqliteFile writer(path_, SqliteFile::Mode::kWrite);
  writer.run(
      "PRAGMA journal_mode = WAL; UPDATE meta SET value = '\"late\"', checksum = NULL WHERE key = 'configuration'");
  keep({path_});
  EXPECT_TRUE(as_nobody([this] {
    const auto map = read_map(kept_, *shared_coco());
    return map && (*map)->submaps.size() == desk().submaps.size();
  })) << "what is in the file";
  const std::string grown_map = place_for_all() + "/grown.db";
  EXPECT_TRUE(as_nobody([&] {
    ObjectSlam session({}, shared_coco());
    session.restore(desk());
    MapDatabase grown(grown_map, shared_coco(), {}, kept_);
    grown.write({session.take_delta()});
    return grown.close().message().empty();
  })) << "by the session that goes on with it, too";
  std::filesystem::permissions(folder_, Permissions::owner_all);
  std::filesystem::remove_all(folder_);
  keep({path_, path_ + "-wal"});
  EXPECT_TRUE(as_nobody([this] {
    return read_map(kept_, *shared_coco()).message() ==
           kept_ + ": its last part is in " + kept_ + "-wal, which is only read where files can be written beside it";
  }));
}

TEST_F(MapFile, DamagedAndMissingFilesAreErrors) {
  const std::string whole = read_whole(path_);
  for (const std::size_t size :
       {std::size_t{0}, std::size_t{10}, std::size_t{5000}, whole.size() / 2, whole.size() - 1}) {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << whole.substr(0, size);
    EXPECT_FALSE(error().empty()) << size;
  }
  std::ofstream(path_, std::ios::binary | std::ios::trunc) << "{\"format\": \"semantic_topo_loop submaps 1\"}";
  EXPECT_EQ(error(), "file is not a database");
  EXPECT_EQ(read_map(directory_.path("none.db"), *shared_coco()).message(),
            directory_.path("none.db") + ": cannot open the file");
  EXPECT_NE(write_map(directory_.path("no/such/folder.db"), desk(), *shared_coco()).message().find("no/such/folder.db"),
            std::string::npos);
}

TEST_F(MapFile, AFailureLeavesWhatWasThere) {
  const std::string before = read_whole(path_);
  const auto fail = [](const std::string& temporary) -> Status {
    std::ofstream(temporary) << "half";
    return Error{"no more space"};
  };
  EXPECT_EQ(replace_file(path_, fail).message(), "no more space");
  EXPECT_TRUE(read_whole(path_) == before);
}

}  // namespace
}  // namespace semantic_topo_loop::core
