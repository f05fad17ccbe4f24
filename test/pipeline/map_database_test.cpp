#include "semantic_topo_loop/io/map_database.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "io/map_tables.h"
#include "io/sqlite_file.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/text_file.h"
#include "support/package_config.h"
#include "support/simulated_run.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

using testing::ChainRun;

/// Laps round a desk with enough drift for corrections that move everything, and for merges.
const SimulatedSequence& laps() {
  static const SimulatedSequence sequence = [] {
    SimulationOptions options;
    options.trajectory.duration_s = 60.0;
    options.trajectory.lap_s = 20.0;
    options.trajectory.rate_hz = 10.0;
    options.drift.position_m = 0.6;
    options.drift.rotation_deg = 10.0;
    return checked(simulate(options, camera_fr2(), coco()));
  }();
  return sequence;
}

/// Every row but those of the names of classes, which stay when an object goes.
std::string rows_of(const std::string& path) {
  std::ostringstream text;
  EXPECT_EQ(dump_map(path, text).message(), "");
  std::istringstream lines(text.str());
  std::string rows;
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind("class ", 0) != 0) rows += line + '\n';
  }
  return rows;
}

void wait_for(const MapDatabase& database) {
  while (database.is_behind() && database.problem()) std::this_thread::sleep_for(std::chrono::microseconds(100));
}

/// Runs to image `end`, and tells the database twice a second.
void run_to(std::size_t end, ChainRun* run, SavePoints* save_points, MapDatabase* database) {
  while (run->done() < end) {
    const std::int64_t stamp_ns = run->next();
    if (save_points->is_due(stamp_ns)) database->write({run->slam().take_delta()});
  }
}

class MapDatabaseTest : public ::testing::Test {
 protected:
  TestDirectory directory_;
  const std::string path_ = directory_.path("map.db");
};

TEST_F(MapDatabaseTest, WhatIsWrittenBitByBitIsTheWholeMap) {
  ChainRun run(laps(), shared_coco());
  SavePoints save_points;
  MapDatabase database(path_, shared_coco());
  const auto expect_whole = [&](const std::string& written, const char* when) {
    const std::string whole = directory_.path("whole.db");
    ASSERT_EQ(write_map(whole, *run.slam().map(), *shared_coco()).message(), "");
    EXPECT_TRUE(rows_of(written) == rows_of(whole)) << when;
  };
  run_to(250, &run, &save_points, &database);
  database.write({run.slam().take_delta()});
  wait_for(database);
  expect_whole(path_, "while it grows");

  const std::string copy = directory_.path("copy.db");
  const MapCounts counts = checked(database.copy_to(copy));
  expect_whole(copy, "a copy");
  EXPECT_EQ(counts.sessions, 1);
  EXPECT_GT(counts.keyframes, 50);
  EXPECT_GT(counts.submaps, 3);
  EXPECT_EQ(checked(read_map(copy, *shared_coco()))->submaps.size(), static_cast<std::size_t>(counts.submaps));

  run_to(laps().odometry.size(), &run, &save_points, &database);
  run.end();
  database.write({run.slam().take_delta()});
  EXPECT_EQ(database.close().message(), "");
  expect_whole(path_, "at the end");
  EXPECT_GT(run.corrections(), 3) << "of the whole map, or nothing was rewritten";
  EXPECT_GT(run.merges(), 0);
  EXPECT_GT(run.slam().map()->refused.size(), 0U);
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->objects.merges.size(), run.merges());
  EXPECT_FALSE(std::filesystem::exists(path_ + "-wal")) << "it is one file then";
}

