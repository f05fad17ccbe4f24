#include "tools/simulation/sequence.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "support/program_test.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::simulate_fr2;

constexpr const char* kFiles[] = {"groundtruth.txt", "groundtruth_frames.txt", "odometry.txt",
                                  "detections.json", "reference_objects.csv",  "camera.yaml"};

class SequenceTest : public ::testing::Test {
 protected:
  std::string write(const std::string& name, const std::map<std::string, std::string>& texts) {
    EXPECT_EQ(write_sequence(simulate_fr2(texts), coco(), directory_.path(name)).message(), "");
    return directory_.path(name);
  }

  const TestDirectory directory_;
};

TEST_F(SequenceTest, same_seed_same_bytes) {
  for (const char* layout : {"desk", "office"}) {
    const std::map<std::string, std::string> texts = {{"scene.layout", layout}, {"trajectory.duration_s", "6"}};
    const std::string a = write("a", texts), b = write("b", texts);
    for (const char* file : kFiles) EXPECT_EQ(read_whole(a + "/" + file), read_whole(b + "/" + file)) << file;
  }
}

TEST_F(SequenceTest, another_seed_other_bytes) {
  const std::string a = write("a", {{"trajectory.duration_s", "3"}});
  const std::string b = write("b", {{"trajectory.duration_s", "3"}, {"simulation.seed", "2"}});
  for (const char* file : {"groundtruth.txt", "odometry.txt", "detections.json", "reference_objects.csv"}) {
    EXPECT_NE(read_whole(a + "/" + file), read_whole(b + "/" + file)) << file;
  }
}

TEST_F(SequenceTest, detector_options_leave_the_scene_and_the_motion) {
  const std::string a = write("a", {{"trajectory.duration_s", "3"}});
  const std::string b = write("b", {{"trajectory.duration_s", "3"}, {"detector.miss_rate", "0.5"}});
  EXPECT_EQ(read_whole(a + "/groundtruth.txt"), read_whole(b + "/groundtruth.txt"));
  EXPECT_EQ(read_whole(a + "/odometry.txt"), read_whole(b + "/odometry.txt"));
  EXPECT_NE(read_whole(a + "/detections.json"), read_whole(b + "/detections.json"));
}

TEST_F(SequenceTest, files_read_back) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "3"}});
  const std::string path = write("a", {{"trajectory.duration_s", "3"}});
  const auto odometry = read_tum_trajectory(path + "/odometry.txt");
  ASSERT_TRUE(odometry) << odometry.message();
  ASSERT_EQ(odometry->size(), 90u);
  EXPECT_EQ(odometry->back().stamp_ns, sequence.odometry.back().stamp_ns);
  EXPECT_LT((odometry->back().T_world_camera.t - sequence.odometry.back().T_world_camera.t).norm(), 1e-8);
  const auto mocap = read_tum_trajectory(path + "/groundtruth.txt");
  ASSERT_TRUE(mocap) << mocap.message();
  EXPECT_EQ((*mocap)[1].stamp_ns - (*mocap)[0].stamp_ns, 10000000);
  EXPECT_LT(mocap->front().stamp_ns, odometry->front().stamp_ns);
  EXPECT_GT(mocap->back().stamp_ns, odometry->back().stamp_ns);
  const auto camera = read_camera(path + "/camera.yaml");
  ASSERT_TRUE(camera) << camera.message();
  EXPECT_EQ(camera->fx, sequence.camera.fx);
  EXPECT_EQ(camera->distortion, sequence.camera.distortion);

  const auto recording = read_detections(path + "/detections.json", coco());
  ASSERT_TRUE(recording) << recording.message();
  EXPECT_TRUE(recording->report.warnings().empty());
  const std::vector<DetectionFrame>& detections = recording->frames;
  ASSERT_EQ(detections.size(), 90u);
  for (std::size_t i = 0; i < detections.size(); ++i) {
    EXPECT_EQ(detections[i].stamp_ns, sequence.truth[i].stamp_ns);
    ASSERT_EQ(detections[i].detections.size(), sequence.detections[i].size());
    for (std::size_t k = 0; k < sequence.detections[i].size(); ++k) {
      const Detection& expected = sequence.detections[i][k].detection;
      EXPECT_EQ(detections[i].detections[k].class_id, expected.class_id);
      EXPECT_LT((detections[i].detections[k].box.edges() - expected.box.edges()).norm(), 1e-3);
    }
  }
}

TEST_F(SequenceTest, an_unwritable_directory_is_an_error_with_its_path) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "1"}});
  const std::string error = write_sequence(sequence, coco(), "/dev/null/here").message();
  EXPECT_NE(error.find("/dev/null/here"), std::string::npos) << error;
}

