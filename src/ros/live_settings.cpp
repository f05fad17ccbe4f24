#include "ros/live_settings.h"

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "ros/parameters.h"

namespace semantic_topo_loop {
namespace {

using dynamic_reconfigure::Config;

constexpr char kGroup[] = "Default";  // the one that the tools ask for
constexpr int kGroupId = 0;

std::string name_of(const core::OptionRow& row) { return row.key.substr(row.key.rfind('.') + 1); }

std::string type_of(const core::OptionRow& row) {
  static constexpr std::array<const char*, std::variant_size_v<core::OptionValue>> kTypes{"double", "int", "bool",
                                                                                          "str"};
  return kTypes[row.exact.index()];
}

/// Adds a value to those of its type.
struct Adder {
  const std::string name;
  Config* config;

  void operator()(double value) const { add(value, &config->doubles); }
  void operator()(int value) const { add(value, &config->ints); }
  void operator()(bool value) const { add(value, &config->bools); }
  void operator()(const std::string& value) const { add(value, &config->strs); }

 private:
  template <class Value, class Parameters>
  void add(const Value& value, Parameters* parameters) const {
    auto& parameter = parameters->emplace_back();
    parameter.name = name;
    parameter.value = value;
  }
};

/// The largest value of a row's type that its range may have, or the smallest.
core::OptionValue bound(const core::OptionRow& row, bool is_largest) {
  const double number = is_largest ? row.range.high() : row.range.low();
  using Int = std::numeric_limits<int>;
  if (std::holds_alternative<int>(row.exact)) {
    return static_cast<int>(std::clamp<double>(number, Int::min(), Int::max()));
  }
  if (std::holds_alternative<bool>(row.exact)) return is_largest;
  if (std::holds_alternative<std::string>(row.exact)) return std::string();
  return number;
}

/// @param value_of a row, for each live one
template <class ValueOf>
Config make_config(const std::vector<core::OptionRow>& rows, ValueOf value_of) {
  Config config;
  for (const core::OptionRow& row : rows) {
    if (row.is_live) std::visit(Adder{name_of(row), &config}, value_of(row));
  }
  auto& group = config.groups.emplace_back();
  group.name = kGroup;
  group.id = group.parent = kGroupId;
  group.state = true;
  return config;
}

}  // namespace

Config to_settings(const std::vector<core::OptionRow>& rows) {
  return make_config(rows, [](const core::OptionRow& row) { return row.exact; });
}

dynamic_reconfigure::ConfigDescription describe_settings(const std::vector<core::OptionRow>& defaults) {
  dynamic_reconfigure::ConfigDescription description;
  auto& group = description.groups.emplace_back();
  group.name = kGroup;
  group.id = group.parent = kGroupId;
  for (const core::OptionRow& row : defaults) {
    if (!row.is_live) continue;
    auto& parameter = group.parameters.emplace_back();
    parameter.name = name_of(row);
    parameter.type = type_of(row);
    parameter.description = row.meaning + (row.rule.empty() ? "" : " (" + row.rule + ")");
  }
  description.dflt = to_settings(defaults);
  description.min = make_config(defaults, [](const core::OptionRow& row) { return bound(row, false); });
  description.max = make_config(defaults, [](const core::OptionRow& row) { return bound(row, true); });
  return description;
}

core::OptionTexts from_settings(const Config& settings, const std::vector<core::OptionRow>& rows) {
  const auto key_of = [&rows](const std::string& name) {
    const auto row = std::find_if(rows.begin(), rows.end(), [&name](const auto& r) { return name_of(r) == name; });
    return row == rows.end() ? name : row->key;
  };
  core::OptionTexts texts;
  for (const auto& setting : settings.doubles) texts[key_of(setting.name)] = exact_text(setting.value);
  for (const auto& setting : settings.ints) texts[key_of(setting.name)] = std::to_string(setting.value);
  for (const auto& setting : settings.bools) texts[key_of(setting.name)] = setting.value != 0 ? "true" : "false";
  for (const auto& setting : settings.strs) texts[key_of(setting.name)] = setting.value;
  return texts;
}

LiveSettings::LiveSettings(const ros::NodeHandle& node, const std::vector<core::OptionRow>& defaults, Rows rows,
                           Change change)
    : node_(node), rows_(std::move(rows)), change_(std::move(change)) {
  descriptions_ = node_.advertise<dynamic_reconfigure::ConfigDescription>("parameter_descriptions", 1, true);
  updates_ = node_.advertise<Config>("parameter_updates", 1, true);
  descriptions_.publish(describe_settings(defaults));
  updates_.publish(settings());
}

core::Status LiveSettings::change(const core::OptionTexts& texts) {
  const core::Status status = change_(texts);
  const std::vector<core::OptionRow> rows = rows_();
  for (const core::OptionRow& row : rows) {
    if (!status || texts.count(row.key) == 0) continue;
    std::string path = row.key;
    std::replace(path.begin(), path.end(), '.', '/');
    std::visit([this, &path](const auto& value) { node_.setParam(path, value); }, row.exact);
  }
  updates_.publish(to_settings(rows));  // after a refusal, too: a tool may show what it asked for
  return status;
}

}  // namespace semantic_topo_loop
