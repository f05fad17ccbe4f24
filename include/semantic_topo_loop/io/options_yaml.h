#pragma once

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/pipeline/options.h"

namespace semantic_topo_loop::core {

/// Reads a YAML file `module: {field: value}` such as config/default.yaml.
/// @return nullopt, with file, line and key in `error`, if the file is missing or of another shape, if a key is given
/// twice, unknown, or its value of the wrong type
std::optional<OptionTexts> read_option_texts(const std::string& path, std::string* error);

/// The options of a program: defaults, then the file (unless the path is empty), then the assignments, strictly.
std::optional<Options> load_options(const std::string& path, const OptionTexts& assignments, std::string* error);

/// Rows as a file that read_option_texts reads.
std::string format_options_yaml(const std::vector<OptionRow>& rows);

/// Rows as a Markdown table.   @param owners heading of a first column that says who has a parameter; empty: none
std::string format_options_table(const std::vector<OptionRow>& rows, const std::string& owners = "");

}  // namespace semantic_topo_loop::core
