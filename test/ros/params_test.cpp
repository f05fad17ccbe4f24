#include "ros/params.h"

#include <gtest/gtest.h>

#include "ros/stage.h"

namespace semantic_topo_loop {
namespace {

using XmlRpc::XmlRpcValue;

TEST(Flatten, JoinsGroupsAndKeepsEveryDigit) {
  XmlRpcValue tree;
  tree["map_frame"] = "map";
  tree["queue_size"] = 12;
  tree["association"]["min_score"] = 0.1 + 0.2;
  tree["association"]["iou_2d_min"] = 0.3;
  tree["loop"]["enabled"] = XmlRpcValue(false);
  std::string error;
  const auto texts = flatten_parameters(tree, &error);
  ASSERT_TRUE(texts) << error;
  const ParameterTexts expected = {{"map_frame", "map"},
                                   {"queue_size", "12"},
                                   {"association.iou_2d_min", "0.3"},
                                   {"association.min_score", "0.30000000000000004"},
                                   {"loop.enabled", "false"}};
  EXPECT_EQ(*texts, expected);
}

TEST(Flatten, NothingSetIsEmpty) {
  const auto texts = flatten_parameters(XmlRpcValue(), nullptr);
  ASSERT_TRUE(texts);
  EXPECT_TRUE(texts->empty());
}

TEST(Flatten, RefusesListsByName) {
  XmlRpcValue tree;
  tree["mapping"]["min_views"][0] = 3;
  std::string error;
  EXPECT_FALSE(flatten_parameters(tree, &error));
  EXPECT_EQ(error, "parameter 'mapping.min_views' is neither a text, a number, true, false nor a group");
}

TEST(NodeletParameters, SplitsCoreOptionsFromItsOwn) {
  std::string error;
  const auto parameters = make_nodelet_parameters<StageParameters>(
      {{"queue_size", "7"}, {"association.min_score", "1"}, {"loop.mode", "paper"}}, &error);
  ASSERT_TRUE(parameters) << error;
  EXPECT_EQ(parameters->own.queue_size, 7);
  EXPECT_EQ(parameters->options.association.min_score, 1.0);
  EXPECT_EQ(parameters->options.loop.mode, "paper");
}

TEST(NodeletParameters, NothingSetGivesTheDefaults) {
  std::string error;
  const auto parameters = make_nodelet_parameters<StageParameters>({}, &error);
  ASSERT_TRUE(parameters) << error;
  EXPECT_EQ(parameters->own.queue_size, StageParameters().queue_size);
}

TEST(NodeletParameters, NamesTheUnknownKey) {
  std::string error;
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"association.min_scor", "0.5"}}, &error));
  EXPECT_NE(error.find("unknown parameter 'association.min_scor' = '0.5'"), std::string::npos) << error;
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"queue_sise", "3"}}, &error));
  EXPECT_NE(error.find("unknown parameter 'queue_sise' = '3'"), std::string::npos) << error;
}

TEST(NodeletParameters, NamesTheValueOfTheWrongType) {
  std::string error;
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"queue_size", "many"}}, &error));
  EXPECT_NE(error.find("'queue_size' = 'many'"), std::string::npos) << error;
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"loop.enabled", "perhaps"}}, &error));
  EXPECT_NE(error.find("'loop.enabled' = 'perhaps'"), std::string::npos) << error;
}

TEST(NodeletParameters, NamesTheValueOutOfRange) {
  std::string error;
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"queue_size", "1"}}, &error));
  EXPECT_EQ(error, "parameter 'queue_size' = 1 must be at least 2");
  EXPECT_FALSE(make_nodelet_parameters<StageParameters>({{"loop.mode", "magic"}}, &error));
  EXPECT_NE(error.find("'loop.mode' = 'magic'"), std::string::npos) << error;
}

TEST(NodeletParameters, StagesWithClassesRequireTheTable) {
  std::string error;
  EXPECT_FALSE(make_nodelet_parameters<ClassStageParameters>({}, &error));
  EXPECT_EQ(error, "parameter 'class_table' = '' must name a class table file");
}

}  // namespace
}  // namespace semantic_topo_loop
