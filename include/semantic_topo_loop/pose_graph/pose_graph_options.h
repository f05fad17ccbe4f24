#pragma once

#include <string>

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// When the pose graph optimises, how it rejects false loops, and what it takes the odometry's noise to be.
struct PoseGraphOptions {
  std::string robust = "gnc";
  double robust_chi2 = 16.8;
  double gnc_loosening = 2.0;
  int interval_keyframes = 15;
  int min_interval_keyframes = 3;
  double urgent_chi2 = 25.0;
  bool estimate_noise = true;
  double translation_noise_m = 0.001;
  double rotation_noise_deg = 0.02;
  double noise_factor_max = 1000.0;
  double noise_evidence = 1.5;
  double max_redundancy = 8.0;
  int max_iterations = 30;
  std::string scale = "fixed";
  double scale_walk = 0.02;
  std::string objects = "auto";
  double object_sigma_px = 4.0;
  double object_sigma_share = 0.06;
  int object_views = 100;

  void visit(OptionVisitor& visitor) {
    visitor.module("pose_graph");
    visitor("robust", robust, one_of({"gnc", "cauchy", "huber", "none"}),
            "how false loops are kept out: gnc, cauchy, huber or none");
    visitor.live("robust_chi2", robust_chi2, positive(),
                 "squared error of a loop, in its sigmas, above which it is doubted");
    visitor("gnc_loosening", gnc_loosening, at_least(1),
            "loops are classified with the odometry's sigmas times this, so that right loops have room");
    visitor.live("interval_keyframes", interval_keyframes, at_least(1), "optimise new loops after this many keyframes");
    visitor.live("min_interval_keyframes", min_interval_keyframes, at_least(1),
                 "a loop that disagrees with the map is optimised after this many keyframes");
    visitor.live("urgent_chi2", urgent_chi2, not_negative(),
                 "squared disagreement of a new loop, in its sigmas, that is urgent");
    visitor("estimate_noise", estimate_noise,
            "learn the odometry's noise from the loops, where the source states none");
    visitor("translation_noise_m", translation_noise_m, positive(),
            "least odometry error after one metre of path (1 sigma; grows with the root of the path)");
    visitor("rotation_noise_deg", rotation_noise_deg, positive(),
            "least odometry error after one radian of rotation (1 sigma; grows with the root of the angle)");
    visitor("noise_factor_max", noise_factor_max, at_least(1), "greatest factor that is learnt on the least noise");
    visitor("noise_evidence", noise_evidence, not_negative(),
            "log likelihood that the loops must offer for each e-fold of noise above the least");
    visitor(
        "max_redundancy", max_redundancy, positive(),
        "a loop stays out of the graph if loops in it rest on its evidence so many times over; less in large graphs");
    visitor.live("max_iterations", max_iterations, at_least(1), "of one solve");
    visitor("scale", scale, one_of({"fixed", "free"}),
            "of the odometry: fixed, or free where it drifts (monocular; Sim(3) vertices)");
    visitor("scale_walk", scale_walk, above(0).at_most(0.5),
            "free scale: error of its logarithm after one metre of path (1 sigma; grows with the root of the path)");
    visitor(
        "objects", objects, one_of({"off", "auto", "on"}),
        "whether objects take part in corrections: off, auto (where odometry is found wrong, or broke) or on (in every "
        "one, and at the end of a run without loops, too); never with scale=free");
    visitor.live("object_sigma_px", object_sigma_px, positive(),
                 "noise of a box edge that all from about one direction share, constant part; 0.6 of it each has "
                 "besides; of an image 640 pixels wide, wider ones in proportion");
    visitor.live("object_sigma_share", object_sigma_share, not_negative(),
                 "noise of a box edge, share of the box size");
    visitor.live("object_views", object_views, at_least(4),
                 "keyframes that observe one object, spread evenly over all");
    visitor.require("min_interval_keyframes", min_interval_keyframes <= interval_keyframes,
                    "<= pose_graph.interval_keyframes");
  }
};

}  // namespace semantic_topo_loop::core