TEST(Sequence, odometry_frames) {
  const auto run = [](const char* frame) {
    return simulate_fr2({{"trajectory.duration_s", "2"}, {"simulation.odometry_frame", frame}});
  };
  const SimulatedSequence first = run("first_camera"), world = run("world"), random = run("random");
  EXPECT_LT(se3_log(first.odometry[0].T_world_camera).norm(), 1e-12);
  EXPECT_LT(se3_log(world.odometry[0].T_world_camera.inverse() * world.truth[0].T_world_camera).norm(), 1e-12);
  const SE3 motion_a = first.odometry.front().T_world_camera.inverse() * first.odometry.back().T_world_camera;
  const SE3 motion_b = random.odometry.front().T_world_camera.inverse() * random.odometry.back().T_world_camera;
  EXPECT_LT(se3_log(motion_a.inverse() * motion_b).norm(), 1e-9);
  EXPECT_GT(se3_log(random.odometry[0].T_world_camera).norm(), 0.1);
}

TEST(Sequence, detections_are_about_as_many_as_yolo_gives) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "20"}});
  double boxes = 0.0;
  for (const auto& frame : sequence.detections) boxes += static_cast<double>(frame.size());
  boxes /= static_cast<double>(sequence.detections.size());
  EXPECT_GT(boxes, 7.0);
  EXPECT_LT(boxes, 18.0);
}

TEST(Sequence, most_objects_of_a_whole_lap_are_certain) {
  for (const char* layout : {"desk", "office"}) {
    const SimulatedSequence sequence = simulate_fr2({{"scene.layout", layout}});
    const std::vector<SimulatedReference> references = reference_objects(sequence);
    double certain = 0.0;
    for (const SimulatedReference& r : references) {
      certain += r.certainty == Certainty::kCertain ? 1.0 : 0.0;
      EXPECT_GE(r.views, 1);
      EXPECT_LE(r.mean_iou, 1.0);
      if (r.certainty != Certainty::kCertain) continue;
      EXPECT_GE(r.views, 90);
      EXPECT_GE(r.baseline_deg, 20.0);
      EXPECT_GT(r.mean_iou, 0.6);
    }
    EXPECT_GT(certain / static_cast<double>(sequence.scene.objects.size()), 0.7) << layout;
  }
}

TEST(Sequence, a_few_views_do_not_make_an_object_certain) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "2"}});
  for (const SimulatedReference& r : reference_objects(sequence)) EXPECT_NE(r.certainty, Certainty::kCertain);
}

TEST(SimulationOptions, bad_values_are_named) {
  const std::vector<std::pair<std::string, std::string>> bad = {
      {"simulation.seed", "-1"},
      {"simulation.odometry_frame", "mars"},
      {"scene.layout", "kitchen"},
      {"scene.desks", "0"},
      {"trajectory.duration_s", "-5"},
      {"trajectory.duration_s", "0.01"},
      {"trajectory.rate_hz", "0"},
      {"trajectory.lap_s", "0"},
      {"trajectory.distance_m", "0"},
      {"trajectory.height_m", "0.5"},
      {"trajectory.wander_m", "1"},
      {"trajectory.shake_m", "-1"},
      {"trajectory.shake_deg", "90"},
      {"drift.model", "walk"},
      {"drift.position_m", "-1"},
      {"drift.rotation_deg", "200"},
      {"detector.miss_rate", "1.5"},
      {"detector.small_box_px", "-1"},
      {"detector.mislabel_rate", "2"},
      {"detector.false_rate", "-0.1"},
      {"detector.jitter_px", "-1"},
      {"detector.jitter_ratio", "2"},
      {"detector.persistence_s", "-1"},
      {"detector.min_visible", "2"},
      {"detector.min_inside", "-1"},
      {"detector.min_score", "1"},
      {"detector.color", "red"},
      {"detector.miss_rate", "nan"},
      {"trajectory.rate_hz", "fast"},
      {"trajectory.model", "drone"},
      {"trajectory.arc_deg", "0"},
      {"dynamics.persons", "-1"},
      {"dynamics.moved_objects", "-2"},
      {"dynamics.move_time_s", "0"},
      {"rendering.depth_scale", "0"},
      {"rendering.depth_scale", "nan"},
      {"rendering.far_value", "7"},
      {"rendering.depth_delay_s", "1"},
      {"rendering.depth_offset_m", "-3"},
      {"rendering.noise", "much"},
      {"scene.seed", "-2"},
      {"trajectory.first_desk", "0"},
      {"trajectory.first_desk", "2"},
      {"trajectory.desks", "2"},
  };
  for (const auto& [key, value] : bad) {
    const std::string error = make_options<SimulationOptions>({{key, value}}).message();
    EXPECT_NE(error.find("'" + key + "'"), std::string::npos) << error;
    EXPECT_NE(error.find("'" + value + "'"), std::string::npos) << key << ": " << error;
  }
}

