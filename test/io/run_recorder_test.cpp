#include "semantic_topo_loop/io/run_recorder.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/random_poses.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kStart = 1500000000000000000, kPeriod = 33333333;

std::shared_ptr<const ClassTable> classes() {
  return std::make_shared<ClassTable>(*ClassTable::create({{41, "cup", ClassRole::kMovable, "", 0.1}}));
}

/// Ten frames with keyframes at 0 and 5; after frame 7 both keyframes move.
class RunRecorderTest : public ::testing::Test {
 protected:
  RunRecorderTest() : recorder_(make_run_recorder(classes(), directory_.path(""))) {
    RandomPoses random(31);
    T_map_odom_before_ = random.pose(1.0);
    T_map_odom_ = random.pose(1.0);
    for (int i = 0; i < 2; ++i) T_map_keyframe_.push_back(random.pose(1.0));
    for (int i = 0; i < 10; ++i) frames_.push_back(make_frame(i, random.pose(1.0)));
  }

  static Frame make_frame(int i, const SE3& T_odom_camera) {
    Frame frame;
    frame.frame_id = i;
    frame.stamp_ns = kStart + i * kPeriod;
    frame.is_keyframe = i % 5 == 0;
    frame.keyframe_id = i / 5;
    frame.is_break = i == 5;
    frame.T_odom_camera = T_odom_camera;
    return frame;
  }

  MapCorrection correction(int i) const {
    MapCorrection correction;
    correction.frame_id = i;
    correction.T_map_odom_old = i > 7 ? T_map_odom_ : T_map_odom_before_;
    correction.T_map_odom = i >= 7 ? T_map_odom_ : T_map_odom_before_;
    if (i != 7) return correction;
    correction.changed = true;
    for (int k = 0; k < 2; ++k) {
      correction.keyframes.push_back(
          {k, 5 * k, kStart + 5 * k * kPeriod, T_map_keyframe_[static_cast<std::size_t>(k)]});
    }
    correction.loops = {{0, 1, 0, true, "", false}, {1, 1, -1, false, "it is wrong", true}};
    correction.odometry = {
        0, 0.25, 0.5, 0.0, 0.0, 0.0, 1.5, 0.0625, {0.25, 0.5, 0.75, 1.0}, {{0, 1, true, 0.125, 2.0}}};
    return correction;
  }

  void record_frames(bool corrections) {
    for (const Frame& frame : frames_) {
      recorder_->record(frame);
      if (corrections) recorder_->record(correction(static_cast<int>(frame.frame_id)));
    }
  }

  void write() { ASSERT_EQ(recorder_->write(directory_.path("run")).message(), ""); }
  std::string text(const std::string& name) const { return read_whole(directory_.path("run/" + name)); }
  StampedPoses poses(const std::string& name) const {
    return checked(read_tum_trajectory(directory_.path("run/" + name)));
  }
  static void expect_pose(const SE3& actual, const SE3& expected) {
    EXPECT_NEAR((actual.matrix() - expected.matrix()).norm(), 0.0, 1e-7);
  }

  TestDirectory directory_;
  std::unique_ptr<RunRecorder> recorder_;
  std::vector<Frame> frames_;
  SE3 T_map_odom_before_;  ///< of a session that goes on with a map
  SE3 T_map_odom_;
  std::vector<SE3> T_map_keyframe_;
};

TEST_F(RunRecorderTest, BeforeABreakFramesHangOnTheirFinalKeyframes) {
  record_frames(true);
  write();
  const StampedPoses final_poses = poses("trajectory.txt");
  ASSERT_EQ(final_poses.size(), 10u);
  for (std::size_t i = 0; i < 10; ++i) {
    const std::size_t k = i / 5;
    EXPECT_EQ(final_poses[i].stamp_ns, frames_[i].stamp_ns);
    expect_pose(final_poses[i].T_world_camera,
                T_map_keyframe_[k] * frames_[5 * k].T_odom_camera.inverse() * frames_[i].T_odom_camera);
  }
}

