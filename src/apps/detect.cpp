#include <cstdio>
#include <string>

#include "apps/image_detections.h"
#include "apps/program.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/stamp.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string images, model, out, classes;
  OptionTexts assignments;
};

Status run(const Arguments& arguments) {
  OptionTexts texts = arguments.assignments;
  texts["detector.model"] = arguments.model;
  const Result<ObjectDetectorOptions> options = make_options<ObjectDetectorOptions>(texts);
  if (!options) return options.error();
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  const auto detector = ObjectDetector::load(*options, *classes);
  if (!detector) return detector.error();
  if (const Status writable = check_writable(arguments.out); !writable) return writable;
  const Stopwatch stopwatch;
  const auto found = detect_in_recording(arguments.images, detector->get());
  if (!found) return found.error();
  const double seconds = 1e-6 * stopwatch.elapsed_us();
  std::size_t boxes = 0;
  for (const DetectionFrame& frame : found->frames) boxes += frame.detections.size();
  std::printf("%zu images, %zu boxes in %.1f s\n", found->frames.size(), boxes, seconds);
  if (!found->warning.empty()) std::fprintf(stderr, "detect: warning: %s\n", found->warning.c_str());
  return write_detections_json(arguments.out, found->frames);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  Command command{"", "DIR_OR_BAG MODEL.onnx OUT.json [--classes YAML] [--set detector.field=value ...]",
                  "Finds the objects in the color images of a TUM folder, or of a bag in the layout of the TUM RGB-D "
                  "bags, and\nwrites them as detections for later runs.\n",
                  [&arguments] { return run(arguments); },
                  [&arguments] { return default_to_package("classes_coco.yaml", "--classes", &arguments.classes); }};
  command.words = {{"DIR_OR_BAG", &arguments.images}, {"MODEL.onnx", &arguments.model}, {"OUT.json", &arguments.out}};
  command
      .option("classes", po::value(&arguments.classes),
              "class table (default: config/classes_coco.yaml of the package)")
      .option("set", assignments(&arguments.assignments), "one of the parameters detector.*; may be repeated");
  return run_program("detect", {command}, argc, argv);
}
