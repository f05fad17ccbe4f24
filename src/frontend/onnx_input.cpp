#include "frontend/onnx_input.h"

#include <cstdint>
#include <fstream>
#include <iterator>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

namespace semantic_topo_loop::core {
namespace {

/// A field of a protobuf message (https://protobuf.dev/programming-guides/encoding), as far as ONNX has them.
struct Field {
  std::uint64_t number = 0;
  std::uint64_t value = 0;  ///< of an integer
  std::string_view bytes;   ///< of a message or a string
};

std::optional<std::uint64_t> take_varint(std::string_view* rest) {
  std::uint64_t value = 0;
  for (unsigned shift = 0; shift < 64 && !rest->empty(); shift += 7) {
    const auto byte = static_cast<std::uint8_t>(rest->front());
    rest->remove_prefix(1);
    value |= std::uint64_t{byte & 0x7fU} << shift;
    if ((byte & 0x80U) == 0) return value;
  }
  return std::nullopt;
}

std::optional<Field> take_field(std::string_view* rest) {
  const std::optional<std::uint64_t> key = take_varint(rest);
  if (!key) return std::nullopt;
  Field field;
  field.number = *key >> 3U;
  std::uint64_t size = 0;
  switch (*key & 7U) {
    case 0: {
      const std::optional<std::uint64_t> value = take_varint(rest);
      if (!value) return std::nullopt;
      field.value = *value;
      return field;
    }
    case 1:
      size = 8;
      break;
    case 2: {
      const std::optional<std::uint64_t> length = take_varint(rest);
      if (!length) return std::nullopt;
      size = *length;
      break;
    }
    case 5:
      size = 4;
      break;
    default:
      return std::nullopt;
  }
  if (size > rest->size()) return std::nullopt;
  field.bytes = rest->substr(0, size);
  rest->remove_prefix(size);
  return field;
}

std::vector<Field> fields(std::string_view message, std::uint64_t number) {
  std::vector<Field> found;
  while (const std::optional<Field> field = take_field(&message)) {
    if (field->number == number) found.push_back(*field);
  }
  return found;
}

/// What lies in messages in each other, by their fields' numbers.
std::vector<Field> fields(std::string_view message, const std::vector<std::uint64_t>& numbers) {
  std::vector<Field> found{{0, 0, message}};
  for (const std::uint64_t number : numbers) {
    std::vector<Field> inside;
    for (const Field& outer : found) {
      const std::vector<Field> inner = fields(outer.bytes, number);
      inside.insert(inside.end(), inner.begin(), inner.end());
    }
    found = std::move(inside);
  }
  return found;
}

}  // namespace

DeclaredInput declared_input(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string model{std::istreambuf_iterator<char>(file), {}};
  // ModelProto.graph.input.type.tensor_type.shape; weights may be listed as inputs too.
  for (const Field& shape : fields(model, {7, 11, 2, 1, 2})) {
    std::vector<std::uint64_t> sizes;
    for (const Field& dimension : fields(shape.bytes, 1)) {
      const std::vector<Field> size = fields(dimension.bytes, 1);  // none: a name, whose value is left open
      sizes.push_back(size.empty() ? 0 : size.front().value);
    }
    constexpr std::uint64_t kColors = 3, kCoarsestCell_px = 32, kLargest_px = 8192;
    const auto is_side = [](std::uint64_t px) { return px > 0 && px % kCoarsestCell_px == 0 && px <= kLargest_px; };
    if (sizes.size() != 4 || sizes[1] != kColors || !is_side(sizes[2]) || !is_side(sizes[3])) continue;
    return {static_cast<int>(sizes[3]), static_cast<int>(sizes[2])};
  }
  return {};
}

}  // namespace semantic_topo_loop::core