TEST_F(MapDatabaseTest, KilledAtAnyMomentTheLastSecondIsLostAtMost) {
  // Of the last frame that was through when the program went, in memory that outlives it.
  auto* last_ns = static_cast<std::atomic<std::int64_t>*>(
      ::mmap(nullptr, sizeof(std::atomic<std::int64_t>), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  ASSERT_NE(static_cast<void*>(last_ns), MAP_FAILED);
  std::mt19937 random(7);
  std::uniform_int_distribution<int> images(40, 590);
  std::uniform_int_distribution<int> instant_us(0, 20'000);
  const SimulatedSequence& sequence = laps();
  for (int i = 0; i < 12; ++i) {
    const auto end = static_cast<std::size_t>(images(random));
    last_ns->store(0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      ChainRun run(sequence, shared_coco());
      SavePoints save_points;
      MapDatabase database(path_, shared_coco());
      for (;;) {
        const std::int64_t stamp_ns = run.next();
        if (save_points.is_due(stamp_ns)) {
          wait_for(database);  // it has half a second on a robot
          database.write({run.slam().take_delta()});
        }
        last_ns->store(stamp_ns);
        if (run.done() == sequence.odometry.size()) ::_exit(0);
      }
    }
    while (last_ns->load() < sequence.odometry[end].stamp_ns) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::microseconds(instant_us(random)));
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);

    const auto map = read_map(path_, *shared_coco());
    ASSERT_TRUE(map) << map.message();
    const double lost_s = 1e-9 * static_cast<double>(last_ns->load() - (*map)->graph.sessions.back().end_ns);
    EXPECT_LE(lost_s, 1.0 + 0.1) << "half a second, and what was being written";
    ChainRun next(sequence, shared_coco(), SE3(), *map);
    for (int frame = 0; frame < 20; ++frame) next.next();
    EXPECT_EQ(next.slam().map()->graph.sessions.size(), 2U) << "the run goes on";
  }
  ::munmap(last_ns, sizeof(*last_ns));
}

TEST_F(MapDatabaseTest, PartsThatCameOverASocketAreTheSame) {
  ChainRun run(laps(), shared_coco());
  SavePoints save_points;
  {
    MapDatabase database(path_, shared_coco());
    while (run.done() < 150) {
      if (!save_points.is_due(run.next())) continue;
      const auto delta = run.slam().take_delta();
      const auto received = unpack_map_delta(pack(*delta));
      ASSERT_NE(received, nullptr);
      EXPECT_TRUE(pack(*received) == pack(*delta));
      database.write({received});
    }
    database.write({run.slam().take_delta()});
    EXPECT_EQ(database.close().message(), "");
  }
  ASSERT_EQ(write_map(directory_.path("whole.db"), *run.slam().map(), *shared_coco()).message(), "");
  EXPECT_TRUE(rows_of(path_) == rows_of(directory_.path("whole.db")));
  std::vector<std::uint8_t> bytes = pack(*run.slam().take_delta());
  bytes.resize(bytes.size() / 2);
  EXPECT_EQ(unpack_map_delta(bytes), nullptr);
  EXPECT_EQ(unpack_map_delta({}), nullptr);
}

TEST_F(MapDatabaseTest, PointsOfTheMapThatASessionGoesOnWithStay) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 60; ++i) run.next();
  const auto points_of = [](std::int64_t keyframe_id) {
    auto delta = std::make_shared<MapDelta>();
    const float height = static_cast<float>(keyframe_id);
    const KeyframePoints points{{{keyframe_id, {0.0F, height, 1.0F}}}, {{0.5F, height, 2.0F}}};
    delta->points = {{keyframe_id, std::make_shared<const KeyframePoints>(points)}};
    return delta;
  };
  const auto save = [&](MapDatabase* database, std::int64_t keyframe_id) {
    run.next();
    database->write({run.slam().take_delta(), points_of(keyframe_id)});
  };
  {
    MapDatabase database(path_, shared_coco());
    save(&database, 0);
    save(&database, 2);
  }
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->points.size(), 2U);
  // A program that was killed may leave those of a keyframe that the map never got.
  SqliteFile(path_, SqliteFile::Mode::kWrite)
      .run("INSERT INTO points SELECT 1000, sparse, semi_dense, body, checksum FROM points LIMIT 1");
  const auto whole = run.slam().map();
  const std::string old = directory_.path("old.db");
  ASSERT_EQ(write_map(old, *whole, *shared_coco()).message(), "");
  SqliteFile(old, SqliteFile::Mode::kWrite)
      .run(
          "ALTER TABLE keyframe ADD COLUMN vertex_from_keyframe; PRAGMA user_version = 1;"
          "DROP TABLE points; DROP TABLE refused_loop; DROP TABLE merge");
  for (const auto& [earlier, count] : {std::pair(path_, 3U), std::pair(old, 1U)}) {
    {
      ChainRun next(laps(), shared_coco(), {}, whole, 61);
      MapDatabase in_place(earlier, shared_coco(), {}, earlier);
      next.next();
      in_place.write({next.slam().take_delta(), points_of(1)});
      EXPECT_EQ(in_place.close().message(), "");
    }
    const auto map = checked(read_map(earlier, *shared_coco()));
    ASSERT_EQ(map->points.size(), count) << earlier;
    EXPECT_EQ(map->points[count / 2].keyframe_id, 1);
    EXPECT_EQ(map->left_out, 0U);
    EXPECT_EQ(SqliteFile(earlier, SqliteFile::Mode::kRead).number("SELECT count(*) FROM points"), count);
  }
}

