#include "semantic_topo_loop/io/detection_file.h"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <map>
#include <set>

#include "io/json_field.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

/// What is wrong with a box, the first cause in the order of the problems; nullopt if nothing is.
std::optional<DetectionProblem> validate(const Detection& detection, const ClassTable& classes) {
  if (classes.find(detection.class_id) == nullptr) return DetectionProblem::kUnknownClass;
  if (!detection.box.is_finite()) return DetectionProblem::kBoxNotFinite;
  if (!detection.box.is_valid()) return DetectionProblem::kBoxInverted;
  if (!(detection.score >= 0.0 && detection.score <= 1.0)) return DetectionProblem::kScoreOutOfRange;
  return std::nullopt;
}

/// The offending field and its value.
std::string describe(const Detection& detection, DetectionProblem problem) {
  constexpr int kDigits = 7;
  if (problem == DetectionProblem::kUnknownClass) return "class id " + std::to_string(detection.class_id);
  if (problem == DetectionProblem::kScoreOutOfRange) return "score " + format_general(detection.score, kDigits);
  const Vec4 e = detection.box.edges();
  return "box [" + format_general(e[0], kDigits) + ", " + format_general(e[1], kDigits) + ", " +
         format_general(e[2], kDigits) + ", " + format_general(e[3], kDigits) + "]";
}

/// Takes in images one by one, leaving out and counting what is wrong with them.
class Collector {
 public:
  Collector(const ClassTable& classes, std::size_t boxes_max) : classes_(classes), boxes_max_(boxes_max) {}

  /// @param place_of gives the place of a box by its index; called only for a bad one
  template <class PlaceOf>
  void add(const DetectionFrame& frame, const std::string& place, const PlaceOf& place_of) {
    DetectionReport& report = recording_.report;
    if (!stamps_.insert(frame.stamp_ns).second) return report.add(DetectionProblem::kDuplicateStamp, place);
    const auto leave_out = [&](std::size_t index, DetectionProblem problem, const std::string& value) {
      report.add(problem, place_of(index) + ": " + value);
    };
    recording_.frames.push_back({frame.stamp_ns, usable_boxes(frame.detections, classes_, boxes_max_, leave_out)});
    ++report.frames;
    report.detections += static_cast<int>(recording_.frames.back().detections.size());
  }

  const ClassTable& classes() const { return classes_; }

  DetectionRecording take_sorted() {
    std::stable_sort(recording_.frames.begin(), recording_.frames.end(),
                     [](const DetectionFrame& a, const DetectionFrame& b) { return a.stamp_ns < b.stamp_ns; });
    return std::move(recording_);
  }

 private:
  const ClassTable& classes_;
  std::size_t boxes_max_;
  DetectionRecording recording_;
  std::set<std::int64_t> stamps_;
};

/// "rgb/1311868164.363181.png", or without an extension, whose place the fraction must not take: 1311868164363181000.
std::optional<std::int64_t> stamp_of_file_name(const std::string& name) {
  const std::filesystem::path path(name);
  const std::optional<std::int64_t> whole = parse_stamp(path.filename().string());
  return whole ? whole : parse_stamp(path.stem().string());
}

// --- JSON: images of OA-SLAM, boxes of COCO's results -------------------------------------------------------------

/// @param is_xywh the box's numbers are x, y, width, height instead of two corners
Detection read_detection(const JsonField& field, const char* score, bool is_xywh) {
  Detection detection;
  detection.class_id = field.member("category_id").small_integer();
  detection.score = field.member(score).number_or_nan();
  const JsonField bbox = field.member("bbox");
  const std::vector<JsonField> v = bbox.elements();
  if (v.size() != 4) {
    bbox.reject("= " + bbox.json().dump() + " must be four numbers " + (is_xywh ? "[x, y, w, h]" : "[x1, y1, x2, y2]"));
    return detection;
  }
  Box& box = detection.box;
  box = {v[0].number_or_nan(), v[1].number_or_nan(), v[2].number_or_nan(), v[3].number_or_nan()};
  if (is_xywh) box = {box.x1, box.y1, box.x1 + box.x2, box.y1 + box.y2};
  return detection;
}

