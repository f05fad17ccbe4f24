#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "support/program_test.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/perturbation/perturbation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFrames = 400, kBoxesPerFrame = 25;
constexpr int kBoxes = kFrames * kBoxesPerFrame;

/// Boxes of 40 x 80 px of the given classes in turn; the score numbers the box, so that it can be found again.
std::vector<DetectionFrame> recording(const std::vector<int>& classes = {39, 41, 73}) {
  std::vector<DetectionFrame> frames;
  for (int i = 0; i < kFrames; ++i) {
    DetectionFrame frame{1000000000LL * (i + 1), {}};
    for (int k = 0; k < kBoxesPerFrame; ++k) {
      const int n = i * kBoxesPerFrame + k;
      const double x = 20.0 * k, y = 5.0 * k;
      frame.detections.push_back(
          {classes[static_cast<std::size_t>(n) % classes.size()], n / (1.0 + kBoxes), {x, y, x + 40.0, y + 80.0}});
    }
    frames.push_back(frame);
  }
  return frames;
}

std::vector<DetectionFrame> perturb(const PerturbationOptions& options, std::uint64_t seed,
                                    const std::vector<DetectionFrame>& frames = recording()) {
  PerturbationCounts counts;
  return perturb_detections(frames, options, seed, &counts);
}

std::string to_json(const TestDirectory& directory, const std::vector<DetectionFrame>& frames) {
  EXPECT_EQ(write_detections_json(directory.path("out.json"), frames).message(), "");
  return read_whole(directory.path("out.json"));
}

/// The boxes by their number.
std::map<int, Detection> by_number(const std::vector<DetectionFrame>& frames) {
  std::map<int, Detection> boxes;
  for (const DetectionFrame& frame : frames) {
    for (const Detection& d : frame.detections) boxes[static_cast<int>(std::lround(d.score * (1.0 + kBoxes)))] = d;
  }
  return boxes;
}

TEST(DetectionPerturbation, ZeroSharesChangeNothing) {
  const TestDirectory directory;
  EXPECT_EQ(to_json(directory, perturb({}, 1)), to_json(directory, recording()));
}

TEST(DetectionPerturbation, SameSeedSameBytesAndAnotherSeedOthers) {
  const TestDirectory directory;
  const PerturbationOptions options{0.3, 0.1, 0.03};
  EXPECT_EQ(to_json(directory, perturb(options, 7)), to_json(directory, perturb(options, 7)));
  EXPECT_NE(to_json(directory, perturb(options, 7)), to_json(directory, perturb(options, 8)));
}

TEST(DetectionPerturbation, SharesAreThoseAskedForAndCounted) {
  PerturbationCounts counts;
  const auto frames = recording();
  const auto worse = perturb_detections(frames, {0.3, 0.1, 0.0}, 3, &counts);
  ASSERT_EQ(worse.size(), frames.size());
  const auto kept = by_number(worse), before = by_number(frames);
  int relabelled = 0;
  for (const auto& [number, detection] : kept) {
    relabelled += detection.class_id != before.at(number).class_id ? 1 : 0;
    EXPECT_EQ(detection.box.edges(), before.at(number).box.edges());
  }
  EXPECT_EQ(counts.boxes, kBoxes);
  EXPECT_EQ(counts.dropped, kBoxes - static_cast<int>(kept.size()));
  EXPECT_EQ(counts.relabelled, relabelled);
  // Five standard deviations.
  EXPECT_NEAR(counts.dropped / static_cast<double>(kBoxes), 0.3, 5.0 * std::sqrt(0.21 / kBoxes));
  EXPECT_NEAR(relabelled / static_cast<double>(kept.size()), 0.1, 5.0 * std::sqrt(0.09 / (0.7 * kBoxes)));
}

TEST(DetectionPerturbation, OtherClassesAreThoseOfTheFileAndEquallyOften) {
  const std::vector<int> classes = {39, 41, 73, 77};
  std::map<std::pair<int, int>, int> changes;
  const auto before = by_number(recording(classes));
  for (const auto& [number, detection] : by_number(perturb({0.0, 1.0, 0.0}, 5, recording(classes)))) {
    ++changes[{before.at(number).class_id, detection.class_id}];
  }
  ASSERT_EQ(changes.size(), 12u);
  const double expected = kBoxes / 12.0;
  for (const auto& [change, count] : changes) {
    EXPECT_NE(change.first, change.second);
    EXPECT_NEAR(count, expected, 5.0 * std::sqrt(expected)) << change.first << " -> " << change.second;
  }
}

TEST(DetectionPerturbation, TheOnlyClassStays) {
  for (const auto& [number, detection] : by_number(perturb({0.0, 1.0, 0.0}, 5, recording({41})))) {
    EXPECT_EQ(detection.class_id, 41) << number;
  }
}

