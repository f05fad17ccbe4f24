#include "semantic_topo_loop/io/rgbd_folder.h"

#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

std::optional<cv::Mat> read_image(const std::string& path, int flags, std::string* error) {
  std::error_code missing;
  if (!std::filesystem::is_regular_file(path, missing)) {
    if (error != nullptr) *error = path + ": no such file";
    return std::nullopt;
  }
  cv::Mat image;
  try {
    image = cv::imread(path, flags);
  } catch (const cv::Exception& exception) {
    if (error != nullptr) *error = path + ": " + exception.what();
    return std::nullopt;
  }
  if (image.empty()) {
    if (error != nullptr) *error = path + ": not an image that can be read";
    return std::nullopt;
  }
  return image;
}

std::string joined(const std::string& directory, std::string_view path) {
  return (std::filesystem::path(directory) / std::string(path)).string();
}

}  // namespace

std::optional<std::vector<RgbdFile>> read_associations(const std::string& path, const std::string& directory,
                                                       std::string* warning, std::string* error) {
  const std::optional<std::string> text = read_text_file(path, error);
  if (!text) return std::nullopt;
  const auto fail = [error](const std::string& message) {
    if (error != nullptr) *error = message;
    return std::nullopt;
  };
  std::vector<RgbdFile> files;
  int left_out = 0;
  std::string first_left_out;
  for (const TextLine& line : content_lines(*text)) {
    const std::vector<std::string_view> fields = split_blanks(line.text);
    if (fields.size() < 4) {
      return fail(
          at_line(path, line.number,
                  std::to_string(fields.size()) + " columns, but 't_rgb rgb_path t_depth depth_path' are four"));
    }
    const std::optional<std::int64_t> stamp_ns = parse_stamp(fields[0]);
    if (!stamp_ns || !parse_stamp(fields[2])) {
      return fail(at_line(path, line.number, "'" + std::string(stamp_ns ? fields[2] : fields[0]) + "' is no stamp"));
    }
    if (!files.empty() && *stamp_ns <= files.back().stamp_ns) {
      if (++left_out == 1) {
        first_left_out = at_line(path, line.number, "stamp " + std::string(fields[0]) + " is not after the one before");
      }
      continue;
    }
    files.push_back({*stamp_ns, joined(directory, fields[1]), joined(directory, fields[3])});
  }
  if (files.empty()) return fail(path + ": no images");
  if (warning != nullptr) {
    *warning = left_out == 0 ? "" : std::to_string(left_out) + " images left out (first: " + first_left_out + ")";
  }
  return files;
}

std::optional<RgbdImage> read_rgbd_image(const RgbdFile& file, const Camera& camera, const DepthOptions& options,
                                         std::string* error) {
  const std::optional<cv::Mat> color = read_image(file.color, cv::IMREAD_COLOR, error);
  if (!color) return std::nullopt;
  const std::optional<cv::Mat> depth = read_image(file.depth, cv::IMREAD_UNCHANGED, error);
  if (!depth) return std::nullopt;
  Result<RgbdImage> image = make_rgbd_image(file.stamp_ns, *color, *depth, camera, options);
  if (image) return *std::move(image);
  if (error != nullptr) *error = file.color + ", " + file.depth + ": " + image.message();
  return std::nullopt;
}

std::optional<RgbdReading> RgbdFolder::next(std::string* /*fault*/) {
  if (index_ == files_.size()) return std::nullopt;
  RgbdReading reading;
  reading.image = read_rgbd_image(files_[index_++], camera_, options_, &reading.error);
  return reading;
}

}  // namespace semantic_topo_loop::core
