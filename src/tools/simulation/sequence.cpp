#include "tools/simulation/sequence.h"

#include <algorithm>

#include "io/csv.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kFirstStamp_ns = 1400000000000000000;  ///< any: ten digits of seconds as in recordings
constexpr double kMocapRate_hz = 100.0;                       ///< of the TUM RGB-D benchmark's motion capture
constexpr double kMocapMargin_s = 0.5;                        ///< before the first and after the last image

/// Whole microseconds, so that six decimals in a file are exact.
std::int64_t stamp_at(double time_s) { return kFirstStamp_ns + 1000 * std::llround(1e6 * time_s); }

StampedPoses sample(const CameraTrajectory& trajectory, double begin_s, double rate_hz, std::size_t count) {
  StampedPoses poses;
  poses.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double time_s = begin_s + static_cast<double>(i) / rate_hz;
    poses.push_back({stamp_at(time_s), trajectory(time_s)});
  }
  return poses;
}

SE3 odometry_frame(const SimulationOptions& options, const SE3& T_world_camera0) {
  if (options.odometry_frame == "world") return SE3();
  if (options.odometry_frame == "first_camera") return T_world_camera0.inverse();
  Random random(seed_of(options, SeedStream::kOdometryFrame));
  const Quaternion rotation = random.rotation();
  return {rotation, 5.0 * random.normal3()};
}

Result<StampedPoses> odometry(const SimulationOptions& options, const StampedPoses& truth) {
  std::vector<SE3> T_world_camera;
  for (const StampedPose& pose : truth) T_world_camera.push_back(pose.T_world_camera);
  auto drifted = drift_poses(T_world_camera, options.drift, seed_of(options, SeedStream::kDrift));
  if (!drifted) return drifted.error();
  *drifted = drift_scale(*drifted, options.drift, seed_of(options, SeedStream::kScaleDrift));
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

/// The boxes of one object, collected frame by frame.
struct Evidence {
  SimulatedReference reference;
  std::vector<double> ious;
  std::vector<Vec3> rays;  ///< unit, world frame, at least kRayStep apart
};

constexpr double kRayStepCosine = 0.99985;  ///< 1 deg

void add_ray(const Vec3& ray, std::vector<Vec3>* rays) {
  const bool is_new =
      std::all_of(rays->begin(), rays->end(), [&ray](const Vec3& r) { return r.dot(ray) < kRayStepCosine; });
  if (is_new) rays->push_back(ray);
}

double largest_angle_deg(const std::vector<Vec3>& rays) {
  double smallest_cosine = 1.0;
  for (const Vec3& a : rays) {
    for (const Vec3& b : rays) smallest_cosine = std::min(smallest_cosine, a.dot(b));
  }
  return degrees(std::acos(std::clamp(smallest_cosine, -1.0, 1.0)));
}

Certainty certainty_of(const SimulatedReference& object, double rate_hz) {
  const auto lasts = [rate_hz](int frames, double seconds) { return frames >= seconds * rate_hz; };
  if (lasts(object.views, 3.0) && lasts(object.whole_frames, 1.0) && object.baseline_deg >= 20.0) {
    return Certainty::kCertain;
  }
  return lasts(object.views, 1.0) && object.baseline_deg >= 10.0 ? Certainty::kProbable : Certainty::kMarginal;
}

void summarise(double rate_hz, Evidence* evidence) {
  SimulatedReference& r = evidence->reference;
  std::vector<double>& ious = evidence->ious;
  std::sort(ious.begin(), ious.end());
  for (const double value : ious) {
    r.mean_iou += value / static_cast<double>(ious.size());
    r.share_iou_above_half += (value > 0.5 ? 1.0 : 0.0) / static_cast<double>(ious.size());
  }
  r.median_iou = ious[ious.size() / 2];
  r.baseline_deg = largest_angle_deg(evidence->rays);
  r.certainty = certainty_of(r, rate_hz);
}

void collect(const SimulatedSequence& sequence, std::size_t frame, const SceneProjector& projector,
             std::vector<Evidence>* evidence) {
  const SE3& T_world_camera = sequence.truth[frame].T_world_camera;
  const double time_s = sequence.time_s(frame);
  const auto is_settled = [&](std::size_t i) {
    const SceneObject& object = sequence.scene.objects[i];
    return object.stays() && (object.phases.empty() || time_s >= object.phases.back().begin_s);
  };
  const double width = sequence.camera.width, height = sequence.camera.height;
  std::vector<std::optional<Box>> true_boxes;
  for (std::size_t i = 0; i < sequence.scene.objects.size(); ++i) {
    const Ellipsoid& ellipsoid = sequence.scene.objects[i].ellipsoid;
    const bool is_here = sequence.scene.room_of(ellipsoid.center()) == sequence.scene.room_of(T_world_camera.t);
    true_boxes.push_back(is_here ? projector.raw_box(ellipsoid, T_world_camera) : std::nullopt);
    const std::optional<Box>& box = true_boxes.back();
    if (box && is_settled(i) && truncated_sides(*box, width, height, 0.0) == 0) ++(*evidence)[i].reference.whole_frames;
  }
  for (const SimulatedDetection& d : sequence.detections[frame]) {
    const auto i = static_cast<std::size_t>(d.object);
    if (d.object < 0 || !is_settled(i)) continue;
    const SceneObject& object = sequence.scene.objects[i];
    Evidence& e = (*evidence)[i];
    ++e.reference.views;
    if (e.reference.first_frame < 0) e.reference.first_frame = static_cast<int>(frame);
    e.reference.last_frame = static_cast<int>(frame);
    if (d.detection.class_id != object.class_id) ++e.reference.other_classes[d.detection.class_id];
    e.ious.push_back(true_boxes[i] ? iou(clip(*true_boxes[i], width, height), d.detection.box) : 0.0);
    add_ray((object.ellipsoid.center() - T_world_camera.t).normalized(), &e.rays);
  }
}

std::string fixed(double value) { return format_fixed(value, 4); }

/// Of an object, or of a place where one was.
template <class... More>
std::string place_row(std::size_t id, int class_id, const Ellipsoid& ellipsoid, const ClassTable& classes,
                      const More&... more) {
  const Quaternion& q = ellipsoid.T_world_quadric.q;
  const Vec3 &center = ellipsoid.center(), &axes = ellipsoid.semi_axes;
  return csv_row(id, class_id, classes.name(class_id), fixed(center.x()), fixed(center.y()), fixed(center.z()),
                 fixed(axes.x()), fixed(axes.y()), fixed(axes.z()), fixed(2.0 * std::atan2(q.z(), q.w())), more...);
}

/// Adds the boxes that show an object at a place that it leaves.
void count_views(const SimulatedSequence& sequence, double from_s, double to_s, GoneObject* gone) {
  for (std::size_t frame = 0; frame < sequence.detections.size(); ++frame) {
    const double time_s = sequence.time_s(frame);
    if (time_s < from_s || time_s >= to_s) continue;
    for (const SimulatedDetection& d : sequence.detections[frame]) {
      if (d.object != gone->object) continue;
      ++gone->views;
      gone->last_frame = static_cast<int>(frame);
    }
  }
}

}  // namespace

