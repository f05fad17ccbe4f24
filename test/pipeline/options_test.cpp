#include "semantic_topo_loop/pipeline/options.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <sstream>

#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"

namespace semantic_topo_loop::core {
namespace {

std::string file_text(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
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

TEST(Options, DefaultFileEqualsTheCode) {
  std::string error;
  const auto texts = read_option_texts(STL_CONFIG_DIR "/default.yaml", &error);
  ASSERT_TRUE(texts) << error;
  EXPECT_TRUE(make_options<Options>(*texts)) << make_options<Options>(*texts).message();
  const std::vector<OptionRow> rows = list_options<Options>();
  EXPECT_EQ(texts->size(), rows.size());
  for (const OptionRow& row : rows) {
    const auto text = texts->find(row.key);
    ASSERT_NE(text, texts->end()) << row.key;
    EXPECT_EQ(text->second, row.value) << row.key;
  }
}

TEST(Options, DocumentationListsEveryParameterWithItsDefault) {
  const std::string page = file_text(STL_CONFIG_DIR "/../docs/parameters.md");
  for (const OptionRow& row : list_options<Options>()) {
    EXPECT_NE(page.find("| `" + row.key + "` | " + row.value + " | " + row.meaning + " |"), std::string::npos)
        << row.key;
  }
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
