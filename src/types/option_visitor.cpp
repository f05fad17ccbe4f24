#include "semantic_topo_loop/types/option_visitor.h"

#include <cmath>
#include <cstdlib>
#include <limits>
#include <sstream>

namespace semantic_topo_loop::core {

const std::string* OptionSetter::take(const std::string& key) {
  const auto it = values_.find(key);
  return it == values_.end() ? nullptr : &it->second;
}

void OptionSetter::reject(const std::string& key, const std::string& value, const char* expected) {
  if (error_.empty()) error_ = "parameter '" + key + "' = '" + value + "' is not " + expected;
}

void OptionSetter::operator()(const std::string& key, double& field, const char*) {
  const std::string* text = take(key);
  if (text == nullptr) return;
  char* end = nullptr;
  const double value = std::strtod(text->c_str(), &end);
  if (text->empty() || *end != '\0' || !std::isfinite(value)) {
    reject(key, *text, "a finite number");
  } else {
    field = value;
  }
  values_.erase(key);
}

void OptionSetter::operator()(const std::string& key, int& field, const char*) {
  const std::string* text = take(key);
  if (text == nullptr) return;
  char* end = nullptr;
  const long value = std::strtol(text->c_str(), &end, 10);
  if (text->empty() || *end != '\0' || value < std::numeric_limits<int>::min() ||
      value > std::numeric_limits<int>::max()) {
    reject(key, *text, "an integer");
  } else {
    field = static_cast<int>(value);
  }
  values_.erase(key);
}

void OptionSetter::operator()(const std::string& key, bool& field, const char*) {
  const std::string* text = take(key);
  if (text == nullptr) return;
  if (*text == "true" || *text == "1") {
    field = true;
  } else if (*text == "false" || *text == "0") {
    field = false;
  } else {
    reject(key, *text, "true or false");
  }
  values_.erase(key);
}

void OptionSetter::operator()(const std::string& key, std::string& field, const char*) {
  const std::string* text = take(key);
  if (text == nullptr) return;
  field = *text;
  values_.erase(key);
}

std::string OptionSetter::error() const {
  if (!error_.empty()) return error_;
  if (!values_.empty()) return "unknown parameter '" + values_.begin()->first + "' = '" + values_.begin()->second + "'";
  return {};
}

void OptionLister::operator()(const std::string& key, double& field, const char* doc) {
  std::ostringstream text;
  text << field;
  rows.push_back({key, text.str(), doc});
}

void OptionLister::operator()(const std::string& key, int& field, const char* doc) {
  rows.push_back({key, std::to_string(field), doc});
}

void OptionLister::operator()(const std::string& key, bool& field, const char* doc) {
  rows.push_back({key, field ? "true" : "false", doc});
}

void OptionLister::operator()(const std::string& key, std::string& field, const char* doc) {
  rows.push_back({key, field, doc});
}

}  // namespace semantic_topo_loop::core
