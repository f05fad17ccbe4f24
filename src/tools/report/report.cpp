#include "tools/report/report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

#include "geometry/statistics.h"
#include "semantic_topo_loop/io/text_file.h"
#include "tools/report/chart.h"
#include "tools/report/loop_picture.h"
#include "tools/report/page.h"
#include "tools/report/top_view.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kWide_px = 1120.0, kHalf_px = 550.0;
constexpr const char* kBefore = "#e8590c";
constexpr const char* kAfter = "#1864ab";
constexpr const char* kTime = "time, s";

std::string count_of(std::size_t count, const std::string& what) { return std::to_string(count) + ' ' + what; }

Axis time_axis(const RunData& run) {
  Axis axis = axis_over(kTime, {0.0, run.seconds(run.optimised().poses.back().stamp_ns)});
  axis.min = 0.0;
  return axis;
}

// --- figures of a whole run ---------------------------------------------------------------------------------------

std::vector<double> frame_times_ms(const RunData& run) {
  std::vector<double> times;
  for (const FrameTiming& frame : run.timing) {
    double sum = 0.0;
    for (const double us : frame.stages_us) sum += us;
    times.push_back(1e-3 * sum);
  }
  return times;
}

std::string milliseconds(double ms) { return format_fixed(ms, ms < 10.0 ? 2 : ms < 100.0 ? 1 : 0); }

std::string tiles(const RunData& run) {
  const auto count_if = [](const auto& items, const auto& is) {
    return static_cast<std::size_t>(std::count_if(items.begin(), items.end(), is));
  };
  const std::size_t confirmed =
      count_if(run.objects, [](const MappedObject& object) { return object.state == "confirmed"; });
  const std::size_t accepted = count_if(run.loops, [](const ShownLoop& loop) { return loop.record.accepted; });
  std::string html = tile(format_fixed(run.seconds(run.optimised().poses.back().stamp_ns), 1) + " s",
                          count_of(run.timing.size(), "frames, ") + count_of(run.keyframes, "keyframes"));
  if (run.optimised().evaluation) {
    html += tile(format_fixed(run.trajectories.front().evaluation->absolute_m.rmse, 4) + " → " +
                     format_fixed(run.optimised().evaluation->absolute_m.rmse, 4) + " m",
                 "absolute trajectory error, " + run.trajectories.front().name + " → optimised");
  }
  std::string object_text = "confirmed objects";
  if (run.object_evaluation) {
    object_text += ", F " + format_fixed(run.object_evaluation->certain.f(), 3) + " against the reference";
  }
  html += tile(std::to_string(confirmed), object_text);
  html += tile(
      std::to_string(accepted),
      "loops accepted of " + count_of(run.loops.size(), "candidates, ") +
          count_of(count_if(run.loops, [](const ShownLoop& loop) { return loop.is_kept; }), "believed at the end"));
  html += tile(milliseconds(quantile(frame_times_ms(run), 0.5)) + " ms",
               "a frame (median), " + milliseconds(quantile(frame_times_ms(run), 0.95)) + " ms (p95)");
  double peak_mb = 0.0;
  for (const MemoryRecord& record : run.memory) peak_mb = std::max(peak_mb, record.peak_mb);
  html += tile(format_fixed(peak_mb, 0) + " MiB", "memory at most");
  return "<div class=\"tiles\">\n" + html + "</div>\n";
}

// --- trajectories -------------------------------------------------------------------------------------------------

std::string error_table(const RunData& run) {
  HtmlTable table({"trajectory", "poses", "ATE rmse, m", "mean", "median", "max", "RPE 1 s, m", "RPE 1 s, deg"});
  for (const ShownTrajectory& trajectory : run.trajectories) {
    const TrajectoryEvaluation& e = *trajectory.evaluation;
    const auto relative = [](const ErrorStatistics& errors, int decimals) {
      return errors.count > 0 ? format_fixed(errors.rmse, decimals) : std::string("-");
    };
    table.add({trajectory.name, std::to_string(e.pairs), format_fixed(e.absolute_m.rmse, 4),
               format_fixed(e.absolute_m.mean, 4), format_fixed(e.absolute_m.median, 4),
               format_fixed(e.absolute_m.max, 4), relative(e.relative_m, 4), relative(e.relative_deg, 3)});
  }
  return "<div class=\"wide\">" + table.html() + "</div>\n";
}

