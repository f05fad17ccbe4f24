// Detector and pose graph together at default settings, on recorded boxes and odometry that drifts: what the README
// promises, with some room for other versions of the libraries. docs/benchmarks.md has every file.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/package_config.h"
#include "support/test_files.h"
#include "tools/evaluation/loop_evaluation.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop::core {
namespace {

struct Outcome {
  double ate_before_m = 0.0, ate_after_m = 0.0;
  int accepted = 0, judged = 0, right = 0;
  std::string name;

  /// Loops to or from an image without a true pose are left out, and not judged those in the motion capture's holes,
  /// whose poses are ORB-SLAM2's.
  void judge(const LoopClosure& loop, const TruePoses& truth) {
    const int query = truth.find(loop.query_stamp_ns), match = truth.find(loop.match_stamp_ns);
    if (query < 0 || match < 0) return;
    ++accepted;
    if (truth.in_hole(query) || truth.in_hole(match)) return;
    const SE3 T_match_query = truth.pose(match).inverse() * truth.pose(query);
    const double error_deg = degrees(rotation_angle(loop.T_match_query.q, T_match_query.q));
    ++judged;
    right += (loop.T_match_query.t - T_match_query.t).norm() <= kLoopLimits.wide_m && error_deg <= kLoopLimits.wide_deg;
  }
  double gain() const { return ate_before_m / ate_after_m; }
  double precision() const { return static_cast<double>(right) / static_cast<double>(judged); }
};

class DriftedData : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!shared_data("tum/fr3_office/drifted_real")) GTEST_SKIP() << "no drifted odometry in SEMANTIC_TOPO_LOOP_DATA";
  }

  /// @param file the odometry, a file of the sequence
  static Outcome run(const std::string& sequence, const std::string& file, const Options& options = {}) {
    const std::string path = *shared_data("tum/" + sequence + "/") + file;
    return run_on(checked(read_tum_trajectory(path)), sequence, file, options);
  }

  static Outcome run_on(const StampedPoses& odometry, const std::string& sequence, const std::string& name,
                        const Options& options = {}) {
    const bool is_desk = sequence == "fr2_desk";
    const std::string root = *shared_data("tum/" + sequence + "/");
    const auto classes = shared_coco();
    const auto boxes =
        checked(read_detections(root + (is_desk ? "detections_yolov5.json" : "detections_yolov3"), *classes));
    const Camera camera =
        checked(read_camera(STL_CONFIG_DIR "/camera/tum_fr" + std::string(is_desk ? "2" : "3") + ".yaml"));
    const StampedPoses mocap = checked(read_tum_ground_truth(root + "groundtruth.txt"));
    const TruePoses truth(checked(read_tum_ground_truth(root + "groundtruth_frames.txt")), mocap, 0.1);
    ObjectSlam slam(options, classes);
    FrameBuilder builder(options.keyframe, camera);
    Outcome outcome;
    outcome.name = sequence + " " + name;
    std::vector<Frame> frames;
    for (const StampedPose& pose : odometry) {
      const PoseSample sample{pose.stamp_ns, pose.T_world_camera};
      if (builder.is_held(sample)) continue;
      frames.push_back(*builder.build(sample));
      const DetectionFrame* seen = find_stamp(boxes.frames, pose.stamp_ns, 1000);
      for (const LoopClosure& loop : slam.process(frames.back(), seen != nullptr ? &seen->detections : nullptr).loops) {
        if (loop.accepted) outcome.judge(loop, truth);
      }
    }
    slam.process(builder.end(), nullptr);
    const std::vector<KeyframePose> keyframes = slam.pose_graph().keyframes();
    StampedPoses corrected;
    for (const Frame& frame : frames) {
      const KeyframePose& keyframe = keyframes[static_cast<std::size_t>(frame.keyframe_id)];
      const SE3& T_odom_keyframe = frames[static_cast<std::size_t>(keyframe.frame_id)].T_odom_camera;
      corrected.push_back({frame.stamp_ns, keyframe.T_map_camera * (T_odom_keyframe.inverse() * frame.T_odom_camera)});
    }
    outcome.ate_before_m = checked(evaluate_trajectory(odometry, mocap)).absolute_m.rmse;
    outcome.ate_after_m = checked(evaluate_trajectory(corrected, mocap)).absolute_m.rmse;
    return outcome;
  }
};