void collect_json_frame(const JsonField& field, const std::string& path, Collector* collector) {
  const JsonField name = field.member("file_name");
  const std::vector<JsonField> detections = field.member("detections").elements();
  const std::optional<std::int64_t> stamp_ns = stamp_of_file_name(name.text());
  if (!stamp_ns) name.reject("must be \"<stamp in seconds>.<extension>\"");
  if (!field.is_fine()) return;
  DetectionFrame frame{*stamp_ns, {}};
  for (const JsonField& box : detections) {
    frame.detections.push_back(read_detection(box, "detection_score", false));
    if (!field.is_fine()) return;
  }
  collector->add(frame, path + ": " + name.place(),
                 [&](std::size_t index) { return path + ": " + detections[index].name(); });
}

/// Boxes of COCO's results, which come one by one, by the stamp of their image.
struct CocoImage {
  DetectionFrame frame;
  std::vector<std::string> places;  ///< of the boxes
};
using CocoImages = std::map<std::int64_t, CocoImage>;

void collect_coco_box(const JsonField& field, const ClassTable& classes, CocoImages* images) {
  const JsonField id = field.member("image_id");
  const std::string name = id.json().is_number_float() ? id.json().dump() : id.text();
  const std::optional<std::int64_t> stamp_ns = stamp_of_file_name(name);
  if (!stamp_ns) {
    return id.reject(std::string("must be the stamp of the image in seconds, 1311868164.363181, or its file name") +
                     (id.json().is_number_integer() ? ": the list that integers count in is not in the file" : ""));
  }
  Detection detection = read_detection(field, "score", true);
  const ObjectClass* found = classes.find_by_coco_id(detection.class_id);
  if (found == nullptr) {
    return field.member("category_id").reject("is no coco_id of the class table");
  }
  detection.class_id = found->id;
  CocoImage& image = (*images)[*stamp_ns];
  image.frame.stamp_ns = *stamp_ns;
  image.frame.detections.push_back(detection);
  image.places.push_back(field.name());
}

Status collect_json(const std::string& path, Collector* collector) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  // Image by image, each forgotten as soon as it is read: the tree of a long recording takes ten times its file.
  bool is_array = false;
  std::size_t elements = 0;
  CocoImages coco;
  std::string problem;
  const auto take = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (depth == 0 && event == Json::parse_event_t::array_start) is_array = true;
    const bool is_whole = event == Json::parse_event_t::object_end || event == Json::parse_event_t::array_end ||
                          event == Json::parse_event_t::value;
    if (!is_array || depth != 1 || !is_whole) return true;
    const JsonField field(parsed, "[" + std::to_string(elements++) + "]", &problem);
    if (!problem.empty()) return false;
    const bool is_coco = parsed.is_object() && parsed.contains("image_id");
    is_coco ? collect_coco_box(field, collector->classes(), &coco) : collect_json_frame(field, path, collector);
    return false;
  };
  const Result<Json> emptied = parse_json(*text, take);
  if (problem.empty() && !emptied)
    problem = (is_array ? "[" + std::to_string(elements) + "]: " : "") + emptied.message();
  if (problem.empty() && !is_array) problem = "must be an array of images, or of boxes as COCO's results";
  if (!problem.empty()) return Error{path + ": " + problem};
  for (const auto& [stamp_ns, image] : coco) {
    const std::vector<std::string>& places = image.places;
    collector->add(image.frame, path + ": " + places.front(),
                   [&](std::size_t index) { return path + ": " + places[index]; });
  }
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
  DetectionFrame frame{*stamp_ns, {}};
  const std::vector<TextLine> lines = content_lines(*text);
  for (const TextLine& line : lines) {
    const Result<Detection> detection = parse_yolo_line(line.text);
    if (!detection) return Error{at_line(path, line.number, detection.message())};
    frame.detections.push_back(*detection);
  }
  collector->add(frame, path, [&](std::size_t index) { return path + ":" + std::to_string(lines[index].number); });
  return {};
}

