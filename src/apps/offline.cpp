#include <unistd.h>

#include <cstdio>
#include <iostream>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "package_path.h"
#include "sample_source.h"
#include "semantic_topo_loop/detection/detection_reader.h"
#include "semantic_topo_loop/evaluation/run_files.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/io/rgbd_folder.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/submap_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/pipeline/stopwatch.h"
#include "semantic_topo_loop/ros/tum_bag_reader.h"

namespace {

using namespace semantic_topo_loop::core;
using semantic_topo_loop::apps::RgbdSource;
using semantic_topo_loop::apps::SampleSource;
using semantic_topo_loop::apps::TrajectorySource;

constexpr char kUsage[] =
    "usage: offline --trajectory FILE --detections FILE_OR_DIR --camera YAML --output DIR\n"
    "               [--classes YAML] [--config YAML] [--set module.field=value ...]\n"
    "               [--extra-loops CSV] [--map FILE] [--save-map FILE] [--points FILE]\n"
    "       offline --rgbd DIR --camera YAML --output DIR [--associations FILE] [--detections FILE_OR_DIR] ...\n"
    "       offline --bag FILE --camera YAML --output DIR [--detections FILE_OR_DIR] ...\n"
    "Runs the whole chain on recorded files, without a ROS master.\n"
    "  --trajectory  camera poses of the odometry, TUM format; one frame a pose\n"
    "  --rgbd        folder of colour and depth images: the odometry is found from them; see depth.* and frontend.*\n"
    "  --bag         the same from a bag in the layout of the TUM RGB-D bags\n"
    "  --associations which depth belongs to which colour image (default: associations.txt of the folder)\n"
    "  --detections  OA-SLAM JSON file, or directory of YOLO text files <stamp>.txt; with --rgbd and --bag they\n"
    "                may be left out: odometry only\n"
    "  --camera      calibration, see config/camera\n"
    "  --classes     class table (default: config/classes_coco.yaml of the package)\n"
    "  --config      parameters (default: the built-in ones, those of config/default.yaml)\n"
    "  --set         one parameter, over --config; may be repeated\n"
    "  --extra-loops loops for the pose graph beside those that are found, as loops.csv, see docs/files.md\n"
    "  --output      directory of the results, made if missing\n"
    "  --map         submaps that an earlier run saved: the run's place in its map is looked for\n"
    "  --save-map    file for this run's submaps, for later runs\n"
    "  --points      with --rgbd: file for the map's points, .ply or .pcd\n"
    "       offline --list-parameters\n"
    "Prints every parameter with its default, as a Markdown table.\n";

constexpr std::int64_t kStampTolerance_ns = 1000;

struct Arguments {
  std::string trajectory, rgbd, bag, associations, detections, camera, classes, config, extra_loops, output, map,
      save_map, points;
  std::vector<std::string> assignments;
};

/// Whether the arguments that belong together are there.
bool are_complete(const Arguments& arguments, std::string* error) {
  const int sources = !arguments.trajectory.empty() + !arguments.rgbd.empty() + !arguments.bag.empty();
  if (sources != 1) {
    *error = "one of the arguments --trajectory, --rgbd and --bag is needed";
  } else if (arguments.detections.empty() && !arguments.trajectory.empty()) {
    *error = "argument --detections is missing";
  } else if (!arguments.associations.empty() && arguments.rgbd.empty()) {
    *error = "argument --associations needs --rgbd";
  } else if (!arguments.points.empty() && arguments.rgbd.empty()) {
    *error = "argument --points needs --rgbd";
  } else if (!arguments.points.empty() && !is_point_cloud_path(arguments.points)) {
    *error = "argument --points '" + arguments.points + "' ends neither in .ply nor in .pcd";
  } else {
    return true;
  }
  return false;
}

/// @return false with `error` set; an empty error means that help was asked for
bool parse(int argc, char** argv, Arguments* arguments, std::string* error) {
  const std::vector<std::pair<std::string, std::string*>> fields = {{"--trajectory", &arguments->trajectory},
                                                                    {"--rgbd", &arguments->rgbd},
                                                                    {"--bag", &arguments->bag},
                                                                    {"--detections", &arguments->detections},
                                                                    {"--associations", &arguments->associations},
                                                                    {"--camera", &arguments->camera},
                                                                    {"--classes", &arguments->classes},
                                                                    {"--config", &arguments->config},
                                                                    {"--extra-loops", &arguments->extra_loops},
                                                                    {"--output", &arguments->output},
                                                                    {"--map", &arguments->map},
                                                                    {"--save-map", &arguments->save_map},
                                                                    {"--points", &arguments->points}};
  const std::set<std::string> optional = {"--trajectory",   "--rgbd",     "--bag",    "--detections",
                                          "--associations", "--classes",  "--config", "--extra-loops",
                                          "--map",          "--save-map", "--points"};
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    if (name == "--help" || name == "-h") return false;
    if (i + 1 == argc) {
      *error = "argument '" + name + "' is unknown or lacks its value";
      return false;
    }
    const std::string value = argv[++i];
    if (name == "--set") {
      arguments->assignments.push_back(value);
      continue;
    }
    bool known = false;
    for (const auto& [field, target] : fields) {
      if (field != name) continue;
      *target = value;
      known = true;
    }
    if (!known) {
      *error = "unknown argument '" + name + "'";
      return false;
    }
  }
  for (const auto& [field, target] : fields) {
    if (target->empty() && optional.count(field) == 0) {
      *error = "argument " + field + " is missing";
      return false;
    }
  }
  if (!are_complete(*arguments, error)) return false;
  if (arguments->classes.empty()) {
    arguments->classes = semantic_topo_loop::apps::config_file("classes_coco.yaml");
    if (arguments->classes.empty()) {
      *error = "the package is not on ROS_PACKAGE_PATH: pass --classes";
      return false;
    }
  }
  return true;
}

