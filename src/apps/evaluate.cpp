#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "apps/program.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "tools/evaluation/loop_evaluation.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;
using Json = nlohmann::json;

struct Arguments {
  std::string run;        ///< directory of the run, or its trajectory
  std::string truth;      ///< trajectory
  std::string reference;  ///< objects
  std::string json, aligned_by, mocap, sightings, details;
  bool with_scale = false;
};

std::string line(std::string name, const std::string& value) {
  constexpr std::size_t kWidth = 34;
  name.resize(std::max(name.size(), kWidth), ' ');
  return name + ' ' + value + '\n';
}

/// A count, ratio or error, for people and for programs.
struct Figure {
  static constexpr char kNone[] = "none";  ///< to judge by

  Figure(int count) : text(std::to_string(count)), json(count) {}
  Figure(const Ratio& ratio)
      : text(format_fixed(ratio.value(), 4) + "  (" + std::to_string(ratio.right) + " / " +
             std::to_string(ratio.total) + ")"),
        json{{"value", ratio.value()}, {"right", ratio.right}, {"total", ratio.total}} {
    if (ratio.total == 0) text = kNone;
  }
  Figure(const ErrorStatistics& e, const char* unit)
      : text("rmse " + format_fixed(e.rmse, 4) + "  mean " + format_fixed(e.mean, 4) + "  median " +
             format_fixed(e.median, 4) + "  max " + format_fixed(e.max, 4) + " " + unit + "  (" +
             std::to_string(e.count) + ")"),
        json{{"count", e.count}, {"rmse", e.rmse}, {"mean", e.mean}, {"median", e.median}, {"max", e.max}} {
    if (e.count > 0) return;
    text = kNone;  // and no error of zero
    for (const char* key : {"rmse", "mean", "median", "max"}) json[key] = nullptr;
  }

  std::string text;
  Json json;
};

/// The figures of one evaluation: as a table for people and as JSON for programs.
struct Report {
  std::string table;
  Json json;

  void add(const char* name, const char* key, const Figure& figure) {
    table += line(name, figure.text);
    json[key] = figure.json;
  }
  void add_detectability(const std::string& name, const Detectability& d) {
    table += line(name + ": precision", Figure(d.precision).text) + line(name + ": recall", Figure(d.recall).text) +
             line(name + ": F", format_fixed(d.f(), 4));
    json[name] = {{"precision", Figure(d.precision).json}, {"recall", Figure(d.recall).json}, {"f", d.f()}};
  }
};

Result<TrajectoryEvaluation> align_files(const std::string& estimate, const std::string& reference, bool with_scale,
                                         const std::optional<Alignment>& known = std::nullopt) {
  const auto estimated = read_tum_trajectory(estimate);
  if (!estimated) return estimated.error();
  const auto truth = read_tum_ground_truth(reference);
  if (!truth) return truth.error();
  auto evaluation = evaluate_trajectory(*estimated, *truth, with_scale, known);
  if (!evaluation) return Error{estimate + ": " + evaluation.message()};
  return evaluation;
}

Result<Report> report_trajectory(const Arguments& arguments) {
  std::optional<Alignment> known;
  if (!arguments.aligned_by.empty()) {
    const auto other = align_files(arguments.aligned_by, arguments.truth, arguments.with_scale);
    if (!other) return other.error();
    known = other->alignment;
  }
  const auto e = align_files(arguments.run, arguments.truth, arguments.with_scale, known);
  if (!e) return e.error();
  Report report;
  report.table =
      line("poses (estimate, ground truth)", std::to_string(e->estimated) + ", " + std::to_string(e->reference));
  report.json = {{"estimated", e->estimated}, {"reference", e->reference}, {"scale", e->alignment.scale}};
  report.add("pairs within 0.02 s", "pairs", static_cast<int>(e->pairs));
  report.table += line("scale", std::to_string(e->alignment.scale));
  report.add("ATE", "ate_m", {e->absolute_m, "m"});
  report.add("rotation after alignment", "ate_deg", {e->absolute_deg, "deg"});
  report.add("RPE over 1 s, translation", "rpe_m", {e->relative_m, "m"});
  report.add("RPE over 1 s, rotation", "rpe_deg", {e->relative_deg, "deg"});
  return report;
}

