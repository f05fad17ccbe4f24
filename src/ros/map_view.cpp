#include "ros/map_view.h"

#include <Eigen/Eigenvalues>
#include <utility>

namespace semantic_topo_loop {

std::vector<core::MapUpdate> MapFollower::follow(const core::MapUpdate& update) {
  if (waiting_.empty() && update.base_version == version_) {
    take(update);
    return {update};
  }
  if (update.map_version <= version_) return {};
  if (waiting_.empty()) ++gaps_;
  constexpr std::size_t kMaxWaiting = 1024;  // updates ahead of one that is missing: half a minute at 30 Hz
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

void MapView::apply(const core::MapUpdate& update) {
  for (const core::LandmarkMerge& merge : update.unmerged) redirects_.unmerge(merge.merged_id);
  for (const core::Landmark& landmark : update.changed) {
    landmarks_[landmark.id] = landmark;
    redirects_.unmerge(landmark.id);  // it lives again, though the update that says so may be lost
  }
  for (const std::int64_t id : update.removed) landmarks_.erase(id);
  for (const core::LandmarkMerge& merge : update.merged) {
    landmarks_.erase(merge.merged_id);
    redirects_.merge(merge);
  }
  const bool has_moved = update.T_map_odom.t != T_map_odom_.t;
  T_map_odom_ = update.T_map_odom;
  // Before the first solution only where the session begins is said anew, with its first frame.
  if (has_moved && solved_to_ == earlier_to_) compose_new();
}

void MapView::apply(const core::MapCorrection& correction) {
  if (!correction.changed) return;
  T_map_odom_ = correction.T_map_odom;
  solved_to_ = correction.valid_to_keyframe_id;
  compose_new();
  for (const core::KeyframePose& pose : correction.keyframes) {
    const auto it = keyframes_.find(pose.keyframe_id);
    if (it != keyframes_.end()) it->second.T_map_camera = pose.T_map_camera;
  }
  for (const core::LoopVerdict& verdict : correction.loops) {
    const Loop ends = {verdict.query_keyframe_id, verdict.match_keyframe_id};
    if (verdict.is_extra) extra_loops_[ends].kept = verdict.kept;
    const auto loop = loops_.find(ends);
    if (!verdict.is_extra && loop != loops_.end()) loop->second.kept = verdict.kept;
  }
}

void MapView::compose_new() {
  for (auto it = keyframes_.upper_bound(solved_to_); it != keyframes_.end(); ++it) {
    it->second.T_map_camera = T_map_odom_ * it->second.T_odom_camera;
  }
}

void MapView::add_keyframe(std::int64_t keyframe_id, const core::SE3& T_odom_camera) {
  keyframes_[keyframe_id] = {T_odom_camera, T_map_odom_ * T_odom_camera};
}

void MapView::add_earlier_keyframe(std::int64_t keyframe_id, const core::SE3& T_map_camera) {
  keyframes_[keyframe_id] = {T_map_camera, T_map_camera};
  solved_to_ = earlier_to_ = keyframe_id;
}

void MapView::add_loops(const std::vector<core::LoopClosure>& loops) {
  for (const core::LoopClosure& loop : loops) {
    if (loop.T_earlier_match) continue;
    const Loop ends = {loop.query_keyframe_id, loop.match_keyframe_id};
    if (loop.accepted) {
      loops_[ends] = {true, loop.matches};
      refused_.erase(ends);
    } else if (loops_.count(ends) == 0) {
      refused_[ends] = loop.reason;
    }
  }
  constexpr std::size_t kMostRefused = 2000;  // with more the image is one colour, and the messages are large
  while (refused_.size() > kMostRefused) refused_.erase(refused_.begin());
}

void MapView::set_view(const core::AssociationFrame& associations) {
  if (associations.associations.empty()) return;
  in_view_.clear();
  for (const core::Association& association : associations.associations) {
    if (association.landmark_id >= 0) in_view_.push_back(association.landmark_id);
  }
}

std::vector<const core::Landmark*> MapView::objects_of(const std::vector<std::int64_t>& ids) const {
  std::set<std::int64_t> survivors;
  for (const std::int64_t id : ids) survivors.insert(survivor(id));
  std::vector<const core::Landmark*> objects;
  for (const std::int64_t id : survivors) {
    const auto it = landmarks_.find(id);
    const bool shown =
        it != landmarks_.end() && it->second.ellipsoid && it->second.state != core::LandmarkState::kRetired;
    if (shown) objects.push_back(&it->second);
  }
  return objects;
}

std::vector<const core::Landmark*> MapView::matched_objects(const std::vector<core::ObjectMatch>& matches) const {
  std::vector<std::int64_t> ids;
  for (const core::ObjectMatch& match : matches) {
    ids.push_back(match.query_landmark_id);
    ids.push_back(match.match_landmark_id);
  }
  return objects_of(ids);
}

core::Vec3 MapView::up() const {
  // Who holds a camera level rolls it little: its x axis is horizontal. Before the camera has turned, the x axes leave
  // one direction open, and image-up decides there.
  constexpr double kImageUpWeight = 0.02;
  core::Mat3 scatter = core::Mat3::Zero();
  core::Vec3 image_up = core::Vec3::Zero();
  for (const auto& [id, keyframe] : keyframes_) {
    const core::Mat3 R = keyframe.T_map_camera.rotation();
    scatter += R.col(0) * R.col(0).transpose();
    image_up -= R.col(1);
  }
  if (!(image_up.norm() > 0.0)) return {0.0, -1.0, 0.0};
  image_up.normalize();
  scatter /= static_cast<double>(keyframes_.size());
  scatter += kImageUpWeight * (core::Mat3::Identity() - image_up * image_up.transpose());
  const Eigen::SelfAdjointEigenSolver<core::Mat3> solver(scatter);
  const core::Vec3 vertical = solver.eigenvectors().col(0);
  return vertical.dot(image_up) < 0.0 ? -vertical : vertical;
}

std::optional<core::SE3> MapView::T_map_upright() const {
  if (keyframes_.empty()) return std::nullopt;
  const core::SE3& T_map_camera = keyframes_.begin()->second.T_map_camera;
  core::Mat3 R;
  R.col(2) = up();
  // A camera that looks straight down has image-up ahead.
  const core::Vec3 ahead = T_map_camera.rotation().col(2) - 0.1 * T_map_camera.rotation().col(1);
  R.col(1) = R.col(2).cross(ahead).normalized();
  R.col(0) = R.col(1).cross(R.col(2));
  return core::SE3(R, T_map_camera.t);
}

}  // namespace semantic_topo_loop
