#include <unistd.h>

#include <cstdio>
#include <ctime>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "apps/program.h"
#include "apps/sample_source.h"
#include "geometry/up_estimator.h"
#include "odometry/odometry_delay.h"
#include "pipeline/map_state.h"
#include "ros/parameters.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/map_database.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/report/report.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string trajectory, rgbd, bag, associations, detections, camera, classes, config, extra_loops, output, map,
      save_map, points;
  bool frozen = false, report = false;
  std::string truth, reference;  ///< for the report
  OptionTexts assignments;
};

void say(const std::string& warning) { std::cerr << "offline: warning: " << warning << '\n'; }

// --- inputs -------------------------------------------------------------------------------------------------------

/// What a run works on.
struct RunInputs {
  Options options;
  Camera camera;
  std::shared_ptr<const ClassTable> classes;
  std::unique_ptr<SampleSource> source;
  std::vector<DetectionFrame> detections;    ///< as they were recorded
  std::unique_ptr<ObjectDetector> detector;  ///< null: none
  std::vector<LoopClosure> extra_loops;
  std::shared_ptr<const MapState> earlier_map;  ///< null: none
};

/// The poses of --trajectory, or those found from the images of --bag or --rgbd.
Result<std::unique_ptr<SampleSource>> open_source(const Arguments& arguments, const RunInputs& inputs) {
  if (!arguments.trajectory.empty()) {
    Result<StampedPoses> trajectory = read_tum_trajectory(arguments.trajectory);
    if (!trajectory) return trajectory.error();
    return source_of_poses(*std::move(trajectory));
  }
  const bool takes_over = inputs.earlier_map != nullptr && inputs.options.frontend.self_calibration;
  const Camera camera =
      takes_over ? inputs.camera.with_focal_lengths_of(inputs.earlier_map->objects.camera) : inputs.camera;
  const DepthOptions& depth = inputs.options.depth;
  OpenRecording open_recording = [bag = arguments.bag, camera, depth] {
    return semantic_topo_loop::open_tum_bag(bag, camera, depth);
  };
  if (arguments.bag.empty()) {
    const Result<RgbdFiles> read = list_rgbd_images(arguments.rgbd, arguments.associations);
    if (!read) return read.error();
    if (!read->warning.empty()) say(read->warning);
    open_recording = [camera, depth, files = read->files] { return read_images(files, camera, depth); };
  }
  return source_of_images(std::move(open_recording), RgbdFrontend(inputs.options.frontend, camera));
}

/// Reads what may be left out.
Status load_optional(const Arguments& arguments, RunInputs* inputs) {
  if (!arguments.detections.empty()) {
    Result<DetectionRecording> recording = read_detections(
        arguments.detections, *inputs->classes, static_cast<std::size_t>(inputs->options.association.boxes_max));
    if (!recording) return recording.error();
    for (const std::string& warning : recording->report.warnings()) say(warning);
    inputs->detections = std::move(recording->frames);
  }
  if (!inputs->options.detector.model.empty()) {
    if (!arguments.trajectory.empty()) return Error{"detector.model needs images: --rgbd or --bag"};
    if (!arguments.detections.empty()) return Error{"there are both --detections and detector.model"};
    auto detector = ObjectDetector::load(inputs->options.detector, *inputs->classes);
    if (!detector) return detector.error();
    inputs->detector = *std::move(detector);
    if (const std::string& warning = inputs->detector->warning(); !warning.empty()) say(warning);
  }
  if (!arguments.extra_loops.empty()) {
    Result<std::vector<LoopClosure>> loops = read_given_loops(arguments.extra_loops);
    if (!loops) return loops.error();
    inputs->extra_loops = *std::move(loops);
  }
  // Paper mode keeps no submaps to be found by, and looks for none.
  for (const auto& [name, map] : {std::pair("--map", arguments.map), std::pair("--save-map", arguments.save_map)}) {
    if (map.empty() || inputs->options.loop.mode == "graph") continue;
    return Error{std::string("argument ") + name + " = '" + map + "' needs loop.mode = graph"};
  }
  if (!arguments.map.empty()) {
    Result<std::shared_ptr<const MapState>> map = read_map(arguments.map, *inputs->classes);
    if (!map) return map.error();
    inputs->earlier_map = *std::move(map);
    if (arguments.frozen && !arguments.save_map.empty() && is_same_file(arguments.map, arguments.save_map)) {
      return Error{arguments.save_map + ": is the frozen map, which stays as it is: save under another name"};
    }
    const Status has_scale = inputs->earlier_map->check_scale(inputs->options.pose_graph);
    if (!arguments.frozen && !has_scale) return Error{arguments.map + ": " + has_scale.message()};
    if (inputs->earlier_map->submaps.empty()) return Error{arguments.map + ": holds no place to be found at"};
    if (!arguments.frozen && inputs->earlier_map->graph.sessions.empty()) {
      return Error{arguments.map + ": holds submaps only, so that it can only be used with --frozen"};
    }
  }
  return {};
}

