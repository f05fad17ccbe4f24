#include "apps/offline_run.h"

#include <unistd.h>

#include <cstdio>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/io/submap_file.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::apps {

namespace {

using namespace core;

constexpr std::int64_t kStampTolerance_ns = 1000;

class Progress {
 public:
  explicit Progress(std::size_t total) : total_(total), is_terminal_(isatty(STDERR_FILENO) != 0) {}
  void show(std::size_t done) {
    const int percent = static_cast<int>(100 * done / total_);
    if (!is_terminal_ || percent == percent_) return;
    percent_ = percent;
    constexpr int kWidth = 50;
    const std::string bar(static_cast<std::size_t>(percent * kWidth / 100), '#');
    std::fprintf(stderr, "\r[%-*s] %3d %%%s", kWidth, bar.c_str(), percent, done == total_ ? "\n" : "");
  }

 private:
  std::size_t total_;
  bool is_terminal_;
  int percent_ = -1;
};

/// Hands loops out at their query frames.
class ExtraLoops {
 public:
  explicit ExtraLoops(const std::vector<LoopClosure>& loops) {
    for (const LoopClosure& loop : loops) loops_[loop.query_frame].push_back(loop);
  }
  std::vector<LoopClosure> at(const Frame& frame) {
    if (frame.is_keyframe) keyframe_of_[frame.frame_id] = frame.keyframe_id;
    std::vector<LoopClosure> due = std::move(loops_[frame.frame_id]);
    loops_.erase(frame.frame_id);
    for (LoopClosure& loop : due) {
      loop.query_keyframe_id = keyframe(loop.query_frame);
      loop.match_keyframe_id = keyframe(loop.match_frame);
    }
    return due;
  }
  /// Those whose query frame never came.
  std::size_t left() const {
    std::size_t count = 0;
    for (const auto& [frame, loops] : loops_) count += loops.size();
    return count;
  }

