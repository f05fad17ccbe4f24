#include "semantic_topo_loop/io/detection_file.h"

#include <gtest/gtest.h>

#include <map>

#include "semantic_topo_loop/io/yaml_files.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

const ClassTable& coco() {
  static const ClassTable table = *read_class_table(std::string(STL_CONFIG_DIR) + "/classes_coco.yaml");
  return table;
}

class DetectionReader : public ::testing::Test {
 protected:
  /// Reads `text` as a JSON file.
  bool read(const std::string& text) { return read_path(directory_.write("boxes.json", text)); }

  bool read_path(const std::string& path) {
    const auto recording = read_detections(path, coco());
    error_ = recording.message();
    frames_ = recording ? recording->frames : std::vector<DetectionFrame>();
    report_ = recording ? recording->report : DetectionReport();
    return static_cast<bool>(recording);
  }

  /// One image with one box, whose members are given as JSON.
  static std::string one_box(const std::string& id, const std::string& score, const std::string& bbox) {
    return R"([{"file_name": "1.5.png", "detections": [{"category_id": )" + id + R"(, "detection_score": )" + score +
           R"(, "bbox": )" + bbox + "}]}]";
  }

  void expect_left_out(DetectionProblem problem, const std::string& first) {
    ASSERT_EQ(frames_.size(), 1u);
    EXPECT_TRUE(frames_[0].detections.empty());
    EXPECT_EQ(report_.cause(problem).count, 1);
    EXPECT_NE(report_.cause(problem).first.find(first), std::string::npos) << report_.cause(problem).first;
    ASSERT_EQ(report_.warnings().size(), 1u);
    EXPECT_NE(report_.warnings()[0].find(first), std::string::npos);
  }

  void expect_error(const std::vector<std::string>& parts) const {
    for (const std::string& part : parts) EXPECT_NE(error_.find(part), std::string::npos) << error_;
    EXPECT_EQ(error_.find('\n'), std::string::npos) << error_;
  }

  TestDirectory directory_;
  std::vector<DetectionFrame> frames_;
  DetectionReport report_;
  std::string error_;
};

TEST_F(DetectionReader, ReadsJsonInOrderOfStamps) {
  ASSERT_TRUE(read(R"([
    {"file_name": "rgb/1311868164.399026.png", "detections": []},
    {"file_name": "1311868164.363181.png", "detections": [
      {"category_id": 77, "detection_score": 0.25, "bbox": [293.0, 68.0, 359.5, 97.0]},
      {"category_id": 41, "detection_score": 1, "bbox": [1, 2, 3, 4]}]}])"))
      << error_;
  ASSERT_EQ(frames_.size(), 2u);
  EXPECT_EQ(frames_[0].stamp_ns, 1311868164363181000);
  EXPECT_EQ(frames_[1].stamp_ns, 1311868164399026000);
  EXPECT_TRUE(frames_[1].detections.empty());
  ASSERT_EQ(frames_[0].detections.size(), 2u);
  EXPECT_EQ(frames_[0].detections[0].class_id, 77) << "the teddy bear, which COCO counts as 88";
  EXPECT_EQ(frames_[0].detections[0].score, 0.25);
  EXPECT_EQ(frames_[0].detections[0].box.edges(), Vec4(293.0, 68.0, 359.5, 97.0));
  EXPECT_EQ(report_.frames, 2);
  EXPECT_EQ(report_.detections, 2);
  EXPECT_TRUE(report_.warnings().empty());
}

TEST_F(DetectionReader, ReadsADirectoryOfYoloFiles) {
  directory_.write("yolo/1341847980.754743.txt", "73 173 138 46 70 0.578918\n\n56 16 256 220.5 215 0.909657\r\n");
  directory_.write("yolo/1341847980.722988.txt", "");
  directory_.write("yolo/README.md", "not a detection file");
  ASSERT_TRUE(read_path(directory_.path("yolo"))) << error_;
  ASSERT_EQ(frames_.size(), 2u);
  EXPECT_EQ(frames_[0].stamp_ns, 1341847980722988000);
  EXPECT_TRUE(frames_[0].detections.empty());
  ASSERT_EQ(frames_[1].detections.size(), 2u);
  EXPECT_EQ(frames_[1].detections[0].box.edges(), Vec4(173.0, 138.0, 219.0, 208.0));
  EXPECT_EQ(frames_[1].detections[1].box.edges(), Vec4(16.0, 256.0, 236.5, 471.0));
  EXPECT_EQ(frames_[1].detections[1].score, 0.909657);
}

