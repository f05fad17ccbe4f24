#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kWidth = 640, kHeight = 480, kImages = 240;

Camera camera() {
  Camera camera;
  camera.fx = camera.fy = 525.0;
  camera.cx = 319.5;
  camera.cy = 239.5;
  camera.width = kWidth;
  camera.height = kHeight;
  return camera;
}

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

/// Processor time of the calling thread for one image; the bundle adjustment runs beside it.
void track(benchmark::State& state) {
  std::vector<RgbdImage> sequence = images();
  RgbdFrontend frontend(FrontendOptions(), camera());
  std::vector<double> times_ms;
  std::int64_t number = 0;
  for (auto _ : state) {
    RgbdImage& image = sequence[static_cast<std::size_t>(number % kImages)];
    image.stamp_ns = number++ * 33333333;
    const double begin_ms = thread_ms();
    benchmark::DoNotOptimize(frontend.track(image).inliers);
    times_ms.push_back(thread_ms() - begin_ms);
  }
  std::sort(times_ms.begin(), times_ms.end());
  state.counters["p50_ms"] = times_ms[times_ms.size() / 2];
  state.counters["p99_ms"] = times_ms[times_ms.size() * 99 / 100];
}
BENCHMARK(track)->Iterations(2 * kImages)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace semantic_topo_loop::core

BENCHMARK_MAIN();
