#include "semantic_topo_loop/types/class_table.h"

#include <algorithm>

namespace semantic_topo_loop::core {

Result<ClassTable> ClassTable::create(std::vector<ObjectClass> classes) {
  ClassTable table;
  for (ObjectClass& object_class : classes) {
    const int id = object_class.id;
    if (!table.classes_.emplace(id, std::move(object_class)).second) {
      return Error{"class id " + std::to_string(id) + " is listed twice"};
    }
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

bool ClassTable::is_mappable(int id) const {
  const ObjectClass* object_class = find(id);
  return object_class != nullptr &&
         (object_class->role == ClassRole::kStatic || object_class->role == ClassRole::kMovable);
}

int ClassTable::label(int id) const {
  if (!is_mappable(id)) return -1;
  const std::string& group = find(id)->group;
  const auto is_alike = [this, &group](const auto& entry) {
    return entry.second.group == group && is_mappable(entry.first);
  };
  return group.empty() ? id : std::find_if(classes_.begin(), classes_.end(), is_alike)->first;
}

}  // namespace semantic_topo_loop::core
