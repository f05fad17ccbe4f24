#pragma once

#include "semantic_topo_loop/types/eigen.h"
#include "semantic_topo_loop/types/solved_motion.h"

namespace semantic_topo_loop::core {

/// Squares of what was found, over how many of them are determined: a variance.
struct VarianceEvidence {
  double squares = 0.0, count = 0.0;
};

/// Learns how far an odometry is off over some seconds from windows in which it was solved for with what was in view
/// (MacKay's fixed point): of each error its square, over the degrees of freedom that the view determines. In seconds,
/// metres and radians: any frame rate.
class ShortTermNoiseEstimator {
 public:
  /// An error that was found. @param error of a step's motion, behind it (m, rad)   @param variances that are left of
  /// it
  /// @param prior its variances before   @param all of the kind so far, in sigmas of the prior
  void add_step(const Vec6& error, const Vec6& variances, const Vec6& prior, double duration_s, VarianceEvidence* all) {
    add(error, variances, prior, 1.0 / duration_s, &step_translation_, &step_rotation_, all);
  }
  /// The same of a drift (m/s, rad/s).
  void add_drift(const Vec6& error, const Vec6& variances, const Vec6& prior, VarianceEvidence* all) {
    add(error, variances, prior, 1.0, &drift_translation_, &drift_rotation_, all);
  }
  /// Evidence is worth less as time passes.
  void forget(double elapsed_s);
  ShortTermNoise noise() const;

 private:
  static void add(const Vec6& error, const Vec6& variances, const Vec6& prior, double per_square,
                  VarianceEvidence* translation, VarianceEvidence* rotation, VarianceEvidence* all);

  VarianceEvidence step_translation_, step_rotation_, drift_translation_, drift_rotation_;
};

}  // namespace semantic_topo_loop::core
