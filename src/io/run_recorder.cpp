#include "semantic_topo_loop/io/run_recorder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>

#include "geometry/relative_pose.h"
#include "io/csv.h"
#include "io/process_memory.h"
#include "io/spool.h"
#include "odometry/held_poses.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/map_unit.h"

namespace semantic_topo_loop::core {
namespace {

/// Besides those that every run has.
constexpr std::array<const char*, 4> kSometimesWritten = {"relocalisations.csv", "scales.csv", "loop_scales.csv",
                                                          "report.html"};

const char* level_name(AssociationLevel level) {
  constexpr std::array<const char*, 10> kNames = {"new", "2d",      "pro",        "3d",        "joint",
                                                  "jda", "ignored", "suppressed", "low_score", "wrong_size"};
  const auto i = static_cast<std::size_t>(level);
  return i < kNames.size() ? kNames[i] : "unknown";
}

nlohmann::json odometry_summary(const OdometryReport& report) {
  nlohmann::json faults = nlohmann::json::array();
  for (const OdometryFault& fault : report.faults) {
    const char* kind = fault.is_break          ? "break"
                       : fault.frozen_s > 0.0  ? "freeze"
                       : fault.slipped_s > 0.0 ? "slip"
                                               : "jump";
    faults.push_back({{"from_keyframe", fault.from_keyframe_id},
                      {"to_keyframe", fault.to_keyframe_id},
                      {"kind", kind},
                      {"translation_m", fault.translation_m},
                      {"rotation_rad", fault.rotation_rad},
                      {"frozen_s", fault.frozen_s},
                      {"slipped_s", fault.slipped_s}});
  }
  return {{"stated_edges", report.stated_edges},
          {"translation_m", report.translation_m},
          {"rotation_rad", report.rotation_rad},
          {"steady_translation", report.steady_translation},
          {"steady_rotation_rad", report.steady_rotation_rad},
          {"scale", report.scale},
          {"loop_factor", report.loop_factor},
          {"delay_s", report.delay_s},
          {"short_term",
           {{"step_m", report.short_term.step_m},
            {"step_rad", report.short_term.step_rad},
            {"drift_mps", report.short_term.drift_mps},
            {"drift_radps", report.short_term.drift_radps}}},
          {"faults", faults}};
}

nlohmann::json to_json(const std::optional<Relocalisation>& relocalisation) {
  if (!relocalisation) return nullptr;
  const SE3& T = relocalisation->T_earlier_odom;
  nlohmann::json pose;
  for (const double value : {T.t.x(), T.t.y(), T.t.z(), T.q.x(), T.q.y(), T.q.z(), T.q.w()}) {
    pose.push_back(std::round(1e9 * value) / 1e9);
  }
  return {{"earlier_map_from_odom", pose}, {"agreeing", relocalisation->agreeing}, {"accepted", relocalisation->total}};
}

nlohmann::json to_json(const TrackingReport& tracking) {
  return {{"total", tracking.images},          {"tracked", tracking.tracked}, {"relocalised", tracking.relocalised},
          {"started_anew", tracking.restarts}, {"lost", tracking.lost},       {"unusable", tracking.unusable},
          {"unreadable", tracking.unreadable}};
}

/// Tables whose rows stay as they are: they go to the disk while the run goes on.
enum Table {
  kLivePoses,
  kLoops,
  kRelocalisations,
  kLoopScales,
  kLoopObjects,
  kAssociations,
  kTiming,
  kMemory,
  kTables
};
using Rows = std::array<std::string, kTables>;

const Rows& headers() {
  static const Rows kHeaders = {"",
                                loop_table_header(),
                                loop_table_header(),
                                "query_frame,match_frame,accepted,scale,sigma_log\n",
                                loop_object_table_header(),
                                "frame_id,detection_index,landmark_id,level\n",
                                "frame_id,association_us,mapping_us,loop_us,optimise_us\n",
                                "frame_id,resident_mb,peak_mb\n"};
  return kHeaders;
}

/// Of a frame, what is needed at the end; plain numbers, so that its bytes can be kept.
struct FramePlace {
  FramePlace() = default;
  explicit FramePlace(const Frame& frame)
      : frame_id(frame.frame_id), keyframe_id(frame.keyframe_id), stamp_ns(frame.stamp_ns) {
    set_pose(frame.T_odom_camera);
  }
  void set_pose(const SE3& T_odom_camera) {
    Eigen::Map<Vec7>(pose_.data()) << T_odom_camera.q.coeffs(), T_odom_camera.t;
  }
  SE3 T_odom_camera() const { return {Quaternion(pose_.data()), Vec3(pose_.data() + 4)}; }

