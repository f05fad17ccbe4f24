#include "semantic_topo_loop/pipeline/options.h"

#include <gtest/gtest.h>

#include <limits>

#include "semantic_topo_loop/io/yaml_files.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

TEST(Range, HoldsWhatItsRuleSays) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  struct Case {
    Range range;
    std::string rule;
    std::vector<double> in, out;
  };
  for (const Case& one :
       {Case{any(), "", {-1e9, 1e9}, {nan, infinity}}, Case{positive(), "> 0", {1e-9, 1e9}, {0.0, -1.0, nan, infinity}},
        Case{not_negative(), ">= 0", {0.0, 1e9}, {-1e-9, nan}}, Case{at_least(3), ">= 3", {3.0}, {2.0, nan}},
        Case{share(), "in [0, 1]", {0.0, 1.0}, {-0.1, 1.1, nan}},
        Case{above(1).at_most(2), "in (1, 2]", {1.1, 2.0}, {1.0, 2.1, nan}},
        Case{at_least(0).below(180), "in [0, 180)", {0.0, 179.0}, {-1.0, 180.0, nan}}}) {
    EXPECT_EQ(one.range.rule(), one.rule);
    for (const double value : one.in) EXPECT_TRUE(one.range.holds(value)) << value << " must be " << one.rule;
    for (const double value : one.out) EXPECT_FALSE(one.range.holds(value)) << value << " must be " << one.rule;
  }
  EXPECT_EQ(one_of({"a", "b", "c"}).rule(), "a, b or c");
  EXPECT_TRUE(one_of({"a", "b"}).holds("b"));
  EXPECT_FALSE(one_of({"a", "b"}).holds("c"));
  EXPECT_FALSE(given().holds(""));
}

TEST(Options, RulesBetweenFieldsAreChecked) {
  for (const auto& [key, rule] : {std::pair("frontend.max_keyframes", ">= 2 frontend.window_keyframes"),
                                  std::pair("mapping.fit_views_max", ">= mapping.min_views")}) {
    EXPECT_EQ(make_options<Options>({{key, "5"}}).message(),
              "parameter '" + std::string(key) + "' = '5' must be " + rule);
  }
}

TEST(Options, LevelsAreOfTheCascadeAlone) {
  for (const char* mode : {"joint", "jda"}) {
    EXPECT_EQ(make_options<Options>({{"association.mode", mode}, {"association.levels", "2d"}}).message(),
              "parameter 'association.levels' = '2d' must be 2d,pro,3d unless association.mode is cascade");
  }
  EXPECT_TRUE(make_options<Options>({{"association.mode", "cascade"}, {"association.levels", "2d"}}));
  EXPECT_TRUE(make_options<Options>({{"association.mode", "joint"}, {"association.levels", "2d,pro,3d"}}));
}

TEST(Options, DefaultsAreValid) {
  const auto options = make_options<Options>({});
  EXPECT_TRUE(options) << options.message();
}

TEST(Options, EveryFieldCanBeSetByItsKey) {
  for (const OptionRow& row : list_options<Options>()) {
    const auto options = make_options<Options>({{row.key, row.value}});
    EXPECT_TRUE(options) << options.message();
    EXPECT_FALSE(row.meaning.empty()) << row.key;
  }
}

TEST(Options, UnknownKeyWrongTypeAndRangeAreErrorsThatNameThem) {
  const auto error_of = [](const std::string& key, const std::string& value) {
    const auto options = make_options<Options>({{key, value}});
    EXPECT_FALSE(options) << key;
    EXPECT_NE(options.message().find(key), std::string::npos) << options.message();
    return options.message();
  };
  EXPECT_NE(error_of("association.iou_2d_mni", "0.5").find("unknown"), std::string::npos);
  EXPECT_NE(error_of("association.iou_2d_min", "half").find("half"), std::string::npos);
  EXPECT_NE(error_of("association.iou_2d_min", "nan").find("nan"), std::string::npos);
  EXPECT_NE(error_of("mapping.min_views", "3.5").find("3.5"), std::string::npos);
  EXPECT_NE(error_of("loop.enabled", "maybe").find("maybe"), std::string::npos);
  EXPECT_NE(error_of("loop.mode", "magic").find("magic"), std::string::npos);
  EXPECT_NE(error_of("keyframe.max_interval_s", "-1").find("-1"), std::string::npos);
  EXPECT_NE(error_of("pose_graph.robust", "hope").find("hope"), std::string::npos);
}

TEST(Options, DefaultFileIsWhatTheCodeSays) {
  const std::string text = read_whole(STL_CONFIG_DIR "/default.yaml"), options = text.substr(text.find("depth:"));
  EXPECT_EQ(options, format_options_yaml(list_options<Options>())) << "scripts/generate_parameters writes it";
  EXPECT_EQ(load_options(STL_CONFIG_DIR "/default.yaml", {}).message(), "");
}

TEST(Options, DocumentationIsWhatTheCodeSays) {
  EXPECT_EQ(generated_part(STL_SOURCE_DIR "/docs/parameters.md", "offline --list-parameters"),
            format_options_table(list_options<Options>()))
      << "scripts/generate_parameters writes it";
}

TEST(Config, CamerasAndClassesLoad) {
  for (const std::string name : {"tum_fr1", "tum_fr2", "tum_fr3"}) {
    EXPECT_EQ(read_camera(STL_CONFIG_DIR "/camera/" + name + ".yaml").message(), "");
  }
  const auto classes = read_class_table(STL_CONFIG_DIR "/classes_coco.yaml");
  ASSERT_TRUE(classes) << classes.message();
  EXPECT_EQ(classes->classes().size(), 80U);
}

}  // namespace
}  // namespace semantic_topo_loop::core