struct Inputs {
  Options options;
  Camera camera;
  std::shared_ptr<const ClassTable> classes;
  std::unique_ptr<SampleSource> source;
  std::vector<DetectionFrame> detections;
  std::vector<LoopClosure> extra_loops;
  std::optional<std::vector<LocalMap>> earlier_map;
  std::string save_map, points;
};

/// @return what opens the recording of --bag or --rgbd; null with `error` set
RgbdSource::Open image_opener(const Arguments& arguments, const Inputs& inputs, std::string* error) {
  const Camera& camera = inputs.camera;
  const DepthOptions& depth = inputs.options.depth;
  if (!arguments.bag.empty()) {
    return [bag = arguments.bag, camera, depth](std::string* why) {
      return semantic_topo_loop::open_tum_bag(bag, camera, depth, why);
    };
  }
  const std::string list =
      arguments.associations.empty() ? arguments.rgbd + "/associations.txt" : arguments.associations;
  std::string warning;
  std::optional<std::vector<RgbdFile>> files = read_associations(list, arguments.rgbd, &warning, error);
  if (!files) return nullptr;
  if (!warning.empty()) std::cerr << "offline: warning: " << warning << '\n';
  return [camera, depth, files = *files](std::string*) { return std::make_unique<RgbdFolder>(files, camera, depth); };
}

std::unique_ptr<SampleSource> open_source(const Arguments& arguments, const Inputs& inputs, std::string* error) {
  if (!arguments.trajectory.empty()) {
    std::optional<StampedPoses> trajectory = read_tum_trajectory(arguments.trajectory, error);
    if (!trajectory) return nullptr;
    return std::make_unique<TrajectorySource>(std::move(*trajectory));
  }
  const RgbdSource::Open open_reader = image_opener(arguments, inputs, error);
  if (!open_reader) return nullptr;
  return RgbdSource::open(open_reader, inputs.camera, inputs.options.frontend, error);
}

bool load_detections(const std::string& path, const ClassTable& classes, std::vector<DetectionFrame>* frames,
                     std::string* error) {
  if (path.empty()) return true;
  DetectionReport report;
  std::optional<std::vector<DetectionFrame>> detections = read_detections(path, classes, &report, error);
  for (const std::string& warning : report.warnings()) std::cerr << "offline: warning: " << warning << '\n';
  if (detections) *frames = std::move(*detections);
  return detections.has_value();
}

bool load_extra_loops(const std::string& path, std::vector<LoopClosure>* loops, std::string* error) {
  if (path.empty()) return true;
  std::optional<std::vector<LoopClosure>> given = read_given_loops(path, error);
  if (given) *loops = std::move(*given);
  return given.has_value();
}

std::optional<Inputs> load(const Arguments& arguments, std::string* error) {
  Inputs inputs;
  const std::optional<Options> options = load_options(arguments.config, arguments.assignments, error);
  if (!options) return std::nullopt;
  inputs.options = *options;
  const std::optional<Camera> camera = read_camera(arguments.camera, error);
  if (!camera) return std::nullopt;
  inputs.camera = *camera;
  std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  if (!classes) return std::nullopt;
  inputs.classes = std::make_shared<const ClassTable>(std::move(*classes));
  inputs.source = open_source(arguments, inputs, error);
  if (!inputs.source) return std::nullopt;
  if (!load_detections(arguments.detections, *inputs.classes, &inputs.detections, error)) return std::nullopt;
  if (!load_extra_loops(arguments.extra_loops, &inputs.extra_loops, error)) return std::nullopt;
  inputs.save_map = arguments.save_map;
  inputs.points = arguments.points;
  if (!arguments.map.empty()) {
    if (inputs.options.loop.mode != "graph") {
      *error = "argument --map = '" + arguments.map + "' needs loop.mode = graph";
      return std::nullopt;
    }
    inputs.earlier_map = read_submaps(arguments.map, *inputs.classes, error);
    if (!inputs.earlier_map) return std::nullopt;
  }
  return inputs;
}

