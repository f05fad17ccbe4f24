// Time of the core's building blocks. Run a Release or RelWithDebInfo build on an otherwise idle machine:
//   rosrun semantic_topo_loop benchmark_core
#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>
#include <vector>

#include "map/landmark_fitter.h"
#include "map/quadric_fit.h"
#include "semantic_topo_loop/association/associator_options.h"
#include "semantic_topo_loop/association/object_associator.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
constexpr int kCup = 41;

std::vector<BoxView> views_of(const Ellipsoid& ellipsoid, int n) {
  std::vector<BoxView> views;
  for (int i = 0; i < n; ++i) {
    const double angle = radians(60.0) * i / n - radians(30.0);
    const SE3 T_world_camera(so3_exp(Vec3(0.0, -angle, 0.0)), Vec3(1.5 * std::sin(angle), 0.0, -1.5 * std::cos(angle)));
    views.push_back({T_world_camera, *project_box(ellipsoid, projection_matrix(kCamera, T_world_camera)), 0, 0.0});
  }
  return views;
}

const Ellipsoid kObject{SE3(so3_exp(Vec3(0.1, 0.2, 0.3)), Vec3(0.02, -0.03, 0.04)), Vec3(0.05, 0.04, 0.1)};

void project_quadric(benchmark::State& state) {
  const Mat34 P = projection_matrix(kCamera, views_of(kObject, 3)[1].T_world_camera);
  const Mat3 shape = kObject.shape();
  for (auto _ : state) benchmark::DoNotOptimize(project_box(kObject.center(), shape, P));
}
BENCHMARK(project_quadric);

void initialise_quadric(benchmark::State& state) {
  const std::vector<BoxView> views = views_of(kObject, static_cast<int>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(initialise_sphere(kCamera, views));
}
BENCHMARK(initialise_quadric)->Arg(10)->Arg(60);

void refine_quadric_on_boxes(benchmark::State& state) {
  const std::vector<BoxView> views = views_of(kObject, static_cast<int>(state.range(0)));
  const Ellipsoid sphere = *initialise_sphere(kCamera, views);
  for (auto _ : state) benchmark::DoNotOptimize(refine_quadric(kCamera, views, sphere));
}
BENCHMARK(refine_quadric_on_boxes)->Arg(10)->Arg(60)->Unit(benchmark::kMicrosecond);

/// Landmark `i` of a hall of desks, 20 objects on each and 4 m from desk to desk, of which the camera at the origin
/// sees the first alone: the others stand beside and behind it.
Landmark landmark_in_hall(std::int64_t i) {
  constexpr std::int64_t kDesksInRow = 71;
  const std::int64_t desk = i / 20;
  const auto row = static_cast<double>(desk / kDesksInRow), column = static_cast<double>(desk % kDesksInRow);
  Landmark landmark;
  landmark.id = i;
  landmark.class_id = kCup;
  landmark.observations = 40;
  const Vec3 on_desk(0.3 * static_cast<double>(i % 5) - 0.6, 0.3 * static_cast<double>(i / 5 % 4) - 0.45, 2.0);
  landmark.ellipsoid =
      Ellipsoid{SE3(Quaternion::Identity(), on_desk + Vec3(4.0 * column, 0.0, -4.0 * row)), Vec3::Constant(0.08)};
  return landmark;
}

/// A frame with 20 boxes against a map of range(0) landmarks, of which 20 are in view.
void associate_frame(benchmark::State& state, const char* mode) {
  const auto classes =
      std::make_shared<const ClassTable>(*ClassTable::create({{kCup, "cup", ClassRole::kMovable, "", 0.1}}));
  AssociatorOptions options;
  options.mode = mode;
  ObjectAssociator associator(options, classes);
  MapUpdate update;
  update.map_version = 1;
  for (std::int64_t i = 0; i < state.range(0); ++i) update.changed.push_back(landmark_in_hall(i));
  std::vector<Detection> detections;
  for (std::size_t i = 0; i < 20; ++i) {
    detections.push_back({kCup, 0.9, *project_box(*update.changed[i].ellipsoid, projection_matrix(kCamera, SE3()))});
  }
  associator.apply(update);
  Frame frame;
  frame.camera = kCamera;
  frame.keyframe_id = 0;
  for (auto _ : state) {
    ++frame.frame_id;
    frame.stamp_ns += 33333333;
    benchmark::DoNotOptimize(associator.associate(frame, detections));
  }
}
BENCHMARK_CAPTURE(associate_frame, joint, "joint")
    ->Arg(20)
    ->Arg(100)
    ->Arg(1000)
    ->Arg(10000)
    ->Arg(100000)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(associate_frame, cascade, "cascade")
    ->Arg(20)
    ->Arg(100)
    ->Arg(1000)
    ->Arg(10000)
    ->Arg(100000)
    ->Unit(benchmark::kMicrosecond);
// One dense assignment over all landmarks: as far as it runs in sensible time.
BENCHMARK_CAPTURE(associate_frame, jda, "jda")->Arg(20)->Arg(100)->Arg(1000)->Arg(10000)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace semantic_topo_loop::core

BENCHMARK_MAIN();