 private:
  /// -1 where there is none: the pose graph refuses such a loop.
  std::int64_t keyframe(std::int64_t frame_id) const {
    const auto found = keyframe_of_.find(frame_id);
    return found == keyframe_of_.end() ? -1 : found->second;
  }
  std::map<std::int64_t, std::vector<LoopClosure>> loops_;
  std::map<std::int64_t, std::int64_t> keyframe_of_;
};

void record(const Frame& frame, const FrameResult& result, RunRecorder* recorder) {
  recorder->record(frame);
  recorder->record(result.associations);
  recorder->record(result.observation);
  recorder->record(frame.frame_id, result.loops, result.loop_us);
  recorder->record(result.correction);
  recorder->record(result.completion);
}

/// What a run went through.
struct Counts {
  std::size_t frames = 0;
  std::size_t with_detections = 0;
  std::int64_t first_ns = 0, last_ns = 0;
};

void warn(const RunInputs& inputs, const Counts& counts, std::size_t loops_left) {
  const auto say = [](const std::string& text) { std::cerr << "offline: warning: " << text << '\n'; };
  const std::size_t images = inputs.detections.size();
  if (images > 0 && counts.with_detections < counts.frames) {
    say(std::to_string(counts.frames - counts.with_detections) + " of " + std::to_string(counts.frames) +
        " frames have no detections");
  }
  if (loops_left > 0) say(std::to_string(loops_left) + " extra loops have a query frame that never came");
  if (counts.with_detections < images) {
    say(std::to_string(images - counts.with_detections) + " of " + std::to_string(images) +
        " images with detections have no pose and were left out");
  }
  if (!inputs.source->warning().empty()) say(inputs.source->warning());
  const std::optional<TrackingReport> tracking = inputs.source->report();
  if (tracking && !tracking->warning().empty()) say(tracking->warning());
  const std::string depth = inputs.source->depth_range().warning(inputs.options.depth);
  if (!depth.empty()) say(depth);
}

/// @return whether there were frames, and detections that belong to them, if there are any; else `error` is set
bool has_input(const RunInputs& inputs, const Counts& counts, std::string* error) {
  if (counts.frames == 0) {
    const std::optional<TrackingReport> tracking = inputs.source->report();
    *error = inputs.source->fault();
    if (!error->empty()) return false;
    *error = "no image has a pose" + (tracking ? ": " + tracking->warning() : std::string());
    const std::string depth = inputs.source->depth_range().warning(inputs.options.depth);
    if (!depth.empty()) *error += "; " + depth;
    return false;
  }
  if (counts.with_detections > 0 || inputs.detections.empty()) return true;
  *error = "no detection has the stamp of a pose: the first of each are " + std::to_string(counts.first_ns) +
           " ns (pose) and " + std::to_string(inputs.detections.front().stamp_ns) + " ns (detection)";
  return false;
}

/// @return false with `error` set if the inputs have no frame in common or a file cannot be written; and, without
/// results, when the source needs to be rewound
bool run_once(const RunInputs& inputs, RunRecorder* recorder, std::string* error) {
  ObjectSlam slam(inputs.options, inputs.classes);
  if (inputs.earlier_map) slam.set_earlier_map(*inputs.earlier_map);
  FrameBuilder builder(inputs.options.keyframe, inputs.camera);
  PointMap point_map(inputs.options.point_map);
  ExtraLoops extra_loops(inputs.extra_loops);
  Progress progress(inputs.source->total());
  Counts counts;
  const std::vector<Detection> none;
  const Stopwatch stopwatch;
  while (const std::optional<PoseSample> sample = inputs.source->next()) {
    if (const std::optional<Camera> camera = inputs.source->camera()) builder.set_camera(*camera);
    std::optional<Frame> frame = builder.build(*sample, error);
    if (!frame) return false;
    if (frame->is_keyframe && !inputs.points.empty()) {
      frame->keyframe_points = inputs.source->keyframe_points(inputs.options.point_map.semi_dense_max);
    }
    const DetectionFrame* detections = find_stamp(inputs.detections, frame->stamp_ns, kStampTolerance_ns);
    if (detections != nullptr) ++counts.with_detections;
    const std::vector<Detection>& boxes = detections != nullptr ? detections->detections : none;
    const FrameResult result = slam.process(*frame, boxes, extra_loops.at(*frame));
    point_map.add(*frame);
    point_map.apply(result.correction);
    record(*frame, result, recorder);
    if (counts.frames++ == 0) counts.first_ns = frame->stamp_ns;
    counts.last_ns = frame->stamp_ns;
    progress.show(inputs.source->done());
  }
  if (inputs.source->needs_rewind() || !has_input(inputs, counts, error)) return false;
  const Frame end = builder.end();
  const FrameResult last = slam.process(end, none);
  point_map.apply(last.correction);
  record(end, last, recorder);
  if (const std::optional<TrackingReport> tracking = inputs.source->report()) recorder->record(*tracking);
  if (!inputs.points.empty() && !write_point_cloud(inputs.points, point_map.points(), error)) return false;
  if (!inputs.save_map.empty() && !write_submaps(inputs.save_map, slam.submaps_in_map(), error)) return false;

  const double seconds = 1e-6 * stopwatch.elapsed_us();
  const double recorded = 1e-9 * static_cast<double>(counts.last_ns - counts.first_ns);
  warn(inputs, counts, extra_loops.left());
  std::printf("%zu frames in %.2f s, %.1f x real time\n", counts.frames, seconds, recorded / seconds);
  return true;
}

}  // namespace

std::optional<RunRecorder> run_chain(const RunInputs& inputs, std::string* error) {
  RunRecorder recorder(inputs.classes);
  bool is_done = run_once(inputs, &recorder, error);
  while (inputs.source->needs_rewind() && inputs.source->rewind(error)) {
    std::printf("the calibration was corrected: from the first image again\n");
    recorder = RunRecorder(inputs.classes);
    is_done = run_once(inputs, &recorder, error);
  }
  if (!is_done) return std::nullopt;
  return recorder;
}

}  // namespace semantic_topo_loop::apps
