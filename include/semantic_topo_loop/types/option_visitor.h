#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace semantic_topo_loop::core {

/// Assigns texts to the fields that an options struct shows through its `visit(visitor, prefix)`; the one way by which
/// YAML files, ROS parameters and `--set` reach a field. Fields are named `<module>.<field>`.
class OptionSetter {
 public:
  explicit OptionSetter(std::map<std::string, std::string> values) : values_(std::move(values)) {}

  void operator()(const std::string& key, double& field, const char* doc);
  void operator()(const std::string& key, int& field, const char* doc);
  void operator()(const std::string& key, bool& field, const char* doc);
  void operator()(const std::string& key, std::string& field, const char* doc);

  /// Empty if every value met a field of its type; else one message that names key and value.
  std::string error() const;

 private:
  const std::string* take(const std::string& key);
  void reject(const std::string& key, const std::string& value, const char* expected);

  std::map<std::string, std::string> values_;
  std::string error_;
};

/// Lists fields as `key, value, doc`, for the parameter table of the documentation and for tests.
class OptionLister {
 public:
  struct Row {
    std::string key, value, doc;
  };
  void operator()(const std::string& key, double& field, const char* doc);
  void operator()(const std::string& key, int& field, const char* doc);
  void operator()(const std::string& key, bool& field, const char* doc);
  void operator()(const std::string& key, std::string& field, const char* doc);

  std::vector<Row> rows;
};

}  // namespace semantic_topo_loop::core
