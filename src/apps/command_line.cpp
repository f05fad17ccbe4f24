#include "apps/command_line.h"

#include <algorithm>
#include <iostream>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::apps {

namespace {

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
std::string rule(const std::string& kind, Number min, Number max) {
  using Limits = std::numeric_limits<Number>;
  if (max < Limits::max()) return kind + " in [" + to_text(min) + ", " + to_text(max) + "]";
  return min > Limits::lowest() ? kind + " >= " + to_text(min) : kind;
}

bool asks_for_help(const std::vector<std::string>& words) {
  return std::any_of(words.begin(), words.end(), [](const auto& word) { return word == "--help" || word == "-h"; });
}

/// @return `status`
int fail(const std::string& who, const std::string& problem, int status) {
  std::cerr << who << ": error: " << problem << (status == kBadArguments ? " (see --help)\n" : "\n");
  return status;
}

}  // namespace

void CommandLine::value(const std::string& name, const std::string& rule, Take take) {
  arguments_.push_back({name, rule, std::move(take)});
}

void CommandLine::required(const std::string& name, std::string* path) {
  value(name, "a path", [path](const std::string& text) {
    *path = text;
    return !text.empty();
  });
  arguments_.back().is_needed = true;
}

void CommandLine::text(const std::string& name, std::string* text) {
  value(name, "a text", [text](const std::string& given) {
    *text = given;
    return true;
  });
}

void CommandLine::flag(const std::string& name, bool* is_set) {
  value(name, "alone", [is_set](const std::string&) { return *is_set = true; });
  arguments_.back().has_value = false;
}

void CommandLine::boolean(const std::string& name, bool* is_true) {
  value(name, "true or false", [is_true](const std::string& text) {
    *is_true = text == "true";
    return *is_true || text == "false";
  });
}

void CommandLine::choice(const std::string& name, const std::vector<std::string>& choices, std::string* choice) {
  value(name, listed(choices), [choices, choice](const std::string& text) {
    *choice = text;
    return std::find(choices.begin(), choices.end(), text) != choices.end();
  });
}

void CommandLine::number(const std::string& name, double* number, double min, double max) {
  value(name, rule("a number", min, max), [number, min, max](const std::string& text) {
    const std::optional<double> given = core::parse_double(text);
    *number = given.value_or(0.0);
    return given && *given >= min && *given <= max;
  });
}

void CommandLine::add_integer(const std::string& name, std::int64_t min, std::int64_t max,
                              std::function<void(std::int64_t)> set) {
  value(name, rule("an integer", min, max), [min, max, set = std::move(set)](const std::string& text) {
    const std::optional<std::int64_t> given = core::parse_integer(text);
    set(given.value_or(0));
    return given && *given >= min && *given <= max;
  });
}

void CommandLine::assignments(const std::string& name, core::OptionTexts* texts) {
  value(name, "<module>.<field>=<value>", [texts](const std::string& text) {
    const std::size_t equals = text.find('=');
    (*texts)[text.substr(0, equals)] = text.substr(equals + 1);
    return equals != std::string::npos && equals != 0;
  });
  arguments_.back().may_repeat = true;
}

CommandLine::Argument* CommandLine::find(const std::string& word) {
  const auto found = std::find_if(arguments_.begin(), arguments_.end(), [&word](const Argument& argument) {
    return is_name(word) ? argument.name == word : !is_name(argument.name) && !argument.is_given;
  });
  return found == arguments_.end() ? nullptr : &*found;
}

bool CommandLine::read_argument(std::size_t* word, std::string* error) {
  const std::string& first = words_[*word];
  Argument* const argument = find(first);
  if (argument == nullptr) {
    *error = "unknown argument '" + first + "'";
    return false;
  }
  if (is_name(first) && argument->has_value && (++*word == words_.size() || is_name(words_[*word]))) {
    *error = "argument " + first + " lacks its value";
  } else if (argument->is_given && !argument->may_repeat) {
    *error = "argument " + first + " is given twice";
  } else if (!argument->take(words_[*word])) {
    *error = "argument " + argument->name + " '" + words_[*word] + "' must be " + argument->rule;
  } else {
    return argument->is_given = true;
  }
  return false;
}

bool CommandLine::read(std::string* error) {
  for (std::size_t word = 0; word < words_.size(); ++word) {
    if (!read_argument(&word, error)) return false;
  }
  for (const Argument& argument : arguments_) {
    if (argument.is_given || !argument.is_needed) continue;
    *error = "argument " + argument.name + " is missing";
    return false;
  }
  return true;
}

int run_program(const std::string& program, const std::string& usage, const std::vector<Command>& commands, int argc,
                char** argv) {
  std::vector<std::string> words(argv + 1, argv + argc);
  if (asks_for_help(words)) {
    std::cout << usage << "Exit status: 0 done, 1 a file is missing or wrong, 2 wrong arguments.\n";
    return 0;
  }
  const std::string first = words.empty() ? "" : words.front();
  const auto command = std::find_if(commands.begin(), commands.end(),
                                    [&first](const Command& one) { return one.name == first || one.name.empty(); });
  if (command == commands.end()) {
    const std::string problem = first.empty() ? "the sub-command is missing" : "unknown sub-command '" + first + "'";
    return fail(program, problem, kBadArguments);
  }
  const bool is_named = !command->name.empty();
  if (is_named) words.erase(words.begin());
  CommandLine line(std::move(words));
  std::string error;
  const int status = command->run(&line, &error);
  return status == 0 ? 0 : fail(is_named ? program + " " + first : program, error, status);
}

}  // namespace semantic_topo_loop::apps
