#include <cstdio>
#include <filesystem>
#include <opencv2/core.hpp>
#include <string>
#include <utility>
#include <vector>

#include "apps/program.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/frontend/object_detector.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/stamp.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string images, model, out, classes;
  OptionTexts assignments;
};

struct ImageDetections {
  std::vector<DetectionFrame> frames;  ///< in order of their stamps
  std::string warning;                 ///< images that could not be read; empty if none
};

/// What a detector finds in every color image of a recording: of a TUM folder (those of rgb.txt or, where that is
/// missing, of associations.txt) or of a bag in the layout of the TUM RGB-D bags.
/// @return an error, with file and cause, if the recording or none of its images can be read, or the model fails
Result<ImageDetections> detect_in_recording(const std::string& folder_or_bag, ObjectDetector* detector) {
  ImageDetections found;
  DetectionReport::Cause unreadable;
  const auto detect = [&](std::int64_t stamp_ns, const Result<cv::Mat>& color) -> Status {
    if (!color) {
      if (unreadable.count++ == 0) unreadable.first = color.message();
      return {};
    }
    Result<std::vector<Detection>> detections = detector->detect(*color);
    if (!detections) return detections.error();
    found.frames.push_back({stamp_ns, *std::move(detections)});
    return {};
  };
  const auto finish = [&]() -> Result<ImageDetections> {
    if (unreadable.count == 0) return std::move(found);
    if (found.frames.empty()) return Error{"no image can be read (first: " + unreadable.first + ")"};
    found.warning = std::to_string(unreadable.count) + " images left out (first: " + unreadable.first + ")";
    return std::move(found);
  };
  std::error_code missing;
  if (!std::filesystem::is_directory(folder_or_bag, missing)) {
    const auto take = [&](std::int64_t stamp_ns, const Result<cv::Mat>& color) {
      return detector->is_due(stamp_ns) ? detect(stamp_ns, color) : Status();
    };
    if (const Status read = semantic_topo_loop::for_each_color_image(folder_or_bag, take); !read) return read.error();
    return finish();
  }
  const auto images = list_color_images(folder_or_bag);
  if (!images) return images.error();
  for (const auto& [stamp_ns, path] : *images) {
    if (!detector->is_due(stamp_ns)) continue;
    if (const Status detected = detect(stamp_ns, read_color_image(path)); !detected) {
      return Error{path + ": " + detected.message()};
    }
  }
  return finish();
}

Status run(const Arguments& arguments) {
  OptionTexts texts = arguments.assignments;
  texts["detector.model"] = arguments.model;
  const Result<ObjectDetectorOptions> options = make_options<ObjectDetectorOptions>(texts);
  if (!options) return options.error();
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  const auto detector = ObjectDetector::load(*options, *classes);
  if (!detector) return detector.error();
  if (arguments.out.empty() || arguments.out.back() == '/')
    return Error{"'" + arguments.out + "' is no name of a file"};
  for (const std::string& input : {arguments.images, arguments.model}) {
    if (is_same_file(input, arguments.out)) return Error{arguments.out + ": would take the place of the input"};
  }
  if (const Status writable = check_writable(arguments.out); !writable) return writable;
  const Stopwatch stopwatch;
  const auto found = detect_in_recording(arguments.images, detector->get());
  if (!found) return found.error();
  const double seconds = 1e-6 * stopwatch.elapsed_us();
  std::size_t boxes = 0;
  for (const DetectionFrame& frame : found->frames) boxes += frame.detections.size();
  std::printf("%zu images, %zu boxes in %.1f s\n", found->frames.size(), boxes, seconds);
  for (const std::string& warning : {(*detector)->warning(), found->warning}) {
    if (!warning.empty()) std::fprintf(stderr, "detect: warning: %s\n", warning.c_str());
  }
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
