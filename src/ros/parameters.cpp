#include "ros/parameters.h"

#include <ros/param.h>

#include <array>
#include <iterator>
#include <sstream>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {
namespace {

/// Read from a nodelet's private namespace by diagnostic_updater and by `nodelet standalone`.
constexpr std::array<const char*, 2> kForeignKeys = {"diagnostic_period", "num_worker_threads"};
/// Their values name groups there that image_transport's plugins read and write, by dynamic_reconfigure say.
constexpr std::array<const char*, 2> kTransportKeys = {"color_transport", "depth_transport"};

/// XmlRpcValue's conversions and iterators are not const: they work on this copy.
core::Status flatten(XmlRpc::XmlRpcValue value, const std::string& key, core::OptionTexts* texts) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeStruct:
      for (auto& [name, child] : value) {
        const core::Status status = flatten(child, key.empty() ? name : key + "." + name, texts);
        if (!status) return status;
      }
      return {};
    case XmlRpc::XmlRpcValue::TypeBoolean:
      (*texts)[key] = static_cast<bool&>(value) ? "true" : "false";
      return {};
    case XmlRpc::XmlRpcValue::TypeInt:
      (*texts)[key] = std::to_string(static_cast<int&>(value));
      return {};
    case XmlRpc::XmlRpcValue::TypeDouble:
      (*texts)[key] = exact_text(static_cast<double&>(value));
      return {};
    case XmlRpc::XmlRpcValue::TypeString:
      (*texts)[key] = static_cast<std::string&>(value);
      return {};
    default:
      return core::Error{"parameter '" + key + "' is neither a text, a number, true, false nor a group"};
  }
}

/// Adds the rows that a struct has beside those of the one that it inherits.
template <class Own, class Base>
void add_rows(const std::string& owner, std::vector<core::OptionRow>* rows) {
  const std::size_t inherited = core::list_options<Base>().size();
  std::vector<core::OptionRow> own = core::list_options<Own>();
  for (std::size_t i = inherited; i < own.size(); ++i) {
    own[i].owner = owner;
    rows->push_back(std::move(own[i]));
  }
}

struct Nothing {
  void visit(core::OptionVisitor&) {}
};

}  // namespace

std::vector<std::string> PlayerParameters::stage_names() const {
  std::istringstream words(stages);
  return {std::istream_iterator<std::string>(words), std::istream_iterator<std::string>()};
}

std::vector<core::OptionRow> list_nodelet_parameters() {
  std::vector<core::OptionRow> rows;
  add_rows<StageParameters, Nothing>("every stage", &rows);
  add_rows<ClassStageParameters, StageParameters>("those that need classes", &rows);
  add_rows<FileStageParameters<ClassStageParameters>, ClassStageParameters>("those with services that name files",
                                                                            &rows);
  add_rows<FrontendParameters, FileStageParameters<ClassStageParameters>>("both front ends", &rows);
  add_rows<PoseFrontendParameters, FrontendParameters>("PoseFrontend", &rows);
  add_rows<RgbdFrontendParameters, FrontendParameters>("RgbdFrontend", &rows);
  add_rows<ObjectDetectorParameters, ClassStageParameters>("ObjectDetector", &rows);
  add_rows<DetectionParameters, ClassStageParameters>("DetectionIngestion", &rows);
  add_rows<LoopDetectionParameters, ClassStageParameters>("LoopDetection", &rows);
  add_rows<PlayerParameters, StageParameters>("Player", &rows);
  add_rows<QuadricMappingParameters, ClassStageParameters>("those that publish in the map", &rows);
  add_rows<PoseGraphParameters, FileStageParameters<MapStageParameters>>("PoseGraph", &rows);
  add_rows<PointMappingParameters, FileStageParameters<MapStageParameters>>("PointMapping", &rows);
  add_rows<MapDatabaseParameters, FileStageParameters<ClassStageParameters>>("MapDatabase", &rows);
  add_rows<RecorderParameters, ClassStageParameters>("Recorder", &rows);
  add_rows<VisualizationParameters, QuadricMappingParameters>("Visualization", &rows);
  return rows;
}

std::string exact_text(double value) {
  std::string text;
  for (int digits = 15; digits <= 17 && core::parse_double(text) != value; ++digits) {
    text = core::format_general(value, digits);
  }
  return text;
}

core::Result<core::OptionTexts> flatten_parameters(const XmlRpc::XmlRpcValue& tree) {
  core::OptionTexts texts;
  if (!tree.valid()) return texts;
  if (const core::Status status = flatten(tree, "", &texts); !status) return status.error();
  return texts;
}

core::OptionTexts own_parameters(core::OptionTexts texts) {
  for (const char* key : kForeignKeys) texts.erase(key);
  for (const char* key : kTransportKeys) {
    const auto transport = texts.find(key);
    if (transport == texts.end()) continue;
    const std::string group = transport->second + ".";
    const auto is_in_group = [&](auto text) { return text != texts.end() && text->first.rfind(group, 0) == 0; };
    for (auto text = texts.lower_bound(group); is_in_group(text);) text = texts.erase(text);
  }
  return texts;
}

core::Result<core::OptionTexts> read_parameters(const ros::NodeHandle& private_handle) {
  XmlRpc::XmlRpcValue tree;
  if (!ros::param::get(private_handle.getNamespace(), tree)) return core::OptionTexts();
  core::Result<core::OptionTexts> texts = flatten_parameters(tree);
  return texts ? own_parameters(*std::move(texts)) : texts;
}

}  // namespace semantic_topo_loop
