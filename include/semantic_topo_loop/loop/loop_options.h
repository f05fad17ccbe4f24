#pragma once

#include <string>

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// Parameters of loop detection. The defaults are one set for all sequences.
struct LoopOptions {
  bool enabled = true;
  std::string mode = "graph";
  std::string score = "corrected";
  std::string scale = "fixed";
  double min_gap_s = 16.0;
  int max_candidates = 4;
  double attempt_interval_s = 0.3;

  double window_s = 15.0;
  double min_window_s = 6.0;
  double window_sigma_deg = 1.0;
  double frame_interval_s = 0.09;
  double store_interval_s = 2.0;
  int min_views = 6;
  double min_parallax_deg = 5.0;
  double min_seen_share = 0.12;
  double max_depth_m = 6.0;
  double max_radius_m = 1.5;
  int fit_views = 15;
  double up_window_s = 33.0;

  double size_ratio_log = 0.7;
  double distance_tolerance_m = 0.06;
  double distance_tolerance_share = 0.03;
  double min_distance_m = 0.05;
  double inlier_distance_m = 0.12;

  int min_inliers = 6;
  int min_confirmed_inliers = 4;
  int min_labels = 3;
  double max_rms_m = 0.09;
  double min_spread_m = 0.05;
  double ambiguity_ratio = 1.3;
  double reprojection_iou = 0.3;
  double min_reprojection_ratio = 0.4;
  int min_reprojected_objects = 4;
  double min_explained_share = 0.25;
  double max_tilt_deg = 20.0;

  int refine_views = 8;
  double refine_sigma_px = 4.0;
  double refine_sigma_share = 0.06;
  double refine_max_residual = 1.2;
  double refine_max_shift_m = 0.35;
  double refine_max_shift_deg = 15.0;
  double covariance_inflation = 2.0;
  double max_sigma_m = 0.15;
  double max_sigma_deg = 4.5;
  bool use_points = true;

  int paper_min_common = 3;
  int paper_min_gap_frames = 1000;
  double paper_window_s = 5.0;
  double paper_printed_min_score = 6.0;
  double paper_corrected_min_score = 0.12;
  int paper_consistency = 3;

