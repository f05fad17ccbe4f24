#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <unordered_map>
#include <vector>

#include "geometry/word_index.h"
#include "loop/submap/graph_matcher.h"
#include "loop/submap/submap_refiner.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// Finds submaps that share pairs of objects with a query: an index over (label pair, distance), so that a query visits
/// the entries of its own pairs instead of every submap.
class SubmapIndex {
 public:
  /// @param max_returned of a query, those with most agreeing pairs
  explicit SubmapIndex(const LoopOptions& options, int max_returned = 40)
      : options_(options), max_returned_(max_returned) {}
  /// Submaps are numbered from 0 in the order of insertion.
  void insert(const std::vector<LabelledPoint>& points);
  /// @param points as they were inserted; the other submaps keep their numbers
  void erase(int number, const std::vector<LabelledPoint>& points);
  int size() const { return size_; }
  /// How many pairs of the query's objects each of the submaps 0 .. end - 1 shares.
  std::vector<int> agreeing_pairs(const std::vector<LabelledPoint>& points, int end) const;
  /// @param end submaps from this number on are left out   @return numbers, ascending
  std::vector<int> query(const std::vector<LabelledPoint>& points, int end) const;

 private:
  using Key = std::uint64_t;
  static Key key(int label_p, int label_q, int bin);
  int bin(double distance_m) const;

  LoopOptions options_;
  int max_returned_, size_ = 0;
  std::unordered_map<Key, std::vector<int>> submaps_of_;  ///< looked up only, never iterated over; each ascending
};

/// How well one submap's objects, moved by an alignment, explain the other submap's detections.
struct Reprojection {
  double ratio = 0.0;  ///< matched over expected boxes; expected ones are weighed by how often the object is detected
  int objects = 0;     ///< objects matched in more than 30 % of the frames that should see them
  double explained = 0.0;  ///< share of the detections that an object explains
};

struct Verdict {
  LoopReason reason = LoopReason::kAccepted;
  double tilt_deg = 0.0;                     ///< between the two up directions, 0 if one of them is uncertain
  std::optional<Reprojection> reprojection;  ///< each figure the worse of both ways; none if a test before it failed
};

/// The acceptance tests of an alignment between two submaps: enough objects and classes, spread out and well aligned,
/// no alternative nearly as good, not mirrored, upright, and each side's detections explained by the other side's
/// objects.
/// @param second_score of the best distinct alternative   @return the first test that fails, or kAccepted
Verdict verify_alignment(const LocalMap& a, const LocalMap& b, const GraphMatch& match, double second_score,
                         const LoopOptions& options);
/// True if the matched objects lie in a plane, and the two submaps' cameras on different sides of it: then one is the
/// mirror image of the other, which no residual shows.
/// @param max_rms_m from a plane; beyond, the residual of a mirror image would show it
bool is_mirrored(const LocalMap& a, const LocalMap& b, const GraphMatch& match, double max_rms_m);
/// Angle between the two up directions, rad; 0 if one of them is uncertain.
double tilt(const LocalMap& a, const LocalMap& b, const SE3& T_a_b);

/// Loops between the submap of the last seconds and all earlier ones, by their object graphs; where those find none,
/// and no odometry leads there, by points that look alike.
class GraphDetector {
 public:
  explicit GraphDetector(const LoopOptions& options);
  /// @param options those that it has, but for live ones, of which the index has none
  void set_options(const LoopOptions& options) { options_ = options; }

  /// Matches the submap with those kept at least `min_gap_s` before it.
  /// @return the best candidate, then those whose place was compared least recently, then all others; last what points
  /// found
  std::vector<LoopClosure> detect(const LocalMap& query);
  /// Keeps the submap for later queries if it spans enough time and the last one kept is old enough. Where enough are
  /// kept that see the same place alike, the poorest of them goes: memory and time grow with what there is to see, not
  /// with how often it is seen.
  void store(LocalMap map);
  /// Keeps the submap in any case.
  void insert(LocalMap map);

  struct StoredMap {
    LocalMap map;
    std::vector<LabelledPoint> points;
    std::int64_t compared_ns = -1;  ///< stamp of the last query that was compared with its place, surfaces and all
  };
  /// Submaps kept, by number in the order they came.
  const std::map<int, StoredMap>& submaps() const { return maps_; }
  /// The kept submap that tells best of a keyframe: it spans the frame, and its anchor is nearest in time.
  /// @return its number, or nullopt if none spans the frame
  std::optional<int> submap_about(std::int64_t frame_id, std::int64_t stamp_ns) const;

  /// What detect() would have made of a pair of kept submaps.
  struct Comparison {
    int agreeing_pairs = 0;              ///< pairs of objects that agree in labels and distance
    bool proposed = false;               ///< by the index
    std::optional<LoopClosure> closure;  ///< none if no alignment of enough objects exists
  };
  /// Compares two kept submaps as if the later one had just come. Changes nothing.
  Comparison compare(int query, int match) const;

 private:
  struct Candidate {
    int stored = 0;
    GraphMatch alignment;  ///< a: match, b: query
    double second_score = 0.0;
    Verdict verdict;
  };
  /// The first number whose submap is not `min_gap_s` older than the query.
  int old_enough(const LocalMap& query) const;
  /// Submaps worth matching, of the numbers below `end`.
  std::vector<int> propose(const std::vector<LabelledPoint>& points, int end) const;
  const LocalMap& match_of(const Candidate& candidate) const { return maps_.at(candidate.stored).map; }
  static bool is_accepted(const Candidate& candidate) { return candidate.verdict.reason == LoopReason::kAccepted; }
  /// Fewer objects than a loop needs whose surfaces do not confirm it.
  bool has_few(const Candidate& candidate) const {
    return static_cast<int>(candidate.alignment.pairs.size()) < options_.min_inliers;
  }
  void make_room(const LocalMap& map);
  std::vector<int> find_alike(const LocalMap& map) const;
  /// Aligns and verifies the query with the submaps of these numbers.
  std::vector<Candidate> examine(const LocalMap& query, const std::vector<LabelledPoint>& points,
                                 const std::vector<int>& numbers) const;
  void find_ambiguous(const LocalMap& query, std::vector<Candidate>* candidates) const;
  void select(std::vector<Candidate>* candidates) const;
  void mark_compared(const LocalMap& match, std::int64_t query_ns);
  LoopClosure finish(const LocalMap& query, const Candidate& candidate) const;
  std::optional<LoopClosure> find_by_points(const LocalMap& query) const;

  LoopOptions options_;
  SubmapIndex index_;
  WordIndex words_;  ///< of their features, by number
  std::map<int, StoredMap> maps_;
};

}  // namespace semantic_topo_loop::core
