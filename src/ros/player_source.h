#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/pipeline/read_ahead.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {

/// What the player publishes for one image: first the transforms, then the camera_info that stands for the image, then
/// the image itself, where a front end is to track it.
struct PlayerItem {
  std::vector<tf2_msgs::TFMessage> transforms;  ///< recorded up to a little after the image, so that none is awaited
  sensor_msgs::CameraInfo camera_info;          ///< stamped as the image
  sensor_msgs::ImageConstPtr color, depth;      ///< both stamped as camera_info; null where none are played
  std::string left_out;                         ///< if not empty: no image after all, and why
  std::string detail;                           ///< of left_out
};

/// A recording, image by image.
class PlayerSource {
 public:
  virtual ~PlayerSource() = default;
  /// @return nullopt at the end; with `error` set if the recording ends there by a fault
  virtual std::optional<PlayerItem> next(std::string* error) = 0;
  /// Images in the recording, for the progress shown.
  virtual std::size_t size() const = 0;
};

/// The stamps of a trajectory file.
class FileStamps : public PlayerSource {
 public:
  FileStamps(core::StampedPoses trajectory, sensor_msgs::CameraInfo camera_info)
      : trajectory_(std::move(trajectory)), camera_info_(std::move(camera_info)) {}
  std::optional<PlayerItem> next(std::string* error) override;
  std::size_t size() const override { return trajectory_.size(); }

 private:
  core::StampedPoses trajectory_;
  sensor_msgs::CameraInfo camera_info_;
  std::size_t index_ = 0;
};

/// Another source, read in a thread of its own: compressed chunks of a bag take longer than a frame.
class ReadAheadSource : public PlayerSource {
 public:
  explicit ReadAheadSource(std::unique_ptr<PlayerSource> source);
  std::optional<PlayerItem> next(std::string* error) override;
  std::size_t size() const override { return size_; }

 private:
  std::unique_ptr<PlayerSource> source_;  ///< of the reading thread, once it runs
  const std::size_t size_;
  std::string fault_;  ///< written before the reading thread ends the stream, read after
  core::ReadAhead<PlayerItem> items_;
};

}  // namespace semantic_topo_loop
