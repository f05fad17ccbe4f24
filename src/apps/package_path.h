#pragma once

#include <ros/package.h>

#include <string>

namespace semantic_topo_loop::apps {

/// Where `path`, the value of `argument`, is empty: a file of the package's config directory.
/// @return false with `error` set if the package is not on ROS_PACKAGE_PATH
inline bool default_to_package(const std::string& file, const std::string& argument, std::string* path,
                               std::string* error) {
  if (!path->empty()) return true;
  const std::string package = ros::package::getPath("semantic_topo_loop");
  *path = package + "/config/" + file;
  if (package.empty()) *error = "the package is not on ROS_PACKAGE_PATH: pass " + argument;
  return !package.empty();
}

}  // namespace semantic_topo_loop::apps
