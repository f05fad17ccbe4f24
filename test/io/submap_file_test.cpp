#include "semantic_topo_loop/io/submap_file.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "support/synthetic_desk.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

std::vector<LocalMap> desk_submaps() {
  testing::RunSetup setup;
  setup.desk = testing::random_desk(1, 12);
  setup.visits = {{0.0, 14.0, 0.0, 90.0}};
  setup.end_s = 14.0;
  std::vector<LocalMap> submaps;
  testing::run(LoopOptions(), setup, [&submaps](const LoopDetector& detector) { submaps = detector.submaps(); });
  return submaps;
}

class SubmapFile : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::vector<LocalMap> submaps = desk_submaps();
    ASSERT_EQ(write_submaps(path_, submaps).message(), "");
  }
  nlohmann::json json() const { return nlohmann::json::parse(read_whole(path_)); }
  /// The error that a changed file gives.
  std::string error_of(const std::string& text) const {
    const std::string path = directory_.write("bad.json", text);
    const std::string error = read_submaps(path, *testing::desk_classes()).message();
    EXPECT_EQ(error.find(path), 0u) << error;
    EXPECT_EQ(error.find('\n'), std::string::npos) << error;
    return error.substr(std::min(error.size(), path.size() + 2));
  }
  std::string error_of(const nlohmann::json& json) const { return error_of(json.dump()); }

  TestDirectory directory_;
  const std::string path_ = directory_.path("submaps.json");
};

TEST_F(SubmapFile, KeepsWhatMatchingNeeds) {
  const std::vector<LocalMap> submaps = desk_submaps();
  const auto read = read_submaps(path_, *testing::desk_classes());
  ASSERT_TRUE(read) << read.message();
  ASSERT_EQ(read->size(), submaps.size());
  constexpr double kRounding = 2e-6;
  for (std::size_t i = 0; i < submaps.size(); ++i) {
    const LocalMap &a = submaps[i], &b = (*read)[i];
    EXPECT_EQ(a.keyframe_id, b.keyframe_id);
    EXPECT_EQ(a.stamp_ns, b.stamp_ns);
    EXPECT_EQ(a.end_frame, b.end_frame);
    EXPECT_EQ(a.check_frames, b.check_frames);
    EXPECT_EQ(a.up.certain, b.up.certain);
    EXPECT_TRUE(a.up.direction.isApprox(b.up.direction, kRounding));
    EXPECT_LT((a.T_odom_anchor.t - b.T_odom_anchor.t).norm(), kRounding);
    ASSERT_EQ(a.frames.size(), b.frames.size());
    for (std::size_t k = 0; k < a.frames.size(); ++k) {
      EXPECT_TRUE(a.frames[k].R_camera_local.isApprox(b.frames[k].R_camera_local, kRounding));
      EXPECT_LT((a.frames[k].t_camera_local - b.frames[k].t_camera_local).norm(), 10.0 * kRounding);
      ASSERT_EQ(a.frames[k].boxes.size(), b.frames[k].boxes.size());
      for (std::size_t n = 0; n < a.frames[k].boxes.size(); ++n) {
        EXPECT_EQ(a.frames[k].boxes[n].label, b.frames[k].boxes[n].label);
        EXPECT_EQ(a.frames[k].boxes[n].truncated, b.frames[k].boxes[n].truncated);
        EXPECT_LT((a.frames[k].boxes[n].box.edges() - b.frames[k].boxes[n].box.edges()).norm(), kRounding);
      }
    }
    ASSERT_EQ(a.objects.size(), b.objects.size());
    for (std::size_t k = 0; k < a.objects.size(); ++k) {
      EXPECT_EQ(a.objects[k].label, b.objects[k].label);
      EXPECT_EQ(a.objects[k].landmark_id, b.objects[k].landmark_id);
      EXPECT_LT((a.objects[k].spheroid.center - b.objects[k].spheroid.center).norm(), kRounding);
      ASSERT_EQ(a.objects[k].views.size(), b.objects[k].views.size());
      EXPECT_EQ(a.objects[k].views.back().frame, b.objects[k].views.back().frame);
    }
  }
}

/// The same with what frames with depth add.
std::vector<LocalMap> submaps_with_depth() {
  std::vector<LocalMap> submaps = desk_submaps();
  SubmapView& view = submaps[0].objects[0].views[0];
  view.depth_m = 1.25;
  view.truncated = 6;
  const Eigen::Vector3f normal = Eigen::Vector3f(1.0F, -2.0F, 2.0F) / 3.0F;
  submaps[0].surfels = std::make_shared<const std::vector<Surfel>>(
      std::vector<Surfel>{{{0.1F, -0.2F, 1.5F}, normal}, {{-0.3F, 0.0F, 2.0F}, -Eigen::Vector3f::UnitZ()}});
  return submaps;
}

