#include <gtest/gtest.h>

#include <algorithm>

#include "support/simulated_run.h"
#include "support/test_fixtures.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kPerson = 0, kCup = 41;
constexpr double kSamePlaceM = 0.15;

using Texts = std::map<std::string, std::string>;

/// Two laps around the desks with exact odometry in the world frame, so that the map can be compared with the truth as
/// it is.
SimulatedSequence simulate_laps(Texts texts, const ClassTable& classes) {
  texts.insert({{"trajectory.duration_s", "72"},
                {"trajectory.lap_s", "36"},
                {"trajectory.rate_hz", "20"},
                {"simulation.odometry_frame", "world"},
                {"drift.position_m", "0"},
                {"drift.rotation_deg", "0"}});
  return simulation_test::simulate_fr2(texts, classes);
}

/// What a run left behind.
struct Outcome {
  std::vector<Landmark> landmarks;
  std::vector<Landmark> landmarks_halfway;
  std::vector<LoopClosure> loops;
  int person_boxes = 0;             ///< that were given to the chain
  int person_boxes_associated = 0;  ///< that got a landmark

  /// Confirmed landmarks near a place, of the class or one that detectors confuse with it.
  static int confirmed_at(const Vec3& place, int class_id, const ClassTable& classes,
                          const std::vector<Landmark>& landmarks) {
    int count = 0;
    for (const Landmark& landmark : landmarks) {
      if (landmark.state != LandmarkState::kConfirmed || !classes.confusable(landmark.class_id, class_id)) continue;
      count += (landmark.ellipsoid->center() - place).norm() < kSamePlaceM ? 1 : 0;
    }
    return count;
  }
};

Outcome run(const SimulatedSequence& sequence, const std::shared_ptr<const ClassTable>& classes, bool with_loops) {
  Options options;
  options.loop.enabled = with_loops;
  testing::ChainRun chain(sequence, classes, {}, nullptr, 0, options);
  Outcome outcome;
  for (std::size_t i = 0; i < sequence.odometry.size(); ++i) {
    chain.next();
    for (const Association& a : chain.last().associations.associations) {
      if (a.class_id != kPerson) continue;
      ++outcome.person_boxes;
      outcome.person_boxes_associated += a.landmark_id >= 0 ? 1 : 0;
    }
    const std::vector<LoopClosure>& loops = chain.last().loops;
    outcome.loops.insert(outcome.loops.end(), loops.begin(), loops.end());
    if (2 * i == sequence.odometry.size()) outcome.landmarks_halfway = chain.slam().mapper().landmarks();
  }
  chain.end();
  outcome.landmarks = chain.slam().mapper().landmarks();
  return outcome;
}

TEST(WalkingPeople, BecomeNeitherLandmarksNorLoopNodes) {
  const auto classes = shared_coco();
  const auto all = simulate_laps({{"dynamics.persons", "6"},
                                  {"trajectory.duration_s", "40"},
                                  {"trajectory.lap_s", "20"},
                                  {"trajectory.rate_hz", "10"}},
                                 *classes);
  const auto is_person = [](const SimulatedDetection& d) { return d.detection.class_id == kPerson; };
  auto others = all;
  for (auto& frame : others.detections) {
    frame.erase(std::remove_if(frame.begin(), frame.end(), is_person), frame.end());
  }
  const Outcome with = run(all, classes, true), without = run(others, classes, true);
  EXPECT_GT(with.person_boxes, 30);
  EXPECT_EQ(with.person_boxes_associated, 0);
  for (const Landmark& landmark : with.landmarks) EXPECT_NE(landmark.class_id, kPerson) << landmark.id;

  // Their boxes change nothing: not the map, not a loop, accepted or not.
  ASSERT_EQ(with.landmarks.size(), without.landmarks.size());
  EXPECT_GT(with.landmarks.size(), 10u);
  for (std::size_t i = 0; i < with.landmarks.size(); ++i) {
    const Landmark &a = with.landmarks[i], &b = without.landmarks[i];
    EXPECT_EQ(a.id, b.id);
    EXPECT_EQ(a.state, b.state);
    ASSERT_EQ(a.ellipsoid.has_value(), b.ellipsoid.has_value());
    EXPECT_TRUE(!a.ellipsoid || a.ellipsoid->center() == b.ellipsoid->center());
  }
  ASSERT_EQ(with.loops.size(), without.loops.size());
  EXPECT_FALSE(with.loops.empty());
  for (std::size_t i = 0; i < with.loops.size(); ++i) {
    EXPECT_EQ(with.loops[i].query_frame, without.loops[i].query_frame);
    EXPECT_EQ(with.loops[i].match_frame, without.loops[i].match_frame);
    EXPECT_EQ(with.loops[i].reason, without.loops[i].reason);
    EXPECT_EQ(with.loops[i].inliers, without.loops[i].inliers);
    EXPECT_EQ(with.loops[i].T_match_query.t, without.loops[i].T_match_query.t);
  }
}

