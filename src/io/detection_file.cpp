#include "semantic_topo_loop/io/detection_file.h"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <set>

#include "io/json_field.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

/// Takes in images and boxes one by one, leaving out and counting what is wrong with them.
class Collector {
 public:
  explicit Collector(const ClassTable& classes) : classes_(classes) {}

  /// Begins the image that the following boxes belong to.
  void begin_frame(std::int64_t stamp_ns, const std::string& where) {
    keep_ = stamps_.insert(stamp_ns).second;
    if (keep_) {
      recording_.frames.push_back({stamp_ns, {}});
      ++recording_.report.frames;
    } else {
      recording_.report.add(DetectionProblem::kDuplicateStamp, where);
    }
  }

  /// @param where gives the place of the box; called only for a bad one
  template <class Where>
  void add(const Detection& detection, const Where& where) {
    if (!keep_) return;
    if (const std::optional<DetectionProblem> problem = validate(detection, classes_)) {
      recording_.report.add(*problem, where() + ": " + describe(detection, *problem));
      return;
    }
    recording_.frames.back().detections.push_back(detection);
    ++recording_.report.detections;
  }

  DetectionRecording take_sorted() {
    std::stable_sort(recording_.frames.begin(), recording_.frames.end(),
                     [](const DetectionFrame& a, const DetectionFrame& b) { return a.stamp_ns < b.stamp_ns; });
    return std::move(recording_);
  }

 private:
  const ClassTable& classes_;
  DetectionRecording recording_;
  std::set<std::int64_t> stamps_;
  bool keep_ = false;
};

/// "rgb/1311868164.363181.png" -> 1311868164363181000.
std::optional<std::int64_t> stamp_of_file_name(const std::string& name) {
  return parse_stamp(std::filesystem::path(name).stem().string());
}

// --- OA-SLAM JSON -------------------------------------------------------------------------------------------------

Detection read_detection(const JsonField& field) {
  Detection detection;
  detection.class_id = static_cast<int>(field.member("category_id").integer());
  detection.score = field.member("detection_score").number_or_nan();
  const JsonField bbox = field.member("bbox");
  const std::vector<JsonField> corners = bbox.elements();
  if (corners.size() != 4) {
    bbox.reject("= " + bbox.json().dump() + " must be four numbers [x1, y1, x2, y2]");
    return detection;
  }
  detection.box = {corners[0].number_or_nan(), corners[1].number_or_nan(), corners[2].number_or_nan(),
                   corners[3].number_or_nan()};
  return detection;
}

void collect_json_frame(const JsonField& field, const std::string& path, Collector* collector) {
  const JsonField name = field.member("file_name");
  const std::vector<JsonField> detections = field.member("detections").elements();
  const std::optional<std::int64_t> stamp_ns = stamp_of_file_name(name.text());
  if (!stamp_ns) name.reject("must be \"<stamp in seconds>.<extension>\"");
  if (!field.is_fine()) return;
  collector->begin_frame(*stamp_ns, path + ": " + name.place());
  for (const JsonField& box : detections) {
    const Detection detection = read_detection(box);
    if (!field.is_fine()) return;
    collector->add(detection, [&] { return path + ": " + box.name(); });
  }
}

Status collect_json(const std::string& path, Collector* collector) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  // Image by image, each forgotten as soon as it is read: the tree of a long recording takes ten times its file.
  bool is_array = false;
  std::size_t images = 0;
  std::string problem;
  const auto take = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (depth == 0 && event == Json::parse_event_t::array_start) is_array = true;
    const bool is_whole = event == Json::parse_event_t::object_end || event == Json::parse_event_t::array_end ||
                          event == Json::parse_event_t::value;
    if (!is_array || depth != 1 || !is_whole) return true;
    const JsonField field(parsed, "[" + std::to_string(images++) + "]", &problem);
    if (problem.empty()) collect_json_frame(field, path, collector);
    return false;
  };
  try {
    [[maybe_unused]] const Json emptied = Json::parse(*text, take);
  } catch (const Json::parse_error& exception) {
    problem = json_problem(*text, exception);
  }
  if (problem.empty() && !is_array) problem = "must be an array of images";
  if (!problem.empty()) return Error{path + ": " + problem};
  return {};
}

// --- YOLO text files ----------------------------------------------------------------------------------------------

/// The error is without file and line.
Result<Detection> parse_yolo_line(std::string_view line) {
  constexpr std::size_t kColumns = 6;
  const std::vector<std::string_view> fields = split_blanks(line);
  if (fields.size() != kColumns) {
    return Error{std::to_string(fields.size()) + " columns instead of 6 (class x y w h score)"};
  }
  const std::optional<std::int64_t> id = parse_integer(fields[0]);
  if (!id || *id < std::numeric_limits<int>::min() || *id > std::numeric_limits<int>::max()) {
    return Error{"class '" + std::string(fields[0]) + "' is no integer"};
  }
  std::array<double, kColumns> v{};
  for (std::size_t i = 1; i < kColumns; ++i) {
    const std::optional<double> value = parse_double(fields[i]);
    if (!value) return Error{"'" + std::string(fields[i]) + "' is no number"};
    v[i] = *value;
  }
  return Detection{static_cast<int>(*id), v[5], {v[1], v[2], v[1] + v[3], v[2] + v[4]}};
}