  std::int64_t frame_id = -1, keyframe_id = -1, stamp_ns = 0;

 private:
  std::array<double, 7> pose_{};
};

/// A frame of which a stage may still tell more.
struct OpenFrame {
  std::optional<FramePlace> place;  ///< once the frame itself has come
  SE3 T_odom_live;                  ///< as it was given then
  bool is_break = false;
  AssociationFrame associations;
  std::vector<LoopClosure> loops;
  std::optional<std::pair<SE3, SE3>> T_map_odom;  ///< before and after its correction
  double mapping_us = 0.0, loop_us = 0.0, optimise_us = 0.0;
  std::optional<Memory> memory;  ///< once a second
};

/// Counts of the summary.
struct Counts {
  std::int64_t frames = 0, breaks = 0, detections = 0, candidates = 0, accepted = 0;
  std::map<std::string, int> levels, reasons;

  void add(const OpenFrame& frame) {
    frames += frame.place ? 1 : 0;
    breaks += frame.is_break ? 1 : 0;
    detections += static_cast<std::int64_t>(frame.associations.associations.size());
    for (const Association& association : frame.associations.associations) ++levels[level_name(association.level)];
    for (const LoopClosure& loop : frame.loops) {
      if (loop.T_earlier_match) continue;
      ++candidates;
      ++reasons[to_string(loop.reason)];
      accepted += loop.accepted ? 1 : 0;
    }
  }
};

class FileRecorder : public RunRecorder {
 public:
  FileRecorder(std::shared_ptr<const ClassTable> classes, std::string directory)
      : classes_(std::move(classes)), directory_(std::move(directory)) {}

  void record(const Frame& frame) override {
    if (frame.is_end) return;
    if (frame.held_since_ns) {
      for (auto& [frame_id, open] : open_) {
        if (open.place) open.place->set_pose(pose_on_the_way(open.place->stamp_ns, open.place->T_odom_camera(), frame));
      }
    }
    open_[frame.frame_id].place = FramePlace(frame);
    open_[frame.frame_id].T_odom_live = frame.T_odom_camera;
    open_[frame.frame_id].is_break = frame.is_break;
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    const std::int64_t second = frame.stamp_ns / kSecond_ns;
    if (std::exchange(memory_second_, second) != second) open_[frame.frame_id].memory = memory_of_process();
    if (frame.is_keyframe) keyframes_.insert_or_assign(frame.keyframe_id, FramePlace(frame));
    settle(frame.stamp_ns);
  }

  void record(const AssociationFrame& associations) override {
    open_[associations.frame_id].associations = associations;
  }

  void record(const MapUpdate& update) override {
    open_[update.frame_id].mapping_us += update.duration_us;
    for (const Landmark& landmark : update.changed) landmarks_.insert_or_assign(landmark.id, landmark);
    for (const std::int64_t id : update.removed) landmarks_.erase(id);
    for (const LandmarkMerge& merge : update.merged) landmarks_.erase(merge.merged_id);
    merges_ += static_cast<int>(update.merged.size()) - static_cast<int>(update.unmerged.size());
  }

  void record(std::int64_t frame_id, const std::vector<LoopClosure>& loops, double loop_us) override {
    open_[frame_id].loop_us = loop_us;
    if (loops.empty()) return;
    for (const LoopClosure& loop : loops) {
      has_earlier_map_ = has_earlier_map_ || loop.T_earlier_match;
      has_loop_scales_ = has_loop_scales_ || loop.scale_covariance(6) > 0.0;
    }
    open_[frame_id].loops = loops;
  }

