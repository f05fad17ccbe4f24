#include "semantic_topo_loop/types/stamp.h"

#include <cstdio>
#include <limits>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {

std::optional<std::int64_t> parse_stamp(std::string_view text) {
  const std::size_t e = std::min(text.find_first_of("eE"), text.size());
  const std::optional<std::int64_t> exponent = e < text.size() ? parse_integer(text.substr(e + 1)) : 0;
  std::string digits(text.substr(0, e));
  const std::size_t point = std::min(digits.find('.'), digits.size());
  if (point < digits.size()) digits.erase(point, 1);
  constexpr std::int64_t kMaxExponent = 9999;  // more than doubles have, and no overflow below
  const bool is_decimal = !digits.empty() && digits.find_first_not_of("0123456789") == std::string::npos;
  if (!is_decimal || !exponent || *exponent > kMaxExponent || *exponent < -kMaxExponent) return std::nullopt;
  constexpr std::int64_t kNanosecondDigits = 9;
  constexpr std::int64_t kMax = std::numeric_limits<std::int64_t>::max();
  // Digits up to the nanosecond.
  const std::int64_t count = static_cast<std::int64_t>(point) + *exponent + kNanosecondDigits;
  const auto digit = [&digits](std::int64_t i) -> int {
    return i >= 0 && i < static_cast<std::int64_t>(digits.size()) ? digits[static_cast<std::size_t>(i)] - '0' : 0;
  };
  std::int64_t ns = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    if (ns > (kMax - digit(i)) / 10) return std::nullopt;
    ns = 10 * ns + digit(i);
  }
  if (digit(count) >= 5) {
    if (ns == kMax) return std::nullopt;
    ++ns;
  }
  return ns;
}

std::string format_stamp(std::int64_t stamp_ns) {
  constexpr std::int64_t kSecond = 1000000000;
  const auto seconds = static_cast<long long>(stamp_ns / kSecond);
  const auto rest = static_cast<long long>(stamp_ns % kSecond);
  char text[40];
  if (rest % 1000 == 0) {
    std::snprintf(text, sizeof(text), "%lld.%06lld", seconds, rest / 1000);
  } else {
    std::snprintf(text, sizeof(text), "%lld.%09lld", seconds, rest);
  }
  return text;
}

}  // namespace semantic_topo_loop::core