/// One row an object: what it was matched with.
void list_objects(const ObjectEvaluation& evaluation, const std::vector<MappedObject>& objects,
                  const std::vector<ReferenceObject>& references, Report* report) {
  std::map<std::int64_t, const MappedObject*> object_of;
  std::map<int, const ReferenceObject*> reference_of;
  for (const MappedObject& object : objects) object_of[object.id] = &object;
  for (const ReferenceObject& reference : references) reference_of[reference.id] = &reference;
  Json rows = Json::array();
  report->table += "\nobject label            reference certainty  distance_m\n";
  for (const ObjectMatchResult& match : evaluation.matches) {
    const ReferenceObject* reference = match.reference_id < 0 ? nullptr : reference_of[match.reference_id];
    const std::string label = match.object_id < 0 ? reference->label : object_of[match.object_id]->label;
    const char* certainty = reference == nullptr ? "-" : name_of(reference->certainty);
    const std::string object_text = match.object_id < 0 ? "missed" : std::to_string(match.object_id);
    const std::string reference_text = reference == nullptr ? "false" : std::to_string(reference->id);
    char text[160];
    std::snprintf(text, sizeof(text), "%6s %-16s %9s %-9s %11.4f\n", object_text.c_str(), label.c_str(),
                  reference_text.c_str(), certainty, match.distance_m);
    report->table += text;
    rows.push_back({{"object", match.object_id},
                    {"label", label},
                    {"reference", match.reference_id},
                    {"certainty", certainty},
                    {"distance_m", match.distance_m}});
  }
  report->json["matches"] = rows;
}

Result<Report> report_objects(const Arguments& arguments) {
  const std::string& run = arguments.run;
  const auto objects = read_objects(run + "/objects.csv");
  if (!objects) return objects.error();
  const auto references = read_reference_objects(arguments.reference);
  if (!references) return references.error();
  if (const Status labels = check_labels(*objects, *references); !labels) {
    return Error{arguments.reference + ": " + labels.message()};
  }
  const auto trajectory = align_files(run + "/trajectory.txt", arguments.truth, arguments.with_scale);
  if (!trajectory) return trajectory.error();
  const ObjectEvaluation e = evaluate_objects(*objects, *references, trajectory->alignment);
  Report report;
  report.add_detectability("certain", e.certain);
  report.add_detectability("strict", e.strict);
  report.add("no other object nearby (paper)", "undisputed", e.undisputed);
  report.table += line("matched probable, marginal",
                       std::to_string(e.matched_probable) + ", " + std::to_string(e.matched_marginal));
  report.json["matched_certain"] = e.matched_certain;
  report.json["matched_probable"] = e.matched_probable;
  report.json["matched_marginal"] = e.matched_marginal;
  report.add("distance to certain references", "center_m", {e.center_m, "m"});
  list_objects(e, *objects, *references, &report);
  return report;
}

/// What the figures of a run's loops are computed from.
struct LoopFiles {
  std::vector<JudgedLoop> loops;
  int into_earlier_sessions = 0;  ///< loops that are not among them
  TruePoses truth;
  KeyframeViews keyframes;
};

Result<LoopFiles> read_loop_files(const Arguments& arguments) {
  const std::string& run = arguments.run;
  if (const std::string scales = run + "/loop_scales.csv"; std::filesystem::exists(scales)) {
    return Error{scales + ": the run's unit of length drifts, in which its loops are; they cannot be judged in metres"};
  }
  const auto loops = read_loops(run + "/loops.csv");
  if (!loops) return loops.error();
  const auto frames = read_tum_trajectory(run + "/trajectory.txt");
  if (!frames) return frames.error();
  const auto keyframes = read_keyframes(run + "/keyframes.csv");
  if (!keyframes) return keyframes.error();
  const auto sightings = read_sightings(arguments.sightings.empty() ? run : arguments.sightings);
  if (!sightings) return sightings.error();
  auto truth = read_tum_ground_truth(arguments.truth);
  if (!truth) return truth.error();
  const auto mocap = arguments.mocap.empty() ? StampedPoses() : read_tum_ground_truth(arguments.mocap);
  if (!mocap) return mocap.error();
  constexpr double kMaxMocapGap_s = 0.1;  // ten samples of a motion capture at 100 Hz
  LoopFiles files{{}, 0, TruePoses(*std::move(truth), *mocap, kMaxMocapGap_s), {}};
  for (const KeyframePose& keyframe : *keyframes) files.keyframes.keyframe_stamps_ns.push_back(keyframe.stamp_ns);
  auto judged = judge_loops(*loops, *frames, files.truth, first_frame_id(*keyframes));
  if (!judged) return Error{run + "/loops.csv: " + judged.message()};
  files.loops = *std::move(judged);
  files.into_earlier_sessions = static_cast<int>(loops->size() - files.loops.size());
  files.keyframes.objects.resize(static_cast<std::size_t>(files.truth.size()));
  for (const auto& [stamp_ns, ids] : *sightings) {
    const int image = files.truth.find(stamp_ns);
    if (image >= 0) files.keyframes.objects[static_cast<std::size_t>(image)].assign(ids.begin(), ids.end());
  }
  return files;
}

