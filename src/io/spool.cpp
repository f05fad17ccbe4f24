#include "io/spool.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <system_error>

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kEndMax = 1 << 18;  ///< bytes: short runs need no file

std::FILE* open_nameless(const std::string& directory) {
  std::string path = directory + "/.rows_XXXXXX";
  const int descriptor = ::mkstemp(path.data());
  if (descriptor < 0) return nullptr;
  ::unlink(path.c_str());
  return ::fdopen(descriptor, "w+b");
}

}  // namespace

void Spool::add(std::string_view bytes, const std::string& directory) {
  end_ += bytes;
  if (end_.size() >= kEndMax) write_end(directory);
}

Status Spool::read(std::size_t row_size, const std::function<void(std::string_view)>& take) const {
  std::string part(kEndMax - kEndMax % row_size, '\0');
  std::size_t held = 0;  // bytes of a row of which the rest has not been read
  for (off_t at = 0; file_;) {
    const ssize_t length = ::pread(::fileno(file_.get()), part.data() + held, part.size() - held, at);
    if (length < 0 && errno == EINTR) continue;
    if (length < 0) return Error{"the rows of the run cannot be read: " + std::system_category().message(errno)};
    if (length == 0) break;
    at += length;
    held += static_cast<std::size_t>(length);
    const std::size_t whole = held - held % row_size;
    take(std::string_view(part.data(), whole));
    held -= whole;
    std::copy_n(part.data() + whole, held, part.data());
  }
  std::string_view end = end_;
  if (held > 0) {  // the disk was full within a row
    const std::size_t missing = row_size - held;
    if (end.size() < missing) return Error{"the rows of the run cannot be read: they end within one"};
    take(part.substr(0, held).append(end.substr(0, missing)));
    end.remove_prefix(missing);
  }
  take(end);
  return {};
}

/// What a full disk does not take stays, and is written with what comes next.
void Spool::write_end(const std::string& directory) {
  if (!file_) file_.reset(open_nameless(directory));
  std::size_t written = 0;
  while (file_ && written < end_.size()) {
    const ssize_t length = ::pwrite(::fileno(file_.get()), end_.data() + written, end_.size() - written, length_);
    if (length < 0 && errno == EINTR) continue;
    if (length <= 0) break;
    written += static_cast<std::size_t>(length);
    length_ += length;
  }
  end_.erase(0, written);
}

}  // namespace semantic_topo_loop::core
