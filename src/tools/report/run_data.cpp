#include "tools/report/run_data.h"

#include <cstddef>
#include <filesystem>
#include <map>
#include <tuple>
#include <utility>

#include "io/csv.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

VerdictRecord read_verdict(CsvTable& table) {
  VerdictRecord row;
  table("query_frame", row.query_frame);
  table("match_frame", row.match_frame);
  table("extra", row.is_extra);
  table("kept", row.is_kept);
  table("verdict", row.verdict);
  return row;
}

FrameTiming read_timing(CsvTable& table) {
  FrameTiming row;
  table("frame_id", row.frame_id);
  for (std::size_t i = 0; i < kStages.size(); ++i) table((std::string(kStages[i]) + "_us").c_str(), row.stages_us[i]);
  return row;
}

MemoryRecord read_memory(CsvTable& table) {
  MemoryRecord row;
  table("frame_id", row.frame_id);
  table("resident_mb", row.resident_mb);
  table("peak_mb", row.peak_mb);
  return row;
}

/// Hands a file's rows over, or notes the first error.
class FileReader {
 public:
  template <class Value>
  void take(Result<Value> read, Value* value) {
    if (!status_) return;
    if (read) {
      *value = *std::move(read);
    } else {
      status_ = read.error();
    }
  }
  const Status& status() const { return status_; }

 private:
  Status status_;
};

std::string directory_name(const std::string& directory) {
  std::error_code ignored;
  const std::filesystem::path path = std::filesystem::canonical(directory, ignored);
  return path.filename().string();
}

/// The number of an accepted loop, what the pose graph made of it and the submaps that it joins.
void complete_loops(const std::vector<VerdictRecord>& verdicts, std::vector<LoopObjectRecord> objects, RunData* run) {
  using Frames = std::pair<std::int64_t, std::int64_t>;
  std::map<Frames, std::vector<const VerdictRecord*>> verdicts_of;  // the last first
  for (auto verdict = verdicts.rbegin(); verdict != verdicts.rend(); ++verdict) {
    if (!verdict->is_extra) verdicts_of[{verdict->query_frame, verdict->match_frame}].push_back(&*verdict);
    if (verdict->is_extra && verdict->query_frame >= 0) run->extra_loops.push_back(*verdict);  // else of before
  }
  using Key = std::tuple<std::int64_t, std::int64_t, std::int64_t, std::int64_t>;
  std::map<Key, std::vector<LoopObjectRecord>> objects_of;
  for (LoopObjectRecord& object : objects) {
    const Key key(object.query_frame, object.match_frame, object.query_end, object.match_end);
    objects_of[key].push_back(std::move(object));
  }
  int accepted = 0;
  for (ShownLoop& loop : run->loops) {
    const LoopRecord& record = loop.record;
    if (!record.accepted) continue;
    loop.number = ++accepted;
    const std::int64_t match_frame = run->is_into_map(record) ? -1 : record.match_frame;  // as the file has it
    const auto verdict = verdicts_of.find({record.query_frame, match_frame});
    if (verdict != verdicts_of.end() && !verdict->second.empty()) {
      loop.is_kept = verdict->second.back()->is_kept;
      loop.verdict = verdict->second.back()->verdict;
      verdict->second.pop_back();
    }
    for (LoopObjectRecord& object :
         objects_of[Key(record.query_frame, record.match_frame, record.query_end, record.match_end)]) {
      (object.is_query ? loop.query : loop.match).push_back(std::move(object));
    }
  }
}

/// Against the ground truth, if there is one.
Result<ShownTrajectory> shown(std::string name, StampedPoses poses, const std::string& path, const ReportInputs& inputs,
                              const StampedPoses& truth) {
  ShownTrajectory trajectory{std::move(name), std::move(poses), {}, {}};
  if (inputs.truth.empty()) return trajectory;
  Result<TrajectoryEvaluation> evaluation = evaluate_trajectory(trajectory.poses, truth, inputs.with_scale);
  if (!evaluation) return Error{path + ": " + evaluation.message()};
  trajectory.S_world_map = Sim3(evaluation->alignment.T_a_b, evaluation->alignment.scale);
  trajectory.evaluation = *std::move(evaluation);
  return trajectory;
}

