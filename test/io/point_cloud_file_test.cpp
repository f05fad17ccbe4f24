#include "semantic_topo_loop/io/point_cloud_file.h"

#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <tuple>
#include <vector>

#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

const MapPoints kPoints{{{1.0F, -2.0F, 3.5F}}, {{0.25F, 0.5F, 0.75F}, {-1.0F, 1e-3F, 1e4F}}};

/// The four floats of each point behind the header.
std::vector<std::array<float, 4>> read_back(const std::string& path, const std::string& header_end) {
  const std::string text = read_whole(path);
  const std::size_t begin = text.find(header_end) + header_end.size();
  std::vector<std::array<float, 4>> rows((text.size() - begin) / 16);
  if (!rows.empty()) std::memcpy(rows.data(), text.data() + begin, 16 * rows.size());
  EXPECT_EQ(begin + 16 * rows.size(), text.size());
  return rows;
}

TEST(PointCloudFile, PlyAndPcdHoldEveryPointBitForBit) {
  const TestDirectory directory;
  for (const auto& [name, header_end, count] : {std::tuple("map.ply", "end_header\n", "element vertex 3\n"),
                                                std::tuple("map.pcd", "DATA binary\n", "POINTS 3\n")}) {
    const std::string path = directory.path(name);
    ASSERT_EQ(write_point_cloud(path, kPoints).message(), "");
    EXPECT_NE(read_whole(path).find(count), std::string::npos);
    const std::vector<std::array<float, 4>> rows = read_back(path, header_end);
    ASSERT_EQ(rows.size(), 3U);
    EXPECT_EQ(rows[0], (std::array<float, 4>{1.0F, -2.0F, 3.5F, 1.0F}));
    EXPECT_EQ(rows[1], (std::array<float, 4>{0.25F, 0.5F, 0.75F, 0.0F}));
    EXPECT_EQ(rows[2], (std::array<float, 4>{-1.0F, 1e-3F, 1e4F, 0.0F}));
    ASSERT_EQ(write_point_cloud(path, {}).message(), "");
    EXPECT_TRUE(read_back(path, header_end).empty());
  }
}

TEST(PointCloudFile, NamesTheObjectsThatPointsLieOn) {
  const TestDirectory directory;
  for (const auto& [name, field, header_end] : {std::tuple("map.ply", "property int object\n", "end_header\n"),
                                                std::tuple("map.pcd", "TYPE F F F F I\n", "DATA binary\n")}) {
    const std::string path = directory.path(name);
    ASSERT_EQ(write_point_cloud(path, kPoints, {7, -1, 9}).message(), "");
    const std::string text = read_whole(path);
    EXPECT_NE(text.find(field), std::string::npos);
    const std::size_t begin = text.find(header_end) + std::strlen(header_end);
    ASSERT_EQ(text.size(), begin + 3 * 20);
    std::array<std::int32_t, 3> objects{};
    for (std::size_t i = 0; i < 3; ++i) std::memcpy(&objects.at(i), text.data() + begin + 20 * i + 16, 4);
    EXPECT_EQ(objects, (std::array<std::int32_t, 3>{7, -1, 9}));
  }
}

TEST(PointCloudFile, SaysWhatIsWrongWithThePath) {
  EXPECT_NE(write_point_cloud("map.xyz", kPoints).message().find("map.xyz"), std::string::npos);
  EXPECT_NE(write_point_cloud("/nowhere/at/all/map.ply", kPoints).message().find("/nowhere/at/all/map.ply"),
            std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
