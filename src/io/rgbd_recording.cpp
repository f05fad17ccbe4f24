#include "semantic_topo_loop/io/rgbd_recording.h"

#include <cstdlib>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <tuple>

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

/// Images by stamp: `stamp path` a line; of two with one stamp the first counts.
Result<std::map<std::int64_t, std::string>> read_image_list(const std::string& directory, const char* name) {
  const std::string path = joined(directory, name);
  const Result<std::string> text = read_text_file(path);
  if (!text) return Error{text.message() + "; a folder without associations.txt needs rgb.txt and depth.txt"};
  std::map<std::int64_t, std::string> images;
  for (const TextLine& line : content_lines(*text)) {
    const std::vector<std::string_view> fields = split_blanks(line.text);
    const std::optional<std::int64_t> stamp_ns = parse_stamp(fields[0]);
    if (!stamp_ns) return Error{at_line(path, line.number, "'" + std::string(fields[0]) + "' is no stamp")};
    if (fields.size() < 2) return Error{at_line(path, line.number, "1 column, but 'stamp path' are two")};
    images.emplace(*stamp_ns, joined(directory, fields[1]));
  }
  if (images.empty()) return Error{path + ": no images"};
  return images;
}

}  // namespace

Result<RgbdFiles> associate_images(const std::string& directory) {
  const auto colors = read_image_list(directory, "rgb.txt");
  if (!colors) return colors.error();
  const auto depths = read_image_list(directory, "depth.txt");
  if (!depths) return depths.error();
  constexpr std::int64_t kMaxDifference_ns = 20000000;  // 0.02 s, the default of the benchmark's associate.py
  std::set<std::tuple<std::int64_t, std::int64_t, std::int64_t>> candidates;  // difference, color, depth
  for (const auto& [color_ns, unused] : *colors) {
    for (auto depth = depths->upper_bound(color_ns - kMaxDifference_ns);
         depth != depths->end() && depth->first - color_ns < kMaxDifference_ns; ++depth) {
      candidates.emplace(std::abs(depth->first - color_ns), color_ns, depth->first);
    }
  }
  std::map<std::int64_t, std::int64_t> depth_of;
  std::set<std::int64_t> taken;
  for (const auto& [difference_ns, color_ns, depth_ns] : candidates) {
    if (depth_of.count(color_ns) == 0 && taken.insert(depth_ns).second) depth_of.emplace(color_ns, depth_ns);
  }
  RgbdFiles read;
  for (const auto& [color_ns, depth_ns] : depth_of) {
    read.files.push_back({color_ns, colors->at(color_ns), depths->at(depth_ns)});
  }
  const std::string counts = std::to_string(read.files.size()) + " of " + std::to_string(colors->size()) +
                             " color images of rgb.txt have one of depth.txt within 0.02 s";
  if (read.files.empty()) return Error{directory + ": " + counts};
  read.warning = "no associations.txt in " + directory + ": " + counts;
  return read;
}

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

Result<RgbdFiles> list_rgbd_images(const std::string& directory, const std::string& associations) {
  if (!associations.empty()) return read_associations(associations, directory);
  const std::string usual = joined(directory, "associations.txt");
  std::error_code missing;
  return std::filesystem::exists(usual, missing) ? read_associations(usual, directory) : associate_images(directory);
}

Result<std::map<std::int64_t, std::string>> list_color_images(const std::string& directory) {
  std::error_code missing;
  const bool is_as_downloaded = std::filesystem::exists(joined(directory, "rgb.txt"), missing);
  return read_image_list(directory, is_as_downloaded ? "rgb.txt" : "associations.txt");
}

Result<cv::Mat> read_color_image(const std::string& path) { return read_image(path, cv::IMREAD_COLOR); }

Result<RgbdImage> read_rgbd_image(const RgbdFile& file, const Camera& camera, const DepthOptions& options) {
  // JPEG holds brightness by itself, which is read in a third of the time. PNG does not: nothing would be saved.
  const std::string extension = std::filesystem::path(file.color).extension();
  const bool is_jpeg = extension == ".jpg" || extension == ".jpeg";
  const Result<cv::Mat> color = read_image(file.color, is_jpeg ? cv::IMREAD_GRAYSCALE : cv::IMREAD_COLOR);
  if (!color) return color.error();
  const Result<cv::Mat> depth = read_image(file.depth, cv::IMREAD_UNCHANGED);
  if (!depth) return depth.error();
  Result<RgbdImage> image = make_rgbd_image(file.stamp_ns, *color, *depth, camera, options);
  if (!image) return Error{file.color + ", " + file.depth + ": " + image.message()};
  return image;
}

RgbdRecording read_images(std::vector<RgbdFile> files, const Camera& camera, const DepthOptions& options) {
  const std::size_t total = files.size();
  auto next = [=, files = std::move(files), i = std::size_t{0}]() mutable -> Result<std::optional<RgbdReading>> {
    if (i == files.size()) return std::optional<RgbdReading>();
    const RgbdFile& file = files[i++];
    return std::optional<RgbdReading>(
        {read_rgbd_image(file, camera, options), "", [path = file.color] { return read_color_image(path); }});
  };
  return {std::move(next), total};
}

}  // namespace semantic_topo_loop::core