  void record(const std::optional<Relocalisation>& relocalisation) override { relocalisation_ = relocalisation; }

  void record(const MapCorrection& correction) override {
    open_[correction.frame_id].optimise_us = correction.duration_us;
    open_[correction.frame_id].T_map_odom = {correction.T_map_odom_old, correction.T_map_odom};
    if (correction.frame_id >= last_T_map_odom_.first) last_T_map_odom_ = {correction.frame_id, correction.T_map_odom};
    if (!correction.changed) return;
    ++corrections_;
    odometry_ = correction.odometry;
    for (const LoopVerdict& verdict : correction.loops) verdicts_.insert_or_assign(verdict.number, verdict);
    for (const KeyframePose& keyframe : correction.keyframes) {
      S_map_keyframe_.insert_or_assign(keyframe.keyframe_id, Sim3(keyframe.T_map_camera, keyframe.scale));
    }
  }

  void record(const TrackingReport& tracking) override { tracking_ = tracking; }

  std::optional<Relocalisation> relocalisation() const override { return relocalisation_; }

  std::optional<JoinedMap> joined_map() const override {
    if (keyframes_.empty()) return std::nullopt;
    const auto& [first_id, first] = *keyframes_.begin();
    std::optional<JoinedMap> joined;
    for (const auto& [number, verdict] : verdicts_) {
      const auto query = keyframes_.find(verdict.query_keyframe_id);
      if (!verdict.kept || verdict.match_keyframe_id >= first_id || query == keyframes_.end()) continue;
      const double after_s = 1e-9 * static_cast<double>(query->second.stamp_ns - first.stamp_ns);
      joined = joined ? JoinedMap{std::min(joined->after_s, after_s), joined->loops + 1} : JoinedMap{after_s, 1};
    }
    return joined;
  }

  Status write(const std::string& directory) const override {
    Rows open;
    SE3 T_map_odom = settled_T_map_odom_;
    for (const auto& [frame_id, frame] : open_) {
      const Rows rows = rows_of(frame_id, frame, &T_map_odom);
      for (std::size_t table = 0; table < rows.size(); ++table) open[table] += rows[table];
    }
    Status kept;
    FileTexts files;
    const auto add = [&](const std::string& name, const WriteText& text) {
      files.emplace_back(directory + "/" + name, text);
    };
    const auto require = [&kept](const Status& read, std::ostream& file) {
      if (read) return;
      kept = read;
      file.setstate(std::ios::badbit);
    };
    const auto add_table = [&](const char* name, Table table) {
      add(name, [&, table](std::ostream& file) {
        file << headers()[table];
        require(settled_[table].read(1, [&file](std::string_view rows) { file << rows; }), file);
        file << open[table];
      });
    };
    add_table("trajectory_live.txt", kLivePoses);
    add("trajectory.txt", [&](std::ostream& file) { require(write_trajectory(file), file); });
    add("keyframes.csv", [this](std::ostream& file) { write_keyframes(file); });
    add("objects.csv", [this](std::ostream& file) { write_objects(file); });
    add_table("loops.csv", kLoops);
    add("loop_verdicts.csv", [this](std::ostream& file) { write_verdicts(file); });
    add_table("loop_objects.csv", kLoopObjects);
    add_table("associations.csv", kAssociations);
    add_table("timing.csv", kTiming);
    add_table("memory.csv", kMemory);
    add("summary.json", [this](std::ostream& file) { write_summary(file); });
    if (has_earlier_map_) add_table("relocalisations.csv", kRelocalisations);
    const bool has_scales = std::any_of(S_map_keyframe_.begin(), S_map_keyframe_.end(),
                                        [](const auto& keyframe) { return keyframe.second.scale != 1.0; });
    if (has_scales) add("scales.csv", [this](std::ostream& file) { write_scales(file); });
    if (has_loop_scales_) add_table("loop_scales.csv", kLoopScales);
    if (const Status made = make_directory(directory); !made) return made;
    const Status written = write_files(files);
    if (!kept || !written) return kept ? written : kept;
    // What this run does not have may still lie there from one before.
    for (const char* name : kSometimesWritten) {
      const std::string path = directory + "/" + name;
      const auto is_it = [&path](const auto& file) { return file.first == path; };
      std::error_code ignored;
      if (std::none_of(files.begin(), files.end(), is_it)) std::filesystem::remove(path, ignored);
    }
    return {};
  }