Result<RunInputs> load(const Arguments& arguments) {
  const Result<Options> options = load_options(arguments.config, arguments.assignments);
  if (!options) return options.error();
  const Result<Camera> camera = read_camera(arguments.camera);
  if (!camera) return camera.error();
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  RunInputs inputs;
  inputs.options = *options;
  inputs.camera = *camera;
  inputs.classes = std::make_shared<const ClassTable>(*classes);
  if (const Status loaded = load_optional(arguments, &inputs); !loaded) return loaded.error();
  Result<std::unique_ptr<SampleSource>> source = open_source(arguments, inputs);
  if (!source) return source.error();
  inputs.source = *std::move(source);
  return Result<RunInputs>(std::move(inputs));
}

// --- the run ------------------------------------------------------------------------------------------------------

constexpr std::int64_t kStampTolerance_ns = 1000;  ///< stamps of files have microseconds

/// A bar, on a terminal, whenever another percent is done.   @param shown what it showed last
void show_progress(std::size_t done, std::size_t total, int* shown) {
  const int percent = static_cast<int>(100 * done / total);
  if (isatty(STDERR_FILENO) == 0 || percent == *shown) return;
  *shown = percent;
  constexpr int kWidth = 50;
  const std::string bar(static_cast<std::size_t>(percent * kWidth / 100), '#');
  std::fprintf(stderr, "\r[%-*s] %3d %%%s", kWidth, bar.c_str(), percent, done == total ? "\n" : "");
}

/// Hands loops out at their query frames.
class ExtraLoops {
 public:
  /// @param earlier that the run goes on with, empty without: loops may lead into it
  ExtraLoops(const std::vector<LoopClosure>& loops, const std::vector<KeyframePose>& earlier) {
    for (const LoopClosure& loop : loops) loops_.emplace(loop.query_frame, loop);
    for (const KeyframePose& keyframe : earlier) keyframe_of_[keyframe.frame_id] = keyframe.keyframe_id;
  }
  std::vector<LoopClosure> at(const Frame& frame) {
    if (frame.is_keyframe) keyframe_of_[frame.frame_id] = frame.keyframe_id;
    std::vector<LoopClosure> due;
    const auto [begin, end] = loops_.equal_range(frame.frame_id);
    for (auto loop = begin; loop != end; loop = loops_.erase(loop)) {
      due.push_back(loop->second);
      due.back().query_keyframe_id = keyframe(loop->second.query_frame);
      due.back().match_keyframe_id = keyframe(loop->second.match_frame);
    }
    return due;
  }
  /// Those whose query frame never came.
  std::size_t left() const { return loops_.size(); }

 private:
  /// -1 where there is none: the pose graph refuses such a loop.
  std::int64_t keyframe(std::int64_t frame_id) const {
    const auto found = keyframe_of_.find(frame_id);
    return found == keyframe_of_.end() ? -1 : found->second;
  }
  std::multimap<std::int64_t, LoopClosure> loops_;  ///< by query frame, in the order given
  std::map<std::int64_t, std::int64_t> keyframe_of_;
};

/// Knows what is in the images of a run: from the recorded detections, or from the detector.
class DetectionSource {
 public:
  explicit DetectionSource(const RunInputs& inputs) : inputs_(&inputs), up_(inputs.options.loop.up_window_s) {}

