#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// What association remembers of a landmark.
struct Track {
  std::int64_t id = -1;
  std::vector<std::pair<int, double>> class_weights;  ///< summed detector scores by class
  int class_id = -1;                                  ///< of the largest weight
  int observations = 0;
  std::int64_t last_frame_id = -1;
  std::int64_t last_stamp_ns = 0;
  std::int64_t last_keyframe_id = -1;
  Box last_box;  ///< undistorted, px
  LandmarkState state = LandmarkState::kCandidate;
  bool has_ellipsoid = false;
  bool is_provisional = false;  ///< the ellipsoid comes from depth as yet, not from several directions
  Vec3 center_map = Vec3::Zero();
  Mat3 shape_map = Mat3::Zero();  ///< R diag(a^2) R^T
  std::vector<Vec3> points_map;   ///< of its last observation with points, while without ellipsoid

  double class_share(int id_of_class) const {
    double total = 0.0, weight = 0.0;
    for (const auto& [id_, w] : class_weights) {
      total += w;
      if (id_ == id_of_class) weight = w;
    }
    return total > 0.0 ? weight / total : 0.0;
  }

  void add_class_weight(int id_of_class, double weight) {
    const auto it = std::find_if(class_weights.begin(), class_weights.end(),
                                 [id_of_class](const auto& entry) { return entry.first == id_of_class; });
    if (it == class_weights.end()) {
      class_weights.emplace_back(id_of_class, weight);
    } else {
      it->second += weight;
    }
    class_id = std::max_element(class_weights.begin(), class_weights.end(), [](const auto& a, const auto& b) {
                 return a.second < b.second || (a.second == b.second && a.first > b.first);
               })->first;
  }
};

/// A detection ready to be associated.
struct PreparedDetection {
  std::int32_t index = 0;  ///< in the frame's detections
  int class_id = -1;
  double score = 0.0;
  Box box;      ///< undistorted, px
  Box visible;  ///< the same, clipped to the image
  std::uint8_t truncated = 0;
};

/// A track that this frame may see, with what its prediction needs.
struct TrackInFrame {
  const Track* track = nullptr;
  std::optional<Box> projection;  ///< box of its quadric, clipped to the image; none without quadric or out of view
  bool is_recent = false;         ///< its last box still tells where it may be
};

/// What every level looks at.
struct AssociationContext {
  const Frame* frame = nullptr;
  double interval_s = 0.0;  ///< since the frame before
  Mat34 P_image_map;
  std::vector<PreparedDetection> detections;
  std::vector<TrackInFrame> tracks;
};

}  // namespace semantic_topo_loop::core
