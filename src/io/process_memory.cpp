#include "io/process_memory.h"

#include <sys/resource.h>
#include <unistd.h>

#include <cstdio>

namespace semantic_topo_loop::core {

Memory memory_of_process() {
  Memory memory;
  constexpr double kMiB = 1 << 20, kKiB = 1 << 10;
  rusage usage{};
  if (::getrusage(RUSAGE_SELF, &usage) == 0) memory.peak_mb = static_cast<double>(usage.ru_maxrss) * kKiB / kMiB;
  long size = 0, resident = 0;  // pages
  if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &size, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  memory.resident_mb = static_cast<double>(resident) * static_cast<double>(::sysconf(_SC_PAGESIZE)) / kMiB;
  return memory;
}

}  // namespace semantic_topo_loop::core
