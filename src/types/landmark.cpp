#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

const char* to_string(LandmarkState state) {
  switch (state) {
    case LandmarkState::kCandidate:
      return "candidate";
    case LandmarkState::kConfirmed:
      return "confirmed";
    case LandmarkState::kRetired:
      return "retired";
  }
  return "unknown";
}

}  // namespace semantic_topo_loop::core
