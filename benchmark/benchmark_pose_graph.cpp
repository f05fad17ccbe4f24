// One more loop in a graph of 1,000 keyframes and 200 landmarks, warm: from the loop's arrival until the correction has
// reached the map; and the solver on public graphs (SEMANTIC_TOPO_LOOP_DATA), from file to minimum.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "tools/g2o/g2o.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kKeyframes = 1000, kObjects = 200, kPerRound = 100;

/// A camera that goes round a table ten times; its odometry drifts by a random walk. Loops lead a round back.
class Rounds {
 public:
  explicit Rounds(const std::string& objects)
      : graph_(options(objects)), mapper_(QuadricMapperOptions(), classes()), random_(1) {}

  /// Until the last keyframe of the first thousand but one loop.
  void fill() {
    while (next_ < kKeyframes) {
      const bool has_loop = next_ >= kPerRound + 20 && next_ % 2 == 0;
      step(has_loop ? std::vector<LoopClosure>{loop(next_)} : std::vector<LoopClosure>());
    }
  }
  /// A loop that the map disagrees with. @return the time until the correction is in the map, ms; 0 if none came
  double close_loop_ms() {
    LoopClosure late = loop(next_);
    late.T_match_query.t += Vec3(0.3, 0.0, 0.0);
    late.covariance *= 0.01;
    double spent_ms = step({late});
    constexpr int kPatience = 10;
    for (int i = 0; i < kPatience && !has_changed_; ++i) spent_ms = step({});
    return has_changed_ ? spent_ms : 0.0;
  }
  /// The last optimisation of a run, in which the objects take part. @return the time until it is in the map, ms
  double end_ms() {
    Frame frame;
    frame.frame_id = next_;
    frame.keyframe_id = next_ - 1;
    frame.is_end = true;
    frame.T_odom_camera = T_odom_camera_;
    return process(frame, AssociationFrame(), {});
  }
  std::size_t landmarks() const { return mapper_.landmarks().size(); }

 private:
  static PoseGraphOptions options(const std::string& objects) {
    PoseGraphOptions options;
    options.objects = objects;
    return options;
  }

  static std::shared_ptr<const ClassTable> classes() {
    return std::make_shared<ClassTable>(*ClassTable::create({{41, "cup", ClassRole::kMovable, "", 0.1}}));
  }

  SE3 truth(int k) const {
    const double phase = 2.0 * kPi * k / kPerRound;
    const Vec3 position(3.0 * std::cos(phase), 3.0 * std::sin(phase), 1.0 + 0.2 * std::sin(3.0 * phase));
    const Vec3 z = (Vec3(0.0, 0.0, 0.2) - position).normalized(), x = z.cross(Vec3::UnitZ()).normalized();
    Mat3 R;
    R << x, z.cross(x), z;
    return {R, position};
  }
  static Ellipsoid object(int i) {
    const double angle = 2.399963 * i, radius = 1.2 * std::sqrt((i + 0.5) / kObjects);
    return {SE3(Quaternion::Identity(), Vec3(radius * std::cos(angle), radius * std::sin(angle), 0.2)),
            Vec3(0.04, 0.04, 0.05)};
  }
  LoopClosure loop(int query) {
    LoopClosure loop;
    const int match = query - kPerRound * random_.integer(1, query / kPerRound);
    loop.query_keyframe_id = loop.query_frame = loop.query_end = query;
    loop.match_keyframe_id = loop.match_frame = loop.match_end = match;
    constexpr int kWindow = 10;
    loop.query_begin = std::max(0, query - kWindow);
    loop.match_begin = std::max(0, match - kWindow);
    loop.accepted = true;
    loop.T_match_query =
        truth(match).inverse() * truth(query) * SE3(so3_exp(0.005 * random_.normal3()), Vec3(0.01 * random_.normal3()));
    loop.covariance = 1e-4 * Mat6::Identity();
    return loop;
  }

