#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "package_path.h"
#include "semantic_topo_loop/detection/detection_reader.h"
#include "semantic_topo_loop/detection/detection_writer.h"
#include "semantic_topo_loop/evaluation/run_files.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/loop_table.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/simulation/detection_perturbation.h"
#include "semantic_topo_loop/simulation/false_loops.h"

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

  perturb loops RUN OUT [--seed N] [--share P] [--cluster N] [--distance M] [--rotation DEG] [--sigma M]
                [--sigma-deg DEG] [--gap N] [--window N]
      RUN is a directory that `offline` wrote; OUT becomes a file for its --extra-loops: loops that are wrong.
      --share     how many, as a share of the loops that RUN accepted (default 1)
      --cluster   so many neighbouring ones agree with each other (default 1: each is wrong by itself)
      --distance  least error of the relative position, m; it is uniform up to twice that (default 1)
      --rotation  least error of the rotation, degrees; uniform up to twice that (default 30)
      --sigma     precision that the loops state, m (default 0.03)
      --sigma-deg precision that the loops state, degrees (default 1)
      --gap       least number of keyframes between query and match (default 15)
      --window    frames of evidence on either side (default 200)
      --seed      of all random numbers (default 1)

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

// --- loops --------------------------------------------------------------------------------------------------------

struct LoopArguments {
  std::uint64_t seed = 1;
  double share = 1.0;
  FalseLoopOptions options;
};

bool to_count(const std::string& name, const std::string& value, int* number, std::string* error) {
  const std::optional<std::int64_t> parsed = parse_integer(value);
  constexpr std::int64_t kMax = 1000000;
  if (parsed && *parsed >= 0 && *parsed <= kMax) {
    *number = static_cast<int>(*parsed);
    return true;
  }
  *error = "argument " + name + " '" + value + "' is no integer in [0, 1000000]";
  return false;
}

bool take(const std::string& name, const std::string& value, LoopArguments* arguments, std::string* error) {
  FalseLoopOptions& options = arguments->options;
  if (name == "--seed") return to_seed(name, value, &arguments->seed, error);
  if (name == "--share") return to_number(name, value, &arguments->share, error);
  if (name == "--cluster") return to_count(name, value, &options.cluster_size, error);
  if (name == "--distance") return to_number(name, value, &options.distance_m, error);
  if (name == "--rotation") return to_number(name, value, &options.rotation_deg, error);
  if (name == "--sigma") return to_number(name, value, &options.sigma_m, error);
  if (name == "--sigma-deg") return to_number(name, value, &options.sigma_deg, error);
  if (name == "--gap") return to_count(name, value, &options.min_gap_keyframes, error);
  if (name == "--window") return to_count(name, value, &options.window_frames, error);
  *error = "unknown argument '" + name + "' of perturb loops";
  return false;
}

bool parse_loop_arguments(const Arguments& words, LoopArguments* arguments, std::string* error) {
  if (words.positional.size() != 2) {
    *error = "perturb loops takes 2 paths, not " + std::to_string(words.positional.size());
    return false;
  }
  for (const auto& [name, value] : words.options) {
    if (!take(name, value, arguments, error)) return false;
  }
  constexpr double kMaxShare = 100.0;
  if (arguments->share >= 0.0 && arguments->share <= kMaxShare) return arguments->options.is_valid(error);
  *error = "argument --share must be in [0, 100]";
  return false;
}

int make_false_loop_file(const Arguments& words, std::string* error) {
  LoopArguments arguments;
  if (!parse_loop_arguments(words, &arguments, error)) return kBadArguments;
  const std::string &run = words.positional[0], &out = words.positional[1];
  const auto keyframes = read_keyframes(run + "/keyframes.csv", error);
  if (!keyframes) return kBadFile;
  const auto loops = read_loops(run + "/loops.csv", error);
  if (!loops) return kBadFile;
  std::map<std::int64_t, std::int64_t> keyframe_of;
  for (const KeyframePose& keyframe : *keyframes) keyframe_of[keyframe.frame_id] = keyframe.keyframe_id;
  KeyframePairs taken;
  int accepted = 0;
  for (const LoopRecord& loop : *loops) {
    if (!loop.accepted) continue;
    ++accepted;
    const auto query = keyframe_of.find(loop.query_frame), match = keyframe_of.find(loop.match_frame);
    if (query != keyframe_of.end() && match != keyframe_of.end()) taken.insert({query->second, match->second});
  }
  arguments.options.count = static_cast<int>(std::lround(arguments.share * accepted));
  const std::vector<LoopClosure> wrong = make_false_loops(*keyframes, arguments.options, arguments.seed, taken);
  if (!write_given_loops(out, wrong, error)) return kBadFile;
  std::printf("%d accepted loops, %zu wrong ones written\n", accepted, wrong.size());
  return 0;
}

// ------------------------------------------------------------------------------------------------------------------

constexpr Command kCommands[] = {{"detections", perturb_detection_files}, {"loops", make_false_loop_file}};

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