  /// Of the next frame.   @return nullptr if nobody looked at its image
  Result<const std::vector<Detection>*> next(const Frame& frame) {
    using Found = Result<const std::vector<Detection>*>;
    if (inputs_->detector == nullptr) {
      const DetectionFrame* recorded = find_stamp(inputs_->detections, frame.stamp_ns, kStampTolerance_ns);
      return Found(recorded != nullptr ? &recorded->detections : nullptr);
    }
    up_.push(frame);
    if (!inputs_->detector->is_due(frame.stamp_ns)) return Found(nullptr);
    const Result<cv::Mat> color = inputs_->source->color();
    if (!color) return color.error();
    const Result<std::vector<Detection>> boxes = inputs_->detector->detect(*color, up_.roll_rad(frame.T_odom_camera.q));
    if (!boxes) return boxes.error();
    const auto leave_out = [&](std::size_t, DetectionProblem problem, const std::string& value) {
      report_.add(problem, "stamp " + format_stamp(frame.stamp_ns) + ": " + value);
    };
    found_ = usable_boxes(*boxes, *inputs_->classes, static_cast<std::size_t>(inputs_->options.association.boxes_max),
                          leave_out);
    return Found(&found_);
  }
  std::vector<std::string> warnings() const { return report_.warnings(); }

 private:
  const RunInputs* inputs_;
  UpEstimator up_;
  std::vector<Detection> found_;  ///< in the last image
  DetectionReport report_;
};

/// What a run went through.
struct Counts {
  std::size_t frames = 0;
  std::size_t with_detections = 0;
  std::size_t held = 0;  ///< images left out, see FrameBuilder::is_held
  std::int64_t first_ns = 0, last_ns = 0;
};

void warn(const RunInputs& inputs, const Counts& counts, std::size_t loops_left) {
  const std::size_t images = inputs.detections.size();
  if ((images > 0 || inputs.detector != nullptr) && counts.with_detections < counts.frames) {
    say(std::to_string(counts.frames - counts.with_detections) + " of " + std::to_string(counts.frames) +
        " frames have no detections");
  }
  if (loops_left > 0) say(std::to_string(loops_left) + " extra loops have a query frame that never came");
  if (counts.held > 0) {
    say(std::to_string(counts.held) + " images between the poses of a slower odometry were left out");
  }
  if (counts.with_detections + counts.held < images) {
    say(std::to_string(images - counts.with_detections - counts.held) + " of " + std::to_string(images) +
        " images with detections have no pose and were left out");
  }
  const SourceState& source = inputs.source->state();
  for (const std::string& text : {source.warning, source.report ? source.report->warning() : "",
                                  source.depth_range.warning(inputs.options.depth)}) {
    if (!text.empty()) say(text);
  }
}

/// Whether the detections, if there are any, are of this recording: some frame had its own.
bool are_of_one_recording(const RunInputs& inputs, const Counts& counts) {
  return counts.with_detections > 0 || inputs.detections.empty();
}

/// An error if there were no frames, or no detections that belong to them although there are some.
Status check_input(const RunInputs& inputs, const Counts& counts) {
  if (counts.frames == 0) {
    const SourceState& source = inputs.source->state();
    if (!source.fault.empty()) return Error{source.fault};
    const std::string depth = source.depth_range.warning(inputs.options.depth);
    return Error{"no image has a pose" + (source.report ? ": " + source.report->warning() : std::string()) +
                 (depth.empty() ? "" : "; " + depth)};
  }
  if (are_of_one_recording(inputs, counts)) return {};
  return Error{"no detection has the stamp of a pose: the first of each are " + std::to_string(counts.first_ns) +
               " ns (pose) and " + std::to_string(inputs.detections.front().stamp_ns) + " ns (detection)"};
}

struct ChainResult {
  std::unique_ptr<RunRecorder> recorder;
  Status files;  ///< whether the map and its points could be written
};