TEST_F(DetectionReader, ReadsResultsOfCoco) {
  ASSERT_TRUE(read(R"([
    {"image_id": 1311868164.399026, "category_id": 47, "bbox": [1, 2, 30.5, 40], "score": 0.5},
    {"image_id": "1311868164.363181", "category_id": 88, "bbox": [293, 68, 66.5, 29], "score": 0.25, "area": 1928.5},
    {"image_id": "rgb/1311868164.399026.png", "category_id": 84, "bbox": [5, 6, 7, 8], "score": 1}])"))
      << error_;
  ASSERT_EQ(frames_.size(), 2u);
  EXPECT_EQ(frames_[0].stamp_ns, 1311868164363181000);
  EXPECT_EQ(frames_[1].stamp_ns, 1311868164399026000);
  ASSERT_EQ(frames_[0].detections.size(), 1u);
  EXPECT_EQ(frames_[0].detections[0].class_id, 77) << "the teddy bear, which COCO counts as 88";
  EXPECT_EQ(frames_[0].detections[0].score, 0.25);
  EXPECT_EQ(frames_[0].detections[0].box.edges(), Vec4(293.0, 68.0, 359.5, 97.0));
  ASSERT_EQ(frames_[1].detections.size(), 2u);
  EXPECT_EQ(frames_[1].detections[1].class_id, 73);
  EXPECT_TRUE(report_.warnings().empty());
}

TEST_F(DetectionReader, FileNamesWithoutAnExtensionKeepTheirFraction) {
  ASSERT_TRUE(read(R"([
    {"file_name": "1311868164.363181", "detections": []},
    {"file_name": "rgb/1311868164.399026", "detections": []},
    {"image_id": "rgb/1311868164.431129", "category_id": 41, "bbox": [1, 2, 30, 40], "score": 0.5},
    {"image_id": "1311868165", "category_id": 41, "bbox": [1, 2, 30, 40], "score": 0.5}])"))
      << error_;
  std::vector<std::int64_t> stamps_ns;
  for (const DetectionFrame& frame : frames_) stamps_ns.push_back(frame.stamp_ns);
  EXPECT_EQ(stamps_ns, (std::vector<std::int64_t>{1311868164363181000, 1311868164399026000, 1311868164431129000,
                                                  1311868165000000000}));
}

TEST_F(DetectionReader, BadResultsOfCocoAreNamed) {
  const auto box = [](const std::string& id, const std::string& rest) {
    return R"([{"image_id": )" + id + R"(, "category_id": 41, )" + rest + "}]";
  };
  const std::string good = R"("score": 0.5, "bbox": [1, 2, 3, 4])";
  EXPECT_FALSE(read(box("42", good)));
  expect_error({"boxes.json: [0].image_id = 42 must be the stamp of the image", "integers count"});
  EXPECT_FALSE(read(box("\"left.png\"", good)));
  expect_error({"[0].image_id = \"left.png\" must be the stamp of the image in seconds"});
  EXPECT_FALSE(read(box("-1.5", good)));
  expect_error({"[0].image_id = -1.5"});
  EXPECT_FALSE(read(box("1.5", R"("score": 0.5)")));
  expect_error({"[0] has no 'bbox'"});
  EXPECT_FALSE(read(box("1.5", R"("score": 0.5, "bbox": [1, 2, 3])")));
  expect_error({"[0].bbox", "[x, y, w, h]"});
  EXPECT_FALSE(read(box("1.5", R"("bbox": [1, 2, 3, 4])")));
  expect_error({"[0] has no 'score'"});
  EXPECT_FALSE(read(R"([{"image_id": "1.5", "category_id": 12, "score": 0.5, "bbox": [1, 2, 3, 4]}])"));
  expect_error({"[0].category_id = 12 is no coco_id of the class table"});
  ASSERT_TRUE(read(box("1.5", R"("score": 0.5, "bbox": [5, 2, -3, 4])"))) << error_;
  expect_left_out(DetectionProblem::kBoxInverted, "boxes.json: [0]: box [5, 2, 2, 6]");
}

