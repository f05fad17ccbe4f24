#include "tools/evaluation/object_evaluation.h"

#include <gtest/gtest.h>

#include "support/random_poses.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kCup = 41, kBook = 73;

ReferenceObject reference(int id, int class_id, const Vec3& center, Certainty certainty = Certainty::kCertain) {
  ReferenceObject object;
  object.id = id;
  object.class_id = class_id;
  object.center = center;
  object.semi_axes = Vec3(0.05, 0.05, 0.1);
  object.certainty = certainty;
  return object;
}

MappedObject mapped(int id, int class_id, const Vec3& center, const std::string& state = "confirmed") {
  MappedObject object;
  object.id = id;
  object.class_id = class_id;
  object.center = center;
  object.semi_axes = Vec3(0.05, 0.05, 0.1);
  object.state = state;
  return object;
}

int matched_with(const ObjectEvaluation& e, std::int64_t object_id) {
  for (const ObjectMatchResult& match : e.matches) {
    if (match.object_id == object_id) return match.reference_id;
  }
  return -2;
}

TEST(ObjectEvaluation, PerfectMap) {
  const auto e = evaluate_objects({mapped(5, kCup, {0, 0, 0}), mapped(6, kBook, {1, 0, 0})},
                                  {reference(0, kCup, {0, 0, 0}), reference(1, kBook, {1, 0.1, 0})}, {});
  EXPECT_EQ(e.certain.f(), 1.0);
  EXPECT_EQ(e.certain.precision.total, 2);
  EXPECT_EQ(e.strict.f(), 1.0);
  EXPECT_EQ(e.undisputed.right, 2);
  EXPECT_NEAR(e.center_m.mean, 0.05, 1e-12);
  EXPECT_EQ(matched_with(e, 6), 1);
}

TEST(ObjectEvaluation, OnlyConfirmedObjectsCount) {
  const auto e = evaluate_objects({mapped(5, kCup, {0, 0, 0}, "candidate"), mapped(6, kCup, {0, 0, 0}, "retired")},
                                  {reference(0, kCup, {0, 0, 0})}, {});
  EXPECT_EQ(e.certain.precision.total, 0);
  EXPECT_EQ(e.certain.recall.right, 0);
  EXPECT_EQ(e.certain.recall.total, 1);
  EXPECT_EQ(e.certain.f(), 0.0);
}

TEST(ObjectEvaluation, ClassAndDistanceMustAgree) {
  const std::vector<ReferenceObject> references = {reference(0, kCup, {0, 0, 0})};
  EXPECT_EQ(evaluate_objects({mapped(5, kBook, {0, 0, 0})}, references, {}).matched_certain, 0);
  EXPECT_EQ(evaluate_objects({mapped(5, kCup, {0.149, 0, 0})}, references, {}).matched_certain, 1);
  EXPECT_EQ(evaluate_objects({mapped(5, kCup, {0.151, 0, 0})}, references, {}).matched_certain, 0);
  ReferenceObject large = references[0];
  large.semi_axes = Vec3(0.1, 0.6, 0.2);  // half the largest semi-axis is 0.3 m
  EXPECT_EQ(evaluate_objects({mapped(5, kCup, {0.29, 0, 0})}, {large}, {}).matched_certain, 1);
  EXPECT_EQ(evaluate_objects({mapped(5, kCup, {0.31, 0, 0})}, {large}, {}).matched_certain, 0);
}

TEST(ObjectEvaluation, ADuplicateIsFalse) {
  const auto e = evaluate_objects({mapped(5, kCup, {0, 0, 0}), mapped(6, kCup, {0.05, 0, 0})},
                                  {reference(0, kCup, {0, 0, 0})}, {});
  EXPECT_EQ(e.certain.precision.right, 1);
  EXPECT_EQ(e.certain.precision.total, 2);
  EXPECT_EQ(matched_with(e, 5), 0);
  EXPECT_EQ(matched_with(e, 6), -1);
  EXPECT_EQ(e.undisputed.right, 0);
  EXPECT_EQ(e.undisputed.total, 2);
}

