#include "semantic_topo_loop/frontend/object_detector.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <opencv2/core/cuda.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "frontend/onnx_input.h"
#include "frontend/yolo_output.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "support/package_config.h"
#include "support/rolled_image.h"
#include "support/test_files.h"
#include "support/tiny_yolo.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kInput_px = 64;  ///< 8 x 8, 4 x 4 and 2 x 2 cells
constexpr int kCells = 64 + 16 + 4;
constexpr int kClasses = 3;

/// A network's output of zeros.
cv::Mat make_output(int rows, int columns) { return {std::vector<int>{1, rows, columns}, CV_32FC1, cv::Scalar(0.0)}; }

void set_row(cv::Mat* output, int row, const std::vector<double>& values) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    output->at<float>(0, row, static_cast<int>(i)) = static_cast<float>(values[i]);
  }
}

void expect_box(const Detection& detection, int class_id, double score, const Vec4& edges) {
  EXPECT_EQ(detection.class_id, class_id);
  EXPECT_NEAR(detection.score, score, 1e-6);
  EXPECT_LT((detection.box.edges() - edges).cwiseAbs().maxCoeff(), 1e-4) << detection.box.edges().transpose();
}

TEST(YoloOutput, LayoutsAreToldApartByShape) {
  const auto layout = [](int rows, int columns) {
    return find_yolo_layout(make_output(rows, columns), kInput_px, "auto");
  };
  EXPECT_EQ(checked(layout(kCells, 5 + kClasses)), YoloLayout::kYolox);
  EXPECT_EQ(checked(layout(3 * kCells, 5 + kClasses)), YoloLayout::kYolov5);
  EXPECT_EQ(checked(layout(4 + kClasses, kCells)), YoloLayout::kYolov8);
  EXPECT_EQ(layout(100, 6).message(), "the output is 1 x 100 x 6, which is not the shape of a YOLOX, YOLOv5 or YOLOv8");
  EXPECT_EQ(find_yolo_layout(make_output(kCells, 8), kInput_px, "yolov5").message(),
            "the output is 1 x 84 x 8, which is not that of yolov5");
  EXPECT_FALSE(find_yolo_layout(cv::Mat(3, 4, CV_32FC1), kInput_px, "auto"));
}

TEST(YoloOutput, ValuesThatAreNoneOfTheLayoutAreOneError) {
  cv::Mat yolox = make_output(kCells, 5 + kClasses);
  set_row(&yolox, 7, {0.5, 0.25, 1.0, -1.0, 1.0, 0.0, 1.0, 0.5});
  EXPECT_TRUE(check_yolo_values(yolox, YoloLayout::kYolox));
  set_row(&yolox, 7, {30.0, 20.0, 40.0, 8.0, 0.8, 0.1, 0.2, 0.5});
  EXPECT_EQ(check_yolo_values(yolox, YoloLayout::kYolox).message(),
            "the output 1 x 84 x 8 has boxes in pixels, a YOLOX's are in cells: export it without decoding");
  EXPECT_TRUE(check_yolo_values(make_output(3 * kCells, 5 + kClasses), YoloLayout::kYolov5));
  cv::Mat keypoints = make_output(4 + 4, kCells);  // one class, and the place of one point
  keypoints.at<float>(0, 0, 17) = 30.0F;
  EXPECT_TRUE(check_yolo_values(keypoints, YoloLayout::kYolov8));
  keypoints.at<float>(0, 5, 17) = 31.5F;
  EXPECT_EQ(
      check_yolo_values(keypoints, YoloLayout::kYolov8).message(),
      "the output 1 x 8 x 84 has scores from 0 to 31.5, not from 0 to 1: it is of another network, or of one that "
      "gives more than boxes");
}

TEST(YoloOutput, YoloxBoxesAreInTheirCells) {
  cv::Mat output = make_output(kCells, 5 + kClasses);
  // Of the second grid, of stride 16, the cell (1, 2).
  set_row(&output, 64 + 2 * 4 + 1, {0.5, 0.25, std::log(2.0), std::log(0.5), 0.8, 0.1, 0.2, 0.5});
  const std::vector<Detection> found = read_yolo(output, YoloLayout::kYolox, kInput_px, 0.3);
  ASSERT_EQ(found.size(), 1U);
  expect_box(found[0], 2, 0.4, {24.0 - 16.0, 36.0 - 4.0, 24.0 + 16.0, 36.0 + 4.0});
  EXPECT_TRUE(read_yolo(output, YoloLayout::kYolox, kInput_px, 0.41).empty());
}

