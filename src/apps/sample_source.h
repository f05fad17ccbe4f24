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

/// Where the camera poses of a run come from.
class SampleSource {
 public:
  virtual ~SampleSource() = default;
  /// The next image that has a pose, or nullopt at the end.
  virtual std::optional<core::PoseSample> next() = 0;
  /// Whether the samples ended early because all of them should be found anew: the calibration was corrected.
  virtual bool needs_rewind() const { return false; }
  /// Back to the first image, with what was learned of the camera.
  virtual core::Status rewind() { return core::Error{"the source cannot be rewound"}; }
  /// What the point map keeps of the last image, where there are images.
  virtual std::shared_ptr<const core::KeyframePoints> keyframe_points(int /*semi_dense_max*/) const { return nullptr; }
  /// Images gone through so far, and of all.
  virtual std::size_t done() const = 0;
  virtual std::size_t total() const = 0;
  /// The camera of the last sample, where the source corrects its calibration.
  virtual std::optional<core::Camera> camera() const { return std::nullopt; }
  /// What became of the images, where there are any.
  virtual std::optional<core::TrackingReport> report() const { return std::nullopt; }
  /// Where the depth of the images lies, as far as they were read.
  virtual core::DepthRange depth_range() const { return {}; }
  /// What was left out, once the end is reached; empty if nothing.
  virtual std::string warning() const { return {}; }
  /// Why the recording ended early, once the end is reached; empty if it did not.
  virtual std::string fault() const { return {}; }
};

/// Poses of a trajectory file.
class TrajectorySource : public SampleSource {
 public:
  explicit TrajectorySource(core::StampedPoses poses) : poses_(std::move(poses)) {}
  std::optional<core::PoseSample> next() override {
    if (done_ == poses_.size()) return std::nullopt;
    core::PoseSample sample;
    sample.stamp_ns = poses_[done_].stamp_ns;
    sample.T_odom_camera = poses_[done_].T_world_camera;
    ++done_;
    return sample;
  }
  std::size_t done() const override { return done_; }
  std::size_t total() const override { return poses_.size(); }

 private:
  core::StampedPoses poses_;
  std::size_t done_ = 0;
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
      ++done_;
      if (!reading->left_out.empty()) {
        left_out_.add(*reading);
        continue;
      }
      if (!reading->image) {
        report_.add_unreadable(reading->image.message());
        continue;
      }
      depth_range_.add(reading->image->depth_range);
      core::TrackedImage tracked = frontend_.track(*reading->image);
      if (tracked.is_recalibrated) {
        needs_rewind_ = true;
        return std::nullopt;
      }
      last_image_ = *reading->image;
      report_.add(tracked);
      if (tracked.sample) return std::move(tracked.sample);
    }
    is_at_end_ = true;
    return std::nullopt;
  }
  std::shared_ptr<const core::KeyframePoints> keyframe_points(int semi_dense_max) const override {
    return std::make_shared<const core::KeyframePoints>(core::KeyframePoints{
        frontend_.sparse_points(), core::semi_dense_points(last_image_, frontend_.camera(), semi_dense_max)});
  }
  bool needs_rewind() const override { return needs_rewind_; }
  core::Status rewind() override {
    readings_.reset();
    core::Result<std::unique_ptr<core::RgbdRecording>> opened = open_recording_();
    if (!opened) return opened.error();
    recording_ = *std::move(opened);
    if (needs_rewind_) frontend_.begin_anew();
    total_ = recording_->total();
    report_ = {};
    depth_range_ = {};
    left_out_ = {};
    last_image_ = {};
    done_ = 0;
    fault_.clear();
    needs_rewind_ = false;
    readings_ = std::make_unique<core::ReadAhead<core::RgbdReading>>([this] { return read(); }, kReadAhead);
    return {};
  }
  std::size_t done() const override { return done_; }
  std::size_t total() const override { return total_; }
  std::optional<core::Camera> camera() const override { return frontend_.camera(); }
  std::optional<core::TrackingReport> report() const override { return report_; }
  core::DepthRange depth_range() const override { return depth_range_; }
  std::string warning() const override { return left_out_.text(); }
  std::string fault() const override { return is_at_end_ ? fault_ : std::string(); }

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

  /// Images that the recording itself does not count, by cause.
  class LeftOut {
   public:
    void add(const core::RgbdReading& reading) {
      Cause& cause = causes_[reading.left_out];
      if (cause.count++ == 0) cause.first = reading.image.message();
    }
    std::string text() const {
      std::string text;
      for (const auto& [name, cause] : causes_) {
        text += (text.empty() ? "" : "; ") + std::to_string(cause.count) + " " + name + " (first: " + cause.first + ")";
      }
      return text;
    }

   private:
    struct Cause {
      std::size_t count = 0;
      std::string first;
    };
    std::map<std::string, Cause> causes_;
  };

  Open open_recording_;
  std::unique_ptr<core::RgbdRecording> recording_;  ///< of the reading thread, once it runs
  std::size_t total_ = 0;
  core::RgbdFrontend frontend_;
  core::TrackingReport report_;
  core::DepthRange depth_range_;
  LeftOut left_out_;
  core::RgbdImage last_image_;
  std::size_t done_ = 0;
  std::string fault_;  ///< written before the reading thread ends the stream
  bool is_at_end_ = false;
  bool needs_rewind_ = false;
  std::unique_ptr<core::ReadAhead<core::RgbdReading>> readings_;  ///< last: its thread ends before what it uses
};

}  // namespace semantic_topo_loop::apps
