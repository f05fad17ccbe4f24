#pragma once

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

#include <map>
#include <optional>
#include <string>

#include "semantic_topo_loop/pipeline/options.h"
#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop {

using ParameterTexts = std::map<std::string, std::string>;

/// Flattens nested parameters into `module.field` -> text; numbers keep every digit.
/// @return nullopt, naming the key, for a list, a binary or a date
std::optional<ParameterTexts> flatten_parameters(const XmlRpc::XmlRpcValue& tree, std::string* error);

/// Reads everything below the handle's namespace; none set gives an empty map. Parameters that roscpp's own tools read
/// there (diagnostic_period, num_worker_threads) are left out.
std::optional<ParameterTexts> read_parameters(const ros::NodeHandle& private_handle, std::string* error);

/// Parameters of a nodelet: the options of the core and its own, a struct with `visit` and `is_valid` as the core's
/// options, its keys at top level ("map_frame").
template <class Own>
struct NodeletParameters {
  core::Options options;
  Own own;
};

/// Strict: a missing key keeps its default; an unknown key, a text of the wrong type or a value out of range is an
/// error that names key and value.
template <class Own>
std::optional<NodeletParameters<Own>> make_nodelet_parameters(ParameterTexts texts, std::string* error) {
  NodeletParameters<Own> result;
  core::OptionVisitor own;
  result.own.visit(own);
  ParameterTexts own_texts;
  for (const core::OptionRow& row : own.rows()) {
    const auto it = texts.find(row.key);
    if (it == texts.end()) continue;
    own_texts.insert(*it);
    texts.erase(it);
  }
  const core::Result<core::Options> options = core::make_options<core::Options>(texts);
  if (!options) {
    if (error != nullptr) *error = options.message();
    return std::nullopt;
  }
  result.options = *options;
  if (const core::Status status = own.set(own_texts); !status) {
    if (error != nullptr) *error = status.message();
    return std::nullopt;
  }
  if (!result.own.is_valid(error)) return std::nullopt;
  return result;
}

/// read_parameters and make_nodelet_parameters in one.
template <class Own>
std::optional<NodeletParameters<Own>> load_parameters(const ros::NodeHandle& private_handle, std::string* error) {
  const std::optional<ParameterTexts> texts = read_parameters(private_handle, error);
  return texts ? make_nodelet_parameters<Own>(*texts, error) : std::nullopt;
}

}  // namespace semantic_topo_loop