TEST_F(RunRecorderTest, FramesLeadToTheNextKeyframe) {
  for (const Frame& frame : frames_) {
    recorder_->record(frame);
    MapCorrection steady = correction(static_cast<int>(frame.frame_id));
    for (OdometryFault& fault : steady.odometry.faults) fault.is_break = false;
    // The first keyframe stays, the second is half a metre off the odometry, straight ahead of the camera.
    if (steady.changed) {
      steady.keyframes[0].T_map_camera = frames_[0].T_odom_camera;
      steady.keyframes[1].T_map_camera = frames_[5].T_odom_camera * SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 0.5));
    }
    recorder_->record(steady);
  }
  write();
  const StampedPoses final_poses = poses("trajectory.txt");
  ASSERT_EQ(final_poses.size(), 10u);
  for (std::size_t i = 0; i < 10; ++i) {
    const double share = std::min(static_cast<double>(i) / 5.0, 1.0);
    expect_pose(final_poses[i].T_world_camera,
                i < 5 ? frames_[i].T_odom_camera * SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 0.5 * share))
                      : frames_[5].T_odom_camera * SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 0.5)) *
                            frames_[5].T_odom_camera.inverse() * frames_[i].T_odom_camera);
  }
}

TEST_F(RunRecorderTest, LivePosesUseTheCorrectionBeforeTheFrame) {
  record_frames(true);
  write();
  const StampedPoses live = poses("trajectory_live.txt");
  ASSERT_EQ(live.size(), 10u);
  for (std::size_t i = 0; i < 10; ++i) {
    expect_pose(live[i].T_world_camera, (i > 7 ? T_map_odom_ : T_map_odom_before_) * frames_[i].T_odom_camera);
  }
}

TEST_F(RunRecorderTest, WithoutCorrectionsBothTrajectoriesAreTheOdometry) {
  record_frames(false);
  write();
  for (const char* name : {"trajectory.txt", "trajectory_live.txt"}) {
    const StampedPoses written = poses(name);
    ASSERT_EQ(written.size(), 10u);
    for (std::size_t i = 0; i < 10; ++i) expect_pose(written[i].T_world_camera, frames_[i].T_odom_camera);
  }
}

TEST_F(RunRecorderTest, FramesThatWereGivenAnEarlierPoseWereOnTheWay) {
  const auto at = [](double x) { return SE3(Quaternion::Identity(), Vec3(x, 0.0, 0.0)); };
  for (const double x : {0.0, 0.1, 0.1, 0.1, 0.4}) {
    Frame frame = make_frame(static_cast<int>(frames_.size()), at(x));
    if (x == 0.4) frame.held_since_ns = frames_[frames_.size() - 3].stamp_ns;
    frames_.push_back(frame);
  }
  for (std::size_t i = 10; i < frames_.size(); ++i) recorder_->record(frames_[i]);
  write();
  const StampedPoses final_poses = poses("trajectory.txt"), live = poses("trajectory_live.txt");
  ASSERT_EQ(final_poses.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    expect_pose(final_poses[i].T_world_camera, at(0.1 * static_cast<double>(i)));
    expect_pose(live[i].T_world_camera, frames_[10 + i].T_odom_camera);
  }
}

TEST_F(RunRecorderTest, FramesBeyondTheSolutionUseTheLastMapFromOdom) {
  record_frames(true);
  Frame late = make_frame(10, SE3(Quaternion::Identity(), Vec3(1.0, 2.0, 3.0)));
  recorder_->record(late);
  write();
  expect_pose(poses("trajectory.txt").back().T_world_camera, T_map_odom_ * late.T_odom_camera);
}

TEST_F(RunRecorderTest, TheEndFrameIsNoFrame) {
  record_frames(true);
  Frame end = frames_.back();
  end.frame_id = 10;
  end.is_end = true;
  recorder_->record(end);
  recorder_->record(correction(10));
  write();
  EXPECT_EQ(poses("trajectory.txt").size(), 10u);
  const std::string timing = text("timing.csv");
  EXPECT_EQ(std::count(timing.begin(), timing.end(), '\n'), 11);
}

TEST_F(RunRecorderTest, KeyframesAreThoseOfTheTrajectory) {
  record_frames(true);
  write();
  const std::string keyframes = text("keyframes.csv");
  EXPECT_EQ(keyframes.rfind("keyframe_id,frame_id,stamp,x,y,z,qx,qy,qz,qw\n0,0,1500000000.000000,", 0), 0u);
  EXPECT_NE(keyframes.find("\n1,5,1500000000.166666665,"), std::string::npos);
  EXPECT_EQ(std::count(keyframes.begin(), keyframes.end(), '\n'), 3);
}