Status collect_yolo_file(const std::string& path, Collector* collector) {
  const std::optional<std::int64_t> stamp_ns = stamp_of_file_name(path);
  if (!stamp_ns) return Error{path + ": the file name must be <stamp in seconds>.txt"};
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  collector->begin_frame(*stamp_ns, path);
  for (const TextLine& line : content_lines(*text)) {
    const Result<Detection> detection = parse_yolo_line(line.text);
    if (!detection) return Error{at_line(path, line.number, detection.message())};
    collector->add(*detection, [&] { return path + ":" + std::to_string(line.number); });
  }
  return {};
}

Status collect_yolo(const std::string& directory, Collector* collector) {
  std::vector<std::string> paths;
  std::error_code code;
  for (std::filesystem::directory_iterator it(directory, code), end; !code && it != end; it.increment(code)) {
    if (it->path().extension() == ".txt") paths.push_back(it->path().string());
  }
  if (code) return Error{directory + ": cannot list the directory: " + code.message()};
  std::sort(paths.begin(), paths.end());  // the order of a directory differs from machine to machine
  for (const std::string& path : paths) {
    if (const Status collected = collect_yolo_file(path, collector); !collected) return collected;
  }
  return {};
}

// --- writing ------------------------------------------------------------------------------------------------------

constexpr int kCoordinateDecimals = 4;
constexpr int kScoreDecimals = 6;

std::string json_box(const Detection& detection) {
  std::string text = "{\"category_id\": " + std::to_string(detection.class_id) +
                     ", \"detection_score\": " + format_fixed(detection.score, kScoreDecimals) + ", \"bbox\": [";
  const Vec4 edges = detection.box.edges();
  for (int i = 0; i < edges.size(); ++i) text += (i == 0 ? "" : ", ") + format_fixed(edges[i], kCoordinateDecimals);
  return text + "]}";
}

std::string json_frame(const DetectionFrame& frame) {
  std::string text = "{\"file_name\": \"" + format_stamp(frame.stamp_ns) + ".png\", \"detections\": [";
  for (std::size_t i = 0; i < frame.detections.size(); ++i) {
    text += (i == 0 ? "" : ", ") + json_box(frame.detections[i]);
  }
  return text + "]}";
}

std::string yolo_line(const Detection& detection) {
  std::string text = std::to_string(detection.class_id);
  const Box& box = detection.box;
  for (const double value : {box.x1, box.y1, box.width(), box.height()}) {
    text += ' ' + format_fixed(value, kCoordinateDecimals);
  }
  return text + ' ' + format_fixed(detection.score, kScoreDecimals) + '\n';
}

}  // namespace

const char* to_string(DetectionProblem problem) {
  constexpr std::array<const char*, kDetectionProblemCount> kNames = {
      "unknown class id", "box is not finite", "box has x2 <= x1 or y2 <= y1 (are its numbers in the stated order?)",
      "score is not in [0, 1]", "stamp of an earlier image"};
  return kNames.at(static_cast<std::size_t>(problem));
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

Result<DetectionRecording> read_detections(const std::string& path, const ClassTable& classes) {
  Collector collector(classes);
  std::error_code code;
  const bool is_directory = std::filesystem::is_directory(path, code);
  const Status collected = is_directory ? collect_yolo(path, &collector) : collect_json(path, &collector);
  if (!collected) return collected.error();
  DetectionRecording recording = collector.take_sorted();
  if (recording.report.frames > 0) return recording;
  return Error{path + (is_directory ? ": contains no <stamp>.txt file" : ": contains no image")};
}

Status write_detections_json(const std::string& path, const std::vector<DetectionFrame>& frames) {
  std::string text = "[";
  for (std::size_t i = 0; i < frames.size(); ++i) text += (i == 0 ? "" : ",\n") + json_frame(frames[i]);
  return write_text_file(path, text + "]\n");
}

Status write_detections_yolo(const std::string& directory, const std::vector<DetectionFrame>& frames) {
  if (const Status made = make_directory(directory); !made) return made;
  for (const DetectionFrame& frame : frames) {
    std::string text;
    for (const Detection& detection : frame.detections) text += yolo_line(detection);
    const Status written = write_text_file(directory + "/" + format_stamp(frame.stamp_ns) + ".txt", text);
    if (!written) return written;
  }
  return {};
}

}  // namespace semantic_topo_loop::core
