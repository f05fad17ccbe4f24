#pragma once

#include <boost/program_options.hpp>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::apps {

namespace po = boost::program_options;

/// Throws the error of an option's value that is not what it must be.
[[noreturn]] void refuse(const std::string& name, const std::string& value, const std::string& rule);

/// What reads the value of the option of that name.
using Value = std::function<const po::value_semantic*(const std::string& name)>;

/// A text for which `take` must be true; it stores the text.
/// @param rule what the value must be, for the help and the error
Value checked(const std::string& rule, const std::function<bool(const std::string&)>& take, bool is_required = false);
/// Needed, not empty.
Value path(std::string* path);
/// true or false.
Value boolean(bool* is_true);
Value choice(std::string* choice, const std::vector<std::string>& choices);
/// `key=value`, over what `texts` already holds for the key; may be repeated.
Value assignments(core::OptionTexts* texts);

/// Finite, in [min, max], which `Number` can hold.
template <class Number, class Given = std::conditional_t<std::is_integral_v<Number>, std::int64_t, double>>
Value number(Number* number, std::common_type_t<Given> min = std::numeric_limits<Given>::lowest(),
             std::common_type_t<Given> max = std::numeric_limits<Given>::max()) {
  const auto text = [](Given value) {
    if constexpr (std::is_integral_v<Given>) return std::to_string(value);
    return core::format_general(static_cast<double>(value), 6);
  };
  std::string rule = std::is_integral_v<Given> ? "an integer" : "a finite number";
  if (max < std::numeric_limits<Given>::max()) {
    rule += " in [" + text(min) + ", " + text(max) + "]";
  } else if (min > std::numeric_limits<Given>::lowest()) {
    rule += " >= " + text(min);
  }
  return [=](const std::string& name) {
    return po::value<Given>()->value_name(rule)->notifier([=](Given given) {
      if (!(given >= min && given <= max)) refuse(name, text(given), rule);
      *number = static_cast<Number>(given);
    });
  };
}

/// A program, or a sub-command of it: what it takes and does.
struct Command {
  std::string name;     ///< the first word; empty for a program without one
  std::string usage;    ///< what follows the name
  std::string purpose;  ///< what it does; lines that end in '\n'
  std::function<core::Status()> run = nullptr;
  std::function<core::Status()> check = nullptr;                 ///< of the arguments together; may be empty
  std::vector<std::pair<std::string, std::string*>> words = {};  ///< paths without a name in front, all needed
  po::options_description options{120};

  /// @param value is owned from now on
  Command& option(const char* name, const po::value_semantic* value, const std::string& meaning = {}) {
    options.add_options()(name, value, meaning.c_str());
    return *this;
  }
  Command& option(const char* name, const Value& value, const std::string& meaning = {}) {
    return option(name, value(name), meaning);
  }
};

/// A command that prints a text.
Command print_command(const std::string& name, const std::string& purpose, const std::function<std::string()>& text);

/// Takes words that follow a command's name; what is not given keeps its value. Names are not abbreviated.
/// @return an error that names the argument, if one is unknown, lacks its value, is given twice, is not what it must
/// be, or is needed and missing
core::Status read_arguments(const Command& command, const std::vector<std::string>& words);

/// What `main` does: prints what the commands take for --help or -h, else runs the first one that fits and prints its
/// error, or that of an exception, in one line.
/// @return the exit status: 0 done, 1 failed, 2 wrong arguments
int run_program(const std::string& program, const std::vector<Command>& commands, int argc, char** argv);

/// Where `path`, the value of `argument`, is empty: a file of the package's config directory.
/// @return an error if the package is not on ROS_PACKAGE_PATH
core::Status default_to_package(const std::string& file, const std::string& argument, std::string* path);

}  // namespace semantic_topo_loop::apps