/// A cup that is carried to another place after the first lap. Both tests look at the same run.
class MovedCup : public ::testing::TestWithParam<std::tuple<std::string, int>> {
 protected:
  struct Run {
    Vec3 old_place = Vec3::Zero(), new_place = Vec3::Zero();
    std::vector<SceneObject> others;  ///< certain references at rest
    Outcome outcome;
  };

  void SetUp() override {
    static std::map<ParamType, Run> results;
    const auto [it, is_new] = results.emplace(GetParam(), Run());
    if (is_new) simulate_and_run(&it->second);
    result_ = &it->second;
  }

  void simulate_and_run(Run* result) const {
    const auto& [layout, seed] = GetParam();
    const auto sequence = simulate_laps({{"scene.layout", layout},
                                         {"simulation.seed", std::to_string(seed)},
                                         {"dynamics.moved_objects", "1"},
                                         {"dynamics.move_time_s", "36"}},
                                        *classes_);
    const auto gone = gone_objects(sequence);
    ASSERT_EQ(gone.size(), 1u);
    // The sequence must show both places well, or it asks for what cannot be known.
    ASSERT_GT(gone[0].views, 60);
    const auto references = reference_objects(sequence);
    const auto moved = std::find_if(references.begin(), references.end(),
                                    [&gone](const SimulatedReference& r) { return r.object == gone[0].object; });
    ASSERT_TRUE(moved != references.end() && moved->certainty == Certainty::kCertain);
    result->old_place = gone[0].ellipsoid.center();
    result->new_place = sequence.scene.objects[static_cast<std::size_t>(moved->object)].ellipsoid.center();
    for (const SimulatedReference& r : references) {
      if (r.certainty == Certainty::kCertain && r.object != moved->object) {
        result->others.push_back(sequence.scene.objects[static_cast<std::size_t>(r.object)]);
      }
    }
    result->outcome = run(sequence, classes_, false);
  }

  std::shared_ptr<const ClassTable> classes_ = shared_coco();
  const Run* result_ = nullptr;
};

TEST_P(MovedCup, IsMappedWhereItIsAtTheEnd) {
  EXPECT_EQ(Outcome::confirmed_at(result_->new_place, kCup, *classes_, result_->outcome.landmarks), 1);
}

TEST_P(MovedCup, IsRetiredWhereItWas) {
  const Outcome& outcome = result_->outcome;
  EXPECT_EQ(Outcome::confirmed_at(result_->old_place, kCup, *classes_, outcome.landmarks_halfway), 1) << "as it moved";
  EXPECT_EQ(Outcome::confirmed_at(result_->old_place, kCup, *classes_, outcome.landmarks), 0);
}

TEST_P(MovedCup, LeavesTheOthersMapped) {
  int mapped = 0;
  for (const SceneObject& object : result_->others) {
    const int there =
        Outcome::confirmed_at(object.ellipsoid.center(), object.class_id, *classes_, result_->outcome.landmarks);
    mapped += there > 0 ? 1 : 0;
  }
  EXPECT_GT(result_->others.size(), 15u);
  EXPECT_GE(mapped, 0.8 * static_cast<double>(result_->others.size())) << "of " << result_->others.size();
}

INSTANTIATE_TEST_SUITE_P(Scenes, MovedCup,
                         ::testing::Combine(::testing::Values("desk", "office"), ::testing::Values(1, 2)));

}  // namespace
}  // namespace semantic_topo_loop::core