TEST(DetectionPerturbation, CornersScatterWithWidthAndHeight) {
  const auto before = by_number(recording());
  Vec4 sum = Vec4::Zero(), squares = Vec4::Zero();
  double x1_times_x2 = 0.0;
  for (const auto& [number, detection] : by_number(perturb({0.0, 0.0, 0.03}, 11))) {
    const Vec4 e = detection.box.edges() - before.at(number).box.edges();
    sum += e;
    squares += e.cwiseAbs2();
    x1_times_x2 += e[0] * e[2];
  }
  for (int i = 0; i < 4; ++i) {
    const double sigma = 0.03 * (i % 2 == 0 ? 40.0 : 80.0);
    EXPECT_NEAR(sum[i] / kBoxes, 0.0, 5.0 * sigma / std::sqrt(kBoxes));
    EXPECT_NEAR(std::sqrt(squares[i] / kBoxes), sigma, 5.0 * sigma / std::sqrt(2.0 * kBoxes));
  }
  EXPECT_NEAR(x1_times_x2 / kBoxes / (1.2 * 1.2), 0.0, 5.0 / std::sqrt(kBoxes));
}

TEST(DetectionPerturbation, BoxesStayBoxesUnderAnyJitter) {
  for (const DetectionFrame& frame : perturb({0.0, 0.0, 1.0}, 2)) {
    for (const Detection& detection : frame.detections) EXPECT_TRUE(detection.box.is_valid());
  }
}

TEST(DetectionPerturbation, AnOptionLeavesTheEffectsOfTheOthers) {
  const auto few = by_number(perturb({0.5, 0.1, 0.03}, 9));
  const auto most = by_number(perturb({0.2, 0.1, 0.03}, 9));
  const auto unlabelled = by_number(perturb({0.2, 0.0, 0.03}, 9));
  EXPECT_LT(few.size(), most.size());
  for (const auto& [number, detection] : few) {
    ASSERT_TRUE(most.count(number)) << number;
    EXPECT_EQ(most.at(number).class_id, detection.class_id);
    EXPECT_EQ(most.at(number).box.edges(), detection.box.edges());
    EXPECT_EQ(unlabelled.at(number).box.edges(), detection.box.edges());
  }
}

TEST(DetectionPerturbation, RealDetectionsKeepTheirImages) {
  const auto path = shared_data("tum/fr2_desk/detections_yolov5.json");
  if (!path) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const ClassTable classes = coco();
  const auto recording = read_detections(*path, classes);
  ASSERT_TRUE(recording) << recording.message();
  const std::vector<DetectionFrame>& frames = recording->frames;
  PerturbationCounts counts;
  const auto worse = perturb_detections(frames, {0.3, 0.1, 0.03}, 1, &counts);
  ASSERT_EQ(worse.size(), frames.size());
  for (std::size_t i = 0; i < worse.size(); ++i) EXPECT_EQ(worse[i].stamp_ns, frames[i].stamp_ns);
  for (const DetectionFrame& frame : worse) {
    EXPECT_EQ(usable_boxes(frame.detections, classes, frame.detections.size(), nullptr).size(),
              frame.detections.size());
  }
  EXPECT_EQ(counts.boxes, recording->report.detections);
  EXPECT_NEAR(counts.dropped / static_cast<double>(counts.boxes), 0.3, 0.02);
}

class PerturbProgram : public ProgramTest {
 protected:
  PerturbProgram() : ProgramTest(STL_PROGRAM_DIR "/perturb") {
    directory_.write("boxes.json", R"([{"file_name": "1.500000.png", "detections": [
      {"category_id": 41, "detection_score": 0.5, "bbox": [10, 20, 30, 60]},
      {"category_id": 73, "detection_score": 0.25, "bbox": [100, 20, 130, 60]}]},
      {"file_name": "1.600000.png", "detections": []}])");
    directory_.write("yolo/1.500000.txt", "41 10 20 20 40 0.5\n73 100 20 30 40 0.25\n");
    directory_.write("yolo/1.600000.txt", "");
  }

  int detections(const std::string& arguments) {
    return run("detections " + arguments + " --classes " STL_CONFIG_DIR "/classes_coco.yaml");
  }
};

TEST_F(PerturbProgram, WritesTheKindThatItReads) {
  ASSERT_EQ(detections("@boxes.json @worse.json --seed 3 --jitter 0.03"), 0) << err_;
  EXPECT_EQ(out_, "2 images, 2 boxes: 0 dropped, 0 relabelled\n");
  EXPECT_NE(read_whole(directory_.path("worse.json")).find("\"file_name\": \"1.500000.png\""), std::string::npos);
  ASSERT_EQ(detections("@yolo @worse --seed 3 --relabel 1"), 0) << err_;
  EXPECT_EQ(out_, "2 images, 2 boxes: 0 dropped, 2 relabelled\n");
  EXPECT_EQ(read_whole(directory_.path("worse/1.500000.txt")),
            "73 10.0000 20.0000 20.0000 40.0000 0.500000\n41 100.0000 20.0000 30.0000 40.0000 0.250000\n");
  EXPECT_TRUE(std::filesystem::exists(directory_.path("worse/1.600000.txt")));
}

