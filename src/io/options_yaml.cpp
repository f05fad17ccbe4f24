#include "semantic_topo_loop/io/options_yaml.h"

#include <sstream>

#include "io/yaml.h"

namespace semantic_topo_loop::core {
namespace {

/// Why an option on its own cannot be taken, or an empty text.
std::string option_problem(const std::string& key, const std::string& value) {
  Options options;
  OptionVisitor visitor;
  options.visit(visitor);
  return visitor.set({{key, value}}).message();
}

bool parse_module(const std::string& path, const std::string& module, const YAML::Node& fields, OptionTexts* texts,
                  std::string* error) {
  if (!fields.IsMap()) {
    *error = yaml_place(path, fields) + ": '" + module + "' must be a map of options";
    return false;
  }
  if (!check_unique_keys(path, fields, error)) return false;
  for (const auto& entry : fields) {
    const std::string key = module + "." + entry.first.Scalar();
    if (!entry.second.IsScalar()) {
      *error = yaml_place(path, entry.first) + ": '" + key + "' must be a single value";
      return false;
    }
    const std::string problem = option_problem(key, entry.second.Scalar());
    if (!problem.empty()) {
      *error = yaml_place(path, entry.first) + ": " + problem;
      return false;
    }
    (*texts)[key] = entry.second.Scalar();
  }
  return true;
}

std::optional<OptionTexts> parse_options(const std::string& path, std::string* error) {
  const std::optional<YAML::Node> root = read_yaml_map(path, error);
  if (!root || !check_unique_keys(path, *root, error)) return std::nullopt;
  OptionTexts texts;
  for (const auto& entry : *root) {
    if (!parse_module(path, entry.first.Scalar(), entry.second, &texts, error)) return std::nullopt;
  }
  return texts;
}

}  // namespace

std::optional<OptionTexts> read_option_texts(const std::string& path, std::string* error) {
  std::string problem;
  std::optional<OptionTexts> texts = parse_options(path, &problem);
  if (!texts && error != nullptr) *error = problem;
  return texts;
}

std::optional<Options> load_options(const std::string& path, const OptionTexts& assignments, std::string* error) {
  OptionTexts texts = assignments;
  if (!path.empty()) {
    const std::optional<OptionTexts> from_file = read_option_texts(path, error);
    if (!from_file) return std::nullopt;
    texts.insert(from_file->begin(), from_file->end());
  }
  Result<Options> options = make_options<Options>(texts);
  if (options) return *std::move(options);
  if (error != nullptr) *error = options.message();
  return std::nullopt;
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
    text << (has_owners ? "| " + row.owner + " " : "") << "| `" << row.key << "` | " << row.value << " | " << row.unit
         << " | " << row.rule << " | " << row.meaning << " |\n";
  }
  return text.str();
}

}  // namespace semantic_topo_loop::core
