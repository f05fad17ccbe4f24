#include "tools/simulation/detector.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

constexpr double kFullyVisible = 0.8;   ///< unoccluded share from which occlusion costs no detection
constexpr double kSizeSlope = 0.2;      ///< width of the transition around small_box_px, share of it
constexpr double kPhantomLife = 0.125;  ///< of persistence_s: false boxes flicker
constexpr double kMinBoxSide_px = 2.0;  ///< smaller ones are not written

double normal_cdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

/// One step of a stationary first-order Markov process with standard normal values.
double advance(double value, double memory, Random* random) {
  return memory * value + std::sqrt(1.0 - memory * memory) * random->normal();
}

/// Poisson-distributed count (Knuth's product of uniforms), for small means.
int poisson(double mean, Random* random) {
  const double limit = std::exp(-mean);
  int count = 0;
  for (double product = random->uniform(); product > limit; product *= random->uniform()) ++count;
  return count;
}

double memory_over(double time_s, double persistence_s) {
  return persistence_s > 0.0 ? std::exp(-time_s / persistence_s) : 0.0;
}

}  // namespace

DetectorModel::DetectorModel(const Scene& scene, const Camera& camera, const ClassTable& classes,
                             const DetectorOptions& options, double rate_hz, std::uint64_t seed)
    : scene_(&scene),
      camera_(camera),
      projector_(scene, camera),
      options_(options),
      memory_(memory_over(1.0 / rate_hz, options.persistence_s)),
      phantom_memory_(memory_over(1.0 / rate_hz, kPhantomLife * options.persistence_s)),
      moods_(scene.objects.size()),
      random_(seed) {
  for (const SceneObject& object : scene.objects) {
    std::vector<int> others;
    for (const auto& [id, entry] : classes.classes()) {
      if (id != object.class_id && classes.confusable(id, object.class_id)) others.push_back(id);
    }
    confusable_.push_back(others);
  }
}

std::vector<SimulatedDetection> DetectorModel::detect(const SE3& T_world_camera, double time_s) {
  return detect(T_world_camera, projector_.project(T_world_camera, time_s));
}

std::vector<SimulatedDetection> DetectorModel::detect(const SE3& T_world_camera,
                                                      const std::vector<std::optional<ObjectView>>& views) {
  advance_moods();
  advance_phantoms(T_world_camera);
  std::vector<SimulatedDetection> detections;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::optional<Detection> detection = views[i] ? detect_object(i, *views[i]) : std::nullopt;
    if (detection) detections.push_back({*detection, static_cast<int>(i)});
  }
  for (const Phantom& phantom : phantoms_) {
    const std::optional<Box> box = projector_.raw_box(phantom.ellipsoid, T_world_camera);
    if (!box) continue;
    const Box clipped = clip(*box, camera_.width, camera_.height);
    if (clipped.width() < kMinBoxSide_px || clipped.height() < kMinBoxSide_px) continue;
    const double score = options_.min_score + 0.5 * std::pow(random_.uniform(), 2.0);
    detections.push_back({{phantom.class_id, std::min(score, 1.0), clipped}, -1});
  }
  return detections;
}

void DetectorModel::advance_moods() {
  // The first frame draws from the stationary distribution.
  const double memory = started_ ? memory_ : 0.0;
  for (Mood& mood : moods_) {
    mood.miss = advance(mood.miss, memory, &random_);
    mood.label = advance(mood.label, memory, &random_);
    mood.other_class = advance(mood.other_class, memory, &random_);
    for (int i = 0; i < 4; ++i) mood.edges[i] = advance(mood.edges[i], memory, &random_);
  }
}

