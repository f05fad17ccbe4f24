// The detector on recorded sequences: the same associations again in another world, after a restart, mirrored, and
// against another place.

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <utility>

#include "loop/submap/submap_builder.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/package_config.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFrameStep = 3;  ///< 10 Hz is plenty, and faster

struct Step {
  Frame frame;
  AssociationFrame associations;
  std::vector<LandmarkMerge> merged;
};
using Recording = std::vector<Step>;

/// Associates a sequence without closing loops.   @return empty without the shared data
Recording record(const std::string& sequence, const std::string& trajectory, const std::string& detections,
                 const std::string& camera_file, std::size_t max_frames) {
  const auto root = shared_folder("tum/" + sequence + "/", trajectory);
  Recording steps;
  if (!root) return steps;
  const auto classes = shared_coco();
  const auto poses = read_tum_trajectory(*root + trajectory);
  const auto camera = read_camera(STL_CONFIG_DIR "/camera/" + camera_file);
  const auto boxes = read_detections(*root + detections, *classes);
  EXPECT_TRUE(poses && camera && boxes) << poses.message() << camera.message() << boxes.message();
  if (!poses || !camera || !boxes) return steps;
  Options options;
  options.loop.enabled = false;
  ObjectSlam slam(options, classes);
  FrameBuilder builder(options.keyframe, *camera);
  for (std::size_t i = 0; i < std::min(poses->size(), max_frames); i += kFrameStep) {
    const auto frame = builder.build({(*poses)[i].stamp_ns, (*poses)[i].T_world_camera});
    const DetectionFrame* seen = find_stamp(boxes->frames, frame->stamp_ns, 1000);
    FrameResult result = slam.process(*frame, seen != nullptr ? &seen->detections : nullptr);
    std::vector<LandmarkMerge> merged = result.observation.merged;
    merged.insert(merged.end(), result.completion.merged.begin(), result.completion.merged.end());
    steps.push_back({*frame, std::move(result.associations), std::move(merged)});
  }
  return steps;
}

const Recording& office() {
  static const Recording recording =
      record("fr3_office", "groundtruth_frames.txt", "detections_yolov3", "tum_fr3.yaml", 2600);
  return recording;
}

const Recording& desk() {
  static const Recording recording =
      record("fr2_desk", "orbslam2_rgbd_trajectory.txt", "detections_yolov5.json", "tum_fr2.yaml", 2900);
  return recording;
}

/// Both recordings, the desk and the office.
class LoopData : public ::testing::TestWithParam<const Recording& (*)()> {
 protected:
  void SetUp() override {
    if (recording().empty()) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  }
  static const Recording& recording() { return GetParam()(); }
};
INSTANTIATE_TEST_SUITE_P(Recorded, LoopData, ::testing::Values(&desk, &office));

std::vector<LoopClosure> replay(const Recording& recording) {
  LoopDetector detector(LoopOptions(), shared_coco());
  std::vector<LoopClosure> loops;
  for (const Step& step : recording) {
    MapUpdate update;
    update.merged = step.merged;
    for (LoopClosure& loop : detector.detect(step.frame, step.associations)) loops.push_back(std::move(loop));
    detector.apply(update);
  }
  return loops;
}

std::set<std::pair<std::int64_t, std::int64_t>> accepted_pairs(const std::vector<LoopClosure>& loops) {
  std::set<std::pair<std::int64_t, std::int64_t>> pairs;
  for (const LoopClosure& loop : loops) {
    if (loop.accepted) pairs.emplace(loop.query_frame, loop.match_frame);
  }
  return pairs;
}

/// Appends a recording after another one, as a restart of the odometry 20 s later.
Recording append(Recording first, Recording second) {
  constexpr std::int64_t kIdOffset = 1'000'000;
  const Frame& last = first.back().frame;
  const std::int64_t frames = last.frame_id + 1, keyframes = last.keyframe_id + 1;
  const std::int64_t shift_ns = last.stamp_ns + 20'000'000'000 - second.front().frame.stamp_ns;
  second.front().frame.is_break = true;
  for (Step& step : second) {
    step.frame.frame_id += frames;
    step.frame.keyframe_id += keyframes;
    step.frame.stamp_ns += shift_ns;
    for (Association& association : step.associations.associations) {
      if (association.landmark_id >= 0) association.landmark_id += kIdOffset;
    }
    for (LandmarkMerge& merge : step.merged) {
      merge.merged_id += kIdOffset;
      merge.survivor_id += kIdOffset;
    }
    first.push_back(std::move(step));
  }
  return first;
}

/// Flips the world along x, and the images with it.
Recording mirrored(Recording recording) {
  const Mat3 flip = Vec3(-1.0, 1.0, 1.0).asDiagonal();
  for (Step& step : recording) {
    SE3& pose = step.frame.T_odom_camera;
    pose = SE3(Quaternion(Mat3(flip * pose.rotation() * flip)), flip * pose.t);
    const double width = step.frame.camera.width;
    step.frame.camera.cx = width - step.frame.camera.cx;
    for (Association& association : step.associations.associations) {
      association.box = {width - association.box.x2, association.box.y1, width - association.box.x1,
                         association.box.y2};
    }
  }
  return recording;
}