Result<SimulatedSequence> simulate(const SimulationOptions& options, const Camera& camera, const ClassTable& classes) {
  if (const Status status = validate(options); !status) return status.error();
  if (const Status status = camera.check(); !status) return status.error();
  SimulatedSequence sequence;
  sequence.camera = camera;
  sequence.scene = make_scene(options.scene, seed_of(options, SeedStream::kScene));
  const CameraTrajectory trajectory =
      make_trajectory(sequence.scene, options.trajectory, seed_of(options, SeedStream::kTrajectory));
  const double duration_s = options.trajectory.duration_s;
  add_dynamics(options.dynamics, trajectory, duration_s, seed_of(options, SeedStream::kDynamics), &sequence.scene);
  for (const SceneObject& object : sequence.scene.objects) {
    if (classes.find(object.class_id) != nullptr) continue;
    return Error{"the class table lacks id " + std::to_string(object.class_id) +
                 ", which the scene has: its ids must be COCO's"};
  }
  const double rate_hz = options.trajectory.rate_hz;
  const auto count = static_cast<std::size_t>(std::llround(duration_s * rate_hz));
  sequence.truth = sample(trajectory, 0.0, rate_hz, count);
  sequence.depth = sample(trajectory, options.rendering.depth_delay_s, rate_hz, count);
  sequence.mocap = sample(trajectory, -kMocapMargin_s, kMocapRate_hz,
                          static_cast<std::size_t>((duration_s + 2.0 * kMocapMargin_s) * kMocapRate_hz) + 1);
  Result<StampedPoses> drifted = odometry(options, sequence.truth);
  if (!drifted) return drifted.error();
  sequence.odometry = *std::move(drifted);
  DetectorModel detector(sequence.scene, camera, classes, options.detector, rate_hz,
                         seed_of(options, SeedStream::kDetector));
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) {
    sequence.detections.push_back(detector.detect(sequence.truth[i].T_world_camera, sequence.time_s(i)));
  }
  return sequence;
}

