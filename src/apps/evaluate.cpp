#include <cstdio>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "semantic_topo_loop/evaluation/loop_evaluation.h"
#include "semantic_topo_loop/evaluation/object_evaluation.h"
#include "semantic_topo_loop/evaluation/run_files.h"
#include "semantic_topo_loop/evaluation/trajectory_evaluation.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"

namespace {

using namespace semantic_topo_loop::core;
using Json = nlohmann::json;

constexpr const char* kUsage = R"(Judges the files of a run.

  evaluate trajectory EST GT [--scale]         absolute (ATE) and relative (RPE over 1 s) errors of a TUM trajectory
  evaluate objects RUN_DIR GT REFERENCE        objects.csv against reference objects, aligned by trajectory.txt and GT
  evaluate loops RUN_DIR GT_FRAMES [--mocap F] loops.csv against a true pose for every image; --mocap names the motion
                                               capture's own file, in whose holes nothing is judged

  --json FILE   also writes the figures as JSON
  --help        shows this text
Exit status: 0 done, 1 a file is missing or wrong, 2 wrong arguments.
)";

struct Arguments {
  std::vector<std::string> positional;
  std::string json, mocap;
  bool with_scale = false;
};

/// The figures of one evaluation: as a table for people and as JSON for programs.
struct Report {
  std::string table;
  Json json;
};

std::string line(const char* name, const std::string& value) {
  char text[256];
  std::snprintf(text, sizeof(text), "%-34s %s\n", name, value.c_str());
  return text;
}

std::string to_text(const Ratio& ratio) {
  char text[64];
  std::snprintf(text, sizeof(text), "%.4f  (%d / %d)", ratio.value(), ratio.right, ratio.total);
  return text;
}

std::string to_text(const ErrorStatistics& e, const char* unit) {
  char text[160];
  std::snprintf(text, sizeof(text), "rmse %.4f  mean %.4f  median %.4f  max %.4f %s  (%zu)", e.rmse, e.mean, e.median,
                e.max, unit, e.count);
  return text;
}

Json to_json(const Ratio& ratio) { return {{"value", ratio.value()}, {"right", ratio.right}, {"total", ratio.total}}; }

Json to_json(const ErrorStatistics& e) {
  return {{"count", e.count}, {"rmse", e.rmse}, {"mean", e.mean}, {"median", e.median}, {"max", e.max}};
}

Json to_json(const Detectability& d) {
  return {{"precision", to_json(d.precision)}, {"recall", to_json(d.recall)}, {"f", d.f()}};
}

std::optional<TrajectoryEvaluation> align_files(const std::string& estimate, const std::string& reference,
                                                bool with_scale, std::string* error) {
  const auto estimated = read_tum_trajectory(estimate, error);
  const auto truth = estimated ? read_tum_ground_truth(reference, error) : std::nullopt;
  if (!truth) return std::nullopt;
  TrajectoryEvaluationOptions options;
  options.with_scale = with_scale;
  auto evaluation = evaluate_trajectory(*estimated, *truth, options, error);
  if (!evaluation) *error = estimate + ": " + *error;
  return evaluation;
}

std::optional<Report> report_trajectory(const Arguments& arguments, std::string* error) {
  const auto e = align_files(arguments.positional[0], arguments.positional[1], arguments.with_scale, error);
  if (!e) return std::nullopt;
  Report report;
  report.table =
      line("poses (estimate, ground truth)", std::to_string(e->estimated) + ", " + std::to_string(e->reference)) +
      line("pairs within 0.02 s", std::to_string(e->pairs)) + line("scale", std::to_string(e->alignment.scale)) +
      line("ATE", to_text(e->absolute_m, "m")) + line("RPE over 1 s, translation", to_text(e->relative_m, "m")) +
      line("RPE over 1 s, rotation", to_text(e->relative_deg, "deg"));
  report.json = {
      {"estimated", e->estimated},          {"reference", e->reference},       {"pairs", e->pairs},
      {"scale", e->alignment.scale},        {"ate_m", to_json(e->absolute_m)}, {"rpe_m", to_json(e->relative_m)},
      {"rpe_deg", to_json(e->relative_deg)}};
  return report;
}

