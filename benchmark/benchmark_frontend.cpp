// Tracking one image: on a painted wall, and, with --rgbd, on the images of a folder as `offline --rgbd` takes them.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "apps/program.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kWidth = 640, kHeight = 480, kImages = 240;

const Camera kCamera{525.0, 525.0, 319.5, 239.5, kWidth, kHeight, {}};

/// A wall painted with patches of random brightness, 2 m away, past which the camera goes back and forth.
std::vector<RgbdImage> images() {
  cv::Mat wall = cv::Mat::zeros(1200, 1800, CV_16UC1);
  cv::RNG random(5);
  for (const int cell_px : {64, 24, 9}) {
    cv::Mat cells(wall.rows / cell_px + 1, wall.cols / cell_px + 1, CV_16UC1), patches;
    random.fill(cells, cv::RNG::UNIFORM, 0, 85);
    cv::resize(cells, patches, cv::Size(), cell_px, cell_px, cv::INTER_NEAREST);
    wall += patches(cv::Rect(0, 0, wall.cols, wall.rows));
  }
  wall.convertTo(wall, CV_8UC1);
  std::vector<RgbdImage> result;
  for (int i = 0; i < kImages; ++i) {
    const double phase = 2.0 * kPi * i / kImages;
    RgbdImage image;
    cv::getRectSubPix(wall, cv::Size(kWidth, kHeight),
                      cv::Point2f(static_cast<float>(900.0 + 500.0 * std::sin(phase)),
                                  static_cast<float>(600.0 + 200.0 * std::sin(2.0 * phase))),
                      image.gray);
    image.depth_m = cv::Mat(kHeight, kWidth, CV_32FC1, cv::Scalar(2.0));
    result.push_back(image);
  }
  return result;
}

double thread_ms() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
}

double wall_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Times of images that were tracked one after the other.
class Times {
 public:
  TrackedImage track(RgbdFrontend* frontend, const RgbdImage& image) {
    const double thread_begin_ms = thread_ms(), wall_begin_ms = wall_ms();
    TrackedImage tracked = frontend->track(image);
    thread_ms_.push_back(thread_ms() - thread_begin_ms);
    wall_ms_.push_back(wall_ms() - wall_begin_ms);
    return tracked;
  }
  double last_wall_ms() const { return wall_ms_.back(); }
  /// cpu: of the calling thread; wall: with its waiting for the local bundle adjustment, which runs beside it.
  void report(benchmark::State* state) {
    report("cpu_", &thread_ms_, state);
    report("wall_", &wall_ms_, state);
  }

 private:
  static void report(const std::string& name, std::vector<double>* times_ms, benchmark::State* state) {
    std::sort(times_ms->begin(), times_ms->end());
    const std::size_t count = times_ms->size();
    const double sum_ms = std::accumulate(times_ms->begin(), times_ms->end(), 0.0);
    state->counters[name + "mean"] = sum_ms / static_cast<double>(count);
    state->counters[name + "p50"] = (*times_ms)[count / 2];
    state->counters[name + "p99"] = (*times_ms)[count * 99 / 100];
    state->counters[name + "max"] = times_ms->back();
  }
  std::vector<double> thread_ms_, wall_ms_;
};

void track_wall(benchmark::State& state) {
  std::vector<RgbdImage> sequence = images();
  RgbdFrontend frontend(FrontendOptions(), kCamera);
  Times times;
  std::int64_t number = 0;
  for (auto _ : state) {
    RgbdImage& image = sequence[static_cast<std::size_t>(number % kImages)];
    image.stamp_ns = number++ * 33333333;
    benchmark::DoNotOptimize(times.track(&frontend, image).inliers);
  }
  times.report(&state);
}
BENCHMARK(track_wall)->Iterations(2 * kImages)->Unit(benchmark::kMillisecond);

/// A recording with what it is read by.
struct Recording {
  std::vector<RgbdFile> files;
  Camera camera;
  Options options;
};

/// Every image once, read before the clock starts.
void track_folder(benchmark::State& state, const Recording& recording) {
  RgbdRecording folder = read_images(recording.files, recording.camera, recording.options.depth);
  RgbdFrontend frontend(recording.options.frontend, recording.camera);
  Times times;
  TrackingReport report;
  for (auto _ : state) {
    const Result<std::optional<RgbdReading>> reading = folder.next();
    if (!reading || !*reading || !(*reading)->image) {
      state.SkipWithError(reading && *reading ? (*reading)->image.message().c_str() : "no image left");
      return;
    }
    report.add(times.track(&frontend, *(*reading)->image));
    state.SetIterationTime(1e-3 * times.last_wall_ms());
  }
  times.report(&state);
  state.counters["lost"] = static_cast<double>(report.lost + report.unusable);
  state.counters["relocalised"] = static_cast<double>(report.relocalised);
}

struct Arguments {
  std::string rgbd, camera, associations;
  OptionTexts options;
};

Result<Recording> open(const Arguments& arguments) {
  const std::string camera_file = arguments.camera.empty() ? arguments.rgbd + "/camera.yaml" : arguments.camera;
  const Result<Camera> camera = read_camera(camera_file);
  if (!camera) return camera.error();
  const Result<Options> options = load_options("", arguments.options);
  if (!options) return options.error();
  const Result<RgbdFiles> read = list_rgbd_images(arguments.rgbd, arguments.associations);
  if (!read) return read.error();
  return Recording{read->files, *camera, *options};
}

Status run(const Arguments& arguments) {
  if (!arguments.rgbd.empty()) {
    const Result<Recording> recording = open(arguments);
    if (!recording) return recording.error();
    benchmark::RegisterBenchmark("track_folder", track_folder, *recording)
        ->Iterations(static_cast<benchmark::IterationCount>(recording->files.size()))
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  }
  benchmark::RunSpecifiedBenchmarks();
  return {};
}

}  // namespace
}  // namespace semantic_topo_loop::core

int main(int argc, char** argv) {
  using namespace semantic_topo_loop;
  benchmark::Initialize(&argc, argv);
  core::Arguments arguments;
  apps::Command command{
      "", "[--rgbd DIR [--camera YAML] [--associations FILE] [--set module.field=value ...]] [--benchmark_...]", "",
      [&arguments] { return core::run(arguments); }};
  command.option("rgbd", apps::po::value(&arguments.rgbd), "folder of color and depth images that is tracked")
      .option("camera", apps::po::value(&arguments.camera), "its calibration (default: camera.yaml of the folder)")
      .option("associations", apps::po::value(&arguments.associations), "its list (default: as of offline)")
      .option("set", apps::assignments(&arguments.options), "one parameter; may be repeated");
  return apps::run_program("benchmark_frontend", {command}, argc, argv);
}
