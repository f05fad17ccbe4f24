#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "apps/program.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/map_database.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/stamp.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string a, b, out, classes, config;
  OptionTexts assignments;
};

std::ptrdiff_t confirmed(const MapState& map) {
  return std::count_if(map.objects.landmarks.begin(), map.objects.landmarks.end(), [](const MappedLandmark& landmark) {
    return landmark.state.state == LandmarkState::kConfirmed;
  });
}

/// Boxes of a map, each with its keyframe's stamp: no two recordings have one alike to the last digit.
std::set<std::array<double, 5>> boxes_of(const MapState& map) {
  std::map<std::int64_t, double> stamps_s;
  for (const KeyframePose& pose : map.keyframe_poses())
    stamps_s[pose.keyframe_id] = 1e-9 * static_cast<double>(pose.stamp_ns);
  std::set<std::array<double, 5>> boxes;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    for (const Observation& observation : landmark.observations) {
      const Box& box = observation.view.box;
      boxes.insert({stamps_s[observation.keyframe_id], box.x1, box.y1, box.x2, box.y2});
    }
  }
  return boxes;
}

std::size_t shared_boxes(const MapState& a, const MapState& b) {
  const auto boxes_a = boxes_of(a), boxes_b = boxes_of(b);
  return static_cast<std::size_t>(
      std::count_if(boxes_a.begin(), boxes_a.end(), [&boxes_b](const auto& box) { return boxes_b.count(box) > 0; }));
}

Status run(const Arguments& arguments) {
  for (const std::string* map : {&arguments.a, &arguments.b}) {
    if (is_same_file(arguments.out, *map))
      return Error{arguments.out + ": would take the place of a map that is joined"};
  }
  if (const Status place = check_map_place(arguments.out); !place) return place;
  const Result<Options> options = load_options(arguments.config, arguments.assignments);
  if (!options) return options.error();
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  const auto a = read_map(arguments.a, *classes), b = read_map(arguments.b, *classes);
  for (const auto* map : {&a, &b}) {
    if (!*map) return map->error();
    const std::string& path = map == &a ? arguments.a : arguments.b;
    if ((**map)->graph.sessions.empty()) return Error{path + ": holds submaps only"};
    if (const Status has_scale = (**map)->check_scale(options->pose_graph); !has_scale) {
      return Error{path + ": " + has_scale.message()};
    }
  }
  const std::size_t shared = shared_boxes(**a, **b);
  if (shared > 0) {
    std::fprintf(
        stderr,
        "merge_maps: warning: %zu boxes are in both maps, of a session that is in both: it is in the result twice, "
        "and counts twice\n",
        shared);
  }
  const Stopwatch stopwatch;
  const MergedMaps merged = merge_maps(**a, **b, *options, std::make_shared<const ClassTable>(*classes));
  if (!merged.joined) {
    return Error{arguments.a + " and " + arguments.b + " have " + merged.joined.message() + "; nothing is written"};
  }
  std::printf("%zu loops join the maps; %td and %td confirmed objects are %td; %.1f s\n", merged.kept_loops,
              confirmed(**a), confirmed(**b), confirmed(*merged.map), 1e-6 * stopwatch.elapsed_us());
  MapState map = *merged.map;
  map.configuration = format_options_yaml(list_options(*options));
  return write_map(arguments.out, map, *classes);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  Command command{"", "A.db B.db OUT.db [--config YAML] [--set module.field=value ...] [--classes YAML]",
                  "Joins two maps, each in a frame of its own, by what both saw; the result is in A's frame.\n",
                  [&arguments] { return run(arguments); },
                  [&arguments] { return default_to_package("classes_coco.yaml", "--classes", &arguments.classes); }};
  command.words = {{"A.db", &arguments.a}, {"B.db", &arguments.b}, {"OUT.db", &arguments.out}};
  command
      .option("classes", po::value(&arguments.classes),
              "class table (default: config/classes_coco.yaml of the package)")
      .option("config", po::value(&arguments.config),
              "parameters (default: the built-in ones, those of config/default.yaml)")
      .option("set", assignments(&arguments.assignments), "one parameter, over --config; may be repeated");
  return run_program("merge_maps", {command}, argc, argv);
}