TEST_F(PerturbProgram, TheBytesArePinned) {
  // The random numbers are part of the format: published figures must stay reproducible.
  ASSERT_EQ(detections("@yolo @worse --seed 5 --drop 0.1 --relabel 0.5 --jitter 0.03"), 0) << err_;
  EXPECT_EQ(read_whole(directory_.path("worse/1.500000.txt")),
            "73 9.5197 18.7997 21.0453 40.3666 0.500000\n41 99.6488 21.3106 30.1603 39.5632 0.250000\n");
}

TEST_F(PerturbProgram, FalseLoopsAreASeededShareOfTheRightOnes) {
  std::string keyframes = "keyframe_id,frame_id,stamp,x,y,z,qx,qy,qz,qw\n", loops = loop_table_header();
  for (int k = 0; k < 60; ++k) {
    const std::string id = std::to_string(k), frame = std::to_string(10 * k);
    keyframes += id + "," + frame + "," + frame + ".0," + id + ",0,0,0,0,0,1\n";
  }
  for (int k = 0; k < 20; ++k) {
    LoopClosure loop;
    loop.query_frame = 10 * (k + 40);
    loop.match_frame = 10 * k;
    loop.accepted = k < 10;
    loops += table_row(loop);
  }
  directory_.write("run/keyframes.csv", keyframes);
  directory_.write("run/loops.csv", loops);
  ASSERT_EQ(run("loops @run @false.csv --seed 3 --share 0.5 --cluster 5 --distance 2"), 0) << err_;
  EXPECT_EQ(out_, "10 accepted loops, 5 wrong ones written\n");
  const auto wrong = read_given_loops(directory_.path("false.csv"));
  ASSERT_TRUE(wrong) << wrong.message();
  ASSERT_EQ(wrong->size(), 5U);
  for (const LoopClosure& loop : *wrong) {
    EXPECT_TRUE(loop.accepted);
    EXPECT_NEAR(loop.covariance(0, 0), 0.03 * 0.03, 1e-7);
    // Without rotation in the odometry the error of all members is the same but for the lever arm of the rotation.
    const Vec3 odometry(0.1 * static_cast<double>(loop.query_frame - loop.match_frame), 0.0, 0.0);
    EXPECT_GT((loop.T_match_query.t - odometry).norm(), 0.5);
  }
  const std::string first = read_whole(directory_.path("false.csv"));
  ASSERT_EQ(run("loops @run @false.csv --seed 3 --share 0.5 --cluster 5 --distance 2"), 0) << err_;
  EXPECT_EQ(read_whole(directory_.path("false.csv")), first);
}

TEST_F(PerturbProgram, BadArgumentsAreOneClearError) {
  expect_failure("", 2, "the sub-command is missing");
  expect_failure("poses", 2, "unknown sub-command 'poses'");
  expect_failure("loops @run @run/loops.csv", 1, "run/loops.csv: the run's results would take its place");
  expect_failure("loops @run", 2, "the option '--OUT' is required but missing");
  expect_failure("loops @run @out.csv --cluster 0", 2,
                 "('0') for option '--cluster' must be an integer in [1, 1000000]");
  expect_failure("loops @run @out.csv --sigma 0", 2, "('0') for option '--sigma' must be a finite number >= 1e-06");
  expect_failure("loops @run @out.csv", 1, "keyframes.csv");
  EXPECT_EQ(detections("@boxes.json"), 2);
  expect_one_line_error("the option '--OUT' is required but missing");
  for (const auto& [name, value] :
       {std::pair("drop", "1.5"), {"relabel", "-0.1"}, {"jitter", "2"}, {"jitter", "nan"}}) {
    EXPECT_EQ(detections(std::string("@boxes.json @out.json --") + name + " " + value), 2);
    expect_one_line_error(std::string("('") + value + "') for option '--" + name +
                          "' must be a finite number in [0, 1]");
  }
  EXPECT_EQ(detections("@boxes.json @out.json --jitter much"), 2);
  expect_one_line_error("the argument ('much') for option '--jitter' is invalid");
  EXPECT_EQ(detections("@boxes.json @out.json --seed -1"), 2);
  expect_one_line_error("the argument ('-1') for option '--seed' must be an integer >= 0");
  EXPECT_EQ(detections("@boxes.json @out.json --flip 0.1"), 2);
  expect_one_line_error("unrecognised option '--flip'");
  expect_failure("detections @boxes.json @out.json --drop", 2, "the required argument for option '--drop' is missing");
  EXPECT_EQ(detections("@boxes.json @boxes.json"), 2);
  expect_one_line_error("is the input itself");
  EXPECT_FALSE(std::filesystem::exists(directory_.path("out.json")));
}

TEST_F(PerturbProgram, BadFilesAreOneClearError) {
  EXPECT_EQ(detections("@none.json @out.json"), 1);
  expect_one_line_error("none.json");
  EXPECT_EQ(detections("@boxes.json @none/out.json"), 1);
  expect_one_line_error("none/out.json");
}

TEST_F(PerturbProgram, Help) {
  EXPECT_EQ(run("--help"), 0);
  EXPECT_NE(out_.find("perturb detections IN OUT"), std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