std::vector<SimulatedReference> reference_objects(const SimulatedSequence& sequence) {
  if (sequence.truth.size() < 2) return {};
  std::vector<Evidence> evidence(sequence.scene.objects.size());
  const SceneProjector projector(sequence.scene, sequence.camera);
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) collect(sequence, i, projector, &evidence);

  const double duration_s =
      1e-9 * static_cast<double>(sequence.truth.back().stamp_ns - sequence.truth.front().stamp_ns);
  const double rate_hz = static_cast<double>(sequence.truth.size() - 1) / duration_s;
  std::vector<SimulatedReference> references;
  for (std::size_t i = 0; i < evidence.size(); ++i) {
    evidence[i].reference.object = static_cast<int>(i);
    if (evidence[i].ious.empty()) continue;
    summarise(rate_hz, &evidence[i]);
    references.push_back(evidence[i].reference);
  }
  std::stable_sort(references.begin(), references.end(),
                   [](const SimulatedReference& a, const SimulatedReference& b) { return a.views > b.views; });
  return references;
}

std::string format_reference_objects(const SimulatedSequence& sequence, const ClassTable& classes) {
  std::string text =
      "id,label_id,label,x,y,z,a,b,c,yaw,views,fullvis_frames,baseline_deg,mean_iou,median_iou,iou_gt_05,first,last,"
      "alt_labels,certainty\n";
  const std::vector<SimulatedReference> references = reference_objects(sequence);
  for (std::size_t i = 0; i < references.size(); ++i) {
    const SimulatedReference& r = references[i];
    const SceneObject& object = sequence.scene.objects[static_cast<std::size_t>(r.object)];
    std::string others;
    for (const auto& [class_id, count] : r.other_classes) {
      others += (others.empty() ? "" : ";") + classes.name(class_id) + ":" + std::to_string(count);
    }
    text += place_row(i, object.class_id, object.ellipsoid, classes, r.views, r.whole_frames, fixed(r.baseline_deg),
                      fixed(r.mean_iou), fixed(r.median_iou), fixed(r.share_iou_above_half), r.first_frame,
                      r.last_frame, others, name_of(r.certainty));
  }
  return text;
}

std::vector<GoneObject> gone_objects(const SimulatedSequence& sequence) {
  std::vector<GoneObject> places;
  for (std::size_t i = 0; i < sequence.scene.objects.size(); ++i) {
    const std::vector<ObjectPhase>& phases = sequence.scene.objects[i].phases;
    for (std::size_t k = 0; k + 1 < phases.size(); ++k) {
      if (!phases[k].is_present || !phases[k].velocity.isZero()) continue;
      GoneObject gone;
      gone.object = static_cast<int>(i);
      gone.ellipsoid = sequence.scene.objects[i].ellipsoid;
      gone.ellipsoid.T_world_quadric = phases[k].T_world_object;
      count_views(sequence, phases[k].begin_s, phases[k + 1].begin_s, &gone);
      places.push_back(gone);
    }
  }
  return places;
}

std::string format_gone_objects(const SimulatedSequence& sequence, const ClassTable& classes) {
  std::string text = "id,label_id,label,x,y,z,a,b,c,yaw,views,last,reference_id\n";
  const std::vector<SimulatedReference> references = reference_objects(sequence);
  const std::vector<GoneObject> places = gone_objects(sequence);
  for (std::size_t i = 0; i < places.size(); ++i) {
    const GoneObject& gone = places[i];
    const auto reference = std::find_if(references.begin(), references.end(),
                                        [&gone](const SimulatedReference& r) { return r.object == gone.object; });
    const std::int64_t reference_id = reference == references.end() ? -1 : reference - references.begin();
    const int class_id = sequence.scene.objects[static_cast<std::size_t>(gone.object)].class_id;
    text += place_row(i, class_id, gone.ellipsoid, classes, gone.views, gone.last_frame, reference_id);
  }
  return text;
}

Status write_sequence(const SimulatedSequence& sequence, const ClassTable& classes, const std::string& directory) {
  Status status = make_directory(directory);
  // First: it says whose directory this is.
  if (status) status = write_text_file(directory + "/camera.yaml", kSequenceTitle + format_camera(sequence.camera));
  for (const auto& [name, poses] :
       {std::pair("/groundtruth.txt", &sequence.mocap), std::pair("/groundtruth_frames.txt", &sequence.truth),
        std::pair("/odometry.txt", &sequence.odometry)}) {
    if (status) status = write_tum_trajectory(directory + name, *poses);
  }
  if (status) status = write_detections_json(directory + "/detections.json", detection_frames(sequence));
  for (const auto& [name, text] : {std::pair("/reference_objects.csv", format_reference_objects(sequence, classes)),
                                   std::pair("/gone_objects.csv", format_gone_objects(sequence, classes))}) {
    if (status) status = write_text_file(directory + name, text);
  }
  return status;
}

}  // namespace semantic_topo_loop::core