TEST(Sequence, robots_in_one_scene_differ_in_all_but_the_scene) {
  OptionTexts texts{{"scene.layout", "office"}, {"scene.seed", "7"}, {"trajectory.duration_s", "2"}};
  texts["simulation.seed"] = "1";
  const SimulatedSequence first = simulate_fr2(texts);
  texts["simulation.seed"] = "2";
  const SimulatedSequence second = simulate_fr2(texts);
  ASSERT_EQ(first.scene.objects.size(), second.scene.objects.size());
  for (std::size_t i = 0; i < first.scene.objects.size(); ++i) {
    EXPECT_EQ(first.scene.objects[i].ellipsoid.center(), second.scene.objects[i].ellipsoid.center());
  }
  EXPECT_GT((first.truth[0].T_world_camera.t - second.truth[0].T_world_camera.t).norm(), 0.1);
  const auto motion = [](const StampedPoses& poses) {
    return poses.front().T_world_camera.inverse() * poses.back().T_world_camera;
  };
  EXPECT_GT((motion(first.odometry).t - motion(second.odometry).t).norm(), 1e-3);
}

TEST(SimulationOptions, documentation_is_what_the_code_says) {
  EXPECT_EQ(generated_part(STL_SOURCE_DIR "/docs/parameters.md", "simulate --list-parameters"),
            format_options_table(list_options<SimulationOptions>()))
      << "scripts/generate_parameters writes it";
}

TEST(SimulationOptions, classes_that_the_scene_does_not_have_are_an_error) {
  const ClassTable other = *ClassTable::create({{0, "cup", ClassRole::kMovable, "", 0.1}});
  const std::string error = simulate({}, camera_fr2(), other).message();
  EXPECT_NE(error.find("the class table lacks id "), std::string::npos) << error;
}

TEST(SimulationOptions, an_invalid_camera_is_an_error) {
  Camera camera = camera_fr2();
  camera.fx = 0.0;
  const std::string error = simulate({}, camera, coco()).message();
  EXPECT_NE(error.find("fx"), std::string::npos) << error;
}

/// Runs `simulate` and `simulate_bag` with a small camera.
class SimulateProgram : public ::testing::Test {
 protected:
  SimulateProgram() {
    directory_.write("camera.yaml",
                     "fx: 80\nfy: 80\ncx: 48\ncy: 36\nwidth: 96\nheight: 72\ndistortion: [0, 0, 0, 0, 0]\n");
  }

  ProgramRun run(const std::string& program, const std::string& arguments) {
    return run_program(program,
                       "--output @made --camera @camera.yaml --classes " STL_CONFIG_DIR
                       "/classes_coco.yaml --duration 0.4 --rate 10 " +
                           arguments,
                       directory_);
  }
  bool exists(const std::string& name) const { return std::filesystem::exists(directory_.path("made/" + name)); }

  TestDirectory directory_;
};

TEST_F(SimulateProgram, images_only_where_asked_for) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "").status, 0);
  EXPECT_TRUE(exists("detections.json"));
  EXPECT_FALSE(exists("rgb"));
  EXPECT_FALSE(exists("manifest.txt"));
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  EXPECT_TRUE(exists("rgb/1400000000.300000.png"));
  EXPECT_TRUE(exists("depth/1400000000.308000.png"));
  EXPECT_FALSE(exists("sequence.bag"));
}

TEST_F(SimulateProgram, simulate_bag_writes_folder_and_bag) {
  const ProgramRun first = run(STL_PROGRAM_DIR "/simulate_bag", "");
  EXPECT_EQ(first.status, 0) << first.err;
  EXPECT_TRUE(exists("associations.txt"));
  EXPECT_GT(std::filesystem::file_size(directory_.path("made/sequence.bag")), 4u * 96u * 72u * 3u / 2u);
}

