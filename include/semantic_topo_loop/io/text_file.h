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
/// @return what the file holds, without the mark that UTF-8 may begin with
Result<std::string> read_text_file(const std::string& path);

/// What a file shall hold, given to a stream, so that it need not be in memory as a whole.
using WriteText = std::function<void(std::ostream&)>;
/// Path and text of files.
using FileTexts = std::vector<std::pair<std::string, WriteText>>;

/// Writes a temporary file beside `path`, or where links lead from there, which no other writer uses, brings it to the
/// disk and renames it, so that a reader, or a crash, never sees half a file. A failure leaves what was there before.
/// A device is written itself.
Status write_text_file(const std::string& path, const std::string& text);
Status write_file(const std::string& path, const WriteText& write);
/// The same for files that belong together: all are written before the first is put in place.
Status write_files(const FileTexts& files);

/// The same for a file that a library writes. @param write into the file of the name that it is given, there and empty
Status replace_file(const std::string& path, const std::function<Status(const std::string&)>& write);

/// Whether that is written itself, since nothing can take its place: standard output, a device, a pipe.
bool is_device(const std::string& path);

/// Sees whether a file of that name, or for "DIRECTORY/" one in it, can be written.
Status check_writable(const std::string& path);

/// The file that a name leads to by symbolic links, of which the last one need not lead to a file.
std::string behind_links(const std::string& path);

/// Whether two names lead to one file, by links too; of files that are not there, whether they would.
bool is_same_file(const std::string& a, const std::string& b);

/// Succeeds if the directory is there already.
Status make_directory(const std::string& path);

}  // namespace semantic_topo_loop::core
