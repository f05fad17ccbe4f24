#include "tools/rendering/rgbd_sequence.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <future>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/rendering/scene_renderer.h"

namespace semantic_topo_loop::core {
namespace {

/// Raised whenever the same options give other images.
constexpr int kGeneratorVersion = 1;
constexpr char kManifest[] = "manifest.txt";
constexpr char kManifestTitle[] = "# What this directory was made from.\n";
/// What comes with images alone.
constexpr std::array<const char*, 5> kImageFiles = {"rgb", "depth", "rgb.txt", "depth.txt", "associations.txt"};
constexpr int kPngCompression = 1;  ///< the images' noise leaves little to gain

std::string color_name(const SimulatedSequence& sequence, std::size_t frame) {
  return "rgb/" + format_stamp(sequence.truth[frame].stamp_ns) + ".png";
}

std::string depth_name(const SimulatedSequence& sequence, std::size_t frame) {
  return "depth/" + format_stamp(sequence.depth[frame].stamp_ns) + ".png";
}

/// 16-bit depth.
cv::Mat quantised(const cv::Mat& depth_m, const RenderingOptions& options) {
  constexpr double kLargest = 65534.0;  // 65535 may mean "out of range"
  cv::Mat result(depth_m.size(), CV_16UC1);
  const auto far_value = static_cast<std::uint16_t>(options.far_value);
  for (int y = 0; y < depth_m.rows; ++y) {
    const float* in = depth_m.ptr<float>(y);
    std::uint16_t* out = result.ptr<std::uint16_t>(y);
    for (int x = 0; x < depth_m.cols; ++x) {
      const double slope = 1.0 + options.depth_slope * (2.0 * x / (depth_m.cols - 1) - 1.0);
      const double depth = slope * static_cast<double>(in[x]);
      const double units = std::isinf(in[x]) ? kLargest + 1.0 : options.depth_scale * depth + 0.5;
      out[x] = std::isnan(in[x]) ? std::uint16_t{0} : units < kLargest ? static_cast<std::uint16_t>(units) : far_value;
    }
  }
  return result;
}

Status write_image(const std::string& path, const cv::Mat& image) {
  try {
    if (cv::imwrite(path, image, {cv::IMWRITE_PNG_COMPRESSION, kPngCompression})) return {};
  } catch (const cv::Exception&) {
  }
  return Error{path + ": cannot write the image"};
}

Result<cv::Mat> read_image(const std::string& path, int type, const Camera& camera) {
  cv::Mat image;
  try {
    // imread would print about a missing file.
    std::error_code ignored;
    if (std::filesystem::exists(path, ignored)) image = cv::imread(path, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    image.release();
  }
  if (image.type() == type && image.cols == camera.width && image.rows == camera.height) return image;
  return Error{path + ": cannot read an image of the sequence"};
}

/// Renders single frames; const, so that threads may share it.
struct FrameWriter {
  const SimulationOptions& options;
  const SimulatedSequence& sequence;
  const std::string& directory;
  const PixelRays rays{sequence.camera};
  const SceneRenderer renderer{sequence.scene, room_around(sequence.scene, sequence.mocap),
                               seed_of(options, SeedStream::kTextures)};

  using Views = std::vector<std::optional<ObjectView>>;

  /// Writes one frame's images.
  /// @return what the color image shows
  Result<Views> write(std::size_t frame) const {
    const RenderingOptions& rendering = options.rendering;
    const double time_s = sequence.time_s(frame);
    RenderedImage image = renderer.render(rays, sequence.truth[frame].T_world_camera, time_s);
    const std::uint64_t seed =
        2 * (seed_of(options, SeedStream::kImageNoise) + 16 * static_cast<std::uint64_t>(frame) * 0x10001);
    const cv::Mat color = rendering.noise ? kinect_color(image.color, seed) : image.color;
    Views views = std::move(image.objects);
    Status written = write_image(directory + "/" + color_name(sequence, frame), color);
    if (!written) return written.error();
    const bool is_same_view = rendering.depth_delay_s == 0.0 && rendering.depth_offset_m == 0.0;
    const SE3 T_world_depth = sequence.depth[frame].T_world_camera * color_from_depth(rendering);
    const RenderedImage depth =
        is_same_view ? std::move(image) : renderer.render(rays, T_world_depth, time_s + rendering.depth_delay_s, false);
    const cv::Mat measured = rendering.noise ? kinect_depth(depth, rays, seed + 1) : depth.depth_m;
    written = write_image(directory + "/" + depth_name(sequence, frame), quantised(measured, rendering));
    if (!written) return written.error();
    return views;
  }
};

Status write_lists(const SimulatedSequence& sequence, const std::string& directory) {
  std::string colors = "# colour images: timestamp filename\n", depths = "# depth images: timestamp filename\n", pairs;
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) {
    const std::string color = format_stamp(sequence.truth[i].stamp_ns) + " " + color_name(sequence, i);
    const std::string depth = format_stamp(sequence.depth[i].stamp_ns) + " " + depth_name(sequence, i);
    colors += color + "\n";
    depths += depth + "\n";
    pairs += color + " " + depth + "\n";
  }
  for (const auto& [name, text] :
       {std::pair("rgb.txt", colors), std::pair("depth.txt", depths), std::pair("associations.txt", pairs)}) {
    if (Status written = write_text_file(directory + "/" + name, text); !written) return written;
  }
  return {};
}

bool is_there(const std::string& directory, const char* name) {
  std::error_code missing;
  return std::filesystem::exists(std::filesystem::symlink_status(directory + "/" + name, missing));
}

/// Fowler-Noll-Vo hash.
std::uint64_t fnv1a(const std::string& text) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3ULL;
  return hash;
}

}  // namespace