TEST_F(DetectionReader, LeavesOutAndCountsBadBoxes) {
  ASSERT_TRUE(read(one_box("91", "0.5", "[1, 2, 3, 4]"))) << error_;
  expect_left_out(DetectionProblem::kUnknownClass, "boxes.json: [0].detections[0]: class id 91");
  ASSERT_TRUE(read(one_box("41", "0.5", "[5, 2, 3, 4]"))) << error_;
  expect_left_out(DetectionProblem::kBoxInverted, "box [5, 2, 3, 4]");
  ASSERT_TRUE(read(one_box("41", "0.5", "[1, 2, 3, 2]"))) << error_;
  expect_left_out(DetectionProblem::kBoxInverted, "box [1, 2, 3, 2]");
  ASSERT_TRUE(read(one_box("41", "0.5", "[1, null, 3, 4]"))) << error_;
  expect_left_out(DetectionProblem::kBoxNotFinite, "box [1, nan, 3, 4]");
  ASSERT_TRUE(read(one_box("41", "1.5", "[1, 2, 3, 4]"))) << error_;
  expect_left_out(DetectionProblem::kScoreOutOfRange, "score 1.5");
  ASSERT_TRUE(read(one_box("41", "null", "[1, 2, 3, 4]"))) << error_;
  expect_left_out(DetectionProblem::kScoreOutOfRange, "score nan");
}

TEST_F(DetectionReader, CountsYoloProblemsWithFileAndLine) {
  directory_.write("yolo/1.0.txt", "41 1 2 30 40 0.5\n41 1 2 -30 40 0.5\n41 nan 2 30 40 0.5\n41 1 2 -3 40 0.5\n");
  ASSERT_TRUE(read_path(directory_.path("yolo"))) << error_;
  EXPECT_EQ(frames_[0].detections.size(), 1u);
  EXPECT_EQ(report_.cause(DetectionProblem::kBoxInverted).count, 2);
  EXPECT_NE(report_.cause(DetectionProblem::kBoxInverted).first.find("1.0.txt:2: box [1, 2, -29, 42]"),
            std::string::npos);
  EXPECT_NE(report_.cause(DetectionProblem::kBoxNotFinite).first.find("1.0.txt:3"), std::string::npos);
  EXPECT_EQ(report_.warnings().size(), 2u);
}

TEST_F(DetectionReader, KeepsTheFirstOfTwoImagesOfOneStamp) {
  ASSERT_TRUE(read(R"([
    {"file_name": "2.0.png", "detections": [{"category_id": 41, "detection_score": 0.5, "bbox": [1, 2, 3, 4]}]},
    {"file_name": "2.00.png", "detections": []}])"))
      << error_;
  ASSERT_EQ(frames_.size(), 1u);
  EXPECT_EQ(frames_[0].detections.size(), 1u);
  EXPECT_EQ(report_.cause(DetectionProblem::kDuplicateStamp).count, 1);
  EXPECT_NE(report_.warnings().at(0).find("1 images left out: stamp of an earlier image"), std::string::npos);
  EXPECT_NE(report_.warnings().at(0).find("[1].file_name = \"2.00.png\""), std::string::npos);
}

TEST_F(DetectionReader, MissingEmptyAndTruncatedFilesAreErrors) {
  EXPECT_FALSE(read_path(directory_.path("none.json")));
  expect_error({"none.json: cannot open the file"});
  EXPECT_FALSE(read(""));
  expect_error({"boxes.json: the file is empty"});
  EXPECT_FALSE(read("[]"));
  expect_error({"boxes.json: contains no image"});
  EXPECT_FALSE(read("[\n{\"file_name\": \"1.0.png\", \"detec"));
  expect_error({"boxes.json", "line 2"});
  EXPECT_FALSE(read("{}"));
  expect_error({"boxes.json: must be an array of images"});
  EXPECT_FALSE(read(one_box("41", "NaN", "[1, 2, 3, 4]")));
  expect_error({"boxes.json", "line 1"});
  std::filesystem::create_directory(directory_.path("empty"));
  EXPECT_FALSE(read_path(directory_.path("empty")));
  expect_error({"empty: contains no <stamp>.txt file"});
}

TEST_F(DetectionReader, SharesOfTheImageAreNoPixels) {
  directory_.write("yolo/1.0.txt", "56 0.9 0.43 0.8 0.31 0.88\n");
  EXPECT_FALSE(read_path(directory_.path("yolo")));
  expect_error({"yolo: boxes must be in pixels, these are shares of the image"});
  directory_.write("yolo/1.1.txt", "56 500 300 80 60 0.88\n");
  EXPECT_TRUE(read_path(directory_.path("yolo"))) << "a box in the corner may be so small";
}

