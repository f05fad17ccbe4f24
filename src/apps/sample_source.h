#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/frontend/rgbd_image.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/pipeline/read_ahead.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::apps {

/// How far a source is, and what became of its images where there are any.
struct SourceState {
  std::size_t done = 0, total = 0;  ///< images gone through so far, and of all
  /// The samples ended early because all of them should be found anew: the calibration was corrected.
  bool needs_rewind = false;
  std::optional<core::Camera> camera;          ///< of the last sample, where the source corrects its calibration
  std::optional<core::TrackingReport> report;  ///< of images
  core::DepthRange depth_range;                ///< of the images read so far
  std::string warning;                         ///< at the end: what was left out; empty if nothing
  std::string fault;                           ///< at the end: why the recording ended early; empty if it did not
};

/// Where the camera poses of a run come from.
class SampleSource {
 public:
  virtual ~SampleSource() = default;
  /// The next image that has a pose, or nullopt at the end.
  virtual std::optional<core::PoseSample> next() = 0;
  /// Back to the first image, with what was learned of the camera.
  virtual core::Status rewind() { return core::Error{"the source cannot be rewound"}; }
  /// What the point map keeps of the last image, where there are images.
  virtual std::shared_ptr<const core::KeyframePoints> keyframe_points(int /*semi_dense_max*/) const { return nullptr; }
  const SourceState& state() const { return state_; }

 protected:
  SourceState state_;
};

/// Poses of a trajectory file.
class TrajectorySource : public SampleSource {
 public:
  explicit TrajectorySource(core::StampedPoses poses) : poses_(std::move(poses)) { state_.total = poses_.size(); }
  std::optional<core::PoseSample> next() override {
    if (state_.done == poses_.size()) return std::nullopt;
    const core::StampedPose& pose = poses_[state_.done++];
    core::PoseSample sample;
    sample.stamp_ns = pose.stamp_ns;
    sample.T_odom_camera = pose.T_world_camera;
    return sample;
  }

 private:
  core::StampedPoses poses_;
};

/// Poses that the RGB-D front end finds in a recording's images, which are read while others are tracked.
class RgbdSource : public SampleSource {
 public:
  /// Opens the recording at its first image.
  using Open = std::function<core::Result<std::unique_ptr<core::RgbdRecording>>()>;

  static core::Result<std::unique_ptr<SampleSource>> open(Open open_recording, const core::Camera& camera,
                                                          const core::FrontendOptions& options) {
    std::unique_ptr<SampleSource> source(
        new RgbdSource(std::move(open_recording), core::RgbdFrontend(options, camera)));
    if (const core::Status opened = source->rewind(); !opened) return opened.error();
    return core::Result<std::unique_ptr<SampleSource>>(std::move(source));
  }

  std::optional<core::PoseSample> next() override {
    while (const std::optional<core::RgbdReading> reading = readings_->next()) {
      ++state_.done;
      if (!reading->left_out.empty()) {
        Cause& cause = left_out_[reading->left_out];
        if (cause.count++ == 0) cause.first = reading->image.message();
        continue;
      }
      if (!reading->image) {
        state_.report->add_unreadable(reading->image.message());
        continue;
      }
      state_.depth_range.add(reading->image->depth_range);
      core::TrackedImage tracked = frontend_.track(*reading->image);
      state_.needs_rewind = tracked.is_recalibrated;
      if (tracked.is_recalibrated) return std::nullopt;
      last_image_ = *reading->image;
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
  std::shared_ptr<const core::KeyframePoints> keyframe_points(int semi_dense_max) const override {
    return std::make_shared<const core::KeyframePoints>(frontend_.keyframe_points(last_image_, semi_dense_max));
  }
  core::Status rewind() override {
    readings_.reset();
    core::Result<std::unique_ptr<core::RgbdRecording>> opened = open_recording_();
    if (!opened) return opened.error();
    recording_ = *std::move(opened);
    if (state_.needs_rewind) frontend_.begin_anew();
    state_ = {};
    state_.total = recording_->total();
    state_.report.emplace();
    left_out_.clear();
    last_image_ = {};
    fault_.clear();
    readings_ = std::make_unique<core::ReadAhead<core::RgbdReading>>([this] { return read(); }, kReadAhead);
    return {};
  }

 private:
  static constexpr std::size_t kReadAhead = 8;

  RgbdSource(Open open_recording, core::RgbdFrontend frontend)
      : open_recording_(std::move(open_recording)), frontend_(std::move(frontend)) {}

  /// On the reading thread.
  std::optional<core::RgbdReading> read() {
    core::Result<std::optional<core::RgbdReading>> reading = recording_->next();
    fault_ = reading.message();
    return reading ? *std::move(reading) : std::nullopt;
  }

  struct Cause {
    std::size_t count = 0;
    std::string first;
  };

  Open open_recording_;
  std::unique_ptr<core::RgbdRecording> recording_;  ///< of the reading thread, once it runs
  core::RgbdFrontend frontend_;
  std::map<std::string, Cause> left_out_;  ///< images that the recording itself does not count
  core::RgbdImage last_image_;
  std::string fault_;                                             ///< written before the reading thread ends the stream
  std::unique_ptr<core::ReadAhead<core::RgbdReading>> readings_;  ///< last: its thread ends before what it uses
};

}  // namespace semantic_topo_loop::apps
