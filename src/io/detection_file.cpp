#include "semantic_topo_loop/io/detection_file.h"

#include <algorithm>
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

/// A member of a JSON object; the error names `field`.
Result<const Json*> member(const Json& object, const char* key, const std::string& field) {
  if (!object.is_object()) return Error{field + ": must be an object"};
  const auto it = object.find(key);
  if (it == object.end()) return Error{field + ": has no '" + key + "'"};
  return &*it;
}

/// A number; null stands for NaN, as JSON writers have it.
std::optional<double> to_number(const Json& value) {
  if (value.is_null()) return std::nan("");
  if (!value.is_number()) return std::nullopt;
  return value.get<double>();
}

Result<Detection> parse_json_detection(const Json& json, const std::string& field) {
  const auto id = member(json, "category_id", field);
  if (!id) return id.error();
  const auto score = member(json, "detection_score", field);
  if (!score) return score.error();
  const auto bbox = member(json, "bbox", field);
  if (!bbox) return bbox.error();
  if (!(*id)->is_number_integer()) return Error{field + ".category_id = " + (*id)->dump() + " must be an integer"};
  const std::optional<double> score_value = to_number(**score);
  if (!score_value) return Error{field + ".detection_score = " + (*score)->dump() + " must be a number"};
  std::array<double, 4> corners{};
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const bool is_box = (*bbox)->is_array() && (*bbox)->size() == corners.size();
    const std::optional<double> corner = is_box ? to_number((**bbox)[i]) : std::nullopt;
    if (!corner) return Error{field + ".bbox = " + (*bbox)->dump() + " must be four numbers [x1, y1, x2, y2]"};
    corners[i] = *corner;
  }
  return Detection{(*id)->get<int>(), *score_value, {corners[0], corners[1], corners[2], corners[3]}};
}

/// The error is without the path.
Status collect_json_frame(const Json& json, const std::string& path, const std::string& field, Collector* collector) {
  const auto name = member(json, "file_name", field);
  if (!name) return name.error();
  const auto detections = member(json, "detections", field);
  if (!detections) return detections.error();
  const std::optional<std::int64_t> stamp_ns =
      (*name)->is_string() ? stamp_of_file_name((*name)->get<std::string>()) : std::nullopt;
  if (!stamp_ns) {
    return Error{field + ".file_name = " + (*name)->dump() + " must be \"<stamp in seconds>.<extension>\""};
  }
  if (!(*detections)->is_array()) return Error{field + ".detections must be an array"};
  collector->begin_frame(*stamp_ns, path + ": " + field + ".file_name = " + (*name)->dump());
  for (std::size_t i = 0; i < (*detections)->size(); ++i) {
    const std::string box_field = field + ".detections[" + std::to_string(i) + "]";
    const Result<Detection> detection = parse_json_detection((**detections)[i], box_field);
    if (!detection) return detection.error();
    collector->add(*detection, [&] { return path + ": " + box_field; });
  }
  return {};
}

Status collect_json(const std::string& path, Collector* collector) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  // Image by image, each forgotten as soon as it is read: the tree of a long recording takes ten times its file.
  bool is_array = false;
  std::size_t images = 0;
  Status status;
  const auto take = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (depth == 0 && event == Json::parse_event_t::array_start) is_array = true;
    const bool is_whole = event == Json::parse_event_t::object_end || event == Json::parse_event_t::array_end ||
                          event == Json::parse_event_t::value;
    if (!is_array || depth != 1 || !is_whole) return true;
    const std::string field = "[" + std::to_string(images++) + "]";
    if (status) status = collect_json_frame(parsed, path, field, collector);
    return false;
  };
  try {
    [[maybe_unused]] const Json emptied = Json::parse(*text, take);
  } catch (const Json::parse_error& exception) {
    const std::string what = exception.what();
    return Error{path + ": " + (text->empty() ? "the file is empty" : what.substr(what.find("] ") + 2))};
  }
  if (!is_array) return Error{path + ": must be an array of images"};
  if (!status) return Error{path + ": " + status.message()};
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
