#pragma once

#include <memory>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

struct AssociatorOptions;

/// MLV-ODA: associates the detections of each frame with landmarks. Alone allocates landmark ids and keeps the tracks
/// and class counts; geometry comes in by `apply`.
class ObjectAssociator {
 public:
  ObjectAssociator(const AssociatorOptions& options, std::shared_ptr<const ClassTable> classes);

  AssociationFrame associate(const Frame& frame, const std::vector<Detection>& detections);
  /// Of a frame at which the detector did not look: nothing is associated, and nothing is missed.
  AssociationFrame pass(const Frame& frame);
  /// New landmarks' ids are not below this from here on.
  void count_from(std::int64_t landmark_id);
  /// @return false if the update does not follow the version held, so that the caller must ask for the full map
  bool apply(const MapUpdate& update);
  std::uint64_t map_version() const;
  /// From the next frame on. @param options those that it has, but for live ones
  void set_options(const AssociatorOptions& options);

 private:
  struct Impl;
  std::unique_ptr<Impl, void (*)(Impl*)> impl_;
};

}  // namespace semantic_topo_loop::core
