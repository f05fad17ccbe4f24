#include "semantic_topo_loop/io/run_recorder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "io/csv.h"
#include "loop/graph/relocalisation.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"

namespace semantic_topo_loop::core {
namespace {

const char* level_name(AssociationLevel level) {
  constexpr std::array<const char*, 9> kNames = {"new", "2d",      "pro",        "3d",       "joint",
                                                 "jda", "ignored", "suppressed", "low_score"};
  const auto i = static_cast<std::size_t>(level);
  return i < kNames.size() ? kNames[i] : "unknown";
}

constexpr int kRatioDecimals = 6;

nlohmann::json odometry_summary(const OdometryReport& report) {
  nlohmann::json faults = nlohmann::json::array();
  for (const OdometryFault& fault : report.faults) {
    faults.push_back({{"from_keyframe", fault.from_keyframe_id},
                      {"to_keyframe", fault.to_keyframe_id},
                      {"kind", fault.is_break ? "break" : "jump"},
                      {"translation_m", fault.translation_m},
                      {"rotation_rad", fault.rotation_rad}});
  }
  return {{"stated_edges", report.stated_edges},
          {"translation_m", report.translation_m},
          {"rotation_rad", report.rotation_rad},
          {"steady_translation", report.steady_translation},
          {"steady_rotation_rad", report.steady_rotation_rad},
          {"scale", report.scale},
          {"loop_factor", report.loop_factor},
          {"faults", faults}};
}

nlohmann::json to_json(const std::optional<Relocalisation>& relocalisation) {
  if (!relocalisation) return nullptr;
  nlohmann::json pose;
  for (const double value : {relocalisation->T_earlier_odom.t.x(), relocalisation->T_earlier_odom.t.y(),
                             relocalisation->T_earlier_odom.t.z(), relocalisation->T_earlier_odom.q.x(),
                             relocalisation->T_earlier_odom.q.y(), relocalisation->T_earlier_odom.q.z(),
                             relocalisation->T_earlier_odom.q.w()}) {
    pose.push_back(std::round(1e9 * value) / 1e9);
  }
  return {{"earlier_map_from_odom", pose}, {"agreeing", relocalisation->agreeing}, {"accepted", relocalisation->total}};
}

nlohmann::json to_json(const TrackingReport& tracking) {
  return {{"total", tracking.images},          {"tracked", tracking.tracked}, {"relocalised", tracking.relocalised},
          {"started_anew", tracking.restarts}, {"lost", tracking.lost},       {"unusable", tracking.unusable},
          {"unreadable", tracking.unreadable}};
}

}  // namespace

void RunRecorder::record(const Frame& frame) {
  if (frame.is_end) return;
  Frame& kept = frames_.insert_or_assign(frame.frame_id, frame).first->second;
  kept.keyframe_points.reset();
  kept.points_camera.reset();  // no file has them, and those of a long run fill the memory
  if (frame.is_keyframe) keyframe_frames_[frame.keyframe_id] = frame.frame_id;
}

void RunRecorder::record(const AssociationFrame& associations) {
  timing_[associations.frame_id].association_us = associations.duration_us;
  associations_.insert_or_assign(associations.frame_id, associations);
}

void RunRecorder::record(const MapUpdate& update) {
  timing_[update.frame_id].mapping_us += update.duration_us;
  for (const Landmark& landmark : update.changed) landmarks_.insert_or_assign(landmark.id, landmark);
  for (const std::int64_t id : update.removed) landmarks_.erase(id);
  for (const LandmarkMerge& merge : update.merged) landmarks_.erase(merge.merged_id);
  merges_ += static_cast<int>(update.merged.size()) - static_cast<int>(update.unmerged.size());
}

void RunRecorder::record(std::int64_t frame_id, const std::vector<LoopClosure>& loops, double loop_us) {
  timing_[frame_id].loop_us = loop_us;
  if (loops.empty()) return;
  std::vector<LoopRow> rows;
  rows.reserve(loops.size());
  std::vector<LoopClosure> relocalising;
  for (const LoopClosure& loop : loops) {
    LoopRow row;
    static_cast<LoopFigures&>(row) = static_cast<const LoopFigures&>(loop);
    row.log_scale_variance = loop.scale_covariance(6);
    row.is_in_earlier_map = loop.T_earlier_match.has_value();
    has_earlier_map_ = has_earlier_map_ || row.is_in_earlier_map;
    has_loop_scales_ = has_loop_scales_ || row.log_scale_variance > 0.0;
    if (row.is_in_earlier_map && loop.accepted) relocalising.push_back(loop);
    rows.push_back(row);
  }
  loops_.insert_or_assign(frame_id, std::move(rows));
  if (!relocalising.empty()) relocalising_.insert_or_assign(frame_id, std::move(relocalising));
}

void RunRecorder::record(const MapCorrection& correction) {
  timing_[correction.frame_id].optimise_us = correction.duration_us;
  T_map_odom_.insert_or_assign(correction.frame_id, correction.T_map_odom);
  if (!correction.changed) return;
  ++corrections_;
  correction_ = correction;
  S_map_keyframe_.clear();
  for (const KeyframePose& keyframe : correction.keyframes) {
    S_map_keyframe_.insert_or_assign(keyframe.keyframe_id, Sim3(keyframe.T_map_camera, keyframe.scale));
  }
}

SE3 RunRecorder::live_map_from_odom(std::int64_t frame_id) const {
  const auto own = T_map_odom_.lower_bound(frame_id);
  return own == T_map_odom_.begin() ? SE3() : std::prev(own)->second;
}

SE3 RunRecorder::final_pose(const Frame& frame) const {
  const auto solution = S_map_keyframe_.find(frame.keyframe_id);
  const auto keyframe_frame = keyframe_frames_.find(frame.keyframe_id);
  if (solution == S_map_keyframe_.end() || keyframe_frame == keyframe_frames_.end()) {
    return (T_map_odom_.empty() ? SE3() : T_map_odom_.rbegin()->second) * frame.T_odom_camera;
  }
  const SE3& T_odom_keyframe = frames_.at(keyframe_frame->second).T_odom_camera;
  return solution->second.pose(T_odom_keyframe.inverse() * frame.T_odom_camera);
}

std::string RunRecorder::trajectory(bool live) const {
  std::string text;
  for (const auto& [frame_id, frame] : frames_) {
    const SE3 T_map_camera = live ? live_map_from_odom(frame_id) * frame.T_odom_camera : final_pose(frame);
    text += format_tum_pose({frame.stamp_ns, T_map_camera}) + '\n';
  }
  return text;
}

std::string RunRecorder::keyframes() const {
  std::string text = keyframe_table_header();
  for (const auto& [keyframe_id, frame_id] : keyframe_frames_) {
    const Frame& frame = frames_.at(frame_id);
    KeyframePose keyframe;
    keyframe.keyframe_id = keyframe_id;
    keyframe.frame_id = frame_id;
    keyframe.stamp_ns = frame.stamp_ns;
    keyframe.T_map_camera = final_pose(frame);
    text += table_row(keyframe);
  }
  return text;
}

std::string RunRecorder::objects() const {
  std::string text = object_table_header();
  for (const auto& [id, landmark] : landmarks_) {
    if (!landmark.ellipsoid) continue;
    MappedObject object;
    object.id = id;
    object.class_id = landmark.class_id;
    object.label = classes_->name(landmark.class_id);
    object.center = landmark.ellipsoid->T_world_quadric.t;
    object.rotation = landmark.ellipsoid->T_world_quadric.q;
    object.semi_axes = landmark.ellipsoid->semi_axes;
    object.state = to_string(landmark.state);
    object.observations = landmark.observations;
    object.baseline_deg = landmark.baseline_deg;
    object.mean_iou = landmark.mean_iou;
    object.quality = landmark.quality;
    text += table_row(object);
  }
  return text;
}

std::string RunRecorder::loops(bool in_earlier_map) const {
  std::string text = loop_table_header();
  for (const auto& [frame_id, candidates] : loops_) {
    for (const LoopRow& loop : candidates) {
      if (loop.is_in_earlier_map == in_earlier_map) text += table_row(static_cast<const LoopFigures&>(loop));
    }
  }
  return text;
}

std::string RunRecorder::loop_verdicts() const {
  std::string text = "query_keyframe,match_keyframe,query_frame,match_frame,extra,kept,verdict\n";
  const auto frame_of = [this](std::int64_t keyframe_id) {
    const auto found = keyframe_frames_.find(keyframe_id);
    return found == keyframe_frames_.end() ? -1 : found->second;
  };
  for (const LoopVerdict& verdict : correction_.loops) {
    text += csv_row(verdict.query_keyframe_id, verdict.match_keyframe_id, frame_of(verdict.query_keyframe_id),
                    frame_of(verdict.match_keyframe_id), verdict.is_extra ? 1 : 0, verdict.kept ? 1 : 0,
                    verdict.reason.empty() ? "kept" : verdict.reason);
  }
  return text;
}

std::string RunRecorder::scales() const {
  std::string text = "keyframe_id,frame_id,scale\n";
  for (const auto& [keyframe_id, frame_id] : keyframe_frames_) {
    const auto solution = S_map_keyframe_.find(keyframe_id);
    if (solution == S_map_keyframe_.end()) continue;
    text += csv_row(keyframe_id, frame_id, format_fixed(solution->second.scale, kRatioDecimals));
  }
  return text;
}

std::string RunRecorder::loop_scales() const {
  std::string text = "query_frame,match_frame,accepted,scale,sigma_log\n";
  for (const auto& [frame_id, candidates] : loops_) {
    for (const LoopRow& loop : candidates) {
      if (!(loop.log_scale_variance > 0.0)) continue;
      text +=
          csv_row(loop.query_frame, loop.match_frame, loop.accepted ? 1 : 0, format_fixed(loop.scale, kRatioDecimals),
                  format_fixed(std::sqrt(loop.log_scale_variance), kRatioDecimals));
    }
  }
  return text;
}

std::string RunRecorder::associations() const {
  std::string text = "frame_id,detection_index,landmark_id,level\n";
  for (const auto& [frame_id, frame] : associations_) {
    for (const Association& association : frame.associations) {
      text += csv_row(frame_id, association.detection_index, association.landmark_id, level_name(association.level));
    }
  }
  return text;
}

std::string RunRecorder::timing() const {
  std::string text = "frame_id,association_us,mapping_us,loop_us,optimise_us\n";
  constexpr int kMicrosecondDecimals = 1;
  for (const auto& [frame_id, frame] : frames_) {
    const auto it = timing_.find(frame_id);
    const FrameTiming t = it == timing_.end() ? FrameTiming() : it->second;
    text += csv_row(frame_id, format_fixed(t.association_us, kMicrosecondDecimals),
                    format_fixed(t.mapping_us, kMicrosecondDecimals), format_fixed(t.loop_us, kMicrosecondDecimals),
                    format_fixed(t.optimise_us, kMicrosecondDecimals));
  }
  return text;
}

std::string RunRecorder::summary() const {
  std::int64_t detections = 0, breaks = 0, candidates = 0, accepted = 0, kept = 0;
  std::map<std::string, int> levels, states, reasons;
  for (const auto& [frame_id, frame] : frames_) breaks += frame.is_break ? 1 : 0;
  for (const auto& [frame_id, frame] : associations_) {
    detections += static_cast<std::int64_t>(frame.associations.size());
    for (const Association& association : frame.associations) ++levels[level_name(association.level)];
  }
  for (const auto& [id, landmark] : landmarks_) ++states[to_string(landmark.state)];
  for (const auto& [frame_id, loops] : loops_) {
    for (const LoopRow& loop : loops) {
      if (loop.is_in_earlier_map) continue;
      ++candidates;
      ++reasons[to_string(loop.reason)];
      accepted += loop.accepted ? 1 : 0;
    }
  }
  for (const LoopVerdict& verdict : correction_.loops) kept += verdict.kept ? 1 : 0;
  nlohmann::json summary = {
      {"frames", frames_.size()},
      {"keyframes", keyframe_frames_.size()},
      {"breaks", breaks},
      {"detections", detections},
      {"associations", levels},
      {"landmarks", states},
      {"merges", merges_},
      {"loops", {{"candidates", candidates}, {"accepted", accepted}, {"kept", kept}, {"reasons", reasons}}},
      {"corrections", corrections_},
      {"odometry", odometry_summary(correction_.odometry)}};
  if (tracking_) summary["images"] = to_json(*tracking_);
  if (has_earlier_map_) summary["relocalisation"] = to_json(relocalisation());
  constexpr int kIndent = 2;
  return summary.dump(kIndent) + '\n';
}

std::optional<Relocalisation> RunRecorder::relocalisation() const {
  Relocaliser relocaliser;
  for (const auto& [frame_id, loops] : relocalising_) {
    for (const LoopClosure& loop : loops) {
      const auto query = frames_.find(loop.query_frame);
      if (query != frames_.end()) relocaliser.add(loop, query->second.T_odom_camera);
    }
  }
  return relocaliser.estimate();
}

Status RunRecorder::write(const std::string& directory) const {
  // One text at a time: that of the loops is as long as all others together.
  std::vector<std::pair<const char*, std::function<std::string()>>> files = {
      {"trajectory_live.txt", [this] { return trajectory(true); }},
      {"trajectory.txt", [this] { return trajectory(false); }},
      {"keyframes.csv", [this] { return keyframes(); }},
      {"objects.csv", [this] { return objects(); }},
      {"loops.csv", [this] { return loops(false); }},
      {"loop_verdicts.csv", [this] { return loop_verdicts(); }},
      {"associations.csv", [this] { return associations(); }},
      {"timing.csv", [this] { return timing(); }},
      {"summary.json", [this] { return summary(); }}};
  if (has_earlier_map_) files.emplace_back("relocalisations.csv", [this] { return loops(true); });
  const bool has_scales = std::any_of(S_map_keyframe_.begin(), S_map_keyframe_.end(),
                                      [](const auto& keyframe) { return keyframe.second.scale != 1.0; });
  if (has_scales) files.emplace_back("scales.csv", [this] { return scales(); });
  if (has_loop_scales_) files.emplace_back("loop_scales.csv", [this] { return loop_scales(); });
  if (const Status made = make_directory(directory); !made) return made;
  for (const auto& [name, text] : files) {
    if (const Status written = write_text_file(directory + "/" + name, text()); !written) return written;
  }
  return {};
}

}  // namespace semantic_topo_loop::core
