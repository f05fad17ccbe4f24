#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/solved_motion.h"

namespace semantic_topo_loop::core {

struct LocalMap;
struct SubmapDelta;
struct LoopOptions;

/// What became of a pair of keyframes.
enum class PairStatus : std::uint8_t {
  kVerified = 0,         ///< it reached verification in the run
  kUnknownKeyframe = 1,  ///< the run has no such keyframe
  kWrongOrder = 2,       ///< the query is not the later one
  kNoSubmap = 3,         ///< no submap was kept about one of them: a break, too few objects or too little time
  kTooRecent = 4,        ///< closer in time than `min_gap_s`
  kNotProposed = 5,      ///< the index preferred other submaps
  kNoAlignment = 6,      ///< the submaps share no group of objects whose distances agree
  kNotAttempted = 7,     ///< the submaps can be compared, but were not: loop closing was off, or another mode
};

const char* to_string(PairStatus status);

/// Answer to the question why two keyframes were closed, or were not.
struct LoopExplanation {
  PairStatus status = PairStatus::kUnknownKeyframe;
  std::string text;  ///< in words, with each figure beside its threshold
  /// kVerified: what the run decided, without covariances and matches; otherwise what a comparison for this answer
  /// gives, if there was one. Its keyframes are the anchors of the submaps that were compared.
  std::optional<LoopClosure> closure;
};

/// Decision and figures of a candidate of graph mode, each with the threshold that applies.
std::string describe(const LoopFigures& loop, const LoopOptions& options);

/// QLT-SLC: recognises places by the semantic topology of their objects, in `graph` or `paper` mode.
class LoopDetector {
 public:
  LoopDetector(const LoopOptions& options, std::shared_ptr<const ClassTable> classes);

  /// Keeps landmark quality, states and merge redirects up to date. Call it with every update, in order.
  void apply(const MapUpdate& update);
  /// Takes in a frame, and looks for loops if it is time. Call after `apply` of the frame's observation update.
  /// @return every candidate that reached verification, accepted or not
  std::vector<LoopClosure> detect(const Frame& frame, const AssociationFrame& associations);
  /// Graph mode: how the camera moved about the last frame given to detect(), solved for with the objects in view: from
  /// the middle of the last seconds on, each keyframe to the next. What comes later holds. Empty for most frames, and
  /// while loop closing is off.
  const std::vector<SolvedMotion>& motions() const;
  /// Graph mode: by how much the odometry's poses are taken to be late against the images; negative: early. 0 unless it
  /// is evident.
  double odometry_delay_s() const;
  /// From the next frame on; what is explained later is explained by them. While they are not enabled, frames are taken
  /// in all the same. @param options those that it has, but for live ones
  void set_options(const LoopOptions& options);
  /// Why two keyframes of the run were closed, or were not. Pairs that the run did not compare are compared for the
  /// answer; nothing changes by it.
  LoopExplanation explain(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const;

  /// Graph mode: looks for the place in an earlier run's submaps, too (io/map_file.h). Call it before the first
  /// frame.
  void set_earlier_map(std::vector<LocalMap> submaps);
  /// Where the run is in the earlier run's map; nullopt until it is known.
  std::optional<Relocalisation> relocalisation() const;
  /// Goes on with the submaps of earlier sessions, poses in the map: loops into them are loops of one graph. Call it
  /// before the first frame.
  /// @param keyframes of these sessions   @param refused candidates of them, which `explain` knows
  void restore(std::vector<LocalMap> submaps, const std::vector<KeyframePose>& keyframes,
               const std::vector<LoopFigures>& refused);
  /// Graph mode: looks for the places of another map in the submaps kept so far.
  /// @return every candidate that reached verification, accepted or not
  std::vector<LoopClosure> detect(const std::vector<LocalMap>& queries);
  /// The submaps kept so far, poses in the odometry's world; those of earlier sessions in the map.
  std::vector<LocalMap> submaps() const;
  /// The latest decision on each pair of keyframes whose candidate was refused, in order of query and match; of the
  /// earlier run's submaps none. Bounded: those of the earliest queries are forgotten.
  std::vector<LoopFigures> refused() const;
  /// While places are fixed, no submap is kept; loops into those that are there are found.
  void set_fixed(bool fixed);
  /// What is new in them, and in what was refused, since the last call, or all there is. @param whole also if it was
  /// told before
  SubmapDelta take_delta(bool whole);

 private:
  struct Impl;
  std::unique_ptr<Impl, void (*)(Impl*)> impl_;
};

}  // namespace semantic_topo_loop::core
