#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

using Json = nlohmann::json;

/// As text; what is no UTF-8, as a damaged file's CBOR may hold, as the replacement character.
inline std::string printable(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

/// A value of a JSON file and the name of its place, "submaps[0].frames[3].image". The first problem is kept, so that a
/// tree is read in one go and checked once; what is read after it means nothing.
class JsonField {
 public:
  JsonField(const Json& json, std::string name, std::string* problem)
      : json_(json), name_(std::move(name)), problem_(problem) {}

  JsonField member(const char* key) const {
    if (!json_.is_object()) {
      reject("must be an object");
    } else if (const auto it = json_.find(key); it != json_.end()) {
      return {*it, name_ + (name_.empty() ? "" : ".") + key, problem_};
    } else {
      reject(std::string("has no '") + key + "'");
    }
    return {kNothing, name_, problem_};
  }

  std::vector<JsonField> elements() const {
    std::vector<JsonField> fields;
    if (!json_.is_array()) reject("must be an array");
    if (!json_.is_array()) return fields;
    fields.reserve(json_.size());
    for (std::size_t i = 0; i < json_.size(); ++i) {
      fields.emplace_back(json_[i], name_ + '[' + std::to_string(i) + ']', problem_);
    }
    return fields;
  }

  int small_integer() const {
    constexpr int kMin = std::numeric_limits<int>::min(), kMax = std::numeric_limits<int>::max();
    // Of a large one not to the last digit.
    const double value = json_.is_number_integer() ? json_.get<double>() : std::nan("");
    if (value >= kMin && value <= kMax) return static_cast<int>(value);
    reject("must be an integer of 32 bits");
    return 0;
  }

  /// Null stands for NaN, as JSON writers have it.
  double number_or_nan() const {
    if (json_.is_number()) return json_.get<double>();
    if (!json_.is_null()) reject("must be a number");
    return std::nan("");
  }

  /// Empty if it is no text.
  std::string text() const { return json_.is_string() ? json_.get<std::string>() : std::string(); }

  /// The name, and the value if it is a single one, for messages.
  std::string place() const {
    constexpr std::size_t kMaxValue = 60;  // characters: half a line
    const std::string value = json_.is_structured() ? std::string() : " = " + printable(json_).substr(0, kMaxValue);
    return (name_.empty() ? "the file" : name_) + value;
  }
  const std::string& name() const { return name_; }
  const Json& json() const { return json_; }
  void reject(const std::string& rule) const {
    if (problem_->empty()) *problem_ = place() + ' ' + rule;
  }
  bool is_fine() const { return problem_->empty(); }

 private:
  inline static const Json kNothing;
  const Json& json_;
  std::string name_;
  std::string* problem_;
};

/// @param take nlohmann's callback, or null   @return an error that names line and column, or key and value
inline Result<Json> parse_json(const std::string& text, const Json::parser_callback_t& take = nullptr) {
  std::string key;  // of the value at hand, which the messages do not name
  const auto follow = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (event == Json::parse_event_t::key) key = parsed.get<std::string>();
    return !take || take(depth, event, parsed);
  };
  try {
    return Json::parse(text, follow);
  } catch (const Json::exception& exception) {
    const std::string what = exception.what();
    if (text.empty()) return Error{"the file is empty"};
    const bool is_value = dynamic_cast<const Json::out_of_range*>(&exception) != nullptr;
    return Error{(is_value ? "'" + key + "': " : "") + what.substr(what.find("] ") + 2)};
  }
}

}  // namespace semantic_topo_loop::core
