#include "semantic_topo_loop/io/point_cloud_file.h"

#include <boost/algorithm/string/predicate.hpp>
#include <cstdint>
#include <cstring>
#include <ostream>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

using boost::algorithm::ends_with;

std::string ply_header(std::size_t count, bool has_objects) {
  return "ply\nformat binary_little_endian 1.0\ncomment metres, map frame; intensity 1: sparse, 0: semi-dense\n"
         "element vertex " +
         std::to_string(count) + "\nproperty float x\nproperty float y\nproperty float z\nproperty float intensity\n" +
         (has_objects ? "property int object\n" : "") + "end_header\n";
}

std::string pcd_header(std::size_t count, bool has_objects) {
  const std::string n = std::to_string(count);
  const std::string fields = has_objects
                                 ? "FIELDS x y z intensity object\nSIZE 4 4 4 4 4\nTYPE F F F F I\nCOUNT 1 1 1 1 1"
                                 : "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1";
  return "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n" + fields + "\nWIDTH " + n +
         "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + n + "\nDATA binary\n";
}

/// Little-endian, whatever the machine.
void append(std::uint32_t bits, std::string* bytes) {
  for (int shift = 0; shift < 32; shift += 8) bytes->push_back(static_cast<char>((bits >> shift) & 0xff));
}
void append(float value, std::string* bytes) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  append(bits, bytes);
}

/// @param object of the first point, where there are any
void write(const std::vector<Eigen::Vector3f>& points, float intensity, const std::int64_t* object,
           std::ostream& file) {
  std::string bytes;
  for (const Eigen::Vector3f& p : points) {
    bytes.clear();
    for (const float value : {p.x(), p.y(), p.z(), intensity}) append(value, &bytes);
    if (object != nullptr) append(static_cast<std::uint32_t>(*object++), &bytes);
    file << bytes;
  }
}

}  // namespace

bool is_point_cloud_path(const std::string& path) { return ends_with(path, ".ply") || ends_with(path, ".pcd"); }

Status write_point_cloud(const std::string& path, const MapPoints& points, const std::vector<std::int64_t>& objects) {
  if (!is_point_cloud_path(path)) return Error{"'" + path + "' ends neither in .ply nor in .pcd"};
  const std::size_t count = points.sparse.size() + points.semi_dense.size();
  const bool has_objects = !objects.empty();
  const auto write_points = [&](std::ostream& file) {
    file << (ends_with(path, ".ply") ? ply_header(count, has_objects) : pcd_header(count, has_objects));
    write(points.sparse, 1.0F, has_objects ? objects.data() : nullptr, file);
    write(points.semi_dense, 0.0F, has_objects ? objects.data() + points.sparse.size() : nullptr, file);
  };
  return write_file(path, write_points);
}

}  // namespace semantic_topo_loop::core
