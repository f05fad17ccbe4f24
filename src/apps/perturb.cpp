#include <cstdio>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "package_path.h"
#include "semantic_topo_loop/detection/detection_reader.h"
#include "semantic_topo_loop/detection/detection_writer.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/simulation/detection_perturbation.h"

namespace {

using namespace semantic_topo_loop::core;

constexpr char kUsage[] =
    R"(Makes recorded data worse, to measure what the errors cost. The same arguments give the same bytes.

  perturb detections IN OUT [--seed N] [--drop P] [--relabel P] [--jitter P] [--classes YAML]
      IN is an OA-SLAM JSON file or a directory of YOLO text files; OUT becomes the same. In this order:
      --drop     share of boxes left out
      --relabel  share of the remaining boxes that get another one of the classes in IN
      --jitter   standard deviation of each corner, as a share of the box's width (x) and height (y)
      --seed     of all random numbers (default 1)
      --classes  class table (default: config/classes_coco.yaml of the package)

  --help         shows this text
Exit status: 0 done, 1 a file is missing or wrong, 2 wrong arguments.
)";

constexpr int kBadFile = 1, kBadArguments = 2;

/// The words after the sub-command: `--name value` pairs and the rest.
struct Arguments {
  std::vector<std::string> positional;
  std::vector<std::pair<std::string, std::string>> options;
};

struct Command {
  const char* name;
  /// @return the exit status, with the problem in `error` unless 0
  int (*run)(const Arguments&, std::string* error);
};

bool to_number(const std::string& name, const std::string& value, double* number, std::string* error) {
  const std::optional<double> parsed = parse_double(value);
  if (parsed) *number = *parsed;
  if (!parsed) *error = "argument " + name + " '" + value + "' is no number";
  return parsed.has_value();
}

bool to_seed(const std::string& name, const std::string& value, std::uint64_t* seed, std::string* error) {
  const std::optional<std::int64_t> parsed = parse_integer(value);
  if (parsed && *parsed >= 0) {
    *seed = static_cast<std::uint64_t>(*parsed);
    return true;
  }
  *error = "argument " + name + " '" + value + "' is no integer >= 0";
  return false;
}

// --- detections ---------------------------------------------------------------------------------------------------

struct DetectionArguments {
  std::string input, output, classes;
  std::uint64_t seed = 1;
  PerturbationOptions options;
};

bool take(const std::string& name, const std::string& value, DetectionArguments* arguments, std::string* error) {
  if (name == "--seed") return to_seed(name, value, &arguments->seed, error);
  if (name == "--drop") return to_number(name, value, &arguments->options.drop, error);
  if (name == "--relabel") return to_number(name, value, &arguments->options.relabel, error);
  if (name == "--jitter") return to_number(name, value, &arguments->options.jitter, error);
  if (name == "--classes") {
    arguments->classes = value;
    return true;
  }
  *error = "unknown argument '" + name + "' of perturb detections";
  return false;
}

bool parse_detection_arguments(const Arguments& words, DetectionArguments* arguments, std::string* error) {
  if (words.positional.size() != 2) {
    *error = "perturb detections takes 2 paths, not " + std::to_string(words.positional.size());
    return false;
  }
  arguments->input = words.positional[0];
  arguments->output = words.positional[1];
  for (const auto& [name, value] : words.options) {
    if (!take(name, value, arguments, error)) return false;
  }
  if (!arguments->options.is_valid(error)) return false;
  std::error_code unused;
  if (std::filesystem::equivalent(arguments->input, arguments->output, unused)) {
    *error = "'" + arguments->output + "' is the input itself";
    return false;
  }
  if (arguments->classes.empty()) arguments->classes = semantic_topo_loop::apps::config_file("classes_coco.yaml");
  if (!arguments->classes.empty()) return true;
  *error = "the package is not on ROS_PACKAGE_PATH: pass --classes";
  return false;
}

int perturb_detection_files(const Arguments& words, std::string* error) {
  DetectionArguments arguments;
  if (!parse_detection_arguments(words, &arguments, error)) return kBadArguments;
  const std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  if (!classes) return kBadFile;
  DetectionReport report;
  const auto frames = read_detections(arguments.input, *classes, &report, error);
  for (const std::string& warning : report.warnings()) std::cerr << "perturb: warning: " << warning << '\n';
  if (!frames) return kBadFile;
  PerturbationCounts counts;
  const std::vector<DetectionFrame> worse = perturb_detections(*frames, arguments.options, arguments.seed, &counts);
  const auto write = std::filesystem::is_directory(arguments.input) ? write_detections_yolo : write_detections_json;
  if (!write(arguments.output, worse, error)) return kBadFile;
  std::printf("%zu images, %d boxes: %d dropped, %d relabelled\n", worse.size(), counts.boxes, counts.dropped,
              counts.relabelled);
  return 0;
}

// ------------------------------------------------------------------------------------------------------------------

constexpr Command kCommands[] = {{"detections", perturb_detection_files}};

bool split_arguments(int argc, char** argv, Arguments* arguments, std::string* error) {
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i];
    if (word.rfind("--", 0) != 0) {
      arguments->positional.push_back(word);
    } else if (i + 1 < argc) {
      arguments->options.emplace_back(word, argv[++i]);
    } else {
      *error = "argument '" + word + "' is unknown or lacks its value";
      return false;
    }
  }
  return true;
}

int run(int argc, char** argv, std::string* error) {
  for (const Command& command : kCommands) {
    if (argc < 2 || std::strcmp(argv[1], command.name) != 0) continue;
    Arguments arguments;
    return split_arguments(argc, argv, &arguments, error) ? command.run(arguments, error) : kBadArguments;
  }
  *error = argc < 2 ? "the sub-command is missing" : "unknown sub-command '" + std::string(argv[1]) + "'";
  return kBadArguments;
}

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(kUsage, stdout);
      return 0;
    }
  }
  std::string error;
  const int status = run(argc, argv, &error);
  if (status != 0) {
    std::cerr << "perturb: error: " << error << (status == kBadArguments ? " (see --help)" : "") << '\n';
  }
  return status;
}