TEST(ObjectEvaluation, MostPairsComeBeforeTheLeastDistance) {
  // Object 5 is nearest to reference 1, but only with reference 0 do both objects find one.
  const auto e = evaluate_objects({mapped(5, kCup, {0.10, 0, 0}), mapped(6, kCup, {0.25, 0, 0})},
                                  {reference(0, kCup, {0, 0, 0}), reference(1, kCup, {0.12, 0, 0})}, {});
  EXPECT_EQ(e.matched_certain, 2);
  EXPECT_EQ(matched_with(e, 5), 0);
  EXPECT_EQ(matched_with(e, 6), 1);
}

TEST(ObjectEvaluation, CertainReferencesChooseFirst) {
  const auto e =
      evaluate_objects({mapped(5, kCup, {0.05, 0, 0})},
                       {reference(0, kCup, {0.05, 0, 0}, Certainty::kProbable), reference(1, kCup, {0, 0, 0})}, {});
  EXPECT_EQ(e.matched_certain, 1);
  EXPECT_EQ(e.matched_probable, 0);
}

TEST(ObjectEvaluation, ProbableAndMarginalAreNeutralUnlessStrict) {
  const auto e = evaluate_objects(
      {mapped(5, kCup, {0, 0, 0}), mapped(6, kBook, {1, 0, 0}), mapped(7, kBook, {2, 0, 0}),
       mapped(8, kBook, {9, 0, 0})},
      {reference(0, kCup, {0, 0, 0}), reference(1, kBook, {1, 0, 0}, Certainty::kProbable),
       reference(2, kBook, {2, 0, 0}, Certainty::kMarginal), reference(3, kCup, {5, 0, 0}, Certainty::kProbable)},
      {});
  EXPECT_EQ(e.certain.precision.right, 1);
  EXPECT_EQ(e.certain.precision.total, 2);
  EXPECT_EQ(e.certain.recall.total, 1);
  EXPECT_EQ(e.strict.precision.right, 2);
  EXPECT_EQ(e.strict.precision.total, 4);
  EXPECT_EQ(e.strict.recall.right, 2);
  EXPECT_EQ(e.strict.recall.total, 3);
  EXPECT_NEAR(e.certain.f(), 2.0 * 0.5 / 1.5, 1e-12);
}

TEST(ObjectEvaluation, MissedReferencesAreListed) {
  const auto e =
      evaluate_objects({}, {reference(3, kCup, {0, 0, 0}), reference(4, kCup, {1, 0, 0}, Certainty::kMarginal)}, {});
  ASSERT_EQ(e.matches.size(), 1u);
  EXPECT_EQ(e.matches[0].object_id, -1);
  EXPECT_EQ(e.matches[0].reference_id, 3);
}

TEST(ObjectEvaluation, MovesObjectsByTheAlignment) {
  RandomPoses random(43);
  Alignment alignment;
  alignment.T_a_b = random.pose(3.0);
  const Vec3 center_map(1.0, 2.0, 3.0);
  const auto e =
      evaluate_objects({mapped(5, kCup, center_map)}, {reference(0, kCup, alignment.T_a_b * center_map)}, alignment);
  EXPECT_EQ(e.matched_certain, 1);
  EXPECT_NEAR(e.center_m.max, 0.0, 1e-12);
}

TEST(ObjectEvaluation, LabelsAreThoseOfTheRunsClassTable) {
  std::vector<MappedObject> objects{mapped(5, kCup, {0, 0, 0})};
  objects.back().label = "cup";
  ReferenceObject cup;
  cup.id = 3;
  cup.class_id = 47;  // COCO's own number
  cup.label = "cup";
  const std::string error = check_labels(objects, {cup}).message();
  EXPECT_NE(error.find("label_id: 47 of reference 3, 'cup', is"), std::string::npos) << error;
  cup.class_id = kCup;
  EXPECT_TRUE(check_labels(objects, {cup}));
}

TEST(ReferenceObjects, AnIdThatIsThereTwiceIsAnError) {
  const TestDirectory directory;
  const std::string row = "4,41,cup,0,0,0,1,1,1,certain\n";
  const std::string path = directory.write("r.csv", "id,label_id,label,x,y,z,a,b,c,certainty\n" + row + row);
  EXPECT_EQ(read_reference_objects(path).message(), path + ": id: 4 is there twice");
}

}  // namespace
}  // namespace semantic_topo_loop::core
