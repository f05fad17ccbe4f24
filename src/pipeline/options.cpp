#include "semantic_topo_loop/pipeline/options.h"

namespace semantic_topo_loop::core {

bool Options::is_valid(std::string* error) const {
  return depth.is_valid(error) && frontend.is_valid(error) && keyframe.is_valid(error) && association.is_valid(error) &&
         mapping.is_valid(error) && point_map.is_valid(error) && loop.is_valid(error) && pose_graph.is_valid(error);
}

std::optional<Options> make_options(const std::map<std::string, std::string>& values, std::string* error) {
  Options options;
  OptionSetter setter(values);
  options.visit(setter);
  const std::string problem = setter.error();
  if (!problem.empty()) {
    if (error != nullptr) *error = problem;
    return std::nullopt;
  }
  if (!options.is_valid(error)) return std::nullopt;
  return options;
}

std::vector<OptionLister::Row> list_options() {
  Options options;
  OptionLister lister;
  options.visit(lister);
  return lister.rows;
}

}  // namespace semantic_topo_loop::core
