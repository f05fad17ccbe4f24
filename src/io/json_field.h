#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

using Json = nlohmann::json;

/// As text; what is no UTF-8, as a damaged file's CBOR may hold, as the replacement character.
inline std::string printable(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

/// A value of a JSON file and the name of its place, "submaps[0].frames[3].image". The first problem is kept, so that a
/// tree is read in one go and checked once; what is read after it means nothing.
class JsonField {
 public:
  /// @param is_named without, a problem does not say where it is, and a large tree is read in half the time
  JsonField(const Json& json, std::string name, std::string* problem, bool is_named = true)
      : json_(json), name_(std::move(name)), problem_(problem), is_named_(is_named) {}

  bool has(const char* key) const { return json_.is_object() && json_.contains(key); }

  JsonField member(const char* key) const {
    if (!json_.is_object()) {
      reject("must be an object");
    } else if (const auto it = json_.find(key); it != json_.end()) {
      return child(*it, [&] { return (name_.empty() ? "" : ".") + std::string(key); });
    } else {
      reject(std::string("has no '") + key + "'");
    }
    return {kNothing, name_, problem_, is_named_};
  }

  std::vector<JsonField> elements() const {
    std::vector<JsonField> fields;
    if (!json_.is_array()) reject("must be an array");
    if (!json_.is_array()) return fields;
    fields.reserve(json_.size());
    for (std::size_t i = 0; i < json_.size(); ++i) {
      fields.push_back(child(json_[i], [i] { return '[' + std::to_string(i) + ']'; }));
    }
    return fields;
  }

  std::int64_t integer() const {
    constexpr std::uint64_t kMax = std::numeric_limits<std::int64_t>::max();
    const bool is_larger = json_.is_number_unsigned() && json_.get<std::uint64_t>() > kMax;
    if (json_.is_number_integer() && !is_larger) return json_.get<std::int64_t>();
    reject("must be an integer");
    return 0;
  }

  int small_integer() const {
    const std::int64_t value = integer();
    if (value != static_cast<int>(value)) reject("must be an integer of 32 bits");
    return static_cast<int>(value);
  }

  bool flag() const {
    if (json_.is_boolean()) return json_.get<bool>();
    reject("must be true or false");
    return false;
  }

  double number() const {
    const double value = json_.is_number() ? json_.get<double>() : std::nan("");
    if (!std::isfinite(value)) reject("must be a finite number");
    return value;
  }

  /// The same, but null stands for NaN, as JSON writers have it.
  double number_or_nan() const {
    if (json_.is_number()) return json_.get<double>();
    if (!json_.is_null()) reject("must be a number");
    return std::nan("");
  }

  /// Empty if it is no text.
  std::string text() const { return json_.is_string() ? json_.get<std::string>() : std::string(); }

  template <int n>
  Eigen::Matrix<double, n, 1> numbers() const {
    Eigen::Matrix<double, n, 1> v = Eigen::Matrix<double, n, 1>::Zero();
    if (!json_.is_array()) {
      reject("must be an array");
    } else if (json_.size() < static_cast<std::size_t>(n)) {
      reject("must have " + std::to_string(n) + " numbers");
    } else {
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        v(static_cast<Eigen::Index>(i)) = child(json_[i], [i] { return '[' + std::to_string(i) + ']'; }).number();
      }
    }
    return v;
  }

  Box box() const {
    const Vec4 v = numbers<4>();
    const Box box{v(0), v(1), v(2), v(3)};
    if (!box.is_valid()) reject("is no box [x1, y1, x2, y2]");
    return box;
  }

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
  template <class Suffix>
  JsonField child(const Json& json, const Suffix& suffix) const {
    return {json, is_named_ ? name_ + suffix() : std::string(), problem_, is_named_};
  }

  inline static const Json kNothing;
  const Json& json_;
  std::string name_;
  std::string* problem_;
  bool is_named_;
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