TEST(YoloOutput, Yolov5AndYolov8BoxesAreInPixels) {
  cv::Mat v5 = make_output(3 * kCells, 5 + kClasses);
  set_row(&v5, 200, {30.0, 20.0, 10.0, 8.0, 0.5, 0.1, 0.8, 0.3});
  const std::vector<Detection> of_v5 = read_yolo(v5, YoloLayout::kYolov5, kInput_px, 0.3);
  ASSERT_EQ(of_v5.size(), 1U);
  expect_box(of_v5[0], 1, 0.4, {25.0, 16.0, 35.0, 24.0});

  cv::Mat v8 = make_output(4 + kClasses, kCells);
  const double values[] = {30.0, 20.0, 10.0, 8.0, 0.1, 0.4, 0.3};
  for (int i = 0; i < 7; ++i) v8.at<float>(0, i, 17) = static_cast<float>(values[i]);
  const std::vector<Detection> of_v8 = read_yolo(v8, YoloLayout::kYolov8, kInput_px, 0.3);
  ASSERT_EQ(of_v8.size(), 1U);
  expect_box(of_v8[0], 1, 0.4, {25.0, 16.0, 35.0, 24.0});
}

TEST(YoloOutput, NothingIsFoundWhereScoresAreNotNumbers) {
  cv::Mat output = make_output(kCells, 5 + kClasses);
  output.setTo(std::nan(""));
  EXPECT_TRUE(read_yolo(output, YoloLayout::kYolox, kInput_px, 0.0).empty());
}

TEST(YoloOutput, TheBestOfOverlappingBoxesOfAClassStays) {
  const Box box{0.0, 0.0, 10.0, 10.0}, beside{6.0, 0.0, 16.0, 10.0}, on_it{1.0, 0.0, 11.0, 10.0};
  const std::vector<Detection> kept = suppress_overlapping(
      {{1, 0.5, on_it}, {1, 0.9, box}, {2, 0.4, on_it}, {1, 0.3, beside}, {3, 0.2, box}, {3, 0.2, on_it}}, 0.5);
  ASSERT_EQ(kept.size(), 4U);
  expect_box(kept[0], 1, 0.9, box.edges());
  expect_box(kept[1], 2, 0.4, on_it.edges());
  expect_box(kept[2], 1, 0.3, beside.edges());
  expect_box(kept[3], 3, 0.2, box.edges());
}

TEST(ObjectDetectorOptions, InputIsOfWholeCells) {
  const auto with = [](const std::string& px) {
    return make_options<ObjectDetectorOptions>({{"detector.input_px", px}});
  };
  EXPECT_TRUE(with("640"));
  EXPECT_NE(with("417").message().find("detector.input_px"), std::string::npos) << with("417").message();
}

TEST(OnnxInput, IsWhatTheModelDeclares) {
  using testing::field, testing::onnx_input;
  const TestDirectory directory;
  const auto declared = [&directory](const std::string& bytes) {
    const DeclaredInput input = declared_input(directory.write("model.onnx", bytes));
    return std::pair(input.width_px, input.height_px);
  };
  const std::pair none(0, 0);
  const std::string weights = field(5, std::string(1000, 'w')), kernel = onnx_input({16, 3, 3, 3});
  const std::string model = field(2, "exporter") + field(7, weights + kernel + onnx_input({1, 3, 640, 640}));
  EXPECT_EQ(declared(model), std::pair(640, 640));
  EXPECT_EQ(declared(field(7, onnx_input({1, 3, 0, 0}))), none);
  EXPECT_EQ(declared(field(7, onnx_input({1, 3, 480, 640}))), std::pair(640, 480));
  for (std::size_t size = 0; size < model.size(); ++size) EXPECT_EQ(declared(model.substr(0, size)), none) << size;
  EXPECT_EQ(declared_input(directory.path("none.onnx")).width_px, 0);
}