TEST_F(MapDatabaseTest, KeyframesKeepWhereTheyWereToldToBeFirst) {
  ChainRun run(laps(), shared_coco());
  std::vector<SE3> told;
  double most_m = 0.0;
  while (run.done() < laps().odometry.size()) {
    const SE3 T_map_odom = run.slam().pose_graph().T_map_odom();
    const SE3& T_odom_camera = laps().odometry[run.done()].T_world_camera;
    run.next();
    if (run.slam().pose_graph().keyframes().size() > told.size()) told.push_back(T_map_odom * T_odom_camera);
  }
  ASSERT_EQ(write_map(path_, *run.slam().map(), *shared_coco()).message(), "");
  const auto map = checked(read_map(path_, *shared_coco()));
  ChainRun next(laps(), shared_coco(), {}, map, 100);
  next.next();
  const GraphState graph = next.slam().map()->graph;
  ASSERT_EQ(graph.keyframes.size(), told.size() + 1);
  for (std::size_t k = 0; k < told.size(); ++k) {
    ASSERT_TRUE(graph.keyframes[k].T_map_live.has_value());
    EXPECT_LT((graph.keyframes[k].T_map_live->t - told[k].t).norm(), 1e-12) << k;
    most_m = std::max(most_m, (graph.keyframes[k].pose.T_map_camera.t - told[k].t).norm());
  }
  EXPECT_GT(most_m, 0.1) << "nothing was corrected";
}

TEST_F(MapDatabaseTest, WhatEarlierSessionsRefusedStays) {
  ChainRun run(laps(), shared_coco());
  while (run.slam().loop_detector().refused().empty()) run.next();
  const auto whole = run.slam().map();
  const LoopFigures& refused = whole->refused.front();
  ASSERT_EQ(write_map(path_, *whole, *shared_coco()).message(), "");
  ChainRun next(laps(), shared_coco(), {}, checked(read_map(path_, *shared_coco())), run.done());
  MapDatabase in_place(path_, shared_coco(), {}, path_);
  next.next();
  in_place.write({next.slam().take_delta()});
  EXPECT_EQ(in_place.close().message(), "");
  const auto map = checked(read_map(path_, *shared_coco()));
  ASSERT_FALSE(map->refused.empty());
  EXPECT_EQ(map->refused.front().rms_m, refused.rms_m);
  const LoopExplanation why = next.slam().loop_detector().explain(refused.query_keyframe_id, refused.match_keyframe_id);
  EXPECT_EQ(why.status, PairStatus::kVerified);
  EXPECT_NE(why.text.find(to_string(refused.reason)), std::string::npos) << why.text;
}

TEST_F(MapDatabaseTest, WhatIsAcceptedLaterOrForgottenIsNotRefusedInTheFile) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 100; ++i) run.next();
  const auto decided = [](std::int64_t query, std::int64_t match, bool accepted) {
    LoopFigures loop;
    loop.query_keyframe_id = query;
    loop.match_keyframe_id = match;
    loop.accepted = accepted;
    return loop;
  };
  auto first = std::make_shared<MapDelta>(*run.slam().take_delta());
  first->submaps->decided = {decided(3, 0, false), decided(5, 1, false), decided(5, 2, false), decided(6, 1, false)};
  auto second = std::make_shared<MapDelta>();
  second->submaps.emplace();
  second->submaps->is_whole = false;
  second->submaps->decided = {decided(5, 2, true)};
  second->submaps->first_query = 4;
  MapDatabase database(path_, shared_coco());
  database.write({first});
  wait_for(database);
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->refused.size(), 4U);
  database.write({second});
  EXPECT_EQ(database.close().message(), "");
  const auto map = checked(read_map(path_, *shared_coco()));
  ASSERT_EQ(map->refused.size(), 2U);
  EXPECT_EQ(map->refused[0].query_keyframe_id, 5);
  EXPECT_EQ(map->refused[0].match_keyframe_id, 1);
  EXPECT_EQ(map->refused[1].query_keyframe_id, 6);
}

