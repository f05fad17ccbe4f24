#include "semantic_topo_loop/io/detection_reader.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

using Json = nlohmann::json;

/// Takes in images and boxes one by one, leaving out and counting what is wrong with them.
class Collector {
 public:
  Collector(const ClassTable& classes, DetectionReport* report) : classes_(classes), report_(report) {}

  /// Begins the image that the following boxes belong to.
  void begin_frame(std::int64_t stamp_ns, const std::string& where) {
    keep_ = stamps_.insert(stamp_ns).second;
    if (keep_) {
      frames_.push_back({stamp_ns, {}});
      ++report_->frames;
    } else {
      report_->add(DetectionProblem::kDuplicateStamp, where);
    }
  }

  /// @param where gives the place of the box; called only for a bad one
  template <class Where>
  void add(const Detection& detection, const Where& where) {
    if (!keep_) return;
    if (const std::optional<DetectionProblem> problem = validate(detection, classes_)) {
      report_->add(*problem, where() + ": " + describe(detection, *problem));
      return;
    }
    frames_.back().detections.push_back(detection);
    ++report_->detections;
  }

  std::vector<DetectionFrame> take_sorted() {
    std::stable_sort(frames_.begin(), frames_.end(),
                     [](const DetectionFrame& a, const DetectionFrame& b) { return a.stamp_ns < b.stamp_ns; });
    return std::move(frames_);
  }

 private:
  const ClassTable& classes_;
  DetectionReport* report_;
  std::vector<DetectionFrame> frames_;
  std::set<std::int64_t> stamps_;
  bool keep_ = false;
};

/// "rgb/1311868164.363181.png" -> 1311868164363181000.
std::optional<std::int64_t> stamp_of_file_name(const std::string& name) {
  return parse_stamp(std::filesystem::path(name).stem().string());
}

// --- OA-SLAM JSON -------------------------------------------------------------------------------------------------

/// A member of a JSON object, or null with the field in `error`.
const Json* member(const Json& object, const char* key, const std::string& field, std::string* error) {
  if (!object.is_object()) {
    *error = field + ": must be an object";
    return nullptr;
  }
  const auto it = object.find(key);
  if (it == object.end()) {
    *error = field + ": has no '" + key + "'";
    return nullptr;
  }
  return &*it;
}

/// A number; null stands for NaN, as JSON writers have it.
std::optional<double> to_number(const Json& value) {
  if (value.is_null()) return std::nan("");
  if (!value.is_number()) return std::nullopt;
  return value.get<double>();
}

std::optional<Detection> parse_json_detection(const Json& json, const std::string& field, std::string* error) {
  const Json* id = member(json, "category_id", field, error);
  const Json* score = id == nullptr ? nullptr : member(json, "detection_score", field, error);
  const Json* bbox = score == nullptr ? nullptr : member(json, "bbox", field, error);
  if (bbox == nullptr) return std::nullopt;
  Detection detection;
  if (!id->is_number_integer()) {
    *error = field + ".category_id = " + id->dump() + " must be an integer";
    return std::nullopt;
  }
  detection.class_id = id->get<int>();
  const std::optional<double> score_value = to_number(*score);
  if (!score_value) {
    *error = field + ".detection_score = " + score->dump() + " must be a number";
    return std::nullopt;
  }
  detection.score = *score_value;
  std::array<double, 4> corners{};
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const std::optional<double> corner =
        bbox->is_array() && bbox->size() == corners.size() ? to_number((*bbox)[i]) : std::nullopt;
    if (!corner) {
      *error = field + ".bbox = " + bbox->dump() + " must be four numbers [x1, y1, x2, y2]";
      return std::nullopt;
    }
    corners[i] = *corner;
  }
  detection.box = {corners[0], corners[1], corners[2], corners[3]};
  return detection;
}

