#pragma once

#include <map>
#include <string>
#include <vector>

#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {

/// How surely the detections show an object, so how firmly a map may be asked for it.
enum class Certainty {
  kCertain,   ///< boxes for 3 s in all, rays 20 deg apart, and whole in the image for 1 s: must be found
  kProbable,  ///< boxes for 1 s in all, rays 10 deg apart: may be found
  kMarginal   ///< fewer
};

const char* to_string(Certainty certainty);

/// What a sequence's detections show of an object, at the place where it is at the end.
struct SimulatedReference {
  int object = -1;            ///< index in Scene::objects
  int views = 0;              ///< boxes that belong to it
  int whole_frames = 0;       ///< frames that have it whole in the image
  double baseline_deg = 0.0;  ///< largest angle between two rays to its centre, of those that saw it
  double mean_iou = 0.0;      ///< of the boxes with its true ones, clipped to the image
  double median_iou = 0.0;
  double share_iou_above_half = 0.0;
  int first_frame = -1, last_frame = -1;
  std::map<int, int> other_classes;  ///< boxes with a wrong class
  Certainty certainty = Certainty::kMarginal;
};

/// The objects that stay to the end and have at least one box there, those with most boxes first.
std::vector<SimulatedReference> reference_objects(const SimulatedSequence& sequence);

/// The text of reference_objects.csv, with the columns of the yardsticks of recorded sequences.
std::string format_reference_objects(const SimulatedSequence& sequence, const ClassTable& classes);

/// A place where an object was at rest and is no more: a map that shows it there is wrong.
struct GoneObject {
  int object = -1;  ///< index in Scene::objects
  Ellipsoid ellipsoid;
  int views = 0;        ///< boxes that show it there
  int last_frame = -1;  ///< the last of them
};

/// In order of objects and of time.
std::vector<GoneObject> gone_objects(const SimulatedSequence& sequence);

/// The text of gone_objects.csv: `id,label_id,label,x,y,z,a,b,c,yaw,views,last,reference_id`, the last one the object's
/// row in reference_objects.csv, -1 without one.
std::string format_gone_objects(const SimulatedSequence& sequence, const ClassTable& classes);

}  // namespace semantic_topo_loop::core