TEST_F(MapDatabaseTest, PointsLieOnTheObjectsTheyAreDeepestIn) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 100; ++i) run.next();
  const auto map = run.slam().map();
  MapPoints points;
  std::vector<std::int64_t> ids;
  for (const MappedLandmark& landmark : map->objects.landmarks) {
    if (landmark.state.state != LandmarkState::kConfirmed) continue;
    ids.push_back(landmark.state.id);
    points.sparse.push_back(landmark.state.ellipsoid->center().cast<float>());
  }
  ASSERT_GT(ids.size(), 3U);
  const Ellipsoid& first = *map->objects.landmarks.front().state.ellipsoid;
  const Vec3 up(0.0, 0.0, first.semi_axes.z());
  points.semi_dense = {(first.T_world_quadric * (1.05 * up)).cast<float>(),
                       (first.T_world_quadric * (1.15 * up)).cast<float>(), Eigen::Vector3f(0.0F, 0.0F, 1e4F)};
  ids.insert(ids.end(), {map->objects.landmarks.front().state.id, -1, -1});
  EXPECT_EQ(objects_under(points, *map), ids);
}

TEST_F(MapDatabaseTest, OneProgramWritesAtATime) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 20; ++i) run.next();
  {
    MapDatabase first(path_, shared_coco());
    first.write({run.slam().take_delta()});
    run.next();
    first.write({run.slam().take_delta()});
    wait_for(first);
    ASSERT_EQ(first.problem().message(), "");
    const std::string busy = path_ + ": is being written by another session or program";
    EXPECT_EQ(check_map_place(path_).message(), busy);
    ChainRun other(laps(), shared_coco());
    other.next();
    MapDatabase second(path_, shared_coco());
    second.write({other.slam().take_delta()});
    EXPECT_EQ(second.close().message(), busy);
  }
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), run.slam().map()->graph.keyframes.size());
  EXPECT_EQ(check_map_place(path_).message(), "");
}

TEST_F(MapDatabaseTest, AMapIsNotReplacedByOneThatLostAPartOfIt) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 200; ++i) run.next();
  const auto whole = run.slam().map();
  ASSERT_EQ(write_map(path_, *whole, *shared_coco()).message(), "");
  const std::string before = read_whole(path_);
  // Stages that did not take the map over, as one whose parameters are wrong.
  for (const char* lost : {"keyframe", "observation", "submap"}) {
    ChainRun next(laps(), shared_coco(), {}, whole, 200);
    next.next();
    auto delta = std::make_shared<MapDelta>(*next.slam().take_delta());
    if (lost == std::string("keyframe")) delta->graph = GraphDelta{true, {}};
    if (lost == std::string("observation")) delta->objects->changed.clear();
    if (lost == std::string("submap")) delta->submaps->added.clear();
    MapDatabase database(path_, shared_coco(), {}, path_);
    database.write({delta});
    EXPECT_NE(database.close().message().find(std::string("without any ") + lost), std::string::npos) << lost;
    EXPECT_TRUE(read_whole(path_) == before) << lost;
  }
}