bool collect_json_frame(const Json& json, const std::string& path, const std::string& field, Collector* collector,
                        std::string* error) {
  const Json* name = member(json, "file_name", field, error);
  const Json* detections = name == nullptr ? nullptr : member(json, "detections", field, error);
  if (detections == nullptr) return false;
  const std::optional<std::int64_t> stamp_ns =
      name->is_string() ? stamp_of_file_name(name->get<std::string>()) : std::nullopt;
  if (!stamp_ns) {
    *error = field + ".file_name = " + name->dump() + " must be \"<stamp in seconds>.<extension>\"";
    return false;
  }
  if (!detections->is_array()) {
    *error = field + ".detections must be an array";
    return false;
  }
  collector->begin_frame(*stamp_ns, path + ": " + field + ".file_name = " + name->dump());
  for (std::size_t i = 0; i < detections->size(); ++i) {
    const std::string box_field = field + ".detections[" + std::to_string(i) + "]";
    const std::optional<Detection> detection = parse_json_detection((*detections)[i], box_field, error);
    if (!detection) return false;
    collector->add(*detection, [&] { return path + ": " + box_field; });
  }
  return true;
}

bool collect_json(const std::string& path, Collector* collector, std::string* error) {
  const std::optional<std::string> text = read_text_file(path, error);
  if (!text) return false;
  // Image by image, each forgotten as soon as it is read: the tree of a long recording takes ten times its file.
  bool is_array = false;
  std::size_t images = 0;
  std::string problem;
  const auto take = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (depth == 0 && event == Json::parse_event_t::array_start) is_array = true;
    const bool is_whole = event == Json::parse_event_t::object_end || event == Json::parse_event_t::array_end ||
                          event == Json::parse_event_t::value;
    if (!is_array || depth != 1 || !is_whole) return true;
    const std::string field = "[" + std::to_string(images++) + "]";
    if (problem.empty()) collect_json_frame(parsed, path, field, collector, &problem);
    return false;
  };
  try {
    [[maybe_unused]] const Json emptied = Json::parse(*text, take);
  } catch (const Json::parse_error& exception) {
    const std::string what = exception.what();
    *error = path + ": " + (text->empty() ? "the file is empty" : what.substr(what.find("] ") + 2));
    return false;
  }
  if (!is_array) problem = "must be an array of images";
  if (!problem.empty()) *error = path + ": " + problem;
  return problem.empty();
}

// --- YOLO text files ----------------------------------------------------------------------------------------------

std::optional<Detection> parse_yolo_line(std::string_view line, std::string* error) {
  constexpr std::size_t kColumns = 6;
  const std::vector<std::string_view> fields = split_blanks(line);
  if (fields.size() != kColumns) {
    *error = std::to_string(fields.size()) + " columns instead of 6 (class x y w h score)";
    return std::nullopt;
  }
  const std::optional<std::int64_t> id = parse_integer(fields[0]);
  if (!id || *id < std::numeric_limits<int>::min() || *id > std::numeric_limits<int>::max()) {
    *error = "class '" + std::string(fields[0]) + "' is no integer";
    return std::nullopt;
  }
  std::array<double, kColumns> v{};
  for (std::size_t i = 1; i < kColumns; ++i) {
    const std::optional<double> value = parse_double(fields[i]);
    if (!value) {
      *error = "'" + std::string(fields[i]) + "' is no number";
      return std::nullopt;
    }
    v[i] = *value;
  }
  return Detection{static_cast<int>(*id), v[5], {v[1], v[2], v[1] + v[3], v[2] + v[4]}};
}

bool collect_yolo_file(const std::string& path, Collector* collector, std::string* error) {
  const std::optional<std::int64_t> stamp_ns = stamp_of_file_name(path);
  if (!stamp_ns) {
    *error = path + ": the file name must be <stamp in seconds>.txt";
    return false;
  }
  const std::optional<std::string> text = read_text_file(path, error);
  if (!text) return false;
  collector->begin_frame(*stamp_ns, path);
  for (const TextLine& line : content_lines(*text)) {
    std::string problem;
    const std::optional<Detection> detection = parse_yolo_line(line.text, &problem);
    if (!detection) {
      *error = at_line(path, line.number, problem);
      return false;
    }
    collector->add(*detection, [&] { return path + ":" + std::to_string(line.number); });
  }
  return true;
}