Landmark make_landmark(std::int64_t id, LandmarkState state, bool with_ellipsoid) {
  Landmark landmark;
  landmark.id = id;
  landmark.class_id = 41;
  landmark.state = state;
  landmark.observations = 12;
  landmark.baseline_deg = 30.5;
  landmark.mean_iou = 0.75;
  landmark.quality = 0.5;
  if (with_ellipsoid) {
    landmark.ellipsoid =
        Ellipsoid{SE3(Quaternion::Identity(), Vec3(static_cast<double>(id), 0.0, 1.0)), Vec3(0.1, 0.2, 0.3)};
  }
  return landmark;
}

TEST_F(RunRecorderTest, ObjectsAreTheLastStatesWithAnEllipsoid) {
  MapUpdate first;
  first.frame_id = 0;
  first.changed = {make_landmark(1, LandmarkState::kCandidate, true), make_landmark(2, LandmarkState::kCandidate, true),
                   make_landmark(3, LandmarkState::kCandidate, false),
                   make_landmark(4, LandmarkState::kCandidate, true),
                   make_landmark(9, LandmarkState::kCandidate, true)};
  MapUpdate second;
  second.frame_id = 1;
  second.changed = {make_landmark(1, LandmarkState::kConfirmed, true), make_landmark(9, LandmarkState::kRetired, true)};
  second.merged = {{2, 1}};
  second.removed = {4};
  recorder_->record(first);
  recorder_->record(second);
  write();
  EXPECT_EQ(text("objects.csv"),
            "id,class_id,label,x,y,z,qx,qy,qz,qw,a,b,c,state,observations,baseline_deg,mean_iou,quality\n"
            "1,41,cup,1.000000000,0.000000000,1.000000000,0.000000000,0.000000000,0.000000000,1.000000000,"
            "0.100000000,0.200000000,0.300000000,confirmed,12,30.500000,0.750000,0.500000\n"
            "9,41,cup,9.000000000,0.000000000,1.000000000,0.000000000,0.000000000,0.000000000,1.000000000,"
            "0.100000000,0.200000000,0.300000000,retired,12,30.500000,0.750000,0.500000\n");
  const auto objects = read_objects(directory_.path("run/objects.csv"));
  ASSERT_TRUE(objects);
  EXPECT_EQ(objects->at(1).id, 9);
}

LoopClosure make_loop(std::int64_t query, bool accepted) {
  LoopClosure loop;
  loop.query_frame = query;
  loop.match_frame = 1;
  loop.query_stamp_ns = kStart + query * 1000000;
  loop.match_stamp_ns = kStart;
  loop.query_begin = query - 1;
  loop.query_end = query + 1;
  loop.match_begin = 0;
  loop.match_end = 2;
  loop.accepted = accepted;
  loop.reason = accepted ? LoopReason::kAccepted : LoopReason::kTilt;
  loop.score = 1.25;
  loop.inliers = 7;
  loop.rms_m = 0.03;
  loop.reprojection_ratio = 0.7;
  return loop;
}

TEST_F(RunRecorderTest, LoopsInOrderOfFrameAndPosition) {
  recorder_->record(8, {make_loop(8, true), make_loop(7, false)}, 10.0);
  recorder_->record(5, {make_loop(5, false)}, 10.0);
  recorder_->record(6, {}, 10.0);
  write();
  const auto loops = read_loops(directory_.path("run/loops.csv"));
  ASSERT_TRUE(loops);
  ASSERT_EQ(loops->size(), 3u);
  EXPECT_EQ(loops->at(0).query_frame, 5);
  EXPECT_EQ(loops->at(1).query_frame, 8);
  EXPECT_EQ(loops->at(2).query_frame, 7);
  EXPECT_NE(text("loops.csv").find(",tilt,1.250000,7,"), std::string::npos);
  EXPECT_NE(text("loops.csv").find(",0.030000,0.000000,-1.000000,0.700000,-1,"), std::string::npos) << "its figures";
  EXPECT_NE(
      text("loops.csv").find("\n8,1,1500000000.008000,1500000000.000000,7,9,0,2,1,accepted,1.250000,7,0.000000000"),
      std::string::npos);
}

