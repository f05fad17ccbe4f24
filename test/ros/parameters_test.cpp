#include "ros/parameters.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/io/yaml_files.h"
#include "support/test_files.h"

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
  const auto texts = flatten_parameters(tree);
  ASSERT_TRUE(texts) << texts.message();
  const core::OptionTexts expected = {{"map_frame", "map"},
                                      {"queue_size", "12"},
                                      {"association.iou_2d_min", "0.3"},
                                      {"association.min_score", "0.30000000000000004"},
                                      {"loop.enabled", "false"}};
  EXPECT_EQ(*texts, expected);
}

TEST(Flatten, NothingSetIsEmpty) {
  const auto texts = flatten_parameters(XmlRpcValue());
  ASSERT_TRUE(texts);
  EXPECT_TRUE(texts->empty());
}

TEST(Flatten, RefusesListsByName) {
  XmlRpcValue tree;
  tree["mapping"]["min_views"][0] = 3;
  EXPECT_EQ(flatten_parameters(tree).message(),
            "parameter 'mapping.min_views' is neither a text, a number, true, false nor a group");
}

TEST(OwnParameters, LeaveOutWhatOthersHaveInTheNamespace) {
  const core::OptionTexts own = {
      {"color_transport", "compressed"}, {"compressedDepth.png_level", "9"}, {"loop.enabled", "false"}};
  core::OptionTexts all = own;
  all.insert({{"compressed.mode", "color"}, {"compressed.jpeg.quality", "80"}, {"diagnostic_period", "0.5"}});
  EXPECT_EQ(own_parameters(all), own) << "of transports that are in use";
  all["depth_transport"] = "compressedDepth";
  EXPECT_EQ(own_parameters(all).count("compressedDepth.png_level"), 0U);
}

TEST(NodeletParameters, SplitsCoreOptionsFromItsOwn) {
  const auto parameters = make_nodelet_parameters<StageParameters>(
      {{"queue_size", "7"}, {"association.min_score", "1"}, {"loop.mode", "paper"}});
  ASSERT_TRUE(parameters) << parameters.message();
  EXPECT_EQ(parameters->own.queue_size, 7);
  EXPECT_EQ(parameters->options.association.min_score, 1.0);
  EXPECT_EQ(parameters->options.loop.mode, "paper");
}

TEST(NodeletParameters, NothingSetGivesTheDefaults) {
  const auto parameters = make_nodelet_parameters<StageParameters>({});
  ASSERT_TRUE(parameters) << parameters.message();
  EXPECT_EQ(parameters->own.queue_size, StageParameters().queue_size);
}

TEST(NodeletParameters, WhatIsWrongIsNamed) {
  const auto error_of = [](const char* key, const char* value) {
    return make_nodelet_parameters<StageParameters>({{key, value}}).message();
  };
  EXPECT_EQ(error_of("association.min_scor", "0.5"), "unknown parameter 'association.min_scor' = '0.5'");
  EXPECT_EQ(error_of("queue_sise", "3"), "unknown parameter 'queue_sise' = '3'");
  EXPECT_EQ(error_of("queue_size", "many"), "parameter 'queue_size' = 'many' is not an integer");
  EXPECT_EQ(error_of("loop.enabled", "perhaps"), "parameter 'loop.enabled' = 'perhaps' is not true or false");
  EXPECT_EQ(error_of("queue_size", "1"), "parameter 'queue_size' = '1' must be >= 2");
  EXPECT_EQ(error_of("loop.mode", "magic"), "parameter 'loop.mode' = 'magic' must be graph or paper");
}

TEST(NodeletParameters, StagesWithClassesRequireTheTable) {
  EXPECT_EQ(make_nodelet_parameters<ClassStageParameters>({}).message(), "parameter 'class_table' = '' must be given");
}

TEST(NodeletParameters, RulesBetweenThemAreChecked) {
  PlayerParameters player;
  player.mode = "film";
  EXPECT_EQ(core::validate(player).message(), "parameter 'mode' = 'film' must be files or bag");
  player.mode = "bag";
  player.bag.file = "a.bag";
  EXPECT_TRUE(core::validate(player)) << core::validate(player).message();
  player.rate = -1.0;
  EXPECT_EQ(core::validate(player).message(), "parameter 'rate' = '-1' must be > 0");
  player.rate = 1.0;
  player.credit = player.queue_size;
  EXPECT_EQ(core::validate(player).message(), "parameter 'credit' = '60' must be less than queue_size")
      << "so many would be dropped";

  PoseFrontendParameters frontend;
  frontend.class_table = "coco.yaml";
  EXPECT_TRUE(core::validate(frontend)) << core::validate(frontend).message();
  frontend.pose_source = "file";
  EXPECT_EQ(core::validate(frontend).message(), "parameter 'trajectory_file' = '' must be given with pose_source file");
  frontend.pose_source = "gps";
  EXPECT_EQ(core::validate(frontend).message(), "parameter 'pose_source' = 'gps' must be file, tf or odometry");
}

TEST(NodeletParameters, DocumentationIsWhatTheCodeSays) {
  EXPECT_EQ(core::generated_part(STL_SOURCE_DIR "/docs/parameters.md", "offline --list-nodelet-parameters"),
            core::format_options_table(list_nodelet_parameters(), "nodelet"))
      << "scripts/generate_parameters writes it";
}

}  // namespace
}  // namespace semantic_topo_loop
