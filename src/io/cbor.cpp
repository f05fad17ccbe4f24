#include "io/cbor.h"

#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "io/json_field.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kPositive = 0, kNegative = 1, kText = 3, kArray = 4, kMap = 5, kOther = 7;
// Of kOther:
constexpr int kFalse = 20, kTrue = 21, kNull = 22, kHalf = 25, kFloat = 26, kDouble = 27;
constexpr std::uint64_t kMaxInteger = std::numeric_limits<std::int64_t>::max();

/// @return whether it is all there, and of no kind that is never written
bool take_head(const std::uint8_t** at, const std::uint8_t* end, CborHead* head) {
  if (*at == end) return false;
  const int first = *(*at)++;
  head->kind = first >> 5;
  head->info = first & 31;
  head->argument = static_cast<std::uint64_t>(head->info);
  if (head->info >= 24) {
    if (head->info > 27) return false;
    const int size = 1 << (head->info - 24);
    if (end - *at < size) return false;
    head->argument = 0;
    for (int i = 0; i < size; ++i) head->argument = head->argument << 8 | *(*at)++;
  }
  // Half precision is what earlier programs wrote for what is no finite number.
  if (head->kind == kOther) return (head->info >= kFalse && head->info <= kNull) || head->info >= kHalf;
  return head->kind == kPositive || head->kind == kNegative || (head->kind >= kText && head->kind <= kMap);
}

/// How many values are in one that begins so, beside its head.
std::uint64_t values_in(const CborHead& head) {
  return head.kind == kArray ? head.argument : head.kind == kMap ? 2 * head.argument : 0;
}

/// Whether this is one value, whose maps have texts for keys, and nests no deeper than ours do.
bool is_sound(const std::uint8_t* begin, const std::uint8_t* end) {
  constexpr std::size_t kDeepest = 64;
  struct Open {
    std::uint64_t to_come = 1;
    bool is_map = false;
  };
  std::vector<Open> open = {Open()};  // the innermost last
  const std::uint8_t* at = begin;
  while (!open.empty()) {
    if (open.back().to_come == 0) {
      open.pop_back();
      continue;
    }
    const bool is_key = open.back().is_map && open.back().to_come % 2 == 0;
    --open.back().to_come;
    CborHead head;
    if (!take_head(&at, end, &head) || (is_key && head.kind != kText)) return false;
    if (head.kind < kText || head.kind > kMap) continue;
    if (head.argument > static_cast<std::uint64_t>(end - at)) return false;  // each takes a byte at least
    if (head.kind == kText) {
      at += head.argument;
    } else {
      open.push_back({values_in(head), head.kind == kMap});
      if (open.size() > kDeepest) return false;
    }
  }
  return at == end;
}

template <class To, class From>
To with_bits_of(From from) {
  static_assert(sizeof(To) == sizeof(From));
  To to{};
  std::memcpy(&to, &from, sizeof(to));
  return to;
}

Json parsed(const std::uint8_t* begin, const std::uint8_t* end) {
  // The parser calls itself for each level: a few kilobytes could fill its stack.
  if (!is_sound(begin, end)) return Json(Json::value_t::discarded);
  return Json::from_cbor(begin, end, true, false);
}

}  // namespace

// --- writing ------------------------------------------------------------------------------------------------------

void CborWriter::head(int kind, int info, std::uint64_t argument) {
  std::array<char, 9> bytes{};
  std::size_t size = 0;
  bytes[size++] = static_cast<char>(kind << 5 | info);
  for (int bits = info < 24 ? 0 : 8 << (info - 24); bits > 0; bits -= 8) {
    bytes[size++] = static_cast<char>(argument >> (bits - 8));
  }
  bytes_.append(bytes.data(), size);
}

void CborWriter::counted(int kind, std::uint64_t argument) {
  const int info = argument < 24                                           ? static_cast<int>(argument)
                   : argument <= std::numeric_limits<std::uint8_t>::max()  ? 24
                   : argument <= std::numeric_limits<std::uint16_t>::max() ? 25
                   : argument <= std::numeric_limits<std::uint32_t>::max() ? 26
                                                                           : 27;
  head(kind, info, argument);
}

void CborWriter::null() { head(kOther, kNull, 0); }
void CborWriter::flag(bool value) { head(kOther, value ? kTrue : kFalse, 0); }

void CborWriter::integer(std::int64_t value) {
  counted(value < 0 ? kNegative : kPositive, static_cast<std::uint64_t>(value < 0 ? -(value + 1) : value));
}

void CborWriter::number(double value) {
  const auto single = static_cast<float>(value);
  if (static_cast<double>(single) == value) {
    head(kOther, kFloat, with_bits_of<std::uint32_t>(single));
  } else {
    head(kOther, kDouble, with_bits_of<std::uint64_t>(value));
  }
}

