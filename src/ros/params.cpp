#include "ros/params.h"

#include <ros/param.h>

#include <array>
#include <cstdio>
#include <cstdlib>

namespace semantic_topo_loop {
namespace {

/// Read from a nodelet's private namespace by diagnostic_updater and by `nodelet standalone`.
constexpr std::array<const char*, 2> kForeignKeys = {"diagnostic_period", "num_worker_threads"};

/// The shortest text that gives the same number back.
std::string format(double value) {
  std::array<char, 32> text{};
  for (int digits = 15; digits <= 17; ++digits) {
    std::snprintf(text.data(), text.size(), "%.*g", digits, value);
    if (std::strtod(text.data(), nullptr) == value) break;
  }
  return text.data();
}

/// XmlRpcValue's conversions and iterators are not const: they work on this copy.
bool flatten(XmlRpc::XmlRpcValue value, const std::string& key, ParameterTexts* texts, std::string* error) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeStruct:
      for (auto& [name, child] : value) {
        if (!flatten(child, key.empty() ? name : key + "." + name, texts, error)) return false;
      }
      return true;
    case XmlRpc::XmlRpcValue::TypeBoolean:
      (*texts)[key] = static_cast<bool&>(value) ? "true" : "false";
      return true;
    case XmlRpc::XmlRpcValue::TypeInt:
      (*texts)[key] = std::to_string(static_cast<int&>(value));
      return true;
    case XmlRpc::XmlRpcValue::TypeDouble:
      (*texts)[key] = format(static_cast<double&>(value));
      return true;
    case XmlRpc::XmlRpcValue::TypeString:
      (*texts)[key] = static_cast<std::string&>(value);
      return true;
    default:
      if (error != nullptr) *error = "parameter '" + key + "' is neither a text, a number, true, false nor a group";
      return false;
  }
}

}  // namespace

std::optional<ParameterTexts> flatten_parameters(const XmlRpc::XmlRpcValue& tree, std::string* error) {
  ParameterTexts texts;
  if (!tree.valid()) return texts;
  if (!flatten(tree, "", &texts, error)) return std::nullopt;
  return texts;
}

std::optional<ParameterTexts> read_parameters(const ros::NodeHandle& private_handle, std::string* error) {
  XmlRpc::XmlRpcValue tree;
  if (!ros::param::get(private_handle.getNamespace(), tree)) return ParameterTexts();
  std::optional<ParameterTexts> texts = flatten_parameters(tree, error);
  if (texts) {
    for (const char* key : kForeignKeys) texts->erase(key);
  }
  return texts;
}

}  // namespace semantic_topo_loop
