#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include "apps/command_line.h"
#include "apps/package_path.h"
#include "apps/tum_bag_writer.h"
#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/io/options_yaml.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/rendering/rgbd_sequence.h"
#include "tools/simulation/sequence.h"

namespace {

using namespace semantic_topo_loop::apps;
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
    "  --set         one of the parameters below; may be repeated\n"
    "With --list-parameters alone, a table of these with their ranges is printed.\n";

struct Arguments {
  std::string output, camera, classes, bag, bag_compression;
  bool has_images = kWithImages, has_bag_images = true;
  int threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  OptionTexts options;
};

std::string usage() {
  std::string text = std::string("usage: ") + kName + kUsage;
  for (const OptionRow& row : list_options<SimulationOptions>())
    text += "    " + row.key + "=" + row.value + "  " + row.meaning + "\n";
  return text;
}

/// @return false unless the value is "model:metres:degrees"
bool set_drift(const std::string& value, OptionTexts* options) {
  const std::vector<std::string_view> parts = split(value, ':');
  if (parts.size() != 3) return false;
  (*options)["drift.model"] = parts[0];
  (*options)["drift.position_m"] = parts[1];
  (*options)["drift.rotation_deg"] = parts[2];
  return true;
}

/// Arguments that are short for --set.
void add_options(CommandLine* line, OptionTexts* options) {
  for (const auto& [name, key] :
       {std::pair("--seed", "simulation.seed"), std::pair("--layout", "scene.layout"),
        std::pair("--duration", "trajectory.duration_s"), std::pair("--rate", "trajectory.rate_hz")}) {
    line->value(name, "a text", [options, key = key](const std::string& value) {
      (*options)[key] = value;
      return true;
    });
  }
  line->value("--drift", "model:metres:degrees",
              [options](const std::string& value) { return set_drift(value, options); });
  line->assignments("--set", options);
}

bool read(CommandLine* line, Arguments* arguments, std::string* error) {
  line->required("--output", &arguments->output);
  line->text("--camera", &arguments->camera);
  line->text("--classes", &arguments->classes);
  line->boolean("--images", &arguments->has_images);
  line->integer("--threads", &arguments->threads, 1, 256);
  line->text("--bag", &arguments->bag);
  line->boolean("--bag-images", &arguments->has_bag_images);
  line->choice("--bag-compression", {"bz2", "lz4", "none"}, &arguments->bag_compression);
  add_options(line, &arguments->options);
  if (!line->read(error)) return false;
  if (arguments->bag_compression.empty()) arguments->bag_compression = arguments->has_images ? "lz4" : "bz2";
  if (kWithImages && arguments->bag.empty()) arguments->bag = arguments->output + "/sequence.bag";
  return default_to_package("camera/tum_fr2.yaml", "--camera", &arguments->camera, error) &&
         default_to_package("classes_coco.yaml", "--classes", &arguments->classes, error);
}

/// What the arguments ask for, beside the options.
std::string outputs(const Arguments& arguments) {
  const auto text = [](bool value) { return std::string(value ? "true" : "false"); };
  return "images=" + text(arguments.has_images) + " bag=" + arguments.bag +
         " bag-images=" + text(arguments.has_bag_images) + " bag-compression=" + arguments.bag_compression;
}

bool is_made(const Arguments& arguments, const std::string& manifest) {
  const std::optional<std::string> there = read_text_file(arguments.output + "/manifest.txt", nullptr);
  return there == manifest && (arguments.bag.empty() || std::filesystem::exists(arguments.bag));
}

bool write_files(const Arguments& arguments, const SimulationOptions& options, const Camera& camera,
                 const ClassTable& classes, std::string* error) {
  std::optional<SimulatedSequence> sequence = simulate(options, camera, classes, error);
  if (!sequence) return false;
  if (arguments.has_images &&
      !render_sequence(options, classes, arguments.threads, arguments.output, &*sequence, error)) {
    return false;
  }
  if (!write_sequence(*sequence, classes, arguments.output, error)) return false;
  semantic_topo_loop::TumBagOptions bag_options;
  bag_options.with_images = arguments.has_bag_images;
  bag_options.compression = arguments.bag_compression;
  bag_options.rendering = options.rendering;
  if (arguments.has_images) bag_options.image_directory = arguments.output;
  if (!arguments.bag.empty() && !semantic_topo_loop::write_tum_bag(*sequence, arguments.bag, bag_options, error)) {
    return false;
  }
  std::printf("%zu frames, %zu objects\n", sequence->truth.size(), sequence->scene.objects.size());
  return true;
}

bool run(const Arguments& arguments, std::string* error) {
  const Result<SimulationOptions> options = make_options<SimulationOptions>(arguments.options);
  if (!options) {
    *error = options.message();
    return false;
  }
  const std::optional<Camera> camera = read_camera(arguments.camera, error);
  if (!camera) return false;
  const std::optional<ClassTable> classes = read_class_table(arguments.classes, error);
  const std::optional<std::string> class_text = classes ? read_text_file(arguments.classes, error) : std::nullopt;
  if (!class_text) return false;
  const std::string manifest = sequence_manifest(*options, *camera, *class_text, outputs(arguments));
  if (arguments.has_images && is_made(arguments, manifest)) {
    std::printf("%s is up to date\n", arguments.output.c_str());
    return true;
  }
  // Without its manifest a directory that is only half made is not taken for whole.
  std::error_code ignored;
  std::filesystem::remove(arguments.output + "/manifest.txt", ignored);
  if (!write_files(arguments, *options, *camera, *classes, error)) return false;
  return !arguments.has_images || write_text_file(arguments.output + "/manifest.txt", manifest, error);
}

int list_parameters(CommandLine* line, std::string* error) {
  if (!line->read(error)) return kBadArguments;
  std::cout << format_options_table(list_options<SimulationOptions>());
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return run_program(kName, usage(), {{"--list-parameters", list_parameters}, make_command("", read, run)}, argc, argv);
}
