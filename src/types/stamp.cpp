#include "semantic_topo_loop/types/stamp.h"

#include <cstdio>
#include <limits>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// The digits of a decimal number and how many of them stand before its point.
struct Decimal {
  std::string digits;
  long whole = 0;
};

/// Reads "e+09" and the like at the end of a number; a missing exponent is 0.
std::optional<std::int64_t> parse_exponent(std::string_view text) {
  if (text.empty()) return 0;
  if (text.front() != 'e' && text.front() != 'E') return std::nullopt;
  const std::optional<std::int64_t> exponent = parse_integer(text.substr(1));
  constexpr std::int64_t kMax = 9999;  // more than doubles have, and no overflow below
  return exponent && *exponent >= -kMax && *exponent <= kMax ? exponent : std::nullopt;
}

std::optional<Decimal> parse_decimal(std::string_view text) {
  Decimal decimal;
  std::size_t i = 0;
  for (; i < text.size() && is_digit(text[i]); ++i) decimal.digits += text[i];
  decimal.whole = static_cast<long>(decimal.digits.size());
  if (i < text.size() && text[i] == '.') {
    for (++i; i < text.size() && is_digit(text[i]); ++i) decimal.digits += text[i];
  }
  const std::optional<std::int64_t> exponent = parse_exponent(text.substr(i));
  if (decimal.digits.empty() || !exponent) return std::nullopt;
  decimal.whole += *exponent;
  return decimal;
}

}  // namespace

std::optional<std::int64_t> parse_stamp(std::string_view text) {
  const std::optional<Decimal> decimal = parse_decimal(text);
  if (!decimal) return std::nullopt;
  constexpr long kNanosecondDigits = 9;
  constexpr std::int64_t kMax = std::numeric_limits<std::int64_t>::max();
  const long count = decimal->whole + kNanosecondDigits;  // digits up to the nanosecond
  const auto digit = [&decimal](long i) -> int {
    return i >= 0 && i < static_cast<long>(decimal->digits.size()) ? decimal->digits[static_cast<std::size_t>(i)] - '0'
                                                                   : 0;
  };
  std::int64_t ns = 0;
  for (long i = 0; i < count; ++i) {
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
