#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace semantic_topo_loop::core::testing {

/// A number as protobuf writes it (https://protobuf.dev/programming-guides/encoding).
inline std::string varint(std::uint64_t value) {
  std::string bytes;
  for (; value > 0x7fU; value >>= 7U) bytes += static_cast<char>((value & 0x7fU) | 0x80U);
  return bytes + static_cast<char>(value);
}

/// A field of a protobuf message: a text, an array or another message.
inline std::string field(unsigned number, const std::string& bytes) {
  return varint(number << 3U | 2U) + varint(bytes.size()) + bytes;
}
inline std::string field(unsigned number, int value) {
  return varint(number << 3U) + varint(static_cast<std::uint64_t>(value));
}

/// Name, type (float) and shape of a value; 0 is a size that is left open.
inline std::string onnx_value(const std::string& name, const std::vector<int>& sizes) {
  std::string shape;
  for (const int size : sizes) shape += field(1, size > 0 ? field(1, size) : field(2, "any"));
  return field(1, name) + field(2, field(1, field(1, 1) + field(2, shape)));
}

inline std::string onnx_input(const std::vector<int>& sizes) { return field(11, onnx_value("images", sizes)); }

inline std::string onnx_attribute(const std::string& name, int value) {
  return field(5, field(1, name) + field(3, value) + field(20, 2));
}
inline std::string onnx_attribute(const std::string& name, const std::vector<int>& values) {
  std::string ints;
  for (const int value : values) ints += field(8, value);
  return field(5, field(1, name) + ints + field(20, 7));
}

/// An ONNX model that is put together operation by operation, in the subset of opset 11 that OpenCV 4.2 runs.
class OnnxGraph {
 public:
  /// @return the name of the output
  std::string add(const std::string& operation, const std::vector<std::string>& inputs,
                  const std::string& attributes = {}) {
    return add(operation, inputs, attributes, 1).front();
  }

  /// Two parts, whose sizes are an input, as since opset 13.
  std::vector<std::string> split(const std::string& input, const std::string& sizes, const std::string& axis) {
    opset_ = 13;
    return add("Split", {input, sizes}, axis, 2);
  }

  /// A constant, row-major. @tparam Value float or std::int64_t
  template <class Value>
  std::string constant(const std::vector<int>& sizes, const std::vector<Value>& values) {
    std::string tensor, raw(values.size() * sizeof(Value), '\0');
    for (const int size : sizes) tensor += field(1, size);
    std::memcpy(raw.data(), values.data(), raw.size());
    constexpr int kFloat = 1, kInt64 = 7;
    const std::string name = new_name();
    graph_ +=
        field(5, tensor + field(2, sizeof(Value) == sizeof(float) ? kFloat : kInt64) + field(8, name) + field(9, raw));
    return name;
  }

  std::string reshape(const std::string& input, const std::vector<std::int64_t>& sizes) {
    return add("Reshape", {input, constant({static_cast<int>(sizes.size())}, sizes)});
  }

  /// A 1 x 1 convolution. @param rows of each channel that comes out the weights of those that go in, and the bias
  std::string linear(const std::string& input, const std::vector<std::vector<double>>& rows) {
    std::vector<float> weights, biases;
    for (const std::vector<double>& row : rows) {
      for (const double weight : row) weights.push_back(static_cast<float>(weight));
      biases.push_back(weights.back());
      weights.pop_back();
    }
    const int channels = static_cast<int>(rows.size()), inputs = static_cast<int>(rows.front().size()) - 1;
    return add("Conv", {input, constant({channels, inputs, 1, 1}, weights), constant({channels}, biases)},
               onnx_attribute("kernel_shape", {1, 1}));
  }

  /// The file's bytes. The input is called `images`. @param names of the classes, where the file tells
  std::string model(const std::vector<int>& input_sizes, const std::string& output,
                    const std::vector<int>& output_sizes, const std::string& names) const {
    const std::string graph =
        graph_ + field(2, "graph") + onnx_input(input_sizes) + field(12, onnx_value(output, output_sizes));
    constexpr int kIrVersion = 7;
    return field(1, kIrVersion) + field(7, graph) + field(8, field(2, opset_)) +
           (names.empty() ? "" : field(14, field(1, "names") + field(2, names)));
  }

 private:
  std::vector<std::string> add(const std::string& operation, const std::vector<std::string>& inputs,
                               const std::string& attributes, int output_count) {
    std::string node;
    for (const std::string& input : inputs) node += field(1, input);
    std::vector<std::string> outputs;
    for (int i = 0; i < output_count; ++i) {
      outputs.push_back(new_name());
      node += field(2, outputs.back());
    }
    graph_ += field(1, node + field(3, outputs.front()) + field(4, operation) + attributes);
    return outputs;
  }

  std::string new_name() { return "t" + std::to_string(names_++); }

  std::string graph_;  ///< fields of GraphProto
  int names_ = 0, opset_ = 11;
};

}  // namespace semantic_topo_loop::core::testing