std::string draw_errors(const RunData& run) {
  std::vector<double> all;
  std::vector<LegendEntry> entries;
  for (const ShownTrajectory& trajectory : run.trajectories) {
    for (const PoseError& error : trajectory.evaluation->errors) all.push_back(error.error_m);
  }
  Axis axis = axis_over("distance from the ground truth, m", all, true);
  constexpr double kLeast_m = 1e-4;  // below it an error says nothing
  axis.min = std::max(axis.min, kLeast_m);
  axis.max = std::max(axis.max, 10.0 * axis.min);
  Chart chart({kHalf_px, 480.0}, time_axis(run), axis);
  for (const ShownTrajectory& trajectory : run.trajectories) {
    std::vector<Vec2> values;
    const std::vector<PoseError>& errors = trajectory.evaluation->errors;
    for (std::size_t i = 0; i < errors.size(); ++i) {
      if (i > 0 && is_gap(errors[i - 1].stamp_ns, errors[i].stamp_ns)) values.push_back(line_break());
      values.emplace_back(run.seconds(errors[i].stamp_ns), errors[i].error_m);
    }
    chart.series(values, trajectory_color(trajectory.name), "stroke-width=\"1.2\"");
    entries.push_back({trajectory_color(trajectory.name), trajectory.name});
  }
  return legend(entries) + chart.svg("error over time");
}

/// How far the optimisation moved what was known live.
std::string draw_shifts(const RunData& run) {
  const StampedPoses& before = run.trajectories.front().poses;
  const StampedPoses& after = run.optimised().poses;
  std::vector<Vec2> values;
  std::vector<double> all = {0.0};
  for (const StampedPose& pose : after) {
    const StampedPose* live = find_stamp(before, pose.stamp_ns, 0);
    if (live == nullptr) continue;
    all.push_back((live->T_world_camera.t - pose.T_world_camera.t).norm());
    values.emplace_back(run.seconds(pose.stamp_ns), all.back());
  }
  Chart chart({kHalf_px, 480.0}, time_axis(run), axis_over("moved, m", all));
  chart.series(values, kAfter, "stroke-width=\"1.4\"");
  return legend({{kAfter, run.trajectories.front().name + " to optimised"}}) +
         chart.svg("how far poses were moved over time");
}

std::string trajectory_section(const RunData& run, const TopView& view) {
  const bool has_truth = !run.truth.empty();
  std::string note = has_truth
                         ? "Each is aligned with the ground truth by itself, as <code>evaluate trajectory</code> does; "
                           "seen along the ground truth's z axis."
                         : "In the map's frame, seen from above; up is found from how the camera was turned.";
  if (!view.is_certain) note += " The camera hardly turned, so that up is its images' mean up, which may be tilted.";
  std::string content = "<div class=\"pair\">\n<div>\n<h3>From above</h3>\n" + draw_trajectories(run, view) +
                        "</div>\n<div>\n<h3>" +
                        (has_truth ? "Error over time</h3>\n" + draw_errors(run)
                                   : "What the optimisation moved</h3>\n" + draw_shifts(run)) +
                        "</div>\n</div>\n";
  if (has_truth) content += error_table(run);
  return section("trajectories", "Trajectories", note, content);
}

// --- objects ------------------------------------------------------------------------------------------------------

std::string object_table(const RunData& run) {
  if (run.objects.empty()) return {};
  std::map<std::int64_t, ObjectMatchResult> match_of;
  std::vector<std::string> columns = {"object",       "label", "state",         "x, m",     "y, m",   "z, m",
                                      "semi-axes, m", "boxes", "baseline, deg", "mean IoU", "quality"};
  if (run.object_evaluation) {
    for (const ObjectMatchResult& match : run.object_evaluation->matches) match_of[match.object_id] = match;
    columns.insert(columns.end(), {"reference", "off, m"});
  }
  HtmlTable table(columns);
  for (const MappedObject& object : run.objects) {
    const Vec3 at = run.optimised().S_world_map * object.center;
    const Vec3 axes = run.optimised().S_world_map.scale * object.semi_axes;
    std::vector<std::string> cells = {
        std::to_string(object.id),
        object.label,
        object.state,
        format_fixed(at.x(), 3),
        format_fixed(at.y(), 3),
        format_fixed(at.z(), 3),
        format_fixed(axes.x(), 3) + " × " + format_fixed(axes.y(), 3) + " × " + format_fixed(axes.z(), 3),
        std::to_string(object.observations),
        format_fixed(object.baseline_deg, 1),
        format_fixed(object.mean_iou, 3),
        format_fixed(object.quality, 3)};
    if (run.object_evaluation) {
      const auto match = match_of.find(object.id);
      const bool is_matched = match != match_of.end() && match->second.reference_id >= 0;
      cells.push_back(is_matched ? std::to_string(match->second.reference_id) : "");
      cells.push_back(is_matched ? format_fixed(match->second.distance_m, 4) : "");
    }
    table.add(cells);
  }
  return section("object-table", "Objects in figures", "A click on the name of a column sorts by it.",
                 "<div class=\"wide\">" + table.html() + "</div>\n");
}

