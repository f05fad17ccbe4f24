#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Why a box, or a whole image of boxes, is left out.
enum class DetectionProblem : std::uint8_t {
  kUnknownClass = 0,     ///< the class table does not list the id
  kBoxNotFinite = 1,     ///< a corner is NaN or infinite
  kBoxInverted = 2,      ///< x2 <= x1 or y2 <= y1
  kScoreOutOfRange = 3,  ///< the score is not in [0, 1]
  kDuplicateStamp = 4,   ///< a second image with the stamp of an earlier one
  kTooMany = 5,          ///< the image has more boxes, of higher scores, than are taken
};
constexpr std::size_t kDetectionProblemCount = 6;

/// What the problem means, for a warning: "unknown class id".
const char* to_string(DetectionProblem problem);

/// Hears of a box that is left out: its index, why, and the offending field and its value, "class id 91".
using OnLeftOut = std::function<void(std::size_t index, DetectionProblem problem, const std::string& value)>;

/// The boxes of an image that can be used, in their order.
/// @param boxes_max of these, those of the highest scores, the first of equal ones
std::vector<Detection> usable_boxes(const std::vector<Detection>& boxes, const ClassTable& classes,
                                    std::size_t boxes_max, const OnLeftOut& on_left_out);

/// What was taken in and what was left out, by cause, each with the first place where it occurred.
struct DetectionReport {
  struct Cause {
    int count = 0;
    std::string first;  ///< file, line or field, and value
  };
  int frames = 0;      ///< images, with or without detections
  int detections = 0;  ///< that were kept
  std::array<Cause, kDetectionProblemCount> causes;

  void add(DetectionProblem problem, const std::string& where) {
    Cause& entry = causes[static_cast<std::size_t>(problem)];
    if (entry.count++ == 0) entry.first = where;
  }
  const Cause& cause(DetectionProblem problem) const { return causes[static_cast<std::size_t>(problem)]; }
  /// One line a cause that occurred: "12 boxes left out: unknown class id (first: boxes.json: ...)".
  std::vector<std::string> warnings() const;
};

/// Recorded detections in order of stamps, without duplicates, and what was left out.
struct DetectionRecording {
  std::vector<DetectionFrame> frames;
  DetectionReport report;
};

/// Reads
/// - a file: OA-SLAM's JSON, `[{file_name: "<stamp>.png", detections: [{category_id, detection_score,
///   bbox: [x1, y1, x2, y2]}]}]`, or COCO's results, `[{image_id: "<stamp>", category_id, bbox: [x, y, w, h], score}]`
/// - a directory: YOLO text files `<stamp>.txt` with a line `class x y w h score` a box, (x, y) the top-left corner
///
/// Single bad boxes are left out and counted, and so are those beyond `boxes_max` of an image.
/// @return an error, with file, line or field, and value, if the path is missing, holds no image, or a text cannot be
/// parsed
Result<DetectionRecording> read_detections(const std::string& path, const ClassTable& classes,
                                           std::size_t boxes_max = std::numeric_limits<std::size_t>::max());

/// Write what read_detections reads; stamps become file names.
/// @return an error, with the path, if a file cannot be written, or a directory holds text files of other images
Status write_detections_json(const std::string& path, const std::vector<DetectionFrame>& frames);
Status write_detections_yolo(const std::string& directory, const std::vector<DetectionFrame>& frames);

}  // namespace semantic_topo_loop::core
