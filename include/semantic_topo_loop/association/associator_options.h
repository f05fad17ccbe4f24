#pragma once

#include <string>

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

struct AssociatorOptions {
  std::string mode = "joint";
  std::string levels = "2d,pro,3d";
  std::string pro_new_object = "uniform";
  int boxes_max = 200;
  double min_score = 0.25;
  double iou_2d_min = 0.5;
  double iou_3d_min = 0.3;
  double points_in_box_min = 0.5;
  double iou_joint_2d_min = 0.4;
  double suppression_iou = 0.85;
  double border_px = 8.0;
  double memory_s = 0.3;
  double memory_decay_per_s = 1.8;
  double memory_decay_max = 0.36;
  double memory_weight = 0.9;
  double memory_iou_3d_min = 0.1;
  double iou_other_label_min = 0.5;
  double label_agreement_confusable = 0.5;
  double label_agreement_history = 0.8;
  double label_agreement_place = 0.3;
  double label_history_min_share = 0.1;
  double size_tolerance = 0.1;
  double mature_observations = 30.0;
  double mature_bonus = 0.15;
  int window_keyframes = 100;
  double posterior_alpha = 1.0;
  double posterior_count_max = 30.0;
  double range_m = 10.0;
  double jda_distance_max = 1.6;

  void visit(OptionVisitor& visitor) {
    visitor.module("association");
    visitor(
        "mode", mode, one_of({"joint", "cascade", "jda"}),
        "joint (one-to-one over overlap and labels), cascade (the paper's three levels) or jda (the paper's baseline)");
    visitor("levels", levels, {is_level_list, "a comma-separated list of 2d, pro, 3d"},
            "cascade mode: levels in use, comma separated: 2d, pro, 3d");
    visitor("pro_new_object", pro_new_object, one_of({"uniform", "paper"}),
            "level 2's prior of a new object: uniform (over labels and image) or paper (as printed)");
    visitor("boxes_max", boxes_max, at_least(1), "boxes of an image at most; those of the lowest scores are left out");
    visitor.live("min_score", min_score, share(), "detections below this score are left out");
    visitor.live("iou_2d_min", iou_2d_min, share(), "level 1 gate delta1: box overlap with the previous frame");
    visitor.live("iou_3d_min", iou_3d_min, share(), "level 3 gate delta2: box overlap with the projected quadric");
    visitor.live("points_in_box_min", points_in_box_min, share(),
                 "level 3 gate delta3: share of map points in the box");
    visitor.live("iou_joint_2d_min", iou_joint_2d_min, share(),
                 "joint mode: overlap gate for landmarks without a quadric");
    visitor.live("suppression_iou", suppression_iou, share(),
                 "of two boxes that overlap more, the lower score is left out");
    visitor.live(
        "border_px", border_px, not_negative(),
        "sides this close to the image border count as cut; of an image 640 pixels wide, wider ones in proportion");
    visitor.live("memory_s", memory_s, not_negative(), "joint mode: how long a box remains a track's last position");
    visitor.live("memory_decay_per_s", memory_decay_per_s, not_negative(),
                 "joint mode: share of its overlap that a last box loses in each second without the object");
    visitor.live("memory_decay_max", memory_decay_max, share(), "joint mode: the most that it loses");
    visitor.live("memory_weight", memory_weight, share(),
                 "joint mode: weight of the overlap with the last box where there is a quadric, whose overlap has 1");
    visitor.live(
        "memory_iou_3d_min", memory_iou_3d_min, share(),
        "joint mode: where there is a quadric, the last box counts only if the quadric overlaps at least so much");
    visitor.live("iou_other_label_min", iou_other_label_min, share(),
                 "joint mode: overlap gate for a box of another label than the landmark's");
    visitor.live("label_agreement_confusable", label_agreement_confusable, share(),
                 "joint mode: agreement of a label with another one of its group (1 with itself, 0 with others)");
    visitor.live("label_agreement_history", label_agreement_history, share(),
                 "joint mode: agreement with a label that the landmark has often had");
    visitor.live("label_agreement_place", label_agreement_place, share(),
                 "joint mode: agreement with any label of a landmark to which depth gives the same place and size");
    visitor.live("label_history_min_share", label_history_min_share, share(),
                 "joint mode: share of a landmark's summed scores from which on it has had a label often");
    visitor.live("size_tolerance", size_tolerance, not_negative(),
                 "boxes that depth makes larger or smaller than anything of their class, by this share, are left out");
    visitor.live("mature_observations", mature_observations, positive(),
                 "joint mode: boxes from which on a landmark is fully established (30 are a second at 30 Hz)");
    visitor.live("mature_bonus", mature_bonus, not_negative(),
                 "joint mode: share by which the score of an established landmark is higher");
    visitor("window_keyframes", window_keyframes, at_least(1),
            "level 3: landmarks seen in this many last keyframes (all in view in joint mode)");
    visitor.live("posterior_alpha", posterior_alpha, positive(), "level 2: concentration of the Dirichlet process");
    visitor.live("posterior_count_max", posterior_count_max, at_least(1),
                 "level 2: cap on a landmark's observation count");
    visitor.live("range_m", range_m, positive(), "landmarks farther from the camera are not looked for");
    visitor.live("jda_distance_max", jda_distance_max, above(0).at_most(3),
                 "jda mode: largest summed distance of a pair");
    visitor.require("levels", mode == "cascade" || levels == AssociatorOptions().levels,
                    AssociatorOptions().levels + " unless association.mode is cascade");
  }
  static bool is_level_list(const std::string& text);
};

}  // namespace semantic_topo_loop::core