  double step(const std::vector<LoopClosure>& loops) {
    const SE3 motion = next_ == 0 ? SE3() : truth(next_ - 1).inverse() * truth(next_);
    T_odom_camera_ =
        next_ == 0 ? truth(0)
                   : T_odom_camera_ * motion * SE3(so3_exp(0.001 * random_.normal3()), Vec3(0.003 * random_.normal3()));
    Frame frame;
    frame.frame_id = frame.keyframe_id = next_;
    frame.stamp_ns = 300000000LL * next_;
    frame.is_keyframe = true;
    frame.T_odom_camera = T_odom_camera_;
    frame.camera = Camera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
    AssociationFrame associations;
    associations.frame_id = next_;
    for (int i = next_ % 5; i < kObjects; i += 5) {
      const auto box = project_box(object(i), projection_matrix(frame.camera, truth(next_)));
      if (!box) continue;
      Association association;
      association.landmark_id = i;
      association.class_id = association.landmark_class_id = 41;
      association.box = *box;
      associations.associations.push_back(association);
    }
    ++next_;
    return process(frame, associations, loops);
  }

  double process(const Frame& frame, const AssociationFrame& associations, const std::vector<LoopClosure>& loops) {
    const MapUpdate observation = mapper_.integrate(frame, associations);
    const auto start = std::chrono::steady_clock::now();
    graph_.apply(observation);
    graph_.observe(frame, associations);
    const MapCorrection correction = graph_.process(frame, loops);
    graph_.apply(mapper_.apply(correction));
    has_changed_ = correction.changed;
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  }

  PoseGraph graph_;
  QuadricMapper mapper_;
  Random random_;
  SE3 T_odom_camera_;
  int next_ = 0;
  bool has_changed_ = false;
};

void close_one_loop(benchmark::State& state, const std::string& objects) {
  Rounds rounds(objects);
  rounds.fill();
  std::vector<double> times_ms;
  for (auto _ : state) {
    const double spent_ms = rounds.close_loop_ms();
    times_ms.push_back(spent_ms);
    state.SetIterationTime(1e-3 * spent_ms);
  }
  std::sort(times_ms.begin(), times_ms.end());
  state.counters["landmarks"] = static_cast<double>(rounds.landmarks());
  state.counters["median_ms"] = times_ms[times_ms.size() / 2];
  state.counters["worst_ms"] = times_ms.back();
}
BENCHMARK_CAPTURE(close_one_loop, off, std::string("off"))
    ->UseManualTime()
    ->Iterations(50)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(close_one_loop, on, std::string("on"))
    ->UseManualTime()
    ->Iterations(50)
    ->Unit(benchmark::kMillisecond);

void finish_run(benchmark::State& state, const std::string& objects) {
  for (auto _ : state) {
    Rounds rounds(objects);
    rounds.fill();
    state.SetIterationTime(1e-3 * rounds.end_ms());
    state.counters["landmarks"] = static_cast<double>(rounds.landmarks());
  }
}
BENCHMARK_CAPTURE(finish_run, off, std::string("off"))->UseManualTime()->Iterations(1)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(finish_run, on, std::string("on"))->UseManualTime()->Iterations(1)->Unit(benchmark::kMillisecond);

void public_graph(benchmark::State& state, const std::string& name) {
  const char* data = std::getenv("SEMANTIC_TOPO_LOOP_DATA");
  if (data == nullptr) {
    state.SkipWithError("set SEMANTIC_TOPO_LOOP_DATA to the shared data");
    return;
  }
  const Result<G2oGraph> graph = read_g2o(std::string(data) + "/pose_graphs/" + name + ".g2o", nullptr);
  if (!graph) {
    state.SkipWithError(graph.message().c_str());
    return;
  }
  for (auto _ : state) {
    G2oGraph solved = *graph;
    const Result<GraphOptimizerReport> report = optimize_graph(&solved, {});
    if (!report) {
      state.SkipWithError(report.message().c_str());
      return;
    }
    state.counters["chi2"] = report->final_chi2;
  }
}
BENCHMARK_CAPTURE(public_graph, sphere2500, std::string("sphere2500"))->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(public_graph, parking_garage, std::string("parking-garage"))->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace semantic_topo_loop::core

BENCHMARK_MAIN();