TEST_F(DetectionReader, JsonOfAnotherShapeIsAnErrorThatNamesTheField) {
  EXPECT_FALSE(read(R"([{"detections": []}])"));
  expect_error({"boxes.json: [0] has no 'file_name'"});
  EXPECT_FALSE(read(R"([{"file_name": "left.png", "detections": []}])"));
  expect_error({"[0].file_name = \"left.png\""});
  EXPECT_FALSE(read(R"([{"file_name": "1.0.png"}])"));
  expect_error({"[0] has no 'detections'"});
  EXPECT_FALSE(read(R"([7])"));
  expect_error({"[0] = 7 must be an object"});
  EXPECT_FALSE(read(R"([[{"file_name": "1.0.png", "detections": []}]])"));
  expect_error({"[0] must be an object"});
  EXPECT_FALSE(read(R"({"images": [{"file_name": "1.0.png", "detections": []}]})"));
  expect_error({"boxes.json: must be an array of images"});
  EXPECT_FALSE(read(R"([{"file_name": "1.0.png", "detections": []}, 7, {"file_name": "left.png"}])"));
  expect_error({"[1] = 7 must be an object"});
  EXPECT_FALSE(read(one_box("\"cup\"", "0.5", "[1, 2, 3, 4]")));
  expect_error({"[0].detections[0].category_id = \"cup\""});
  EXPECT_FALSE(read(one_box("41", "\"high\"", "[1, 2, 3, 4]")));
  expect_error({"[0].detections[0].detection_score = \"high\""});
  EXPECT_FALSE(read(one_box("41", "0.5", "[1, 2, 3]")));
  expect_error({"[0].detections[0].bbox = [1,2,3]"});
  EXPECT_FALSE(read(one_box("41", "0.5", "[1, 2, 3, \"4\"]")));
  expect_error({"[0].detections[0].bbox"});
}

TEST_F(DetectionReader, NumbersThatDoNotFitAreErrors) {
  EXPECT_FALSE(read(one_box("41", "1e999", "[1, 2, 3, 4]")));
  expect_error({"boxes.json: [0]: 'detection_score': ", "1e999"});
  for (const char* id : {"4294967337", "-4294967255", "9223372036854775849", "18446744073709551615"}) {
    EXPECT_FALSE(read(one_box(id, "0.5", "[1, 2, 3, 4]"))) << "modulo 2^32 a cup";
    expect_error({"[0].detections[0].category_id = " + std::string(id), "must be an integer"});
  }
}

TEST_F(DetectionReader, OfTooManyBoxesTheBestAreTakenInTheirOrder) {
  std::vector<Detection> boxes;
  for (const double score : {0.3, 0.9, 0.5, 2.0, 0.5, 0.7}) boxes.push_back({41, score, {1.0, 2.0, 3.0, 4.0}});
  std::map<DetectionProblem, std::vector<std::size_t>> left_out;
  const auto note = [&left_out](std::size_t index, DetectionProblem problem, const std::string& /*value*/) {
    left_out[problem].push_back(index);
  };
  std::vector<double> scores;
  for (const Detection& box : usable_boxes(boxes, coco(), 3, note)) scores.push_back(box.score);
  EXPECT_EQ(scores, (std::vector<double>{0.9, 0.5, 0.7})) << "the first of two equal ones";
  EXPECT_EQ(left_out[DetectionProblem::kScoreOutOfRange], std::vector<std::size_t>{3}) << "not among the best";
  EXPECT_EQ(left_out[DetectionProblem::kTooMany], (std::vector<std::size_t>{4, 0}));

  ASSERT_TRUE(write_detections_json(directory_.path("many.json"), {{1, std::vector<Detection>(3500, boxes[0])}}));
  const auto recording = read_detections(directory_.path("many.json"), coco(), 200);
  ASSERT_TRUE(recording);
  EXPECT_EQ(recording->frames.at(0).detections.size(), 200U);
  EXPECT_EQ(recording->report.cause(DetectionProblem::kTooMany).count, 3300);
  EXPECT_EQ(recording->report.detections, 200);
  const std::string warning = recording->report.warnings().at(0);
  EXPECT_NE(warning.find("3300 boxes left out: more boxes in the image than association.boxes_max"), std::string::npos);
  EXPECT_NE(warning.find("[0].detections[200]: 3500 boxes"), std::string::npos) << warning;
}

