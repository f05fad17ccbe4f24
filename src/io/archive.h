#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "io/json_field.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

// Values as JSON and back, to the last bit. Enums need a Codec of their own, which knows their values. For a struct
// write once
//   template <class Visitor> void visit_members(T& value, Visitor& visit) { visit("name", value.name); ... }

template <class T>
Json to_archive(const T& value);
template <class T>
void from_archive(const JsonField& field, T* value);

/// What visit_members calls to write.
class ArchiveWriter {
 public:
  template <class T>
  void operator()(const char* name, const T& value) {
    json_[name] = to_archive(value);
  }
  template <class T>
  void later(const char* name, const T& value) {
    (*this)(name, value);
  }
  Json take() { return std::move(json_); }

 private:
  Json json_ = Json::object();
};

/// What visit_members calls to read; problems are noted where the field notes them.
class ArchiveReader {
 public:
  explicit ArchiveReader(const JsonField& field) : field_(field) {}
  template <class T>
  void operator()(const char* name, T& value) {
    from_archive(field_.member(name), &value);
  }
  /// Of a member that files of the same version may lack: it stays as it is.
  template <class T>
  void later(const char* name, T& value) {
    if (field_.has(name)) (*this)(name, value);
  }

 private:
  const JsonField& field_;
};

/// What visit_members calls to compare without writing, in a fraction of its time: two values of a type are written
/// alike if all their members have the same bytes.
class ArchiveBytes {
 public:
  template <class T>
  void operator()(const char*, const T& value) {
    add(value);
  }
  template <class T>
  void later(const char*, const T& value) {
    add(value);
  }
  template <class T>
  void add(const T& value) {
    if constexpr (std::is_arithmetic_v<T>) {
      bytes_.append(reinterpret_cast<const char*>(&value), sizeof(value));
    } else {
      visit_members(const_cast<T&>(value), *this);  // it changes nothing
    }
  }
  void add(const std::string& value) {
    add(value.size());
    bytes_ += value;
  }
  template <int rows, int columns>
  void add(const Eigen::Matrix<double, rows, columns>& value) {
    bytes_.append(reinterpret_cast<const char*>(value.data()), sizeof(double) * static_cast<std::size_t>(value.size()));
  }
  void add(const SE3& value) {
    add(value.t);
    add(Vec4(value.q.coeffs()));
  }
  template <class T>
  void add(const std::optional<T>& value) {
    add_if_any(value);
  }
  template <class T>
  void add(const std::shared_ptr<const T>& value) {
    add_if_any(value);
  }
  void clear() { bytes_.clear(); }
  const std::string& bytes() const { return bytes_; }

 private:
  template <class Holder>
  void add_if_any(const Holder& value) {
    add(static_cast<bool>(value));
    if (value) add(*value);
  }

  std::string bytes_;
};

namespace archive {

/// Whether a struct is written as an array of its members in their order: there are many of it, and the names would be
/// most of it.
template <class T>
inline constexpr bool is_row = false;

class RowWriter {
 public:
  template <class T>
  void operator()(const char*, const T& value) {
    json_.push_back(to_archive(value));
  }
  Json take() { return std::move(json_); }

 private:
  Json json_ = Json::array();
};

class RowReader {
 public:
  explicit RowReader(const JsonField& field) : field_(field), elements_(field.elements()) {}
  template <class T>
  void operator()(const char* name, T& value) {
    if (next_ == elements_.size()) return field_.reject(std::string("has no '") + name + "'");
    from_archive(elements_[next_++], &value);
  }

