#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// Side of the square image, 1 x 3 x side x side, that an ONNX model declares as its input. OpenCV does not tell, and
/// runs models of no reshaping to a fixed size on any other, where they find less.
/// @param path a file that OpenCV has read   @return px, a multiple of 32; 0 if the model leaves it open
int declared_input_px(const std::string& path);

}  // namespace semantic_topo_loop::core