TEST_F(RunRecorderTest, ObjectsOfTheSubmapsOfAcceptedLoops) {
  LoopClosure loop = make_loop(8, true);
  loop.matches = {{3, 4}};
  loop.query_objects = {{3, 41, Vec3(1.0, 2.0, 3.0), 0.25}};
  loop.match_objects = {{4, 41, Vec3(1.5, 2.0, 3.0), 0.5}, {9, 41, Vec3(4.0, 5.0, 6.0), 0.125}};
  LoopClosure refused = loop, earlier = loop;
  refused.accepted = false;
  earlier.T_earlier_match = SE3();
  recorder_->record(8, {refused, loop, earlier}, 10.0);
  write();
  EXPECT_EQ(text("loop_objects.csv"),
            "query_frame,match_frame,query_end,match_end,is_query,pair,landmark_id,class_id,label,x,y,z,radius_m\n"
            "8,1,9,2,1,0,3,41,cup,1.000000000,2.000000000,3.000000000,0.250000\n"
            "8,1,9,2,0,0,4,41,cup,1.500000000,2.000000000,3.000000000,0.500000\n"
            "8,1,9,2,0,-1,9,41,cup,4.000000000,5.000000000,6.000000000,0.125000\n");
  const auto objects = read_loop_objects(directory_.path("run/loop_objects.csv"));
  ASSERT_TRUE(objects) << objects.message();
  ASSERT_EQ(objects->size(), 3u);
  EXPECT_FALSE(objects->at(2).is_query);
  EXPECT_EQ(objects->at(2).pair, -1);
  EXPECT_EQ(objects->at(2).object.position, Vec3(4.0, 5.0, 6.0));
  EXPECT_EQ(objects->at(2).label, "cup");
}

TEST_F(RunRecorderTest, MemoryOfTheProcessOnceASecondOfTheData) {
  for (std::int64_t i = 0; i < 25; ++i) {
    Frame frame;
    frame.frame_id = i;
    frame.stamp_ns = kStart + i * 100'000'000;
    recorder_->record(frame);
  }
  write();
  std::istringstream table(text("memory.csv"));
  std::string line;
  std::getline(table, line);
  EXPECT_EQ(line, "frame_id,resident_mb,peak_mb");
  for (const int frame_id : {0, 10, 20}) {
    ASSERT_TRUE(std::getline(table, line));
    int id = -1;
    double resident_mb = 0.0, peak_mb = 0.0;
    ASSERT_EQ(std::sscanf(line.c_str(), "%d,%lf,%lf", &id, &resident_mb, &peak_mb), 3) << line;
    EXPECT_EQ(id, frame_id);
    EXPECT_GT(resident_mb, 1.0);
    EXPECT_LT(resident_mb, 4096.0);
    EXPECT_GE(peak_mb, 0.99 * resident_mb);
  }
  EXPECT_FALSE(std::getline(table, line));
}

TEST_F(RunRecorderTest, LoopsIntoAnEarlierMapAreKeptApart) {
  const SE3 T_earlier_odom(so3_exp(Vec3(0.3, -0.2, 0.5)), Vec3(1.0, 2.0, 3.0));
  for (const Frame& frame : frames_) recorder_->record(frame);
  for (std::int64_t k = 5; k < 9; ++k) {
    LoopClosure loop = make_loop(5, true);
    loop.query_keyframe_id = 1;
    loop.T_earlier_match = SE3(so3_exp(Vec3(0.1, 0.0, 0.0)), Vec3(4.0, 0.0, 0.0));
    loop.T_match_query = loop.T_earlier_match->inverse() * T_earlier_odom * frames_[5].T_odom_camera;
    recorder_->record(k, {make_loop(k, true), loop}, 10.0);
  }
  recorder_->record(Relocalisation{T_earlier_odom, 4, 4});
  write();
  EXPECT_EQ(read_loops(directory_.path("run/loops.csv"))->size(), 4u);
  EXPECT_EQ(read_loops(directory_.path("run/relocalisations.csv"))->size(), 4u);
  const nlohmann::json summary = nlohmann::json::parse(text("summary.json"));
  EXPECT_EQ(summary["loops"]["accepted"], 4);
  EXPECT_EQ(summary["relocalisation"]["agreeing"], 4);
  EXPECT_NEAR(summary["relocalisation"]["earlier_map_from_odom"][1].get<double>(), 2.0, 1e-6);
}