/// Candidates and accepted loops between the two halves.
std::pair<int, int> across(const std::vector<LoopClosure>& loops, std::int64_t first_frame_of_second) {
  int candidates = 0, accepted = 0;
  for (const LoopClosure& loop : loops) {
    if (loop.query_frame < first_frame_of_second || loop.match_frame >= first_frame_of_second) continue;
    ++candidates;
    accepted += loop.accepted ? 1 : 0;
  }
  return {candidates, accepted};
}

TEST_P(LoopData, TheOdometrysWorldDoesNotMatter) {
  const SE3 T_other_world(so3_exp(Vec3(2.0, -0.7, 1.1)), Vec3(4.0, -3.0, 2.0));
  Recording moved = recording();
  for (Step& step : moved) step.frame.T_odom_camera = T_other_world * step.frame.T_odom_camera;
  const auto pairs = accepted_pairs(replay(recording())), moved_pairs = accepted_pairs(replay(moved));
  ASSERT_GE(pairs.size(), 20u);
  std::size_t shared = 0;
  for (const auto& pair : pairs) shared += moved_pairs.count(pair);
  EXPECT_GE(static_cast<double>(shared), 0.95 * static_cast<double>(pairs.size()));
}

TEST_P(LoopData, LandmarksDoNotMatter) {
  // A correction of the map, a false one too, changes what the boxes are associated with, and not which loops are
  // found.
  Recording other = recording();
  std::int64_t id = 0;
  for (Step& step : other) {
    step.merged.clear();
    for (Association& association : step.associations.associations) {
      if (association.landmark_id < 0) continue;
      association.landmark_id = id++ % 1000;
      association.landmark_class_id = association.class_id;
    }
  }
  const auto pairs = accepted_pairs(replay(recording()));
  ASSERT_GE(pairs.size(), 20u);
  EXPECT_EQ(accepted_pairs(replay(other)), pairs);
}

TEST_P(LoopData, ClosesAcrossARestart) {
  const SE3 T_other_world(so3_exp(Vec3(0.5, 1.7, -1.1)), Vec3(-1.0, 3.0, 2.0));
  Recording restarted = recording();
  const std::size_t middle = restarted.size() / 2;
  for (std::size_t i = middle; i < restarted.size(); ++i) {
    restarted[i].frame.T_odom_camera = T_other_world * restarted[i].frame.T_odom_camera;
    for (Association& association : restarted[i].associations.associations) {
      if (association.landmark_id >= 0) association.landmark_id += 1'000'000;
    }
  }
  restarted[middle].frame.is_break = true;
  int right = 0, wrong = 0;
  for (const LoopClosure& loop : replay(restarted)) {
    const auto first = static_cast<std::int64_t>(middle);
    if (!loop.accepted || loop.query_frame < first || loop.match_frame >= first) continue;
    const SE3 truth = recording()[static_cast<std::size_t>(loop.match_frame)].frame.T_odom_camera.inverse() *
                      recording()[static_cast<std::size_t>(loop.query_frame)].frame.T_odom_camera;
    const bool is_right =
        (loop.T_match_query.t - truth.t).norm() < 0.35 && degrees(rotation_angle(loop.T_match_query.q, truth.q)) < 10.0;
    ++(is_right ? right : wrong);
  }
  EXPECT_GE(right, 20);
  EXPECT_LE(wrong, right / 100);
}

TEST(LoopDataOfTheOffice, ARunInAnUnknownFrameIsPlacedInAnEarlierMap) {
  if (office().empty()) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const SE3 T_other_world(so3_exp(Vec3(-0.4, 1.3, 2.1)), Vec3(2.0, -3.0, 1.0));
  const auto middle = office().begin() + static_cast<std::ptrdiff_t>(office().size() / 2);
  LoopDetector first(LoopOptions(), shared_coco()), second(LoopOptions(), shared_coco());
  for (auto step = office().begin(); step != middle; ++step) first.detect(step->frame, step->associations);
  second.set_earlier_map(first.submaps());
  for (auto step = middle; step != office().end(); ++step) {
    Frame frame = step->frame;
    frame.T_odom_camera = T_other_world * frame.T_odom_camera;
    second.detect(frame, step->associations);
  }
  const std::optional<Relocalisation> found = second.relocalisation();
  ASSERT_TRUE(found.has_value());
  const SE3 there = found->T_earlier_odom * T_other_world * office().back().frame.T_odom_camera;
  EXPECT_LT((there.t - office().back().frame.T_odom_camera.t).norm(), 0.1);
  EXPECT_LT(degrees(rotation_angle(there.q, office().back().frame.T_odom_camera.q)), 3.0);
  EXPECT_GE(found->agreeing, 20);
}

TEST_P(LoopData, TheMirrorImageIsNoLoop) {
  const auto [candidates, accepted] =
      across(replay(append(recording(), mirrored(recording()))), static_cast<std::int64_t>(recording().size()));
  EXPECT_GT(candidates, 100);
  EXPECT_EQ(accepted, 0);
}

TEST(LoopDataOfBoth, AnotherPlaceIsNoLoop) {
  if (desk().empty()) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const auto [candidates, accepted] =
      across(replay(append(desk(), office())), static_cast<std::int64_t>(desk().size()));
  EXPECT_GT(candidates, 0);
  EXPECT_EQ(accepted, 0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
