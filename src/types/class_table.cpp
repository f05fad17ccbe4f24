#include "semantic_topo_loop/types/class_table.h"

#include <algorithm>

namespace semantic_topo_loop::core {

Result<ClassTable> ClassTable::create(std::vector<ObjectClass> classes) {
  ClassTable table;
  for (ObjectClass& object_class : classes) {
    const int id = object_class.id, coco_id = object_class.coco_id;
    if (coco_id >= 0 && !table.ids_by_coco_id_.emplace(coco_id, id).second) {
      return Error{"coco_id " + std::to_string(coco_id) + " is listed twice"};
    }
    if (!table.classes_.emplace(id, std::move(object_class)).second) {
      return Error{"class id " + std::to_string(id) + " is listed twice"};
    }
  }
  std::map<std::string, int> label_of_group;
  for (const auto& [id, object_class] : table.classes_) {
    if (object_class.role != ClassRole::kStatic && object_class.role != ClassRole::kMovable) continue;
    const bool is_alone = object_class.group.empty();
    table.labels_[id] = is_alone ? id : label_of_group.emplace(object_class.group, id).first->second;
  }
  return table;
}

const ObjectClass* ClassTable::find(int id) const {
  const auto it = classes_.find(id);
  return it == classes_.end() ? nullptr : &it->second;
}

const ObjectClass* ClassTable::find(const std::string& name) const {
  for (const auto& [id, object_class] : classes_) {
    if (object_class.name == name) return &object_class;
  }
  return nullptr;
}

const ObjectClass* ClassTable::find_by_coco_id(int coco_id) const {
  if (ids_by_coco_id_.empty()) return find(coco_id);
  const auto it = ids_by_coco_id_.find(coco_id);
  return it == ids_by_coco_id_.end() ? nullptr : find(it->second);
}

std::string ClassTable::name(int id) const {
  const ObjectClass* object_class = find(id);
  return object_class != nullptr ? object_class->name : "class_" + std::to_string(id);
}

bool ClassTable::confusable(int a, int b) const {
  if (a == b) return true;
  const ObjectClass* class_a = find(a);
  const ObjectClass* class_b = find(b);
  return class_a != nullptr && class_b != nullptr && !class_a->group.empty() && class_a->group == class_b->group;
}

int ClassTable::label(int id) const {
  const auto it = labels_.find(id);
  return it == labels_.end() ? -1 : it->second;
}

}  // namespace semantic_topo_loop::core
