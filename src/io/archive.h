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

#include "io/cbor.h"
#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

// Values as CBOR and back, to the last bit. Enums need a Codec of their own, which knows their values. For a struct
// write once
//   template <class Visitor> void visit_members(T& value, Visitor& visit) { visit("name", value.name); ... }

template <class T>
void to_archive(const T& value, CborWriter* writer);
template <class T>
void from_archive(CborReader* reader, T* value);

/// What visit_members calls to write.
class ArchiveWriter {
 public:
  /// @param is_row values alone, without their names
  ArchiveWriter(CborWriter* writer, bool is_row) : writer_(*writer), is_row_(is_row) {}
  template <class T>
  void operator()(const char* name, const T& value) {
    if (!is_row_) writer_.text(name);
    to_archive(value, &writer_);
  }
  template <class T>
  void later(const char* name, const T& value) {
    (*this)(name, value);
  }

 private:
  CborWriter& writer_;
  const bool is_row_;
};

/// What visit_members calls to count.
class MemberCount {
 public:
  template <class T>
  void operator()(const char*, const T&) {
    ++count_;
  }
  template <class T>
  void later(const char*, const T&) {
    ++count_;
  }
  std::size_t count() const { return count_; }

 private:
  std::size_t count_ = 0;
};

/// What visit_members calls to read.
class ArchiveReader {
 public:
  explicit ArchiveReader(CborReader* reader) : reader_(reader), members_(reader) {}
  template <class T>
  void operator()(const char* name, T& value) {
    members_.member(name, [&] { from_archive(reader_, &value); });
  }
  /// Of a member that files of the same version may lack: it stays as it is.
  template <class T>
  void later(const char* name, T& value) {
    if (members_.has(name)) (*this)(name, value);
  }

 private:
  CborReader* reader_;
  CborReader::Members members_;
};

namespace archive {

/// Whether a struct is written as an array of its members in their order: there are many of it, and the names would be
/// most of it.
template <class T>
inline constexpr bool is_row = false;

template <class T>
void write_elements(const T* values, std::size_t size, CborWriter* writer) {
  writer->array(size);
  for (std::size_t i = 0; i < size; ++i) to_archive(values[i], writer);
}

/// Of an array that has as many.
template <class T>
void read_elements(CborReader* reader, std::size_t size, T* values) {
  const std::uint8_t* const at = reader->at();
  std::size_t next = 0;
  T beyond{};
  const std::size_t found = reader->elements([&] { from_archive(reader, next < size ? &values[next++] : &beyond); });
  if (found != size) reader->reject(at, "must have " + std::to_string(size) + " elements");
}

class RowReader {
 public:
  explicit RowReader(CborReader* reader) : reader_(reader), row_(reader) {}
  template <class T>
  void operator()(const char* name, T& value) {
    row_.member(name, [&] { from_archive(reader_, &value); });
  }