TEST(ObjectDetector, AComputerThatCannotIsOneError) {
  if (cv::cuda::getCudaEnabledDeviceCount() > 0) GTEST_SKIP() << "it can";
  ObjectDetectorOptions options;
  options.model = "model.onnx";
  options.backend = "cuda";
  const auto detector = ObjectDetector::load(options, coco());
  ASSERT_FALSE(detector);
  EXPECT_NE(detector.message().find("detector.backend=cuda"), std::string::npos) << detector.message();
}

TEST(ObjectDetector, FilesThatAreNoModelAreOneError) {
  const TestDirectory directory;
  const auto refusal = [](const std::string& path) {
    ObjectDetectorOptions options;
    options.model = path;
    return ObjectDetector::load(options, coco()).message();
  };
  for (const std::string& path : {directory.write("empty.onnx", ""), directory.write("text.onnx", "no model\n"),
                                  directory.write("cut.onnx", testing::TinyYolo().onnx().substr(0, 5000))}) {
    EXPECT_EQ(refusal(path).find(path + ": cannot be read as an ONNX model: "), 0U) << refusal(path);
    EXPECT_EQ(refusal(path).find('\n'), std::string::npos);
  }
  EXPECT_EQ(refusal(directory.path("none.onnx")), directory.path("none.onnx") + ": cannot open the file");
  EXPECT_EQ(refusal(directory.path("")), directory.path("") + ": is a directory, not a file");
}

/// The networks of tiny_yolo.h, in a file.
class TinyNetwork : public ::testing::Test {
 protected:
  TinyNetwork() { write(); }
  void write() { options_.model = directory_.write("model.onnx", network_.onnx()); }
  std::unique_ptr<ObjectDetector> load() const {
    auto detector = ObjectDetector::load(options_, coco());
    EXPECT_TRUE(detector) << detector.message();
    return *std::move(detector);
  }
  std::string refusal() const { return ObjectDetector::load(options_, coco()).message(); }

  const TestDirectory directory_;
  testing::TinyYolo network_;
  ObjectDetectorOptions options_;
};

const cv::Scalar kRed(0, 0, 255), kGreen(0, 255, 0), kBlue(255, 0, 0);

cv::Mat painted(const cv::Size& size, const std::vector<std::pair<cv::Rect, cv::Scalar>>& rectangles) {
  cv::Mat image(size, CV_8UC3, cv::Scalar::all(90));
  for (const auto& [rectangle, color] : rectangles) image(rectangle).setTo(color);
  return image;
}

/// All that there is in detections, in order.
std::vector<double> values_of(const std::vector<Detection>& detections) {
  std::vector<double> values;
  for (const Detection& d : detections) {
    for (const double value : {static_cast<double>(d.class_id), d.score, d.box.x1, d.box.y1, d.box.x2, d.box.y2}) {
      values.push_back(value);
    }
  }
  return values;
}

class EveryLayout : public TinyNetwork, public ::testing::WithParamInterface<YoloLayout> {
 protected:
  EveryLayout() {
    network_.layout = GetParam();
    write();
  }
  /// Of the network's output, as errors tell it.
  static std::string shape(int cells) {
    return GetParam() == YoloLayout::kYolov8   ? "1 x 7 x " + std::to_string(cells)
           : GetParam() == YoloLayout::kYolov5 ? "1 x " + std::to_string(3 * cells) + " x 8"
                                               : "1 x " + std::to_string(cells) + " x 8";
  }
};

constexpr std::array<const char*, 3> kLayouts = {"yolox", "yolov5", "yolov8"};  ///< in the order of YoloLayout

const char* layout_name(YoloLayout layout) { return kLayouts[static_cast<std::size_t>(layout)]; }

INSTANTIATE_TEST_SUITE_P(Layouts, EveryLayout,
                         ::testing::Values(YoloLayout::kYolox, YoloLayout::kYolov5, YoloLayout::kYolov8),
                         [](const auto& test) { return layout_name(test.param); });

