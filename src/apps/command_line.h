#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/io/options_yaml.h"

namespace semantic_topo_loop::apps {

/// The words after a program's name: positional ones, `--name value` and `--flag`, in any order. A program says what it
/// knows and where the values go, then reads. What is not given keeps its value.
class CommandLine {
 public:
  /// @return false if the value is not what it must be
  using Take = std::function<bool(const std::string& value)>;

  explicit CommandLine(std::vector<std::string> words) : words_(std::move(words)) {}

  /// A path that is needed: the one after `--name` or, if the name does not begin so, the next word without one.
  void required(const std::string& name, std::string* path);
  void text(const std::string& name, std::string* text);
  void flag(const std::string& name, bool* is_set);
  /// true or false.
  void boolean(const std::string& name, bool* is_true);
  void choice(const std::string& name, const std::vector<std::string>& choices, std::string* choice);
  /// Finite, in [min, max].
  void number(const std::string& name, double* number, double min = std::numeric_limits<double>::lowest(),
              double max = std::numeric_limits<double>::max());
  /// In [min, max], which `Integer` can hold.
  template <class Integer>
  void integer(const std::string& name, Integer* integer, std::int64_t min,
               std::int64_t max = std::numeric_limits<std::int64_t>::max()) {
    add_integer(name, min, max, [integer](std::int64_t given) { *integer = static_cast<Integer>(given); });
  }
  /// `key=value`, over what `texts` already holds for the key; may be repeated.
  void assignments(const std::string& name, core::OptionTexts* texts);
  /// Any other value.   @param rule what it must be, for the error
  void value(const std::string& name, const std::string& rule, Take take);

  /// @return false, with the argument named in `error`, if one is unknown, lacks its value, is given twice, is not what
  /// it must be, or is needed and missing
  bool read(std::string* error);

 private:
  struct Argument {
    std::string name, rule;
    Take take;
    bool has_value = true, is_needed = false, may_repeat = false;
    bool is_given = false;
  };

  void add_integer(const std::string& name, std::int64_t min, std::int64_t max, std::function<void(std::int64_t)> set);
  /// The argument that a word names or, without a name, is; null if there is none.
  Argument* find(const std::string& word);
  /// Reads the argument that begins at `*word` and leaves `*word` at its last one.
  bool read_argument(std::size_t* word, std::string* error);

  std::vector<std::string> words_;
  std::vector<Argument> arguments_;
};

/// A program, or a sub-command of it.
struct Command {
  std::string name;  ///< the first word; empty for a program that needs no sub-command
  /// @return the exit status, with the problem in `error` unless 0
  std::function<int(CommandLine* line, std::string* error)> run;
};

constexpr int kFailed = 1, kBadArguments = 2;

/// A command in two steps, each of which returns false with `error` set: its arguments, then what it does.
template <class Arguments>
Command make_command(std::string name, bool (*read)(CommandLine* line, Arguments* arguments, std::string* error),
                     bool (*run)(const Arguments& arguments, std::string* error)) {
  return {std::move(name), [read, run](CommandLine* line, std::string* error) {
            Arguments arguments;
            if (!read(line, &arguments, error)) return kBadArguments;
            return run(arguments, error) ? 0 : kFailed;
          }};
}

/// What `main` does: prints `usage` for --help or -h, else runs the first command that fits and prints its error in one
/// line.
/// @return the exit status: 0 done, 1 failed, 2 wrong arguments
int run_program(const std::string& program, const std::string& usage, const std::vector<Command>& commands, int argc,
                char** argv);

}  // namespace semantic_topo_loop::apps
