#include <gtest/gtest.h>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/package_config.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/evaluation/trajectory_evaluation.h"
#include "tools/perturbation/perturbation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kStampTolerance_ns = 1000;

std::vector<MappedObject> mapped_objects(const ObjectSlam& slam, const ClassTable& classes) {
  std::vector<MappedObject> objects;
  for (const Landmark& landmark : slam.mapper().landmarks()) {
    if (!landmark.ellipsoid) continue;
    objects.push_back({landmark.id, landmark.class_id, classes.name(landmark.class_id), landmark.ellipsoid->center(),
                       landmark.ellipsoid->semi_axes, to_string(landmark.state), landmark.observations});
  }
  return objects;
}

/// The real recording fr2_desk: ORB-SLAM2's trajectory, YOLOv5's boxes, the vetted reference objects.
class RecordedDesk : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const auto directory = shared_folder("tum/fr2_desk/", "orbslam2_rgbd_trajectory.txt");
    if (!directory) return;
    classes_ = shared_coco();
    trajectory_ = checked(read_tum_trajectory(*directory + "orbslam2_rgbd_trajectory.txt"));
    const StampedPoses truth = checked(read_tum_ground_truth(*directory + "groundtruth.txt"));
    alignment_ = checked(evaluate_trajectory(trajectory_, truth)).alignment;
    detections_ = checked(read_detections(*directory + "detections_yolov5.json", *classes_)).frames;
    reference_ = checked(read_reference_objects(*directory + "reference_objects.csv"));
  }

  void SetUp() override {
    if (trajectory_.empty()) GTEST_SKIP() << "no recorded trajectory in SEMANTIC_TOPO_LOOP_DATA";
  }

  /// Maps every `stride`-th frame and judges the objects. Loops are off: this odometry does not drift.
  static ObjectEvaluation map_objects(const std::vector<DetectionFrame>& detections, std::size_t stride = 1,
                                      Options options = {}) {
    options.loop.enabled = false;
    ObjectSlam slam(options, classes_);
    FrameBuilder builder(options.keyframe, camera_fr2());
    for (std::size_t i = 0; i < trajectory_.size(); i += stride) {
      const Frame frame = checked(builder.build({trajectory_[i].stamp_ns, trajectory_[i].T_world_camera}));
      const DetectionFrame* seen = find_stamp(detections, frame.stamp_ns, kStampTolerance_ns);
      slam.process(frame, seen != nullptr ? &seen->detections : nullptr);
    }
    slam.process(builder.end(), nullptr);
    return evaluate_objects(mapped_objects(slam, *classes_), reference_, alignment_);
  }

  static inline std::shared_ptr<const ClassTable> classes_;
  static inline StampedPoses trajectory_;
  static inline Alignment alignment_;
  static inline std::vector<DetectionFrame> detections_;
  static inline std::vector<ReferenceObject> reference_;
};

TEST_F(RecordedDesk, EveryObjectIsMappedOnceUnderItsName) {
  const ObjectEvaluation e = map_objects(detections_);
  EXPECT_GE(e.certain.precision.value(), 0.95);
  EXPECT_GE(e.certain.recall.value(), 0.95);
  EXPECT_GE(e.certain.f(), 0.97);
  EXPECT_LT(e.center_m.median, 0.01);
}

TEST_F(RecordedDesk, SixFramesASecondSuffice) { EXPECT_GE(map_objects(detections_, 5).certain.f(), 0.92); }

TEST_F(RecordedDesk, MissedMislabelledAndShakenBoxesCostLittle) {
  PerturbationOptions worse;
  worse.drop = 0.3;
  worse.relabel = 0.1;
  worse.jitter = 0.03;
  double sum = 0.0;
  constexpr int kSeeds = 3;
  for (int seed = 101; seed < 101 + kSeeds; ++seed) {
    PerturbationCounts counts;
    sum += map_objects(perturb_detections(detections_, worse, static_cast<std::uint64_t>(seed), &counts)).certain.f();
  }
  EXPECT_GE(sum / kSeeds, 0.95);
}

/// What the mapping rules add to any association, and the joint assignment to bad detections.
TEST_F(RecordedDesk, MergingAndConfirmationDecidePrecision) {
  Options options;
  options.mapping.merge_duplicates = false;
  options.mapping.confirm_seen_s = 0.0;
  options.mapping.confirm_baseline_deg = 0.0;
  options.mapping.confirm_mean_iou = 0.0;
  options.mapping.confirm_seen_share = 0.0;
  options.mapping.confirm_quality = 0.0;
  EXPECT_LT(map_objects(detections_, 1, options).certain.precision.value(), 0.8);
}

/// fr1_xyz: real images and depth, a small real detector, objects marked by hand; the whole chain with its front end.
/// Every second and third image with boxes, and a half, too: what holds on the whole must not hang on it.
TEST(RecordedImages, ObjectsOfASmallDetectorHoldWithDepth) {
  const std::string directory = shared_data("tum/fr1_xyz").value_or("");
  const auto reference = read_reference_objects(directory + "/reference_objects.csv");
  if (!reference) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA has no tum/fr1_xyz";
  const auto camera = checked(read_camera(STL_CONFIG_DIR "/camera/tum_fr1.yaml"));
  const auto truth = checked(read_tum_ground_truth(directory + "/groundtruth.txt"));
  const auto files = checked(associate_images(directory)).files;
  const auto classes = shared_coco();
  const auto detections = checked(read_detections(directory + "/detections_yolox_nano.json", *classes)).frames;
  Options options;
  options.depth.scale = 5000.0;
  options.loop.enabled = false;

  struct Run {
    int stride;
    double until, f, strict;
  };
  const std::vector<Run> runs{{1, 1.0, 0.92, 0.8}, {2, 1.0, 0.92, 0.8}, {3, 1.0, 0.92, 0.8}, {1, 0.5, 0.88, 0.75}};
  std::vector<ObjectSlam> slams;
  for (std::size_t i = 0; i < runs.size(); ++i) slams.emplace_back(options, classes);
  RgbdFrontend frontend(options.frontend, camera);
  FrameBuilder builder(options.keyframe, camera);
  StampedPoses poses;
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto image = read_rgbd_image(files[i], camera, options.depth);
    ASSERT_TRUE(image) << image.message();
    const TrackedImage tracked = frontend.track(*image);
    if (!tracked.sample) continue;
    builder.set_camera(frontend.camera());
    const Frame frame = checked(builder.build(*tracked.sample));
    poses.push_back({frame.stamp_ns, frame.T_odom_camera});
    const DetectionFrame* seen = find_stamp(detections, frame.stamp_ns, kStampTolerance_ns);
    for (std::size_t k = 0; k < runs.size(); ++k) {
      if (static_cast<double>(i) > runs[k].until * static_cast<double>(files.size())) continue;
      const bool has_boxes = seen != nullptr && i % static_cast<std::size_t>(runs[k].stride) == 0;
      slams[k].process(frame, has_boxes ? &seen->detections : nullptr);
    }
  }
  const Alignment alignment = checked(evaluate_trajectory(poses, truth)).alignment;
  for (std::size_t k = 0; k < runs.size(); ++k) {
    slams[k].process(builder.end(), nullptr);
    const ObjectEvaluation e = evaluate_objects(mapped_objects(slams[k], *classes), *reference, alignment);
    EXPECT_GE(e.certain.f(), runs[k].f) << k;
    EXPECT_GE(e.strict.f(), runs[k].strict) << k;
    EXPECT_LE(e.center_m.median, 0.055) << k;
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
