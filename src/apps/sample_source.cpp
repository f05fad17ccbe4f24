#include "apps/sample_source.h"

#include <map>
#include <utility>

#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/pipeline/read_ahead.h"

namespace semantic_topo_loop::apps {
namespace {

using namespace semantic_topo_loop::core;

class TrajectorySource : public SampleSource {
 public:
  explicit TrajectorySource(StampedPoses poses) : poses_(std::move(poses)) { state_.total = poses_.size(); }
  std::optional<PoseSample> next() override {
    if (state_.done == poses_.size()) return std::nullopt;
    const StampedPose& pose = poses_[state_.done++];
    return PoseSample{pose.stamp_ns, pose.T_world_camera};
  }

 private:
  StampedPoses poses_;
};

class RgbdSource : public SampleSource {
 public:
  RgbdSource(OpenRecording open_recording, RgbdFrontend frontend)
      : open_recording_(std::move(open_recording)), frontend_(std::move(frontend)) {}

  std::optional<PoseSample> next() override {
    while (const std::optional<RgbdReading> reading = readings_->next()) {
      ++state_.done;
      if (!reading->left_out.empty()) {
        DetectionReport::Cause& cause = left_out_[reading->left_out];
        if (cause.count++ == 0) cause.first = reading->image.message();
        continue;
      }
      if (!reading->image) {
        state_.report->add_unreadable(reading->image.message());
        continue;
      }
      state_.depth_range.add(reading->image->depth_range);
      TrackedImage tracked = frontend_.track(*reading->image);
      state_.needs_rewind = tracked.is_recalibrated;
      if (tracked.is_recalibrated) return std::nullopt;
      last_reading_ = *reading;
      state_.camera = frontend_.camera();
      state_.report->add(tracked);
      if (tracked.sample) return std::move(tracked.sample);
    }
    state_.fault = fault_;
    for (const auto& [name, cause] : left_out_) {
      state_.warning += (state_.warning.empty() ? "" : "; ") + std::to_string(cause.count) + " " + name +
                        " (first: " + cause.first + ")";
    }
    return std::nullopt;
  }
  Result<cv::Mat> color() const override { return last_reading_->color(); }
  std::shared_ptr<const KeyframePoints> keyframe_points(int semi_dense_max) const override {
    return std::make_shared<const KeyframePoints>(frontend_.keyframe_points(*last_reading_->image, semi_dense_max));
  }
  Status rewind() override {
    readings_.reset();
    Result<RgbdRecording> opened = open_recording_();
    if (!opened) return opened.error();
    recording_ = *std::move(opened);
    if (state_.needs_rewind) frontend_.begin_anew();
    state_ = {};
    state_.total = recording_.total;
    state_.report.emplace();
    left_out_.clear();
    last_reading_.reset();
    fault_.clear();
    readings_ = std::make_unique<ReadAhead<RgbdReading>>([this] { return read(); }, kReadAhead);
    return {};
  }

 private:
  static constexpr std::size_t kReadAhead = 8;

  /// On the reading thread.
  std::optional<RgbdReading> read() {
    Result<std::optional<RgbdReading>> reading = recording_.next();
    fault_ = reading.message();
    return reading ? *std::move(reading) : std::nullopt;
  }

  OpenRecording open_recording_;
  RgbdRecording recording_;  ///< of the reading thread, once it runs
  RgbdFrontend frontend_;
  std::map<std::string, DetectionReport::Cause> left_out_;  ///< images that the recording itself does not count
  std::optional<RgbdReading> last_reading_;                 ///< of the last sample
  std::string fault_;                                       ///< written before the reading thread ends the stream
  std::unique_ptr<ReadAhead<RgbdReading>> readings_;        ///< last: its thread ends before what it uses
};

}  // namespace

std::unique_ptr<SampleSource> source_of_poses(StampedPoses poses) {
  return std::make_unique<TrajectorySource>(std::move(poses));
}

Result<std::unique_ptr<SampleSource>> source_of_images(OpenRecording open_recording, RgbdFrontend frontend) {
  auto source = std::make_unique<RgbdSource>(std::move(open_recording), std::move(frontend));
  if (const Status opened = source->rewind(); !opened) return opened.error();
  return Result<std::unique_ptr<SampleSource>>(std::move(source));
}

}  // namespace semantic_topo_loop::apps
