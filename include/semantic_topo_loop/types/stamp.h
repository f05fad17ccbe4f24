#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace semantic_topo_loop::core {

/// Seconds in decimal text ("1311868164.363181", also with an exponent) to nanoseconds, never through a double.
/// Digits below a nanosecond are rounded.
/// @return nullopt if the text is no non-negative decimal number or exceeds int64 nanoseconds
std::optional<std::int64_t> parse_stamp(std::string_view text);

/// Nanoseconds to seconds in decimal text: 6 decimals, or 9 where they are needed, so that parse_stamp gives the same
/// stamp back.
std::string format_stamp(std::int64_t stamp_ns);

}  // namespace semantic_topo_loop::core
