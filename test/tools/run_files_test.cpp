#include "semantic_topo_loop/io/run_files.h"

#include <gtest/gtest.h>

#include "support/test_files.h"
#include "tools/evaluation/loop_evaluation.h"
#include "tools/evaluation/object_evaluation.h"

namespace semantic_topo_loop::core {
namespace {

class RunFiles : public ::testing::Test {
 protected:
  template <class Rows>
  void expect_error(const Result<Rows>& rows, const std::string& message) const {
    EXPECT_EQ(rows.message(), directory_.path("f.csv") + message);
  }
  std::string write(const std::string& text) { return directory_.write("f.csv", text); }

  TestDirectory directory_;
};

constexpr const char* kObjects = "id,class_id,label,x,y,z,a,b,c,state,observations\n";
constexpr const char* kLoops =
    "query_frame,match_frame,query_stamp,match_stamp,query_begin,query_end,match_begin,match_end,accepted,reason,score,"
    "x,y,z,qx,qy,qz,qw\n";

TEST_F(RunFiles, Objects) {
  const auto objects = read_objects(write(std::string(kObjects) + "7,41,cup,1,2,3,0.1,0.2,0.3,confirmed,12\n"));
  ASSERT_TRUE(objects) << objects.message();
  ASSERT_EQ(objects->size(), 1u);
  EXPECT_EQ(objects->at(0).id, 7);
  EXPECT_EQ(objects->at(0).class_id, 41);
  EXPECT_EQ(objects->at(0).label, "cup");
  EXPECT_EQ(objects->at(0).center, Vec3(1.0, 2.0, 3.0));
  EXPECT_EQ(objects->at(0).semi_axes, Vec3(0.1, 0.2, 0.3));
  EXPECT_EQ(objects->at(0).observations, 12);
  EXPECT_TRUE(read_objects(write(kObjects))->empty());
}

TEST_F(RunFiles, ObjectErrors) {
  expect_error(read_objects(write(std::string(kObjects) + "7,41,cup,1,2,nan,0.1,0.2,0.3,confirmed,12\n")),
               ":2: z = 'nan' is no finite number");
  expect_error(read_objects(write(std::string(kObjects) + "7,41,cup,1,2,3,0.1,0.2,0.3,gone,12\n")),
               ":2: state = 'gone' must be candidate, confirmed or retired");
  expect_error(read_objects(write(std::string(kObjects) + "7.5,41,cup,1,2,3,0.1,0.2,0.3,confirmed,12\n")),
               ":2: id = '7.5' is no integer");
  expect_error(read_objects(write(std::string(kObjects) + "7,41\n")), ":2: 2 fields instead of 11");
  expect_error(read_objects(write("id,class_id\n7,41\n")), ": column 'label' is missing");
  expect_error(read_objects(write("id,id\n7,41\n")), ":1: column 'id' is there twice");
  expect_error(read_objects(write("")), ": the file is empty");
  EXPECT_EQ(read_objects(directory_.path("none.csv")).message(),
            directory_.path("none.csv") + ": cannot open the file");
}

TEST_F(RunFiles, Loops) {
  const auto loops =
      read_loops(write(std::string(kLoops) + "9,2,1.000000,0.500000,8,9,1,3,1,accepted,7.5,1,2,3,0,0,0,1\n"));
  ASSERT_TRUE(loops) << loops.message();
  ASSERT_EQ(loops->size(), 1u);
  EXPECT_EQ(loops->at(0).query_stamp_ns, 1000000000);
  EXPECT_EQ(loops->at(0).match_end, 3);
  EXPECT_TRUE(loops->at(0).accepted);
  EXPECT_EQ(loops->at(0).score, 7.5);
  EXPECT_EQ(loops->at(0).T_match_query.t, Vec3(1.0, 2.0, 3.0));
}

TEST_F(RunFiles, LoopErrors) {
  expect_error(read_loops(write(std::string(kLoops) + "9,2,1.0,0.5,8,9,1,3,yes,accepted,7.5,1,2,3,0,0,0,1\n")),
               ":2: accepted = 'yes' is no integer");
  expect_error(read_loops(write(std::string(kLoops) + "9,2,1.0,0.5,8,9,1,3,2,accepted,7.5,1,2,3,0,0,0,1\n")),
               ":2: accepted = '2' must be 0 or 1");
  expect_error(read_loops(write(std::string(kLoops) + "9,2,1.0,0.5,8,9,1,3,1,accepted,7.5,1,2,3,0,0,0,2\n")),
               ":2: qw = '2' is part of a quaternion that is no rotation");
  expect_error(read_loops(write(std::string(kLoops) + "9,2,then,0.5,8,9,1,3,1,accepted,7.5,1,2,3,0,0,0,1\n")),
               ":2: query_stamp = 'then' is no stamp in seconds");
}

TEST_F(RunFiles, SightingsAreThoseOfConfirmedObjects) {
  directory_.write("trajectory.txt", "1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n");
  directory_.write("keyframes.csv", keyframe_table_header() + "0,0,1.0,0,0,0,0,0,0,1\n");
  directory_.write("objects.csv", std::string(kObjects) + "7,41,cup,1,2,3,0.1,0.1,0.1,confirmed,9\n" +
                                      "8,41,cup,1,2,3,0.1,0.1,0.1,candidate,9\n");
  const std::string header = "frame_id,detection_index,landmark_id,level\n";
  directory_.write("associations.csv", header + "0,0,7,joint\n0,1,8,joint\n1,0,9,joint\n1,1,-1,ignored\n");
  const auto sightings = read_sightings(directory_.path("."));
  ASSERT_TRUE(sightings) << sightings.message();
  EXPECT_EQ(*sightings, (SightingsByStamp{{1000000000, {7}}}));
  directory_.write("associations.csv", header + "2,0,7,joint\n");
  EXPECT_NE(read_sightings(directory_.path("."))
                .message()
                .find("associations.csv:2: frame_id = '2' is no frame of trajectory.txt"),
            std::string::npos);
  // A run that goes on with a map counts its frames on.
  directory_.write("keyframes.csv", keyframe_table_header() + "9,1,1.0,0,0,0,0,0,0,1\n");
  EXPECT_EQ(checked(read_sightings(directory_.path("."))), (SightingsByStamp{{2000000000, {7}}}));
  directory_.write("associations.csv", header + "0,0,7,joint\n");
  EXPECT_FALSE(read_sightings(directory_.path(".")));
}

TEST_F(RunFiles, Keyframes) {
  const auto keyframes = read_keyframes(
      write("keyframe_id,frame_id,stamp,x,y,z,qx,qy,qz,qw\n0,3,1.5,1,2,3,0,0,0,1\n1,9,2.25,1,2,4,0,0,0,1\n"));
  ASSERT_TRUE(keyframes) << keyframes.message();
  ASSERT_EQ(keyframes->size(), 2u);
  EXPECT_EQ(keyframes->at(0).stamp_ns, 1500000000);
  EXPECT_EQ(keyframes->at(1).frame_id, 9);
  EXPECT_EQ(keyframes->at(1).T_map_camera.t, Vec3(1.0, 2.0, 4.0));
}

TEST_F(RunFiles, WhatIsWrittenIsReadBack) {
  MappedObject object;
  object.id = 5;
  object.label = "cup";
  object.center = Vec3(1.0, -2.0, 0.5);
  object.rotation = Quaternion(0.5, 0.5, -0.5, 0.5);
  object.state = "retired";
  object.quality = 0.25;
  const auto objects = read_objects(write(object_table_header() + table_row(object)));
  ASSERT_TRUE(objects) << objects.message();
  EXPECT_EQ(objects->at(0).center, object.center);
  EXPECT_EQ(objects->at(0).rotation.coeffs(), object.rotation.coeffs());
  EXPECT_EQ(objects->at(0).quality, 0.25);
  LoopFigures loop;
  loop.query_frame = 9;
  loop.match_stamp_ns = 1500000000;
  loop.accepted = true;
  loop.reason = LoopReason::kAccepted;
  loop.T_match_query = SE3(object.rotation, object.center);
  const auto loops = read_loops(write(loop_table_header() + table_row(loop)));
  ASSERT_TRUE(loops) << loops.message();
  EXPECT_EQ(loops->at(0).query_frame, 9);
  EXPECT_EQ(loops->at(0).match_stamp_ns, 1500000000);
  EXPECT_EQ(loops->at(0).reason_text, "accepted");
  EXPECT_EQ(loops->at(0).T_match_query.t, object.center);
}

TEST_F(RunFiles, ReferenceObjectsOfFr2Desk) {
  const auto objects = read_reference_objects(std::string(STL_TEST_DATA_DIR) + "/reference_objects.csv");
  ASSERT_TRUE(objects) << objects.message();
  ASSERT_EQ(objects->size(), 27u);
  int certain = 0, probable = 0;
  for (const ReferenceObject& object : *objects) {
    certain += object.certainty == Certainty::kCertain ? 1 : 0;
    probable += object.certainty == Certainty::kProbable ? 1 : 0;
  }
  EXPECT_EQ(certain, 20);
  EXPECT_EQ(probable, 1);
  EXPECT_EQ(objects->at(6).label, "cell phone");
  EXPECT_EQ(objects->at(6).class_id, 67);
  EXPECT_EQ(objects->at(6).center, Vec3(1.1249, -1.5724, 0.7869));
}

TEST_F(RunFiles, ReferenceErrors) {
  expect_error(
      read_reference_objects(write("id,label_id,label,x,y,z,a,b,c,certainty\n-1,41,cup,1,2,3,1,1,1,certain\n")),
      ":2: id = '-1' must be >= 0");
  expect_error(read_reference_objects(write("id,label_id,label,x,y,z,a,b,c,certainty\n0,41,cup,1,2,3,1,1,1,perhaps\n")),
               ":2: certainty = 'perhaps' must be certain, probable or marginal");
}

}  // namespace
}  // namespace semantic_topo_loop::core