/// Puts every image of the source through the chain.
/// @return an error if the inputs have no frame in common. If the source needs to be rewound the result means nothing
Status run_once(const Arguments& arguments, const RunInputs& inputs, ChainResult* chain) {
  RunRecorder* const recorder = chain->recorder.get();
  if (inputs.detector) inputs.detector->restart();
  ObjectSlam slam(inputs.options, inputs.classes);
  FrameBuilder builder(inputs.options.keyframe, inputs.camera);
  PointMap point_map(inputs.options.point_map);
  if (inputs.earlier_map != nullptr) {
    if (arguments.frozen) {
      slam.set_earlier_map(inputs.earlier_map->submaps_in_unit());
    } else {
      recorder->record(slam.restore(*inputs.earlier_map));
      restore_points(*inputs.earlier_map, &point_map);
      const GraphState& graph = inputs.earlier_map->graph;
      builder.count_from(graph.next_frame_id, graph.next_keyframe_id());
    }
  }
  std::optional<MapDatabase> database;
  if (!arguments.save_map.empty()) {
    database.emplace(arguments.save_map, inputs.classes, format_options_yaml(list_options(inputs.options)),
                     arguments.frozen ? std::string() : arguments.map);
  }
  std::vector<PointsOfKeyframe> new_points;
  const auto save = [&] {
    const auto points = std::make_shared<MapDelta>();
    points->points = std::exchange(new_points, {});
    database->write({slam.take_delta(), points});
  };
  SavePoints save_points;
  const bool goes_on = inputs.earlier_map && !arguments.frozen;
  ExtraLoops extra_loops(inputs.extra_loops,
                         goes_on ? inputs.earlier_map->keyframe_poses() : std::vector<KeyframePose>());
  DetectionSource detection_source(inputs);
  const auto take = [&](const Frame& frame, const FrameResult& result) {
    point_map.apply(result.correction);
    record(frame, result, recorder);
  };
  const SourceState& source = inputs.source->state();
  Counts counts;
  int shown_percent = -1;
  const Stopwatch stopwatch;
  const std::clock_t before = std::clock();
  while (const std::optional<PoseSample> sample = inputs.source->next()) {
    if (source.camera) builder.set_camera(*source.camera);
    if (builder.is_held(*sample)) {
      ++counts.held;
      continue;
    }
    Result<Frame> frame = builder.build(*sample);
    if (!frame) return frame.error();
    if (frame->is_keyframe && (database || !arguments.points.empty())) {
      frame->keyframe_points = inputs.source->keyframe_points(inputs.options.point_map.semi_dense_max);
    }
    if (database && frame->keyframe_points) {
      const auto points = std::make_shared<KeyframePoints>(reduced(*frame->keyframe_points, inputs.options.point_map));
      new_points.push_back({frame->keyframe_id, points});
    }
    const Result<const std::vector<Detection>*> detections = detection_source.next(*frame);
    if (!detections) return detections.error();
    if (*detections != nullptr) ++counts.with_detections;
    point_map.add(*frame);
    take(*frame, slam.process(*frame, *detections, extra_loops.at(*frame)));
    // What another recording's detections make must not take a map's place.
    const bool may_save = database && are_of_one_recording(inputs, counts);
    if (may_save && save_points.is_due(frame->stamp_ns) && !database->is_behind()) save();
    if (counts.frames++ == 0) counts.first_ns = frame->stamp_ns;
    counts.last_ns = frame->stamp_ns;
    show_progress(source.done, source.total, &shown_percent);
  }
  if (source.needs_rewind) return {};
  if (const Status checked = check_input(inputs, counts); !checked) return checked;
  const Stopwatch end_stopwatch;
  const Frame end = builder.end();
  take(end, slam.process(end, nullptr));
  const double end_s = 1e-6 * end_stopwatch.elapsed_us();
  if (source.report) recorder->record(*source.report);
  // What one file cannot take the others still get.
  if (!arguments.points.empty()) chain->files = write_point_cloud(arguments.points, point_map.points());
  if (database) {
    save();
    if (const Status closed = database->close(); chain->files) chain->files = closed;
  }

  const double seconds = 1e-6 * stopwatch.elapsed_us();
  const double processor_ms = 1e3 * static_cast<double>(std::clock() - before) / CLOCKS_PER_SEC;  // of all threads
  const double recorded = 1e-9 * static_cast<double>(counts.last_ns - counts.first_ns);
  for (const std::string& warning : detection_source.warnings()) say(warning);
  warn(inputs, counts, extra_loops.left());
  if (const std::string delay = describe_delay(slam.loop_detector().odometry_delay_s()); !delay.empty()) say(delay);
  std::printf("%zu frames in %.2f s, %.1f x real time, %.1f ms of processor time a frame; the end took %.2f s\n",
              counts.frames, seconds, recorded / seconds, processor_ms / static_cast<double>(counts.frames), end_s);
  return {};
}

