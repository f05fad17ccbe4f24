#include "semantic_topo_loop/io/yaml_files.h"

#include <gtest/gtest.h>

#include <set>

#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

class YamlFiles : public ::testing::Test {
 protected:
  std::string write(const std::string& text) { return directory_.write("f.yaml", text); }
  void expect_error(const std::string& error, const std::string& part) const {
    EXPECT_NE(error.find(directory_.path("f.yaml")), std::string::npos) << error;
    EXPECT_NE(error.find(part), std::string::npos) << error;
  }
  void expect_bad_classes(const std::string& text, const std::string& part) {
    expect_error(read_class_table(write(text)).message(), part);
  }
  void expect_bad_camera(const std::string& text, const std::string& part) {
    expect_error(read_camera(write(text)).message(), part);
  }
  void expect_bad_options(const std::string& text, const std::string& part) {
    expect_error(read_option_texts(write(text)).message(), part);
  }

  TestDirectory directory_;
};

constexpr const char* kCamera =
    "fx: 500\nfy: 501.5\ncx: 320\ncy: 240\nwidth: 640\nheight: 480\ndistortion: [0.1, -0.2, 0.01, 0.02, 0.3]\n";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  return text.replace(text.find(from), from.size(), to);
}

TEST_F(YamlFiles, ClassTable) {
  const auto table = read_class_table(
      write("classes:\n"
            "  - {id: 41, name: cup, role: movable, group: vessel, size_prior_m: 0.1, size_range_m: [0.05, 0.2]}\n"
            "  - {id: 0, name: person, role: dynamic}\n"));
  ASSERT_TRUE(table) << table.message();
  EXPECT_EQ(table->classes().size(), 2u);
  EXPECT_EQ(table->find(41)->name, "cup");
  EXPECT_EQ(table->find(41)->group, "vessel");
  EXPECT_EQ(table->find(41)->size_prior_m, 0.1);
  EXPECT_EQ(table->find(41)->size_min_m, 0.05);
  EXPECT_EQ(table->find(41)->size_max_m, 0.2);
  EXPECT_EQ(table->find(0)->role, ClassRole::kDynamic);
  EXPECT_TRUE(table->find(0)->group.empty());
}

TEST_F(YamlFiles, ClassTableErrors) {
  expect_bad_classes("classes:\n  - {id: 1, name: a, role: static}\n  - {id: 2, name: b, role: solid}\n",
                     ":3: 'role' = 'solid' must be static, movable, dynamic or ignore");
  expect_bad_classes("classes:\n  - {id: 1, name: a, role: static, colour: red}\n", ":2: unknown key 'colour'");
  expect_bad_classes("classes:\n  - {id: 1, role: static}\n", "key 'name' is missing");
  expect_bad_classes("classes:\n  - {id: one, name: a, role: static}\n", ":2: 'id' = 'one' must be an integer");
  expect_bad_classes("classes:\n  - {id: 1, name: a, role: static, size_prior_m: -1}\n", "'size_prior_m' = '-1'");
  for (const char* range : {"0.1", "[0.1]", "[0.2, 0.1]", "[-1, 1]", "[0.1, .nan]"}) {
    expect_bad_classes(std::string("classes:\n  - {id: 1, name: a, role: static, size_range_m: ") + range + "}\n",
                       "'size_range_m'");
  }
  expect_bad_classes("classes:\n  - {id: 1, name: 'a,b', role: static}\n", "'name' = 'a,b'");
  expect_bad_classes("classes:\n  - {id: 1, name: a, role: static}\n  - {id: 1, name: b, role: static}\n",
                     "class id 1 is listed twice");
  expect_bad_classes("classes:\n  - {id: 1, id: 2, name: a, role: static}\n", ":2: key 'id' is given twice");
  expect_bad_classes("classes: []\n", "'classes' must be a list of classes");
  expect_bad_classes("classes:\n  - cup\n", ":2: a class must be a map");
  expect_bad_classes("", "must be a YAML map");
  expect_bad_classes("classes: [\n", ":2");
  EXPECT_EQ(read_class_table(directory_.path("none.yaml")).message(),
            directory_.path("none.yaml") + ": cannot open the file");
}

TEST_F(YamlFiles, CocoIsComplete) {
  const auto table = read_class_table(std::string(STL_CONFIG_DIR) + "/classes_coco.yaml");
  ASSERT_TRUE(table) << table.message();
  ASSERT_EQ(table->classes().size(), 80u);
  std::set<std::string> names;
  int expected_id = 0;
  for (const auto& [id, object_class] : table->classes()) {
    EXPECT_EQ(id, expected_id++);
    EXPECT_TRUE(names.insert(object_class.name).second) << object_class.name;
    EXPECT_FALSE(object_class.group.empty()) << object_class.name;
  }
  for (const char* name : {"person", "cat", "dog", "car"}) EXPECT_FALSE(table->is_mappable(table->find(name)->id));
  for (const char* name : {"tv", "teddy bear", "chair", "cup"}) EXPECT_TRUE(table->is_mappable(table->find(name)->id));
  const auto confusable = [&](const char* a, const char* b) {
    return table->confusable(table->find(a)->id, table->find(b)->id);
  };
  EXPECT_TRUE(confusable("fork", "spoon"));
  EXPECT_TRUE(confusable("mouse", "cell phone"));
  EXPECT_TRUE(confusable("cup", "vase"));
  EXPECT_FALSE(confusable("cup", "book"));
  EXPECT_EQ(table->find(77)->name, "teddy bear");
}