 private:
  /// The frame's rows.   @param T_map_odom after the frame before; then after this one
  Rows rows_of(std::int64_t frame_id, const OpenFrame& frame, SE3* T_map_odom) const {
    Rows rows;
    if (frame.T_map_odom) *T_map_odom = frame.T_map_odom->first;  // what a live user had
    if (frame.place) {
      rows[kLivePoses] = format_tum_pose({frame.place->stamp_ns, *T_map_odom * frame.T_odom_live}) + '\n';
      constexpr int kMicrosecondDecimals = 1;
      rows[kTiming] = csv_row(frame_id, format_fixed(frame.associations.duration_us, kMicrosecondDecimals),
                              format_fixed(frame.mapping_us, kMicrosecondDecimals),
                              format_fixed(frame.loop_us, kMicrosecondDecimals),
                              format_fixed(frame.optimise_us, kMicrosecondDecimals));
    }
    if (frame.memory) {
      rows[kMemory] =
          csv_row(frame_id, format_fixed(frame.memory->resident_mb, 1), format_fixed(frame.memory->peak_mb, 1));
    }
    if (frame.T_map_odom) *T_map_odom = frame.T_map_odom->second;
    for (const LoopClosure& loop : frame.loops) {
      rows[loop.T_earlier_match ? kRelocalisations : kLoops] += table_row(loop);
      if (loop.accepted && !loop.T_earlier_match) rows[kLoopObjects] += loop_object_rows(loop, *classes_);
      const double log_scale_variance = loop.scale_covariance(6);
      if (!(log_scale_variance > 0.0)) continue;
      rows[kLoopScales] +=
          csv_row(loop.query_frame, loop.match_frame, loop.accepted, loop.scale, std::sqrt(log_scale_variance));
    }
    for (const Association& association : frame.associations.associations) {
      rows[kAssociations] +=
          csv_row(frame_id, association.detection_index, association.landmark_id, level_name(association.level));
    }
    return rows;
  }

  /// Hands the frames of which nothing more will come to the disk.
  void settle(std::int64_t newest_ns) {
    constexpr std::int64_t kOpen_ns = 10'000'000'000;  // no stage is as late
    for (;;) {
      const auto recorded =
          std::find_if(open_.begin(), open_.end(), [](const auto& frame) { return frame.second.place.has_value(); });
      if (recorded == open_.end() || recorded->second.place->stamp_ns > newest_ns - kOpen_ns) break;
      const auto& [frame_id, frame] = *open_.begin();
      const Rows rows = rows_of(frame_id, frame, &settled_T_map_odom_);
      for (std::size_t table = 0; table < rows.size(); ++table) settled_[table].add(rows[table], directory_);
      if (frame.place) {
        settled_places_.add({reinterpret_cast<const char*>(&*frame.place), sizeof(FramePlace)}, directory_);
      }
      settled_counts_.add(frame);
      open_.erase(open_.begin());
    }
  }

