#include "pipeline/map_changes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "geometry/statistics.h"
#include "support/package_config.h"
#include "support/random_poses.h"
#include "support/simulated_run.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {
namespace {

/// Two laps round a desk; between them one object is moved, one goes and one comes.
struct TwoDays {
  SimulatedSequence sequence;
  std::size_t second = 0;                 ///< first image of the second lap
  int moved = -1, gone = -1, added = -1;  ///< objects of the scene
};

TwoDays two_days(int seed) {
  SimulationOptions options;
  options.seed = seed;
  options.trajectory.duration_s = 72.0;
  options.trajectory.rate_hz = 15.0;
  options.dynamics.moved_objects = 1;
  TwoDays days;
  days.sequence = checked(simulate(options, camera_fr2(), coco()));
  SimulatedSequence& sequence = days.sequence;
  while (sequence.time_s(days.second) < options.dynamics.move_time_s) ++days.second;
  days.moved = gone_objects(sequence).front().object;
  // Objects that are often seen in both laps and may be carried.
  std::map<int, std::pair<int, int>> boxes;
  for (std::size_t i = 0; i < sequence.detections.size(); ++i) {
    for (const SimulatedDetection& d : sequence.detections[i]) {
      if (d.object >= 0) ++(i < days.second ? boxes[d.object].first : boxes[d.object].second);
    }
  }
  const ClassTable classes = coco();
  constexpr int kOften = 200;
  for (const auto& [object, count] : boxes) {
    const int class_id = sequence.scene.objects[static_cast<std::size_t>(object)].class_id;
    const bool is_movable = classes.find(class_id)->role == ClassRole::kMovable;
    if (object == days.moved || !is_movable || std::min(count.first, count.second) < kOften) continue;
    (days.gone < 0 ? days.gone : days.added) = object;
    if (days.added >= 0) break;
  }
  for (std::size_t i = 0; i < sequence.detections.size(); ++i) {
    std::vector<SimulatedDetection>& found = sequence.detections[i];
    const int hidden = i < days.second ? days.added : days.gone;
    found.erase(std::remove_if(found.begin(), found.end(), [=](const auto& d) { return d.object == hidden; }),
                found.end());
  }
  return days;
}

/// "moved cup", in order.
std::vector<std::string> listed(const MapState& map) {
  const auto name = [&map](std::int64_t id) {
    const auto found = std::find_if(map.objects.landmarks.begin(), map.objects.landmarks.end(),
                                    [id](const MappedLandmark& landmark) { return landmark.state.id == id; });
    return coco().name(found->state.class_id);
  };
  std::vector<std::string> texts;
  for (const MapChange& change : map_changes(map)) {
    texts.push_back(std::string(to_string(change.kind)) + " " +
                    name(change.before_id.value_or(change.after_id.value_or(-1))));
  }
  std::sort(texts.begin(), texts.end());
  return texts;
}

TEST(MapChanges, WhatMovedWentAndCameIsListedAndNothingElse) {
  for (const int seed : {1, 2, 3}) {
    const TwoDays days = two_days(seed);
    RandomPoses random(static_cast<std::uint64_t>(seed));
    const auto first = testing::map_of(days.sequence, 0, days.second, shared_coco());
    EXPECT_TRUE(map_changes(*first).empty());
    const auto both = testing::map_of(days.sequence, days.second, days.sequence.odometry.size(), shared_coco(),
                                      random.pose(5.0), first);
    const auto name = [&](const char* kind, int object) {
      const int class_id = days.sequence.scene.objects[static_cast<std::size_t>(object)].class_id;
      return std::string(kind) + " " + coco().name(class_id);
    };
    std::vector<std::string> expected{name("gone", days.gone), name("moved", days.moved), name("new", days.added)};
    EXPECT_EQ(listed(*both), expected) << "seed " << seed;
    for (const MapChange& change : map_changes(*both)) {
      EXPECT_TRUE(!change.before_id || change.looked_at_after > 4) << change.looked_at_after;
      EXPECT_TRUE(!change.after_id || change.looked_at_before > 1) << change.looked_at_before;
    }
  }
}

TEST(MapChanges, ASessionThatOnlyFoundItsWayMissesNothing) {
  const TwoDays days = two_days(1);
  const auto first = testing::map_of(days.sequence, 0, days.second, shared_coco());
  MapState both = *testing::map_of(days.sequence, days.second, days.sequence.odometry.size(), shared_coco(), {}, first);
  ASSERT_FALSE(map_changes(both).empty());
  // As in localisation mode: keyframes came, boxes did not.
  both.objects = first->objects;
  EXPECT_TRUE(listed(both).empty()) << listed(both).front();
}

TEST(MapChanges, AFalseBoxOrTwoDoesNotBringBackWhatHasGone) {
  const TwoDays days = two_days(1);
  const auto first = testing::map_of(days.sequence, 0, days.second, shared_coco());
  MapState map = *testing::map_of(days.sequence, days.second, days.sequence.odometry.size(), shared_coco(), {}, first);
  const auto changes = map_changes(map);
  const auto is_gone = [](const MapChange& change) { return change.kind == MapChange::Kind::kGone; };
  const auto gone = std::find_if(changes.begin(), changes.end(), is_gone);
  ASSERT_NE(gone, changes.end());
  const auto landmark = std::find_if(map.objects.landmarks.begin(), map.objects.landmarks.end(),
                                     [&](const MappedLandmark& l) { return l.state.id == *gone->before_id; });
  landmark->observations = spread(landmark->observations, 50);
  const auto is_listed_with = [&](std::size_t false_boxes, double box_s) {
    MapState seen = map;
    MappedLandmark& object = seen.objects.landmarks[static_cast<std::size_t>(landmark - map.objects.landmarks.begin())];
    Observation box = object.observations.back();
    box.keyframe_id = seen.graph.next_keyframe_id() - 1;
    object.observations.insert(object.observations.end(), false_boxes, box);
    object.sightings.seen_s = box_s * static_cast<double>(object.observations.size());
    const auto left = map_changes(seen);
    return std::any_of(left.begin(), left.end(), [&](const MapChange& c) { return c.before_id == gone->before_id; });
  };
  for (const double box_s : {0.06, 0.2}) {  // of a detector at 16 and at 5 Hz
    EXPECT_TRUE(is_listed_with(0, box_s));
    EXPECT_TRUE(is_listed_with(2, box_s));
    EXPECT_FALSE(is_listed_with(8, box_s)) << "so many are no mistake";
  }
  EXPECT_TRUE(is_listed_with(3, 0.06));
}

TEST(MapChanges, AChairThatTheBorderOfTheImageAlwaysCutsIsMissedToo) {
  for (const int seed : {11, 20}) {
    SimulationOptions options;
    options.seed = seed;
    options.trajectory.duration_s = 72.0;
    options.trajectory.rate_hz = 10.0;
    options.dynamics.moved_objects = options.dynamics.removed_objects = options.dynamics.new_objects = 1;
    options.dynamics.move_time_s = 36.0;
    const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
    std::size_t second = 0;
    while (sequence.time_s(second) < options.dynamics.move_time_s) ++second;
    const auto first = testing::map_of(sequence, 0, second, shared_coco());
    const auto both = testing::map_of(sequence, second, sequence.odometry.size(), shared_coco(), {}, first);
    const std::vector<std::string> expected{"gone chair", "moved cup", "new bottle"};
    EXPECT_EQ(listed(*both), expected) << "seed " << seed;
  }
}

/// Two sessions of 20 s each.
MapState map_of_halves(SimulationOptions options) {
  options.trajectory.duration_s = 40.0;
  options.trajectory.rate_hz = 15.0;
  const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
  const std::size_t half = sequence.odometry.size() / 2;
  const auto first = testing::map_of(sequence, 0, half, shared_coco());
  return *testing::map_of(sequence, half, sequence.odometry.size(), shared_coco(), {}, first);
}

TEST(MapChanges, WhatDepthSeesThroughIsGoneWhereverItIsSeenFrom) {
  SimulationOptions options;
  options.seed = 4;
  MapState both = map_of_halves(options);
  ASSERT_EQ(listed(both), std::vector<std::string>());
  const std::int64_t second = both.graph.sessions.back().first_keyframe_id;
  const auto is_before = [second](const Observation& o) { return o.keyframe_id < second; };
  const auto object = std::find_if(both.objects.landmarks.begin(), both.objects.landmarks.end(), [&](const auto& l) {
    return l.state.state == LandmarkState::kConfirmed &&
           std::count_if(l.observations.begin(), l.observations.end(), is_before) > 50;
  });
  ASSERT_NE(object, both.objects.landmarks.end());
  std::vector<Observation>& boxes = object->observations;
  boxes.erase(std::remove_if(boxes.begin(), boxes.end(), [&](const Observation& o) { return !is_before(o); }),
              boxes.end());
  object->seen_from = SeenFrom();
  EXPECT_EQ(listed(both), std::vector<std::string>()) << "nobody looked";
  object->sightings.seen_s = 10.0;
  object->sightings.seen_through_since_s = 2.0;
  EXPECT_EQ(listed(both), std::vector<std::string>{"gone " + coco().name(object->state.class_id)});
  object->state.state = LandmarkState::kCandidate;
  EXPECT_EQ(listed(both), std::vector<std::string>{"gone " + coco().name(object->state.class_id)})
      << "it was an object when the first session ended";
  object->was_confirmed = false;
  EXPECT_EQ(listed(both), std::vector<std::string>()) << "it has never been an object";
  object->was_confirmed = true;
  object->sightings.transparent_s = 9.0;
  EXPECT_EQ(listed(both), std::vector<std::string>()) << "it is mostly holes";
}

TEST(MapChanges, WhatComesBackToWhereItHadLeftInAnEarlierSessionIsNew) {
  SimulationOptions options;
  options.seed = 3;
  options.trajectory.lap_s = 20.0;
  MapState both = map_of_halves(options);
  ASSERT_EQ(listed(both), std::vector<std::string>());
  const std::int64_t second = both.graph.sessions.back().first_keyframe_id;
  const auto is_before = [second](const Observation& o) { return o.keyframe_id < second; };
  auto& landmarks = both.objects.landmarks;
  const auto object = std::find_if(landmarks.begin(), landmarks.end(), [&](const auto& l) {
    const auto before = std::count_if(l.observations.begin(), l.observations.end(), is_before);
    return l.state.state == LandmarkState::kConfirmed && before > 50 &&
           static_cast<std::ptrdiff_t>(l.observations.size()) - before > 50;
  });
  ASSERT_NE(object, landmarks.end());
  MappedLandmark back = *object;
  back.state.id = landmarks.back().state.id + 1;
  back.was_confirmed = false;
  back.observations.erase(std::remove_if(back.observations.begin(), back.observations.end(), is_before),
                          back.observations.end());
  auto& before = object->observations;
  before.erase(std::remove_if(before.begin(), before.end(), [&](const Observation& o) { return !is_before(o); }),
               before.end());
  object->state.state = LandmarkState::kRetired;
  const std::string name = coco().name(back.state.class_id);
  const std::int64_t id = object->state.id;
  landmarks.push_back(std::move(back));
  EXPECT_EQ(listed(both), std::vector<std::string>()) << "the last session gave it up, and found it again";
  for (MappedLandmark& landmark : landmarks) landmark.was_confirmed = landmark.was_confirmed && landmark.state.id != id;
  EXPECT_EQ(listed(both), std::vector<std::string>{"new " + name});
}

TEST(MapChanges, WhatWasNotLookedAtBeforeIsNotNew) {
  SimulationOptions options;
  options.seed = 3;
  options.trajectory.duration_s = 60.0;
  options.trajectory.rate_hz = 15.0;
  const SimulatedSequence sequence = checked(simulate(options, camera_fr2(), coco()));
  const std::size_t part = 150, all = sequence.odometry.size();  // a quarter of the first lap
  const auto first = testing::map_of(sequence, 0, part, shared_coco());
  const auto both = testing::map_of(sequence, part, all, shared_coco(), {}, first);
  ASSERT_EQ(both->graph.sessions.size(), 2U);
  EXPECT_GT(both->objects.landmarks.size(), first->objects.landmarks.size());
  EXPECT_EQ(listed(*both), std::vector<std::string>());
}

}  // namespace
}  // namespace semantic_topo_loop::core