 private:
  CborReader* reader_;
  CborReader::Row row_;
};

template <class T>
void write_members(const T& value, CborWriter* writer) {
  T& visited = const_cast<T&>(value);  // neither changes anything
  MemberCount members;
  visit_members(visited, members);
  is_row<T> ? writer->array(members.count()) : writer->map(members.count());
  ArchiveWriter visitor(writer, is_row<T>);
  visit_members(visited, visitor);
}
template <class T>
void read_members(CborReader* reader, T* value) {
  std::conditional_t<is_row<T>, RowReader, ArchiveReader> visitor(reader);
  visit_members(*value, visitor);
}

template <class T>
struct Codec {
  static void write(const T& value, CborWriter* writer) {
    if constexpr (std::is_same_v<T, bool>) {
      writer->flag(value);
    } else if constexpr (std::is_floating_point_v<T>) {
      writer->number(static_cast<double>(value));
    } else if constexpr (std::is_integral_v<T>) {
      writer->integer(static_cast<std::int64_t>(value));
    } else {
      write_members(value, writer);
    }
  }
  static void read(CborReader* reader, T* value) {
    if constexpr (std::is_same_v<T, bool>) {
      *value = reader->flag();
    } else if constexpr (std::is_floating_point_v<T>) {
      *value = static_cast<T>(reader->number());
    } else if constexpr (std::is_integral_v<T>) {
      const std::uint8_t* const at = reader->at();
      const std::int64_t number = reader->integer();
      *value = static_cast<T>(number);
      const bool is_lost = static_cast<std::int64_t>(*value) != number || (std::is_unsigned_v<T> && number < 0);
      if (is_lost) reader->reject(at, "is out of range");
    } else {
      read_members(reader, value);
    }
  }
};

template <>
struct Codec<std::string> {
  static void write(const std::string& value, CborWriter* writer) { writer->text(value); }
  static void read(CborReader* reader, std::string* value) { *value = reader->text(); }
};

template <class Scalar, int rows, int columns>
struct Codec<Eigen::Matrix<Scalar, rows, columns>> {
  using Matrix = Eigen::Matrix<Scalar, rows, columns>;
  static void write(const Matrix& value, CborWriter* writer) { write_elements(value.data(), rows * columns, writer); }
  static void read(CborReader* reader, Matrix* value) { read_elements(reader, rows * columns, value->data()); }
};

/// x, y, z, qx, qy, qz, qw.
template <>
struct Codec<SE3> {
  static void write(const SE3& value, CborWriter* writer) {
    Vec7 v;
    v << value.t, value.q.coeffs();
    to_archive(v, writer);
  }
  static void read(CborReader* reader, SE3* value) {
    const std::uint8_t* const at = reader->at();
    Vec7 v = Vec7::Zero();
    from_archive(reader, &v);
    *value = {Quaternion(v(6), v(3), v(4), v(5)), v.head<3>()};
    if (!is_rotation(value->q)) reader->reject(at, "holds a quaternion that is no rotation");
  }
};

template <>
struct Codec<Box> {
  static void write(const Box& value, CborWriter* writer) { to_archive(value.edges(), writer); }
  static void read(CborReader* reader, Box* value) {
    const std::uint8_t* const at = reader->at();
    Vec4 v = Vec4::Zero();
    from_archive(reader, &v);
    *value = {v(0), v(1), v(2), v(3)};
    if (!value->is_valid()) reader->reject(at, "is no box [x1, y1, x2, y2]");
  }
};

/// null or the value.
template <class T>
struct Codec<std::optional<T>> {
  static void write(const std::optional<T>& value, CborWriter* writer) {
    value ? to_archive(*value, writer) : writer->null();
  }
  static void read(CborReader* reader, std::optional<T>* value) {
    value->reset();
    if (!reader->null()) from_archive(reader, &value->emplace());
  }
};
template <class T>
struct Codec<std::shared_ptr<const T>> {
  static void write(const std::shared_ptr<const T>& value, CborWriter* writer) {
    value ? to_archive(*value, writer) : writer->null();
  }
  static void read(CborReader* reader, std::shared_ptr<const T>* value) {
    value->reset();
    if (reader->null()) return;
    auto read = std::make_shared<T>();
    from_archive(reader, read.get());
    *value = std::move(read);
  }
};

template <class T>
struct Codec<std::vector<T>> {
  static void write(const std::vector<T>& values, CborWriter* writer) {
    write_elements(values.data(), values.size(), writer);
  }
  static void read(CborReader* reader, std::vector<T>* values) {
    values->clear();
    reader->elements([&] { from_archive(reader, &values->emplace_back()); });
  }
};

template <class T, std::size_t n>
struct Codec<std::array<T, n>> {
  static void write(const std::array<T, n>& values, CborWriter* writer) { write_elements(values.data(), n, writer); }
  static void read(CborReader* reader, std::array<T, n>* values) { read_elements(reader, n, values->data()); }
};

/// [[key, value], ...]
template <class Key, class T>
struct Codec<std::map<Key, T>> {
  static void write(const std::map<Key, T>& values, CborWriter* writer) {
    writer->array(values.size());
    for (const auto& [key, value] : values) {
      writer->array(2);
      to_archive(key, writer);
      to_archive(value, writer);
    }
  }
  static void read(CborReader* reader, std::map<Key, T>* values) {
    values->clear();
    reader->elements([&] {
      Key key{};
      T value{};
      RowReader pair(reader);
      pair("key", key);
      pair("value", value);
      values->insert_or_assign(std::move(key), std::move(value));
    });
  }
};

}  // namespace archive

template <class T>
void to_archive(const T& value, CborWriter* writer) {
  archive::Codec<T>::write(value, writer);
}
template <class T>
void from_archive(CborReader* reader, T* value) {
  archive::Codec<T>::read(reader, value);
}

}  // namespace semantic_topo_loop::core