class Progress {
 public:
  explicit Progress(std::size_t total) : total_(total), is_terminal_(isatty(STDERR_FILENO) != 0) {}
  void show(std::size_t done) {
    const int percent = static_cast<int>(100 * done / total_);
    if (!is_terminal_ || percent == percent_) return;
    percent_ = percent;
    constexpr int kWidth = 50;
    const std::string bar(static_cast<std::size_t>(percent * kWidth / 100), '#');
    std::fprintf(stderr, "\r[%-*s] %3d %%%s", kWidth, bar.c_str(), percent, done == total_ ? "\n" : "");
  }

 private:
  std::size_t total_;
  bool is_terminal_;
  int percent_ = -1;
};

/// Hands loops out at their query frames.
class ExtraLoops {
 public:
  explicit ExtraLoops(const std::vector<LoopClosure>& loops) {
    for (const LoopClosure& loop : loops) loops_[loop.query_frame].push_back(loop);
  }
  std::vector<LoopClosure> at(const Frame& frame) {
    if (frame.is_keyframe) keyframe_of_[frame.frame_id] = frame.keyframe_id;
    std::vector<LoopClosure> due = std::move(loops_[frame.frame_id]);
    loops_.erase(frame.frame_id);
    for (LoopClosure& loop : due) {
      loop.query_keyframe_id = keyframe(loop.query_frame);
      loop.match_keyframe_id = keyframe(loop.match_frame);
    }
    return due;
  }
  /// Those whose query frame never came.
  std::size_t left() const {
    std::size_t count = 0;
    for (const auto& [frame, loops] : loops_) count += loops.size();
    return count;
  }

 private:
  /// -1 where there is none: the pose graph refuses such a loop.
  std::int64_t keyframe(std::int64_t frame_id) const {
    const auto found = keyframe_of_.find(frame_id);
    return found == keyframe_of_.end() ? -1 : found->second;
  }
  std::map<std::int64_t, std::vector<LoopClosure>> loops_;
  std::map<std::int64_t, std::int64_t> keyframe_of_;
};

void record(const Frame& frame, const FrameResult& result, RunRecorder* recorder) {
  recorder->record(frame);
  recorder->record(result.associations);
  recorder->record(result.observation);
  recorder->record(frame.frame_id, result.loops, result.loop_us);
  recorder->record(result.correction);
  recorder->record(result.completion);
}

void print(const std::optional<Relocalisation>& found) {
  if (!found) {
    std::printf("not found in the earlier map\n");
    return;
  }
  const SE3& T = found->T_earlier_odom;
  std::printf("earlier map from odometry: %.4f %.4f %.4f %.6f %.6f %.6f %.6f, by %d of %d loops\n", T.t.x(), T.t.y(),
              T.t.z(), T.q.x(), T.q.y(), T.q.z(), T.q.w(), found->agreeing, found->total);
}

/// What a run went through.
struct Counts {
  std::size_t frames = 0;
  std::size_t with_detections = 0;
  std::int64_t first_ns = 0, last_ns = 0;
};

void warn(const Inputs& inputs, const Counts& counts, std::size_t loops_left) {
  const auto say = [](const std::string& text) { std::cerr << "offline: warning: " << text << '\n'; };
  const std::size_t images = inputs.detections.size();
  if (images > 0 && counts.with_detections < counts.frames) {
    say(std::to_string(counts.frames - counts.with_detections) + " of " + std::to_string(counts.frames) +
        " frames have no detections");
  }
  if (loops_left > 0) say(std::to_string(loops_left) + " extra loops have a query frame that never came");
  if (counts.with_detections < images) {
    say(std::to_string(images - counts.with_detections) + " of " + std::to_string(images) +
        " images with detections have no pose and were left out");
  }
  if (!inputs.source->warning().empty()) say(inputs.source->warning());
  const std::optional<TrackingReport> tracking = inputs.source->report();
  if (tracking && !tracking->warning().empty()) say(tracking->warning());
  const std::string depth = inputs.source->depth_range().warning(inputs.options.depth);
  if (!depth.empty()) say(depth);
}