TEST_P(EveryLayout, FindsARectangleWhereItIsInImagesOfAllSizes) {
  for (const char* const stated : {"auto", layout_name(GetParam())}) {
    options_.layout = stated;
    const std::unique_ptr<ObjectDetector> detector = load();
    for (const cv::Size& size : {cv::Size(128, 128), cv::Size(640, 480), cv::Size(300, 401), cv::Size(64, 48),
                                 cv::Size(50, 90), cv::Size(400, 100)}) {
      const cv::Rect at(size.width / 5, size.height / 4, size.width / 2, size.height / 2);
      const std::vector<Detection> found = checked(detector->detect(painted(size, {{at, kRed}})));
      ASSERT_EQ(found.size(), 1U) << size;
      EXPECT_EQ(found[0].class_id, 0);
      EXPECT_NEAR(found[0].score, 0.993, 1e-3);
      const double pixel = std::max(size.width, size.height) / 128.0;  // of the input, in the image
      const Vec4 edges(at.x, at.y, at.br().x, at.br().y);
      EXPECT_LT((found[0].box.edges() - edges).cwiseAbs().maxCoeff(), 0.75 * std::max(1.0, pixel))
          << size << ' ' << found[0].box.edges().transpose();
    }
  }
}

TEST_P(EveryLayout, ClassesAreThoseOfTheNamesFile) {
  const cv::Mat image =
      painted({160, 120}, {{{10, 10, 40, 30}, kRed}, {{60, 45, 40, 30}, kGreen}, {{110, 80, 40, 30}, kBlue}});
  const auto ids = [this, &image] {
    std::set<int> found;
    for (const Detection& detection : checked(load()->detect(image))) found.insert(detection.class_id);
    return found;
  };
  EXPECT_EQ(ids(), (std::set<int>{0, 1, 2}));
  EXPECT_EQ(load()->warning(), options_.model +
                                   ": its 3 classes are taken for the ids 0 to 2 of the class table, which "
                                   "has others besides: are they? detector.names states them");
  options_.names = directory_.write("model.names",
                                    "\xEF\xBB\xBF"
                                    "chair \r\nunheard of\n\n\tbook\n");
  EXPECT_EQ(ids(), (std::set<int>{coco().find("chair")->id, coco().find("book")->id}));
  EXPECT_EQ(load()->warning(), options_.names + ": left out, since the class table has no such names: unheard of");
}

TEST_P(EveryLayout, ModelsAsTheyAreExportedRunOncePrepared) {
  const cv::Mat image = painted({128, 128}, {{{8, 8, 32, 48}, kRed}, {{56, 64, 48, 32}, kBlue}});
  options_.names = directory_.write("model.names", "chair\nunheard of\nbook\n");
  const std::vector<double> expected = values_of(checked(load()->detect(image)));
  ASSERT_EQ(expected.size(), 12U);
  network_.is_as_exported = true;
  write();
  const std::string prepared = directory_.path("prepared");
  const std::string command =
      STL_SOURCE_DIR "/scripts/prepare_model " + options_.model + ' ' + prepared + ".onnx > " + prepared + ".txt 2>&1";
  if (std::system(command.c_str()) != 0) {
    const std::string said = read_whole(prepared + ".txt");
    ASSERT_NE(said.find("module onnx, 1.12 or newer, is missing"), std::string::npos) << said;
    GTEST_SKIP() << said;
  }
  options_.model = prepared + ".onnx";
  options_.names = prepared + ".names";
  const std::vector<double> found = values_of(checked(load()->detect(image)));
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) EXPECT_NEAR(found[i], expected[i], 1e-3) << i;
}

TEST_P(EveryLayout, ScoresAreThoseOfTheNetwork) {
  const std::unique_ptr<ObjectDetector> detector = load();
  // 49 of the 64 pixels of a cell: of a logistic function at 20 (49 / 64 - 3 / 4).
  const cv::Mat image = painted({128, 128}, {{{33, 41, 7, 7}, kBlue}});
  const std::vector<Detection> found = checked(detector->detect(image));
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(found[0].score, 0.5775, 0.005);
  options_.score = 0.6;
  detector->set_options(options_);
  EXPECT_TRUE(checked(detector->detect(image)).empty());
}

