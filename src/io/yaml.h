#pragma once

#include <yaml-cpp/yaml.h>

#include <optional>
#include <string>

namespace semantic_topo_loop::core {

/// Parses a YAML file whose root is a map; nullopt with file, line and cause in `error`.
std::optional<YAML::Node> read_yaml_map(const std::string& path, std::string* error);

/// "<path>:<line>" of a node, for messages.
std::string yaml_place(const std::string& path, const YAML::Node& node);

/// False, with file, line and key in `error`, if the map has a key twice, one that is not in `allowed`, or none of a
/// `required` one. yaml-cpp itself silently keeps one of two equal keys.
bool check_keys(const std::string& path, const YAML::Node& map, const std::vector<std::string>& allowed,
                const std::vector<std::string>& required, std::string* error);
/// The part of check_keys that names a key given twice.
bool check_unique_keys(const std::string& path, const YAML::Node& map, std::string* error);

/// The scalar of a key as T, or nullopt with file, line, key, value and `expected` in `error`.
template <class T>
std::optional<T> yaml_value(const std::string& path, const YAML::Node& map, const char* key, const char* expected,
                            std::string* error) {
  const YAML::Node node = map[key];
  T value{};
  if (node.IsScalar() && YAML::convert<T>::decode(node, value)) return value;
  *error =
      yaml_place(path, node) + ": '" + key + "' = '" + (node.IsScalar() ? node.Scalar() : "") + "' must be " + expected;
  return std::nullopt;
}

}  // namespace semantic_topo_loop::core
