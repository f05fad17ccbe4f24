#include "semantic_topo_loop/pipeline/options.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

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
  std::string error;
  EXPECT_TRUE(load_options(STL_CONFIG_DIR "/default.yaml", {}, &error)) << error;
}

TEST(Options, DocumentationIsWhatTheCodeSays) {
  EXPECT_EQ(generated_part(STL_SOURCE_DIR "/docs/parameters.md", "offline --list-parameters"),
            format_options_table(list_options<Options>()))
      << "scripts/generate_parameters writes it";
}

TEST(Config, CamerasAndClassesLoad) {
  std::string error;
  for (const std::string name : {"tum_fr1", "tum_fr2", "tum_fr3"}) {
    EXPECT_TRUE(read_camera(STL_CONFIG_DIR "/camera/" + name + ".yaml", &error)) << error;
  }
  const auto classes = read_class_table(STL_CONFIG_DIR "/classes_coco.yaml", &error);
  ASSERT_TRUE(classes) << error;
  EXPECT_EQ(classes->classes().size(), 80U);
}

}  // namespace
}  // namespace semantic_topo_loop::core