TEST_F(DriftedData, LoopsAreRightAndTakeTheDriftOut) {
  struct Case {
    const char *sequence, *file;
    double least_gain;  ///< some three quarters of what it is
    int least_loops;
    double least_precision;
  };
  const Case cases[] = {{"fr2_desk", "drifted/smooth_0.3m_5deg_s1.txt", 7.5, 200, 0.99},
                        {"fr2_desk", "drifted/jump_1m_15deg_s1.txt", 20.0, 150, 0.99},
                        {"fr2_desk", "drifted_real/walk_0.3m_5deg_s1.txt", 3.2, 200, 0.99},
                        {"fr2_desk", "drifted_real/slip_1m_15deg_s1.txt", 3.8, 100, 0.99},
                        {"fr3_office", "drifted/smooth_1m_15deg_s1.txt", 4.4, 20, 0.99},
                        {"fr3_office", "drifted_real/freeze_1m_15deg_s1.txt", 5.5, 20, 0.99}};
  for (const Case& c : cases) {
    const Outcome outcome = run(c.sequence, c.file);
    EXPECT_GT(outcome.gain(), c.least_gain) << outcome.name << " " << outcome.ate_before_m << " m before";
    EXPECT_GE(outcome.accepted, c.least_loops) << outcome.name;
    EXPECT_GE(outcome.precision(), c.least_precision) << outcome.name;
  }
}

/// What asks it thirty times a second is given its last pose again.
TEST_F(DriftedData, AnOdometryAtFiveHertzIsAsGood) {
  const std::string file = "drifted_real/walk_0.3m_5deg_s1.txt";
  StampedPoses odometry = checked(read_tum_trajectory(*shared_data("tum/fr2_desk/") + file));
  constexpr std::size_t kImages = 6;
  for (std::size_t i = 0; i < odometry.size(); ++i)
    odometry[i].T_world_camera = odometry[i / kImages * kImages].T_world_camera;
  const Outcome outcome = run_on(odometry, "fr2_desk", file + " at 5 Hz");
  EXPECT_GT(outcome.gain(), 2.5) << outcome.ate_before_m << " m before";
  EXPECT_GE(outcome.accepted, 100);
  EXPECT_GE(outcome.precision(), 0.99);
}

/// Lost for half a second and more, as those from images are, and found again.
TEST_F(DriftedData, AnOdometryThatCatchesUpIsAsGood) {
  const std::string file = "drifted_real/walk_0.3m_5deg_s1.txt";
  StampedPoses odometry = checked(read_tum_trajectory(*shared_data("tum/fr2_desk/") + file));
  constexpr std::size_t kEvery = 300, kLost = 25;
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    if (i % kEvery >= kEvery - kLost)
      odometry[i].T_world_camera = odometry[i / kEvery * kEvery + kEvery - kLost].T_world_camera;
  }
  const Outcome outcome = run_on(odometry, "fr2_desk", file + " with losses");
  EXPECT_GT(outcome.gain(), 2.5) << outcome.ate_before_m << " m before";
  EXPECT_GE(outcome.accepted, 150);
  EXPECT_GE(outcome.precision(), 0.99);
}

/// Clocks that are apart, or a filter.
TEST_F(DriftedData, AnOdometryThatIsLateGetsBetter) {
  const StampedPoses odometry =
      checked(read_tum_trajectory(*shared_data("tum/fr2_desk/") + "orbslam2_rgbd_trajectory.txt"));
  constexpr std::int64_t kDelay_ns = 100'000'000;
  StampedPoses late = odometry;
  std::size_t before = 0;
  for (StampedPose& pose : late) {
    const std::int64_t stamp_ns = std::max(pose.stamp_ns - kDelay_ns, odometry.front().stamp_ns);
    while (odometry[before + 1].stamp_ns <= stamp_ns) ++before;
    const StampedPose &p = odometry[before], &q = odometry[before + 1];
    const double share = static_cast<double>(stamp_ns - p.stamp_ns) / static_cast<double>(q.stamp_ns - p.stamp_ns);
    pose.T_world_camera = interpolate(p.T_world_camera, q.T_world_camera, share);
  }
  const Outcome outcome = run_on(late, "fr2_desk", "100 ms late");
  EXPECT_GT(outcome.ate_before_m, 0.018);
  EXPECT_LT(outcome.ate_after_m, 0.8 * outcome.ate_before_m);
  EXPECT_GE(outcome.accepted, 450);
  EXPECT_EQ(outcome.right, outcome.judged);
}

TEST_F(DriftedData, GoodOdometryStaysGood) {
  const Outcome outcome = run("fr2_desk", "orbslam2_rgbd_trajectory.txt");
  EXPECT_NEAR(outcome.ate_before_m, 0.0081, 0.0001);
  EXPECT_LE(outcome.ate_after_m, outcome.ate_before_m);
  EXPECT_GE(outcome.accepted, 500);
  EXPECT_EQ(outcome.right, outcome.judged);
}

/// Table III: 46 and 35 loops over the gap.
TEST_F(DriftedData, PaperModeFindsItsLoops) {
  Options options;
  options.loop.mode = "paper";
  const Outcome desk = run("fr2_desk", "orbslam2_rgbd_trajectory.txt", options);
  EXPECT_NEAR(desk.accepted, 46, 4);
  EXPECT_GE(desk.precision(), 0.85);
  const Outcome office = run("fr3_office", "groundtruth_frames.txt", options);
  EXPECT_NEAR(office.accepted, 35, 4);
  EXPECT_GE(office.precision(), 0.75);
}

}  // namespace
}  // namespace semantic_topo_loop::core