TEST_P(EveryLayout, BoxesOfOneObjectAreOne) {
  const cv::Mat image = painted({128, 128}, {{{0, 64, 64, 64}, kRed}, {{64, 0, 64, 64}, kRed}});
  const std::unique_ptr<ObjectDetector> detector = load();
  EXPECT_EQ(checked(detector->detect(image)).size(), 2U);
  options_.nms_iou = 1.0;
  detector->set_options(options_);
  const std::size_t cells = 2 * (64 + 16 + 4), boxes = GetParam() == YoloLayout::kYolov5 ? 3 * cells : cells;
  EXPECT_EQ(checked(detector->detect(image)).size(), boxes);
}

TEST_P(EveryLayout, SameImageSameBoxesWhateverTheThreads) {
  const cv::Mat image = painted({320, 240}, {{{31, 17, 101, 83}, kRed}, {{150, 117, 111, 93}, kBlue}});
  const int threads = cv::getNumThreads();
  std::set<std::vector<double>> results;
  options_.nms_iou = 1.0;
  for (const int count : {1, 2, 3, 4}) {
    options_.threads = count;
    const std::unique_ptr<ObjectDetector> detector = load();
    for (int i = 0; i < 2; ++i) results.insert(values_of(checked(detector->detect(image))));
  }
  cv::setNumThreads(threads);
  EXPECT_EQ(results.size(), 1U);
  EXPECT_GT(results.begin()->size(), 6U * 30U);
}

TEST_P(EveryLayout, ARolledImageIsTurnedUpright) {
  const std::unique_ptr<ObjectDetector> detector = load();
  const cv::Size size(320, 240);
  const cv::Rect at(140, 60, 90, 50);
  const double roll_rad = 0.8, c = std::cos(roll_rad), s = std::sin(roll_rad);
  const cv::Mat image = testing::rolled(painted(size, {{at, kRed}}), roll_rad);
  const std::vector<Detection> found = checked(detector->detect(image, roll_rad));
  ASSERT_EQ(found.size(), 1U);
  // The box of the ellipse in the rectangle, both turned.
  const Vec2 middle(160.0, 120.0), from_middle = Vec2(at.x + 45.0, at.y + 25.0) - middle;
  const Vec2 center =
      middle + Vec2(c * from_middle.x() + s * from_middle.y(), c * from_middle.y() - s * from_middle.x());
  const Vec2 half(std::hypot(45.0 * c, 25.0 * s), std::hypot(45.0 * s, 25.0 * c));
  const Vec4 edges(center.x() - half.x(), center.y() - half.y(), center.x() + half.x(), center.y() + half.y());
  EXPECT_LT((found[0].box.edges() - edges).cwiseAbs().maxCoeff(), 3.0) << found[0].box.edges().transpose();
}

TEST_P(EveryLayout, OfAnImageOnItsSideItSeesWhatItSeesOfTheUprightOne) {
  const std::unique_ptr<ObjectDetector> detector = load();
  const cv::Mat upright = painted({320, 240}, {{{140, 60, 90, 50}, kRed}});
  cv::Mat on_its_side;
  cv::rotate(upright, on_its_side, cv::ROTATE_90_COUNTERCLOCKWISE);
  const std::vector<Detection> expected = checked(detector->detect(upright)),
                               found = checked(detector->detect(on_its_side, 0.5 * kPi));
  ASSERT_EQ(expected.size(), 1U);
  ASSERT_EQ(found.size(), 1U);
  const Box& box = expected[0].box;
  const Vec4 edges(box.y1, 320.0 - box.x2, box.y2, 320.0 - box.x1);
  EXPECT_LT((found[0].box.edges() - edges).cwiseAbs().maxCoeff(), 0.5) << found[0].box.edges().transpose();
}

TEST_P(EveryLayout, AnotherLayoutThanTheStatedOneIsOneError) {
  for (const std::string stated : kLayouts) {
    if (stated == layout_name(GetParam())) continue;
    options_.layout = stated;
    EXPECT_EQ(refusal(), options_.model + ": with an input of 128 x 128 px the output is " + shape(336) +
                             ", which is not that of " + stated + " (detector.input_px, detector.layout)");
  }
}

