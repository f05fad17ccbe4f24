#include "semantic_topo_loop/io/class_table_yaml.h"

#include "io/yaml.h"

namespace semantic_topo_loop::core {
namespace {

std::optional<ClassRole> parse_role(const std::string& text) {
  if (text == "static") return ClassRole::kStatic;
  if (text == "movable") return ClassRole::kMovable;
  if (text == "dynamic") return ClassRole::kDynamic;
  if (text == "ignore") return ClassRole::kIgnore;
  return std::nullopt;
}

std::optional<ObjectClass> parse_class(const std::string& path, const YAML::Node& node, std::string* error) {
  if (!node.IsMap()) {
    *error = yaml_place(path, node) + ": a class must be a map {id, name, role, group, size_prior_m}";
    return std::nullopt;
  }
  if (!check_keys(path, node, {"id", "name", "role", "group", "size_prior_m"}, {"id", "name", "role"}, error)) {
    return std::nullopt;
  }
  const auto id = yaml_value<int>(path, node, "id", "an integer", error);
  const auto name = yaml_value<std::string>(path, node, "name", "a text", error);
  const auto role_text = yaml_value<std::string>(path, node, "role", "a text", error);
  if (!id || !name || !role_text) return std::nullopt;
  if (name->empty() || name->find_first_of(",\"\n") != std::string::npos) {
    // Names are fields of the CSV files.
    *error = yaml_place(path, node["name"]) + ": 'name' = '" + *name + "' must be a text without commas and quotes";
    return std::nullopt;
  }
  const std::optional<ClassRole> role = parse_role(*role_text);
  if (!role) {
    *error =
        yaml_place(path, node["role"]) + ": 'role' = '" + *role_text + "' must be static, movable, dynamic or ignore";
    return std::nullopt;
  }
  ObjectClass object_class;
  object_class.id = *id;
  object_class.name = *name;
  object_class.role = *role;
  if (node["group"].IsDefined()) {
    const auto group = yaml_value<std::string>(path, node, "group", "a text", error);
    if (!group) return std::nullopt;
    object_class.group = *group;
  }
  if (node["size_prior_m"].IsDefined()) {
    const auto size = yaml_value<double>(path, node, "size_prior_m", "a number > 0", error);
    if (!size) return std::nullopt;
    if (!(*size > 0.0)) {
      *error = yaml_place(path, node["size_prior_m"]) + ": 'size_prior_m' = '" + node["size_prior_m"].Scalar() +
               "' must be a number > 0";
      return std::nullopt;
    }
    object_class.size_prior_m = *size;
  }
  return object_class;
}

std::optional<ClassTable> parse_class_table(const std::string& path, std::string* error) {
  const std::optional<YAML::Node> root = read_yaml_map(path, error);
  if (!root || !check_keys(path, *root, {"classes"}, {"classes"}, error)) return std::nullopt;
  const YAML::Node list = (*root)["classes"];
  if (!list.IsSequence() || list.size() == 0) {
    *error = yaml_place(path, list) + ": 'classes' must be a list of classes";
    return std::nullopt;
  }
  std::vector<ObjectClass> classes;
  for (const YAML::Node& node : list) {
    std::optional<ObjectClass> object_class = parse_class(path, node, error);
    if (!object_class) return std::nullopt;
    classes.push_back(std::move(*object_class));
  }
  Result<ClassTable> table = ClassTable::create(std::move(classes));
  if (table) return *std::move(table);
  *error = path + ": " + table.message();
  return std::nullopt;
}

}  // namespace

std::optional<ClassTable> read_class_table(const std::string& path, std::string* error) {
  std::string problem;
  std::optional<ClassTable> table = parse_class_table(path, &problem);
  if (!table && error != nullptr) *error = problem;
  return table;
}

}  // namespace semantic_topo_loop::core
