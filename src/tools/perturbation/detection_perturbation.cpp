#include "tools/perturbation/detection_perturbation.h"

#include <algorithm>
#include <set>

#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

/// The random numbers of one box, all drawn whether they are needed or not.
struct Draws {
  explicit Draws(Random* random) : drop(random->uniform()), relabel(random->uniform()), other_class(random->uniform()) {
    for (double& edge : edges) edge = random->normal();
  }
  double drop, relabel, other_class;
  Vec4 edges;
};

std::vector<int> classes_of(const std::vector<DetectionFrame>& frames) {
  std::set<int> ids;
  for (const DetectionFrame& frame : frames) {
    for (const Detection& detection : frame.detections) ids.insert(detection.class_id);
  }
  return {ids.begin(), ids.end()};
}

/// Uniform over the others of two or more classes. @param draw in [0, 1)
int another_class(int class_id, const std::vector<int>& classes, double draw) {
  const auto index = static_cast<std::size_t>(draw * static_cast<double>(classes.size() - 1));
  return classes[index] < class_id ? classes[index] : classes[index + 1];
}

Box jittered(const Box& box, const Vec4& errors, double sigma) {
  const double x1 = box.x1 + sigma * box.width() * errors[0], y1 = box.y1 + sigma * box.height() * errors[1];
  const double x2 = box.x2 + sigma * box.width() * errors[2], y2 = box.y2 + sigma * box.height() * errors[3];
  return {std::min(x1, x2), std::min(y1, y2), std::max(x1, x2), std::max(y1, y2)};
}

}  // namespace

std::vector<DetectionFrame> perturb_detections(const std::vector<DetectionFrame>& frames,
                                               const PerturbationOptions& options, std::uint64_t seed,
                                               PerturbationCounts* counts) {
  const std::vector<int> classes = classes_of(frames);
  Random random(seed);
  std::vector<DetectionFrame> result;
  result.reserve(frames.size());
  for (const DetectionFrame& frame : frames) {
    result.push_back({frame.stamp_ns, {}});
    for (Detection detection : frame.detections) {
      const Draws draws(&random);
      ++counts->boxes;
      if (draws.drop < options.drop) {
        ++counts->dropped;
        continue;
      }
      if (draws.relabel < options.relabel && classes.size() > 1) {
        ++counts->relabelled;
        detection.class_id = another_class(detection.class_id, classes, draws.other_class);
      }
      detection.box = jittered(detection.box, draws.edges, options.jitter);
      result.back().detections.push_back(detection);
    }
  }
  return result;
}

}  // namespace semantic_topo_loop::core