TEST_P(EveryLayout, AnOutputOfNoKnownShapeIsOneErrorWithIt) {
  network_.strides = {8, 16};
  write();
  EXPECT_EQ(refusal(),
            options_.model + ": with an input of 128 x 128 px the output is " + shape(320) +
                ", which is not the shape of a YOLOX, YOLOv5 or YOLOv8 (detector.input_px, detector.layout)");
}

TEST_P(EveryLayout, AnInputThatTheModelDoesNotTakeIsOneError) {
  options_.input_px = 96;
  const std::string expected = options_.model + ": with an input of 96 x 96 px it fails: ";
  EXPECT_EQ(refusal().find(expected), 0U) << refusal();
  EXPECT_EQ(refusal().find('\n'), std::string::npos);
}

TEST_F(TinyNetwork, NamesOfAnotherNumberThanItsClassesAreOneError) {
  options_.names = directory_.write("two.names", "book\nchair\n");
  EXPECT_EQ(refusal(),
            options_.names + ": 2 names, but the output of " + options_.model + " is 1 x 336 x 8, of 3 classes");
  options_.names = directory_.path("none.names");
  EXPECT_EQ(refusal(), options_.names + ": cannot open the file");
  options_.names = directory_.write("unknown.names", "one\ntwo\nthree\n");
  EXPECT_EQ(refusal(), options_.model + ": the class table has none of its 3 classes");
}

TEST_F(TinyNetwork, ImagesThatAreNoneAreOneError) {
  const std::unique_ptr<ObjectDetector> detector = load();
  EXPECT_EQ(detector->detect({}).message(), "image of 0 x 0 pixels and type CV_8UC1, not 8UC3 or 8UC1");
  EXPECT_FALSE(detector->detect(cv::Mat(4, 4, CV_32FC1)));
}

TEST_F(TinyNetwork, LooksAtNoMoreImagesThanAreWanted) {
  const auto due = [this](double rate_hz) {
    const std::unique_ptr<ObjectDetector> detector = load();
    options_.rate_hz = rate_hz;
    detector->set_options(options_);
    int count = 0;
    for (std::int64_t k = 0; k < 90; ++k) count += detector->is_due(1'305'031'102'000'000'000 + k * 33'333'333) ? 1 : 0;
    return count;
  };
  EXPECT_EQ(due(0.0), 90);
  EXPECT_EQ(due(10.0), 30);
  EXPECT_EQ(due(60.0), 90);
}

/// A real network on real images.
class YoloxNano : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto model = shared_detector(), folder = shared_folder("tum/fr1_xyz", "rgb.txt");
    if (!model) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set, or OpenCV too old";
    options_.model = *model;
    folder_ = *folder;
  }
  std::unique_ptr<ObjectDetector> load() const {
    auto detector = ObjectDetector::load(options_, coco());
    EXPECT_TRUE(detector) << detector.message();
    return *std::move(detector);
  }
  cv::Mat image(std::size_t index) const {
    const auto images = checked(list_color_images(folder_));
    return checked(read_color_image(std::next(images.begin(), static_cast<std::ptrdiff_t>(index))->second));
  }

  ObjectDetectorOptions options_;
  std::string folder_;
};

TEST_F(YoloxNano, DeclaresItsInput) { EXPECT_EQ(declared_input(options_.model).width_px, 416); }

TEST_F(YoloxNano, FindsWhatItIsKnownToFind) {
  const std::unique_ptr<ObjectDetector> detector = load();
  const std::vector<DetectionFrame> known =
      checked(read_detections(folder_ + "/detections_yolox_nano.json", coco())).frames;
  const auto images = checked(list_color_images(folder_));
  for (const std::size_t i : {0U, 300U, 650U}) {
    const auto [stamp_ns, path] = *std::next(images.begin(), i);
    const auto frame = std::find_if(known.begin(), known.end(), [stamp = stamp_ns](const DetectionFrame& k) {
      return std::abs(k.stamp_ns - stamp) < 1000;
    });
    ASSERT_NE(frame, known.end());
    const std::vector<Detection> found = checked(detector->detect(checked(read_color_image(path))));
    ASSERT_GE(found.size(), 2U);
    EXPECT_NEAR(static_cast<double>(found.size()), static_cast<double>(frame->detections.size()), 1.0);
    // Known from the images before they were compressed: the sure ones, roughly.
    for (const Detection& box : frame->detections) {
      if (box.score < 0.4) continue;
      const auto is_it = [&box](const Detection& f) {
        return f.class_id == box.class_id && std::abs(f.score - box.score) < 0.1 && iou(f.box, box.box) > 0.85;
      };
      EXPECT_TRUE(std::any_of(found.begin(), found.end(), is_it))
          << "image " << i << " class " << box.class_id << " score " << box.score;
    }
  }
}

