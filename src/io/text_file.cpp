#include "semantic_topo_loop/io/text_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <deque>
#include <ext/stdio_filebuf.h>
#include <filesystem>
#include <fstream>
#include <locale>
#include <vector>

namespace semantic_topo_loop::core {
namespace {

constexpr char kStandardOutput[] = "/dev/stdout";
constexpr char kByteOrderMark[] = "\xEF\xBB\xBF";  ///< that editors of Windows begin UTF-8 with

/// A file that is written beside the one whose place it shall take, and removed unless it takes it. A device is written
/// itself.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::string path)
      : path_(std::move(path)), is_device_(is_device(path_)), target_(is_device_ ? path_ : behind_links(path_)) {}
  ~TemporaryFile() {
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  Status write(const WriteText& write) {
    const int descriptor = create();
    if (descriptor < 0) return failure("cannot write the file");
    __gnu_cxx::stdio_filebuf<char> buffer(descriptor, std::ios::out | std::ios::binary);
    std::ostream stream(&buffer);
    stream.imbue(std::locale::classic());
    errno = 0;
    write(stream);
    const bool is_written = static_cast<bool>(stream.flush()) && (is_device_ || ::fsync(descriptor) == 0);
    return is_written && buffer.close() != nullptr ? Status() : failure("cannot write the file");
  }

  /// @param write writes the file of the name it is given, which is there and empty
  Status write(const std::function<Status(const std::string&)>& write) {
    if (is_device_) return write(target_);
    const int descriptor = create();
    if (descriptor < 0) return failure("cannot write the file");
    const Status written = write(temporary_);
    errno = 0;
    const bool is_on_disk = ::fsync(descriptor) == 0;
    ::close(descriptor);
    return is_on_disk || !written ? written : failure("cannot write the file");
  }

  Status put_in_place() {
    if (is_device_) return {};
    if (std::rename(temporary_.c_str(), target_.c_str()) != 0) return failure("cannot rename the temporary file");
    temporary_.clear();
    return {};
  }

 private:
  /// @return descriptor of a new file, or of the device, < 0 if there cannot be one
  int create() {
    if (path_ == kStandardOutput) {
      std::fflush(stdout);
      return ::dup(STDOUT_FILENO);
    }
    if (is_device_) return ::open(target_.c_str(), O_WRONLY | O_CLOEXEC);
    static std::atomic<std::uint64_t> next{0};
    int descriptor = -1;
    do {  // O_EXCL refuses what is there, links included; then the next number
      temporary_ = target_ + "." + std::to_string(::getpid()) + "-" + std::to_string(next++) + ".tmp";
      constexpr mode_t kMode = 0666;  // less the umask, as std::ofstream makes files
      descriptor = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, kMode);
    } while (descriptor < 0 && errno == EEXIST);
    if (descriptor < 0) temporary_.clear();
    return descriptor;
  }

  Error failure(const std::string& what) const {
    return Error{path_ + ": " + what + (errno == 0 ? "" : ": " + std::system_category().message(errno))};
  }

  const std::string path_;
  const bool is_device_;
  const std::string target_;
  std::string temporary_;
};

}  // namespace

Result<std::string> read_text_file(const std::string& path) {
  std::error_code code;
  if (std::filesystem::is_directory(path, code)) return Error{path + ": is a directory, not a file"};
  std::ifstream file(path, std::ios::binary);
  if (!file) return Error{path + ": cannot open the file"};
  std::string text;
  std::vector<char> part(1 << 16);
  do {
    file.read(part.data(), static_cast<std::streamsize>(part.size()));
    text.append(part.data(), static_cast<std::size_t>(file.gcount()));
  } while (file);
  if (file.bad()) return Error{path + ": cannot be read to its end"};
  if (text.rfind(kByteOrderMark, 0) == 0) text.erase(0, std::strlen(kByteOrderMark));
  return text;
}

Status write_text_file(const std::string& path, const std::string& text) {
  return write_file(path, [&text](std::ostream& file) { file << text; });
}

Status write_file(const std::string& path, const WriteText& write) { return write_files({{path, write}}); }

Status write_files(const FileTexts& files) {
  std::deque<TemporaryFile> written;
  for (const auto& [path, write] : files) {
    if (const Status status = written.emplace_back(path).write(write); !status) return status;
  }
  for (TemporaryFile& file : written) {
    if (const Status status = file.put_in_place(); !status) return status;
  }
  return {};
}

Status replace_file(const std::string& path, const std::function<Status(const std::string&)>& write) {
  TemporaryFile file(path);
  const Status written = file.write(write);
  return written ? file.put_in_place() : written;
}

bool is_device(const std::string& path) {
  std::error_code missing;
  return path == kStandardOutput || std::filesystem::is_other(path, missing);
}

Status check_writable(const std::string& path) {
  if (is_device(path)) return {};
  std::error_code missing;
  const bool is_inside = !path.empty() && path.back() == '/';
  if (!is_inside && std::filesystem::is_directory(path, missing)) return Error{path + ": is a directory, not a file"};
  const std::string probe = behind_links(path) + ".writable";
  if (const Status written = write_text_file(probe, ""); !written) {
    return Error{path + written.message().substr(probe.size())};
  }
  std::error_code ignored;
  std::filesystem::remove(probe, ignored);
  return {};
}

std::string behind_links(const std::string& path) {
  constexpr int kLinksMax = 40;  // as the kernel
  std::filesystem::path target = path;
  std::error_code code;
  for (int links = 0; links < kLinksMax; ++links) {
    if (!std::filesystem::is_symlink(std::filesystem::symlink_status(target, code))) return target;
    target = target.parent_path() / std::filesystem::read_symlink(target, code);
  }
  return path;
}

bool is_same_file(const std::string& a, const std::string& b) {
  std::error_code missing;
  if (std::filesystem::equivalent(a, b, missing)) return true;
  const auto place = [](const std::string& path) {
    std::error_code code;
    const auto full = std::filesystem::weakly_canonical(std::filesystem::absolute(path, code), code);
    return code ? std::filesystem::path() : full;
  };
  const std::filesystem::path place_a = place(a);
  return !place_a.empty() && place_a == place(b);
}

Status make_directory(const std::string& path) {
  std::error_code code;
  std::filesystem::create_directories(path, code);
  std::error_code missing;
  if (std::filesystem::is_directory(path, missing)) return {};
  return Error{path + ": cannot make the directory" + (code ? ": " + code.message() : "")};
}

}  // namespace semantic_topo_loop::core