TEST_F(MapDatabaseTest, AJournalThatWasLeftBehindIsNoPartOfTheNextMap) {
  ChainRun run(laps(), shared_coco());
  SavePoints save_points;
  {
    MapDatabase first(path_, shared_coco());
    run_to(100, &run, &save_points, &first);
    wait_for(first);
    // As a program that was killed leaves them, moved away without the journal.
    std::filesystem::copy_file(path_ + "-wal", directory_.path("wal"));
  }
  std::filesystem::remove(path_);
  std::filesystem::rename(directory_.path("wal"), path_ + "-wal");
  ChainRun other(laps(), shared_coco());
  for (int i = 0; i < 20; ++i) other.next();
  MapDatabase second(path_, shared_coco());
  second.write({other.slam().take_delta()});
  EXPECT_EQ(second.close().message(), "");
  const std::string whole = directory_.path("whole.db");
  std::filesystem::copy_file(path_ + "-wal~", whole + "-wal");
  ASSERT_EQ(write_map(whole, *other.slam().map(), *shared_coco()).message(), "");
  EXPECT_TRUE(rows_of(path_) == rows_of(whole));
}

TEST_F(MapDatabaseTest, WhatWasThereIsSetAsideOnceSomethingTakesItsPlace) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 20; ++i) run.next();
  ASSERT_EQ(write_map(path_, *run.slam().map(), *shared_coco()).message(), "");
  const std::string before = read_whole(path_);
  { const MapDatabase nothing_comes(path_, shared_coco(), {}, {}, true); }
  EXPECT_TRUE(read_whole(path_) == before);
  ChainRun other(laps(), shared_coco());
  other.next();
  MapDatabase next(path_, shared_coco(), {}, {}, true);
  next.write({other.slam().take_delta()});
  EXPECT_EQ(next.close().message(), "");
  EXPECT_TRUE(read_whole(path_ + "~") == before);
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), 1U);
}

TEST_F(MapDatabaseTest, WhatAnotherProgramWroteMeanwhileIsSetAside) {
  ChainRun run(laps(), shared_coco()), other(laps(), shared_coco());
  run.next();
  for (int i = 0; i < 20; ++i) other.next();
  MapDatabase late(path_, shared_coco());
  {
    MapDatabase early(path_, shared_coco());
    early.write({other.slam().take_delta()});
  }
  const std::string before = read_whole(path_);
  late.write({run.slam().take_delta()});
  EXPECT_EQ(late.close().message(), "");
  EXPECT_TRUE(read_whole(path_ + "~") == before);
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), 1U);
}

TEST_F(MapDatabaseTest, AMapThatDisappearsIsTold) {
  ChainRun run(laps(), shared_coco());
  run.next();
  MapDatabase database(path_, shared_coco());
  database.write({run.slam().take_delta()});
  wait_for(database);
  std::filesystem::remove(path_);
  run.next();
  database.write({run.slam().take_delta()});
  EXPECT_EQ(database.close().message(), path_ + ": is not there any more");
  EXPECT_FALSE(std::filesystem::exists(path_)) << "an empty one in its place";
}

TEST_F(MapDatabaseTest, AnotherFileThatTakesItsPlaceIsLeftAsItIs) {
  ChainRun foreign(laps(), shared_coco());
  foreign.next();
  const std::string other = directory_.path("other.db"), away = directory_.path("away.db");
  ASSERT_EQ(write_map(other, *foreign.slam().map(), *shared_coco()).message(), "");
  const std::string before = read_whole(other);
  for (const bool goes_first : {false, true}) {
    SCOPED_TRACE(goes_first);
    std::filesystem::remove(away);
    ChainRun run(laps(), shared_coco());
    SavePoints save_points;
    MapDatabase database(path_, shared_coco());
    run_to(60, &run, &save_points, &database);
    wait_for(database);
    std::filesystem::rename(path_, away);
    if (goes_first) {
      run_to(70, &run, &save_points, &database);
      wait_for(database);
    }
    std::filesystem::copy_file(other, path_);
    run_to(90, &run, &save_points, &database);
    EXPECT_EQ(database.close().message(), path_ + ": another file is there now");
    EXPECT_TRUE(read_whole(path_) == before);
    EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), 1U) << "with no journal of ours";
    EXPECT_GT(checked(read_map(away, *shared_coco()))->graph.keyframes.size(), 5U)
        << "what was written stays, by its new name";
    std::filesystem::remove(path_);
  }
}

