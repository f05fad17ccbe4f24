#pragma once

#include <optional>
#include <string>
#include <type_traits>
#include <utility>

namespace semantic_topo_loop::core {

/// Why something could not be done: one sentence that names file, field and value.
struct Error {
  std::string message;
};

struct Nothing {};

/// What a call that can fail gives back: a value, or the error. The one way in which the core reports what is wrong
/// with its input; programs and nodelets turn it into one line.
template <class Value>
class [[nodiscard]] Result {
 public:
  Result(Value value) : value_(std::move(value)) {}
  Result(Error error) : error_(std::move(error)) {}
  /// Success of a call without a value.
  template <class Only = Value, class = std::enable_if_t<std::is_same_v<Only, Nothing>>>
  Result() : value_(Nothing()) {}

  explicit operator bool() const { return value_.has_value(); }
  const Value& operator*() const& { return *value_; }
  Value& operator*() & { return *value_; }
  Value&& operator*() && { return *std::move(value_); }
  const Value* operator->() const { return &*value_; }
  Value* operator->() { return &*value_; }
  /// Empty if there is a value.
  const std::string& message() const { return error_.message; }
  /// To hand on as another Result's.
  const Error& error() const { return error_; }

 private:
  std::optional<Value> value_;
  Error error_;
};

/// Success, or the error, of a call without a value.
using Status = Result<Nothing>;

}  // namespace semantic_topo_loop::core