std::string reference_note(const RunData& run) {
  if (!run.object_evaluation) return "Ellipses are the outlines of the ellipsoids from above.";
  const Detectability& certain = run.object_evaluation->certain;
  const auto ratio = [](const Ratio& r) { return std::to_string(r.right) + " of " + std::to_string(r.total); };
  std::string note = "Ellipses are the outlines of the ellipsoids from above. Right: " + ratio(certain.precision) +
                     "; certain references found: " + ratio(certain.recall);
  const ErrorStatistics& center_m = run.object_evaluation->center_m;
  note += center_m.count > 0 ? "; centres " + format_fixed(center_m.median, 3) + " m off (median)." : ".";
  for (const ObjectMatchResult& match : run.object_evaluation->matches) {
    if (match.object_id >= 0) continue;
    for (const ReferenceObject& reference : run.references) {
      if (reference.id == match.reference_id) note += " Missed: " + escaped(reference.label) + ".";
    }
  }
  return note;
}

std::string object_section(const RunData& run, const TopView& view, const ClassColors& colors) {
  if (run.objects.empty()) return section("objects", "Objects", "The run has no object.", "");
  return section("objects", "Objects", reference_note(run),
                 "<div class=\"wide\">" + draw_objects(run, view, colors) + "</div>\n");
}

// --- loops --------------------------------------------------------------------------------------------------------

/// Of candidates by reason; those that the pose graph does not believe are told apart.
constexpr const char* kBelievedColor = "#1864ab";
constexpr const char* kDisbelievedColor = "#f08c00";
std::string reason_color(std::size_t rank) {
  constexpr std::array<const char*, 8> kColors = {"#adb5bd", "#d6a2a2", "#c0a8dd", "#9fc5a5",
                                                  "#d9bf8c", "#8fc1cf", "#e0a3c8", "#a5a58d"};
  return kColors[std::min(rank, kColors.size() - 1)];
}

/// Reasons for rejection, the most frequent first.
std::vector<std::pair<std::string, std::size_t>> rejections(const RunData& run) {
  std::map<std::string, std::size_t> counts;
  for (const ShownLoop& loop : run.loops) {
    if (!loop.record.accepted) ++counts[loop.record.reason_text];
  }
  std::vector<std::pair<std::string, std::size_t>> sorted(counts.begin(), counts.end());
  std::stable_sort(sorted.begin(), sorted.end(), [](const auto& a, const auto& b) { return a.second > b.second; });
  return sorted;
}

/// Loops that have a picture on the page.
using Pictured = std::set<int>;