TEST_F(SubmapFile, KeepsDepthsAndSurfaces) {
  const std::vector<LocalMap> submaps = submaps_with_depth();
  ASSERT_EQ(write_submaps(path_, submaps).message(), "");
  const auto read = read_submaps(path_, *testing::desk_classes());
  ASSERT_TRUE(read) << read.message();
  const SubmapView& view = (*read)[0].objects[0].views[0];
  EXPECT_EQ(view.depth_m, 1.25);
  EXPECT_EQ(view.truncated, 6);
  EXPECT_EQ((*read)[0].objects[0].views[1].depth_m, 0.0);
  ASSERT_NE((*read)[0].surfels, nullptr);
  ASSERT_EQ((*read)[0].surfels->size(), 2U);
  constexpr float kMillimetre = 0.001F;
  for (std::size_t i = 0; i < 2; ++i) {
    const Surfel &a = (*submaps[0].surfels)[i], &b = (*(*read)[0].surfels)[i];
    EXPECT_LT((a.position - b.position).norm(), kMillimetre);
    EXPECT_LT((a.normal - b.normal).norm(), kMillimetre);
    EXPECT_NEAR(b.normal.norm(), 1.0F, 1e-6F);
  }
  EXPECT_EQ((*read)[1].surfels, nullptr);
  nlohmann::json bad = json();
  bad["submaps"][0]["surfels"][1][5] = 0.5;
  EXPECT_EQ(error_of(bad), "submaps[0].surfels[1] has no unit normal");
  bad = json();
  bad["submaps"][0]["surfels"][1].erase(5);
  EXPECT_EQ(error_of(bad), "submaps[0].surfels[1] must have 6 numbers");
  bad = json();
  bad["submaps"][0]["objects"][0]["views"][0][5] = -1.0;
  EXPECT_EQ(error_of(bad), "submaps[0].objects[0].views[0][5] = -1.0 must be > 0");
  bad["submaps"][0]["objects"][0]["views"][0].erase(6);
  EXPECT_EQ(error_of(bad), "submaps[0].objects[0].views[0] must have 5 or 7 fields");
}

TEST_F(SubmapFile, IsTheSameBytesAgain) {
  const auto read = read_submaps(path_, *testing::desk_classes());
  ASSERT_TRUE(read);
  ASSERT_TRUE(write_submaps(directory_.path("again.json"), desk_submaps()));
  EXPECT_EQ(read_whole(path_), read_whole(directory_.path("again.json")));
}

TEST_F(SubmapFile, NamesFileAndFieldOfAnError) {
  EXPECT_EQ(error_of(std::string()), "the file is empty");
  EXPECT_NE(error_of(read_whole(path_).substr(0, 3000)).find("parse error at line 1, column 3001"), std::string::npos);
  EXPECT_NE(error_of(std::string("[]")).find("has no \"format\""), std::string::npos);
  nlohmann::json bad = json();
  bad["format"] = "semantic_topo_loop submaps 9";
  EXPECT_NE(error_of(bad).find("has no \"format\": \"semantic_topo_loop submaps 1\""), std::string::npos);
  bad = json();
  bad["submaps"] = nlohmann::json::array();
  EXPECT_EQ(error_of(bad), "the file holds no submap");
  bad = json();
  bad["submaps"][1].erase("up");
  EXPECT_EQ(error_of(bad), "submaps[1] has no 'up'");
  bad = json();
  bad["submaps"][0]["objects"][2]["class_id"] = 7;
  EXPECT_EQ(error_of(bad), "submaps[0].objects[2].class_id = 7 is no class that becomes a landmark in the class table");
  bad = json();
  bad["submaps"][0]["objects"][0]["views"][0][4] = 100000;
  EXPECT_EQ(error_of(bad), "submaps[0].objects[0].views[0][4] = 100000 is no index of a frame");
  bad = json();
  bad["submaps"][0]["frames"][3]["anchor_from_camera"][6] = 5.0;
  EXPECT_EQ(error_of(bad), "submaps[0].frames[3].anchor_from_camera holds a quaternion that is no rotation");
  bad = json();
  const std::size_t k = bad["submaps"][0]["check_frames"][1];  // the others keep no boxes
  bad["submaps"][0]["frames"][k]["boxes"][1][0] = nullptr;
  EXPECT_EQ(error_of(bad), "submaps[0].frames[" + std::to_string(k) + "].boxes[1][0] = null must be a finite number");
  bad = json();
  bad["submaps"][0]["frames"][3]["focal_px"] = "wide";
  EXPECT_EQ(error_of(bad), "submaps[0].frames[3].focal_px = \"wide\" must be an array");
}

TEST_F(SubmapFile, MissingFilesAndFoldersAreErrors) {
  EXPECT_EQ(read_submaps(directory_.path("none.json"), *testing::desk_classes()).message(),
            directory_.path("none.json") + ": cannot open the file");
  EXPECT_NE(write_submaps(directory_.path("no/such/folder.json"), {}).message().find("no/such/folder.json"),
            std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