void CborWriter::text(std::string_view value) {
  counted(kText, value.size());
  bytes_ += value;
}

void CborWriter::array(std::size_t size) { counted(kArray, size); }
void CborWriter::map(std::size_t size) { counted(kMap, size); }

// --- reading ------------------------------------------------------------------------------------------------------

CborReader::CborReader(std::string name, const std::uint8_t* begin, const std::uint8_t* end)
    : name_(std::move(name)), at_(begin), end_(end) {
  if (!is_sound(begin, end)) problem_ = name_ + " is damaged";
}

CborHead CborReader::take() {
  CborHead head;
  if (is_fine()) take_head(&at_, end_, &head);
  return head;
}

bool CborReader::null() {
  const bool is_null = is_fine() && *at_ == (kOther << 5 | kNull);
  if (is_null) ++at_;
  return is_null;
}

bool CborReader::flag() {
  const std::uint8_t* const begin = at_;
  const CborHead head = take();
  if (head.kind == kOther && (head.info == kFalse || head.info == kTrue)) return head.info == kTrue;
  reject(begin, "must be true or false");
  return false;
}

std::int64_t CborReader::integer() {
  const std::uint8_t* const begin = at_;
  const CborHead head = take();
  if (head.kind <= kNegative && head.argument <= kMaxInteger) {
    const auto value = static_cast<std::int64_t>(head.argument);
    return head.kind == kNegative ? -1 - value : value;
  }
  reject(begin, "must be an integer");
  return 0;
}

double CborReader::number() {
  const std::uint8_t* const begin = at_;
  const CborHead head = take();
  double value = std::nan("");
  if (head.kind == kPositive) {
    value = static_cast<double>(head.argument);
  } else if (head.kind == kNegative) {
    value = -1.0 - static_cast<double>(head.argument);
  } else if (head.kind == kOther && head.info == kFloat) {
    value = static_cast<double>(with_bits_of<float>(static_cast<std::uint32_t>(head.argument)));
  } else if (head.kind == kOther && head.info == kDouble) {
    value = with_bits_of<double>(head.argument);
  }
  if (!std::isfinite(value)) reject(begin, "must be a finite number");
  return value;
}

std::string CborReader::text() {
  const std::uint8_t* const begin = at_;
  const CborHead head = take();
  if (head.kind != kText) {
    reject(begin, "must be a text");
    return {};
  }
  const auto* const characters = reinterpret_cast<const char*>(at_);
  at_ += head.argument;
  return {characters, static_cast<std::size_t>(head.argument)};
}

std::size_t CborReader::size_of(int kind, const char* rule) {
  const std::uint8_t* const begin = at_;
  const CborHead head = take();
  if (head.kind == kind) return static_cast<std::size_t>(head.argument);
  reject(begin, rule);
  return 0;
}

std::size_t CborReader::array() { return size_of(kArray, "must be an array"); }
std::size_t CborReader::map() { return size_of(kMap, "must be an object"); }

void CborReader::skip() {
  for (std::uint64_t left = 1; left > 0 && is_fine(); --left) {
    const CborHead head = take();
    if (head.kind == kText) at_ += head.argument;
    left += values_in(head);
  }
}

bool CborReader::Members::find(const char* name) {
  const std::size_t length = std::strlen(name);
  const auto is_here = [&] {
    const CborHead head = reader_.take();
    const bool is_name = head.argument == length && std::memcmp(reader_.at_, name, length) == 0;
    reader_.at_ += head.argument;
    return is_name;
  };
  reader_.at_ = next_;
  is_next_ = left_ > 0 && is_here();
  if (is_next_) return true;
  reader_.at_ = begin_;
  for (std::size_t i = 0; i < size_ && reader_.is_fine(); ++i) {
    if (is_here()) return true;
    reader_.skip();
  }
  return false;
}

void CborReader::reject(const std::uint8_t* at, const std::string& rule) {
  if (!is_fine()) return;
  std::string place = name_;
  for (const Step& step : steps_) {
    place += step.member != nullptr ? '.' + std::string(step.member) : '[' + std::to_string(step.number) + ']';
  }
  at_ = at;
  const bool is_single = values_in(take()) == 0;
  at_ = at;
  skip();
  JsonField(is_single ? parsed(at, at_) : Json::array(), place, &problem_).reject(rule);
}

Json from_cbor(const std::string& bytes) {
  const auto* const begin = reinterpret_cast<const std::uint8_t*>(bytes.data());
  return parsed(begin, begin + bytes.size());
}

}  // namespace semantic_topo_loop::core
