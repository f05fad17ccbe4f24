#include "io/compression.h"

#include <zlib.h>

#include <array>

namespace semantic_topo_loop::core {
namespace {

Bytef* to_zlib(const char* bytes) { return reinterpret_cast<Bytef*>(const_cast<char*>(bytes)); }

}  // namespace

std::string compressed(const std::string& bytes) {
  auto size = ::compressBound(static_cast<uLong>(bytes.size()));
  std::string result(size, '\0');
  ::compress2(to_zlib(result.data()), &size, to_zlib(bytes.data()), static_cast<uLong>(bytes.size()), Z_BEST_SPEED);
  result.resize(size);
  return result;
}

bool is_compressed(const std::string& bytes) {
  constexpr char kDeflate = 0x78;
  return !bytes.empty() && bytes.front() == kDeflate;
}

std::string inflated(const std::string& bytes) {
  z_stream stream{};
  if (::inflateInit(&stream) != Z_OK) return {};
  stream.next_in = to_zlib(bytes.data());
  stream.avail_in = static_cast<uInt>(bytes.size());
  std::string result;
  std::array<char, 1 << 16> part{};
  int state = Z_OK;
  while (state == Z_OK) {
    stream.next_out = to_zlib(part.data());
    stream.avail_out = static_cast<uInt>(part.size());
    state = ::inflate(&stream, Z_NO_FLUSH);  // Z_BUF_ERROR if it ends early
    result.append(part.data(), part.size() - stream.avail_out);
  }
  ::inflateEnd(&stream);
  return state == Z_STREAM_END ? result : std::string();
}

}  // namespace semantic_topo_loop::core
