// A map of 20,000 keyframes and 600 objects: written to a file, and read back.

#include <benchmark/benchmark.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>

#include "apps/program.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {
namespace {

template <class Value>
Value or_exit(Result<Value> result) {
  if (result) return *std::move(result);
  std::fprintf(stderr, "benchmark_map: %s\n", result.message().c_str());
  std::exit(1);
}

const ClassTable& classes() {
  static const ClassTable table = [] {
    std::string path;
    if (const Status found = apps::default_to_package("classes_coco.yaml", "--classes", &path); !found) std::exit(1);
    return or_exit(read_class_table(path));
  }();
  return table;
}

/// A minute about a desk.
MapState one_minute() {
  SimulationOptions simulation;
  simulation.trajectory.rate_hz = 10.0;
  const Camera camera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
  const SimulatedSequence sequence = or_exit(simulate(simulation, camera, classes()));
  const Options options;
  ObjectSlam slam(options, std::make_shared<const ClassTable>(classes()));
  FrameBuilder builder(options.keyframe, camera);
  for (std::size_t i = 0; i < sequence.odometry.size(); ++i) {
    const auto& [stamp_ns, T_world_camera] = sequence.odometry[i];
    std::vector<Detection> detections;
    for (const SimulatedDetection& d : sequence.detections[i]) detections.push_back(d.detection);
    slam.process(or_exit(builder.build({stamp_ns, T_world_camera})), &detections);
  }
  slam.process(builder.end(), nullptr);
  return *slam.map();
}

/// The minute again and again, each time beside what is there; of its objects as many as make 600 in all.
const MapState& large_map() {
  static const MapState map = [] {
    constexpr std::size_t kKeyframes = 20'000, kObjects = 600;
    MapState minute = one_minute(), large;
    const std::size_t times = kKeyframes / minute.graph.keyframes.size() + 1;
    minute.objects.landmarks.resize(std::min(minute.objects.landmarks.size(), kObjects / times + 1));
    for (std::size_t i = 0; i < times; ++i) large.append(minute);
    return large;
  }();
  return map;
}

std::string path() {
  return (std::filesystem::temp_directory_path() / ("benchmark_map_" + std::to_string(::getpid()) + ".db")).string();
}

void report(benchmark::State& state) {
  state.counters["keyframes"] = static_cast<double>(large_map().graph.keyframes.size());
  state.counters["objects"] = static_cast<double>(large_map().objects.landmarks.size());
  state.counters["submaps"] = static_cast<double>(large_map().submaps.size());
  state.counters["MB"] = 1e-6 * static_cast<double>(std::filesystem::file_size(path()));
}

void write(benchmark::State& state) {
  large_map();
  for (auto _ : state) or_exit(write_map(path(), large_map(), classes()));
  report(state);
}
BENCHMARK(write)->Unit(benchmark::kMillisecond);

void read(benchmark::State& state) {
  or_exit(write_map(path(), large_map(), classes()));
  for (auto _ : state) benchmark::DoNotOptimize(or_exit(read_map(path(), classes())));
  report(state);
  std::filesystem::remove(path());
}
BENCHMARK(read)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace semantic_topo_loop::core

BENCHMARK_MAIN();
