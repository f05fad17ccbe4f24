#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "semantic_topo_loop/types/box.h"

namespace semantic_topo_loop::core {

/// One box of an object detector, in pixels of the raw (distorted) image.
struct Detection {
  int class_id = -1;
  double score = 0.0;  ///< [0, 1]
  Box box;
};

/// All boxes of one image; empty when the detector ran and saw nothing.
struct DetectionFrame {
  std::int64_t stamp_ns = 0;
  std::vector<Detection> detections;
  bool unanswered = false;  ///< the detector did not look at the image
};

/// How a detection came to its landmark, or why it has none.
enum class AssociationLevel : std::uint8_t {
  kNew = 0,         ///< starts a landmark
  k2d = 1,          ///< level 1: box overlap with a recent frame
  kPosterior = 2,   ///< level 2: label posterior
  k3d = 3,          ///< level 3: quadric or map points
  kJoint = 4,       ///< joint one-to-one assignment over all levels
  kJda = 5,         ///< baseline: one Hungarian assignment over all landmarks
  kIgnored = 6,     ///< class role dynamic or ignore, or nothing is left of the box when it is undistorted
  kSuppressed = 7,  ///< another box of higher score covers it
  kLowScore = 8,    ///< below the score gate
  kWrongSize = 9,   ///< depth makes it larger or smaller than anything of its class
};

/// One detection with its landmark.
struct Association {
  std::int32_t detection_index = 0;  ///< in the detections of the frame
  std::int64_t landmark_id = -1;     ///< -1: none
  AssociationLevel level = AssociationLevel::kNew;
  int class_id = -1;           ///< as detected
  double score = 0.0;          ///< of the detector
  Box box;                     ///< undistorted, px
  std::uint8_t truncated = 0;  ///< Truncation bits
  int landmark_class_id = -1;  ///< most frequent class of the landmark, this detection included
  /// Depth of the near side of the landmark; 0 where the frame does not tell, or leaves open which of two depths it is.
  double near_m = 0.0;

  bool has_depth() const { return std::isfinite(near_m) && near_m > 0.0; }
};

struct AssociationFrame {
  std::int64_t frame_id = -1;
  bool unanswered = false;                ///< the detector did not look at the image: what is missing tells nothing
  std::uint64_t map_version = 0;          ///< of the quadric map that was associated against
  std::vector<Association> associations;  ///< in order of detection_index, every detection once
  double duration_us = 0.0;

  /// Of a frame that nothing is known of but its pose.
  static AssociationFrame without_answer(std::int64_t frame_id) {
    AssociationFrame result;
    result.frame_id = frame_id;
    result.unanswered = true;
    return result;
  }
};

}  // namespace semantic_topo_loop::core
