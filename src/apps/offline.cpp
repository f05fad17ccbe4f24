#include <cstdio>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "apps/offline_run.h"
#include "apps/package_path.h"
#include "ros/parameters.h"
#include "ros/tum_bag_reader.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/detection_reader.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/io/rgbd_folder.h"
#include "semantic_topo_loop/io/submap_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "tools/evaluation/run_files.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

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
    "Prints every parameter with its default, as a Markdown table.\n"
    "       offline --default-config\n"
    "Prints the defaults as a file for --config.\n"
    "       offline --list-nodelet-parameters\n"
    "Prints what the nodelets have beside these.\n";

struct Arguments {
  std::string trajectory, rgbd, bag, associations, detections, camera, classes, config, extra_loops, output, map,
      save_map, points;
  OptionTexts assignments;
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
  } else {
    return true;
  }
  return false;
}

bool read(CommandLine* line, Arguments* arguments, std::string* error) {
  line->text("--trajectory", &arguments->trajectory);
  line->text("--rgbd", &arguments->rgbd);
  line->text("--bag", &arguments->bag);
  line->text("--associations", &arguments->associations);
  line->text("--detections", &arguments->detections);
  line->required("--camera", &arguments->camera);
  line->text("--classes", &arguments->classes);
  line->text("--config", &arguments->config);
  line->assignments("--set", &arguments->assignments);
  line->text("--extra-loops", &arguments->extra_loops);
  line->required("--output", &arguments->output);
  line->text("--map", &arguments->map);
  line->text("--save-map", &arguments->save_map);
  line->value("--points", "a path that ends in .ply or .pcd", [arguments](const std::string& value) {
    arguments->points = value;
    return value.empty() || is_point_cloud_path(value);
  });
  return line->read(error) && are_complete(*arguments, error) &&
         default_to_package("classes_coco.yaml", "--classes", &arguments->classes, error);
}

/// @return what opens the recording of --bag or --rgbd; null with `error` set
RgbdSource::Open image_opener(const Arguments& arguments, const RunInputs& inputs, std::string* error) {
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

std::unique_ptr<SampleSource> open_source(const Arguments& arguments, const RunInputs& inputs, std::string* error) {
  if (!arguments.trajectory.empty()) {
    std::optional<StampedPoses> trajectory = read_tum_trajectory(arguments.trajectory, error);
    if (!trajectory) return nullptr;
    return std::make_unique<TrajectorySource>(std::move(*trajectory));
  }
  const RgbdSource::Open open_reader = image_opener(arguments, inputs, error);
  if (!open_reader) return nullptr;
  return RgbdSource::open(open_reader, inputs.camera, inputs.options.frontend, error);
}

std::optional<std::vector<DetectionFrame>> load_detections(const std::string& path, const ClassTable& classes,
                                                           std::string* error) {
  DetectionReport report;
  std::optional<std::vector<DetectionFrame>> detections = read_detections(path, classes, &report, error);
  for (const std::string& warning : report.warnings()) std::cerr << "offline: warning: " << warning << '\n';
  return detections;
}

template <class T>
bool take(std::optional<T> read, T* value) {
  if (read) *value = std::move(*read);
  return read.has_value();
}

/// Reads what may be left out.
bool load_optional(const Arguments& arguments, RunInputs* inputs, std::string* error) {
  const ClassTable& classes = *inputs->classes;
  const std::string &detections = arguments.detections, &loops = arguments.extra_loops;
  if (!detections.empty() && !take(load_detections(detections, classes, error), &inputs->detections)) return false;
  if (!loops.empty() && !take(read_given_loops(loops, error), &inputs->extra_loops)) return false;
  if (arguments.map.empty()) return true;
  if (inputs->options.loop.mode != "graph") {
    *error = "argument --map = '" + arguments.map + "' needs loop.mode = graph";
    return false;
  }
  inputs->earlier_map = read_submaps(arguments.map, classes, error);
  return inputs->earlier_map.has_value();
}

std::optional<RunInputs> load(const Arguments& arguments, std::string* error) {
  RunInputs inputs;
  if (!take(load_options(arguments.config, arguments.assignments, error), &inputs.options) ||
      !take(read_camera(arguments.camera, error), &inputs.camera)) {
    return std::nullopt;
  }
  std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  if (!classes) return std::nullopt;
  inputs.classes = std::make_shared<const ClassTable>(std::move(*classes));
  inputs.save_map = arguments.save_map;
  inputs.points = arguments.points;
  inputs.source = open_source(arguments, inputs, error);
  if (!inputs.source || !load_optional(arguments, &inputs, error)) return std::nullopt;
  return inputs;
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

bool run(const Arguments& arguments, std::string* error) {
  const std::optional<RunInputs> inputs = load(arguments, error);
  if (!inputs) return false;
  const std::optional<RunRecorder> recorder = run_chain(*inputs, error);
  if (!recorder || !recorder->write(arguments.output, error)) return false;
  if (inputs->earlier_map) print(recorder->relocalisation());
  const std::string fault = inputs->source->fault();
  if (!fault.empty()) *error = "the recording ends early: " + fault + "; what was mapped is kept";
  return fault.empty();
}

/// Prints a text that needs no other argument.
Command make_printer(std::string name, std::string (*text)()) {
  return {std::move(name), [text](CommandLine* line, std::string* error) {
            if (!line->read(error)) return kBadArguments;
            std::cout << text();
            return 0;
          }};
}

std::string parameter_table() { return format_options_table(list_options<Options>()); }
std::string default_config() { return format_options_yaml(list_options<Options>()); }
std::string nodelet_parameter_table() {
  return format_options_table(semantic_topo_loop::list_nodelet_parameters(), "nodelet");
}

}  // namespace

int main(int argc, char** argv) {
  return run_program(
      "offline", kUsage,
      {make_printer("--list-parameters", parameter_table), make_printer("--default-config", default_config),
       make_printer("--list-nodelet-parameters", nodelet_parameter_table), make_command("", read, run)},
      argc, argv);
}
