#pragma once

#include <sstream>
#include <string>

namespace semantic_topo_loop {

/// A broken rule of a nodelet's own parameter, as "parameter 'key' = 'value' must be rule". @return false
template <class Value>
bool fail(const char* key, const Value& value, const std::string& rule, std::string* error) {
  std::ostringstream text;
  text << "parameter '" << key << "' = '" << value << "' must be " << rule;
  if (error != nullptr) *error = text.str();
  return false;
}

}  // namespace semantic_topo_loop
