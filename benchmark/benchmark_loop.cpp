// Loop detection alone: the matcher against the number of correspondences and the share of outliers, and detection per
// keyframe against the number of submaps in the map.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "loop/graph/graph_detector.h"
#include "loop/submap/graph_matcher.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

double uniform(std::mt19937_64& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1.0p-53;
}

Vec3 uniform_vector(std::mt19937_64& random, const Vec3& half) {
  return {uniform(random, -half.x(), half.x()), uniform(random, -half.y(), half.y()),
          uniform(random, -half.z(), half.z())};
}

LabelledPoint random_point(std::mt19937_64& random, int labels) {
  LabelledPoint point;
  point.position = uniform_vector(random, Vec3(1.0, 0.7, 0.3));
  point.label = static_cast<int>(uniform(random, 0, labels));
  point.class_id = point.label;
  point.size = uniform(random, 0.05, 0.09);  // any two are similar enough: labels alone make the correspondences
  return point;
}

struct Problem {
  std::vector<LabelledPoint> a, b;
  SE3 T_a_b;
};

/// Points 0 .. common - 1 of both sets are the same, with an error of 1 cm; the rest are others.
Problem random_problem(std::mt19937_64& random, int points, int common, int labels) {
  Problem problem;
  problem.T_a_b =
      SE3(so3_exp(uniform_vector(random, Vec3::Constant(2.0))), uniform_vector(random, Vec3::Constant(3.0)));
  const SE3 T_b_a = problem.T_a_b.inverse();
  for (int i = 0; i < points; ++i) {
    const LabelledPoint p = random_point(random, labels);
    LabelledPoint q = i < common ? p : random_point(random, labels);
    q.position = T_b_a * q.position + uniform_vector(random, Vec3::Constant(0.017));
    problem.a.push_back(p);
    problem.b.push_back(q);
  }
  return problem;
}

int correspondences(const Problem& problem) {
  int count = 0;
  for (const LabelledPoint& p : problem.a) {
    count += static_cast<int>(
        std::count_if(problem.b.begin(), problem.b.end(), [&p](const LabelledPoint& q) { return q.label == p.label; }));
  }
  return count;
}

bool is_exact(const Problem& problem, int common, const std::vector<GraphMatch>& matches) {
  if (matches.empty()) return false;
  for (int i = 0; i < common; ++i) {
    const Vec3 error = matches.front().T_a_b * problem.b[static_cast<std::size_t>(i)].position -
                       problem.a[static_cast<std::size_t>(i)].position;
    if (error.norm() > 0.06) return false;
  }
  return true;
}

/// Arguments: points of a set, points in common, labels. Counters: correspondences, outliers among them, share of exact
/// matches, and the median time.
void matcher(benchmark::State& state) {
  const int common = static_cast<int>(state.range(1));
  std::mt19937_64 random(1);
  std::vector<Problem> problems;
  double total = 0.0;
  for (int k = 0; k < 500; ++k) {
    problems.push_back(
        random_problem(random, static_cast<int>(state.range(0)), common, static_cast<int>(state.range(2))));
    total += correspondences(problems.back());
  }
  const LoopOptions options;
  std::vector<double> times_us;
  std::size_t k = 0, exact = 0;
  for (auto _ : state) {
    const Problem& problem = problems[k++ % problems.size()];
    const auto begin = std::chrono::steady_clock::now();
    const std::vector<GraphMatch> matches = match_graphs(problem.a, problem.b, options);
    times_us.push_back(std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count());
    exact += is_exact(problem, common, matches) ? 1 : 0;
  }
  const auto middle = times_us.begin() + static_cast<std::ptrdiff_t>(times_us.size() / 2);
  std::nth_element(times_us.begin(), middle, times_us.end());
  const double mean = total / static_cast<double>(problems.size());
  state.counters["correspondences"] = mean;
  state.counters["outliers"] = 1.0 - common / mean;
  state.counters["exact"] = static_cast<double>(exact) / static_cast<double>(k);
  state.counters["median_us"] = *middle;
}
BENCHMARK(matcher)
    ->Args({12, 8, 5})
    ->Args({12, 10, 7})
    ->Args({16, 10, 5})
    ->Args({20, 8, 5})
    ->Args({20, 6, 5})
    ->Args({30, 10, 5})
    ->Args({64, 16, 4})
    ->Unit(benchmark::kMicrosecond);

/// A submap of some desk; without boxes, so that a match ends at the reprojection test.
LocalMap random_map(std::mt19937_64& random, std::int64_t stamp_ns) {
  LocalMap map;
  map.stamp_ns = map.end_ns = stamp_ns;
  map.keyframe_id = map.frame_id = map.begin_frame = map.end_frame = stamp_ns / 2'000'000'000;
  map.span_s = 10.0;
  for (int i = 0; i < 14; ++i) {
    const LabelledPoint point = random_point(random, 12);
    LocalObject object;
    object.landmark_id = i;
    object.label = object.class_id = point.label;
    object.spheroid.center = point.position;
    object.spheroid.log_axes.setConstant(std::log(point.size));
    map.objects.push_back(object);
  }
  return map;
}

/// One query against a map of `range(0)` submaps of different places, one of which is the query's.
void detection(benchmark::State& state) {
  std::mt19937_64 random(1);
  GraphDetector detector{LoopOptions()};
  const std::int64_t step_ns = 2'000'000'000;
  const std::int64_t submaps = state.range(0);
  std::vector<LocalMap> queries;
  for (std::int64_t k = 0; k < submaps; ++k) {
    LocalMap map = random_map(random, k * step_ns);
    if (queries.size() < 10) {
      queries.push_back(map);
      queries.back().stamp_ns = queries.back().end_ns = (submaps + 100) * step_ns;
    }
    detector.store(std::move(map));
  }
  std::size_t k = 0;
  for (auto _ : state) benchmark::DoNotOptimize(detector.detect(queries[k++ % queries.size()]));
}
BENCHMARK(detection)->Arg(10)->Arg(100)->Arg(1000)->Unit(benchmark::kMicrosecond);

void add_features(std::mt19937_64& random, LocalMap* map) {
  constexpr int kFeatures = 500;
  auto features = std::make_shared<std::vector<PointFeature>>(kFeatures);
  for (PointFeature& feature : *features) {
    for (std::uint64_t& part : feature.descriptor) part = random();
  }
  map->features = std::move(features);
}

/// One query whose objects fit nowhere against a map of an earlier session with `range(0)` submaps, so that those that
/// look most alike are compared by their points.
void relocalisation_by_points(benchmark::State& state) {
  std::mt19937_64 random(1);
  GraphDetector detector{LoopOptions()};
  for (std::int64_t k = 0; k < state.range(0); ++k) {
    LocalMap map = random_map(random, k * 2'000'000'000);
    add_features(random, &map);
    map.segment = LocalMap::kOtherSession;
    detector.insert(std::move(map));
  }
  LocalMap query = random_map(random, 0);
  add_features(random, &query);
  query.segment = 0;
  for (auto _ : state) benchmark::DoNotOptimize(detector.detect(query));
}
BENCHMARK(relocalisation_by_points)->Arg(100)->Arg(1000)->Arg(3000)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace semantic_topo_loop::core

BENCHMARK_MAIN();
