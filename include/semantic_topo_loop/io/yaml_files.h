#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/pipeline/options.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Reads a calibration such as config/camera/tum_fr2.yaml: `fx, fy, cx, cy, width, height` (pixels) and `distortion`,
/// the five plumb-bob coefficients `[k1, k2, p1, p2, k3]`. Every key must be there.
/// @return an error, with file, line, key and value, for anything else
Result<Camera> read_camera(const std::string& path);
/// The text of such a file.
std::string format_camera(const Camera& camera);

/// Reads a class table such as config/classes_coco.yaml:
/// `classes: [{id, name, role: static|movable|dynamic|ignore, coco_id, group, size_prior_m, size_range_m}]`; the last
/// four are optional.
/// @return an error, with file, line, key and value, for anything else
Result<ClassTable> read_class_table(const std::string& path);

/// Reads a YAML file `module: {field: value}` such as config/default.yaml.
/// @return an error, with file, line and key, if the file is missing or of another shape, if a key is given
/// twice, unknown, or its value of the wrong type
Result<OptionTexts> read_option_texts(const std::string& path);

/// The options of a program: defaults, then the file (unless the path is empty), then the assignments, strictly.
Result<Options> load_options(const std::string& path, const OptionTexts& assignments);

/// Rows as a file that read_option_texts reads.
std::string format_options_yaml(const std::vector<OptionRow>& rows);

/// Rows as a Markdown table.   @param owners heading of a first column that says who has a parameter; empty: none
std::string format_options_table(const std::vector<OptionRow>& rows, const std::string& owners = "");

}  // namespace semantic_topo_loop::core
