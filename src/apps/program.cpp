#include "apps/program.h"

#include <ros/package.h>

#include <algorithm>
#include <iostream>
#include <sstream>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::apps {

namespace {

namespace po = boost::program_options;

constexpr char kWords[] = "words";  ///< option of the parser that holds the words without a name

/// A value that is not what it must be.
struct BadValue : po::error_with_option_name {
  BadValue(std::string value, std::string rule)
      : error_with_option_name("bad value"), value(std::move(value)), rule(std::move(rule)) {}
  ~BadValue() noexcept override = default;
  std::string value, rule;
};

bool is_name(const std::string& word) { return word.rfind("--", 0) == 0; }

/// "a, b or c"
std::string listed(const std::vector<std::string>& choices) {
  std::string text = choices.front();
  for (std::size_t i = 1; i < choices.size(); ++i) text += (i + 1 == choices.size() ? " or " : ", ") + choices[i];
  return text;
}

std::string to_text(std::int64_t number) { return std::to_string(number); }
std::string to_text(double number) { return core::format_general(number, 6); }

/// What a number in [min, max] must be.
template <class Number>
std::string rule_of(const std::string& kind, Number min, Number max) {
  using Limits = std::numeric_limits<Number>;
  if (max < Limits::max()) return kind + " in [" + to_text(min) + ", " + to_text(max) + "]";
  return min > Limits::lowest() ? kind + " >= " + to_text(min) : kind;
}

core::Error bad_value(const std::string& name, const std::string& value, const std::string& rule) {
  return core::Error{"argument " + name + " '" + value + "' must be " + rule};
}

core::Status take_words(const Command& command, const std::vector<std::string>& words) {
  if (words.size() > command.words.size()) {
    return core::Error{"unknown argument '" + words[command.words.size()] + "'"};
  }
  for (std::size_t i = 0; i < command.words.size(); ++i) {
    const auto& [name, value] = command.words[i];
    if (i >= words.size()) return core::Error{"argument " + name + " is missing"};
    if (words[i].empty()) return bad_value(name, words[i], "a path");
    *value = words[i];
  }
  return {};
}

std::string help(const std::string& program, const std::vector<Command>& commands) {
  std::ostringstream text;
  for (const Command& command : commands) {
    text << "usage: " << program << (command.name.empty() ? "" : " " + command.name) << ' ' << command.usage << '\n'
         << command.purpose << command.options << '\n';
  }
  text << "Exit status: 0 done, 1 a file is missing or wrong, 2 wrong arguments.\n";
  return text.str();
}

/// @return `status`
int fail(const std::string& who, const std::string& problem, int status) {
  std::cerr << who << ": error: " << problem << (status == kBadArguments ? " (see --help)\n" : "\n");
  return status;
}

}  // namespace

Argument* Argument::required() {
  is_needed_ = true;
  return this;
}

Argument* Argument::repeatable() {
  may_repeat_ = true;
  return this;
}

void Argument::parse(boost::any& store, const std::vector<std::string>& tokens, bool /*utf8*/) const {
  const std::string token = tokens.empty() ? "" : tokens.front();
  if (is_name(token)) throw po::invalid_command_line_syntax(po::invalid_command_line_syntax::missing_parameter);
  if (!store.empty() && !may_repeat_) throw po::multiple_occurrences();
  if (!take_(token)) throw BadValue(token, rule_);
  store = token;
}

Argument* path(std::string* path) {
  return new Argument("a path", [path](const std::string& given) { return !(*path = given).empty(); });
}

Argument* text(std::string* text) {
  return new Argument("a text", [text](const std::string& given) {
    *text = given;
    return true;
  });
}

Argument* flag(bool* is_set) {
  return new Argument("", [is_set](const std::string&) { return *is_set = true; });
}

Argument* boolean(bool* is_true) {
  return new Argument("true or false", [is_true](const std::string& given) {
    *is_true = given == "true";
    return *is_true || given == "false";
  });
}

Argument* choice(std::string* choice, const std::vector<std::string>& choices) {
  return new Argument(listed(choices), [choices, choice](const std::string& given) {
    *choice = given;
    return std::find(choices.begin(), choices.end(), given) != choices.end();
  });
}

Argument* number(double* number, double min, double max) {
  return new Argument(rule_of("a number", min, max), [number, min, max](const std::string& given) {
    const std::optional<double> value = core::parse_double(given);
    *number = value.value_or(0.0);
    return value && *value >= min && *value <= max;
  });
}