Report report_geometry(const LoopEvaluation& e) {
  Report report;
  report.add("candidates", "candidates", e.candidates);
  report.add("accepted", "accepted", e.accepted);
  report.add("not judged (mocap holes)", "not_judged", e.not_judged);
  report.add("right within 0.35 m, 10 deg", "right_wide", e.right_wide);
  report.add("right within 0.20 m, 5 deg", "right_narrow", e.right_narrow);
  report.add("error, translation", "error_m", {e.error_m, "m"});
  report.add("error, rotation", "error_deg", {e.error_deg, "deg"});
  report.table += line("largest viewpoint difference, right", format_fixed(e.largest_right_view_deg, 1) + " deg");
  report.json["largest_right_view_deg"] = e.largest_right_view_deg;
  report.add("loopable queries closed", "closed", Ratio{e.closed, e.loopable});
  report.add("loopable queries closed at once", "closed_at_once", Ratio{e.closed_at_once, e.loopable});
  report.add("pairs: precision (paper)", "pair_precision", e.pair_precision);
  report.add("pairs: recall (paper)", "pair_recall", e.pair_recall);
  return report;
}

void add_viewpoints(const LoopEvaluation& e, Report* report) {
  report->table += "\nviewpoint difference, deg  right within 0.35 m, 10 deg   median error\n";
  for (const ViewpointFigures& bin : e.by_viewpoint) {
    char text[160];
    const std::string errors = bin.error_m.count == 0 ? Figure::kNone
                                                      : format_fixed(bin.error_m.median, 3) + " m, " +
                                                            format_fixed(bin.error_deg.median, 2) + " deg";
    std::snprintf(text, sizeof(text), "%8.0f to %3.0f %13s %-27s %s\n", bin.from_deg, bin.to_deg, "",
                  Figure(bin.right_wide).text.c_str(), errors.c_str());
    report->table += text;
    report->json["by_viewpoint"].push_back({{"from_deg", bin.from_deg},
                                            {"to_deg", bin.to_deg},
                                            {"right_wide", Figure(bin.right_wide).json},
                                            {"right_narrow", Figure(bin.right_narrow).json},
                                            {"error_m", Figure(bin.error_m, "").json},
                                            {"error_deg", Figure(bin.error_deg, "").json}});
  }
}

void add_revisits(const LoopEvaluation& e, const TruePoses& truth, Report* report) {
  std::vector<double> latencies_s;
  Json rows = Json::array();
  for (const Revisit& revisit : e.revisits) {
    const int closed = revisit.first + revisit.latency_frames.value_or(0);
    const double latency_s = 1e-9 * static_cast<double>(truth.stamp_ns(closed) - truth.stamp_ns(revisit.first));
    if (revisit.latency_frames) latencies_s.push_back(latency_s);
    rows.push_back({{"first_image", revisit.first},
                    {"last_image", revisit.last},
                    {"latency_frames", revisit.latency_frames ? Json(*revisit.latency_frames) : Json()},
                    {"latency_s", revisit.latency_frames ? Json(latency_s) : Json()}});
  }
  const auto closed = static_cast<int>(latencies_s.size());
  report->table += line("revisits closed", Figure(Ratio{closed, static_cast<int>(e.revisits.size())}).text) +
                   line("latency, revisit to loop", Figure(error_statistics(std::move(latencies_s)), "s").text);
  report->json["revisits"] = rows;
}

void add_table(const std::vector<CriterionCounts>& rows, Report* report) {
  report->table +=
      "\ncriterion  keyframes  reference pairs, loops, found  real loops, true positives  precision  recall\n";
  for (const CriterionCounts& row : rows) {
    char text[160];
    std::snprintf(text, sizeof(text), "%-9s %10d %16d, %5d, %5d %11d, %14d %10.4f %7.4f\n", row.name, row.keyframes,
                  row.reference_pairs, row.reference_loops, row.found, row.real_loops, row.true_positives,
                  row.precision().value(), row.recall().value());
    report->table += text;
    report->json["table"].push_back({{"criterion", row.name},
                                     {"keyframes", row.keyframes},
                                     {"reference_pairs", row.reference_pairs},
                                     {"reference_loops", row.reference_loops},
                                     {"real_loops", row.real_loops},
                                     {"true_positives", row.true_positives},
                                     {"right_wide", Figure(row.right_wide).json},
                                     {"found", row.found}});
  }
}

