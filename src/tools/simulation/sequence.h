#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/perturbation/drift.h"
#include "tools/rendering/rendering_options.h"
#include "tools/simulation/detector.h"
#include "tools/simulation/dynamics.h"
#include "tools/simulation/scene.h"
#include "tools/simulation/trajectory.h"

namespace semantic_topo_loop::core {

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
    visitor("simulation.seed", seed, not_negative(), "of everything that is random");
    visitor("simulation.odometry_frame", odometry_frame, one_of({"first_camera", "random", "world"}),
            "world of the odometry: first_camera (its first pose is the identity), random, or world (as the truth)");
    scene.visit(visitor);
    trajectory.visit(visitor);
    drift.visit(visitor);
    dynamics.visit(visitor);
    detector.visit(visitor);
    rendering.visit(visitor);
  }
};

/// What a recorded sequence has, with the truth.
struct SimulatedSequence {
  Camera camera;
  Scene scene;
  StampedPoses mocap;     ///< T_world_camera at 100 Hz, from before the first to after the last image
  StampedPoses truth;     ///< T_world_camera at the images
  StampedPoses depth;     ///< T_world_camera of the colour camera at the depth images, one an image
  StampedPoses odometry;  ///< T_odom_camera at the images, drifted
  std::vector<std::vector<SimulatedDetection>> detections;  ///< one vector an image

  /// From the first image.
  double time_s(std::size_t frame) const;
};

/// The same options, camera and classes give the same sequence, bit for bit.
/// @return nullopt, with parameter and value in `error`, for invalid options or a drift level that cannot be met
std::optional<SimulatedSequence> simulate(const SimulationOptions& options, const Camera& camera,
                                          const ClassTable& classes, std::string* error);

/// Writes groundtruth.txt, groundtruth_frames.txt, odometry.txt (TUM format), detections.json (OA-SLAM's format),
/// reference_objects.csv, gone_objects.csv and camera.yaml, making the directory.
bool write_sequence(const SimulatedSequence& sequence, const ClassTable& classes, const std::string& directory,
                    std::string* error);

}  // namespace semantic_topo_loop::core
