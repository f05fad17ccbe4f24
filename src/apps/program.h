#pragma once

#include <boost/program_options.hpp>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::apps {

/// The value of an argument: says what it must be and takes it, in the order of the command line. What is not given
/// keeps its value.
class Argument : public boost::program_options::value_semantic {
 public:
  /// @return false if the text is not what it must be
  using Take = std::function<bool(const std::string& text)>;

  /// @param rule what a value must be, for the help and the error; empty for an argument without one
  Argument(std::string rule, Take take) : rule_(std::move(rule)), take_(std::move(take)) {}
  Argument* required();
  Argument* repeatable();

  std::string name() const override { return rule_; }
  unsigned min_tokens() const override { return rule_.empty() ? 0 : 1; }
  unsigned max_tokens() const override { return min_tokens(); }
  bool is_composing() const override { return may_repeat_; }
  bool is_required() const override { return is_needed_; }
  void parse(boost::any& store, const std::vector<std::string>& tokens, bool utf8) const override;
  bool apply_default(boost::any&) const override { return false; }
  void notify(const boost::any&) const override {}

 private:
  std::string rule_;
  Take take_;
  bool is_needed_ = false, may_repeat_ = false;
};

/// Not empty.
Argument* path(std::string* path);
Argument* text(std::string* text);
Argument* flag(bool* is_set);
/// true or false.
Argument* boolean(bool* is_true);
Argument* choice(std::string* choice, const std::vector<std::string>& choices);
/// Finite, in [min, max].
Argument* number(double* number, double min = std::numeric_limits<double>::lowest(),
                 double max = std::numeric_limits<double>::max());
Argument* integer(std::function<void(std::int64_t)> set, std::int64_t min, std::int64_t max);
/// In [min, max], which `Integer` can hold.
template <class Integer>
Argument* integer(Integer* integer, std::int64_t min, std::int64_t max = std::numeric_limits<std::int64_t>::max()) {
  return apps::integer([integer](std::int64_t given) { *integer = static_cast<Integer>(given); }, min, max);
}
/// `key=value`, over what `texts` already holds for the key; may be repeated.
Argument* assignments(core::OptionTexts* texts);

/// A program, or a sub-command of it: what it takes and does.
struct Command {
  std::string name;     ///< the first word; empty for a program that needs no sub-command
  std::string usage;    ///< what follows the name
  std::string purpose;  ///< what it does; lines that end in '\n'
  std::vector<std::pair<std::string, std::string*>>
      words;  ///< names and values of the words without a name, all needed
  boost::program_options::options_description options{120};
  std::function<core::Status()> check;  ///< of the arguments together; may be empty
  std::function<core::Status()> run;

  Command(std::string name, std::string usage, std::string purpose);
  Command& word(const std::string& name, std::string* path);
  /// @param name without the dashes   @param value owned from now on
  Command& option(const char* name, Argument* value, const std::string& meaning);
};

/// A command without arguments that prints a text.
Command print_command(std::string name, std::string purpose, std::function<std::string()> text);

constexpr int kFailed = 1, kBadArguments = 2;

/// Takes words that follow a command's name: words without a name, `--name value`, `--name=value` and `--flag`, in any
/// order; names are not abbreviated.
/// @return an error that names the argument, if one is unknown, lacks its value, is given twice, is not what it must
/// be, or is needed and missing
core::Status read_arguments(const Command& command, const std::vector<std::string>& words);

/// What `main` does: prints what the commands take for --help or -h, else runs the first one that fits and prints its
/// error in one line.
/// @return the exit status: 0 done, 1 failed, 2 wrong arguments
int run_program(const std::string& program, const std::vector<Command>& commands, int argc, char** argv);

/// Where `path`, the value of `argument`, is empty: a file of the package's config directory.
/// @return an error if the package is not on ROS_PACKAGE_PATH
core::Status default_to_package(const std::string& file, const std::string& argument, std::string* path);

}  // namespace semantic_topo_loop::apps