  /// Pose after the last optimisation: on the way from the frame's keyframe to the next, or hung on the last T_map_odom
  /// without one.
  SE3 final_pose(const FramePlace& frame) const {
    const auto solution = S_map_keyframe_.find(frame.keyframe_id);
    const auto keyframe = keyframes_.find(frame.keyframe_id);
    if (solution == S_map_keyframe_.end() || keyframe == keyframes_.end()) {
      return last_T_map_odom_.second * frame.T_odom_camera();
    }
    const SE3 T_keyframe_odom = keyframe->second.T_odom_camera().inverse();
    const SE3 T_keyframe_camera = T_keyframe_odom * frame.T_odom_camera();
    const auto next = std::next(keyframe);
    const auto next_solution = next == keyframes_.end() ? S_map_keyframe_.end() : S_map_keyframe_.find(next->first);
    if (next_solution == S_map_keyframe_.end() || is_broken_after(frame.keyframe_id)) {
      return solution->second.pose(T_keyframe_camera);
    }
    SE3 T_keyframe_next = solution->second.T.inverse() * next_solution->second.T;
    T_keyframe_next.t /= solution->second.scale;
    const double share = static_cast<double>(frame.stamp_ns - keyframe->second.stamp_ns) /
                         static_cast<double>(next->second.stamp_ns - keyframe->second.stamp_ns);
    return solution->second.pose(
        motion_on_the_way(T_keyframe_camera, T_keyframe_odom * next->second.T_odom_camera(), T_keyframe_next, share));
  }

  /// True if the odometry broke on the way to the next keyframe.
  bool is_broken_after(std::int64_t keyframe_id) const {
    return std::any_of(odometry_.faults.begin(), odometry_.faults.end(), [keyframe_id](const OdometryFault& fault) {
      return fault.is_break && fault.from_keyframe_id <= keyframe_id && keyframe_id < fault.to_keyframe_id;
    });
  }

  Status write_trajectory(std::ostream& file) const {
    const auto write = [&](const FramePlace& frame) {
      file << format_tum_pose({frame.stamp_ns, final_pose(frame)}) << '\n';
    };
    const Status read = settled_places_.read(sizeof(FramePlace), [&](std::string_view places) {
      for (; places.size() >= sizeof(FramePlace); places.remove_prefix(sizeof(FramePlace))) {
        FramePlace frame;
        std::memcpy(&frame, places.data(), sizeof(FramePlace));
        write(frame);
      }
    });
    for (const auto& [frame_id, frame] : open_) {
      if (frame.place) write(*frame.place);
    }
    return read;
  }

  void write_keyframes(std::ostream& file) const {
    file << keyframe_table_header();
    for (const auto& [keyframe_id, frame] : keyframes_) {
      file << table_row(KeyframePose{keyframe_id, frame.frame_id, frame.stamp_ns, final_pose(frame)});
    }
  }

  void write_objects(std::ostream& file) const {
    file << object_table_header();
    for (const auto& [id, landmark] : landmarks_) {
      if (!landmark.ellipsoid) continue;
      file << table_row(mapped_object(landmark, *classes_));
    }
  }

  void write_verdicts(std::ostream& file) const {
    file << "query_keyframe,match_keyframe,query_frame,match_frame,extra,kept,verdict\n";
    const auto frame_of = [this](std::int64_t keyframe_id) {
      const auto found = keyframes_.find(keyframe_id);
      return found == keyframes_.end() ? -1 : found->second.frame_id;
    };
    for (const auto& [number, verdict] : verdicts_) {
      file << csv_row(verdict.query_keyframe_id, verdict.match_keyframe_id, frame_of(verdict.query_keyframe_id),
                      frame_of(verdict.match_keyframe_id), verdict.is_extra, verdict.kept,
                      verdict.reason.empty() ? "kept" : verdict.reason);
    }
  }

  void write_scales(std::ostream& file) const {
    file << "keyframe_id,frame_id,scale\n";
    for (const auto& [keyframe_id, frame] : keyframes_) {
      const auto solution = S_map_keyframe_.find(keyframe_id);
      if (solution == S_map_keyframe_.end()) continue;
      file << csv_row(keyframe_id, frame.frame_id, solution->second.scale);
    }
  }

