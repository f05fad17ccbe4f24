#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "pipeline/map_state.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "support/program_test.h"
#include "support/simulated_run.h"
#include "support/test_fixtures.h"
#include "support/tiny_yolo.h"
#include "tools/evaluation/trajectory_evaluation.h"
#include "tools/g2o/g2o.h"
#include "tools/rendering/rgbd_sequence.h"

namespace semantic_topo_loop::core {
namespace {

class OfflineProgram : public ProgramTest {
 protected:
  OfflineProgram() : ProgramTest(STL_PROGRAM_DIR "/offline") {}

  void expect_bad_arguments(const std::string& arguments, const std::string& part) {
    EXPECT_EQ(run("--camera @camera.yaml --output @run --classes " STL_CONFIG_DIR "/classes_coco.yaml " + arguments),
              2);
    expect_one_line_error("offline: error: " + part + " (see --help)");
  }
};

TEST_F(OfflineProgram, HelpAndParametersAreNoErrors) {
  EXPECT_EQ(run("--trajectory --help"), 0);
  EXPECT_EQ(out_.find("usage: offline --trajectory FILE"), 0u);
  EXPECT_NE(out_.find("Exit status: 0 done"), std::string::npos);
  EXPECT_EQ(run("--list-parameters"), 0);
  EXPECT_NE(out_.find("| `loop.mode` | graph |"), std::string::npos);
  expect_failure("--list-parameters loop", 2, "unrecognised argument 'loop'");
}

TEST_F(OfflineProgram, ArgumentsThatDoNotFitAreOneClearError) {
  expect_failure("", 2, "the option '--camera' is required but missing");
  const std::string no_source = "one of the arguments --trajectory, --rgbd and --bag is needed";
  expect_bad_arguments("", no_source);
  expect_bad_arguments("--rgbd @ --bag @b.bag", no_source);
  expect_bad_arguments("--trajectory @t.txt", "argument --detections is missing");
  expect_bad_arguments("--bag @b.bag --associations @a.txt", "argument --associations needs --rgbd");
  expect_bad_arguments("--trajectory @t.txt --detections @d.json --points a.ply",
                       "argument --points needs --rgbd or --bag");
  expect_bad_arguments("--bag @b.bag --frozen", "argument --frozen needs --map");
  expect_bad_arguments("--rgbd @ --points a.obj",
                       "the argument ('a.obj') for option '--points' must be a path that ends in .ply or .pcd");
}

TEST_F(OfflineProgram, FilesThatAreMissingAreOneClearError) {
  expect_failure("--rgbd @ --camera @none.yaml --output @run --classes " STL_CONFIG_DIR "/classes_coco.yaml", 1,
                 "none.yaml: cannot open the file");
  EXPECT_EQ(err_.find("--help"), std::string::npos);
}

class DetectProgram : public ProgramTest {
 protected:
  DetectProgram() : ProgramTest(STL_PROGRAM_DIR "/detect") {}
  const std::string classes_ = " --classes " STL_CONFIG_DIR "/classes_coco.yaml";
};

TEST_F(DetectProgram, WhatDoesNotFitIsOneClearError) {
  directory_.write("text.onnx", "no model\n");
  expect_failure("@ @text.onnx @d.json" + classes_, 1, "text.onnx: cannot be read as an ONNX model: ");
  expect_failure("@ @text.onnx @d.json --set detector.score=2" + classes_, 1, "detector.score");
  expect_failure("@ @text.onnx @d.json --set loop.mode=paper" + classes_, 1, "loop.mode");
  expect_failure("@ @text.onnx" + classes_, 2, "OUT.json");
}

TEST_F(DetectProgram, ADirectoryIsNoPlaceForTheBoxes) {
  directory_.write("tiny.onnx", testing::TinyYolo().onnx());
  std::filesystem::create_directories(directory_.path("results"));
  expect_failure("@ @tiny.onnx @results" + classes_, 1, "results: is a directory, not a file");
  expect_failure("@ @tiny.onnx @results/" + classes_, 1, "results/' is no name of a file");
  expect_failure("@ @tiny.onnx @tiny.onnx" + classes_, 1, "tiny.onnx: would take the place of the input");
}

/// The images of a TUM folder from `begin_s` after its first one on, in a folder of their own.
void write_part(const std::string& recording, double begin_s, double end_s, const std::string& name,
                const TestDirectory& directory) {
  double first_s = 0.0;
  for (const char* images : {"rgb", "depth"}) {
    std::istringstream list(read_whole(recording + "/" + images + ".txt"));
    std::string part;
    for (std::string line; std::getline(list, line);) {
      if (line.empty() || line.front() == '#') continue;
      const double stamp_s = std::stod(line);
      if (first_s == 0.0) first_s = stamp_s;
      if (stamp_s >= first_s + begin_s && stamp_s < first_s + end_s) part += line + '\n';
    }
    directory.write(name + "/" + images + ".txt", part);
    std::filesystem::create_directory_symlink(recording + "/" + images, directory.path(name + "/" + images));
  }
}

/// A real network on the first of real images: the boxes that `detect` writes are those that `offline` finds.
TEST_F(DetectProgram, WritesWhatOfflineFinds) {
  const auto model = shared_detector(), recording = shared_folder("tum/fr1_xyz", "rgb.txt");
  if (!model) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set, or OpenCV too old";
  write_part(*recording, 0.0, 1.0, "tum", directory_);
  ASSERT_EQ(run("@tum " + *model + " @d.json --set detector.rate_hz=10" + classes_), 0) << err_;
  EXPECT_EQ(out_.find("11 images, "), 0U) << out_;
  ASSERT_EQ(run("@tum " + *model + " @d.json" + classes_), 0) << err_;
  program_ = STL_PROGRAM_DIR "/offline";
  const std::string arguments =
      "--rgbd @tum --set depth.scale=5000 --camera " STL_CONFIG_DIR "/camera/tum_fr1.yaml" + classes_;
  ASSERT_EQ(run(arguments + " --detections @d.json --output @recorded"), 0) << err_;
  ASSERT_EQ(run(arguments + " --detector " + *model + " --output @found"), 0) << err_;
  EXPECT_EQ(err_.find("frames have no detections"), std::string::npos) << err_;
  const std::string found = read_whole(directory_.path("found/associations.csv"));
  EXPECT_GT(std::count(found.begin(), found.end(), '\n'), 60);
  EXPECT_EQ(found, read_whole(directory_.path("recorded/associations.csv")));
  ASSERT_EQ(run(arguments + " --detector " + *model + " --set detector.rate_hz=10 --output @some"), 0) << err_;
  EXPECT_NE(err_.find("frames have no detections"), std::string::npos) << err_;
  EXPECT_EQ(run(arguments + " --detections @d.json --detector " + *model + " --output @both"), 1);
  EXPECT_NE(err_.find("there are both --detections and detector.model"), std::string::npos) << err_;
}

TEST_F(DetectProgram, LeavesOutAnImageThatCannotBeRead) {
  directory_.write("tiny.onnx", testing::TinyYolo().onnx());
  const std::string missing = "3.0 rgb/missing.png\n";
  directory_.write("tum/rgb.txt", "1.0 rgb/first.png\n2.0 rgb/second.png\n" + missing);
  std::filesystem::create_directories(directory_.path("tum/rgb"));
  cv::Mat image(120, 160, CV_8UC3, cv::Scalar::all(90));
  cv::imwrite(directory_.path("tum/rgb/first.png"), image);
  image(cv::Rect(20, 30, 60, 40)).setTo(cv::Scalar(255, 0, 0));
  cv::imwrite(directory_.path("tum/rgb/second.png"), image);
  ASSERT_EQ(run("@tum @tiny.onnx @d.json" + classes_), 0) << err_;
  EXPECT_NE(err_.find("1 images left out (first: "), std::string::npos) << err_;
  EXPECT_NE(err_.find("missing.png"), std::string::npos) << err_;
  EXPECT_EQ(out_.find("2 images, 1 boxes in "), 0U) << out_;
  directory_.write("tum/rgb.txt", missing);
  expect_failure("@tum @tiny.onnx @none.json" + classes_, 1, "no image can be read (first: ");
}

/// While most of what is on the desk is cut by the image border: four or five objects, and surfaces, tell the place.
TEST_F(OfflineProgram, FindsItsPlaceInTheMapOfAnotherRunByObjectsAndSurfaces) {
  const auto recording = shared_folder("tum/fr1_xyz", "rgb.txt");
  if (!recording) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  write_part(*recording, 0.0, 13.3, "first", directory_);
  write_part(*recording, 16.0, 26.0, "second", directory_);
  const std::string source = " --set depth.scale=5000 --camera " STL_CONFIG_DIR
                             "/camera/tum_fr1.yaml --classes " STL_CONFIG_DIR "/classes_coco.yaml --detections " +
                             *recording + "/detections_yolox_nano.json";
  ASSERT_EQ(run("--rgbd @first --output @one --save-map @map.db" + source), 0) << err_;
  EXPECT_EQ(run("--rgbd @second --output @two --frozen --map @map.db --save-map @map.db" + source), 1);
  EXPECT_NE(err_.find("map.db: is the frozen map, which stays as it is"), std::string::npos) << err_;
  ASSERT_EQ(run("--rgbd @second --output @two --frozen --map @map.db" + source), 0) << err_;
  const nlohmann::json found = nlohmann::json::parse(read_whole(directory_.path("two/summary.json")))["relocalisation"];
  ASSERT_TRUE(found.is_object());
  EXPECT_GT(found["agreeing"], 20);
  EXPECT_EQ(found["agreeing"], found["accepted"]);
  const std::vector<double> p = found["earlier_map_from_odom"];
  const SE3 T_map_odom(Quaternion(p[6], p[3], p[4], p[5]), {p[0], p[1], p[2]});
  StampedPoses poses = checked(read_tum_trajectory(directory_.path("one/trajectory.txt")));
  for (const StampedPose& pose : checked(read_tum_trajectory(directory_.path("two/trajectory.txt")))) {
    poses.push_back({pose.stamp_ns, T_map_odom * pose.T_world_camera});
  }
  const StampedPoses mocap = checked(read_tum_ground_truth(*recording + "/groundtruth.txt"));
  EXPECT_LT(checked(evaluate_trajectory(poses, mocap)).absolute_m.rmse, 0.025);

  // As a session of the map, in which it has its place at once.
  ASSERT_EQ(run("--rgbd @second --output @three --map @map.db --save-map @both.db" + source), 0) << err_;
  EXPECT_EQ(out_.find("joined the earlier map after "), out_.rfind("joined")) << out_;
  const nlohmann::json joined = nlohmann::json::parse(read_whole(directory_.path("three/summary.json")))["joined_map"];
  ASSERT_TRUE(joined.is_object());
  EXPECT_LT(joined["after_s"], 10.0);
  EXPECT_GT(joined["loops"], 20);
  poses = checked(read_tum_trajectory(directory_.path("one/trajectory.txt")));
  const StampedPoses second = checked(read_tum_trajectory(directory_.path("three/trajectory.txt")));
  poses.insert(poses.end(), second.begin(), second.end());
  EXPECT_LT(checked(evaluate_trajectory(poses, mocap)).absolute_m.rmse, 0.02);

  // What self-calibration found for the map holds for its sessions.
  write_part(*recording, 16.0, 17.0, "third", directory_);
  MapState map = *checked(read_map(directory_.path("map.db"), coco()));
  const double stated = map.objects.camera.fx, corrected = 1.02 * stated;
  map.objects.camera.fx = corrected;
  map.objects.camera.fy *= 1.02;
  ASSERT_EQ(write_map(directory_.path("map.db"), map, coco()).message(), "");
  for (const bool takes_over : {true, false}) {
    const std::string setting = takes_over ? "" : " --set frontend.self_calibration=false";
    ASSERT_EQ(run("--rgbd @third --output @three --map @map.db --save-map @both.db" + source + setting), 0) << err_;
    const auto both = checked(read_map(directory_.path("both.db"), coco()));
    EXPECT_EQ(both->objects.camera.fx, takes_over ? corrected : stated);
  }
}

/// Mean of the points of a PLY file, of four floats each.
Vec3 mean_point(const std::string& path) {
  const std::string text = read_whole(path), header_end = "end_header\n";
  const std::size_t begin = text.find(header_end) + header_end.size(), count = (text.size() - begin) / 16;
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    Eigen::Vector3f point;
    std::memcpy(point.data(), &text[begin + 16 * i], sizeof(float) * 3);
    sum += point.cast<double>();
  }
  return sum / static_cast<double>(count);
}

TEST_F(OfflineProgram, PointsFollowTheCorrection) {
  const SimulationOptions options = simulation_test::options_of(
      {{"trajectory.duration_s", "4"}, {"trajectory.rate_hz", "10"}, {"scene.layout", "desk"}});
  SimulatedSequence sequence = checked(simulate(options, {256.0, 256.0, 160.0, 120.0, 320, 240, {}}, coco()));
  ASSERT_EQ(render_sequence(options, coco(), 1, directory_.path("in"), &sequence).message(), "");
  ASSERT_EQ(write_sequence(sequence, coco(), directory_.path("in")).message(), "");
  const std::string source =
      "--rgbd @in --camera @in/camera.yaml --detections @in/detections.json --classes " STL_CONFIG_DIR
      "/classes_coco.yaml ";
  ASSERT_EQ(run(source + "--output @plain --points @plain.ply"), 0) << err_;
  const std::vector<KeyframePose> keyframes = checked(read_keyframes(directory_.path("plain/keyframes.csv")));
  ASSERT_GT(keyframes.size(), 6U);

  // In the middle the camera is said to be half a metre off, by a loop that outweighs the odometry.
  const KeyframePose& query = keyframes[keyframes.size() / 2];
  LoopClosure loop;
  loop.accepted = true;
  loop.query_frame = query.frame_id;
  loop.match_frame = keyframes[0].frame_id;
  loop.T_match_query =
      SE3(Quaternion::Identity(), {0.5, 0.0, 0.0}) * keyframes[0].T_map_camera.inverse() * query.T_map_camera;
  loop.covariance = Mat6(1e-6 * Mat6::Identity());
  ASSERT_EQ(write_given_loops(directory_.path("loops.csv"), {loop}).message(), "");
  ASSERT_EQ(run(source + "--output @moved --points @moved.ply --extra-loops @loops.csv --set pose_graph.robust=none"),
            0)
      << err_;
  const std::vector<KeyframePose> moved = checked(read_keyframes(directory_.path("moved/keyframes.csv")));
  EXPECT_NEAR((moved.back().T_map_camera.t - keyframes.back().T_map_camera.t).norm(), 0.5, 0.1);
  const double shift_m = (mean_point(directory_.path("moved.ply")) - mean_point(directory_.path("plain.ply"))).norm();
  EXPECT_GT(shift_m, 0.15);
  EXPECT_LT(shift_m, 0.5);
  // What they cannot be written to keeps nothing else from being written.
  std::filesystem::create_symlink("/dev/full", directory_.path("full.ply"));
  EXPECT_EQ(run(source + "--output @kept --points @full.ply"), 1);
  EXPECT_EQ(checked(read_keyframes(directory_.path("kept/keyframes.csv"))).size(), keyframes.size());
}

class OfflineRun : public OfflineProgram {
 protected:
  OfflineRun() {
    directory_.write("t.txt", "1.0 0 0 0 0 0 0 1\n1.1 0.1 0 0 0 0 0 1\n");
    directory_.write("d.json", R"([{"file_name": "1.0.png", "detections": []}])");
    directory_.write("file", "");
    std::filesystem::create_symlink("loop", directory_.path("loop"));
  }
  static std::string with(const std::string& detections, const std::string& output) {
    return "--trajectory @t.txt --detections @" + detections +
           " --camera " STL_CONFIG_DIR "/camera/tum_fr2.yaml --classes " STL_CONFIG_DIR
           "/classes_coco.yaml --output @" +
           output;
  }
};

TEST_F(OfflineRun, OutputThatCannotBeWrittenIsOneClearErrorBeforeTheRun) {
  ASSERT_EQ(run(with("d.json", "run")), 0) << err_;
  expect_failure(with("d.json", "file/run"), 1, "file/run");
  expect_failure(with("d.json", "loop"), 1, "loop");
  expect_failure(with("d.json", std::string(300, 'x')), 1, "xxx");
  expect_failure(with("d.json", "run") + " --save-map @file/map.db", 1, "file/map.db");
  std::filesystem::create_directories(directory_.path("taken/.writable/in the way"));
  expect_failure(with("d.json", "taken"), 1, "taken");
}

TEST_F(OfflineRun, PaperModeHasNoMap) {
  for (const std::string option : {"--map", "--save-map"}) {
    expect_failure(with("d.json", "run") + " --set loop.mode=paper " + option + " @map.db", 1,
                   "argument " + option + " = '" + directory_.path("map.db") + "' needs loop.mode = graph");
  }
}

TEST_F(OfflineRun, NoInputIsReplacedByResults) {
  ASSERT_EQ(run(with("d.json", "run")), 0) << err_;
  for (const auto& entry : std::filesystem::directory_iterator(directory_.path("run"))) {
    EXPECT_FALSE(check_survives_run(entry.path(), directory_.path("run"))) << entry.path();
  }
  directory_.write("own/trajectory.txt", "1.0 0 0 0 0 0 0 1\n1.1 0.1 0 0 0 0 0 1\n");
  const std::string before = read_whole(directory_.path("own/trajectory.txt"));
  std::filesystem::remove(directory_.path("t.txt"));
  std::filesystem::create_symlink("own/trajectory.txt", directory_.path("t.txt"));
  expect_failure(with("d.json", "own"), 1, "t.txt: the run's results would take its place");
  EXPECT_EQ(read_whole(directory_.path("own/trajectory.txt")), before);
}

TEST_F(OfflineRun, DetectionsOfAnotherRecordingLeaveTheMapThatIsThere) {
  ASSERT_EQ(run(with("d.json", "run") + " --save-map @map.db"), 0) << err_;
  const std::string before = read_whole(directory_.path("map.db"));
  directory_.write("other.json", R"([{"file_name": "7.0.png", "detections": []}])");
  expect_failure(with("other.json", "run") + " --save-map @map.db", 1, "no detection has the stamp of a pose");
  EXPECT_TRUE(read_whole(directory_.path("map.db")) == before);
}

TEST_F(OfflineRun, NumbersThatNothingHoldsAreOneClearError) {
  directory_.write("huge.json", R"([{"file_name": "1.0.png", "detections": [{"category_id": 41, "detection_score": )"
                                R"(1e999, "bbox": [1, 2, 30, 40]}]}])");
  EXPECT_EQ(run(with("huge.json", "run")), 1);
  expect_one_line_error("offline: error: ");
}

/// What a map is asked for.
class InspectMapProgram : public ProgramTest {
 protected:
  InspectMapProgram() : ProgramTest(STL_PROGRAM_DIR "/inspect_map") {
    const SimulationOptions options = simulation_test::options_of(
        {{"trajectory.duration_s", "30"}, {"trajectory.rate_hz", "10"}, {"scene.layout", "desk"}});
    const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
    const auto map = testing::map_of(sequence, 0, sequence.odometry.size(), shared_coco());
    EXPECT_EQ(write_map(directory_.path("map.db"), *map, coco()).message(), "");
  }
  const std::string classes_ = " --classes " STL_CONFIG_DIR "/classes_coco.yaml";
};

TEST_F(InspectMapProgram, CountsAndExports) {
  ASSERT_EQ(run("@map.db --objects @o.json --trajectory @t.txt --live @l.txt --graph @g.g2o" + classes_), 0) << err_;
  EXPECT_EQ(out_.find("integrity   ok\nsessions    1\n"), 0U) << out_;
  const nlohmann::json objects = nlohmann::json::parse(read_whole(directory_.path("o.json")));
  ASSERT_GT(objects.size(), 5U);
  EXPECT_GE(objects[0]["classes"][std::string(objects[0]["label"])], 1);
  const std::size_t keyframes = checked(read_tum_trajectory(directory_.path("t.txt"))).size();
  EXPECT_NE(out_.find("keyframes   " + std::to_string(keyframes) + "\n"), std::string::npos) << out_;
  const StampedPoses live = checked(read_tum_trajectory(directory_.path("l.txt")));
  ASSERT_EQ(live.size(), keyframes);
  EXPECT_GT(
      (live.back().T_world_camera.t - checked(read_tum_trajectory(directory_.path("t.txt"))).back().T_world_camera.t)
          .norm(),
      0.0);
  const G2oGraph graph = checked(read_g2o(directory_.path("g.g2o"), nullptr));
  EXPECT_EQ(graph.vertices.size(), keyframes);
  EXPECT_GT(graph.edges.size(), keyframes);  // loops, too
  ASSERT_EQ(run("@map.db --objects @o.csv" + classes_), 0) << err_;
  EXPECT_EQ(checked(read_objects(directory_.path("o.csv"))).size(), objects.size());
  ASSERT_EQ(run("@map.db --merges @m.csv" + classes_), 0) << err_;
  EXPECT_NE(out_.find("merges      "), std::string::npos) << out_;
  EXPECT_EQ(read_whole(directory_.path("m.csv")).find("number,merged_id,survivor_id,"), 0U);
  ASSERT_EQ(run("@map.db --refused @r.csv" + classes_), 0) << err_;
  const std::vector<LoopFigures> refused = checked(read_map(directory_.path("map.db"), coco()))->refused;
  ASSERT_FALSE(refused.empty());
  EXPECT_NE(out_.find("refused     " + std::to_string(refused.size()) + " candidates"), std::string::npos) << out_;
  EXPECT_NE(out_.find(std::string(" ") + to_string(refused[0].reason) + "\n"), std::string::npos) << out_;
  const auto loops = checked(read_loops(directory_.path("r.csv")));
  ASSERT_EQ(loops.size(), refused.size());
  EXPECT_EQ(loops.back().match_frame, refused.back().match_frame);
  ASSERT_EQ(run("@map.db --dump"), 0) << err_;
  EXPECT_EQ(out_.find("class "), 0U);
}

TEST_F(InspectMapProgram, AGraphIsInTheUnitOfTheMap) {
  MapState map = *checked(read_map(directory_.path("map.db"), coco()));
  const auto exported = [&](double scale) {
    for (GraphKeyframe& keyframe : map.graph.keyframes) keyframe.pose.scale = scale;
    EXPECT_EQ(write_map(directory_.path("scaled.db"), map, coco()).message(), "");
    EXPECT_EQ(run("@scaled.db --graph @g.g2o" + classes_), 0) << err_;
    return checked(read_g2o(directory_.path("g.g2o"), nullptr)).edges;
  };
  const std::vector<G2oEdge> metres = exported(1.0), halves = exported(2.0);
  ASSERT_EQ(halves.size(), metres.size());
  for (std::size_t i = 0; i < metres.size(); ++i) {
    EXPECT_LT((halves[i].T_from_to.t - 2.0 * metres[i].T_from_to.t).norm(), 1e-6) << i;
    EXPECT_NEAR(halves[i].information(0, 0) / metres[i].information(0, 0), 0.25, 1e-6) << i;
    EXPECT_NEAR(halves[i].information(5, 5) / metres[i].information(5, 5), 1.0, 1e-6) << i;
  }
}

TEST_F(InspectMapProgram, AGraphHasTheNoiseAndTheJumpsThatWereFound) {
  MapState map = *checked(read_map(directory_.path("map.db"), coco()));
  GraphState& graph = map.graph;
  constexpr std::size_t kJumped = 4, kSuspect = 6;
  ASSERT_GT(graph.edges.size(), kSuspect);
  for (const std::size_t i : {kJumped, kSuspect}) {
    OdometryEdge edge;
    edge.T_from_to = graph.edges[i].T_from_to;
    edge.path_m = edge.rotation_rad = 0.1;
    graph.edges[i] = edge;
  }
  graph.noise.jumps.clear();
  graph.noise.loop_factor = graph.noise.odometry.jump_prior = 1.0;
  const auto exported = [&] {
    EXPECT_EQ(write_map(directory_.path("changed.db"), map, coco()).message(), "");
    EXPECT_EQ(run("@changed.db --graph @g.g2o" + classes_), 0) << err_;
    return checked(read_g2o(directory_.path("g.g2o"), nullptr)).edges;
  };
  const auto covariance = [](const G2oEdge& edge) {
    Vec6 by_quaternion;
    by_quaternion << Vec3::Ones(), Vec3::Constant(2.0);
    return Mat6(by_quaternion.asDiagonal() * edge.information.inverse() * by_quaternion.asDiagonal());
  };
  const std::vector<G2oEdge> before = exported();
  graph.noise.jumps = {{kJumped, 0.3, 0.2}};
  graph.noise.loop_factor = 2.0;
  graph.edges[kSuspect].suspected_jump << 0.2, -0.1, 0.0, 0.0, 0.0, 0.1;
  const std::vector<G2oEdge> after = exported();
  ASSERT_GT(before.size(), graph.edges.size()) << "loops, too";
  ASSERT_EQ(after.size(), before.size());
  const Mat6 of_jump = covariance(after[kJumped]) - covariance(before[kJumped]);
  EXPECT_LT((of_jump - isotropic_covariance(0.09, 0.04)).norm(), 1e-6);
  const Vec6 half = 0.5 * graph.edges[kSuspect].suspected_jump;  // a jump by all of it or by nothing, each as likely
  const SE3 T_taken_out = after[kSuspect].T_from_to.inverse() * before[kSuspect].T_from_to;
  EXPECT_LT((se3_log(T_taken_out) - half).norm(), 1e-9);
  const Mat6 of_suspect = covariance(after[kSuspect]) - covariance(before[kSuspect]);
  EXPECT_LT((of_suspect - half * half.transpose()).norm(), 1e-6);
  const Mat6 &loop_before = before.back().information, &loop_after = after.back().information;
  EXPECT_LT((4.0 * loop_after - loop_before).norm(), 1e-9 * loop_before.norm());
}

/// Sessions may be joined in any order of their times.
TEST_F(InspectMapProgram, ATrajectoryNeverGoesBackInTime) {
  const auto first = checked(read_map(directory_.path("map.db"), coco()));
  const auto with_second_after_s = [&](double seconds) {
    MapState map = *first, second = *first;
    MapState& later = seconds < 0.0 ? map : second;
    for (GraphKeyframe& keyframe : later.graph.keyframes) {
      keyframe.pose.stamp_ns += std::llround(1e9 * std::abs(seconds));
    }
    map.append(second);
    EXPECT_EQ(write_map(directory_.path("both.db"), map, coco()).message(), "");
    for (const char* name : {"t.txt", "t_1.txt", "t_2.txt"}) std::filesystem::remove(directory_.path(name));
    EXPECT_EQ(run("@both.db --trajectory @t.txt" + classes_), 0) << err_;
  };
  const std::size_t keyframes = first->graph.keyframes.size();
  const SE3& T_last = first->graph.keyframes.back().pose.T_map_camera;
  for (const double after_s : {100.0, -100.0}) {
    with_second_after_s(after_s);
    const StampedPoses poses = checked(read_tum_trajectory(directory_.path("t.txt")));  // refuses what goes back
    ASSERT_EQ(poses.size(), 2 * keyframes);
    const StampedPose& last = poses[after_s > 0.0 ? keyframes - 1 : 2 * keyframes - 1];
    EXPECT_LT((last.T_world_camera.t - T_last.t).norm(), 1e-6) << after_s;
  }
  for (const double after_s : {0.0, 10.0}) {
    with_second_after_s(after_s);
    EXPECT_FALSE(std::filesystem::exists(directory_.path("t.txt")));
    EXPECT_NE(out_.find("sessions overlap in time, a file each: " + directory_.path("t_1.txt") + " to "),
              std::string::npos)
        << out_;
    for (const char* name : {"t_1.txt", "t_2.txt"}) {
      EXPECT_EQ(checked(read_tum_trajectory(directory_.path(name))).size(), keyframes) << name;
    }
  }
}

TEST_F(InspectMapProgram, WhatDoesNotFitIsOneClearError) {
  expect_failure("@none.db" + classes_, 1, "none.db: cannot open the file");
  expect_failure("@none.db --dump", 1, "none.db: cannot open the file");
  const std::string dump = STL_PROGRAM_DIR "/inspect_map " + directory_.path("map.db") + " --dump 2> /dev/null";
  EXPECT_EQ(std::system((dump + " > /dev/null").c_str()), 0);
  EXPECT_NE(std::system((dump + " > /dev/full").c_str()), 0);
  expect_failure("@map.db --objects @o.txt" + classes_, 2, "must be a path that ends in .csv or .json");
  expect_failure("@map.db --graph @./map.db" + classes_, 1, "map.db: would take the place of the map");
  EXPECT_EQ(std::system((dump + " > /dev/null").c_str()), 0);
  directory_.write("text.db", "no map\n");
  expect_failure("@text.db" + classes_, 1, "text.db: file is not a database");
}

class MergeMapsProgram : public ProgramTest {
 protected:
  MergeMapsProgram() : ProgramTest(STL_PROGRAM_DIR "/merge_maps") {}
};

TEST_F(MergeMapsProgram, MapsOfTwoPlacesAreNotJoined) {
  for (const char* layout : {"desk", "office"}) {
    const SimulationOptions options = simulation_test::options_of(
        {{"trajectory.duration_s", "30"}, {"trajectory.rate_hz", "10"}, {"scene.layout", layout}});
    const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
    const auto map = testing::map_of(sequence, 0, sequence.odometry.size(), shared_coco());
    ASSERT_EQ(write_map(directory_.path(std::string(layout) + ".db"), *map, coco()).message(), "");
  }
  expect_failure("@desk.db @office.db @both.db --classes " STL_CONFIG_DIR "/classes_coco.yaml", 1,
                 "have no place in common");
  EXPECT_FALSE(std::filesystem::exists(directory_.path("both.db")));
  expect_failure("@desk.db @office.db @office.db --classes " STL_CONFIG_DIR "/classes_coco.yaml", 1,
                 "office.db: would take the place of a map that is joined");
  ASSERT_EQ(run("@desk.db @desk.db @both.db --classes " STL_CONFIG_DIR "/classes_coco.yaml"), 0) << err_;
  EXPECT_NE(out_.find(" loops join the maps; "), std::string::npos) << out_;
  EXPECT_NE(err_.find("merge_maps: warning: "), std::string::npos) << "it is one session, twice: " << err_;
  EXPECT_NE(err_.find(" boxes are in both maps"), std::string::npos) << err_;
}

TEST_F(MergeMapsProgram, AUnitThatDriftsNeedsAFreeScale) {
  const SimulationOptions options =
      simulation_test::options_of({{"trajectory.duration_s", "30"}, {"trajectory.rate_hz", "10"}});
  const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
  MapState map = *testing::map_of(sequence, 0, sequence.odometry.size(), shared_coco());
  ASSERT_EQ(write_map(directory_.path("metric.db"), map, coco()).message(), "");
  map.graph.keyframes.back().pose.scale = 1.2;
  ASSERT_EQ(write_map(directory_.path("free.db"), map, coco()).message(), "");
  expect_failure("@metric.db @free.db @both.db --classes " STL_CONFIG_DIR "/classes_coco.yaml", 1,
                 "free.db: its unit of length drifts, which needs pose_graph.scale = free");
  ASSERT_EQ(write_sequence(sequence, coco(), directory_.path("run")).message(), "");
  const std::string later =
      "--trajectory @run/odometry.txt --detections @run/detections.json --camera @run/camera.yaml "
      "--classes " STL_CONFIG_DIR "/classes_coco.yaml --output @results --map @free.db";
  const ProgramRun offline = run_program(STL_PROGRAM_DIR "/offline", later, directory_);
  EXPECT_EQ(offline.status, 1);
  EXPECT_NE(offline.err.find("free.db: its unit of length drifts, which needs pose_graph.scale = free"),
            std::string::npos)
      << offline.err;
  for (const char* allowed : {" --frozen", " --set pose_graph.scale=free --set loop.scale=free"}) {
    const ProgramRun run = run_program(STL_PROGRAM_DIR "/offline", later + allowed, directory_);
    EXPECT_EQ(run.status, 0) << allowed << ": " << run.err;
  }
}

class OptimiseGraphProgram : public ProgramTest {
 protected:
  OptimiseGraphProgram() : ProgramTest(STL_PROGRAM_DIR "/optimise_graph") {}
};

TEST_F(OptimiseGraphProgram, ArgumentsThatDoNotFitAreOneClearError) {
  expect_failure("--robust gnc", 2, "the option '--IN.g2o' is required but missing");
  expect_failure("@in.g2o @out.g2o @more.g2o", 2, "unrecognised argument");
  expect_failure("@in.g2o @out.g2o --robust always", 2, "'always'");
  expect_failure("@in.g2o @out.g2o", 1, "in.g2o: cannot open the file");
}

}  // namespace
}  // namespace semantic_topo_loop::core