std::string draw_loops(const RunData& run, const Pictured& pictured) {
  constexpr double kRejected_px = 1.8, kAccepted_px = 3.2;
  Axis query = time_axis(run), match = query;
  query.title = "time of the query, s";
  match.title = "time of the match, s";
  // The time of another session has no place here: its loops are on the edge.
  const auto match_time = [&run](const LoopRecord& record) {
    return run.is_into_map(record) ? 0.0 : run.seconds(record.match_stamp_ns);
  };
  std::vector<double> matches = {0.0};
  for (const ShownLoop& loop : run.loops) matches.push_back(match_time(loop.record));
  match.max = axis_over("", matches).max;
  Chart chart({kHalf_px, 400.0}, query, match);
  std::map<std::string, std::size_t> rank;
  std::vector<LegendEntry> entries = {{kBelievedColor, "accepted", LegendEntry::kDot},
                                      {kDisbelievedColor, "accepted, not believed", LegendEntry::kDot}};
  for (const auto& [reason, count] : rejections(run)) {
    entries.push_back({reason_color(rank.size()), reason, LegendEntry::kDot});
    rank.emplace(reason, rank.size());
  }
  std::string rejected, accepted;
  std::set<std::tuple<std::string, double, double>> drawn;
  for (const ShownLoop& loop : run.loops) {
    const LoopRecord& record = loop.record;
    const Vec2 at = chart.to_px({run.seconds(record.query_stamp_ns), match_time(record)});
    const std::string color = loop.is_kept      ? kBelievedColor
                              : record.accepted ? kDisbelievedColor
                                                : reason_color(rank.at(record.reason_text));
    const bool is_pictured = pictured.count(loop.number) != 0;
    if (!is_pictured && !drawn.emplace(color, std::round(at.x()), std::round(at.y())).second) continue;
    std::string dot = "<circle cx=\"" + px(at.x()) + "\" cy=\"" + px(at.y()) + "\" r=\"" +
                      px(record.accepted ? kAccepted_px : kRejected_px) + "\" fill=\"" + color + "\"";
    if (is_pictured) dot += " class=\"pick\" data-loop=\"" + std::to_string(loop.number) + "\"";
    (record.accepted ? accepted : rejected) += dot + "/>\n";
  }
  chart.add(rejected + accepted);
  return legend(entries) + chart.svg("loops over time");
}

std::string reason_table(const RunData& run) {
  HtmlTable table({"reason", "candidates", "share, %"});
  std::map<std::string, std::size_t> verdicts, extra_verdicts;
  const auto kind = [](const std::string& verdict) { return verdict.substr(0, verdict.find(':')); };
  std::size_t accepted = 0;
  for (const ShownLoop& loop : run.loops) {
    if (!loop.record.accepted) continue;
    ++accepted;
    if (!loop.is_kept) ++verdicts[kind(loop.verdict)];
  }
  for (const VerdictRecord& loop : run.extra_loops) {
    if (!loop.is_kept) ++extra_verdicts[kind(loop.verdict)];
  }
  const auto add = [&](const std::string& reason, std::size_t count) {
    const double share = 100.0 * static_cast<double>(count) / static_cast<double>(run.loops.size());
    table.add({reason, std::to_string(count), format_fixed(share, 1)});
  };
  if (!run.loops.empty()) add("accepted", accepted);
  for (const auto& [verdict, count] : verdicts) add("accepted, but not believed: " + verdict, count);
  for (const auto& [reason, count] : rejections(run)) add(reason, count);
  const auto add_extra = [&table](const std::string& reason, std::size_t count) {
    table.add({reason, std::to_string(count), ""});  // no share of the candidates: they are none
  };
  if (!run.extra_loops.empty()) add_extra("from outside", run.extra_loops.size());
  for (const auto& [verdict, count] : extra_verdicts) add_extra("from outside, but not believed: " + verdict, count);
  return table.html();
}

std::string describe(const RunData& run, const ShownLoop& loop) {
  const LoopRecord& record = loop.record;
  const auto time = [&run](std::int64_t stamp_ns) { return format_fixed(run.seconds(stamp_ns), 1) + " s"; };
  std::string text = std::to_string(record.inliers) + " matched objects of " + std::to_string(loop.match.size()) +
                     " and " + std::to_string(loop.query.size()) + ", rms " + format_fixed(record.rms_m, 3) +
                     " m, score " + format_fixed(record.score, 2) + "; frames " + std::to_string(record.match_frame) +
                     " (" + run.match_time(record) + ") and " + std::to_string(record.query_frame) + " (" +
                     time(record.query_stamp_ns) + "); ";
  return text + (loop.is_kept ? "believed" : "not believed") + (loop.verdict == "kept" ? "" : ": " + loop.verdict);
}

std::string loop_picture(const RunData& run, const ShownLoop& loop, const TopView& view, const ClassColors& colors) {
  return "<p>" + escaped("Loop " + std::to_string(loop.number) + ": " + describe(run, loop)) +
         ".</p>\n<div class=\"wide\">" + draw_loop(run, loop, view, colors) + "</div>\n";
}

/// The accepted loops whose submaps are known: the one asked for, or that of most objects, and others, evenly taken.
struct LoopChoice {
  const ShownLoop* first = nullptr;
  std::vector<const ShownLoop*> pictured;
  std::size_t with_submaps = 0;
};

