#include "apps/program.h"

#include <malloc.h>
#include <ros/package.h>

#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>

namespace semantic_topo_loop::apps {
namespace {

/// What one image has freed the next one takes. Given back to the system each time it costs a tenth of a run on images.
void keep_freed_memory() {
  constexpr int kMostMapped = 32 << 20;  // no more is allowed
  ::mallopt(M_MMAP_THRESHOLD, kMostMapped);
  ::mallopt(M_TRIM_THRESHOLD, 4 * kMostMapped);
}

}  // namespace

void refuse(const std::string& name, const std::string& value, const std::string& rule) {
  throw po::error("the argument ('" + value + "') for option '--" + name + "' must be " + rule);
}

Value checked(const std::string& rule, const std::function<bool(const std::string&)>& take, bool is_required) {
  return [=](const std::string& name) {
    auto* value = po::value<std::string>()->value_name(rule)->notifier([=](const std::string& given) {
      if (!take(given)) refuse(name, given, rule);
    });
    return is_required ? value->required() : value;
  };
}

Value path(std::string* path) {
  return checked(
      "a path", [path](const std::string& given) { return !(*path = given).empty(); }, true);
}

Value boolean(bool* is_true) {
  return checked("true or false", [is_true](const std::string& given) {
    *is_true = given == "true";
    return *is_true || given == "false";
  });
}

Value choice(std::string* choice, const std::vector<std::string>& choices) {
  const core::Range range = core::one_of(choices);
  return checked(range.rule(), [range, choice](const std::string& given) {
    *choice = given;
    return range.holds(given);
  });
}

Value assignments(core::OptionTexts* texts) {
  return [texts](const std::string& name) {
    const std::string rule = "<module>.<field>=<value>";
    const auto take = [=](const std::vector<std::string>& given) {
      for (const std::string& text : given) {
        const std::size_t equals = text.find('=');
        if (equals == std::string::npos || equals == 0) refuse(name, text, rule);
        (*texts)[text.substr(0, equals)] = text.substr(equals + 1);
      }
    };
    return po::value<std::vector<std::string>>()->composing()->value_name(rule)->notifier(take);
  };
}

Command print_command(const std::string& name, const std::string& purpose, const std::function<std::string()>& text) {
  return {name, "", purpose, [text] {
            std::cout << text();
            return core::Status();
          }};
}

core::Status read_arguments(const Command& command, const std::vector<std::string>& words) try {
  po::options_description known;
  known.add(command.options);
  po::positional_options_description positional;
  for (const auto& [name, value] : command.words) {
    known.add_options()(name.c_str(), path(value)(name));
    positional.add(name.c_str(), 1);
  }
  const auto style = po::command_line_style::allow_long | po::command_line_style::long_allow_next |
                     po::command_line_style::long_allow_adjacent;
  positional.add("more", -1);
  const auto parsed = po::command_line_parser(words).options(known).positional(positional).style(style).run();
  for (const po::option& one : parsed.options) {
    if (one.position_key >= static_cast<int>(command.words.size())) {
      return core::Error{"unrecognised argument '" + one.value.front() + "'"};
    }
    // The parser takes the next option's name for a value.
    const bool is_value_a_name = one.position_key < 0 && !one.value.empty() && one.value.front().rfind("--", 0) == 0;
    if (is_value_a_name) return core::Error{"the required argument for option '--" + one.string_key + "' is missing"};
  }
  po::variables_map values;
  po::store(parsed, values);
  po::notify(values);
  return {};
} catch (const po::error& error) {
  return core::Error{error.what()};
}

int run_program(const std::string& program, const std::vector<Command>& commands, int argc, char** argv) try {
  keep_freed_memory();
  std::vector<std::string> words(argv + 1, argv + argc);
  if (std::any_of(words.begin(), words.end(), [](const auto& word) { return word == "--help" || word == "-h"; })) {
    for (const Command& command : commands) {
      std::cout << "usage: " << program << (command.name.empty() ? "" : " " + command.name) << ' ' << command.usage
                << '\n'
                << command.purpose << command.options << '\n';
    }
    std::cout << "Exit status: 0 done, 1 a file is missing or wrong, 2 wrong arguments.\n";
    return 0;
  }
  const std::string first = words.empty() ? "" : words.front();
  const auto named = [&commands](const std::string& name) {
    return std::find_if(commands.begin(), commands.end(), [&name](const Command& one) { return one.name == name; });
  };
  const auto command = named(first) == commands.end() ? named("") : named(first);
  const bool is_named = command != commands.end() && !command->name.empty();
  if (is_named) words.erase(words.begin());
  core::Status status =
      core::Error{first.empty() ? "the sub-command is missing" : "unknown sub-command '" + first + "'"};
  if (command != commands.end()) status = read_arguments(*command, words);
  if (status && command->check) status = command->check();
  const bool is_read = static_cast<bool>(status);
  if (is_read) status = command->run();
  const bool is_told = static_cast<bool>(std::cout.flush()) && std::fflush(stdout) == 0;
  if (status && !is_told) status = core::Error{"standard output: cannot be written"};
  if (status) return 0;
  std::cerr << program << (is_named ? " " + first : "") << ": error: " << status.message()
            << (is_read ? "\n" : " (see --help)\n");
  return is_read ? 1 : 2;
} catch (const std::exception& exception) {
  std::string cause = exception.what();
  std::replace(cause.begin(), cause.end(), '\n', ' ');
  std::cerr << program << ": error: " << cause << '\n';
  return 1;
}

core::Status default_to_package(const std::string& file, const std::string& argument, std::string* path) {
  if (!path->empty()) return {};
  const std::string package = ros::package::getPath("semantic_topo_loop");
  if (package.empty()) return core::Error{"the package is not on ROS_PACKAGE_PATH: pass " + argument};
  *path = package + "/config/" + file;
  return {};
}

}  // namespace semantic_topo_loop::apps
