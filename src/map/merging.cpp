#include "map/merging.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kVotingViews = 30;  // spread over all: the median of more hardly moves
constexpr double kMinReach_m = 0.25;      // for small objects, whose fits scatter by more than their size
constexpr double kPartInside = 0.7;       // median share of a part's boxes inside the whole's projection
// Of a part's boxes, those beside one of the whole: detectors box parts in between, a thing nearly always beside.
// Chosen on fr2_desk's drifted files, where a quarter, which vetoes merges, leaves more objects twice.
constexpr double kThingBeside = 0.8;
constexpr double kPartSeen = 0.3;    // of the time for which the whole is seen, at most: what is seen more is a thing
constexpr double kForeignIou = 0.1;  // of a box with an object's projection: less shows something else
// Of the frames side by side, those that were mixed up, so that the others veto no merge. Chosen on fr2_desk's drifted
// files, where 0.7 to 0.9 do alike; where fewer are, as in fr3_office's rows of bottles, two things stand side by side.
constexpr double kMixedUp = 0.8;
constexpr double kSameCenter = 0.5;  // mean semi-axes: centres nearer than this are one object's, whatever the boxes

struct Overlap {
  double iou = 0.0;     ///< of b's boxes with a's projection, median
  double inside = 0.0;  ///< share of b's boxes inside a's projection, median
};

Overlap overlap(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& source) {
  std::vector<Observation> whole;
  for (const Observation& observation : b.observations) {
    if (observation.view.truncated == 0) whole.push_back(observation);
  }
  const Camera& camera = source.camera();
  const Box image = camera.image();
  const Mat3 shape = a.state.ellipsoid->shape();
  std::vector<double> ious, insides;
  for (const BoxView& view : source.views(spread(whole.empty() ? b.observations : whole, kVotingViews))) {
    const std::optional<Box> projected =
        project_box(a.state.ellipsoid->center(), shape, projection_matrix(camera, view.T_world_camera));
    const Box seen = clip(view.box, image);
    const Box box = projected ? clip(*projected, image) : Box{};
    ious.push_back(iou(box, seen));
    insides.push_back(seen.area() > 0.0 ? intersection_area(box, seen) / seen.area() : 0.0);
  }
  return {median(ious), median(insides)};
}

/// Whether depth puts both in one place with about one size.
bool is_one_place(const MappedLandmark& a, const MappedLandmark& b) {
  const auto placement = [](const MappedLandmark& landmark) {
    return Placement{landmark.state.ellipsoid->center(), 2.0 * landmark.state.ellipsoid->semi_axes.maxCoeff()};
  };
  return a.sightings.placed_s > 0.0 && b.sightings.placed_s > 0.0 && is_one_thing(placement(a), placement(b));
}

/// Frames in which both had a separate box. What has taken over another knows of all of them, the other one only of its
/// own.
int frames_side_by_side(const MappedLandmark& a, const MappedLandmark& b) {
  const auto frames = [](const MappedLandmark& landmark, std::int64_t other) {
    const auto found = landmark.seen_beside.find(other);
    return found == landmark.seen_beside.end() ? 0 : found->second;
  };
  return std::max(frames(a, b.state.id), frames(b, a.state.id));
}

/// Whether, in nearly all frames in which both have a box, that of `a` shows something else and that of `b` shows `a`:
/// while the odometry was wrong, `a` was given a neighbour's boxes, and its own made `b`.
/// @param same_iou of a box with the projection of what it shows, at least
bool are_mixed_up(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& source, double same_iou) {
  std::vector<std::pair<Observation, Observation>> common;
  auto other = b.observations.begin();
  for (const Observation& observation : a.observations) {
    while (other != b.observations.end() && other->frame_id < observation.frame_id) ++other;
    if (other == b.observations.end()) break;
    if (other->frame_id == observation.frame_id) common.emplace_back(observation, *other);
  }
  if (common.empty()) return false;
  common = spread(common, kVotingViews);
  const auto mixed_up = std::count_if(common.begin(), common.end(), [&](const auto& boxes) {
    const BoxView view = source.view(boxes.first);
    const std::optional<Box> projected =
        project_box(*a.state.ellipsoid, projection_matrix(source.camera(), view.T_world_camera));
    return projected && iou(*projected, view.box) < kForeignIou && iou(*projected, boxes.second.view.box) > same_iou;
  });
  return static_cast<double>(mixed_up) >= kMixedUp * static_cast<double>(common.size());
}

Remains remains_of(const KeyframePlaces& S_map_keyframe, const LandmarkRecord& landmark) {
  Remains remains{landmark, {}, 1.0};
  const auto anchor = S_map_keyframe.find(landmark.state.anchor_keyframe_id);
  if (landmark.state.ellipsoid && anchor != S_map_keyframe.end()) {
    remains.T_anchor_quadric = anchor->second.inverse().pose(landmark.state.ellipsoid->T_world_quadric);
    remains.anchor_scale = anchor->second.scale;
  }
  return remains;
}

