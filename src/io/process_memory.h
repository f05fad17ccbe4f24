#pragma once

namespace semantic_topo_loop::core {

/// Memory of this process, MiB.
struct Memory {
  double resident_mb = 0.0, peak_mb = 0.0;
};

Memory memory_of_process();

}  // namespace semantic_topo_loop::core
