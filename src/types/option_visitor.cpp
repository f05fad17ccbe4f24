#include "semantic_topo_loop/types/option_visitor.h"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

std::string to_text(double value) {
  constexpr int kDigits = 6;
  return format_general(value, kDigits);
}
std::string to_text(int value) { return std::to_string(value); }
std::string to_text(bool value) { return value ? "true" : "false"; }
std::string to_text(const std::string& value) { return value; }

/// Sets a field if the text is of its type. @return what the text is not; empty if it is set
std::string set_field(const std::string& text, double* field) {
  const std::optional<double> value = parse_double(text);
  if (!value || !std::isfinite(*value)) return "a finite number";
  *field = *value;
  return "";
}

std::string set_field(const std::string& text, int* field) {
  const std::optional<std::int64_t> value = parse_integer(text);
  if (!value || *value != static_cast<int>(*value)) return "an integer";
  *field = static_cast<int>(*value);
  return "";
}

std::string set_field(const std::string& text, bool* field) {
  const bool is_true = text == "true" || text == "1";
  if (!is_true && text != "false" && text != "0") return "true or false";
  *field = is_true;
  return "";
}

std::string set_field(const std::string& text, std::string* field) {
  *field = text;
  return "";
}

/// The unit in which a number of that name is; empty if it has none.
std::string unit_of(const std::string& key) {
  static constexpr std::pair<const char*, const char*> kUnits[] = {
      {"_m_s", "m/s"}, {"_per_s", "1/s"}, {"_deg_s", "deg/s"}, {"_s", "s"},         {"_m", "m"},      {"_px", "px"},
      {"_deg", "deg"}, {"_rad", "rad"},   {"_hz", "Hz"},       {"_share", "share"}, {"_percent", "%"}};
  for (const auto& [ending, unit] : kUnits) {
    const std::string text = ending;
    if (key.size() > text.size() && key.compare(key.size() - text.size(), text.size(), text) == 0) return unit;
  }
  return "";
}

std::string broken(const std::string& key, const std::string& value, const std::string& rule) {
  return "parameter '" + key + "' = '" + value + "' must be " + rule;
}

}  // namespace

Range Range::at_most(double high) const {
  Range range = *this;
  range.high_ = high;
  range.has_high_ = true;
  return range;
}

Range Range::below(double high) const {
  Range range = *this;
  range.high_ = high;
  return range;
}

bool Range::holds(double value) const {
  const bool is_low = has_low_ ? value < low_ : value <= low_, is_high = has_high_ ? value > high_ : value >= high_;
  return std::isfinite(value) && !is_low && !is_high;
}

bool Range::holds(const std::string& text) const {
  if (is_good_ != nullptr) return is_good_(text);
  return choices_.empty() || std::find(choices_.begin(), choices_.end(), text) != choices_.end();
}

std::string Range::rule() const {
  if (!text_rule_.empty()) return text_rule_;
  std::string text;
  for (std::size_t i = 0; i < choices_.size(); ++i) {
    if (i > 0) text += i + 1 < choices_.size() ? ", " : " or ";
    text += choices_[i];
  }
  if (!std::isfinite(low_) && !std::isfinite(high_)) return text;
  if (!std::isfinite(high_)) return (has_low_ ? ">= " : "> ") + to_text(low_);
  if (!std::isfinite(low_)) return (has_high_ ? "<= " : "< ") + to_text(high_);
  return std::string("in ") + (has_low_ ? "[" : "(") + to_text(low_) + ", " + to_text(high_) + (has_high_ ? "]" : ")");
}

void OptionVisitor::require(const std::string& name, bool is_kept, const std::string& rule) {
  const std::string key = prefix_ + name;
  const auto option = std::find_if(options_.begin(), options_.end(), [&key](const Option& o) { return o.key == key; });
  if (option == options_.end()) return;
  option->relation = rule;
  if (is_kept || !rules_) return;
  rules_ = Error{broken(key, std::visit([](const auto* field) { return to_text(*field); }, option->field), rule)};
}

Status OptionVisitor::set(const OptionTexts& texts) const {
  OptionTexts unknown = texts;
  for (const Option& option : options_) {
    const auto text = texts.find(option.key);
    if (text == texts.end()) continue;
    const std::string other = std::visit([&text](auto* field) { return set_field(text->second, field); }, option.field);
    if (!other.empty()) return Error{"parameter '" + option.key + "' = '" + text->second + "' is not " + other};
    unknown.erase(option.key);
  }
  if (unknown.empty()) return {};
  return Error{"unknown parameter '" + unknown.begin()->first + "' = '" + unknown.begin()->second + "'"};
}

Status OptionVisitor::change(const OptionTexts& texts) const {
  for (const Option& option : options_) {
    const auto text = texts.find(option.key);
    if (text == texts.end() || option.is_live) continue;
    return Error{"parameter '" + option.key + "' = '" + text->second + "' cannot change while running"};
  }
  return set(texts);
}

Status OptionVisitor::check() const {
  for (const Option& option : options_) {
    const auto holds = [&option](const auto* field) {
      if constexpr (std::is_same_v<decltype(field), const std::string*>) {
        return option.range.holds(*field);
      } else {
        return option.range.holds(static_cast<double>(*field));
      }
    };
    if (std::visit(holds, option.field)) continue;
    const std::string value = std::visit([](const auto* field) { return to_text(*field); }, option.field);
    return Error{broken(option.key, value, option.range.rule())};
  }
  return rules_;
}

std::vector<OptionRow> OptionVisitor::rows() const {
  std::vector<OptionRow> rows;
  rows.reserve(options_.size());
  for (const Option& option : options_) {
    const bool is_text = std::holds_alternative<std::string*>(option.field);
    const bool is_number = !is_text && !std::holds_alternative<bool*>(option.field);
    const std::string rule = option.range.rule(), between = rule.empty() || option.relation.empty() ? "" : "; ";
    const std::string value = std::visit([](const auto* field) { return to_text(*field); }, option.field);
    const std::string unit = is_number ? unit_of(option.key) : "";
    const OptionValue exact = std::visit([](const auto* field) { return OptionValue(*field); }, option.field);
    rows.push_back({option.key,
                    value,
                    unit,
                    rule + between + option.relation,
                    option.meaning,
                    is_text,
                    {},
                    option.is_live,
                    exact,
                    option.range});
  }
  return rows;
}

}  // namespace semantic_topo_loop::core