TEST_F(RunRecorderTest, ThePlaceInAnEarlierMapIsAsLoopDetectionHadItLast) {
  const auto told = [this](int frame_id, const std::optional<Relocalisation>& relocalisation) {
    FrameResult result;
    result.associations.frame_id = result.observation.frame_id = frame_id;
    result.correction.frame_id = result.completion.frame_id = frame_id;
    result.loops.push_back(make_loop(5, true));
    result.loops.back().T_earlier_match = SE3();
    result.relocalisation = relocalisation;
    record(frames_[static_cast<std::size_t>(frame_id)], result, recorder_.get());
    write();
    return nlohmann::json::parse(text("summary.json"))["relocalisation"];
  };
  told(5, Relocalisation{SE3(Mat3::Identity(), Vec3(4.0, 0.0, 0.0)), 3, 3});
  const nlohmann::json moved = told(6, Relocalisation{SE3(Mat3::Identity(), Vec3(7.0, 0.0, 0.0)), 3, 4});
  EXPECT_EQ(moved["agreeing"], 3);
  EXPECT_EQ(moved["accepted"], 4);
  EXPECT_NEAR(moved["earlier_map_from_odom"][0].get<double>(), 7.0, 1e-6);
  EXPECT_TRUE(told(7, std::nullopt).is_null()) << "not of before a jump";
}

TEST_F(RunRecorderTest, AssociationsByNameOfLevel) {
  AssociationFrame frame;
  frame.frame_id = 3;
  frame.associations.resize(3);
  frame.associations[0].landmark_id = 5;
  frame.associations[0].level = AssociationLevel::kJoint;
  frame.associations[1].detection_index = 1;
  frame.associations[1].landmark_id = 6;
  frame.associations[2].detection_index = 2;
  frame.associations[2].level = AssociationLevel::kIgnored;
  recorder_->record(frame);
  write();
  EXPECT_EQ(text("associations.csv"),
            "frame_id,detection_index,landmark_id,level\n3,0,5,joint\n3,1,6,new\n3,2,-1,ignored\n");
}

TEST_F(RunRecorderTest, TimingAddsBothPhasesOfMapping) {
  recorder_->record(frames_[0]);
  AssociationFrame associations;
  associations.frame_id = 0;
  associations.duration_us = 1.5;
  recorder_->record(associations);
  MapUpdate update;
  update.frame_id = 0;
  update.duration_us = 2.0;
  recorder_->record(update);
  update.phase = MapUpdatePhase::kCorrection;
  update.duration_us = 0.25;
  recorder_->record(update);
  recorder_->record(0, {}, 3.0);
  MapCorrection correction;
  correction.frame_id = 0;
  correction.duration_us = 4.0;
  recorder_->record(correction);
  write();
  EXPECT_EQ(text("timing.csv"), "frame_id,association_us,mapping_us,loop_us,optimise_us\n0,1.5,2.2,3.0,4.0\n");
}

TEST_F(RunRecorderTest, SummaryCounts) {
  record_frames(true);
  AssociationFrame associations;
  associations.frame_id = 3;
  associations.associations.resize(2);
  recorder_->record(associations);
  MapUpdate update;
  update.changed = {make_landmark(1, LandmarkState::kConfirmed, true),
                    make_landmark(2, LandmarkState::kCandidate, false)};
  update.merged = {{7, 1}};
  recorder_->record(update);
  recorder_->record(8, {make_loop(8, true), make_loop(7, false)}, 10.0);
  write();
  const nlohmann::json summary = nlohmann::json::parse(text("summary.json"));
  EXPECT_EQ(summary, nlohmann::json::parse(R"({
    "frames": 10, "keyframes": 2, "breaks": 1, "detections": 2, "associations": {"new": 2},
    "landmarks": {"candidate": 1, "confirmed": 1}, "merges": 1, "corrections": 1,
    "loops": {"candidates": 2, "accepted": 1, "kept": 1, "reasons": {"accepted": 1, "tilt": 1}},
    "odometry": {"stated_edges": 0, "translation_m": 0.25, "rotation_rad": 0.5, "steady_translation": 0.0,
      "steady_rotation_rad": 0.0, "scale": 0.0, "loop_factor": 1.5, "delay_s": 0.0625,
      "short_term": {"step_m": 0.25, "step_rad": 0.5, "drift_mps": 0.75, "drift_radps": 1.0}, "faults": [
        {"from_keyframe": 0, "to_keyframe": 1, "kind": "break", "translation_m": 0.125, "rotation_rad": 2.0,
         "frozen_s": 0.0, "slipped_s": 0.0}]}})"));
}

