#include "ros/map_follower.h"

#include <utility>

namespace semantic_topo_loop {
namespace {

constexpr std::size_t kMaxWaiting = 1024;  ///< updates ahead of one that is missing: half a minute at 30 Hz

}  // namespace

std::vector<core::MapUpdate> MapFollower::follow(const core::MapUpdate& update) {
  if (waiting_.empty() && update.base_version == version_) {
    take(update);
    return {update};
  }
  if (update.map_version <= version_) return {};
  if (waiting_.empty()) ++gaps_;
  if (waiting_.size() == kMaxWaiting) waiting_.pop_front();
  waiting_.push_back(update);
  return {};
}

std::vector<core::MapUpdate> MapFollower::recover(core::MapUpdate full_map) {
  if (!has_gap()) return {};
  is_late_ = false;
  if (full_map.map_version <= version_) return {};
  std::set<std::int64_t> remaining;
  for (const core::Landmark& landmark : full_map.changed) remaining.insert(landmark.id);
  for (const std::int64_t id : ids_) {
    if (remaining.count(id) == 0) full_map.removed.push_back(id);
  }
  full_map.base_version = version_;
  take(full_map);
  std::vector<core::MapUpdate> updates = {std::move(full_map)};
  const std::deque<core::MapUpdate> waiting = std::exchange(waiting_, {});
  for (const core::MapUpdate& update : waiting) {
    for (core::MapUpdate& next : follow(update)) updates.push_back(std::move(next));
  }
  return updates;
}

void MapFollower::take(const core::MapUpdate& update) {
  version_ = update.map_version;
  for (const core::Landmark& landmark : update.changed) ids_.insert(landmark.id);
  for (const std::int64_t id : update.removed) ids_.erase(id);
  for (const core::LandmarkMerge& merge : update.merged) ids_.erase(merge.merged_id);
}

}  // namespace semantic_topo_loop
