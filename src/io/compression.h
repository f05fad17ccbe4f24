#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// Bytes in zlib's format (RFC 1950), as small as a quick pass makes them.
std::string compressed(const std::string& bytes);
/// Whether the bytes begin as `compressed` has them. CBOR of objects and arrays never does.
bool is_compressed(const std::string& bytes);
/// @return what was compressed; nothing if the bytes are damaged
std::string inflated(const std::string& bytes);

}  // namespace semantic_topo_loop::core
