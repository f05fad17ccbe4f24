#include "semantic_topo_loop/io/text_file.h"

#include <filesystem>
#include <fstream>
#include <sstream>

namespace semantic_topo_loop::core {

Result<std::string> read_text_file(const std::string& path) {
  std::error_code code;
  if (std::filesystem::is_directory(path, code)) return Error{path + ": is a directory, not a file"};
  std::ifstream file(path, std::ios::binary);
  if (!file) return Error{path + ": cannot open the file"};
  std::ostringstream text;
  text << file.rdbuf();
  if (file.bad()) return Error{path + ": cannot read the file"};
  return text.str();
}

Status write_text_file(const std::string& path, const std::string& text) {
  return write_file(path, [&text](std::ostream& file) { file << text; });
}

Status write_file(const std::string& path, const std::function<void(std::ostream&)>& write) {
  const std::string temporary = path + ".tmp";
  std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
  write(file);
  file.close();
  if (!file) return Error{temporary + ": cannot write the file"};
  std::error_code code;
  std::filesystem::rename(temporary, path, code);
  if (code) return Error{path + ": cannot rename the temporary file: " + code.message()};
  return {};
}

Status make_directory(const std::string& path) {
  std::error_code code;
  std::filesystem::create_directories(path, code);
  if (!std::filesystem::is_directory(path)) return Error{path + ": cannot make the directory"};
  return {};
}

}  // namespace semantic_topo_loop::core