SE3 color_from_depth(const RenderingOptions& options) {
  return {Quaternion::Identity(), {options.depth_offset_m, 0.0, 0.0}};
}

Status begin_sequence(const std::string& directory, bool with_images) {
  if (Status made = make_directory(directory); !made) return made;
  const auto begins_with = [&directory](const char* name, const std::string& title) {
    const Result<std::string> text = read_text_file(directory + "/" + name);
    return text && text->rfind(title, 0) == 0;
  };
  const bool has_own_images = begins_with(kManifest, kManifestTitle);
  const bool is_own = has_own_images || begins_with("camera.yaml", kSequenceTitle);
  std::vector<const char*> others;
  if (!has_own_images) others.insert(others.end(), kImageFiles.begin(), kImageFiles.end());
  if (!is_own) others.insert(others.end(), kSequenceFiles.begin(), kSequenceFiles.end());
  for (const char* name : others) {
    if (!is_there(directory, name)) continue;
    return Error{directory + ": holds a recording that is not simulated (" + name + "): give another directory"};
  }
  if (!has_own_images && !with_images) return {};
  std::vector<const char*> images(kImageFiles.begin(), kImageFiles.end());
  images.push_back("sequence.bag");
  for (const char* name : images) {
    std::error_code ignored;
    std::filesystem::remove_all(directory + "/" + name, ignored);
  }
  return write_text_file(directory + "/" + kManifest, kManifestTitle);
}

bool has_rendered_sequence(const std::string& directory, const std::string& manifest) {
  const Result<std::string> made_from = read_text_file(directory + "/" + kManifest);
  const auto is_here = [&directory](const char* name) { return is_there(directory, name); };
  return made_from && *made_from == manifest && std::all_of(kImageFiles.begin(), kImageFiles.end(), is_here) &&
         std::all_of(kSequenceFiles.begin(), kSequenceFiles.end(), is_here);
}

Status finish_sequence(const std::string& directory, const std::string& manifest) {
  return write_text_file(directory + "/" + kManifest, manifest);
}

Status render_sequence(const SimulationOptions& options, const ClassTable& classes, int threads,
                       const std::string& directory, SimulatedSequence* sequence) {
  if (Status begun = begin_sequence(directory, true); !begun) return begun;
  for (const char* name : {"/rgb", "/depth"}) {
    if (Status made = make_directory(directory + name); !made) return made;
  }
  const FrameWriter writer{options, *sequence, directory};
  DetectorModel detector(sequence->scene, sequence->camera, classes, options.detector, options.trajectory.rate_hz,
                         seed_of(options, SeedStream::kDetector));
  const auto batch = static_cast<std::size_t>(std::max(1, threads));
  for (std::size_t begin = 0; begin < sequence->truth.size(); begin += batch) {
    const std::size_t end = std::min(begin + batch, sequence->truth.size());
    std::vector<std::future<Result<FrameWriter::Views>>> written;
    for (std::size_t i = begin; i < end; ++i) {
      written.push_back(std::async(std::launch::async, [&writer, i] { return writer.write(i); }));
    }
    for (std::size_t i = begin; i < end; ++i) {
      const Result<FrameWriter::Views> views = written[i - begin].get();
      if (!views) return views.error();
      sequence->detections[i] = detector.detect(sequence->truth[i].T_world_camera, *views);
    }
  }
  return write_lists(*sequence, directory);
}

Result<cv::Mat> read_rendered_color(const SimulatedSequence& sequence, const std::string& directory,
                                    std::size_t frame) {
  return read_image(directory + "/" + color_name(sequence, frame), CV_8UC3, sequence.camera);
}

Result<cv::Mat> read_rendered_depth(const SimulatedSequence& sequence, const RenderingOptions& rendering,
                                    const std::string& directory, std::size_t frame) {
  const Result<cv::Mat> units = read_image(directory + "/" + depth_name(sequence, frame), CV_16UC1, sequence.camera);
  if (!units) return units.error();
  cv::Mat depth_m(units->size(), CV_32FC1);
  for (int y = 0; y < units->rows; ++y) {
    const auto* in = units->ptr<std::uint16_t>(y);
    float* out = depth_m.ptr<float>(y);
    for (int x = 0; x < units->cols; ++x) {
      const bool has_depth = in[x] != 0 && in[x] != rendering.far_value;
      out[x] = has_depth ? static_cast<float>(in[x] / rendering.depth_scale) : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return depth_m;
}

std::string sequence_manifest(const SimulationOptions& options, const Camera& camera, const std::string& class_table,
                              const std::string& outputs) {
  std::string text = std::string(kManifestTitle) + "generator " + std::to_string(kGeneratorVersion) + "\noutputs " +
                     outputs + "\nclasses " + std::to_string(fnv1a(class_table)) + "\n";
  for (const OptionRow& row : list_options(options)) text += row.key + " " + row.value + "\n";
  return text + format_camera(camera);
}

}  // namespace semantic_topo_loop::core
