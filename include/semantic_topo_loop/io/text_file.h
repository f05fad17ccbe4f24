#pragma once

#include <functional>
#include <ostream>
#include <string>

#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {

/// Every error names the path and the cause.
Result<std::string> read_text_file(const std::string& path);

/// Writes a temporary file beside `path` and renames it, so that a reader never sees half a file.
Status write_text_file(const std::string& path, const std::string& text);
/// The same with what `write` gives to the stream, for files that are better not held in memory as a whole.
Status write_file(const std::string& path, const std::function<void(std::ostream&)>& write);

/// Succeeds if the directory is there already.
Status make_directory(const std::string& path);

}  // namespace semantic_topo_loop::core
