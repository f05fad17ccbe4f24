#include "io/yaml.h"

#include <algorithm>
#include <set>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

std::string key_text(const YAML::Node& key) { return key.IsScalar() ? key.Scalar() : "(not a text)"; }

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

}  // namespace

std::string yaml_place(const std::string& path, const YAML::Node& node) {
  return node.Mark().is_null() ? path : path + ":" + std::to_string(node.Mark().line + 1);
}

std::optional<YAML::Node> read_yaml_map(const std::string& path, std::string* error) {
  const std::optional<std::string> text = read_text_file(path, error);
  if (!text) return std::nullopt;
  try {
    YAML::Node root = YAML::Load(*text);
    if (root.IsMap()) return root;
    *error = path + ": must be a YAML map";
  } catch (const YAML::Exception& exception) {
    *error = path + ":" + std::to_string(exception.mark.line + 1) + ": " + exception.msg;
  }
  return std::nullopt;
}

bool check_unique_keys(const std::string& path, const YAML::Node& map, std::string* error) {
  std::set<std::string> seen;
  for (const auto& entry : map) {
    if (seen.insert(key_text(entry.first)).second) continue;
    *error = yaml_place(path, entry.first) + ": key '" + key_text(entry.first) + "' is given twice";
    return false;
  }
  return true;
}

bool check_keys(const std::string& path, const YAML::Node& map, const std::vector<std::string>& allowed,
                const std::vector<std::string>& required, std::string* error) {
  if (!check_unique_keys(path, map, error)) return false;
  for (const auto& entry : map) {
    const std::string key = key_text(entry.first);
    if (std::find(allowed.begin(), allowed.end(), key) != allowed.end()) continue;
    *error = yaml_place(path, entry.first) + ": unknown key '" + key + "' (known: " + joined(allowed) + ")";
    return false;
  }
  for (const std::string& key : required) {
    if (map[key].IsDefined()) continue;
    *error = yaml_place(path, map) + ": key '" + key + "' is missing";
    return false;
  }
  return true;
}

}  // namespace semantic_topo_loop::core
