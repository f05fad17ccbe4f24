#pragma once

#include <ros/package.h>

#include <string>

namespace semantic_topo_loop::apps {

/// A file of the package's config directory; empty if the package is not on ROS_PACKAGE_PATH.
inline std::string config_file(const std::string& name) {
  const std::string package = ros::package::getPath("semantic_topo_loop");
  return package.empty() ? std::string() : package + "/config/" + name;
}

}  // namespace semantic_topo_loop::apps
