#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "semantic_topo_loop/loop/loop_explanation.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

struct LocalMap;
struct LoopOptions;

/// QLT-SLC: recognises places by the semantic topology of their objects, in `graph` or `paper` mode.
class LoopDetector {
 public:
  LoopDetector(const LoopOptions& options, std::shared_ptr<const ClassTable> classes);
  ~LoopDetector();
  LoopDetector(LoopDetector&&) noexcept;
  LoopDetector& operator=(LoopDetector&&) noexcept;

  /// Keeps landmark quality, states and merge redirects up to date. Call it with every update, in order.
  void apply(const MapUpdate& update);
  /// Takes in a frame; at keyframes looks for loops. Call after `apply` of the frame's observation update.
  /// @return every candidate that reached verification, accepted or not
  std::vector<LoopClosure> detect(const Frame& frame, const AssociationFrame& associations);
  /// Loop closing can be switched at run time; frames are taken in all the same.
  void set_enabled(bool enabled);
  /// Why two keyframes of the run were closed, or were not. Pairs that the run did not compare are compared for the
  /// answer; nothing changes by it.
  LoopExplanation explain(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const;

  /// Graph mode: looks for the place in an earlier run's submaps, too (io/submap_file.h). Call it before the first
  /// frame.
  void set_earlier_map(std::vector<LocalMap> submaps);
  /// Where the run is in the earlier run's map, by the last accepted loops into it.
  std::optional<Relocalisation> relocalisation() const;
  /// The submaps kept so far, poses in the odometry's world.
  std::vector<LocalMap> submaps() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace semantic_topo_loop::core
