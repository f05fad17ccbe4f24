#pragma once

#include <dynamic_reconfigure/Config.h>
#include <dynamic_reconfigure/ConfigDescription.h>
#include <ros/node_handle.h>

#include <functional>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop {

/// The live rows of an options struct as dynamic_reconfigure's tools know them: by the names of the fields
/// (`min_inliers`), since the tools want identifiers. A nodelet has those of one struct, so that no two are called
/// alike.
dynamic_reconfigure::Config to_settings(const std::vector<core::OptionRow>& rows);
/// What there is to set, with types, bounds and meanings. An open bound is told as a closed one: the tools know no
/// other, and what counts is the check of what they ask for.
/// @param defaults rows of the struct as it is by default
dynamic_reconfigure::ConfigDescription describe_settings(const std::vector<core::OptionRow>& defaults);
/// What a tool asks for, by key; what no row is called by keeps its name.
core::OptionTexts from_settings(const dynamic_reconfigure::Config& settings, const std::vector<core::OptionRow>& rows);

/// Tells dynamic_reconfigure's tools what the live fields of an options struct are, and changes them. Not thread-safe.
class LiveSettings {
 public:
  using Rows = std::function<std::vector<core::OptionRow>()>;
  using Change = std::function<core::Status(const core::OptionTexts&)>;

  /// @param node namespace of the topics and of the parameters   @param rows of the struct as it is now
  /// @param change as core::change_options of the struct
  LiveSettings(const ros::NodeHandle& node, const std::vector<core::OptionRow>& defaults, Rows rows, Change change);

  /// Changes all or none. What has changed is on the parameter server, too, under the name that it is loaded by.
  core::Status change(const core::OptionTexts& texts);
  core::Status change(const dynamic_reconfigure::Config& settings) { return change(from_settings(settings, rows_())); }
  dynamic_reconfigure::Config settings() const { return to_settings(rows_()); }

 private:
  ros::NodeHandle node_;
  Rows rows_;
  Change change_;
  ros::Publisher descriptions_, updates_;
};

}  // namespace semantic_topo_loop
