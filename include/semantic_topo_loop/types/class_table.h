#pragma once

#include <limits>
#include <map>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// What a class may become: static and movable objects are landmarks and loop nodes, dynamic ones neither.
enum class ClassRole { kStatic, kMovable, kDynamic, kIgnore };

struct ObjectClass {
  int id = -1;
  std::string name;
  ClassRole role = ClassRole::kStatic;
  std::string group;          ///< classes a detector confuses share a group; empty: none
  double size_prior_m = 0.3;  ///< typical diameter, m
  /// Longer side of a box around one of them, as depth measures it, from the smallest seen from its narrow side to the
  /// diagonal of the largest, m.
  double size_min_m = 0.0, size_max_m = std::numeric_limits<double>::infinity();
  int coco_id = -1;  ///< in files of COCO's results; -1: not stated
};

/// The detector's classes by id, read from config/classes_*.yaml.
class ClassTable {
 public:
  ClassTable() = default;
  /// @return an error that names the duplicated id, or coco_id, if the classes are not unique
  static Result<ClassTable> create(std::vector<ObjectClass> classes);

  const ObjectClass* find(int id) const;
  const ObjectClass* find(const std::string& name) const;
  /// By its number in files of COCO's results; where the table states none, they count as the table does.
  const ObjectClass* find_by_coco_id(int coco_id) const;
  /// "class_<id>" for an unknown id.
  std::string name(int id) const;
  /// True for the same class and for two classes of one group.
  bool confusable(int a, int b) const;
  /// True if detections of this class become landmarks.
  bool is_mappable(int id) const { return labels_.count(id) != 0; }
  /// One number for all classes of a group, -1 for a class that does not become a landmark.
  int label(int id) const;
  const std::map<int, ObjectClass>& classes() const { return classes_; }

 private:
  std::map<int, ObjectClass> classes_;
  std::map<int, int> ids_by_coco_id_;
  std::map<int, int> labels_;  ///< of the mappable classes, by id: asked for every detection
};

}  // namespace semantic_topo_loop::core