TEST_F(DetectionReader, UnparsableYoloLinesAreErrorsThatNameTheLine) {
  const std::string path = directory_.path("yolo");
  directory_.write("yolo/1.0.txt", "41 1 2 30 40 0.5\n41 1 2 30 40\n");
  EXPECT_FALSE(read_path(path));
  expect_error({"1.0.txt:2: 5 columns instead of 6"});
  directory_.write("yolo/1.0.txt", "cup 1 2 30 40 0.5\n");
  EXPECT_FALSE(read_path(path));
  expect_error({"1.0.txt:1", "class 'cup' is no integer"});
  directory_.write("yolo/1.0.txt", "41 1 2 3O 40 0.5\n");
  EXPECT_FALSE(read_path(path));
  expect_error({"1.0.txt:1", "'3O' is no number"});
  directory_.write("yolo/1.0.txt", "");
  directory_.write("yolo/left.txt", "");
  EXPECT_FALSE(read_path(path));
  expect_error({"left.txt: the file name must be <stamp in seconds>.txt"});
}

TEST_F(DetectionReader, ReadsWhatTheWritersWrite) {
  std::vector<DetectionFrame> frames(3);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i].stamp_ns = 1500000000000000000 + static_cast<std::int64_t>(i) * 33333333;
    for (int k = 0; k < static_cast<int>(i); ++k)
      frames[i].detections.push_back({39 + k, 0.125, {1.5, 2.25, 30.125, 40.0}});
  }
  ASSERT_EQ(write_detections_json(directory_.path("out.json"), frames).message(), "");
  ASSERT_EQ(write_detections_yolo(directory_.path("out"), frames).message(), "");
  for (const char* name : {"out.json", "out"}) {
    ASSERT_TRUE(read_path(directory_.path(name))) << error_;
    ASSERT_EQ(frames_.size(), frames.size());
    for (std::size_t i = 0; i < frames.size(); ++i) {
      EXPECT_EQ(frames_[i].stamp_ns, frames[i].stamp_ns);
      ASSERT_EQ(frames_[i].detections.size(), frames[i].detections.size());
      for (std::size_t k = 0; k < frames[i].detections.size(); ++k) {
        EXPECT_EQ(frames_[i].detections[k].class_id, frames[i].detections[k].class_id);
        EXPECT_EQ(frames_[i].detections[k].score, frames[i].detections[k].score);
        EXPECT_EQ(frames_[i].detections[k].box.edges(), frames[i].detections[k].box.edges());
      }
    }
  }
  EXPECT_NE(write_detections_json(directory_.path("none/out.json"), frames).message().find("none/out.json"),
            std::string::npos);
}

TEST_F(DetectionReader, ADirectoryOfOtherImagesIsNotWrittenInto) {
  const std::vector<DetectionFrame> frames = {{1500000000, {}}};
  directory_.write("out/1.500000.txt", "41 1 2 30 40 0.5\n");
  directory_.write("out/README.md", "");
  ASSERT_EQ(write_detections_yolo(directory_.path("out"), frames).message(), "");
  EXPECT_EQ(read_whole(directory_.path("out/1.500000.txt")), "") << "replaced";
  directory_.write("out/1.500000.txt", "41 1 2 30 40 0.5\n");
  directory_.write("out/1.600000.txt", "");
  const std::string error = write_detections_yolo(directory_.path("out"), frames).message();
  EXPECT_NE(error.find("out/1.600000.txt: is of other detections"), std::string::npos) << error;
  EXPECT_NE(read_whole(directory_.path("out/1.500000.txt")), "") << "left alone";
}

TEST_F(DetectionReader, ReadsTheSharedRecordings) {
  const auto json = shared_data("tum/fr2_desk/detections_yolov5.json");
  const auto yolo = shared_data("tum/fr3_office/detections_yolov3");
  if (!json || !yolo) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  ASSERT_TRUE(read_path(*json)) << error_;
  EXPECT_EQ(frames_.size(), 2965u);
  EXPECT_TRUE(report_.warnings().empty());
  ASSERT_TRUE(read_path(*yolo)) << error_;
  EXPECT_EQ(frames_.size(), 2585u);
  for (std::size_t i = 1; i < frames_.size(); ++i) EXPECT_LT(frames_[i - 1].stamp_ns, frames_[i].stamp_ns);
}

}  // namespace
}  // namespace semantic_topo_loop::core