/// From the first image again if the source corrects its calibration.
Result<ChainResult> run_chain(const Arguments& arguments, const RunInputs& inputs) {
  for (;;) {
    ChainResult chain{make_run_recorder(inputs.classes, arguments.output), {}};
    const Status done = run_once(arguments, inputs, &chain);
    if (!inputs.source->state().needs_rewind) {
      if (!done) return done.error();
      return chain;
    }
    if (const Status rewound = inputs.source->rewind(); !rewound) return rewound.error();
    std::printf("the calibration was corrected: from the first image again\n");
  }
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

void print(const std::optional<JoinedMap>& joined) {
  if (!joined) {
    std::printf("not found in the earlier map: the run stands beside it\n");
    return;
  }
  std::printf("joined the earlier map after %.1f s, by %d loops\n", joined->after_s, joined->loops);
}

Status run(const Arguments& arguments) {
  const Result<RunInputs> inputs = load(arguments);
  if (!inputs) return inputs.error();
  // Now, not after hours of work.
  if (!arguments.truth.empty()) {
    if (const auto truth = read_tum_ground_truth(arguments.truth); !truth) return truth.error();
  }
  if (!arguments.reference.empty()) {
    if (const auto references = read_reference_objects(arguments.reference); !references) return references.error();
  }
  for (const std::string& input : {arguments.trajectory, arguments.detections, arguments.associations,
                                   arguments.extra_loops, arguments.truth, arguments.reference}) {
    if (input.empty()) continue;
    if (const Status survives = check_survives_run(input, arguments.output); !survives) return survives;
  }
  Status writable = make_directory(arguments.output);
  for (const std::string& path : {arguments.output + "/", arguments.save_map, arguments.points}) {
    if (writable && !path.empty()) writable = check_writable(path);
  }
  if (writable && !arguments.save_map.empty()) writable = check_map_place(arguments.save_map);
  if (!writable) return writable;
  const Result<ChainResult> chain = run_chain(arguments, *inputs);
  if (!chain) return chain.error();
  const RunRecorder& recorder = *chain->recorder;
  if (const Status written = recorder.write(arguments.output); !written) return written;
  if (!chain->files) return chain->files;
  if (arguments.report) {
    const bool is_free = inputs->options.pose_graph.scale == "free";
    const Status written = write_report(
        {arguments.output, arguments.trajectory, arguments.truth, arguments.reference, is_free, std::nullopt});
    if (!written) return written;
  }
  if (inputs->earlier_map != nullptr) {
    if (arguments.frozen) {
      print(recorder.relocalisation());
    } else {
      print(recorder.joined_map());
    }
  }
  const std::string& fault = inputs->source->state().fault;
  if (fault.empty()) return {};
  return Error{"the recording ends early: " + fault + "; what was mapped is kept"};
}

// --- command line -------------------------------------------------------------------------------------------------

/// Whether the arguments that belong together are there.
Status check(Arguments* arguments) {
  const int sources = !arguments->trajectory.empty() + !arguments->rgbd.empty() + !arguments->bag.empty();
  if (sources != 1) return Error{"one of the arguments --trajectory, --rgbd and --bag is needed"};
  if (arguments->detections.empty() && !arguments->trajectory.empty()) {
    return Error{"argument --detections is missing"};
  }
  if (!arguments->associations.empty() && arguments->rgbd.empty()) return Error{"argument --associations needs --rgbd"};
  if (arguments->frozen && arguments->map.empty()) return Error{"argument --frozen needs --map"};
  if (!arguments->points.empty() && !arguments->trajectory.empty()) {
    return Error{"argument --points needs --rgbd or --bag"};
  }
  if (!arguments->truth.empty() && !arguments->report) return Error{"argument --groundtruth needs --report"};
  if (!arguments->reference.empty() && arguments->truth.empty()) {
    return Error{"argument --reference needs --groundtruth"};
  }
  return default_to_package("classes_coco.yaml", "--classes", &arguments->classes);
}

Command run_command(Arguments* arguments) {
  Command command{"",
                  "--trajectory FILE --detections FILE_OR_DIR --camera YAML --output DIR\n"
                  "               [--classes YAML] [--config YAML] [--set module.field=value ...]\n"
                  "               [--extra-loops CSV] [--map FILE [--frozen]] [--save-map FILE]\n"
                  "               [--report [--groundtruth FILE [--reference CSV]]]\n"
                  "       offline --rgbd DIR --camera YAML --output DIR [--associations FILE]\n"
                  "               [--detections FILE_OR_DIR | --detector ONNX] [--points FILE] ...\n"
                  "       offline --bag FILE --camera YAML --output DIR [--detections FILE_OR_DIR | --detector ONNX]\n"
                  "               [--points FILE] ...",
                  "Runs the whole chain on recorded files, without a ROS master.\n",
                  [arguments] { return run(*arguments); }, [arguments] { return check(arguments); }};
  const auto take_points = [arguments](const std::string& given) {
    arguments->points = given;
    return given.empty() || is_point_cloud_path(given);
  };
  const auto take_model = [arguments](const std::string& given) {
    arguments->assignments["detector.model"] = given;
    return !given.empty();
  };
  command
      .option("trajectory", po::value(&arguments->trajectory),
              "camera poses of the odometry, TUM format; one frame a pose")
      .option("rgbd", po::value(&arguments->rgbd),
              "folder of color and depth images: the odometry is found from them; see depth.* and frontend.*")
      .option("bag", po::value(&arguments->bag), "the same from a bag in the layout of the TUM RGB-D bags")
      .option("associations", po::value(&arguments->associations),
              "which depth belongs to which color image (default: associations.txt of the folder; without it, rgb.txt "
              "and depth.txt are joined)")
      .option("detections", po::value(&arguments->detections),
              "JSON file as OA-SLAM's or COCO's results, or directory of YOLO text files <stamp>.txt; with --rgbd and "
              "--bag they may be left "
              "out: odometry only")
      .option("detector", checked("an ONNX file", take_model),
              "with --rgbd and --bag: the network that finds the objects in the images; see detector.*")
      .option("camera", path(&arguments->camera), "calibration, see config/camera")
      .option("classes", po::value(&arguments->classes),
              "class table (default: config/classes_coco.yaml of the package)")
      .option("config", po::value(&arguments->config),
              "parameters (default: the built-in ones, those of config/default.yaml)")
      .option("set", assignments(&arguments->assignments), "one parameter, over --config; may be repeated")
      .option("extra-loops", po::value(&arguments->extra_loops),
              "loops for the pose graph beside those that are found, as loops.csv, see docs/files.md")
      .option("output", path(&arguments->output), "directory of the results, made if missing")
      .option("map", po::value(&arguments->map),
              "map that earlier runs saved: this run goes on with it, as a further session")
      .option("frozen", po::bool_switch(&arguments->frozen),
              "the run's place in the map is looked for, and the map stays as it is")
      .option("save-map", po::value(&arguments->save_map),
              "file for the map, written twice a second of the recording, for later runs")
      .option("points", checked("a path that ends in .ply or .pcd", take_points),
              "with --rgbd and --bag: file for the map's points")
      .option("report", po::bool_switch(&arguments->report), "writes report.html into the output, as `report` does")
      .option("groundtruth", po::value(&arguments->truth), "with --report: true trajectory, TUM format")
      .option("reference", po::value(&arguments->reference), "with --groundtruth: reference objects");
  return command;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  return run_program(
      "offline",
      {run_command(&arguments),
       print_command("--list-parameters", "Prints every parameter with its default, as a Markdown table.\n",
                     [] { return format_options_table(list_options<Options>()); }),
       print_command("--default-config", "Prints the defaults as a file for --config.\n",
                     [] { return format_options_yaml(list_options<Options>()); }),
       print_command("--list-nodelet-parameters", "Prints what the nodelets have beside these.\n",
                     [] { return format_options_table(semantic_topo_loop::list_nodelet_parameters(), "nodelet"); })},
      argc, argv);
}