TEST_F(YoloxNano, SameImageSameBoxesWhateverTheThreads) {
  const cv::Mat color = image(100);
  const auto boxes = [&color](ObjectDetector* detector) { return values_of(checked(detector->detect(color))); };
  const int threads = cv::getNumThreads();
  options_.threads = 2;
  const auto two = load();
  const std::vector<double> first = boxes(two.get());
  EXPECT_EQ(first, boxes(two.get()));
  options_.threads = 1;
  EXPECT_EQ(first, boxes(load().get()));
  cv::setNumThreads(threads);
}

TEST_F(YoloxNano, GrayImagesWillDo) {
  cv::Mat gray;
  cv::cvtColor(image(100), gray, cv::COLOR_BGR2GRAY);
  EXPECT_FALSE(checked(load()->detect(gray)).empty());
}

/// How many of the boxes found in an upright image are found in the same one rolled, as the boxes of their ellipses,
/// which turn with the image.
int count_found_again(const std::vector<Detection>& upright, const std::vector<Detection>& found, const cv::Mat& image,
                      double roll_rad) {
  const Vec2 middle(0.5 * image.cols, 0.5 * image.rows);
  const Eigen::Matrix2d turn = Eigen::Rotation2Dd(-roll_rad).toRotationMatrix();
  int count = 0;
  for (const Detection& box : upright) {
    const Vec2 center = middle + turn * (box.box.center() - middle);
    const Eigen::Matrix2d axes = turn * Vec2(0.5 * box.box.width(), 0.5 * box.box.height()).asDiagonal();
    const Vec2 half = axes.rowwise().norm();
    const Box turned =
        clip({center.x() - half.x(), center.y() - half.y(), center.x() + half.x(), center.y() + half.y()}, image.cols,
             image.rows);
    const auto is_it = [&](const Detection& f) { return f.class_id == box.class_id && iou(f.box, turned) > 0.6; };
    if (std::any_of(found.begin(), found.end(), is_it)) ++count;
  }
  return count;
}

TEST_F(YoloxNano, ARolledCameraFindsWhatAnUprightOneDoes) {
  const std::unique_ptr<ObjectDetector> detector = load();
  for (const double roll_rad : {-2.6, -1.0, 0.8, 1.6}) {
    int in_upright = 0, turned_upright = 0, as_it_is = 0;
    for (const std::size_t i : {100U, 300U, 500U, 700U}) {
      const cv::Mat upright = image(i), color = testing::rolled(upright, roll_rad);
      const std::vector<Detection> known = checked(detector->detect(upright));
      in_upright += static_cast<int>(known.size());
      turned_upright += count_found_again(known, checked(detector->detect(color, roll_rad)), color, roll_rad);
      as_it_is += count_found_again(known, checked(detector->detect(color)), color, roll_rad);
    }
    EXPECT_GT(turned_upright, 2 * in_upright / 5) << roll_rad << " of " << in_upright;
    EXPECT_GT(turned_upright, 2 * as_it_is) << roll_rad << " of " << in_upright;
  }
  // What is hardly rolled is looked at as it is.
  const cv::Mat color = image(100);
  const std::vector<Detection> as_it_is = checked(detector->detect(color)),
                               level = checked(detector->detect(color, 0.3));
  ASSERT_EQ(as_it_is.size(), level.size());
  for (std::size_t i = 0; i < level.size(); ++i) EXPECT_EQ(as_it_is[i].box.edges(), level[i].box.edges());
}

}  // namespace
}  // namespace semantic_topo_loop::core
