#include "semantic_topo_loop/io/rgbd_recording.h"

#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/stamp.h"
#include "support/package_config.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

class RgbdFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    cv::imwrite(path("color.png"), cv::Mat(24, 32, CV_8UC3, cv::Scalar(50, 50, 50)));
    cv::imwrite(path("depth.png"), cv::Mat(24, 32, CV_16UC1, cv::Scalar(10000)));
    cv::imwrite(path("small.png"), cv::Mat(12, 16, CV_16UC1, cv::Scalar(10000)));
    write("broken.png", "no image");
  }
  std::string path(const std::string& name) const { return directory_ + name; }
  void write(const std::string& name, const std::string& text) const { std::ofstream(path(name)) << text; }
  Result<RgbdFiles> read(const std::string& text) {
    write("associations.txt", text);
    return read_associations(path("associations.txt"), directory_);
  }
  Result<RgbdImage> read(const std::string& color, const std::string& depth) {
    DepthOptions options;
    options.scale = 5000.0;
    return read_rgbd_image({123, path(color), path(depth)}, small_camera(), options);
  }

  std::string directory_ = ::testing::TempDir() + "rgbd_folder_";
};

TEST_F(RgbdFolder, ReadsFourColumnsAndMore) {
  const auto files =
      read("# stamp rgb stamp depth\n1.000000001 rgb/a.png 1.01 depth/a.png\n2.5 rgb/b.png 2.5 depth/b.png 7\n");
  ASSERT_TRUE(files) << files.message();
  ASSERT_EQ(files->files.size(), 2u);
  EXPECT_EQ(files->files[0].stamp_ns, 1000000001);
  EXPECT_EQ(files->files[1].stamp_ns, 2500000000);
  EXPECT_NE(files->files[1].depth.find("depth/b.png"), std::string::npos);
  EXPECT_EQ(files->warning, "");
}

TEST_F(RgbdFolder, StampsThatGoBackAreLeftOutAndNamed) {
  const auto files = read("2.0 a 2.0 a\n1.0 b 1.0 b\n2.0 c 2.0 c\n3.0 d 3.0 d\n");
  ASSERT_TRUE(files);
  EXPECT_EQ(files->files.size(), 2u);
  EXPECT_NE(files->warning.find("2 images left out"), std::string::npos) << files->warning;
  EXPECT_NE(files->warning.find("associations.txt:2"), std::string::npos) << files->warning;
}

TEST_F(RgbdFolder, BadListsAreNamed) {
  EXPECT_NE(read("1.0 a 1.0\n").message().find("associations.txt:1: 3 columns"), std::string::npos);
  EXPECT_NE(read("1.0 a x d\n").message().find("'x' is no stamp"), std::string::npos);
  EXPECT_NE(read("# nothing\n").message().find("no images"), std::string::npos);
}

TEST(RgbdFolderAsDownloaded, IsJoinedByTheNearestStamps) {
  const TestDirectory directory;
  // 1.00 and 1.01 both are nearest to 1.008: the nearer takes it, and the other what is left within 0.02 s.
  directory.write("rgb.txt", "# timestamp filename\n1.00 a.png\n1.01 b.png\n2.00 c.png\n3.00 d.png\n4.00 e.png\n");
  directory.write("depth.txt", "1.008 A.png\n0.985 B.png\n2.019 C.png\n3.02 D.png\n3.981 E.png\n");
  const auto files = associate_images(directory.path(""));
  ASSERT_TRUE(files) << files.message();
  std::vector<std::string> pairs;
  for (const RgbdFile& file : files->files) {
    const auto name = [](const std::string& path) { return " " + path.substr(path.rfind('/') + 1); };
    pairs.push_back(format_stamp(file.stamp_ns) + name(file.color) + name(file.depth));
  }
  EXPECT_EQ(pairs, (std::vector<std::string>{"1.000000 a.png B.png", "1.010000 b.png A.png", "2.000000 c.png C.png",
                                             "4.000000 e.png E.png"}));
  EXPECT_NE(files->warning.find("4 of 5 color images of rgb.txt have one of depth.txt within 0.02 s"),
            std::string::npos)
      << files->warning;
}

