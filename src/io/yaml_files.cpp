#include "semantic_topo_loop/io/yaml_files.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <boost/algorithm/string/join.hpp>
#include <map>
#include <set>
#include <sstream>
#include <utility>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

std::string key_text(const YAML::Node& key) { return key.IsScalar() ? key.Scalar() : "(not a text)"; }

/// "<path>:<line>" of a node, for messages.
std::string yaml_place(const std::string& path, const YAML::Node& node) {
  return node.Mark().is_null() ? path : path + ":" + std::to_string(node.Mark().line + 1);
}

/// Parses a YAML file whose root is a map; the error has file, line and cause.
Result<YAML::Node> read_yaml_map(const std::string& path) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  try {
    // yaml-cpp 0.6 waits for ever for what follows a colon that ends the text.
    const bool ends_a_line = !text->empty() && text->back() == '\n';
    YAML::Node root = YAML::Load(ends_a_line ? *text : *text + '\n');
    if (root.IsMap()) return root;
    return Error{path + ": must be a YAML map"};
  } catch (const YAML::Exception& exception) {
    return Error{at_line(path, exception.mark.line + 1, exception.msg)};
  }
}

/// An error, with file, line and key, if the map has a key twice; yaml-cpp itself silently keeps one of the two.
Status check_unique_keys(const std::string& path, const YAML::Node& map) {
  std::set<std::string> seen;
  for (const auto& entry : map) {
    if (seen.insert(key_text(entry.first)).second) continue;
    return Error{yaml_place(path, entry.first) + ": key '" + key_text(entry.first) + "' is given twice"};
  }
  return {};
}

/// @return false if the node is no such scalar
template <class T>
bool decode(const YAML::Node& node, T* value) {
  return node.IsScalar() && YAML::convert<T>::decode(node, *value);
}
/// yaml-cpp reads digits as the locale says, and knows .nan and .inf.
bool decode(const YAML::Node& node, double* value) {
  if (!node.IsScalar()) return false;
  if (node.Scalar().find_first_of("0123456789") == std::string::npos)
    return YAML::convert<double>::decode(node, *value);
  const std::optional<double> number = parse_double(node.Scalar());
  *value = number.value_or(0.0);
  return number.has_value();
}

/// A map of a YAML file. Its first problem, with file, line, key and value, is kept, so that a map is read in one go
/// and checked once; what is read after it means nothing.
class YamlMap {
 public:
  YamlMap(const std::string& path, const YAML::Node& node, std::string* problem)
      : path_(path), node_(node), problem_(problem) {}

  bool has(const char* key) const { return node_[key].IsDefined(); }
  /// A value that is there.
  YAML::Node operator[](const char* key) const { return node_[key]; }

  /// @return false if a key is given twice, is none of these, or a required one is missing
  bool has_keys(const std::vector<std::string>& required, const std::vector<std::string>& optional = {}) const {
    const Status unique = check_unique_keys(path_, node_);
    if (problem_->empty()) *problem_ = unique.message();
    std::vector<std::string> known = required;
    known.insert(known.end(), optional.begin(), optional.end());
    for (const auto& entry : node_) {
      const std::string key = key_text(entry.first);
      if (!problem_->empty() || std::find(known.begin(), known.end(), key) != known.end()) continue;
      *problem_ = yaml_place(path_, entry.first) + ": unknown key '" + key +
                  "' (known: " + boost::algorithm::join(known, ", ") + ")";
    }
    for (const std::string& key : required) {
      if (problem_->empty() && !has(key.c_str()))
        *problem_ = yaml_place(path_, node_) + ": key '" + key + "' is missing";
    }
    return problem_->empty();
  }

  /// The scalar of a key that is there.   @param rule what it must be
  template <class T>
  T value(const char* key, const char* rule) const {
    T value{};
    if (!decode(node_[key], &value)) reject(key, rule);
    return value;
  }
  /// Notes that the value of a key that is there is not what it must be.
  void reject(const char* key, const std::string& rule) const {
    if (!problem_->empty()) return;
    const YAML::Node node = node_[key];
    const std::string value = node.IsScalar() ? " = '" + node.Scalar() + "'" : "";
    *problem_ = yaml_place(path_, node) + ": '" + key + "'" + value + " must be " + rule;
  }