/// Paths of the text files in a directory.
Result<std::vector<std::string>> list_yolo_files(const std::string& directory) {
  std::vector<std::string> paths;
  std::error_code code;
  for (std::filesystem::directory_iterator it(directory, code), end; !code && it != end; it.increment(code)) {
    if (it->path().extension() == ".txt") paths.push_back(it->path().string());
  }
  if (code) return Error{directory + ": cannot list the directory: " + code.message()};
  std::sort(paths.begin(), paths.end());  // the order of a directory differs from machine to machine
  return paths;
}

Status collect_yolo(const std::string& directory, Collector* collector) {
  const Result<std::vector<std::string>> paths = list_yolo_files(directory);
  if (!paths) return paths.error();
  for (const std::string& path : *paths) {
    if (const Status collected = collect_yolo_file(path, collector); !collected) return collected;
  }
  return {};
}

/// Whether all boxes end in the first two pixels: they are shares of the image, as YOLO writes them.
bool are_shares(const DetectionRecording& recording) {
  constexpr double kMost = 2.0;  // x and width, one each, are read as a corner and a size
  double largest = 0.0;
  for (const DetectionFrame& frame : recording.frames) {
    for (const Detection& detection : frame.detections) largest = std::max(largest, detection.box.edges().maxCoeff());
  }
  return recording.report.detections > 0 && largest <= kMost;
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
      "unknown class id",
      "box is not finite",
      "box has x2 <= x1 or y2 <= y1 (are its numbers in the stated order?)",
      "score is not in [0, 1]",
      "stamp of an earlier image",
      "more boxes in the image than association.boxes_max, of higher scores"};
  return kNames.at(static_cast<std::size_t>(problem));
}

std::vector<Detection> usable_boxes(const std::vector<Detection>& boxes, const ClassTable& classes,
                                    std::size_t boxes_max, const OnLeftOut& on_left_out) {
  std::vector<std::size_t> usable;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    const std::optional<DetectionProblem> problem = validate(boxes[i], classes);
    problem ? on_left_out(i, *problem, describe(boxes[i], *problem)) : usable.push_back(i);
  }
  if (usable.size() > boxes_max) {
    const auto end_of_kept = usable.begin() + static_cast<std::ptrdiff_t>(boxes_max);
    std::stable_sort(usable.begin(), usable.end(),
                     [&boxes](std::size_t a, std::size_t b) { return boxes[a].score > boxes[b].score; });
    std::sort(usable.begin(), end_of_kept);
    for (auto left_out = end_of_kept; left_out != usable.end(); ++left_out) {
      on_left_out(*left_out, DetectionProblem::kTooMany, std::to_string(boxes.size()) + " boxes");
    }
    usable.erase(end_of_kept, usable.end());
  }
  std::vector<Detection> kept;
  kept.reserve(usable.size());
  for (const std::size_t i : usable) kept.push_back(boxes[i]);
  return kept;
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

Result<DetectionRecording> read_detections(const std::string& path, const ClassTable& classes, std::size_t boxes_max) {
  Collector collector(classes, boxes_max);
  std::error_code code;
  const bool is_directory = std::filesystem::is_directory(path, code);
  const Status collected = is_directory ? collect_yolo(path, &collector) : collect_json(path, &collector);
  if (!collected) return collected.error();
  DetectionRecording recording = collector.take_sorted();
  if (are_shares(recording)) return Error{path + ": boxes must be in pixels, these are shares of the image"};
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
  const Result<std::vector<std::string>> present = list_yolo_files(directory);
  if (!present) return present.error();
  const auto name_of = [](const DetectionFrame& frame) { return format_stamp(frame.stamp_ns) + ".txt"; };
  std::set<std::string> names;
  for (const DetectionFrame& frame : frames) names.insert(name_of(frame));
  for (const std::string& path : *present) {
    if (names.count(std::filesystem::path(path).filename().string()) > 0) continue;
    return Error{path + ": is of other detections, with which these would be read: give another directory"};
  }
  for (const DetectionFrame& frame : frames) {
    std::string text;
    for (const Detection& detection : frame.detections) text += yolo_line(detection);
    if (const Status written = write_text_file(directory + "/" + name_of(frame), text); !written) return written;
  }
  return {};
}

}  // namespace semantic_topo_loop::core
