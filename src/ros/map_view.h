#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"

namespace semantic_topo_loop {

/// Keeps a follower of the quadric map in step with its versions: lets updates through that follow each other, and
/// bridges a gap with the full map. Not thread-safe.
class MapFollower {
 public:
  /// @return the updates to apply now, in order; empty for one that is older than the version held, and during a gap
  std::vector<core::MapUpdate> follow(const core::MapUpdate& update);
  /// @param full_map every landmark of its `map_version`, as FullMap brings it
  /// @return the jump to the full map, landmarks unknown there removed, and what came after it; empty without a gap
  std::vector<core::MapUpdate> recover(core::MapUpdate full_map);

  /// The map may have grown before this follower came: there is a gap until the full map has been seen.
  void join_late() { is_late_ = true; }
  bool has_gap() const { return is_late_ || !waiting_.empty(); }
  std::uint64_t gaps() const { return gaps_; }

 private:
  void take(const core::MapUpdate& update);

  std::uint64_t version_ = 0;
  std::set<std::int64_t> ids_;           ///< landmarks that the map has
  std::deque<core::MapUpdate> waiting_;  ///< updates behind the gap
  bool is_late_ = false;
  std::uint64_t gaps_ = 0;
};

/// Loops of which one line stands for several: where a place is passed slowly each keyframe closes the same loop.
class DistinctLoops {
 public:
  /// @param query, match places of the cameras, m   @return whether no loop with both ends close by was added before
  bool add(const core::Vec3& query, const core::Vec3& match) {
    constexpr double kSameLoopM = 0.6;  // half a second of walking: lines this close cannot be told apart
    for (const auto& [q, m] : ends_) {
      if ((q - query).norm() < kSameLoopM && (m - match).norm() < kSameLoopM) return false;
    }
    ends_.emplace_back(query, match);
    return true;
  }

 private:
  std::vector<std::pair<core::Vec3, core::Vec3>> ends_;
};

/// What there is to show, put together from the stages' deltas. Everything in the map frame. Not thread-safe.
class MapView {
 public:
  struct Keyframe {
    core::SE3 T_odom_camera, T_map_camera;
  };
  using Loop = std::pair<std::int64_t, std::int64_t>;  ///< ids of the query and the match keyframe
  struct AcceptedLoop {
    bool kept = true;  ///< the optimiser believes it
    std::vector<core::ObjectMatch> matches;
  };

  void apply(const core::MapUpdate& update);
  /// Keyframes and loops of which the correction says nothing stay as they are.
  void apply(const core::MapCorrection& correction);
  void add_keyframe(std::int64_t keyframe_id, const core::SE3& T_odom_camera);
  /// Of an earlier session, before all of this one.
  void add_earlier_keyframe(std::int64_t keyframe_id, const core::SE3& T_map_camera);
  /// A loop counts as kept until a correction says otherwise. Of refused candidates the last ones are held.
  void add_loops(const std::vector<core::LoopClosure>& loops);
  void set_frame(const core::Frame& frame) { frame_ = frame; }
  /// A frame without detections leaves the view as it is.
  void set_view(const core::AssociationFrame& associations);

  const std::map<std::int64_t, core::Landmark>& landmarks() const { return landmarks_; }
  const std::map<std::int64_t, Keyframe>& keyframes() const { return keyframes_; }
  const std::map<Loop, AcceptedLoop>& loops() const { return loops_; }
  /// Those from outside, once a correction has told of them: of two keyframes there may be one of each.
  const std::map<Loop, AcceptedLoop>& extra_loops() const { return extra_loops_; }
  const std::map<Loop, core::LoopReason>& refused_loops() const { return refused_; }
  const std::optional<core::Frame>& frame() const { return frame_; }
  const core::SE3& T_map_odom() const { return T_map_odom_; }
  /// The landmark that this one lives on as; itself, unless it was merged.
  std::int64_t survivor(std::int64_t id) const { return redirects_.resolve(id); }
  /// Objects of the last frame with detections that have an ellipsoid and are not retired, in order of id, each once.
  std::vector<const core::Landmark*> objects_in_view() const { return objects_of(in_view_); }
  /// The same of the objects that two places share, by their ids on either side.
  std::vector<const core::Landmark*> matched_objects(const std::vector<core::ObjectMatch>& matches) const;
  /// The vertical, as the cameras were held: across the keyframes' x axes, on the side of image-up, since nothing says
  /// that the world is z-up. Unit; -y before the first keyframe.
  core::Vec3 up() const;
  /// A z-up frame at the first keyframe, x ahead of its camera; none before it.
  std::optional<core::SE3> T_map_upright() const;

 private:
  /// Those of these ids, and of what they were merged into, that there are to show.
  std::vector<const core::Landmark*> objects_of(const std::vector<std::int64_t>& ids) const;
  /// Puts the keyframes that are newer than the solution where T_map_odom has them.
  void compose_new();

  std::map<std::int64_t, core::Landmark> landmarks_;
  core::LandmarkRedirects redirects_;  ///< none of a landmark that lives
  std::map<std::int64_t, Keyframe> keyframes_;
  std::map<Loop, AcceptedLoop> loops_, extra_loops_;
  std::map<Loop, core::LoopReason> refused_;  ///< none that was accepted later
  std::optional<core::Frame> frame_;
  std::vector<std::int64_t> in_view_;
  core::SE3 T_map_odom_;
  std::int64_t earlier_to_ = -1;  ///< keyframes up to this id are of earlier sessions
  std::int64_t solved_to_ = -1;   ///< up to this one they stand where those or a solution have them
};

}  // namespace semantic_topo_loop