TEST_F(YamlFiles, Camera) {
  const auto camera = read_camera(write(kCamera));
  ASSERT_TRUE(camera) << camera.message();
  EXPECT_EQ(camera->fx, 500.0);
  EXPECT_EQ(camera->fy, 501.5);
  EXPECT_EQ(camera->cx, 320.0);
  EXPECT_EQ(camera->cy, 240.0);
  EXPECT_EQ(camera->width, 640);
  EXPECT_EQ(camera->height, 480);
  EXPECT_EQ(camera->distortion, (std::array<double, 5>{0.1, -0.2, 0.01, 0.02, 0.3}));
}

TEST_F(YamlFiles, CameraErrors) {
  expect_bad_camera(std::string(kCamera) + "scale: 1\n", ":8: unknown key 'scale'");
  expect_bad_camera(replaced(kCamera, "cy: 240\n", ""), "key 'cy' is missing");
  expect_bad_camera(replaced(kCamera, "501.5", "wide"), ":2: 'fy' = 'wide' must be a number");
  expect_bad_camera(replaced(kCamera, "501.5", "-5"), "fy = -5 must be > 0");
  expect_bad_camera(replaced(kCamera, "501.5", "[1, 2]"), ":2: 'fy' must be a number");
  expect_bad_camera(replaced(kCamera, "640", "640.5"), ":5: 'width' = '640.5' must be an integer");
  expect_bad_camera(replaced(kCamera, ", 0.3]", "]"), ":7: 'distortion' must be five numbers");
  expect_bad_camera(replaced(kCamera, "0.3]", "k3]"), ":7: 'distortion' must be five numbers");
  expect_bad_camera(replaced(kCamera, "0.3]", ".nan]"), "distortion = nan must be finite");
  expect_bad_camera(std::string(kCamera) + "fx: 1\n", ":8: key 'fx' is given twice");
}

TEST_F(YamlFiles, OptionTexts) {
  const auto texts =
      read_option_texts(write("association:\n  mode: cascade\n  min_score: 0.5\nkeyframe: {max_interval_s: 2}\n"));
  ASSERT_TRUE(texts) << texts.message();
  EXPECT_EQ(*texts,
            (OptionTexts{
                {"association.mode", "cascade"}, {"association.min_score", "0.5"}, {"keyframe.max_interval_s", "2"}}));
}

TEST_F(YamlFiles, OptionErrors) {
  expect_bad_options("association:\n  mode: joint\n  typo: 1\n", ":3: unknown parameter 'association.typo' = '1'");
  expect_bad_options("nothing:\n  at: all\n", ":2: unknown parameter 'nothing.at' = 'all'");
  expect_bad_options("association:\n  min_score: high\n",
                     ":2: parameter 'association.min_score' = 'high' is not a finite number");
  expect_bad_options("association:\n  min_score: 0.1\n  min_score: 0.2\n", ":3: key 'min_score' is given twice");
  expect_bad_options("association: {}\nassociation: {}\n", ":2: key 'association' is given twice");
  expect_bad_options("association: 3\n", ":1: 'association' must be a map of options");
  expect_bad_options("association:\n  mode: [joint]\n", ":2: 'association.mode' must be a single value");
  expect_bad_options("association\n", "must be a YAML map");
  expect_bad_options("a: [", "f.yaml:");
  expect_bad_options("a: {b:", "f.yaml:");
}

TEST_F(YamlFiles, AssignmentsOverrideTheFile) {
  const std::string path = write("association:\n  min_score: 0.5\n  border_px: 12\n");
  const auto options = load_options(path, {{"association.min_score", "0.4"}, {"loop.enabled", "false"}});
  ASSERT_TRUE(options) << options.message();
  EXPECT_EQ(options->association.min_score, 0.4);
  EXPECT_EQ(options->association.border_px, 12.0);
  EXPECT_FALSE(options->loop.enabled);
  EXPECT_EQ(load_options("", {}).message(), "");
}

TEST_F(YamlFiles, BadAssignments) {
  EXPECT_EQ(load_options("", {{"association.typo", "3"}}).message(), "unknown parameter 'association.typo' = '3'");
  EXPECT_EQ(load_options("", {{"keyframe.max_interval_s", "-1"}}).message(),
            "parameter 'keyframe.max_interval_s' = '-1' must be > 0");
}

}  // namespace
}  // namespace semantic_topo_loop::core
