#pragma once

#include <cstdint>
#include <string>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"

namespace semantic_topo_loop::core {

/// What became of the images of a run.
struct TrackingReport {
  std::int64_t images = 0;  ///< all of them
  std::int64_t tracked = 0;
  std::int64_t relocalised = 0;
  std::int64_t restarts = 0;    ///< odometries begun anew after a loss
  std::int64_t lost = 0;        ///< without a pose
  std::int64_t unusable = 0;    ///< without a pose, as there was nothing to follow
  std::int64_t unreadable = 0;  ///< missing, broken, of the wrong size or type
  std::string first_unreadable;

  void add(const TrackedImage& image);
  void add_unreadable(const std::string& problem);
  /// "3 of 58 images lost, ..."; empty if every image has a pose without a restart.
  std::string warning() const;
};

}  // namespace semantic_topo_loop::core
