#include "io/spool.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <string>
#include <string_view>

#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kRow = 24;

std::string rows(std::size_t count) {
  std::string bytes;
  for (std::size_t i = 0; i < count; ++i) {
    const std::string number = std::to_string(i);
    bytes += std::string(kRow - number.size(), '.') + number;
  }
  return bytes;
}

/// What reading gives; empty on an error.   @param is_whole set to whether each part was of whole rows
std::string read(const Spool& spool, bool* is_whole) {
  std::string bytes;
  *is_whole = true;
  const Status status = spool.read(kRow, [&](std::string_view part) {
    *is_whole = *is_whole && part.size() % kRow == 0;
    bytes += part;
  });
  return status ? bytes : std::string();
}

TEST(Spool, GivesBackWholeRowsInTheirOrder) {
  const TestDirectory directory;
  const std::string bytes = rows(40'000);  // a megabyte
  Spool spool;
  for (std::size_t at = 0; at < bytes.size(); at += 1000) spool.add(bytes.substr(at, 1000), directory.path(""));
  bool is_whole = false;
  EXPECT_TRUE(read(spool, &is_whole) == bytes);
  EXPECT_TRUE(is_whole);
}

TEST(Spool, ADiskThatIsFullWithinARowCostsNoRow) {
  const TestDirectory directory;
  const SmallFiles full_disk(100 * kRow + 7);
  const std::string bytes = rows(40'000);
  Spool spool;
  spool.add(bytes, directory.path(""));
  bool is_whole = false;
  EXPECT_TRUE(read(spool, &is_whole) == bytes);
  EXPECT_TRUE(is_whole);
}

TEST(Spool, RowsThatEndWithinOneAreAnError) {
  const TestDirectory directory;
  Spool spool;
  spool.add(rows(40'000) + "half a row", directory.path(""));
  EXPECT_FALSE(spool.read(kRow, [](std::string_view) {}));
}

}  // namespace
}  // namespace semantic_topo_loop::core