/// What a landmark knows less without another one that it had taken over, but for the observations.
void give_up(const LandmarkRecord& merged, LandmarkRecord* survivor) {
  survivor->state.observations -= merged.state.observations;
  for (const ClassCount& c : merged.state.class_counts) survivor->state.count_class(c.class_id, -c.count);
  survivor->sightings.add(merged.sightings, -1.0);
  for (const auto& [id, count] : merged.seen_beside) survivor->seen_beside[id] -= count;
  survivor->seen_beside.erase(survivor->state.id);
}

MappedLandmark restore(const KeyframePlaces& S_map_keyframe, const Remains& remains) {
  MappedLandmark landmark{remains.landmark, {}};
  landmark.state.ellipsoid = MergeHistory::place(S_map_keyframe, remains);
  return landmark;
}

}  // namespace

double DuplicateTest::reach_m(double longest_a_m, double longest_b_m) {
  return std::max(kMinReach_m, longest_a_m + longest_b_m);
}

bool DuplicateTest::is_duplicate(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const {
  const bool same = a.state.class_id == b.state.class_id;
  const bool confusable = classes_.confusable(a.state.class_id, b.state.class_id);
  if (!confusable && !is_one_place(a, b)) return false;
  const double distance = (a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm();
  if (distance > reach_m(a.state.ellipsoid->semi_axes.maxCoeff(), b.state.ellipsoid->semi_axes.maxCoeff()))
    return false;
  const bool vetoed = frames_side_by_side(a, b) >= options_.merge_veto_share * b.state.observations &&
                      !are_mixed_up(a, b, views, options_.merge_iou);
  const Overlap o = overlap(a, b, views);
  if (!vetoed && is_one_place(a, b) && o.inside > kPartInside) return true;
  if (!same) return confusable && o.iou > options_.merge_iou_confusable;
  const double closeness =
      kSameCenter * std::min(a.state.ellipsoid->semi_axes.mean(), b.state.ellipsoid->semi_axes.mean());
  return !vetoed && (o.iou > options_.merge_iou || distance < closeness);
}

bool DuplicateTest::is_part(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const {
  if (!classes_.confusable(a.state.class_id, b.state.class_id)) return false;
  if (b.sightings.seen_s >= kPartSeen * a.sightings.seen_s) return false;
  if (frames_side_by_side(a, b) >= kThingBeside * b.state.observations) return false;
  const double reach = a.state.ellipsoid->semi_axes.maxCoeff() + b.state.ellipsoid->semi_axes.maxCoeff();
  if ((a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm() > reach) return false;
  return overlap(a, b, views).inside > kPartInside;
}

bool DuplicateTest::may_be_pieces(const Landmark& a, const Landmark& b) const {
  if (a.id == b.id || !a.ellipsoid || !b.ellipsoid || !classes_.confusable(a.class_id, b.class_id)) return false;
  return (a.ellipsoid->center() - b.ellipsoid->center()).norm() < a.ellipsoid->radius() + b.ellipsoid->radius();
}

void MergeLog::add(LoggedMerge merge) {
  merge.number = merges_.empty() ? 0 : merges_.rbegin()->first + 1;
  news_.insert(merge.number);
  merges_.emplace(merge.number, merge);
  forget_first();
}

void MergeLog::take_back(const LandmarkMerge& merge, std::int64_t frame_id) {
  const auto made = std::find_if(merges_.rbegin(), merges_.rend(), [&merge](const auto& entry) {
    const LoggedMerge& logged = entry.second;
    return !logged.undone_frame_id && logged.merge.merged_id == merge.merged_id &&
           logged.merge.survivor_id == merge.survivor_id;
  });
  if (made == merges_.rend()) return;
  made->second.undone_frame_id = frame_id;
  news_.insert(made->first);
}

void MergeLog::restore(const std::vector<LoggedMerge>& merges) {
  for (const LoggedMerge& merge : merges) {
    merges_[merge.number] = merge;
    news_.insert(merge.number);
  }
  forget_first();
}

std::vector<LoggedMerge> MergeLog::merges() const {
  std::vector<LoggedMerge> merges;
  merges.reserve(merges_.size());
  for (const auto& [number, merge] : merges_) merges.push_back(merge);
  return merges;
}

void MergeLog::take_delta(MapperDelta* delta) {
  if (delta->is_whole) {
    delta->merges = merges();
  } else {
    for (const std::int64_t number : news_) delta->merges.push_back(merges_.at(number));
  }
  news_.clear();
  if (!merges_.empty()) delta->first_merge = merges_.begin()->first;
}

void MergeLog::forget_first() {
  while (merges_.size() > capacity_) {
    news_.erase(merges_.begin()->first);
    merges_.erase(merges_.begin());
  }
}

std::optional<Ellipsoid> MergeHistory::place(const KeyframePlaces& S_map_keyframe, const Remains& remains) {
  const Landmark& state = remains.landmark.state;
  const auto anchor = S_map_keyframe.find(state.anchor_keyframe_id);
  if (!state.ellipsoid || anchor == S_map_keyframe.end()) return state.ellipsoid;
  return Ellipsoid{anchor->second.pose(remains.T_anchor_quadric),
                   anchor->second.scale / remains.anchor_scale * state.ellipsoid->semi_axes};
}

void MergeHistory::join(const KeyframePlaces& S_map_keyframe, MappedLandmark merged, MappedLandmark* survivor) {
  MergeRecord record;
  record.merge = {merged.state.id, survivor->state.id};
  record.merged = remains_of(S_map_keyframe, merged);
  record.survivor = remains_of(S_map_keyframe, *survivor);
  for (const Observation& observation : merged.observations) record.sources.push_back(observation.source_id);
  std::sort(record.sources.begin(), record.sources.end());
  record.sources.erase(std::unique(record.sources.begin(), record.sources.end()), record.sources.end());
  if (records_.size() == kMostOpenMerges) records_.erase(records_.begin());
  redirects_.merge(record.merge);
  records_.push_back(std::move(record));

  std::vector<Observation> all;
  all.reserve(survivor->observations.size() + merged.observations.size());
  std::merge(survivor->observations.begin(), survivor->observations.end(), merged.observations.begin(),
             merged.observations.end(), std::back_inserter(all),
             [](const Observation& a, const Observation& b) { return a.frame_id < b.frame_id; });
  survivor->observations = std::move(all);
  survivor->state.observations += merged.state.observations;
  for (const ClassCount& c : merged.state.class_counts) survivor->state.count_class(c.class_id, c.count);
  survivor->sightings.add(merged.sightings);
  survivor->sightings.expected_s = std::max(survivor->sightings.expected_s, merged.sightings.expected_s);
  if (merged.last_stamp_ns > survivor->last_stamp_ns) {
    survivor->sightings.missed_since_s = merged.sightings.missed_since_s;
    survivor->sightings.seen_through_since_s = merged.sightings.seen_through_since_s;
    survivor->last_stamp_ns = merged.last_stamp_ns;
    survivor->seen_at_s = merged.seen_at_s;
  }
  survivor->seen_from.add(merged.seen_from);
  survivor->was_confirmed = survivor->was_confirmed || merged.was_confirmed;
  for (const auto& [id, count] : merged.seen_beside) survivor->seen_beside[id] += count;
  survivor->seen_beside.erase(survivor->state.id);  // nothing is beside itself
}

MappedLandmark MergeHistory::split(const KeyframePlaces& S_map_keyframe, std::size_t index, MappedLandmark* survivor) {
  const MergeRecord record = std::move(records_[index]);
  records_.erase(records_.begin() + static_cast<std::ptrdiff_t>(index));
  redirects_.unmerge(record.merge.merged_id);

  MappedLandmark merged = restore(S_map_keyframe, record.merged);
  const auto belongs_to_merged = [&record](const Observation& observation) {
    return std::binary_search(record.sources.begin(), record.sources.end(), observation.source_id);
  };
  std::vector<Observation>& all = survivor->observations;
  std::copy_if(all.begin(), all.end(), std::back_inserter(merged.observations), belongs_to_merged);
  all.erase(std::remove_if(all.begin(), all.end(), belongs_to_merged), all.end());

  const LandmarkRecord& before = record.survivor.landmark;
  const bool has_gone_on = survivor->state.id != before.state.id;
  if (!has_gone_on && survivor->state.observations == before.state.observations + merged.state.observations) {
    MappedLandmark restored = restore(S_map_keyframe, record.survivor);
    restored.observations = std::move(survivor->observations);
    *survivor = std::move(restored);
    return merged;
  }
  give_up(merged, survivor);
  // What was merged into others meanwhile comes back without it.
  for (std::size_t i = index; i < records_.size() && has_gone_on; ++i) {
    MergeRecord& later = records_[i];
    std::vector<std::int64_t> left;
    std::set_difference(later.sources.begin(), later.sources.end(), record.sources.begin(), record.sources.end(),
                        std::back_inserter(left));
    if (left.size() == later.sources.size()) continue;
    later.sources = std::move(left);
    give_up(merged, &later.merged.landmark);
  }
  return merged;
}

}  // namespace semantic_topo_loop::core
