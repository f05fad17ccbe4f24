#pragma once

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

struct QuadricMapperOptions {
  int min_views = 6;
  double min_baseline_deg = 6.0;
  int fit_views_max = 60;
  double refit_growth = 0.15;
  double max_depth_m = 6.0;
  double max_semi_axis_m = 2.5;
  double size_prior_factor = 6.0;
  double min_fit_iou = 0.3;
  double maintenance_interval_s = 1.0;
  bool merge_duplicates = true;
  double merge_iou = 0.3;
  double merge_iou_confusable = 0.5;
  double merge_veto_share = 0.25;
  double confirm_seen_s = 1.2;
  double confirm_baseline_deg = 10.0;
  double confirm_mean_iou = 0.5;
  double confirm_seen_share = 0.14;
  double confirm_quality = 0.3;
  double forget_candidate_s = 2.0;
  double forget_candidate_seen_s = 0.25;
  double forget_unconfirmed_s = 300.0;
  double retire_seen_share = 0.02;
  double retire_expected_s = 7.0;
  double retire_missed_s = 4.0;
  double retire_seen_through_s = 2.5;

  void visit(OptionVisitor& visitor) {
    visitor.module("mapping");
    visitor("min_views", min_views, at_least(3), "views before an ellipsoid is initialised");
    visitor("min_baseline_deg", min_baseline_deg, at_least(0).below(180),
            "parallax before an ellipsoid is initialised");
    visitor("fit_views_max", fit_views_max, any(), "views used in one fit, spread evenly over all");
    visitor("refit_growth", refit_growth, positive(), "refit when the views have grown by this share");
    visitor("max_depth_m", max_depth_m, positive(), "no ellipsoid from farther away (median depth)");
    visitor("max_semi_axis_m", max_semi_axis_m, positive(), "no larger ellipsoid");
    visitor.live("size_prior_factor", size_prior_factor, above(1),
                 "no ellipsoid larger or smaller than its class's typical diameter by more than this factor");
    visitor.live("min_fit_iou", min_fit_iou, share(), "mean overlap below which a fit is refused");
    visitor("maintenance_interval_s", maintenance_interval_s, positive(), "time between searches for duplicates");
    visitor.live("merge_duplicates", merge_duplicates, "whether landmarks that are one object become one");
    visitor.live("merge_iou", merge_iou, share(),
                 "overlap of one landmark's boxes with the other's projection, same class");
    visitor.live("merge_iou_confusable", merge_iou_confusable, share(), "the same for two classes of one group");
    visitor.live("merge_veto_share", merge_veto_share, share(),
                 "no merge if side by side for this share of the boxes of the less seen one");
    visitor.live("confirm_seen_s", confirm_seen_s, not_negative(),
                 "time for which a confirmed landmark was seen, and for half of it every side");
    visitor.live("confirm_baseline_deg", confirm_baseline_deg, at_least(0).below(180),
                 "parallax of a confirmed landmark");
    visitor.live("confirm_mean_iou", confirm_mean_iou, share(), "mean overlap of a confirmed landmark");
    visitor.live("confirm_seen_share", confirm_seen_share, share(), "seen / expected time of a confirmed landmark");
    visitor.live("confirm_quality", confirm_quality, share(), "quality rho of a confirmed landmark");
    visitor.live("forget_candidate_s", forget_candidate_s, positive(), "a candidate unseen for so long is given up");
    visitor.live("forget_candidate_seen_s", forget_candidate_seen_s, not_negative(),
                 "unless it was seen for this long");
    visitor.live("forget_unconfirmed_s", forget_unconfirmed_s, positive(),
                 "what is no object and unseen for so long is given up, however long it was seen");
    visitor.live("retire_seen_share", retire_seen_share, share(),
                 "a landmark is retired when seen / expected falls below");
    visitor.live("retire_expected_s", retire_expected_s, positive(), "and it was expected for this long");
    visitor.live(
        "retire_missed_s", retire_missed_s, positive(),
        "a movable landmark is retired when so much of its sightings is missed from familiar viewpoints since its "
        "last box");
    visitor.live("retire_seen_through_s", retire_seen_through_s, positive(),
                 "a landmark is retired when for this time since its last box depth shows what lies behind it");
    visitor.require("fit_views_max", fit_views_max >= min_views, ">= mapping.min_views");
  }
};

}  // namespace semantic_topo_loop::core