/// One row an object: what it was matched with.
void list_objects(const ObjectEvaluation& evaluation, const std::vector<MappedObject>& objects,
                  const std::vector<ReferenceObject>& references, Report* report) {
  std::map<std::int64_t, const MappedObject*> object_of;
  std::map<int, const ReferenceObject*> reference_of;
  for (const MappedObject& object : objects) object_of[object.id] = &object;
  for (const ReferenceObject& reference : references) reference_of[reference.id] = &reference;
  constexpr std::array<const char*, 3> kCertainties = {"certain", "probable", "marginal"};
  Json rows = Json::array();
  report->table += "\nobject label            reference certainty  distance_m\n";
  for (const ObjectMatchResult& match : evaluation.matches) {
    const ReferenceObject* reference = match.reference_id < 0 ? nullptr : reference_of[match.reference_id];
    const std::string label = match.object_id < 0 ? reference->label : object_of[match.object_id]->label;
    const char* certainty = reference == nullptr ? "-" : kCertainties[static_cast<std::size_t>(reference->certainty)];
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

std::optional<Report> report_objects(const Arguments& arguments, std::string* error) {
  const std::string& run = arguments.positional[0];
  const auto objects = read_objects(run + "/objects.csv", error);
  const auto references = objects ? read_reference_objects(arguments.positional[2], error) : std::nullopt;
  if (!references) return std::nullopt;
  const auto trajectory = align_files(run + "/trajectory.txt", arguments.positional[1], false, error);
  if (!trajectory) return std::nullopt;
  const ObjectEvaluation e = evaluate_objects(*objects, *references, trajectory->alignment);
  char f[64];
  Report report;
  std::snprintf(f, sizeof(f), "%.4f", e.certain.f());
  report.table = line("certain: precision", to_text(e.certain.precision)) +
                 line("certain: recall", to_text(e.certain.recall)) + line("certain: F", f);
  std::snprintf(f, sizeof(f), "%.4f", e.strict.f());
  report.table += line("strict: precision", to_text(e.strict.precision)) +
                  line("strict: recall", to_text(e.strict.recall)) + line("strict: F", f) +
                  line("no other object nearby (paper)", to_text(e.undisputed)) +
                  line("matched probable, marginal",
                       std::to_string(e.matched_probable) + ", " + std::to_string(e.matched_marginal)) +
                  line("distance to certain references", to_text(e.center_m, "m"));
  report.json = {{"certain", to_json(e.certain)},          {"strict", to_json(e.strict)},
                 {"undisputed", to_json(e.undisputed)},    {"matched_certain", e.matched_certain},
                 {"matched_probable", e.matched_probable}, {"matched_marginal", e.matched_marginal},
                 {"center_m", to_json(e.center_m)}};
  list_objects(e, *objects, *references, &report);
  return report;
}

std::optional<Report> report_loops(const Arguments& arguments, std::string* error) {
  const std::string& run = arguments.positional[0];
  const auto loops = read_loops(run + "/loops.csv", error);
  const auto frames = loops ? read_tum_trajectory(run + "/trajectory.txt", error) : std::nullopt;
  const auto truth = frames ? read_tum_ground_truth(arguments.positional[1], error) : std::nullopt;
  if (!truth) return std::nullopt;
  StampedPoses mocap;
  if (!arguments.mocap.empty()) {
    auto poses = read_tum_ground_truth(arguments.mocap, error);
    if (!poses) return std::nullopt;
    mocap = std::move(*poses);
  }
  const auto e = evaluate_loops(*loops, *frames, *truth, mocap, LoopEvaluationOptions(), error);
  if (!e) {
    *error = run + "/loops.csv: " + *error;
    return std::nullopt;
  }
  Report report;
  report.table = line("candidates", std::to_string(e->candidates)) + line("accepted", std::to_string(e->accepted)) +
                 line("not judged (mocap holes)", std::to_string(e->not_judged)) +
                 line("right within 0.35 m, 10 deg", to_text(e->right_wide)) +
                 line("right within 0.20 m, 5 deg", to_text(e->right_narrow)) +
                 line("error, translation", to_text(e->error_m, "m")) +
                 line("error, rotation", to_text(e->error_deg, "deg")) +
                 line("loopable queries closed", to_text({e->closed, e->loopable})) +
                 line("loopable queries closed at once", to_text({e->closed_at_once, e->loopable})) +
                 line("pairs: precision (paper)", to_text(e->pair_precision)) +
                 line("pairs: recall (paper)", to_text(e->pair_recall));
  report.json = {{"candidates", e->candidates},
                 {"accepted", e->accepted},
                 {"not_judged", e->not_judged},
                 {"right_wide", to_json(e->right_wide)},
                 {"right_narrow", to_json(e->right_narrow)},
                 {"error_m", to_json(e->error_m)},
                 {"error_deg", to_json(e->error_deg)},
                 {"closed", to_json(Ratio{e->closed, e->loopable})},
                 {"closed_at_once", to_json(Ratio{e->closed_at_once, e->loopable})},
                 {"pair_precision", to_json(e->pair_precision)},
                 {"pair_recall", to_json(e->pair_recall)}};
  return report;
}

struct Command {
  const char* name;
  std::size_t positional;
  std::optional<Report> (*run)(const Arguments&, std::string*);
};

constexpr Command kCommands[] = {
    {"trajectory", 2, report_trajectory}, {"objects", 3, report_objects}, {"loops", 2, report_loops}};

/// @return false with the problem in `error`
bool parse_arguments(int argc, char** argv, const Command& command, Arguments* arguments, std::string* error) {
  const bool is_loops = command.run == report_loops, is_trajectory = command.run == report_trajectory;
  for (int i = 2; i < argc; ++i) {
    const std::string argument = argv[i];
    const bool takes_value = argument == "--json" || (argument == "--mocap" && is_loops);
    if (takes_value && i + 1 == argc) {
      *error = argument + " needs a file";
      return false;
    }
    if (takes_value) {
      (argument == "--json" ? arguments->json : arguments->mocap) = argv[++i];
    } else if (argument == "--scale" && is_trajectory) {
      arguments->with_scale = true;
    } else if (argument.rfind("--", 0) == 0) {
      *error = "unknown option '" + argument + "' of evaluate " + command.name;
      return false;
    } else {
      arguments->positional.push_back(argument);
    }
  }
  if (arguments->positional.size() == command.positional) return true;
  *error = std::string("evaluate ") + command.name + " takes " + std::to_string(command.positional) + " paths, not " +
           std::to_string(arguments->positional.size());
  return false;
}

int fail(const std::string& error, int status) {
  std::fprintf(stderr, "evaluate: %s\n", error.c_str());
  return status;
}

int run(int argc, char** argv, const Command& command) {
  constexpr int kBadFile = 1, kBadArguments = 2;
  Arguments arguments;
  std::string error;
  if (!parse_arguments(argc, argv, command, &arguments, &error)) return fail(error + " (see --help)", kBadArguments);
  const std::optional<Report> report = command.run(arguments, &error);
  if (!report) return fail(error, kBadFile);
  std::fputs(report->table.c_str(), stdout);
  if (!arguments.json.empty() && !write_text_file(arguments.json, report->json.dump(2) + '\n', &error)) {
    return fail(error, kBadFile);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(kUsage, stdout);
      return 0;
    }
  }
  for (const Command& command : kCommands) {
    if (argc > 1 && std::strcmp(argv[1], command.name) == 0) return run(argc, argv, command);
  }
  std::fputs(kUsage, stderr);
  return 2;
}