TEST(RgbdFolderAsDownloaded, MissingListsAreNamed) {
  const TestDirectory directory;
  const std::string needed = " cannot open the file; a folder without associations.txt needs rgb.txt and depth.txt";
  EXPECT_EQ(associate_images(directory.path("none")).message(), directory.path("none/rgb.txt:") + needed);
  directory.write("rgb.txt", "1 a.png\n");
  EXPECT_EQ(associate_images(directory.path("")).message(), directory.path("depth.txt:") + needed);
}

TEST(RgbdFolderAsDownloaded, BadListsAreNamed) {
  const TestDirectory directory;
  const auto problem = [&directory](const std::string& rgb, const std::string& depth) {
    directory.write("rgb.txt", rgb);
    directory.write("depth.txt", depth);
    return associate_images(directory.path("")).message();
  };
  EXPECT_NE(problem("x a.png\n", "1 A.png\n").find("rgb.txt:1: 'x' is no stamp"), std::string::npos);
  EXPECT_NE(problem("1 a.png\n", "1 A.png\n2\n").find("depth.txt:2: 1 column"), std::string::npos);
  EXPECT_NE(problem("1 a.png\n", "# none\n").find("depth.txt: no images"), std::string::npos);
  EXPECT_NE(problem("1 a.png\n", "2 A.png\n").find("0 of 1 color images"), std::string::npos);
}

TEST(RgbdFolderAsDownloaded, IsJoinedAsTheBenchmarksScriptDoes) {
  const std::optional<std::string> folder = shared_folder("tum/fr1_xyz", "rgb.txt");
  if (!folder) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const auto files = associate_images(*folder);
  ASSERT_TRUE(files) << files.message();
  EXPECT_EQ(files->files.size(), 789u);
}

TEST_F(RgbdFolder, ReadsAnImage) {
  const auto image = read("color.png", "depth.png");
  ASSERT_TRUE(image) << image.message();
  EXPECT_EQ(image->stamp_ns, 123);
  EXPECT_FLOAT_EQ(image->depth_m.at<float>(3, 4), 2.0F);
  EXPECT_EQ(image->gray.at<std::uint8_t>(3, 4), 50);
}

TEST_F(RgbdFolder, ColorIsReadWhenItIsAskedFor) {
  for (const std::string name : {"color.png", "red.jpg"}) {
    cv::imwrite(path("red.jpg"), cv::Mat(24, 32, CV_8UC3, cv::Scalar(0, 0, 200)));
    DepthOptions options;
    options.scale = 5000.0;
    RgbdRecording recording = read_images({{1, path(name), path("depth.png")}}, small_camera(), options);
    const auto reading = recording.next();
    ASSERT_TRUE(reading && *reading && (*reading)->image) << name;
    const cv::Mat gray = (*reading)->image->gray;
    const Result<cv::Mat> color = (*reading)->color();
    ASSERT_TRUE(color) << color.message();
    ASSERT_EQ(color->type(), CV_8UC3);
    const auto pixel = color->at<cv::Vec3b>(5, 5);
    EXPECT_NEAR(gray.at<std::uint8_t>(5, 5), 0.114 * pixel[0] + 0.587 * pixel[1] + 0.299 * pixel[2], 1.5) << name;
    EXPECT_TRUE(recording.next());
    std::remove(path("red.jpg").c_str());
    EXPECT_EQ(static_cast<bool>((*reading)->color()), name == "color.png");
  }
}

TEST_F(RgbdFolder, BadImagesAreNamed) {
  EXPECT_NE(read("color.png", "missing.png").message().find("missing.png: no such file"), std::string::npos);
  EXPECT_NE(read("broken.png", "depth.png").message().find("broken.png: not an image"), std::string::npos);
  EXPECT_NE(read("color.png", "small.png").message().find("depth image of 16 x 12"), std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
