// A monocular odometry in simulation: an unknown unit of length that drifts.
#include <gtest/gtest.h>

#include <algorithm>

#include "support/simulated_run.h"
#include "support/test_fixtures.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kSamePlaceM = 0.15;

/// Two laps; the scale drifts by 15 %, a metre is 0.8 units at first, and the poses drift a little besides.
SimulatedSequence simulate_monocular(int seed, const ClassTable& classes) {
  return simulation_test::simulate_fr2({{"simulation.seed", std::to_string(seed)},
                                        {"trajectory.duration_s", "60"},
                                        {"trajectory.lap_s", "30"},
                                        {"trajectory.rate_hz", "12"},
                                        {"drift.position_m", "0.1"},
                                        {"drift.rotation_deg", "2"},
                                        {"drift.scale_percent", "15"},
                                        {"drift.global_scale", "0.8"}},
                                       classes);
}

/// Keyframes at the end, and what was mapped.
struct Outcome {
  StampedPoses keyframes;
  std::vector<Landmark> landmarks;
};

Outcome run(const SimulatedSequence& sequence, const std::shared_ptr<const ClassTable>& classes) {
  Options options;
  options.loop.scale = options.pose_graph.scale = "free";
  testing::ChainRun chain(sequence, classes, {}, nullptr, 0, options);
  while (chain.done() < sequence.odometry.size()) chain.next();
  chain.end();
  Outcome outcome;
  for (const KeyframePose& keyframe : chain.slam().pose_graph().keyframes()) {
    outcome.keyframes.push_back({keyframe.stamp_ns, keyframe.T_map_camera});
  }
  outcome.landmarks = chain.slam().mapper().landmarks();
  return outcome;
}

TrajectoryEvaluation evaluate(const StampedPoses& estimate, const StampedPoses& truth) {
  return checked(evaluate_trajectory(estimate, truth, true));
}

class Monocular : public ::testing::TestWithParam<int> {};

TEST_P(Monocular, LoopsCorrectTheDriftOfTheScale) {
  const std::shared_ptr<const ClassTable> classes = shared_coco();
  const auto sequence = simulate_monocular(GetParam(), *classes);
  const Outcome outcome = run(sequence, classes);
  const TrajectoryEvaluation before = evaluate(sequence.odometry, sequence.truth);
  const TrajectoryEvaluation after = evaluate(outcome.keyframes, sequence.truth);
  EXPECT_LT(3.0 * after.absolute_m.rmse, before.absolute_m.rmse);
  // Landmarks have followed their keyframes, in one unit of length.
  int mapped = 0;
  for (const Landmark& landmark : outcome.landmarks) {
    if (landmark.state != LandmarkState::kConfirmed) continue;
    const Alignment& T = after.alignment;
    const Vec3 center = T.scale * (T.T_a_b.q * landmark.ellipsoid->center()) + T.T_a_b.t;
    const auto is_it = [&](const SceneObject& object) {
      return (object.ellipsoid.center() - center).norm() < kSamePlaceM &&
             classes->confusable(object.class_id, landmark.class_id);
    };
    const bool is_right = std::any_of(sequence.scene.objects.begin(), sequence.scene.objects.end(), is_it);
    mapped += is_right ? 1 : 0;
  }
  EXPECT_GE(mapped, 12);
}

INSTANTIATE_TEST_SUITE_P(Seeds, Monocular, ::testing::Values(1, 3));

}  // namespace
}  // namespace semantic_topo_loop::core
