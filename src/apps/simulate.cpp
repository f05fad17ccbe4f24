#include <cstdio>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "package_path.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "semantic_topo_loop/pipeline/option_visitor.h"
#include "semantic_topo_loop/ros/tum_bag_writer.h"
#include "semantic_topo_loop/simulation/sequence.h"

namespace {

using namespace semantic_topo_loop::core;

constexpr char kUsage[] =
    "usage: simulate --output DIR [--seed N] [--layout desk|office] [--duration S] [--rate HZ]\n"
    "                [--drift smooth|jump:METRES:DEGREES] [--set key=value ...] [--camera YAML] [--classes YAML]\n"
    "                [--bag FILE] [--bag-images true|false]\n"
    "Writes a simulated sequence: groundtruth.txt, groundtruth_frames.txt, odometry.txt, detections.json,\n"
    "reference_objects.csv, gone_objects.csv, camera.yaml.\n"
    "  --camera      calibration (default: config/camera/tum_fr2.yaml of the package)\n"
    "  --classes     class table (default: config/classes_coco.yaml of the package)\n"
    "  --bag         also write a bag in the TUM layout; --bag-images false: camera_info only\n"
    "  --set         one of the parameters below; may be repeated\n";

struct Arguments {
  std::string output, camera, classes, bag;
  std::string bag_images = "true";
  OptionTexts options;
};

std::string usage() {
  SimulationOptions defaults;
  OptionLister lister;
  defaults.visit(lister);
  std::string text = kUsage;
  for (const OptionLister::Row& row : lister.rows) text += "    " + row.key + "=" + row.value + "  " + row.doc + "\n";
  return text;
}

/// "model:metres:degrees"
bool set_drift(const std::string& value, OptionTexts* options, std::string* error) {
  const std::size_t first = value.find(':');
  const std::size_t second = first == std::string::npos ? first : value.find(':', first + 1);
  if (second == std::string::npos) {
    *error = "argument --drift '" + value + "' is not model:metres:degrees";
    return false;
  }
  (*options)["drift.model"] = value.substr(0, first);
  (*options)["drift.position_m"] = value.substr(first + 1, second - first - 1);
  (*options)["drift.rotation_deg"] = value.substr(second + 1);
  return true;
}

/// @return false with `error` set if the argument is unknown or its value of the wrong shape
bool take(const std::string& name, const std::string& value, Arguments* arguments, std::string* error) {
  const std::map<std::string, std::string*> paths = {{"--output", &arguments->output},
                                                     {"--camera", &arguments->camera},
                                                     {"--classes", &arguments->classes},
                                                     {"--bag", &arguments->bag},
                                                     {"--bag-images", &arguments->bag_images}};
  const std::map<std::string, std::string> keys = {{"--seed", "simulation.seed"},
                                                   {"--layout", "scene.layout"},
                                                   {"--duration", "trajectory.duration_s"},
                                                   {"--rate", "trajectory.rate_hz"}};
  if (name == "--set") return set_option_text(value, &arguments->options, error);
  if (name == "--drift") return set_drift(value, &arguments->options, error);
  if (const auto path = paths.find(name); path != paths.end()) {
    *path->second = value;
    return true;
  }
  if (const auto key = keys.find(name); key != keys.end()) {
    arguments->options[key->second] = value;
    return true;
  }
  *error = "unknown argument '" + name + "'";
  return false;
}

bool default_to_package(const std::string& file, const char* argument, std::string* path, std::string* error) {
  if (path->empty()) *path = semantic_topo_loop::apps::config_file(file);
  if (!path->empty()) return true;
  *error = std::string("the package is not on ROS_PACKAGE_PATH: pass ") + argument;
  return false;
}

/// @return false with `error` set; an empty error means that help was asked for
bool parse(int argc, char** argv, Arguments* arguments, std::string* error) {
  for (int i = 1; i < argc; i += 2) {
    const std::string name = argv[i];
    if (name == "--help" || name == "-h") return false;
    if (i + 1 == argc) {
      *error = "argument '" + name + "' is unknown or lacks its value";
      return false;
    }
    if (!take(name, argv[i + 1], arguments, error)) return false;
  }
  if (arguments->output.empty()) {
    *error = "argument --output is missing";
    return false;
  }
  if (arguments->bag_images != "true" && arguments->bag_images != "false") {
    *error = "argument --bag-images '" + arguments->bag_images + "' must be true or false";
    return false;
  }
  return default_to_package("camera/tum_fr2.yaml", "--camera", &arguments->camera, error) &&
         default_to_package("classes_coco.yaml", "--classes", &arguments->classes, error);
}

bool run(const Arguments& arguments, std::string* error) {
  const std::optional<SimulationOptions> options = make_simulation_options(arguments.options, error);
  if (!options) return false;
  const std::optional<Camera> camera = read_camera(arguments.camera, error);
  if (!camera) return false;
  const std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  if (!classes) return false;
  const std::optional<SimulatedSequence> sequence = simulate(*options, *camera, *classes, error);
  if (!sequence || !write_sequence(*sequence, *classes, arguments.output, error)) return false;
  semantic_topo_loop::TumBagOptions bag_options;
  bag_options.with_images = arguments.bag_images == "true";
  if (!arguments.bag.empty() && !semantic_topo_loop::write_tum_bag(*sequence, arguments.bag, bag_options, error)) {
    return false;
  }
  std::printf("%zu frames, %zu objects\n", sequence->truth.size(), sequence->scene.objects.size());
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  std::string error;
  if (!parse(argc, argv, &arguments, &error)) {
    if (error.empty()) {
      std::cout << usage();
      return 0;
    }
    std::cerr << "simulate: error: " << error << " (try --help)\n";
    return 2;
  }
  if (run(arguments, &error)) return 0;
  std::cerr << "simulate: error: " << error << '\n';
  return 1;
}
