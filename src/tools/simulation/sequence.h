#pragma once

#include <array>
#include <map>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/perturbation/perturbation.h"
#include "tools/simulation/detector.h"
#include "tools/simulation/motion.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// The simulated RGB-D camera. Its depth camera has the intrinsics of the color camera.
struct RenderingOptions {
  bool noise = true;
  double depth_scale = 5000.0;
  int far_value = 0;
  double depth_delay_s = 0.008;
  double depth_offset_m = 0.0;
  double depth_slope = 0.0;

  void visit(OptionVisitor& visitor) {
    visitor.module("rendering");
    visitor("noise", noise, "errors and holes of a Kinect; false: ideal colors and depths");
    // 16 bits must reach the camera's 6 m, and a step must not exceed a centimetre.
    visitor("depth_scale", depth_scale, between(100, 10000), "PNG: units a metre; 5000 as TUM's, 1000 for millimetres");
    visitor("far_value", far_value, any(), "PNG: value of what is out of range, 0 or 65535; other holes are 0");
    visitor("depth_delay_s", depth_delay_s, between(-0.1, 0.1),
            "from a color image to its depth image, each taken at its own time; Kinects have some 10 ms");
    visitor("depth_offset_m", depth_offset_m, between(-0.2, 0.2),
            "how far right of the color camera the depth camera sits; 0: depth is registered to the color image");
    visitor("depth_slope", depth_slope, between(-0.2, 0.2),
            "share by which depth is too large at the right edge and too small at the left, as of a depth camera that "
            "was never calibrated: an odometry from its images drifts");
    visitor.require("far_value", far_value == 0 || far_value == 65535, "0 or 65535");
  }
};

struct SimulationOptions {
  int seed = 1;
  std::string odometry_frame = "first_camera";
  SceneOptions scene;
  TrajectoryOptions trajectory;
  DriftOptions drift;
  DynamicsOptions dynamics;
  DetectorOptions detector;
  RenderingOptions rendering;

  void visit(OptionVisitor& visitor) {
    visitor.module("simulation");
    visitor("seed", seed, not_negative(), "of everything that is random");
    visitor("odometry_frame", odometry_frame, one_of({"first_camera", "random", "world"}),
            "world of the odometry: first_camera (its first pose is the identity), random, or world (as the truth)");
    scene.visit(visitor);
    trajectory.visit(visitor);
    visitor.require("first_desk", trajectory.first_desk <= scene.desk_count(), "a desk of the scene");
    visitor.require("desks", trajectory.first_desk - 1 + trajectory.desks <= scene.desk_count(),
                    "no more than the scene has from trajectory.first_desk on");
    drift.visit(visitor);
    dynamics.visit(visitor);
    visitor.require("move_time_s", !dynamics.changes_objects() || dynamics.move_time_s < trajectory.duration_s,
                    "before the end of the sequence");
    detector.visit(visitor);
    rendering.visit(visitor);
  }
};

/// Streams of the seed; one a component, so that the options of one leave the others as they are.
enum class SeedStream : std::uint64_t {
  kScene = 1,
  kTrajectory,
  kDrift,
  kDetector,
  kOdometryFrame,
  kDynamics,
  kTextures,
  kImageNoise,
  kScaleDrift
};

inline std::uint64_t seed_of(const SimulationOptions& options, SeedStream stream) {
  const bool is_of_scene = stream == SeedStream::kScene || stream == SeedStream::kTextures;
  const int seed = is_of_scene && options.scene.seed >= 0 ? options.scene.seed : options.seed;
  return static_cast<std::uint64_t>(seed) * 16 + static_cast<std::uint64_t>(stream);
}

/// What a recorded sequence has, with the truth.
struct SimulatedSequence {
  Camera camera;
  Scene scene;
  StampedPoses mocap;     ///< T_world_camera at 100 Hz, from before the first to after the last image
  StampedPoses truth;     ///< T_world_camera at the images
  StampedPoses depth;     ///< T_world_camera of the color camera at the depth images, one an image
  StampedPoses odometry;  ///< T_odom_camera at the images, drifted
  std::vector<std::vector<SimulatedDetection>> detections;  ///< one vector an image

  /// From the first image.
  double time_s(std::size_t frame) const {
    return 1e-9 * static_cast<double>(truth[frame].stamp_ns - truth.front().stamp_ns);
  }
};

/// The same options, camera and classes give the same sequence, bit for bit.
/// @return an error that names parameter and value for invalid options or a drift level that cannot be met
Result<SimulatedSequence> simulate(const SimulationOptions& options, const Camera& camera, const ClassTable& classes);

/// What a sequence's detections show of an object, at the place where it is at the end.
struct SimulatedReference {
  int object = -1;            ///< index in Scene::objects
  int views = 0;              ///< boxes that belong to it
  int whole_frames = 0;       ///< frames that have it whole in the image
  double baseline_deg = 0.0;  ///< largest angle between two rays to its centre, of those that saw it
  double mean_iou = 0.0;      ///< of the boxes with its true ones, clipped to the image
  double median_iou = 0.0;
  double share_iou_above_half = 0.0;
  int first_frame = -1, last_frame = -1;
  std::map<int, int> other_classes;  ///< boxes with a wrong class
  /// Certain: boxes for 3 s in all, rays 20 deg apart, and whole in the image for 1 s. Probable: boxes for 1 s, rays
  /// 10 deg apart.
  Certainty certainty = Certainty::kMarginal;
};

/// The objects that stay to the end and have at least one box there, those with most boxes first.
std::vector<SimulatedReference> reference_objects(const SimulatedSequence& sequence);

/// The text of reference_objects.csv, with the columns of the yardsticks of recorded sequences.
std::string format_reference_objects(const SimulatedSequence& sequence, const ClassTable& classes);

/// A place where an object was at rest and is no more: a map that shows it there is wrong.
struct GoneObject {
  int object = -1;  ///< index in Scene::objects
  Ellipsoid ellipsoid;
  int views = 0;        ///< boxes that show it there
  int last_frame = -1;  ///< the last of them
};

/// In order of objects and of time.
std::vector<GoneObject> gone_objects(const SimulatedSequence& sequence);

/// The text of gone_objects.csv: `id,label_id,label,x,y,z,a,b,c,yaw,views,last,reference_id`, the last one the object's
/// row in reference_objects.csv, -1 without one.
std::string format_gone_objects(const SimulatedSequence& sequence, const ClassTable& classes);

/// What write_sequence writes.
inline constexpr std::array<const char*, 7> kSequenceFiles = {
    "groundtruth.txt",       "groundtruth_frames.txt", "odometry.txt", "detections.json",
    "reference_objects.csv", "gone_objects.csv",       "camera.yaml"};
/// Its camera.yaml begins so.
inline constexpr char kSequenceTitle[] = "# Camera of a simulated sequence.\n";

/// Writes groundtruth.txt, groundtruth_frames.txt, odometry.txt (TUM format), detections.json (OA-SLAM's format),
/// reference_objects.csv, gone_objects.csv and camera.yaml, making the directory.
Status write_sequence(const SimulatedSequence& sequence, const ClassTable& classes, const std::string& directory);

}  // namespace semantic_topo_loop::core
