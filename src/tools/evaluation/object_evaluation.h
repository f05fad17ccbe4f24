#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/types/result.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop::core {

/// How sure we are that the object is there: certain ones must be found, the others may be.
enum class Certainty { kCertain, kProbable, kMarginal };
constexpr std::array<const char*, 3> kCertaintyNames = {"certain", "probable", "marginal"};
inline const char* name_of(Certainty certainty) { return kCertaintyNames[static_cast<std::size_t>(certainty)]; }

struct ReferenceObject {
  int id = -1;
  int class_id = -1;
  std::string label;
  Vec3 center = Vec3::Zero();     ///< reference frame, m
  Vec3 semi_axes = Vec3::Ones();  ///< m
  Certainty certainty = Certainty::kCertain;
};

/// Reads reference objects: the columns id, label_id, label, x, y, z, a, b, c and certainty; others do no harm.
/// @return an error, with file, line, column and value
Result<std::vector<ReferenceObject>> read_reference_objects(const std::string& path);

/// @return an error if a label has another id in the run's class table than in the reference
Status check_labels(const std::vector<MappedObject>& objects, const std::vector<ReferenceObject>& references);

/// Precision and recall with their counts.
struct Detectability {
  Ratio precision, recall;
  /// Harmonic mean, 0 if either is 0.
  double f() const {
    const double p = precision.value(), r = recall.value();
    return p + r > 0.0 ? 2.0 * p * r / (p + r) : 0.0;
  }
};

struct ObjectMatchResult {
  std::int64_t object_id = -1;  ///< of the run, -1: missed
  int reference_id = -1;        ///< -1: false
  double distance_m = 0.0;
};

struct ObjectEvaluation {
  Detectability certain;     ///< probable and marginal objects are neither right nor wrong
  Detectability strict;      ///< probable ones required too, everything else unmatched wrong
  Ratio undisputed;          ///< the paper's rule: constructed objects with no other one nearby
  ErrorStatistics center_m;  ///< distances of the objects matched with certain references
  int matched_certain = 0, matched_probable = 0, matched_marginal = 0;
  std::vector<ObjectMatchResult> matches;  ///< every confirmed object and every missed certain reference
};

/// Matches the confirmed objects with the reference: same class, centre within max(0.15 m, half the largest semi-axis)
/// of the reference, one to one with the most pairs and then the least distance; certain references first, then
/// probable, then marginal.
/// @param alignment takes the map frame to the reference frame
ObjectEvaluation evaluate_objects(const std::vector<MappedObject>& objects,
                                  const std::vector<ReferenceObject>& references, const Alignment& alignment);

}  // namespace semantic_topo_loop::core