TEST_F(MapDatabaseTest, WhatAKilledWriterLeftGoesAndNothingElse) {
  ChainRun run(laps(), shared_coco());
  run.next();
  const pid_t child = ::fork();
  if (child == 0) ::_exit(0);
  ::waitpid(child, nullptr, 0);
  const std::string dead = "map.db." + std::to_string(child) + "-4.tmp",
                    own = "map.db." + std::to_string(::getpid()) + "-99.tmp";
  for (const std::string& name : {dead, own, std::string("map.db.2024-11-30"), std::string("map.db.tmp")})
    directory_.write(name, "x");
  ASSERT_EQ(write_map(path_, *run.slam().map(), *shared_coco()).message(), "");
  EXPECT_FALSE(std::filesystem::exists(directory_.path(dead)));
  EXPECT_TRUE(std::filesystem::exists(directory_.path(own)));
  EXPECT_TRUE(std::filesystem::exists(directory_.path("map.db.2024-11-30")));
  EXPECT_TRUE(std::filesystem::exists(directory_.path("map.db.tmp")));
}

TEST_F(MapDatabaseTest, WhoReadsAtTheEndDoesNotMakeItAFailure) {
  ChainRun run(laps(), shared_coco());
  run.next();
  MapDatabase database(path_, shared_coco());
  database.write({run.slam().take_delta()});
  wait_for(database);
  run.next();
  database.write({run.slam().take_delta()});
  wait_for(database);
  {
    SqliteFile reader(path_, SqliteFile::Mode::kRead);
    SqliteStatement rows(&reader, "SELECT * FROM meta");
    ASSERT_TRUE(rows.next());
    EXPECT_EQ(database.close().message(), "");
  }
  EXPECT_EQ(check_map_place(path_).message(), "") << "the journal that was left is taken in";
  EXPECT_EQ(checked(read_map(path_, *shared_coco()))->graph.keyframes.size(), run.slam().map()->graph.keyframes.size());
}

TEST_F(MapDatabaseTest, ALoadedMapStaysThoughItsNameIsALink) {
  ChainRun run(laps(), shared_coco());
  run.next();
  ASSERT_EQ(write_map(directory_.path("site.db"), *run.slam().map(), *shared_coco()).message(), "");
  std::filesystem::create_symlink(directory_.path("site.db"), path_);
  const std::string loaded = checked(link_loaded_map(path_));
  const std::string before = read_whole(loaded);
  for (int i = 0; i < 20; ++i) run.next();
  ASSERT_EQ(write_map(path_, *run.slam().map(), *shared_coco()).message(), "");
  EXPECT_TRUE(read_whole(loaded) == before);
}

TEST_F(MapDatabaseTest, WhatIsSetAsideIsTheMapAndNotALinkToIt) {
  ChainRun run(laps(), shared_coco());
  run.next();
  const std::string site = directory_.path("site.db");
  ASSERT_EQ(write_map(site, *run.slam().map(), *shared_coco()).message(), "");
  const std::string before = read_whole(site);
  std::filesystem::create_symlink(site, path_);
  MapDatabase database(path_, shared_coco(), {}, {}, true);
  for (int i = 0; i < 2; ++i) {
    run.next();
    database.write({run.slam().take_delta()});
  }
  EXPECT_EQ(database.close().message(), "");
  EXPECT_TRUE(read_whole(site + "~") == before);
  EXPECT_TRUE(std::filesystem::is_symlink(path_));
  EXPECT_EQ(rows_of(path_), rows_of(site));
  EXPECT_EQ(checked(read_map(site, *shared_coco()))->graph.sessions.size(), 1U);
}

TEST_F(MapDatabaseTest, AMapIsNotReadWithoutItsJournal) {
  directory_.write("map.db", "what a disk left of a map");
  EXPECT_TRUE(link_loaded_map(path_));
  directory_.write("map.db-wal", "what was written last");
  EXPECT_EQ(link_loaded_map(path_).message(), path_ + ": file is not a database");
}

TEST_F(MapDatabaseTest, AMapHasNoPlaceWhereThereIsNoFolder) {
  const std::string place = directory_.path("no/such/map.db");
  EXPECT_NE(check_map_place(place).message().find(place), std::string::npos) << check_map_place(place).message();
}

