#pragma once

#include <cstdint>
#include <string>
#include <utility>

#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {

/// How far apart the stamps of an image and of its detections or recorded pose may be.
constexpr std::int64_t kStampToleranceNs = 1000;

/// How long poses are kept, s: longer than any image waits for its own.
constexpr double kKeepPoses_s = 60.0;

/// Where PoseFrontend gets the camera's pose at the stamp of an image from. Not thread-safe.
class PoseSource {
 public:
  enum class Status {
    kFound,
    kNotYet,  ///< a pose may still arrive
    kNever,   ///< no later pose can help
  };
  struct Answer {
    Status status = Status::kNotYet;
    core::PoseSample sample;  ///< if found; its stamp is the one asked for
    std::string problem;      ///< else why not
  };

  virtual ~PoseSource() = default;
  /// @param camera_frame tf frame of the camera's optical frame
  virtual Answer at(std::int64_t stamp_ns, const std::string& camera_frame) = 0;
  /// A new session begins: the next pose has no predecessor.
  virtual void reset() {}
};

/// Poses of a trajectory file, at its own stamps only.
class FilePoses : public PoseSource {
 public:
  explicit FilePoses(core::StampedPoses trajectory) : trajectory_(std::move(trajectory)) {}
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;

 private:
  core::StampedPoses trajectory_;
};

}  // namespace semantic_topo_loop