TEST_F(RunRecorderTest, VerdictsNameTheirFrames) {
  record_frames(true);
  write();
  EXPECT_EQ(text("loop_verdicts.csv"),
            "query_keyframe,match_keyframe,query_frame,match_frame,extra,kept,verdict\n"
            "1,0,5,0,0,1,kept\n1,-1,5,-1,1,0,it is wrong\n");
}

TEST_F(RunRecorderTest, FramesFollowTheScaleOfTheirKeyframe) {
  constexpr double kScale = 0.5;
  for (const Frame& frame : frames_) {
    recorder_->record(frame);
    MapCorrection with_scale = correction(static_cast<int>(frame.frame_id));
    if (with_scale.changed) with_scale.keyframes[1].scale = kScale;
    recorder_->record(with_scale);
  }
  LoopClosure loop = make_loop(8, true);
  loop.scale = 1.25;
  loop.scale_covariance(6) = 0.0004;
  recorder_->record(8, {loop, make_loop(7, false)}, 10.0);
  write();
  const StampedPoses optimised = poses("trajectory.txt");
  ASSERT_EQ(optimised.size(), 10U);
  for (std::size_t i = 5; i < 10; ++i) {
    SE3 T_keyframe_camera = frames_[5].T_odom_camera.inverse() * frames_[i].T_odom_camera;
    T_keyframe_camera.t *= kScale;
    expect_pose(optimised[i].T_world_camera, T_map_keyframe_[1] * T_keyframe_camera);
  }
  EXPECT_EQ(text("scales.csv"), "keyframe_id,frame_id,scale\n0,0,1.000000\n1,5,0.500000\n");
  const std::string ends = std::to_string(loop.query_frame) + "," + std::to_string(loop.match_frame);
  EXPECT_EQ(text("loop_scales.csv"),
            "query_frame,match_frame,accepted,scale,sigma_log\n" + ends + ",1,1.250000,0.020000\n");
}

TEST_F(RunRecorderTest, AFixedScaleLeavesNoFileOfScales) {
  record_frames(true);
  recorder_->record(8, {make_loop(8, true)}, 10.0);
  directory_.write("run/scales.csv", "of a run before\n");
  write();
  EXPECT_FALSE(std::filesystem::exists(directory_.path("run/scales.csv")));
  EXPECT_FALSE(std::filesystem::exists(directory_.path("run/loop_scales.csv")));
}

TEST_F(RunRecorderTest, AnEmptyRunStillWritesEveryFile) {
  write();
  for (const char* name :
       {"trajectory_live.txt", "trajectory.txt", "keyframes.csv", "objects.csv", "loops.csv", "loop_verdicts.csv",
        "loop_objects.csv", "associations.csv", "timing.csv", "memory.csv", "summary.json"}) {
    EXPECT_TRUE(std::filesystem::exists(directory_.path(std::string("run/") + name))) << name;
  }
}

TEST_F(RunRecorderTest, AnUnwritableDirectoryIsAnError) {
  directory_.write("file", "");
  EXPECT_NE(recorder_->write(directory_.path("file")).message().find(directory_.path("file")), std::string::npos);
}

/// Twenty minutes of a run whose stages tell of a frame some frames late.
class LongRun {
 public:
  explicit LongRun(std::int64_t late) : late_(late) {}