TEST_F(MapDatabaseTest, ACopyDoesNotTakeThePlaceOfTheMapItself) {
  ChainRun run(laps(), shared_coco());
  run.next();
  MapDatabase database(path_, shared_coco());
  EXPECT_EQ(database.copy_to(directory_.path("copy.db")).message(), path_ + ": nothing is written yet");
  database.write({run.slam().take_delta()});
  wait_for(database);
  std::filesystem::create_symlink(path_, directory_.path("link.db"));
  for (const std::string& place : {path_, path_ + "-wal", directory_.path("link.db")}) {
    EXPECT_EQ(database.copy_to(place).message(), place + ": is a file of the map that is being written");
  }
  EXPECT_EQ(checked(database.copy_to(directory_.path("copy.db"))).sessions, 1);
}

TEST_F(MapDatabaseTest, WhoGoesOnWithAMapHoldsItByANameOfHisOwn) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 50; ++i) run.next();
  ASSERT_EQ(write_map(path_, *run.slam().map(), *shared_coco()).message(), "");
  const pid_t gone = ::fork();
  ASSERT_GE(gone, 0);
  if (gone == 0) ::_exit(0);
  ::waitpid(gone, nullptr, 0);
  const std::string left = path_ + ".loaded-" + std::to_string(gone) + "-1", others = path_ + ".loaded-1-1";
  for (const std::string& link : {left, others}) std::filesystem::create_hard_link(path_, link);
  const std::string first = checked(link_loaded_map(path_)), second = checked(link_loaded_map(path_));
  EXPECT_NE(first, second);
  for (const std::string& link : {first, second}) EXPECT_TRUE(is_same_file(link, path_)) << link;
  EXPECT_FALSE(std::filesystem::exists(left)) << "of a program that was killed";
  EXPECT_TRUE(std::filesystem::exists(others)) << "of one that runs";
  std::filesystem::remove(first);
  EXPECT_TRUE(read_map(second, *shared_coco()));
}

TEST_F(MapDatabaseTest, SeveralMayCloseAtOnce) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 100; ++i) run.next();
  MapDatabase database(path_, shared_coco());
  database.write({run.slam().take_delta()});
  std::thread other([&database] { EXPECT_EQ(database.close().message(), ""); });
  EXPECT_EQ(database.close().message(), "");
  other.join();
  EXPECT_EQ(check_map_place(path_).message(), "");
}

TEST_F(MapDatabaseTest, EdgesAndLoopsThatTheGraphHasNoMoreGo) {
  ChainRun run(laps(), shared_coco());
  for (int i = 0; i < 400; ++i) run.next();
  const auto whole = run.slam().take_delta();
  ASSERT_GT(whole->graph->state.edges.size(), 10U);
  ASSERT_GT(whole->graph->state.loops.size(), 1U);
  auto less = std::make_shared<MapDelta>(*run.slam().take_delta());
  EXPECT_FALSE(less->graph->is_whole);
  less->graph->state.edges.resize(10);
  less->graph->state.loops.resize(1);
  MapDatabase database(path_, shared_coco());
  for (const auto& delta : {whole, std::shared_ptr<const MapDelta>(less)}) {
    database.write({delta});
    wait_for(database);
  }
  EXPECT_EQ(database.close().message(), "");
  SqliteFile file(path_, SqliteFile::Mode::kRead);
  EXPECT_EQ(file.number("SELECT count(*) FROM edge"), 10);
  EXPECT_EQ(file.number("SELECT count(*) FROM loop"), 1);
  EXPECT_EQ(file.number("SELECT count(*) FROM keyframe"),
            static_cast<std::int64_t>(whole->graph->state.keyframes.size()));
}

TEST_F(MapDatabaseTest, WhatIsReplacedStaysBesideItWhereThatIsAskedFor) {
  const auto rows = [](const std::string& path) {
    std::ostringstream text;
    EXPECT_EQ(dump_map(path, text).message(), "");
    return text.str();
  };
  MapDatabase database(path_, shared_coco());
  directory_.write("map.db~-wal", "of a map that is no more");
  std::vector<std::string> before;
  for (const int frames : {50, 20, 10}) {
    ChainRun run(laps(), shared_coco());
    for (int i = 0; i < frames; ++i) run.next();
    database.write({run.slam().take_delta()}, !before.empty());
    wait_for(database);
    before.push_back(rows(path_));
  }
  EXPECT_EQ(database.close().message(), "");
  EXPECT_EQ(rows(path_ + "~"), before[0]);
  EXPECT_EQ(rows(path_ + "~2"), before[1]);
  EXPECT_EQ(rows(path_), before[2]);
  EXPECT_LT(before[1].size(), before[0].size());
  EXPECT_FALSE(std::filesystem::exists(path_ + "~3"));
}

