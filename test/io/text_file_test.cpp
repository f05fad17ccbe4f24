#include "semantic_topo_loop/io/text_file.h"

#include <gtest/gtest.h>

#include <cmath>

#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

TEST(TextFile, WrittenTextComesBack) {
  const TestDirectory directory;
  const std::string text = "a\nb\r\n\0c";
  ASSERT_EQ(write_text_file(directory.path("x"), text).message(), "");
  EXPECT_EQ(checked(read_text_file(directory.path("x"))), text);
  ASSERT_EQ(write_text_file(directory.path("x"), "").message(), "");
  EXPECT_EQ(checked(read_text_file(directory.path("x"))), "");
}

TEST(TextFile, LeavesNoTemporaryFile) {
  const TestDirectory directory;
  ASSERT_TRUE(write_text_file(directory.path("x"), "text"));
  int entries = 0;
  for (const auto& entry : std::filesystem::directory_iterator(directory.path(""))) entries += entry.exists() ? 1 : 0;
  EXPECT_EQ(entries, 1);
}

TEST(TextFile, ErrorsNameThePath) {
  const TestDirectory directory;
  EXPECT_EQ(read_text_file(directory.path("none")).message(), directory.path("none") + ": cannot open the file");
  EXPECT_NE(read_text_file(directory.path("")).message().find("is a directory"), std::string::npos);
  EXPECT_NE(write_text_file(directory.path("none/x"), "text").message().find(directory.path("none/x")),
            std::string::npos);
  directory.write("file", "");
  EXPECT_NE(make_directory(directory.path("file")).message().find(directory.path("file")), std::string::npos);
  EXPECT_FALSE(write_text_file(directory.path(""), "text"));
}

TEST(TextFile, MakesNestedDirectories) {
  const TestDirectory directory;
  EXPECT_EQ(make_directory(directory.path("a/b/c")).message(), "");
  EXPECT_EQ(make_directory(directory.path("a/b/c")).message(), "");
  EXPECT_TRUE(std::filesystem::is_directory(directory.path("a/b/c")));
}

TEST(Text, ContentLinesKeepTheirNumbers) {
  const std::vector<TextLine> lines = content_lines("# head\n\n  a b \r\n\t# note\nlast");
  ASSERT_EQ(lines.size(), 2u);
  EXPECT_EQ(lines[0].number, 3);
  EXPECT_EQ(lines[0].text, "a b");
  EXPECT_EQ(lines[1].number, 5);
  EXPECT_EQ(lines[1].text, "last");
}

TEST(Text, Splits) {
  using Fields = std::vector<std::string_view>;
  EXPECT_EQ(split_blanks("  a \t b  "), (Fields{"a", "b"}));
  EXPECT_EQ(split_blanks(""), Fields());
  EXPECT_EQ(split("a,,b,", ','), (Fields{"a", "", "b", ""}));
  EXPECT_EQ(split("", ','), Fields{""});
}

TEST(Text, ParsesWholeNumbersOnly) {
  EXPECT_EQ(parse_double("-1.5e3"), -1500.0);
  EXPECT_TRUE(std::isnan(*parse_double("nan")));
  for (const char* text : {"", " 1", "1 ", "1x", "x", "1,5"}) EXPECT_FALSE(parse_double(text)) << text;
  EXPECT_EQ(parse_integer("-12"), -12);
  for (const char* text : {"", " 1", "1.0", "1e3", "99999999999999999999"}) EXPECT_FALSE(parse_integer(text)) << text;
}

TEST(Text, FormatsNumbers) {
  EXPECT_EQ(format_fixed(1.0 / 3.0, 4), "0.3333");
  EXPECT_EQ(format_fixed(-1e300, 0).size(), 302u);
  EXPECT_EQ(format_general(0.25, 7), "0.25");
  EXPECT_EQ(at_line("f.txt", 3, "bad"), "f.txt:3: bad");
}

}  // namespace
}  // namespace semantic_topo_loop::core