 private:
  const JsonField& field_;
  std::vector<JsonField> elements_;
  std::size_t next_ = 0;
};

template <class T>
struct Codec {
  static Json write(const T& value) {
    if constexpr (std::is_arithmetic_v<T>) {
      return value;
    } else {
      std::conditional_t<is_row<T>, RowWriter, ArchiveWriter> writer;
      visit_members(const_cast<T&>(value), writer);  // a writer changes nothing
      return writer.take();
    }
  }
  static void read(const JsonField& field, T* value) {
    if constexpr (std::is_same_v<T, bool>) {
      *value = field.flag();
    } else if constexpr (std::is_floating_point_v<T>) {
      *value = static_cast<T>(field.number());
    } else if constexpr (std::is_integral_v<T>) {
      const std::int64_t number = field.integer();
      *value = static_cast<T>(number);
      const bool is_lost = static_cast<std::int64_t>(*value) != number || (std::is_unsigned_v<T> && number < 0);
      if (is_lost) field.reject("is out of range");
    } else {
      std::conditional_t<is_row<T>, RowReader, ArchiveReader> reader(field);
      visit_members(*value, reader);
    }
  }
};

template <>
struct Codec<std::string> {
  static Json write(const std::string& value) { return value; }
  static void read(const JsonField& field, std::string* value) {
    if (!field.json().is_string()) field.reject("must be a text");
    *value = field.text();
  }
};

template <class Scalar, int rows, int columns>
struct Codec<Eigen::Matrix<Scalar, rows, columns>> {
  using Matrix = Eigen::Matrix<Scalar, rows, columns>;
  static Json write(const Matrix& value) {
    Json array = Json::array();
    for (Eigen::Index i = 0; i < value.size(); ++i) array.push_back(value(i));
    return array;
  }
  static void read(const JsonField& field, Matrix* value) {
    const auto numbers = field.numbers<rows * columns>();
    for (Eigen::Index i = 0; i < value->size(); ++i) (*value)(i) = static_cast<Scalar>(numbers(i));
  }
};

/// x, y, z, qx, qy, qz, qw.
template <>
struct Codec<SE3> {
  static Json write(const SE3& value) {
    Vec7 v;
    v << value.t, value.q.coeffs();
    return to_archive(v);
  }
  static void read(const JsonField& field, SE3* value) {
    const Vec7 v = field.numbers<7>();
    *value = {Quaternion(v(6), v(3), v(4), v(5)), v.head<3>()};
    if (field.is_fine() && !is_rotation(value->q)) field.reject("holds a quaternion that is no rotation");
  }
};

template <>
struct Codec<Box> {
  static Json write(const Box& value) { return to_archive(value.edges()); }
  static void read(const JsonField& field, Box* value) { *value = field.box(); }
};

/// null or the value.
template <class T>
struct Codec<std::optional<T>> {
  static Json write(const std::optional<T>& value) { return value ? to_archive(*value) : Json(); }
  static void read(const JsonField& field, std::optional<T>* value) {
    value->reset();
    if (!field.json().is_null()) from_archive(field, &value->emplace());
  }
};
template <class T>
struct Codec<std::shared_ptr<const T>> {
  static Json write(const std::shared_ptr<const T>& value) { return value ? to_archive(*value) : Json(); }
  static void read(const JsonField& field, std::shared_ptr<const T>* value) {
    std::optional<T> read;
    from_archive(field, &read);
    *value = read ? std::make_shared<const T>(*read) : nullptr;
  }
};

template <class T>
struct Codec<std::vector<T>> {
  static Json write(const std::vector<T>& values) {
    Json array = Json::array();
    for (const T& value : values) array.push_back(to_archive(value));
    return array;
  }
  static void read(const JsonField& field, std::vector<T>* values) {
    values->clear();
    for (const JsonField& element : field.elements()) from_archive(element, &values->emplace_back());
  }
};

template <class T, std::size_t n>
struct Codec<std::array<T, n>> {
  static Json write(const std::array<T, n>& values) { return values; }
  static void read(const JsonField& field, std::array<T, n>* values) {
    const std::vector<JsonField> elements = field.elements();
    if (elements.size() != n) return field.reject("must have " + std::to_string(n) + " elements");
    for (std::size_t i = 0; i < n; ++i) from_archive(elements[i], &(*values)[i]);
  }
};

/// [[key, value], ...]
template <class Key, class T>
struct Codec<std::map<Key, T>> {
  static Json write(const std::map<Key, T>& values) {
    Json array = Json::array();
    for (const auto& [key, value] : values) array.push_back({to_archive(key), to_archive(value)});
    return array;
  }
  static void read(const JsonField& field, std::map<Key, T>* values) {
    values->clear();
    for (const JsonField& element : field.elements()) {
      const std::vector<JsonField> pair = element.elements();
      if (pair.size() != 2) return element.reject("must be [key, value]");
      Key key{};
      from_archive(pair[0], &key);
      from_archive(pair[1], &(*values)[key]);
    }
  }
};

}  // namespace archive

template <class T>
Json to_archive(const T& value) {
  return archive::Codec<T>::write(value);
}
template <class T>
void from_archive(const JsonField& field, T* value) {
  archive::Codec<T>::read(field, value);
}

/// @return discarded if that is no CBOR, or nests deeper than anything that is packed here
Json from_cbor(const std::uint8_t* begin, const std::uint8_t* end);
/// @param bytes a string or a vector of them
template <class Bytes>
Json from_cbor(const Bytes& bytes) {
  const auto* begin = reinterpret_cast<const std::uint8_t*>(bytes.data());
  return from_cbor(begin, begin + bytes.size());
}

}  // namespace semantic_topo_loop::core