TEST_F(MapDatabaseTest, OfGraphsThatWaitOnlyTheLastIsKeptWithWhatIsNewInThoseBefore) {
  ChainRun run(laps(), shared_coco());
  MapDatabase::Parts waiting;
  for (int i = 0; i < 3; ++i) {
    for (int frame = 0; frame < 30; ++frame) run.next();
    append({run.slam().take_delta()}, &waiting);
  }
  ASSERT_EQ(waiting.size(), 3U);
  EXPECT_FALSE(waiting[0]->graph || waiting[1]->graph);
  EXPECT_TRUE(waiting[0]->objects && waiting[1]->objects && waiting[2]->graph);
  EXPECT_TRUE(waiting[2]->graph->is_whole);
  const std::vector<GraphKeyframe> all = run.slam().map()->graph.keyframes, &told = waiting[2]->graph->state.keyframes;
  ASSERT_EQ(told.size(), all.size());
  for (std::size_t k = 0; k < all.size(); ++k) {
    EXPECT_EQ(told[k].pose.keyframe_id, all[k].pose.keyframe_id);
    EXPECT_EQ(told[k].pose.T_map_camera.t, all[k].pose.T_map_camera.t);
  }
  run.next();
  EXPECT_LT(run.slam().take_delta()->graph->state.keyframes.size(), 2U);
}

TEST_F(MapDatabaseTest, WhatIsNoMapStaysAsItIs) {
  ChainRun run(laps(), shared_coco());
  run.next();
  const std::string path = directory_.write("notes.txt", std::string(1000, 'x'));
  MapDatabase database(path, shared_coco());
  database.write({run.slam().take_delta()});
  EXPECT_NE(database.close().message().find("notes.txt: file is not a database"), std::string::npos);
  EXPECT_NE(write_map(path, *run.slam().map(), *shared_coco()).message().find("is not a database"), std::string::npos);
  EXPECT_EQ(read_whole(path), std::string(1000, 'x'));
}

TEST_F(MapDatabaseTest, AConfigurationMayHoldAnyBytes) {
  ChainRun run(laps(), shared_coco());
  run.next();
  MapDatabase database(path_, shared_coco(), "names: caf\xE9/names.txt");
  database.write({run.slam().take_delta()});
  EXPECT_EQ(database.close().message(), "");
  EXPECT_NE(checked(read_map(path_, *shared_coco()))->configuration.find("/names.txt"), std::string::npos);
}

TEST_F(MapDatabaseTest, WhatAFullDiskRefusesIsWrittenOnceThereIsRoom) {
  const pid_t child = ::fork();  // a limit of the whole process
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    ChainRun run(laps(), shared_coco());
    SavePoints save_points;
    MapDatabase database(path_, shared_coco());
    run_to(100, &run, &save_points, &database);
    wait_for(database);
    rlimit limit{};
    ::getrlimit(RLIMIT_FSIZE, &limit);
    limit.rlim_cur = 100'000;
    ::setrlimit(RLIMIT_FSIZE, &limit);
    run_to(300, &run, &save_points, &database);
    wait_for(database);
    if (database.problem().message().find(path_ + ": ") != 0) ::_exit(1);
    limit.rlim_cur = limit.rlim_max;
    ::setrlimit(RLIMIT_FSIZE, &limit);
    run_to(350, &run, &save_points, &database);
    database.write({run.slam().take_delta()});
    if (!database.close()) ::_exit(2);
    if (!write_map(directory_.path("whole.db"), *run.slam().map(), *shared_coco())) ::_exit(3);
    ::_exit(rows_of(path_) == rows_of(directory_.path("whole.db")) ? 0 : 4);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
