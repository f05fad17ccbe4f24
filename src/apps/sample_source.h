#pragma once

#include <cstddef>
#include <future>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/frontend/keyframe_points.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/frontend/tracking_report.h"
#include "semantic_topo_loop/geometry/stamped_pose.h"
#include "semantic_topo_loop/io/rgbd_folder.h"

namespace semantic_topo_loop::apps {

/// Where the camera poses of a run come from.
class SampleSource {
 public:
  virtual ~SampleSource() = default;
  /// The next image that has a pose, or nullopt at the end.
  virtual std::optional<core::PoseSample> next() = 0;
  /// What the point map keeps of the last image, where there are images.
  virtual std::shared_ptr<const core::KeyframePoints> keyframe_points(int /*semi_dense_max*/) const { return nullptr; }
  /// Images gone through so far, and of all.
  virtual std::size_t done() const = 0;
  virtual std::size_t total() const = 0;
  /// What became of the images, where there are any.
  virtual std::optional<core::TrackingReport> report() const { return std::nullopt; }
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

/// Poses that the RGB-D front end finds for a folder of images. The next image is read while one is tracked.
class FolderSource : public SampleSource {
 public:
  FolderSource(std::vector<core::RgbdFile> files, const core::Camera& camera, const core::DepthOptions& depth,
               const core::FrontendOptions& frontend)
      : files_(std::move(files)), camera_(camera), depth_(depth), frontend_(frontend, camera) {
    read_ahead();
  }
  std::optional<core::PoseSample> next() override {
    while (done_ < files_.size()) {
      const Reading reading = pending_.get();
      ++done_;
      read_ahead();
      if (!reading.image) {
        report_.add_unreadable(reading.error);
        continue;
      }
      core::TrackedImage tracked = frontend_.track(*reading.image);
      last_image_ = *reading.image;
      report_.add(tracked);
      if (tracked.sample) return std::move(tracked.sample);
    }
    return std::nullopt;
  }
  std::shared_ptr<const core::KeyframePoints> keyframe_points(int semi_dense_max) const override {
    return std::make_shared<const core::KeyframePoints>(
        core::KeyframePoints{frontend_.sparse_points(), core::semi_dense_points(last_image_, camera_, semi_dense_max)});
  }
  std::size_t done() const override { return done_; }
  std::size_t total() const override { return files_.size(); }
  std::optional<core::TrackingReport> report() const override { return report_; }

 private:
  struct Reading {
    std::optional<core::RgbdImage> image;
    std::string error;
  };
  void read_ahead() {
    if (done_ == files_.size()) return;
    pending_ = std::async(std::launch::async, [this, file = files_[done_]] {
      Reading reading;
      reading.image = core::read_rgbd_image(file, camera_, depth_, &reading.error);
      return reading;
    });
  }

  std::vector<core::RgbdFile> files_;
  core::Camera camera_;
  core::DepthOptions depth_;
  core::RgbdFrontend frontend_;
  core::TrackingReport report_;
  core::RgbdImage last_image_;
  std::size_t done_ = 0;
  std::future<Reading> pending_;
};

}  // namespace semantic_topo_loop::apps