 private:
  std::string path_;
  YAML::Node node_;
  std::string* problem_;
};

// --- cameras and classes ---------------------------------------------------------------------------------------------

void read_distortion(const YamlMap& map, Camera* camera) {
  const YAML::Node list = map["distortion"];
  bool ok = list.IsSequence() && list.size() == camera->distortion.size();
  for (std::size_t i = 0; ok && i < camera->distortion.size(); ++i) {
    ok = decode(list[i], &camera->distortion[i]);
  }
  if (!ok) map.reject("distortion", "five numbers [k1, k2, p1, p2, k3]");
}

ClassRole read_role(const YamlMap& map) {
  static const std::map<std::string, ClassRole> kRoles = {{"static", ClassRole::kStatic},
                                                          {"movable", ClassRole::kMovable},
                                                          {"dynamic", ClassRole::kDynamic},
                                                          {"ignore", ClassRole::kIgnore}};
  const auto role = kRoles.find(map.value<std::string>("role", "a text"));
  if (role != kRoles.end()) return role->second;
  map.reject("role", "static, movable, dynamic or ignore");
  return ClassRole::kIgnore;
}

ObjectClass read_class(const YamlMap& map) {
  ObjectClass read;
  if (!map.has_keys({"id", "name", "role"}, {"coco_id", "group", "size_prior_m", "size_range_m"})) return read;
  read.id = map.value<int>("id", "an integer");
  read.name = map.value<std::string>("name", "a text");
  // Names are fields of the CSV files.
  const bool is_field = !read.name.empty() && read.name.find_first_of(",\"\n") == std::string::npos;
  if (!is_field) map.reject("name", "a text without commas and quotes");
  read.role = read_role(map);
  if (map.has("coco_id")) read.coco_id = map.value<int>("coco_id", "an integer");
  if (map.has("group")) read.group = map.value<std::string>("group", "a text");
  if (map.has("size_prior_m")) {
    read.size_prior_m = map.value<double>("size_prior_m", "a number > 0");
    if (!(read.size_prior_m > 0.0)) map.reject("size_prior_m", "a number > 0");
  }
  if (map.has("size_range_m")) {
    const YAML::Node range = map["size_range_m"];
    const bool ok = range.IsSequence() && range.size() == 2 && decode(range[0], &read.size_min_m) &&
                    decode(range[1], &read.size_max_m) && read.size_min_m >= 0.0 && read.size_min_m < read.size_max_m;
    if (!ok) map.reject("size_range_m", "two numbers [least, largest], 0 <= least < largest");
  }
  return read;
}

// --- options ------------------------------------------------------------------------------------------------------

/// Whether an option on its own can be taken.
Status check_option(const std::string& key, const std::string& value) {
  Options options;
  OptionVisitor visitor;
  options.visit(visitor);
  return visitor.set({{key, value}});
}

Status read_module(const std::string& path, const std::string& module, const YAML::Node& fields, OptionTexts* texts) {
  if (!fields.IsMap()) return Error{yaml_place(path, fields) + ": '" + module + "' must be a map of options"};
  if (const Status unique = check_unique_keys(path, fields); !unique) return unique;
  for (const auto& entry : fields) {
    const std::string key = module + "." + entry.first.Scalar(), place = yaml_place(path, entry.first) + ": ";
    if (!entry.second.IsScalar()) return Error{place + "'" + key + "' must be a single value"};
    const Status checked = check_option(key, entry.second.Scalar());
    if (!checked) return Error{place + checked.message()};
    (*texts)[key] = entry.second.Scalar();
  }
  return {};
}

}  // namespace

Result<Camera> read_camera(const std::string& path) {
  const Result<YAML::Node> root = read_yaml_map(path);
  if (!root) return root.error();
  std::string problem;
  const YamlMap map(path, *root, &problem);
  if (!map.has_keys({"fx", "fy", "cx", "cy", "width", "height", "distortion"})) return Error{problem};
  Camera camera;
  camera.fx = map.value<double>("fx", "a number");
  camera.fy = map.value<double>("fy", "a number");
  camera.cx = map.value<double>("cx", "a number");
  camera.cy = map.value<double>("cy", "a number");
  camera.width = map.value<int>("width", "an integer");
  camera.height = map.value<int>("height", "an integer");
  read_distortion(map, &camera);
  if (!problem.empty()) return Error{problem};
  if (const Status valid = camera.check(); !valid) return Error{path + ": " + valid.message()};
  return camera;
}