  void play(RunRecorder* recorder, std::int64_t begin, std::int64_t end) const {
    for (std::int64_t i = begin; i < end; ++i) {
      Frame frame;
      frame.frame_id = i;
      frame.stamp_ns = kStart + i * 100'000'000;
      frame.is_keyframe = i % 10 == 0;
      frame.keyframe_id = i / 10;
      frame.is_break = i == 999 || i == 1999;
      frame.T_odom_camera.t.x() = 0.001 * static_cast<double>(i);
      recorder->record(frame);
      if (i >= late_) tell(recorder, i - late_);
    }
    for (std::int64_t i = end - late_; i < end; ++i) tell(recorder, i);
  }

 private:
  static void tell(RunRecorder* recorder, std::int64_t i) {
    AssociationFrame associations;
    associations.frame_id = i;
    associations.associations.resize(3);
    recorder->record(associations);
    LoopClosure loop;
    loop.query_keyframe_id = i / 10;
    loop.query_frame = 10 * loop.query_keyframe_id;
    loop.match_frame = i / 2;
    loop.accepted = i % 7 == 0;
    loop.reason = loop.accepted ? LoopReason::kAccepted : LoopReason::kResidual;
    loop.scale_covariance(6) = i % 5 == 0 ? 0.01 : 0.0;
    LoopClosure into_earlier = loop;
    into_earlier.T_earlier_match = SE3(Quaternion::Identity(), Vec3(5.0, 0.0, 0.0));
    into_earlier.T_match_query.t.x() = 0.001 * static_cast<double>(loop.query_frame);
    recorder->record(i, {loop, into_earlier}, 1.0);
    MapCorrection correction;
    correction.frame_id = i;
    correction.T_map_odom.t.y() = 0.01 * static_cast<double>(i / 100);
    recorder->record(correction);
  }
  std::int64_t late_;
};

TEST_F(RunRecorderTest, ALongRunsTablesAreCompleteHoweverLateItsStagesAndWheneverItIsSaved) {
  constexpr std::int64_t kFrames = 12'000;
  const std::unique_ptr<RunRecorder> late = make_run_recorder(classes(), directory_.path(""));
  LongRun(0).play(recorder_.get(), 0, kFrames / 2);
  write();
  LongRun(0).play(recorder_.get(), kFrames / 2, kFrames);
  write();
  LongRun(40).play(late.get(), 0, kFrames);
  ASSERT_TRUE(late->write(directory_.path("late")));
  for (const char* name :
       {"trajectory_live.txt", "trajectory.txt", "loops.csv", "relocalisations.csv", "loop_scales.csv",
        "loop_objects.csv", "associations.csv", "timing.csv", "summary.json", "keyframes.csv"}) {
    EXPECT_TRUE(text(name) == read_whole(directory_.path(std::string("late/") + name))) << name;
  }
  const std::string live = text("trajectory_live.txt"), loops = text("loops.csv");
  EXPECT_EQ(std::count(live.begin(), live.end(), '\n'), kFrames);
  EXPECT_EQ(std::count(loops.begin(), loops.end(), '\n'), kFrames + 1);
  const auto summary = nlohmann::json::parse(text("summary.json"));
  EXPECT_EQ(summary["breaks"], 2);
  EXPECT_EQ(summary["detections"], 3 * kFrames);
  EXPECT_EQ(summary["loops"]["candidates"], kFrames);
}

TEST_F(RunRecorderTest, RowsThatTheDiskDoesNotTakeYetAreNotLost) {
  const std::string late = directory_.path("late");
  const std::unique_ptr<RunRecorder> recorder = make_run_recorder(classes(), late);
  const LongRun run(0);
  run.play(recorder.get(), 0, 6'000);
  std::filesystem::create_directory(late);
  run.play(recorder.get(), 6'000, 12'000);
  run.play(recorder_.get(), 0, 12'000);
  write();
  const std::string whole = text("loops.csv");
  ASSERT_EQ(recorder->write(directory_.path("run")).message(), "");
  EXPECT_TRUE(text("loops.csv") == whole);
}

TEST_F(RunRecorderTest, ALongRunNeedsNoTemporaryDirectory) {
  const char* folder = std::getenv("TMPDIR");
  const std::string usual = folder != nullptr ? folder : "";
  ::setenv("TMPDIR", directory_.path("none").c_str(), 1);
  LongRun(0).play(recorder_.get(), 0, 12'000);
  usual.empty() ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", usual.c_str(), 1);
  write();
}

}  // namespace
}  // namespace semantic_topo_loop::core
