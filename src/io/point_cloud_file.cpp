#include "semantic_topo_loop/io/point_cloud_file.h"

#include <boost/algorithm/string/predicate.hpp>
#include <cstdint>
#include <cstring>
#include <ostream>

#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

using boost::algorithm::ends_with;

std::string ply_header(std::size_t count) {
  return "ply\nformat binary_little_endian 1.0\ncomment metres, map frame; intensity 1: sparse, 0: semi-dense\n"
         "element vertex " +
         std::to_string(count) +
         "\nproperty float x\nproperty float y\nproperty float z\nproperty float intensity\nend_header\n";
}

std::string pcd_header(std::size_t count) {
  const std::string n = std::to_string(count);
  return "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\n"
         "TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH " +
         n + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + n + "\nDATA binary\n";
}

/// Little-endian, whatever the machine.
void append(float value, std::string* bytes) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  for (int shift = 0; shift < 32; shift += 8) bytes->push_back(static_cast<char>((bits >> shift) & 0xff));
}

void write(const std::vector<Eigen::Vector3f>& points, float intensity, std::ostream& file) {
  std::string bytes;
  for (const Eigen::Vector3f& p : points) {
    bytes.clear();
    for (const float value : {p.x(), p.y(), p.z(), intensity}) append(value, &bytes);
    file << bytes;
  }
}

}  // namespace

bool is_point_cloud_path(const std::string& path) { return ends_with(path, ".ply") || ends_with(path, ".pcd"); }

Status write_point_cloud(const std::string& path, const MapPoints& points) {
  if (!is_point_cloud_path(path)) return Error{"'" + path + "' ends neither in .ply nor in .pcd"};
  const std::size_t count = points.sparse.size() + points.semi_dense.size();
  const auto write_points = [&](std::ostream& file) {
    file << (ends_with(path, ".ply") ? ply_header(count) : pcd_header(count));
    write(points.sparse, 1.0F, file);
    write(points.semi_dense, 0.0F, file);
  };
  return write_file(path, write_points);
}

}  // namespace semantic_topo_loop::core
