#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "apps/program.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "tools/perturbation/perturbation.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct DetectionArguments {
  std::string input, output, classes;
  std::uint64_t seed = 1;
  PerturbationOptions options;
};

Status check(DetectionArguments* arguments) {
  if (is_same_file(arguments->input, arguments->output))
    return Error{"'" + arguments->output + "' is the input itself"};
  return default_to_package("classes_coco.yaml", "--classes", &arguments->classes);
}

Status perturb_detection_files(const DetectionArguments& arguments) {
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  const Result<DetectionRecording> recording = read_detections(arguments.input, *classes);
  if (!recording) return recording.error();
  for (const std::string& warning : recording->report.warnings()) std::cerr << "perturb: warning: " << warning << '\n';
  PerturbationCounts counts;
  const std::vector<DetectionFrame> worse =
      perturb_detections(recording->frames, arguments.options, arguments.seed, &counts);
  const auto write = std::filesystem::is_directory(arguments.input) ? write_detections_yolo : write_detections_json;
  if (const Status written = write(arguments.output, worse); !written) return written;
  std::printf("%zu images, %d boxes: %d dropped, %d relabelled\n", worse.size(), counts.boxes, counts.dropped,
              counts.relabelled);
  return {};
}

struct LoopArguments {
  std::string run, out;
  std::uint64_t seed = 1;
  double share = 1.0;
  FalseLoopOptions options;
};

Status make_false_loop_file(const LoopArguments& arguments) {
  if (const Status survives = check_survives_run(arguments.out, arguments.run); !survives) return survives;
  const auto keyframes = read_keyframes(arguments.run + "/keyframes.csv");
  if (!keyframes) return keyframes.error();
  const auto loops = read_loops(arguments.run + "/loops.csv");
  if (!loops) return loops.error();
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
  FalseLoopOptions options = arguments.options;
  options.count = static_cast<int>(std::lround(arguments.share * accepted));
  const std::vector<LoopClosure> wrong = make_false_loops(*keyframes, options, arguments.seed, taken);
  if (const Status written = write_given_loops(arguments.out, wrong); !written) return written;
  std::printf("%d accepted loops, %zu wrong ones written\n", accepted, wrong.size());
  return {};
}

Command detection_command(DetectionArguments* arguments) {
  Command command{"detections", "IN OUT [--seed N] [--drop P] [--relabel P] [--jitter P] [--classes YAML]",
                  "Makes recorded detections worse. IN is a JSON file or a directory of YOLO text files; OUT "
                  "becomes the\nsame. In this order:\n",
                  [arguments] { return perturb_detection_files(*arguments); },
                  [arguments] { return check(arguments); }};
  PerturbationOptions& options = arguments->options;
  command.words = {{"IN", &arguments->input}, {"OUT", &arguments->output}};
  command.option("drop", number(&options.drop, 0.0, 1.0), "share of boxes left out")
      .option("relabel", number(&options.relabel, 0.0, 1.0),
              "share of the remaining boxes that get another one of the classes in IN")
      .option("jitter", number(&options.jitter, 0.0, 1.0),
              "standard deviation of each corner, as a share of the box's width (x) and height (y)")
      .option("seed", number(&arguments->seed, 0), "of all random numbers (default 1)")
      .option("classes", po::value(&arguments->classes),
              "class table (default: config/classes_coco.yaml of the package)");
  return command;
}

Command loop_command(LoopArguments* arguments) {
  constexpr int kMaxCount = 1000000;
  constexpr double kMinSigma = 1e-6;  // without an error a loop has no finite weight
  Command command{"loops",
                  "RUN OUT [--seed N] [--share P] [--cluster N] [--distance M] [--rotation DEG] [--sigma M]\n"
                  "                     [--sigma-deg DEG] [--gap N] [--window N]",
                  "Makes loops that are wrong. RUN is a directory that `offline` wrote; OUT becomes a file for its "
                  "--extra-loops.\n",
                  [arguments] { return make_false_loop_file(*arguments); }};
  FalseLoopOptions& options = arguments->options;
  command.words = {{"RUN", &arguments->run}, {"OUT", &arguments->out}};
  command
      .option("share", number(&arguments->share, 0.0, 100.0),
              "how many, as a share of the loops that RUN accepted (default 1)")
      .option("cluster", number(&options.cluster_size, 1, kMaxCount),
              "so many neighbouring ones agree with each other (default 1: each is wrong by itself)")
      .option("distance", number(&options.distance_m, 0.0),
              "least error of the relative position, m; it is uniform up to twice that (default 1)")
      .option("rotation", number(&options.rotation_deg, 0.0),
              "least error of the rotation, degrees; uniform up to twice that (default 30)")
      .option("sigma", number(&options.sigma_m, kMinSigma), "precision that the loops state, m (default 0.03)")
      .option("sigma-deg", number(&options.sigma_deg, kMinSigma), "precision that the loops state, degrees (default 1)")
      .option("gap", number(&options.min_gap_keyframes, 1, kMaxCount),
              "least number of keyframes between query and match (default 15)")
      .option("window", number(&options.window_frames, 0, kMaxCount), "frames of evidence on either side (default 200)")
      .option("seed", number(&arguments->seed, 0), "of all random numbers (default 1)");
  return command;
}

}  // namespace

/// Makes recorded data worse, to measure what the errors cost. The same arguments give the same bytes.
int main(int argc, char** argv) {
  DetectionArguments detections;
  LoopArguments loops;
  return run_program("perturb", {detection_command(&detections), loop_command(&loops)}, argc, argv);
}
