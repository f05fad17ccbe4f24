#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "apps/package_path.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/detection_reader.h"
#include "semantic_topo_loop/io/detection_writer.h"
#include "semantic_topo_loop/io/loop_table.h"
#include "tools/evaluation/run_files.h"
#include "tools/perturbation/perturbation.h"

namespace {

using namespace semantic_topo_loop::apps;
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
)";

template <class Options>
bool is_valid(const Options& options, std::string* error) {
  const Status status = validate(options);
  if (!status) *error = status.message();
  return static_cast<bool>(status);
}

struct DetectionArguments {
  std::string input, output, classes;
  std::uint64_t seed = 1;
  PerturbationOptions options;
};

bool read_detection_arguments(CommandLine* line, DetectionArguments* arguments, std::string* error) {
  line->required("IN", &arguments->input);
  line->required("OUT", &arguments->output);
  line->integer("--seed", &arguments->seed, 0);
  line->number("--drop", &arguments->options.drop);
  line->number("--relabel", &arguments->options.relabel);
  line->number("--jitter", &arguments->options.jitter);
  line->text("--classes", &arguments->classes);
  if (!line->read(error) || !is_valid(arguments->options, error)) return false;
  std::error_code unused;
  if (std::filesystem::equivalent(arguments->input, arguments->output, unused)) {
    *error = "'" + arguments->output + "' is the input itself";
    return false;
  }
  return default_to_package("classes_coco.yaml", "--classes", &arguments->classes, error);
}

bool perturb_detection_files(const DetectionArguments& arguments, std::string* error) {
  const std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  if (!classes) return false;
  DetectionReport report;
  const auto frames = read_detections(arguments.input, *classes, &report, error);
  for (const std::string& warning : report.warnings()) std::cerr << "perturb: warning: " << warning << '\n';
  if (!frames) return false;
  PerturbationCounts counts;
  const std::vector<DetectionFrame> worse = perturb_detections(*frames, arguments.options, arguments.seed, &counts);
  const auto write = std::filesystem::is_directory(arguments.input) ? write_detections_yolo : write_detections_json;
  if (!write(arguments.output, worse, error)) return false;
  std::printf("%zu images, %d boxes: %d dropped, %d relabelled\n", worse.size(), counts.boxes, counts.dropped,
              counts.relabelled);
  return true;
}

struct LoopArguments {
  std::string run, out;
  std::uint64_t seed = 1;
  double share = 1.0;
  FalseLoopOptions options;
};

bool read_loop_arguments(CommandLine* line, LoopArguments* arguments, std::string* error) {
  constexpr int kMaxCount = 1000000;
  FalseLoopOptions& options = arguments->options;
  line->required("RUN", &arguments->run);
  line->required("OUT", &arguments->out);
  line->integer("--seed", &arguments->seed, 0);
  line->number("--share", &arguments->share, 0.0, 100.0);
  line->integer("--cluster", &options.cluster_size, 0, kMaxCount);
  line->number("--distance", &options.distance_m);
  line->number("--rotation", &options.rotation_deg);
  line->number("--sigma", &options.sigma_m);
  line->number("--sigma-deg", &options.sigma_deg);
  line->integer("--gap", &options.min_gap_keyframes, 0, kMaxCount);
  line->integer("--window", &options.window_frames, 0, kMaxCount);
  return line->read(error) && is_valid(options, error);
}

bool make_false_loop_file(const LoopArguments& arguments, std::string* error) {
  const auto keyframes = read_keyframes(arguments.run + "/keyframes.csv", error);
  if (!keyframes) return false;
  const auto loops = read_loops(arguments.run + "/loops.csv", error);
  if (!loops) return false;
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
  if (!write_given_loops(arguments.out, wrong, error)) return false;
  std::printf("%d accepted loops, %zu wrong ones written\n", accepted, wrong.size());
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  return run_program("perturb", kUsage,
                     {make_command("detections", read_detection_arguments, perturb_detection_files),
                      make_command("loops", read_loop_arguments, make_false_loop_file)},
                     argc, argv);
}