  void write_summary(std::ostream& file) const {
    Counts counts = settled_counts_;
    for (const auto& [frame_id, frame] : open_) counts.add(frame);
    std::map<std::string, int> states;
    for (const auto& [id, landmark] : landmarks_) ++states[to_string(landmark.state)];
    std::int64_t kept = 0;
    for (const auto& [number, verdict] : verdicts_) {
      const bool is_own = !verdict.is_extra && keyframes_.count(verdict.query_keyframe_id) > 0;
      kept += is_own && verdict.kept ? 1 : 0;
    }
    nlohmann::json summary = {{"frames", counts.frames},
                              {"keyframes", keyframes_.size()},
                              {"breaks", counts.breaks},
                              {"detections", counts.detections},
                              {"associations", counts.levels},
                              {"landmarks", states},
                              {"merges", merges_},
                              {"loops",
                               {{"candidates", counts.candidates},
                                {"accepted", counts.accepted},
                                {"kept", kept},
                                {"reasons", counts.reasons}}},
                              {"corrections", corrections_},
                              {"odometry", odometry_summary(odometry_)}};
    if (tracking_) summary["images"] = to_json(*tracking_);
    std::vector<Landmark> landmarks;
    for (const auto& [id, landmark] : landmarks_) landmarks.push_back(landmark);
    if (const std::optional<MapUnit> unit = map_unit(landmarks, *classes_)) {
      summary["unit"] = {
          {"metres", unit->metres}, {"sigma", unit->sigma}, {"objects", unit->objects}, {"classes", unit->classes}};
    }
    if (const std::optional<JoinedMap> joined = joined_map()) {
      summary["joined_map"] = {{"after_s", joined->after_s}, {"loops", joined->loops}};
    }
    if (has_earlier_map_) summary["relocalisation"] = to_json(relocalisation_);
    constexpr int kIndent = 2;
    file << summary.dump(kIndent) << '\n';
  }

  std::shared_ptr<const ClassTable> classes_;
  std::string directory_;            ///< of the rows on the disk
  std::int64_t memory_second_ = -1;  ///< of the data, in which the memory was looked at last

  std::map<std::int64_t, FramePlace> keyframes_;  ///< by keyframe_id
  std::map<std::int64_t, OpenFrame> open_;        ///< by frame_id
  std::array<Spool, kTables> settled_;            ///< rows of the frames before
  Spool settled_places_;                          ///< of them
  Counts settled_counts_;
  SE3 settled_T_map_odom_;
  std::pair<std::int64_t, SE3> last_T_map_odom_{-1, {}};  ///< with the id of the frame
  std::map<std::int64_t, Landmark> landmarks_;            ///< latest state of those that still exist
  bool has_earlier_map_ = false;                          ///< there was a candidate in it
  bool has_loop_scales_ = false;                          ///< a loop states one
  std::map<std::int64_t, Sim3> S_map_keyframe_;           ///< of the last solution, by keyframe_id
  std::map<std::int64_t, LoopVerdict> verdicts_;          ///< by the loop's number
  OdometryReport odometry_;                               ///< of the last correction that changed something
  std::optional<TrackingReport> tracking_;
  std::optional<Relocalisation> relocalisation_;
  int merges_ = 0;
  int corrections_ = 0;
};

}  // namespace

Status check_survives_run(const std::string& path, const std::string& directory) {
  std::vector<const char*> names(kSometimesWritten.begin(), kSometimesWritten.end());
  names.insert(names.end(), {"trajectory_live.txt", "trajectory.txt", "keyframes.csv", "objects.csv", "loops.csv",
                             "loop_verdicts.csv", "loop_objects.csv", "associations.csv", "timing.csv", "memory.csv",
                             "summary.json"});
  for (const char* name : names) {
    if (!is_same_file(path, directory + "/" + name)) continue;
    return Error{path + ": the run's results would take its place: give another directory for them"};
  }
  return {};
}

void record(const Frame& frame, const FrameResult& result, RunRecorder* recorder) {
  recorder->record(frame);
  recorder->record(result.associations);
  recorder->record(result.observation);
  recorder->record(frame.frame_id, result.loops, result.loop_us);
  recorder->record(result.relocalisation);
  recorder->record(result.correction);
  recorder->record(result.completion);
}

std::unique_ptr<RunRecorder> make_run_recorder(std::shared_ptr<const ClassTable> classes, std::string directory) {
  return std::make_unique<FileRecorder>(std::move(classes), std::move(directory));
}

}  // namespace semantic_topo_loop::core
