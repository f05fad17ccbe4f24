#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "package_path.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/pipeline/option_visitor.h"
#include "semantic_topo_loop/ros/tum_bag_writer.h"
#include "semantic_topo_loop/simulation/rgbd_sequence.h"
#include "semantic_topo_loop/simulation/sequence.h"

namespace {

using namespace semantic_topo_loop::core;

// simulate_bag is this program with images and a bag asked for.
#ifdef STL_SIMULATE_BAG
constexpr char kName[] = "simulate_bag";
constexpr bool kWithImages = true;
#else
constexpr char kName[] = "simulate";
constexpr bool kWithImages = false;
#endif

constexpr char kUsage[] =
    " --output DIR [--seed N] [--layout desk|office] [--duration S] [--rate HZ]\n"
    "                [--drift smooth|jump:METRES:DEGREES] [--set key=value ...] [--camera YAML] [--classes YAML]\n"
    "                [--images true|false] [--threads N]\n"
    "                [--bag FILE] [--bag-images true|false] [--bag-compression bz2|lz4|none]\n"
    "Writes a simulated sequence: groundtruth.txt, groundtruth_frames.txt, odometry.txt, detections.json,\n"
    "reference_objects.csv, gone_objects.csv, camera.yaml; with images also rgb/, depth/, rgb.txt, depth.txt and\n"
    "associations.txt. A directory with images that was made from the same options is left as it is.\n"
    "  --images      render colour and depth images (default: false; simulate_bag: true)\n"
    "  --threads     that render (default: one a processor); the result does not depend on it\n"
    "  --camera      calibration (default: config/camera/tum_fr2.yaml of the package)\n"
    "  --classes     class table (default: config/classes_coco.yaml of the package)\n"
    "  --bag         also write a bag in the TUM layout, with colour and depth if there are images, else with tiny "
    "grey\n"
    "                images (simulate_bag: DIR/sequence.bag); --bag-images false: camera_info only\n"
    "  --bag-compression  of its chunks (default: bz2 as the official bags; with images lz4, which is 20 times "
    "faster)\n"
    "  --set         one of the parameters below; may be repeated\n";

struct Arguments {
  std::string output, camera, classes, bag;
  std::string bag_images = "true";
  std::string images = kWithImages ? "true" : "false";
  std::string threads, bag_compression;
  OptionTexts options;
};

std::string usage() {
  SimulationOptions defaults;
  OptionLister lister;
  defaults.visit(lister);
  std::string text = std::string("usage: ") + kName + kUsage;
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
  const std::map<std::string, std::string*> paths = {
      {"--output", &arguments->output},         {"--camera", &arguments->camera},
      {"--classes", &arguments->classes},       {"--bag", &arguments->bag},
      {"--bag-images", &arguments->bag_images}, {"--bag-compression", &arguments->bag_compression},
      {"--images", &arguments->images},         {"--threads", &arguments->threads}};
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

bool one_of(const char* argument, const std::string& value, const std::vector<std::string>& values,
            std::string* error) {
  std::string listed;
  for (const std::string& allowed : values) {
    if (value == allowed) return true;
    listed += (listed.empty() ? "" : allowed == values.back() ? " or " : ", ") + allowed;
  }
  *error = std::string("argument ") + argument + " '" + value + "' must be " + listed;
  return false;
}

bool default_threads(std::string* threads, std::string* error) {
  if (threads->empty()) *threads = std::to_string(std::max(1U, std::thread::hardware_concurrency()));
  const std::optional<std::int64_t> count = parse_integer(*threads);
  if (count && *count >= 1 && *count <= 256) return true;
  *error = "argument --threads '" + *threads + "' must be a number in [1, 256]";
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
  if (!one_of("--bag-images", arguments->bag_images, {"true", "false"}, error) ||
      !one_of("--images", arguments->images, {"true", "false"}, error) ||
      !default_threads(&arguments->threads, error)) {
    return false;
  }
  const bool has_images = arguments->images == "true";
  if (arguments->bag_compression.empty()) arguments->bag_compression = has_images ? "lz4" : "bz2";
  if (kWithImages && arguments->bag.empty()) arguments->bag = arguments->output + "/sequence.bag";
  return one_of("--bag-compression", arguments->bag_compression, {"bz2", "lz4", "none"}, error) &&
         default_to_package("camera/tum_fr2.yaml", "--camera", &arguments->camera, error) &&
         default_to_package("classes_coco.yaml", "--classes", &arguments->classes, error);
}

/// What the arguments ask for, beside the options.
std::string outputs(const Arguments& arguments) {
  return "images=" + arguments.images + " bag=" + arguments.bag + " bag-images=" + arguments.bag_images +
         " bag-compression=" + arguments.bag_compression;
}

bool is_made(const Arguments& arguments, const std::string& manifest) {
  const std::optional<std::string> there = read_text_file(arguments.output + "/manifest.txt", nullptr);
  return there == manifest && (arguments.bag.empty() || std::filesystem::exists(arguments.bag));
}

bool write_files(const Arguments& arguments, const SimulationOptions& options, const Camera& camera,
                 const ClassTable& classes, std::string* error) {
  const bool has_images = arguments.images == "true";
  std::optional<SimulatedSequence> sequence = simulate(options, camera, classes, error);
  if (!sequence) return false;
  const int threads = std::stoi(arguments.threads);
  if (has_images && !render_sequence(options, classes, threads, arguments.output, &*sequence, error)) return false;
  if (!write_sequence(*sequence, classes, arguments.output, error)) return false;
  semantic_topo_loop::TumBagOptions bag_options;
  bag_options.with_images = arguments.bag_images == "true";
  bag_options.compression = arguments.bag_compression;
  bag_options.rendering = options.rendering;
  if (has_images) bag_options.image_directory = arguments.output;
  if (!arguments.bag.empty() && !semantic_topo_loop::write_tum_bag(*sequence, arguments.bag, bag_options, error)) {
    return false;
  }
  std::printf("%zu frames, %zu objects\n", sequence->truth.size(), sequence->scene.objects.size());
  return true;
}

bool run(const Arguments& arguments, std::string* error) {
  const std::optional<SimulationOptions> options = make_simulation_options(arguments.options, error);
  if (!options) return false;
  const std::optional<Camera> camera = read_camera(arguments.camera, error);
  if (!camera) return false;
  const std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  const std::optional<std::string> class_text = classes ? read_text_file(arguments.classes, error) : std::nullopt;
  if (!class_text) return false;
  const std::string manifest = sequence_manifest(*options, *camera, *class_text, outputs(arguments));
  const bool has_images = arguments.images == "true";
  if (has_images && is_made(arguments, manifest)) {
    std::printf("%s is up to date\n", arguments.output.c_str());
    return true;
  }
  // Without its manifest a directory that is only half made is not taken for whole.
  std::error_code ignored;
  std::filesystem::remove(arguments.output + "/manifest.txt", ignored);
  if (!write_files(arguments, *options, *camera, *classes, error)) return false;
  return !has_images || write_text_file(arguments.output + "/manifest.txt", manifest, error);
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
    std::cerr << kName << ": error: " << error << " (try --help)\n";
    return 2;
  }
  if (run(arguments, &error)) return 0;
  std::cerr << kName << ": error: " << error << '\n';
  return 1;
}