void DetectorModel::advance_phantoms(const SE3& T_world_camera) {
  const double memory = started_ ? phantom_memory_ : 0.0;
  started_ = true;
  if (scene_->objects.empty()) return;
  std::vector<Phantom> survivors;
  for (const Phantom& phantom : phantoms_) {
    if (random_.chance(memory)) survivors.push_back(phantom);
  }
  phantoms_ = std::move(survivors);
  for (int i = poisson(options_.false_rate * (1.0 - memory), &random_); i > 0; --i) {
    Phantom phantom;
    phantom.class_id =
        scene_->objects[static_cast<std::size_t>(random_.index(static_cast<int>(moods_.size())))].class_id;
    const double x = random_.uniform(0.05, 0.95) * camera_.width;
    const double y = random_.uniform(0.05, 0.95) * camera_.height;
    const double depth = random_.uniform(1.0, 2.5);
    phantom.ellipsoid.T_world_quadric.t = T_world_camera * (depth * camera_.ray(camera_.undistort(Vec2(x, y))));
    for (int i = 0; i < 3; ++i) phantom.ellipsoid.semi_axes[i] = random_.uniform(0.03, 0.15);
    phantoms_.push_back(phantom);
  }
}

std::optional<Detection> DetectorModel::detect_object(std::size_t object, const ObjectView& view) {
  const Mood& mood = moods_[object];
  if (view.inside < options_.min_inside || view.visible < options_.min_visible) return std::nullopt;
  const double size = view.box.size();
  const double small = options_.small_box_px;
  const double size_factor = small > 0.0 ? 1.0 / (1.0 + std::exp((small - size) / (kSizeSlope * small))) : 1.0;
  const double occlusion_factor = view.visible >= kFullyVisible
                                      ? 1.0
                                      : (view.visible - options_.min_visible) / (kFullyVisible - options_.min_visible);
  const double detection_rate = (1.0 - options_.miss_rate) * size_factor * occlusion_factor;
  if (normal_cdf(mood.miss) < 1.0 - detection_rate) return std::nullopt;

  Detection detection;
  detection.class_id = label(object);
  detection.box = jitter(view, mood.edges);
  if (detection.box.width() < kMinBoxSide_px || detection.box.height() < kMinBoxSide_px) return std::nullopt;
  // Median scores of YOLOv5 on fr2_desk: 0.67 at 25 px, 0.80 at 50 px, 0.85 from 120 px.
  double score = 0.88 - (small > 0.0 ? 0.6 * std::exp(-size / small) : 0.0) - 0.3 * (1.0 - view.visible);
  if (detection.class_id != scene_->objects[object].class_id) score -= 0.25;
  score += 0.06 * mood.miss + 0.03 * random_.normal();
  detection.score = std::clamp(score, options_.min_score, 0.99);
  return detection;
}

Box DetectorModel::jitter(const ObjectView& view, const Vec4& slow) {
  const Box& box = view.box;
  const auto error = [this, &slow](int edge, double side) {
    return options_.jitter_px * random_.normal() + options_.jitter_ratio * side * slow[edge];
  };
  const std::uint8_t cut = truncated_sides(box, camera_.width, camera_.height, 0.0);
  Box result = box;
  for (const auto& [edge, bit, side, value] :
       {std::tuple(0, kLeft, box.width(), &result.x1), std::tuple(1, kTop, box.height(), &result.y1),
        std::tuple(2, kRight, box.width(), &result.x2), std::tuple(3, kBottom, box.height(), &result.y2)}) {
    // Drawn for cut sides too, so that one object's truncation does not change the others' errors.
    const double e = error(edge, side);
    if ((cut & bit) == 0) *value += e;
  }
  return clip(result, camera_.width, camera_.height);
}

int DetectorModel::label(std::size_t object) const {
  const std::vector<int>& others = confusable_[object];
  const Mood& mood = moods_[object];
  if (others.empty() || normal_cdf(mood.label) >= options_.mislabel_rate) return scene_->objects[object].class_id;
  const auto count = static_cast<double>(others.size());
  return others[static_cast<std::size_t>(std::min(normal_cdf(mood.other_class) * count, count - 1.0))];
}

}  // namespace semantic_topo_loop::core