  void visit(OptionVisitor& visitor) {
    visitor.module("loop");
    visitor.live("enabled", enabled, "look for loops");
    visitor("mode", mode, one_of({"graph", "paper"}), "graph (local object graphs) or paper (shared landmarks)");
    visitor("score", score, one_of({"corrected", "printed"}), "paper mode: corrected or printed");
    visitor("scale", scale, one_of({"fixed", "free"}),
            "graph mode: fixed, or free for an odometry whose scale drifts (monocular)");
    visitor("min_gap_s", min_gap_s, positive(), "graph mode: no loop between submaps closer in time");
    visitor.live("max_candidates", max_candidates, at_least(1), "loops accepted an attempt at most");
    visitor.live("attempt_interval_s", attempt_interval_s, not_negative(),
                 "loops are looked for this often; paper mode: and at keyframes");
    visitor("window_s", window_s, positive(), "graph mode: time span of a submap, at most");
    visitor("min_window_s", min_window_s, positive(), "and at least, however poor the odometry is");
    visitor("window_sigma_deg", window_sigma_deg, positive(),
            "what may be in doubt of the orientation at the ends of a submap, once it is solved (1 sigma)");
    visitor("frame_interval_s", frame_interval_s, not_negative(), "frames of a submap are at least this far apart");
    visitor("store_interval_s", store_interval_s, positive(), "a submap is kept for later matches every so often");
    visitor("min_views", min_views, at_least(3), "frames of a submap that see an object, at least");
    visitor("min_parallax_deg", min_parallax_deg, positive(), "largest angle between two rays to an object, at least");
    visitor("min_seen_share", min_seen_share, share(),
            "share of the frames with an object in view that detect it, at least");
    visitor("max_depth_m", max_depth_m, positive(), "no object of a submap is farther away");
    visitor("max_radius_m", max_radius_m, positive(), "no object of a submap is larger");
    visitor("fit_views", fit_views, at_least(3), "boxes used to fit one object of a submap");
    visitor("up_window_s", up_window_s, positive(), "time over which the up direction is estimated");
    visitor("size_ratio_log", size_ratio_log, positive(),
            "two objects may correspond if the log of their size ratio is below, in magnitude");
    visitor("distance_tolerance_m", distance_tolerance_m, positive(),
            "two correspondences agree if their distances differ less");
    visitor("distance_tolerance_share", distance_tolerance_share, not_negative(), "plus this share of the distance");
    visitor("min_distance_m", min_distance_m, not_negative(), "objects closer to each other say nothing");
    visitor("inlier_distance_m", inlier_distance_m, positive(),
            "an object is an inlier of an alignment within this distance");
    visitor.live("min_inliers", min_inliers, at_least(4), "aligned objects of an accepted loop");
    visitor.live("min_confirmed_inliers", min_confirmed_inliers, at_least(4),
                 "the same where surfaces confirm the loop");
    visitor.live("min_labels", min_labels, at_least(1), "different classes of an accepted loop");
    visitor.live("max_rms_m", max_rms_m, positive(), "alignment error of an accepted loop");
    visitor.live("min_spread_m", min_spread_m, not_negative(), "second singular value of the aligned objects' spread");
    visitor.live("ambiguity_ratio", ambiguity_ratio, at_least(1), "score over that of the best distinct alternative");
    visitor.live("reprojection_iou", reprojection_iou, share(), "overlap of a projected object with its detection");
    visitor.live("min_reprojection_ratio", min_reprojection_ratio, share(), "matched over expected boxes, both ways");
    visitor.live("min_reprojected_objects", min_reprojected_objects, at_least(1),
                 "objects that reproject well, both ways");
    visitor.live("min_explained_share", min_explained_share, share(), "share of the detections explained, both ways");
    visitor.live("max_tilt_deg", max_tilt_deg, positive(), "angle between the up directions of the two submaps");
    visitor("refine_views", refine_views, at_least(1), "boxes of each object and side in the refinement");
    visitor(
        "refine_sigma_px", refine_sigma_px, positive(),
        "standard deviation of a box edge in the refinement; of an image 640 pixels wide, wider ones in proportion");
    visitor("refine_sigma_share", refine_sigma_share, not_negative(), "plus this share of the box size");
    visitor.live("refine_max_residual", refine_max_residual, positive(),
                 "median box residual after refinement, standard deviations");
    visitor.live("refine_max_shift_m", refine_max_shift_m, positive(),
                 "the refinement may move the alignment this far");
    visitor.live("refine_max_shift_deg", refine_max_shift_deg, positive(), "and turn it this far");
    visitor("covariance_inflation", covariance_inflation, positive(), "factor on the refinement's standard deviations");
    visitor.live("max_sigma_m", max_sigma_m, positive(), "stated error of an accepted loop's translation, at most");
    visitor.live("max_sigma_deg", max_sigma_deg, positive(), "stated error of an accepted loop's rotation, at most");
    visitor("use_points", use_points, "graph mode: points that come with the frames refine and check the loops");
    visitor("paper_min_common", paper_min_common, at_least(3), "paper mode: th_objs, common landmarks of a candidate");
    visitor("paper_min_gap_frames", paper_min_gap_frames, at_least(1),
            "paper mode: th_ids, frames between the keyframes");
    visitor("paper_window_s", paper_window_s, positive(),
            "paper mode: time before a keyframe that its node centres come from");
    visitor("paper_printed_min_score", paper_printed_min_score, not_negative(),
            "paper mode: threshold of the printed score");
    visitor("paper_corrected_min_score", paper_corrected_min_score, not_negative(),
            "paper mode: threshold of the corrected score");
    visitor("paper_consistency", paper_consistency, at_least(1), "paper mode: consecutive keyframes that must agree");
    visitor.require("min_window_s", min_window_s <= window_s, "<= loop.window_s");
  }
};

}  // namespace semantic_topo_loop::core