Result<LoopChoice> choose_loops(const RunData& run, const std::optional<int>& wanted) {
  constexpr std::size_t kPicturesMax = 300;  // about 3 MB
  LoopChoice choice;
  int accepted = 0;
  for (const ShownLoop& loop : run.loops) {
    accepted = std::max(accepted, loop.number);
    if (loop.match.empty() || loop.query.empty()) continue;
    choice.pictured.push_back(&loop);
    if (wanted ? loop.number == *wanted
               : choice.first == nullptr || loop.record.inliers > choice.first->record.inliers) {
      choice.first = &loop;
    }
  }
  if (wanted && choice.first == nullptr) {
    return Error{"loop " + std::to_string(*wanted) + " is none of the " + std::to_string(accepted) +
                 " accepted ones, or its submaps are not known"};
  }
  choice.with_submaps = choice.pictured.size();
  choice.pictured = evenly_taken(std::move(choice.pictured), kPicturesMax);
  const bool has_first =
      std::find(choice.pictured.begin(), choice.pictured.end(), choice.first) != choice.pictured.end();
  if (choice.first != nullptr && !has_first) choice.pictured.insert(choice.pictured.begin(), choice.first);
  return choice;
}

std::string choice_of_loops(const RunData& run, const LoopChoice& choice, const TopView& view,
                            const ClassColors& colors) {
  if (choice.first == nullptr) return "<p>No accepted loop has submaps to show.</p>\n";
  std::string options, templates;
  for (const ShownLoop* loop : choice.pictured) {
    const std::string number = std::to_string(loop->number);
    options += "<option value=\"" + number + "\"" + (loop == choice.first ? " selected" : "") + ">" + number + ": " +
               run.match_time(loop->record) + " – " + format_fixed(run.seconds(loop->record.query_stamp_ns), 1) +
               " s, " + std::to_string(loop->record.inliers) + " objects</option>\n";
    templates += "<template id=\"loop-" + number + "\">" + loop_picture(run, *loop, view, colors) + "</template>\n";
  }
  return "<div class=\"choice\"><h3>One loop</h3><div class=\"script-only\"><select id=\"loop-choice\" "
         "aria-label=\"loop\">\n" +
         options +
         "</select><button id=\"loop-before\" type=\"button\" aria-label=\"the loop before\">←</button>"
         "<button id=\"loop-after\" type=\"button\" aria-label=\"the next loop\">→</button></div></div>\n"
         "<div id=\"loop-picture\">\n" +
         loop_picture(run, *choice.first, view, colors) + "</div>\n" + templates;
}

std::string loop_section(const RunData& run, const LoopChoice& choice, const TopView& view, const ClassColors& colors) {
  if (run.loops.empty() && run.extra_loops.empty()) {
    return section("loops", "Loops", "There was no candidate for a loop.", "");
  }
  Pictured pictured;
  for (const ShownLoop* loop : choice.pictured) pictured.insert(loop->number);
  const std::size_t earlier = static_cast<std::size_t>(std::count_if(
      run.loops.begin(), run.loops.end(), [&run](const ShownLoop& loop) { return run.is_into_map(loop.record); }));
  std::string note = "Every candidate that reached verification, by the time of its query and of its match.";
  if (earlier > 0) note += " " + std::to_string(earlier) + " match an earlier session and are on the lower edge.";
  if (choice.pictured.size() < choice.with_submaps) {
    note += " Of " + std::to_string(choice.with_submaps) + " accepted ones " + std::to_string(choice.pictured.size()) +
            " can be chosen here; <code>report --loop N</code> shows any.";
  }
  return section("loops", "Loops", note,
                 "<div class=\"pair\">\n<div>\n<h3>Over time</h3>\n" + draw_loops(run, pictured) +
                     "</div>\n<div>\n<h3>By reason</h3>\n" + reason_table(run) + "</div>\n</div>\n" +
                     choice_of_loops(run, choice, view, colors));
}

// --- time and memory ----------------------------------------------------------------------------------------------

