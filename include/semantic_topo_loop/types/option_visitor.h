#pragma once

#include <limits>
#include <map>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Which values an option may have: numbers between two bounds, or texts. NaN and infinity never are.
class Range {
 public:
  using IsGood = bool (*)(const std::string& text);

  /// Anything.
  Range() = default;
  /// Texts, by a function and what it asks for in words.
  Range(IsGood is_good, std::string rule) : is_good_(is_good), text_rule_(std::move(rule)) {}
  explicit Range(std::vector<std::string> choices) : choices_(std::move(choices)) {}
  Range(double low, bool has_low) : low_(low), has_low_(has_low) {}

  Range at_most(double high) const;
  Range below(double high) const;

  bool holds(double value) const;
  bool holds(const std::string& text) const;
  /// What a value must be, such as "> 0", "in [0, 1]", "fixed or free"; empty for anything.
  std::string rule() const;
  /// The bounds of numbers, which themselves may be outside; infinite without.
  double low() const { return low_; }
  double high() const { return high_; }

 private:
  double low_ = -std::numeric_limits<double>::infinity(), high_ = std::numeric_limits<double>::infinity();
  bool has_low_ = false, has_high_ = false;  ///< whether the bound itself is in the range
  std::vector<std::string> choices_;
  IsGood is_good_ = nullptr;
  std::string text_rule_;
};

inline Range any() { return {}; }
inline Range above(double low) { return {low, false}; }
inline Range at_least(double low) { return {low, true}; }
inline Range between(double low, double high) { return at_least(low).at_most(high); }
inline Range positive() { return above(0.0); }
inline Range not_negative() { return at_least(0.0); }
inline Range share() { return between(0.0, 1.0); }
inline Range one_of(std::vector<std::string> choices) { return Range(std::move(choices)); }
/// A text that is not empty.
inline Range given() {
  return {[](const std::string& text) { return !text.empty(); }, "given"};
}

/// Options as text: `<module>.<field>` to value.
using OptionTexts = std::map<std::string, std::string>;

using OptionValue = std::variant<double, int, bool, std::string>;

/// What a field of an options struct is, for documents and tools.
struct OptionRow {
  std::string key, value, unit, rule, meaning;
  bool is_text = false;
  std::string owner;     ///< who has it, where the key does not say
  bool is_live = false;  ///< it may change while running
  OptionValue exact;     ///< every digit of `value`
  Range range;
};

/// What an options struct says about its fields. A struct has `void visit(OptionVisitor& visitor)`, which shows each
/// field with its name, its range and a sentence on what it means, and states the rules between fields; it is the one
/// place that does. Setting, checking and listing work on that. A key is `<module>.<field>`, and a number's unit is the
/// end of its name: `loop.min_gap_s`.
class OptionVisitor {
 public:
  /// States whose fields follow. Without it their names are their keys.
  void module(const std::string& name) { prefix_ = name + "."; }
  template <class Field>
  void operator()(const std::string& name, Field& field, Range range, const char* meaning) {
    options_.push_back({prefix_ + name, &field, std::move(range), meaning, {}, false});
  }
  void operator()(const std::string& name, bool& field, const char* meaning) { (*this)(name, field, any(), meaning); }
  /// The same for a field that may change while running: it is read anew at each frame, and nothing that is stored
  /// hangs on what it was.
  template <class Field>
  void live(const std::string& name, Field& field, Range range, const char* meaning) {
    (*this)(name, field, std::move(range), meaning);
    options_.back().is_live = true;
  }
  void live(const std::string& name, bool& field, const char* meaning) { live(name, field, any(), meaning); }
  /// States a rule between fields, about one that was shown.
  void require(const std::string& name, bool is_kept, const std::string& rule);

  /// Sets the fields that texts are given for. An error for a text of the wrong type or an unknown key.
  Status set(const OptionTexts& texts) const;
  /// As set, of live fields alone: another one is an error, too.
  Status change(const OptionTexts& texts) const;
  /// An error for the first field out of its range or, if there is none, the first broken rule between fields.
  Status check() const;
  std::vector<OptionRow> rows() const;

 private:
  struct Option {
    std::string key;
    std::variant<double*, int*, bool*, std::string*> field;
    Range range;
    const char* meaning;
    std::string relation;  ///< to other fields
    bool is_live;
  };

  std::string prefix_;  ///< of keys
  std::vector<Option> options_;
  Status rules_;
};

/// An error that names key and value for the first rule of its `visit` that a struct breaks.
template <class Struct>
Status validate(Struct options) {
  OptionVisitor visitor;
  options.visit(visitor);
  return visitor.check();
}

/// Key, value, unit, range and meaning of every field.
template <class Struct>
std::vector<OptionRow> list_options(Struct options = {}) {
  OptionVisitor visitor;
  options.visit(visitor);
  return visitor.rows();
}

/// The defaults but for what texts are given; the one way by which YAML files, ROS parameters and `--set` reach a
/// field. Strict: an unknown key, a text of the wrong type or a value out of range is an error that names both.
template <class Struct>
Result<Struct> make_options(const OptionTexts& texts) {
  Struct options;
  OptionVisitor visitor;
  options.visit(visitor);
  if (const Status status = visitor.set(texts); !status) return status.error();
  if (const Status status = validate(options); !status) return status.error();
  return options;
}

/// Changes live fields of options in use, all that texts are given for or, with an error, none. As strict as
/// make_options; a field that is not live is an error that names it, too.
template <class Struct>
Status change_options(const OptionTexts& texts, Struct* options) {
  Struct changed = *options;
  OptionVisitor visitor;
  changed.visit(visitor);
  if (const Status status = visitor.change(texts); !status) return status;
  if (const Status status = validate(changed); !status) return status;
  *options = std::move(changed);
  return {};
}

}  // namespace semantic_topo_loop::core