Status read_trajectories(const ReportInputs& inputs, RunData* run) {
  std::vector<std::pair<std::string, std::string>> files = {{"live", inputs.run + "/trajectory_live.txt"},
                                                            {"optimised", inputs.run + "/trajectory.txt"}};
  // Of a run that goes on with a map it lies elsewhere, and only the truth brings them together.
  const bool is_first = run->timing.empty() || run->timing.front().frame_id == 0;
  if (!inputs.odometry.empty() && (is_first || !inputs.truth.empty())) {
    files.insert(files.begin(), {"odometry", inputs.odometry});
  }
  for (const auto& [name, path] : files) {
    Result<StampedPoses> poses = read_tum_trajectory(path);
    if (!poses) return poses.error();
    Result<ShownTrajectory> trajectory = shown(name, *std::move(poses), path, inputs, run->truth);
    if (!trajectory) return trajectory.error();
    run->trajectories.push_back(*std::move(trajectory));
  }
  return {};
}

}  // namespace

const StampedPose* RunData::pose_of(std::int64_t frame_id) const {
  const std::int64_t index = frame_id - timing.front().frame_id;
  const StampedPoses& poses = optimised().poses;
  if (index < 0 || index >= static_cast<std::int64_t>(poses.size())) return nullptr;
  return &poses[static_cast<std::size_t>(index)];
}

std::string RunData::match_time(const LoopRecord& loop) const {
  return is_into_map(loop) ? "earlier session" : format_fixed(seconds(loop.match_stamp_ns), 1) + " s";
}

Result<RunData> read_run(const ReportInputs& inputs) {
  RunData run;
  run.name = directory_name(inputs.run);
  FileReader reader;
  if (!inputs.truth.empty()) reader.take(read_tum_ground_truth(inputs.truth), &run.truth);
  if (!inputs.reference.empty()) reader.take(read_reference_objects(inputs.reference), &run.references);
  std::vector<KeyframePose> keyframes;
  std::vector<LoopRecord> loops;
  std::vector<LoopObjectRecord> loop_objects;
  std::vector<VerdictRecord> verdicts;
  reader.take(read_keyframes(inputs.run + "/keyframes.csv"), &keyframes);
  reader.take(read_objects(inputs.run + "/objects.csv"), &run.objects);
  reader.take(read_loops(inputs.run + "/loops.csv"), &loops);
  reader.take(read_loop_objects(inputs.run + "/loop_objects.csv"), &loop_objects);
  reader.take(read_csv<VerdictRecord>(inputs.run + "/loop_verdicts.csv", read_verdict), &verdicts);
  reader.take(read_csv<FrameTiming>(inputs.run + "/timing.csv", read_timing), &run.timing);
  reader.take(read_csv<MemoryRecord>(inputs.run + "/memory.csv", read_memory), &run.memory);
  if (!reader.status()) return reader.status().error();
  if (const Status read = read_trajectories(inputs, &run); !read) return read.error();
  const std::size_t poses = run.optimised().poses.size();
  if (run.timing.size() != poses) {
    return Error{inputs.run + "/timing.csv: " + std::to_string(run.timing.size()) + " frames, but trajectory.txt has " +
                 std::to_string(poses)};
  }
  run.keyframes = keyframes.size();
  for (LoopRecord& loop : loops) run.loops.push_back({std::move(loop), 0, false, {}, {}, {}});
  complete_loops(verdicts, std::move(loop_objects), &run);
  if (!inputs.reference.empty()) {
    if (const Status labels = check_labels(run.objects, run.references); !labels) {
      return Error{inputs.reference + ": " + labels.message()};
    }
    run.object_evaluation = evaluate_objects(run.objects, run.references, run.optimised().evaluation->alignment);
  }
  return run;
}

}  // namespace semantic_topo_loop::core