Argument* integer(std::function<void(std::int64_t)> set, std::int64_t min, std::int64_t max) {
  return new Argument(rule_of("an integer", min, max), [min, max, set = std::move(set)](const std::string& given) {
    const std::optional<std::int64_t> value = core::parse_integer(given);
    if (!value || *value < min || *value > max) return false;
    set(*value);
    return true;
  });
}

Argument* assignments(core::OptionTexts* texts) {
  const auto take = [texts](const std::string& given) {
    const std::size_t equals = given.find('=');
    if (equals == std::string::npos || equals == 0) return false;
    (*texts)[given.substr(0, equals)] = given.substr(equals + 1);
    return true;
  };
  return (new Argument("<module>.<field>=<value>", take))->repeatable();
}

Command::Command(std::string name, std::string usage, std::string purpose)
    : name(std::move(name)), usage(std::move(usage)), purpose(std::move(purpose)) {}

Command& Command::word(const std::string& name, std::string* path) {
  words.emplace_back(name, path);
  return *this;
}

Command& Command::option(const char* name, Argument* value, const std::string& meaning) {
  options.add_options()(name, value, meaning.c_str());
  return *this;
}

Command print_command(std::string name, std::string purpose, std::function<std::string()> text) {
  Command command(std::move(name), "", std::move(purpose));
  command.run = [text = std::move(text)]() -> core::Status {
    std::cout << text();
    return {};
  };
  return command;
}

core::Status read_arguments(const Command& command, const std::vector<std::string>& words) {
  po::options_description known;
  known.add(command.options).add_options()(kWords, po::value<std::vector<std::string>>());
  constexpr int kStyle = po::command_line_style::allow_long | po::command_line_style::long_allow_next |
                         po::command_line_style::long_allow_adjacent;
  try {
    po::variables_map values;
    const auto positional = po::positional_options_description().add(kWords, -1);
    po::store(po::command_line_parser(words).options(known).positional(positional).style(kStyle).run(), values);
    const po::variable_value& given = values[kWords];
    const core::Status taken =
        take_words(command, given.empty() ? std::vector<std::string>() : given.as<std::vector<std::string>>());
    if (!taken) return taken;
    po::notify(values);
  } catch (const po::unknown_option& error) {
    return core::Error{"unknown argument '" + error.get_option_name() + "'"};
  } catch (const po::multiple_occurrences& error) {
    return core::Error{"argument " + error.get_option_name() + " is given twice"};
  } catch (const po::required_option& error) {
    return core::Error{"argument " + error.get_option_name() + " is missing"};
  } catch (const BadValue& error) {
    return bad_value(error.get_option_name(), error.value, error.rule);
  } catch (const po::invalid_command_line_syntax& error) {
    const bool has_too_much = error.kind() == po::invalid_syntax::extra_parameter;
    return core::Error{"argument " + error.get_option_name() + (has_too_much ? " takes no value" : " lacks its value")};
  } catch (const po::error& error) {
    return core::Error{error.what()};
  }
  return {};
}

int run_program(const std::string& program, const std::vector<Command>& commands, int argc, char** argv) {
  std::vector<std::string> words(argv + 1, argv + argc);
  if (std::any_of(words.begin(), words.end(), [](const auto& word) { return word == "--help" || word == "-h"; })) {
    std::cout << help(program, commands);
    return 0;
  }
  const std::string first = words.empty() ? "" : words.front();
  const auto named = [&commands](const std::string& name) {
    return std::find_if(commands.begin(), commands.end(), [&name](const Command& one) { return one.name == name; });
  };
  const auto command = named(first) == commands.end() ? named("") : named(first);
  if (command == commands.end()) {
    const std::string problem = first.empty() ? "the sub-command is missing" : "unknown sub-command '" + first + "'";
    return fail(program, problem, kBadArguments);
  }
  const bool is_named = !command->name.empty();
  if (is_named) words.erase(words.begin());
  const std::string who = is_named ? program + " " + first : program;
  core::Status status = read_arguments(*command, words);
  if (status && command->check) status = command->check();
  if (!status) return fail(who, status.message(), kBadArguments);
  status = command->run();
  return status ? 0 : fail(who, status.message(), kFailed);
}

core::Status default_to_package(const std::string& file, const std::string& argument, std::string* path) {
  if (!path->empty()) return {};
  const std::string package = ros::package::getPath("semantic_topo_loop");
  if (package.empty()) return core::Error{"the package is not on ROS_PACKAGE_PATH: pass " + argument};
  *path = package + "/config/" + file;
  return {};
}

}  // namespace semantic_topo_loop::apps
