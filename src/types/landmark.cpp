#include "semantic_topo_loop/types/landmark.h"

#include <algorithm>
#include <array>

namespace semantic_topo_loop::core {

Mat3 Ellipsoid::shape() const {
  const Mat3 R = T_world_quadric.rotation();
  return R * semi_axes.cwiseAbs2().asDiagonal() * R.transpose();
}

Mat4 Ellipsoid::dual() const {
  const Mat4 Z = T_world_quadric.matrix();
  return Z *
         Vec4(semi_axes.x() * semi_axes.x(), semi_axes.y() * semi_axes.y(), semi_axes.z() * semi_axes.z(), -1.0)
             .asDiagonal() *
         Z.transpose();
}

const char* to_string(LandmarkState state) {
  constexpr std::array<const char*, 3> kNames = {"candidate", "confirmed", "retired"};
  const auto i = static_cast<std::size_t>(state);
  return i < kNames.size() ? kNames[i] : "unknown";
}

void Landmark::count_class(int of_class, int count) {
  const auto place = std::lower_bound(class_counts.begin(), class_counts.end(), of_class,
                                      [](const ClassCount& c, int id) { return c.class_id < id; });
  const bool is_known = place != class_counts.end() && place->class_id == of_class;
  const auto entry = is_known ? place : class_counts.insert(place, {of_class, 0});
  entry->count += count;
  if (entry->count == 0) class_counts.erase(entry);
}

void LandmarkRedirects::apply(const MapUpdate& update) {
  for (const LandmarkMerge& merge : update.unmerged) unmerge(merge.merged_id);
  for (const LandmarkMerge& merge : update.merged) this->merge(merge);
}

void LandmarkRedirects::merge(const LandmarkMerge& merge) {
  unmerge(merge.merged_id);                                   // from what an unmerge that was lost left it in
  if (resolve(merge.survivor_id) == merge.merged_id) return;  // no id stands for itself by a detour
  survivor_.emplace(merge.merged_id, merge.survivor_id);
  merged_into_[merge.survivor_id].push_back(merge.merged_id);
}

void LandmarkRedirects::unmerge(std::int64_t merged_id) {
  const auto it = survivor_.find(merged_id);
  if (it == survivor_.end()) return;
  std::vector<std::int64_t>& merged = merged_into_[it->second];
  merged.erase(std::remove(merged.begin(), merged.end(), merged_id), merged.end());
  survivor_.erase(it);
}

std::int64_t LandmarkRedirects::resolve(std::int64_t id) const {
  for (auto it = survivor_.find(id); it != survivor_.end(); it = survivor_.find(id)) id = it->second;
  return id;
}

std::vector<std::int64_t> LandmarkRedirects::aliases(std::int64_t id) const {
  std::vector<std::int64_t> ids = {resolve(id)};
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto it = merged_into_.find(ids[i]);
    if (it != merged_into_.end()) ids.insert(ids.end(), it->second.begin(), it->second.end());
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

}  // namespace semantic_topo_loop::core
