#include "io/archive.h"

#include <algorithm>
#include <limits>

namespace semantic_topo_loop::core {
namespace {

/// Whether arrays and maps nest deeper than ours do: the parser calls itself for each level, so that a few kilobytes of
/// a damaged file could fill its stack. What is no CBOR is the parser's to find.
bool nests_deeply(const std::uint8_t* begin, const std::uint8_t* end) {
  constexpr std::size_t kDeepest = 64;
  constexpr std::uint64_t kEndless = std::numeric_limits<std::uint64_t>::max();
  constexpr int kByteString = 2, kText = 3, kArray = 4, kMap = 5, kTag = 6;
  constexpr std::uint8_t kBreak = 0xff;
  std::vector<std::uint64_t> to_come;  // elements of those that are open, the innermost last
  for (const std::uint8_t* byte = begin; byte != end;) {
    const std::uint8_t head = *byte++;
    const int kind = head >> 5, info = head & 31;
    std::uint64_t argument = static_cast<std::uint64_t>(info);
    if (info >= 24 && info <= 27) {
      argument = 0;
      for (int i = 0; i < (1 << (info - 24)) && byte != end; ++i) argument = argument << 8 | *byte++;
    }
    const bool is_endless = info == 31 && head != kBreak;
    if (kind == kTag) continue;  // of the element that follows
    if ((kind == kByteString || kind == kText) && !is_endless) {
      byte += static_cast<std::ptrdiff_t>(std::min(argument, static_cast<std::uint64_t>(end - byte)));
    }
    const bool is_open = kind == kArray || kind == kMap || ((kind == kByteString || kind == kText) && is_endless);
    if (is_open && (is_endless || argument > 0)) {
      const bool is_pairs = kind == kMap && !is_endless && argument < kEndless / 2;
      to_come.push_back(is_endless ? kEndless : is_pairs ? 2 * argument : argument);
      if (to_come.size() > kDeepest) return true;
      continue;
    }
    if (head == kBreak && !to_come.empty()) to_come.pop_back();
    while (!to_come.empty() && to_come.back() != kEndless && --to_come.back() == 0) to_come.pop_back();
  }
  return false;
}

}  // namespace

Json from_cbor(const std::uint8_t* begin, const std::uint8_t* end) {
  if (nests_deeply(begin, end)) return Json(Json::value_t::discarded);
  try {
    return Json::from_cbor(begin, end);
  } catch (const Json::exception&) {  // some it throws whether or not it may
    return Json(Json::value_t::discarded);
  }
}

}  // namespace semantic_topo_loop::core
