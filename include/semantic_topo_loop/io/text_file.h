#pragma once

#include <functional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {

/// Every error names the path and the cause.
Result<std::string> read_text_file(const std::string& path);

/// What a file shall hold, given to a stream, so that it need not be in memory as a whole.
using WriteText = std::function<void(std::ostream&)>;
/// Path and text of files.
using FileTexts = std::vector<std::pair<std::string, WriteText>>;

/// Writes a temporary file beside `path`, which no other writer uses and no link leads elsewhere, brings it to the disk
/// and renames it, so that a reader, or a crash, never sees half a file. A failure leaves what was there before.
Status write_text_file(const std::string& path, const std::string& text);
Status write_file(const std::string& path, const WriteText& write);
/// The same for files that belong together: all are written before the first is put in place.
Status write_files(const FileTexts& files);

/// The same for a file that a library writes. @param write into the file of the name that it is given, there and empty
Status replace_file(const std::string& path, const std::function<Status(const std::string&)>& write);

/// Whether two names lead to one file, by links too; of files that are not there, whether they would.
bool is_same_file(const std::string& a, const std::string& b);

/// Succeeds if the directory is there already.
Status make_directory(const std::string& path);

}  // namespace semantic_topo_loop::core
