#include "semantic_topo_loop/io/rgbd_recording.h"

#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

Result<cv::Mat> read_image(const std::string& path, int flags) {
  std::error_code missing;
  if (!std::filesystem::is_regular_file(path, missing)) return Error{path + ": no such file"};
  cv::Mat image;
  try {
    image = cv::imread(path, flags);
  } catch (const cv::Exception& exception) {
    return Error{path + ": " + exception.what()};
  }
  if (image.empty()) return Error{path + ": not an image that can be read"};
  return image;
}

std::string joined(const std::string& directory, std::string_view path) {
  return (std::filesystem::path(directory) / std::string(path)).string();
}

}  // namespace

Result<RgbdFiles> read_associations(const std::string& path, const std::string& directory) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  RgbdFiles read;
  int left_out = 0;
  std::string first_left_out;
  for (const TextLine& line : content_lines(*text)) {
    const std::vector<std::string_view> fields = split_blanks(line.text);
    if (fields.size() < 4) {
      return Error{
          at_line(path, line.number,
                  std::to_string(fields.size()) + " columns, but 't_rgb rgb_path t_depth depth_path' are four")};
    }
    const std::optional<std::int64_t> stamp_ns = parse_stamp(fields[0]);
    if (!stamp_ns || !parse_stamp(fields[2])) {
      return Error{at_line(path, line.number, "'" + std::string(stamp_ns ? fields[2] : fields[0]) + "' is no stamp")};
    }
    if (!read.files.empty() && *stamp_ns <= read.files.back().stamp_ns) {
      if (++left_out == 1) {
        first_left_out = at_line(path, line.number, "stamp " + std::string(fields[0]) + " is not after the one before");
      }
      continue;
    }
    read.files.push_back({*stamp_ns, joined(directory, fields[1]), joined(directory, fields[3])});
  }
  if (read.files.empty()) return Error{path + ": no images"};
  if (left_out > 0) read.warning = std::to_string(left_out) + " images left out (first: " + first_left_out + ")";
  return read;
}

Result<RgbdImage> read_rgbd_image(const RgbdFile& file, const Camera& camera, const DepthOptions& options) {
  const Result<cv::Mat> color = read_image(file.color, cv::IMREAD_COLOR);
  if (!color) return color.error();
  const Result<cv::Mat> depth = read_image(file.depth, cv::IMREAD_UNCHANGED);
  if (!depth) return depth.error();
  Result<RgbdImage> image = make_rgbd_image(file.stamp_ns, *color, *depth, camera, options);
  if (!image) return Error{file.color + ", " + file.depth + ": " + image.message()};
  return image;
}

Result<std::optional<RgbdReading>> RgbdFolder::next() {
  if (index_ == files_.size()) return std::optional<RgbdReading>();
  return std::optional<RgbdReading>({read_rgbd_image(files_[index_++], camera_, options_), ""});
}

}  // namespace semantic_topo_loop::core
