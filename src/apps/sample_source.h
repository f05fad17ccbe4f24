#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/types/result.h"

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
  /// To the first image, the second time with what was learned of the camera.
  virtual core::Status rewind() { return core::Error{"the source cannot be rewound"}; }
  /// The color image of the last sample, CV_8UC3 as BGR, or an error if it cannot be read.
  virtual core::Result<cv::Mat> color() const { return core::Error{"the source has no images"}; }
  /// What the point map keeps of the last image, where there are images.
  virtual std::shared_ptr<const core::KeyframePoints> keyframe_points(int /*semi_dense_max*/) const { return nullptr; }
  const SourceState& state() const { return state_; }

 protected:
  SourceState state_;
};

/// Poses of a trajectory file.
std::unique_ptr<SampleSource> source_of_poses(core::StampedPoses poses);

/// Opens a recording at its first image.
using OpenRecording = std::function<core::Result<core::RgbdRecording>()>;
/// Poses that the RGB-D front end finds in a recording's images, which are read while others are tracked.
/// @return an error if the recording cannot be opened
core::Result<std::unique_ptr<SampleSource>> source_of_images(OpenRecording open_recording, core::RgbdFrontend frontend);

}  // namespace semantic_topo_loop::apps
