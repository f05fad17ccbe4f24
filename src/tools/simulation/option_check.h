#pragma once

#include <cmath>
#include <sstream>
#include <string>

namespace semantic_topo_loop::core {

/// Collects the first broken rule of an options struct as "parameter 'key' = 'value' must be rule".
class OptionCheck {
 public:
  explicit OptionCheck(std::string* error) : error_(error) {}

  template <class Value>
  void require(bool ok, const char* key, const Value& value, const char* rule) {
    if (ok || !ok_) {
      ok_ = ok_ && ok;
      return;
    }
    ok_ = false;
    if (error_ == nullptr) return;
    std::ostringstream message;
    message << "parameter '" << key << "' = '" << value << "' must be " << rule;
    *error_ = message.str();
  }
  void positive(const char* key, double value) { require(std::isfinite(value) && value > 0.0, key, value, "> 0"); }
  void not_negative(const char* key, double value) {
    require(std::isfinite(value) && value >= 0.0, key, value, ">= 0");
  }
  void share(const char* key, double value) { require(value >= 0.0 && value <= 1.0, key, value, "in [0, 1]"); }
  bool ok() const { return ok_; }

 private:
  std::string* error_;
  bool ok_ = true;
};

}  // namespace semantic_topo_loop::core