TEST_F(SimulateProgram, the_same_request_is_not_made_again) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  const auto written = std::filesystem::last_write_time(directory_.path("made/rgb.txt"));
  const ProgramRun again = run(STL_PROGRAM_DIR "/simulate", "--images true --threads 1");
  EXPECT_EQ(again.status, 0);
  EXPECT_NE(again.out.find("up to date"), std::string::npos) << again.out;
  EXPECT_EQ(std::filesystem::last_write_time(directory_.path("made/rgb.txt")), written);
  const ProgramRun other = run(STL_PROGRAM_DIR "/simulate", "--images true --seed 2");
  EXPECT_EQ(other.status, 0);
  EXPECT_EQ(other.out.find("up to date"), std::string::npos) << other.out;
}

TEST_F(SimulateProgram, half_made_directories_are_made_again) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true --set drift.position_m=-1").status, 1);
  EXPECT_TRUE(exists("manifest.txt")) << "nothing was begun";
  const auto is_made_again = [this] {
    const ProgramRun again = run(STL_PROGRAM_DIR "/simulate", "--images true");
    EXPECT_EQ(again.status, 0) << again.err;
    return again.out.find("up to date") == std::string::npos;
  };
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true --bag @none/a.bag").status, 1);
  EXPECT_FALSE(is_made_again()) << "nothing was begun";
  directory_.write("made/manifest.txt", "# What this directory was made from.\n");  // ended while images were written
  EXPECT_TRUE(is_made_again());
  for (const char* name : {"rgb", "detections.json"}) {
    std::filesystem::remove_all(directory_.path(std::string("made/") + name));
    EXPECT_TRUE(is_made_again()) << name;
  }
}

TEST_F(SimulateProgram, without_images_those_from_before_go_with_their_lists) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "").status, 0);
  EXPECT_FALSE(exists("rgb"));
  EXPECT_FALSE(exists("associations.txt"));
}

TEST_F(SimulateProgram, a_recording_of_others_is_not_touched) {
  for (const char* name : {"rgb/1.png", "depth/1.png", "rgb.txt", "associations.txt", "odometry.txt", "camera.yaml"}) {
    directory_.write(std::string("made/") + name, "mine");
    directory_.write("made/manifest.txt", "mine, too\n");
    for (const char* program : {"/simulate", "/simulate --images true", "/simulate_bag"}) {
      const ProgramRun refused = run(STL_PROGRAM_DIR + std::string(program), "");
      EXPECT_EQ(refused.status, 1) << program;
      EXPECT_NE(refused.err.find(directory_.path("made") + ": holds a recording that is not simulated"),
                std::string::npos)
          << refused.err;
      EXPECT_EQ(read_whole(directory_.path(std::string("made/") + name)), "mine") << program;
    }
    EXPECT_FALSE(exists("groundtruth.txt")) << name;
    std::filesystem::remove_all(directory_.path("made"));
  }
}

TEST_F(SimulateProgram, a_bag_that_was_written_again_is_not_up_to_date) {
  const auto make = [this](const std::string& directory, const std::string& seed) {
    return run_program(STL_PROGRAM_DIR "/simulate",
                       "--output @" + directory +
                           " --camera @camera.yaml --classes " STL_CONFIG_DIR
                           "/classes_coco.yaml --duration 0.4 --rate 10 --images true --bag @a.bag --seed " +
                           seed,
                       directory_);
  };
  ASSERT_EQ(make("one", "1").status, 0);
  const std::string first = read_whole(directory_.path("a.bag"));
  EXPECT_NE(make("one", "1").out.find("up to date"), std::string::npos);
  ASSERT_EQ(make("two", "2").status, 0);
  EXPECT_TRUE(first != read_whole(directory_.path("a.bag")));
  EXPECT_EQ(make("one", "1").out.find("up to date"), std::string::npos);
  EXPECT_TRUE(first == read_whole(directory_.path("a.bag")));
}

TEST_F(SimulateProgram, wrong_arguments_are_named) {
  for (const auto& [arguments, part] :
       {std::pair("--images maybe", "('maybe') for option '--images' must be true or false"),
        std::pair("--threads 0", "('0') for option '--threads'"),
        std::pair("--bag-compression zip", "('zip') for option '--bag-compression' must be bz2, lz4 or none"),
        std::pair("--bag-images 1", "('1') for option '--bag-images'")}) {
    const ProgramRun failed = run(STL_PROGRAM_DIR "/simulate", arguments);
    EXPECT_EQ(failed.status, 2) << arguments;
    EXPECT_NE(failed.err.find(part), std::string::npos) << failed.err;
  }
  const ProgramRun failed = run(STL_PROGRAM_DIR "/simulate", "--set rendering.depth_scale=-5");
  EXPECT_EQ(failed.status, 1);
  EXPECT_NE(failed.err.find("rendering.depth_scale"), std::string::npos) << failed.err;
}

}  // namespace
}  // namespace semantic_topo_loop::core