bool collect_yolo(const std::string& directory, Collector* collector, std::string* error) {
  std::vector<std::string> paths;
  std::error_code code;
  for (std::filesystem::directory_iterator it(directory, code), end; !code && it != end; it.increment(code)) {
    if (it->path().extension() == ".txt") paths.push_back(it->path().string());
  }
  if (code) {
    *error = directory + ": cannot list the directory: " + code.message();
    return false;
  }
  std::sort(paths.begin(), paths.end());  // the order of a directory differs from machine to machine
  return std::all_of(paths.begin(), paths.end(),
                     [&](const std::string& path) { return collect_yolo_file(path, collector, error); });
}

}  // namespace

const char* to_string(DetectionProblem problem) {
  switch (problem) {
    case DetectionProblem::kUnknownClass:
      return "unknown class id";
    case DetectionProblem::kBoxNotFinite:
      return "box is not finite";
    case DetectionProblem::kBoxInverted:
      return "box has x2 <= x1 or y2 <= y1 (are its numbers in the stated order?)";
    case DetectionProblem::kScoreOutOfRange:
      return "score is not in [0, 1]";
    case DetectionProblem::kDuplicateStamp:
      return "stamp of an earlier image";
  }
  return "unknown problem";
}

std::optional<DetectionProblem> validate(const Detection& detection, const ClassTable& classes) {
  if (classes.find(detection.class_id) == nullptr) return DetectionProblem::kUnknownClass;
  if (!detection.box.is_finite()) return DetectionProblem::kBoxNotFinite;
  if (!detection.box.is_valid()) return DetectionProblem::kBoxInverted;
  if (!(detection.score >= 0.0 && detection.score <= 1.0)) return DetectionProblem::kScoreOutOfRange;
  return std::nullopt;
}

std::string describe(const Detection& detection, DetectionProblem problem) {
  constexpr int kDigits = 7;
  if (problem == DetectionProblem::kUnknownClass) return "class id " + std::to_string(detection.class_id);
  if (problem == DetectionProblem::kScoreOutOfRange) return "score " + format_general(detection.score, kDigits);
  const Vec4 e = detection.box.edges();
  return "box [" + format_general(e[0], kDigits) + ", " + format_general(e[1], kDigits) + ", " +
         format_general(e[2], kDigits) + ", " + format_general(e[3], kDigits) + "]";
}

void DetectionReport::add(DetectionProblem problem, const std::string& where) {
  Cause& entry = causes[static_cast<std::size_t>(problem)];
  if (entry.count++ == 0) entry.first = where;
}

std::vector<std::string> DetectionReport::warnings() const {
  std::vector<std::string> lines;
  for (std::size_t i = 0; i < causes.size(); ++i) {
    if (causes[i].count == 0) continue;
    const auto problem = static_cast<DetectionProblem>(i);
    const char* what = problem == DetectionProblem::kDuplicateStamp ? " images" : " boxes";
    lines.push_back(std::to_string(causes[i].count) + what + " left out: " + to_string(problem) +
                    " (first: " + causes[i].first + ")");
  }
  return lines;
}

std::optional<std::vector<DetectionFrame>> read_detections(const std::string& path, const ClassTable& classes,
                                                           DetectionReport* report, std::string* error) {
  std::string problem;
  DetectionReport counts;
  Collector collector(classes, &counts);
  std::error_code code;
  const bool is_directory = std::filesystem::is_directory(path, code);
  bool ok = is_directory ? collect_yolo(path, &collector, &problem) : collect_json(path, &collector, &problem);
  if (ok && counts.frames == 0) {
    ok = false;
    problem = path + (is_directory ? ": contains no <stamp>.txt file" : ": contains no image");
  }
  if (!ok) {
    if (error != nullptr) *error = problem;
    return std::nullopt;
  }
  if (report != nullptr) *report = counts;
  return collector.take_sorted();
}

}  // namespace semantic_topo_loop::core
