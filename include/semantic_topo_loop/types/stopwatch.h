#pragma once

#include <chrono>

namespace semantic_topo_loop::core {

/// Wall time since construction. For reports only: no decision depends on it.
class Stopwatch {
 public:
  double elapsed_us() const {
    return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace semantic_topo_loop::core
