#pragma once

namespace semantic_topo_loop::core {

/// Standard deviation of the depth that a structured-light camera measures at `depth_m`: its disparity has a fixed
/// noise, so that the depth's grows with the square (Khoshelham and Elberink 2012: 1.4 mm at one metre).
inline double depth_sigma_m(double depth_m) { return 1.4e-3 * depth_m * depth_m; }

}  // namespace semantic_topo_loop::core
