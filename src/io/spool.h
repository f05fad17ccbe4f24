#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Bytes that grow for as long as a run, on the disk but for their end: in a file without a name, which goes with the
/// process.
class Spool {
 public:
  /// @param directory of the file, which is there
  void add(std::string_view bytes, const std::string& directory);

  /// Calls take(bytes) in order, part by part, each of whole rows of `row_size` bytes.
  /// @return an error if the disk does not give the bytes back
  Status read(std::size_t row_size, const std::function<void(std::string_view)>& take) const;

 private:
  void write_end(const std::string& directory);

  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  std::unique_ptr<std::FILE, Close> file_;
  off_t length_ = 0;  ///< of the file
  std::string end_;   ///< behind what the file holds
};

}  // namespace semantic_topo_loop::core
