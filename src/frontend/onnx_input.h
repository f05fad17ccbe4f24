#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// Size of an image, 1 x 3 x height x width; 0 if it is left open.
struct DeclaredInput {
  int width_px = 0, height_px = 0;
};

/// The image that an ONNX model declares as its input. OpenCV does not tell, and runs models of no reshaping to a fixed
/// size on any other, where they find less.
/// @param path a file that OpenCV has read   @return multiples of 32
DeclaredInput declared_input(const std::string& path);

}  // namespace semantic_topo_loop::core
