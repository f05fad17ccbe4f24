#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <vector>

#include "map/mapped_landmark.h"
#include "map/mapper_state.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

/// Which landmarks are one object.
class DuplicateTest {
 public:
  DuplicateTest(const QuadricMapperOptions& options, const ClassTable& classes)
      : options_(options), classes_(classes) {}

  /// True if b, the less observed one, is the same object as a: overlap of b's boxes with a's projection, and of one
  /// class and not seen side by side, or of two classes of a group, which a detector may give one thing at once; where
  /// depth places both, also one thing of two names: same place, about one size.
  bool is_duplicate(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const;
  /// True if b is a part of a that the detector boxed alone: little seen, inside a much-seen one of its class group.
  bool is_part(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const;
  /// True for two that reach into each other and may be one by their classes.
  bool may_be_pieces(const Landmark& a, const Landmark& b) const;
  /// Centres farther apart than this belong to two objects, whatever their boxes say.
  /// @param longest_a_m, longest_b_m their longest semi-axes
  static double reach_m(double longest_a_m, double longest_b_m);

 private:
  const QuadricMapperOptions& options_;
  const ClassTable& classes_;
};

/// A landmark as it was, without its observations, which stay with the survivor of the merge.
struct Remains {
  LandmarkRecord landmark;
  SE3 T_anchor_quadric;       ///< so that it can follow its keyframe meanwhile; in the odometry's unit of length
  double anchor_scale = 1.0;  ///< of its keyframe when it was given its semi-axes
};

struct MergeRecord {
  LandmarkMerge merge;
  Remains merged, survivor;
  std::vector<std::int64_t> sources;  ///< observations of these belong to the merged one
};

/// The merges of this session and earlier ones, also those that were taken back: what the map's file keeps of how its
/// objects came about. Bounded: the first are forgotten.
class MergeLog {
 public:
  explicit MergeLog(std::size_t capacity = 20'000) : capacity_(capacity) {}  // some 2 MB
  /// @param merge whose number follows from the last one's
  void add(LoggedMerge merge);
  /// Notes that the last such merge that is in force is no more.
  void take_back(const LandmarkMerge& merge, std::int64_t frame_id);
  void restore(const std::vector<LoggedMerge>& merges);
  std::vector<LoggedMerge> merges() const;
  /// Fills what is new in them since the last call, or all there is if the delta is whole.
  void take_delta(MapperDelta* delta);

 private:
  void forget_first();

  std::size_t capacity_;
  std::map<std::int64_t, LoggedMerge> merges_;  ///< by number
  std::set<std::int64_t> news_;                 ///< of `merges_`: what take_delta has not told of
};

/// The merges that were made, so that they can be taken back.
class MergeHistory {
 public:
  /// Moves everything that `merged` has seen into `survivor`.
  void join(const KeyframePlaces& S_map_keyframe, MappedLandmark merged, MappedLandmark* survivor);
  /// Takes back the last merge into `survivor` made, which must exist: the survivor gives up what it had taken over,
  /// and if nothing was added since, it is what it was.
  /// @return the landmark that comes back, its ellipsoid where its keyframe now is
  MappedLandmark split(const KeyframePlaces& S_map_keyframe, std::size_t record, MappedLandmark* survivor);

  const std::vector<MergeRecord>& records() const { return records_; }
  /// Where a landmark's remains stand now; nullopt without an ellipsoid.
  static std::optional<Ellipsoid> place(const KeyframePlaces& S_map_keyframe, const Remains& remains);
  /// The landmark that an id has become.
  std::int64_t resolve(std::int64_t id) const { return redirects_.resolve(id); }

 private:
  std::vector<MergeRecord> records_;  ///< in the order they were made
  LandmarkRedirects redirects_;
};

}  // namespace semantic_topo_loop::core
