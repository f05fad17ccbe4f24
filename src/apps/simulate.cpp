#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "apps/program.h"
#include "apps/tum_bag_writer.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/rendering/rgbd_sequence.h"
#include "tools/simulation/sequence.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string output, camera, classes, bag, bag_compression;
  bool has_images = false, has_bag_images = true;
  int threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  OptionTexts options;
};

/// What the arguments ask for, beside the options.
std::string outputs(const Arguments& arguments) {
  const auto text = [](bool value) { return std::string(value ? "true" : "false"); };
  return "images=" + text(arguments.has_images) + " bag=" + arguments.bag +
         " bag-images=" + text(arguments.has_bag_images) + " bag-compression=" + arguments.bag_compression;
}

/// Whether directory and bag are what the manifest says. A bag that is newer was written again, from other arguments.
bool is_made(const Arguments& arguments, const std::string& manifest) {
  if (!has_rendered_sequence(arguments.output, manifest)) return false;
  std::error_code ignored, missing;
  const auto made = std::filesystem::last_write_time(arguments.output + "/manifest.txt", ignored);
  return arguments.bag.empty() || (std::filesystem::last_write_time(arguments.bag, missing) <= made && !missing);
}

Status write_files(const Arguments& arguments, const SimulationOptions& options, const Camera& camera,
                   const ClassTable& classes) {
  Result<SimulatedSequence> sequence = simulate(options, camera, classes);
  if (!sequence) return sequence.error();
  Status written;
  if (arguments.has_images) {
    written = render_sequence(options, classes, arguments.threads, arguments.output, &*sequence);
  }
  if (written) written = write_sequence(*sequence, classes, arguments.output);
  if (!written) return written;
  semantic_topo_loop::TumBagOptions bag_options;
  bag_options.with_images = arguments.has_bag_images;
  bag_options.compression = arguments.bag_compression;
  bag_options.rendering = options.rendering;
  if (arguments.has_images) bag_options.image_directory = arguments.output;
  if (!arguments.bag.empty()) {
    written = semantic_topo_loop::write_tum_bag(*sequence, arguments.bag, bag_options);
    if (!written) return written;
  }
  std::printf("%zu frames, %zu objects\n", sequence->truth.size(), sequence->scene.objects.size());
  return {};
}

Status run(const Arguments& arguments) {
  const Result<SimulationOptions> options = make_options<SimulationOptions>(arguments.options);
  if (!options) return options.error();
  const Result<Camera> camera = read_camera(arguments.camera);
  if (!camera) return camera.error();
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  const Result<std::string> class_text = read_text_file(arguments.classes);
  if (!class_text) return class_text.error();
  const std::string manifest = sequence_manifest(*options, *camera, *class_text, outputs(arguments));
  if (arguments.has_images && is_made(arguments, manifest)) {
    std::printf("%s is up to date\n", arguments.output.c_str());
    return {};
  }
  // Now, not after hours of work, and before what is there goes.
  Status ready = make_directory(arguments.output);
  if (ready && !arguments.bag.empty()) ready = check_writable(arguments.bag);
  if (ready) ready = begin_sequence(arguments.output, arguments.has_images);
  if (!ready) return ready;
  const Status written = write_files(arguments, *options, *camera, *classes);
  return written && arguments.has_images ? finish_sequence(arguments.output, manifest) : written;
}

Status complete(bool is_for_bags, Arguments* arguments) {
  if (arguments->bag_compression.empty()) arguments->bag_compression = arguments->has_images ? "lz4" : "bz2";
  if (is_for_bags && arguments->bag.empty()) arguments->bag = arguments->output + "/sequence.bag";
  const Status camera = default_to_package("camera/tum_fr2.yaml", "--camera", &arguments->camera);
  return camera ? default_to_package("classes_coco.yaml", "--classes", &arguments->classes) : camera;
}