std::string timing_section(const RunData& run) {
  constexpr std::array<const char*, kStages.size()> kColors = {"#1c7ed6", "#2b8a3e", "#9c36b5", "#e8590c"};
  constexpr double kLeast_ms = 1e-3;  // what did not run, is not drawn
  HtmlTable table({"stage", "p50, ms", "p95, ms", "max, ms", "mean, ms", "sum, s"});
  const auto add_row = [&table](const std::string& name, const std::vector<double>& times_ms) {
    double sum = 0.0;
    for (const double ms : times_ms) sum += ms;
    table.add({name, format_fixed(quantile(times_ms, 0.5), 3), format_fixed(quantile(times_ms, 0.95), 3),
               format_fixed(quantile(times_ms, 1.0), 3), format_fixed(sum / static_cast<double>(times_ms.size()), 3),
               format_fixed(1e-3 * sum, 2)});
  };
  std::string charts;
  for (std::size_t stage = 0; stage < kStages.size(); ++stage) {
    std::vector<double> times_ms;
    std::vector<Vec2> values;
    for (std::size_t i = 0; i < run.timing.size(); ++i) {
      times_ms.push_back(1e-3 * run.timing[i].stages_us[stage]);
      if (times_ms.back() < kLeast_ms) continue;
      values.emplace_back(run.seconds(run.optimised().poses[i].stamp_ns), times_ms.back());
    }
    add_row(kStages[stage], times_ms);
    Axis axis = axis_over(std::string(kStages[stage]) + ", ms", times_ms, true);
    axis.min = std::max(axis.min, kLeast_ms);
    axis.max = std::max(axis.max, 10.0 * axis.min);
    Chart chart({kHalf_px, 190.0}, time_axis(run), axis);
    std::string dots;
    std::set<std::pair<double, double>> drawn;
    for (const Vec2& value : values) {
      const Vec2 at = chart.to_px(value);
      if (!drawn.emplace(std::round(at.x()), std::round(at.y())).second) continue;
      dots += "M" + px(std::round(at.x())) + ' ' + px(std::round(at.y())) + "h0";
    }
    chart.add("<path d=\"" + dots + "\" stroke=\"" + kColors[stage] +
              "\" stroke-width=\"2.4\" stroke-linecap=\"round\" stroke-opacity=\"0.55\" fill=\"none\"/>\n");
    charts += chart.svg(std::string("time of ") + kStages[stage]);
  }
  add_row("all of a frame", frame_times_ms(run));
  return section("timing", "Time by stage", "Each dot is a frame; a stage that had nothing to do is left out.",
                 "<div class=\"pair\">\n" + charts + "</div>\n<div class=\"wide\">" + table.html() + "</div>\n");
}

std::string memory_section(const RunData& run) {
  std::vector<Vec2> resident, peak;
  std::vector<double> all = {0.0};
  for (const MemoryRecord& record : run.memory) {
    const StampedPose* pose = run.pose_of(record.frame_id);
    if (pose == nullptr) continue;
    resident.emplace_back(run.seconds(pose->stamp_ns), record.resident_mb);
    peak.emplace_back(run.seconds(pose->stamp_ns), record.peak_mb);
    all.push_back(record.peak_mb);
  }
  Axis axis = axis_over("memory, MiB", all);
  axis.min = 0.0;
  Chart chart({kWide_px, 210.0}, time_axis(run), axis);
  chart.line(peak, kBefore, "stroke-width=\"1.4\" stroke-dasharray=\"5 3\"");
  chart.line(resident, kAfter, "stroke-width=\"1.6\"");
  return section("memory", "Memory", "Of the process that wrote the run's files, once a second of the data.",
                 legend({{kAfter, "resident"}, {kBefore, "most so far", LegendEntry::kDash}}) + "<div class=\"wide\">" +
                     chart.svg("memory over time") + "</div>\n");
}

}  // namespace

Result<std::string> make_report(const ReportInputs& inputs) {
  const Result<RunData> read = read_run(inputs);
  if (!read) return read.error();
  const RunData& run = *read;
  const Result<LoopChoice> choice = choose_loops(run, inputs.loop);
  if (!choice) return Error{inputs.run + "/loops.csv: " + choice.message()};
  const TopView view = top_view(run);
  const ClassColors colors = class_colors(run);
  return page(run.name + " – semantic_topo_loop",
              "<h1>" + escaped(run.name) + "</h1>\n" + tiles(run) + trajectory_section(run, view) +
                  object_section(run, view, colors) + loop_section(run, *choice, view, colors) + timing_section(run) +
                  memory_section(run) + object_table(run) +
                  "<footer>Made by semantic_topo_loop's report from the files of the run.</footer>\n");
}

Status write_report(const ReportInputs& inputs) {
  const Result<std::string> html = make_report(inputs);
  if (!html) return html.error();
  return write_text_file(inputs.run + "/report.html", *html);
}

}  // namespace semantic_topo_loop::core
