#include "tools/simulation/sequence.h"

#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/detection_writer.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/simulation/reference_objects.h"
#include "tools/simulation/seed_stream.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kFirstStampNs = 1400000000000000000;
constexpr double kMocapRateHz = 100.0;
constexpr double kMocapMarginS = 0.5;  ///< before the first and after the last image

/// Whole microseconds, so that six decimals in a file are exact.
std::int64_t stamp_at(double time_s) { return kFirstStampNs + 1000 * std::llround(1e6 * time_s); }

StampedPoses sample(const CameraTrajectory& trajectory, double begin_s, double rate_hz, std::size_t count) {
  StampedPoses poses;
  poses.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double time_s = begin_s + static_cast<double>(i) / rate_hz;
    poses.push_back({stamp_at(time_s), trajectory.T_world_camera(time_s)});
  }
  return poses;
}

SE3 odometry_frame(const SimulationOptions& options, const SE3& T_world_camera0) {
  if (options.odometry_frame == "world") return SE3();
  if (options.odometry_frame == "first_camera") return T_world_camera0.inverse();
  Random random(seed_of(options, kOdometryFrame));
  const Quaternion rotation = random.rotation();
  return {rotation, 5.0 * random.normal3()};
}

std::optional<StampedPoses> odometry(const SimulationOptions& options, const StampedPoses& truth, std::string* error) {
  std::vector<SE3> T_world_camera;
  for (const StampedPose& pose : truth) T_world_camera.push_back(pose.T_world_camera);
  auto drifted = drift_poses(T_world_camera, options.drift, seed_of(options, kDrift), error);
  if (!drifted) return std::nullopt;
  *drifted = drift_scale(*drifted, options.drift, seed_of(options, kScaleDrift));
  const SE3 T_odom_world = odometry_frame(options, T_world_camera.front());
  StampedPoses poses;
  for (std::size_t i = 0; i < truth.size(); ++i) poses.push_back({truth[i].stamp_ns, T_odom_world * (*drifted)[i]});
  return poses;
}

std::vector<DetectionFrame> detection_frames(const SimulatedSequence& sequence) {
  std::vector<DetectionFrame> frames;
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) {
    DetectionFrame frame{sequence.truth[i].stamp_ns, {}};
    for (const SimulatedDetection& d : sequence.detections[i]) frame.detections.push_back(d.detection);
    frames.push_back(std::move(frame));
  }
  return frames;
}

}  // namespace

double SimulatedSequence::time_s(std::size_t frame) const {
  return 1e-9 * static_cast<double>(truth[frame].stamp_ns - truth.front().stamp_ns);
}

std::optional<SimulatedSequence> simulate(const SimulationOptions& options, const Camera& camera,
                                          const ClassTable& classes, std::string* error) {
  if (const Status status = validate(options); !status) {
    if (error != nullptr) *error = status.message();
    return std::nullopt;
  }
  if (!camera.is_valid(error)) return std::nullopt;
  SimulatedSequence sequence;
  sequence.camera = camera;
  sequence.scene = make_scene(options.scene, seed_of(options, kScene));
  const std::unique_ptr<CameraTrajectory> trajectory =
      make_trajectory(sequence.scene, options.trajectory, seed_of(options, kTrajectory));
  const double duration_s = options.trajectory.duration_s;
  add_dynamics(options.dynamics, *trajectory, duration_s, seed_of(options, kDynamics), &sequence.scene);
  const double rate_hz = options.trajectory.rate_hz;
  const auto count = static_cast<std::size_t>(std::llround(duration_s * rate_hz));
  sequence.truth = sample(*trajectory, 0.0, rate_hz, count);
  sequence.depth = sample(*trajectory, options.rendering.depth_delay_s, rate_hz, count);
  sequence.mocap = sample(*trajectory, -kMocapMarginS, kMocapRateHz,
                          static_cast<std::size_t>((duration_s + 2.0 * kMocapMarginS) * kMocapRateHz) + 1);
  std::optional<StampedPoses> drifted = odometry(options, sequence.truth, error);
  if (!drifted) return std::nullopt;
  sequence.odometry = std::move(*drifted);
  DetectorModel detector(sequence.scene, camera, classes, options.detector, rate_hz, seed_of(options, kDetector));
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) {
    sequence.detections.push_back(detector.detect(sequence.truth[i].T_world_camera, sequence.time_s(i)));
  }
  return sequence;
}

bool write_sequence(const SimulatedSequence& sequence, const ClassTable& classes, const std::string& directory,
                    std::string* error) {
  return make_directory(directory, error) &&
         write_tum_trajectory(directory + "/groundtruth.txt", sequence.mocap, error) &&
         write_tum_trajectory(directory + "/groundtruth_frames.txt", sequence.truth, error) &&
         write_tum_trajectory(directory + "/odometry.txt", sequence.odometry, error) &&
         write_detections_json(directory + "/detections.json", detection_frames(sequence), error) &&
         write_text_file(directory + "/reference_objects.csv", format_reference_objects(sequence, classes), error) &&
         write_text_file(directory + "/gone_objects.csv", format_gone_objects(sequence, classes), error) &&
         write_text_file(directory + "/camera.yaml",
                         "# Camera of a simulated sequence.\n" + format_camera(sequence.camera), error);
}

}  // namespace semantic_topo_loop::core