/// An argument that is short for --set of an option.
auto* option_value(const char* key, OptionTexts* options) {
  return po::value<std::string>()->notifier([options, key](const std::string& given) { (*options)[key] = given; });
}

Value drift(OptionTexts* options) {
  return checked("model:metres:degrees", [options](const std::string& given) {
    const std::vector<std::string_view> parts = split(given, ':');
    if (parts.size() != 3) return false;
    (*options)["drift.model"] = parts[0];
    (*options)["drift.position_m"] = parts[1];
    (*options)["drift.rotation_deg"] = parts[2];
    return true;
  });
}

/// @param is_for_bags whether images and a bag are the default
Command make_command(bool is_for_bags, Arguments* arguments) {
  Command command{
      "",
      "--output DIR [--seed N] [--layout desk|office|house] [--duration S] [--rate HZ]\n"
      "                [--drift smooth|jump:METRES:DEGREES] [--set key=value ...] [--camera YAML] [--classes YAML]\n"
      "                [--images true|false] [--threads N]\n"
      "                [--bag FILE] [--bag-images true|false] [--bag-compression bz2|lz4|none]",
      "Writes a simulated sequence: groundtruth.txt, groundtruth_frames.txt, odometry.txt, detections.json,\n"
      "reference_objects.csv, gone_objects.csv, camera.yaml; with images also rgb/, depth/, rgb.txt, depth.txt and\n"
      "associations.txt. A directory with images that was made from the same options is left as it is. simulate_bag\n"
      "is simulate with images and a bag.\n",
      [arguments] { return run(*arguments); }, [is_for_bags, arguments] { return complete(is_for_bags, arguments); }};
  std::string parameters = "one of these parameters; may be repeated:";
  for (const OptionRow& row : list_options<SimulationOptions>()) {
    parameters += "\n" + row.key + "=" + row.value + "  " + row.meaning;
  }
  OptionTexts* options = &arguments->options;
  command.option("output", path(&arguments->output), "directory, made if missing")
      .option("camera", po::value(&arguments->camera),
              "calibration (default: config/camera/tum_fr2.yaml of the package)")
      .option("classes", po::value(&arguments->classes),
              "class table (default: config/classes_coco.yaml of the package)")
      .option("images", boolean(&arguments->has_images),
              "render color and depth images (default: false; simulate_bag: true)")
      .option("threads", number(&arguments->threads, 1, 256),
              "that render (default: one a processor); the result does not depend on it")
      .option(
          "bag", po::value(&arguments->bag),
          "also write a bag in the TUM layout, with color and depth if there are images, else with tiny gray images "
          "(simulate_bag: DIR/sequence.bag)")
      .option("bag-images", boolean(&arguments->has_bag_images), "false: the bag has camera_info only (default: true)")
      .option("bag-compression", choice(&arguments->bag_compression, {"bz2", "lz4", "none"}),
              "of its chunks (default: bz2 as the official bags; with images lz4, which is about 10 times faster)")
      .option("seed", option_value("simulation.seed", options), "short for --set simulation.seed")
      .option("layout", option_value("scene.layout", options), "short for --set scene.layout")
      .option("duration", option_value("trajectory.duration_s", options), "short for --set trajectory.duration_s")
      .option("rate", option_value("trajectory.rate_hz", options), "short for --set trajectory.rate_hz")
      .option("drift", drift(options), "short for --set of the three main drift parameters")
      .option("set", assignments(options), parameters);
  return command;
}

}  // namespace

/// `simulate` and `simulate_bag`, which differ in what they make if they are not told.
int main(int argc, char** argv) {
  const std::string name = std::filesystem::path(argv[0]).filename();
  const bool is_for_bags = name == "simulate_bag";
  Arguments arguments;
  arguments.has_images = is_for_bags;
  return run_program(
      name,
      {make_command(is_for_bags, &arguments),
       print_command("--list-parameters", "Prints the parameters with their ranges, as a Markdown table.\n",
                     [] { return format_options_table(list_options<SimulationOptions>()); })},
      argc, argv);
}
