#include "semantic_topo_loop/io/camera_yaml.h"

#include "io/yaml.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

bool parse_distortion(const std::string& path, const YAML::Node& node, Camera* camera, std::string* error) {
  bool ok = node.IsSequence() && node.size() == camera->distortion.size();
  for (std::size_t i = 0; ok && i < camera->distortion.size(); ++i) {
    ok = node[i].IsScalar() && YAML::convert<double>::decode(node[i], camera->distortion[i]);
  }
  if (!ok) *error = yaml_place(path, node) + ": 'distortion' must be five numbers [k1, k2, p1, p2, k3]";
  return ok;
}

std::optional<Camera> parse_camera(const std::string& path, std::string* error) {
  const std::vector<std::string> keys = {"fx", "fy", "cx", "cy", "width", "height", "distortion"};
  const std::optional<YAML::Node> root = read_yaml_map(path, error);
  if (!root || !check_keys(path, *root, keys, keys, error)) return std::nullopt;
  Camera camera;
  struct Field {
    const char* key;
    double* value;
  };
  for (const Field& field : {Field{"fx", &camera.fx}, {"fy", &camera.fy}, {"cx", &camera.cx}, {"cy", &camera.cy}}) {
    const auto value = yaml_value<double>(path, *root, field.key, "a number", error);
    if (!value) return std::nullopt;
    *field.value = *value;
  }
  const auto width = yaml_value<int>(path, *root, "width", "an integer", error);
  const auto height = width ? yaml_value<int>(path, *root, "height", "an integer", error) : std::nullopt;
  if (!height || !parse_distortion(path, (*root)["distortion"], &camera, error)) return std::nullopt;
  camera.width = *width;
  camera.height = *height;
  if (const Status status = camera.check(); !status) {
    *error = path + ": " + status.message();
    return std::nullopt;
  }
  return camera;
}

}  // namespace

std::optional<Camera> read_camera(const std::string& path, std::string* error) {
  std::string problem;
  std::optional<Camera> camera = parse_camera(path, &problem);
  if (!camera && error != nullptr) *error = problem;
  return camera;
}

std::string format_camera(const Camera& camera) {
  constexpr int kDigits = 15;
  std::string text;
  for (const auto& [key, value] : {std::pair("fx", camera.fx), std::pair("fy", camera.fy), std::pair("cx", camera.cx),
                                   std::pair("cy", camera.cy)}) {
    text += std::string(key) + ": " + format_general(value, kDigits) + "\n";
  }
  text += "width: " + std::to_string(camera.width) + "\nheight: " + std::to_string(camera.height) + "\ndistortion: [";
  for (std::size_t i = 0; i < camera.distortion.size(); ++i) {
    text += (i == 0 ? "" : ", ") + format_general(camera.distortion[i], kDigits);
  }
  return text + "]  # k1, k2, p1, p2, k3\n";
}

}  // namespace semantic_topo_loop::core