std::string format_camera(const Camera& camera) {
  constexpr int kDigits = 15;
  std::string text;
  for (const auto& [key, value] : {std::pair("fx", camera.fx), std::pair("fy", camera.fy), std::pair("cx", camera.cx),
                                   std::pair("cy", camera.cy)}) {
    text += std::string(key) + ": " + format_general(value, kDigits) + "\n";
  }
  text += "width: " + std::to_string(camera.width) + "\nheight: " + std::to_string(camera.height) + "\ndistortion: [";
  for (std::size_t i = 0; i < camera.distortion.size(); ++i) {
    text += (i == 0 ? "" : ", ") + format_general(camera.distortion[i], kDigits);
  }
  return text + "]  # k1, k2, p1, p2, k3\n";
}

Result<ClassTable> read_class_table(const std::string& path) {
  const Result<YAML::Node> root = read_yaml_map(path);
  if (!root) return root.error();
  std::string problem;
  const YamlMap map(path, *root, &problem);
  if (!map.has_keys({"classes"})) return Error{problem};
  const YAML::Node list = map["classes"];
  if (!list.IsSequence() || list.size() == 0) map.reject("classes", "a list of classes");
  std::vector<ObjectClass> classes;
  for (std::size_t i = 0; problem.empty() && i < list.size(); ++i) {
    if (!list[i].IsMap())
      return Error{yaml_place(path, list[i]) +
                   ": a class must be a map {id, name, role, coco_id, group, size_prior_m, size_range_m}"};
    classes.push_back(read_class(YamlMap(path, list[i], &problem)));
  }
  if (!problem.empty()) return Error{problem};
  Result<ClassTable> table = ClassTable::create(std::move(classes));
  if (!table) return Error{path + ": " + table.message()};
  return table;
}

Result<OptionTexts> read_option_texts(const std::string& path) {
  const Result<YAML::Node> root = read_yaml_map(path);
  if (!root) return root.error();
  if (const Status unique = check_unique_keys(path, *root); !unique) return unique.error();
  OptionTexts texts;
  for (const auto& entry : *root) {
    const Status read = read_module(path, entry.first.Scalar(), entry.second, &texts);
    if (!read) return read.error();
  }
  return texts;
}

Result<Options> load_options(const std::string& path, const OptionTexts& assignments) {
  const Result<OptionTexts> from_file = path.empty() ? OptionTexts() : read_option_texts(path);
  if (!from_file) return from_file.error();
  OptionTexts texts = assignments;
  texts.insert(from_file->begin(), from_file->end());
  Result<Options> options = make_options<Options>(texts);
  const bool is_fault_of_file = !options && !make_options<Options>(*from_file);
  return is_fault_of_file ? Error{path + ": " + options.message()} : options;
}

std::string format_options_yaml(const std::vector<OptionRow>& rows) {
  std::ostringstream text;
  std::string module;
  for (const OptionRow& row : rows) {
    const std::size_t dot = row.key.find('.');
    if (row.key.substr(0, dot) != module) {
      module = row.key.substr(0, dot);
      text << module << ":\n";
    }
    const char* quote = row.is_text ? "\"" : "";
    text << "  " << row.key.substr(dot + 1) << ": " << quote << row.value << quote << "\n";
  }
  return text.str();
}

std::string format_options_table(const std::vector<OptionRow>& rows, const std::string& owners) {
  const bool has_owners = !owners.empty();
  std::ostringstream text;
  text << (has_owners ? "| " + owners + " " : "") << "| parameter | default | unit | range | meaning |\n"
       << (has_owners ? "| --- " : "") << "| --- | --- | --- | --- | --- |\n";
  for (const OptionRow& row : rows) {
    text << (has_owners ? "| " + row.owner + " " : "") << "| `" << row.key << (row.is_live ? "` (live) | " : "` | ")
         << row.value << " | " << row.unit << " | " << row.rule << " | " << row.meaning << " |\n";
  }
  return text.str();
}

}  // namespace semantic_topo_loop::core
