#include "ros/live_settings.h"

#include <gtest/gtest.h>

#include <limits>
#include <set>

#include "ros/parameters.h"

namespace semantic_topo_loop {
namespace {

template <class Parameters>
auto value_of(const Parameters& parameters, const std::string& name) {
  for (const auto& parameter : parameters) {
    if (parameter.name == name) return parameter.value;
  }
  ADD_FAILURE() << name;
  return decltype(parameters.front().value)();
}

/// Names of the live fields of a struct; a second one of a name is a failure.
template <class Struct>
std::set<std::string> names() {
  const dynamic_reconfigure::ConfigDescription description = describe_settings(core::list_options<Struct>());
  std::set<std::string> names;
  for (const auto& parameter : description.groups.at(0).parameters) {
    EXPECT_TRUE(names.insert(parameter.name).second) << parameter.name;
    EXPECT_EQ(parameter.name.find_first_not_of("abcdefghijklmnopqrstuvwxyz_0123456789"), std::string::npos)
        << parameter.name << " is no identifier, which the tools ask for";
  }
  return names;
}

TEST(LiveSettings, AreWhatMayChangeWhileRunning) {
  EXPECT_EQ(names<core::AssociatorOptions>().count("min_score"), 1U);
  EXPECT_EQ(names<core::QuadricMapperOptions>().count("confirm_seen_s"), 1U);
  EXPECT_EQ(names<core::PoseGraphOptions>().count("urgent_chi2"), 1U);
  EXPECT_EQ(names<core::ObjectDetectorOptions>(), (std::set<std::string>{"nms_iou", "rate_hz", "score"}));
  EXPECT_EQ(names<VisualizationParameters>(), (std::set<std::string>{"camera_size_m", "label_size_m", "line_width_m"}));
  const std::set<std::string> loop = names<core::LoopOptions>();
  EXPECT_EQ(loop.count("min_inliers"), 1U);
  for (const char* name : {"mode", "window_s", "scale", "distance_tolerance_m"})
    EXPECT_EQ(loop.count(name), 0U) << name;
}

TEST(LiveSettings, AreDescribedByTheRows) {
  const auto description = describe_settings(core::list_options<core::LoopOptions>());
  ASSERT_EQ(description.groups.size(), 1U);
  const auto& parameters = description.groups[0].parameters;
  ASSERT_FALSE(parameters.empty());
  EXPECT_EQ(parameters[0].name, "enabled");
  EXPECT_EQ(parameters[0].type, "bool");
  EXPECT_EQ(parameters[1].name, "max_candidates");
  EXPECT_EQ(parameters[1].type, "int");
  EXPECT_EQ(parameters[1].description, "loops accepted an attempt at most (>= 1)");
  EXPECT_EQ(value_of(description.min.ints, "max_candidates"), 1);
  EXPECT_EQ(value_of(description.max.ints, "max_candidates"), std::numeric_limits<int>::max());
  EXPECT_EQ(value_of(description.min.doubles, "reprojection_iou"), 0.0);
  EXPECT_EQ(value_of(description.max.doubles, "reprojection_iou"), 1.0);
  EXPECT_EQ(value_of(description.max.doubles, "max_rms_m"), std::numeric_limits<double>::infinity());
  EXPECT_FALSE(value_of(description.min.bools, "enabled"));
  EXPECT_TRUE(value_of(description.max.bools, "enabled"));
  for (const auto* config : {&description.dflt, &description.min, &description.max}) {
    EXPECT_EQ(config->bools.size() + config->ints.size() + config->doubles.size(), parameters.size());
    EXPECT_EQ(config->groups.size(), 1U);
  }
}

TEST(LiveSettings, GoThereAndBackWithEveryDigit) {
  core::LoopOptions options;
  options.enabled = false;
  options.min_inliers = 9;
  options.max_rms_m = 0.1 + 0.2;
  const std::vector<core::OptionRow> rows = core::list_options(options);
  core::LoopOptions same;
  const core::Status changed = core::change_options(from_settings(to_settings(rows), rows), &same);
  EXPECT_TRUE(changed) << changed.message();
  EXPECT_FALSE(same.enabled);
  EXPECT_EQ(same.min_inliers, 9);
  EXPECT_EQ(same.max_rms_m, 0.1 + 0.2);
}

TEST(LiveSettings, WhatIsNoneIsRefusedByItsName) {
  const std::vector<core::OptionRow> rows = core::list_options<core::LoopOptions>();
  const auto error_of = [&rows](const std::string& name, double value) {
    dynamic_reconfigure::Config request;
    request.doubles.emplace_back();
    request.doubles[0].name = name;
    request.doubles[0].value = value;
    core::LoopOptions options;
    return core::change_options(from_settings(request, rows), &options).message();
  };
  EXPECT_EQ(error_of("window_s", 10.0), "parameter 'loop.window_s' = '10' cannot change while running");
  EXPECT_EQ(error_of("min_inlier", 10.0), "unknown parameter 'min_inlier' = '10'");
  EXPECT_EQ(error_of("min_inliers", 2.5), "parameter 'loop.min_inliers' = '2.5' is not an integer");
  EXPECT_EQ(error_of("max_rms_m", std::numeric_limits<double>::quiet_NaN()),
            "parameter 'loop.max_rms_m' = 'nan' is not a finite number");
}

}  // namespace
}  // namespace semantic_topo_loop