/// @return whether there were frames, and detections that belong to them, if there are any; else `error` is set
bool has_input(const Inputs& inputs, const Counts& counts, std::string* error) {
  if (counts.frames == 0) {
    const std::optional<TrackingReport> tracking = inputs.source->report();
    *error = inputs.source->fault();
    if (!error->empty()) return false;
    *error = "no image has a pose" + (tracking ? ": " + tracking->warning() : std::string());
    const std::string depth = inputs.source->depth_range().warning(inputs.options.depth);
    if (!depth.empty()) *error += "; " + depth;
    return false;
  }
  if (counts.with_detections > 0 || inputs.detections.empty()) return true;
  *error = "no detection has the stamp of a pose: the first of each are " + std::to_string(counts.first_ns) +
           " ns (pose) and " + std::to_string(inputs.detections.front().stamp_ns) + " ns (detection)";
  return false;
}

/// @return false with `error` set if the inputs have no frame in common, or the submaps cannot be written; and when the
/// source needs to be rewound, without results
bool run(const Inputs& inputs, RunRecorder* recorder, std::string* error) {
  ObjectSlam slam(inputs.options, inputs.classes);
  if (inputs.earlier_map) slam.set_earlier_map(*inputs.earlier_map);
  FrameBuilder builder(inputs.options.keyframe, inputs.camera);
  PointMap point_map(inputs.options.point_map);
  ExtraLoops extra_loops(inputs.extra_loops);
  Progress progress(inputs.source->total());
  Counts counts;
  const std::vector<Detection> none;
  const Stopwatch stopwatch;
  while (const std::optional<PoseSample> sample = inputs.source->next()) {
    if (const std::optional<Camera> camera = inputs.source->camera()) builder.set_camera(*camera);
    std::optional<Frame> frame = builder.build(*sample, error);
    if (!frame) return false;
    if (frame->is_keyframe && !inputs.points.empty()) {
      frame->keyframe_points = inputs.source->keyframe_points(inputs.options.point_map.semi_dense_max);
    }
    const DetectionFrame* detections = find_stamp(inputs.detections, frame->stamp_ns, kStampTolerance_ns);
    if (detections != nullptr) ++counts.with_detections;
    const std::vector<Detection>& boxes = detections != nullptr ? detections->detections : none;
    const FrameResult result = slam.process(*frame, boxes, extra_loops.at(*frame));
    point_map.add(*frame);
    point_map.apply(result.correction);
    record(*frame, result, recorder);
    if (counts.frames++ == 0) counts.first_ns = frame->stamp_ns;
    counts.last_ns = frame->stamp_ns;
    progress.show(inputs.source->done());
  }
  if (inputs.source->needs_rewind() || !has_input(inputs, counts, error)) return false;
  const Frame end = builder.end();
  const FrameResult last = slam.process(end, none);
  point_map.apply(last.correction);
  record(end, last, recorder);
  if (const std::optional<TrackingReport> tracking = inputs.source->report()) recorder->record(*tracking);
  if (!inputs.points.empty() && !write_point_cloud(inputs.points, point_map.points(), error)) return false;
  if (!inputs.save_map.empty() && !write_submaps(inputs.save_map, slam.submaps_in_map(), error)) return false;

  const double seconds = 1e-6 * stopwatch.elapsed_us();
  const double recorded = 1e-9 * static_cast<double>(counts.last_ns - counts.first_ns);
  warn(inputs, counts, extra_loops.left());
  std::printf("%zu frames in %.2f s, %.1f x real time\n", counts.frames, seconds, recorded / seconds);
  return true;
}

void print_parameters() {
  std::cout << "| parameter | default | meaning |\n| --- | --- | --- |\n";
  for (const OptionLister::Row& row : list_options()) {
    std::cout << "| `" << row.key << "` | " << row.value << " | " << row.doc << " |\n";
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && std::string(argv[1]) == "--list-parameters") {
    print_parameters();
    return 0;
  }
  Arguments arguments;
  std::string error;
  if (!parse(argc, argv, &arguments, &error)) {
    if (error.empty()) {
      std::cout << kUsage;
      return 0;
    }
    std::cerr << "offline: error: " << error << '\n' << kUsage;
    return 2;
  }
  const std::optional<Inputs> inputs = load(arguments, &error);
  if (inputs) {
    RunRecorder recorder(inputs->classes);
    bool is_done = run(*inputs, &recorder, &error);
    while (inputs->source->needs_rewind() && inputs->source->rewind(&error)) {
      std::printf("the calibration was corrected: from the first image again\n");
      recorder = RunRecorder(inputs->classes);
      is_done = run(*inputs, &recorder, &error);
    }
    if (is_done && recorder.write(arguments.output, &error)) {
      if (inputs->earlier_map) print(recorder.relocalisation());
      error = inputs->source->fault();
      if (error.empty()) return 0;
      error = "the recording ends early: " + error + "; what was mapped is kept";
    }
  }
  std::cerr << "offline: error: " << error << '\n';
  return 1;
}