Status write_details(const LoopFiles& files, const std::string& directory) {
  if (const Status made = make_directory(directory); !made) return made;
  const std::pair<const char*, std::string> texts[] = {
      {"judged_loops.csv", judged_loops_csv(files.loops, files.truth)},
      {"reference_pairs.csv", reference_pairs_csv(reference_pairs(files.truth, files.keyframes), files.truth)},
      {"precision_recall.csv", loop_curve_csv(loop_curve(files.loops, files.truth, files.keyframes))}};
  for (const auto& [name, text] : texts) {
    if (const Status written = write_text_file(directory + "/" + name, text); !written) return written;
  }
  return {};
}

Result<Report> report_loops(const Arguments& arguments) {
  const Result<LoopFiles> files = read_loop_files(arguments);
  if (!files) return files.error();
  const LoopEvaluation e = evaluate_loops(files->loops, files->truth);
  Report report = report_geometry(e);
  if (files->into_earlier_sessions > 0) {
    report.add("left out, into earlier sessions", "into_earlier_sessions", files->into_earlier_sessions);
  }
  add_revisits(e, files->truth, &report);
  add_viewpoints(e, &report);
  add_table(count_by_criterion(files->loops, files->truth, files->keyframes), &report);
  if (arguments.details.empty()) return report;
  const Status written = write_details(*files, arguments.details);
  if (!written) return written.error();
  return report;
}

/// The command that makes a report; `arguments` must live as long as it.
Command make_command(const char* name, const char* usage, const char* purpose,
                     Result<Report> (*make_report)(const Arguments&), Arguments* arguments) {
  Command command{name, usage, purpose};
  command.option("json", po::value(&arguments->json), "file for the figures as JSON");
  command.run = [make_report, arguments]() -> Status {
    const Result<Report> report = make_report(*arguments);
    if (!report) return report.error();
    std::fputs(report->table.c_str(), stdout);
    return arguments->json.empty() ? Status() : write_text_file(arguments->json, report->json.dump(2) + '\n');
  };
  return command;
}

}  // namespace

/// Judges the files of a run.
int main(int argc, char** argv) {
  Arguments arguments;
  Command trajectory = make_command("trajectory", "EST GT [--scale] [--aligned-by FILE] [--json FILE]",
                                    "Absolute (ATE) and relative (RPE over 1 s) errors of a TUM trajectory.\n",
                                    report_trajectory, &arguments);
  trajectory.words = {{"EST", &arguments.run}, {"GT", &arguments.truth}};
  trajectory.option("scale", po::bool_switch(&arguments.with_scale), "align by a similarity (monocular odometry)")
      .option("aligned-by", po::value(&arguments.aligned_by),
              "trajectory in the same frame, such as the map's, by which it is aligned instead");
  Command objects = make_command("objects", "RUN_DIR GT REFERENCE [--scale] [--json FILE]",
                                 "objects.csv against reference objects, aligned by trajectory.txt and GT.\n",
                                 report_objects, &arguments);
  objects.words = {{"RUN_DIR", &arguments.run}, {"GT", &arguments.truth}, {"REFERENCE", &arguments.reference}};
  objects.option("scale", po::bool_switch(&arguments.with_scale), "align by a similarity (monocular odometry)");
  Command loops =
      make_command("loops", "RUN_DIR GT_FRAMES [--mocap F] [--sightings RUN_DIR] [--details DIR] [--json FILE]",
                   "loops.csv against a true pose for every image.\n", report_loops, &arguments);
  loops.words = {{"RUN_DIR", &arguments.run}, {"GT_FRAMES", &arguments.truth}};
  loops.option("mocap", po::value(&arguments.mocap), "the motion capture's own file, in whose holes nothing is judged")
      .option("sightings", po::value(&arguments.sightings),
              "run that tells which objects two keyframes see in common (default: the run itself)")
      .option("details", po::value(&arguments.details),
              "directory for judged_loops.csv, reference_pairs.csv and precision_recall.csv");
  return run_program("evaluate", {trajectory, objects, loops}, argc, argv);
}
