#include "semantic_topo_loop/io/text_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <clocale>
#include <cmath>
#include <cstdio>
#include <locale>
#include <thread>

#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
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

TEST(TextFile, AByteOrderMarkIsNoContent) {
  const TestDirectory directory;
  const std::string mark = "\xEF\xBB\xBF";
  EXPECT_EQ(checked(read_text_file(directory.write("x", mark + mark + "a"))), mark + "a");
  EXPECT_EQ(checked(read_text_file(directory.write("x", mark))), "");
  EXPECT_EQ(checked(read_tum_trajectory(directory.write("t.txt", mark + "1.0 0 0 0 0 0 0 1\n"))).size(), 1U);
  EXPECT_EQ(checked(read_camera(directory.write("c.yaml", mark + "fx: 525\nfy: 525\ncx: 320\ncy: 240\nwidth: 640\n"
                                                                 "height: 480\ndistortion: [0, 0, 0, 0, 0]\n")))
                .width,
            640);
  EXPECT_EQ(checked(read_keyframes(directory.write("k.csv", mark + keyframe_table_header()))).size(), 0U);
  const ClassTable cups = *ClassTable::create({{41, "cup", ClassRole::kMovable, "", 0.1}});
  const std::string frames = R"([{"file_name": "1.0.png", "detections": []}])";
  EXPECT_EQ(checked(read_detections(directory.write("d.json", mark + frames), cups)).frames.size(), 1U);
}

/// Names of what is in a folder, in order.
std::vector<std::string> entries_of(const TestDirectory& directory) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(directory.path(""))) {
    names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

TEST(TextFile, AFullDiskIsAnErrorAndKeepsWhatWasThere) {
  const TestDirectory directory;
  directory.write("x", "before");
  directory.write("y", "before");
  for (const std::size_t length : {100'000U, 4'097U}) {
    const SmallFiles limit(4096);
    const std::string long_text(length, 'a');
    const Status written = write_text_file(directory.path("x"), long_text);
    EXPECT_EQ(written.message().find(directory.path("x") + ": cannot write the file"), 0U) << written.message();
    EXPECT_FALSE(write_files({{directory.path("y"), [](std::ostream& file) { file << "after"; }},
                              {directory.path("x"), [&](std::ostream& file) { file << long_text; }}}));
  }
  EXPECT_EQ(read_whole(directory.path("x")), "before");
  EXPECT_EQ(read_whole(directory.path("y")), "before") << "files that belong together are replaced together";
  EXPECT_EQ(entries_of(directory), (std::vector<std::string>{"x", "y"}));
}

TEST(TextFile, AReaderSeesTheOldFilesUntilAllAreWritten) {
  const TestDirectory directory;
  const std::string x = directory.write("x", "before"), y = directory.write("y", "before");
  std::string seen;
  const auto look = [&](std::ostream& file) {
    file << std::string(1'000'000, 'a') << std::flush;
    seen = read_whole(x) + ' ' + read_whole(y);
  };
  ASSERT_TRUE(write_files({{x, look}, {y, look}}));
  EXPECT_EQ(seen, "before before");
  EXPECT_EQ(read_whole(x).size(), 1'000'000U);
}

TEST(TextFile, TouchesNobodyElsesFile) {
  const TestDirectory directory;
  directory.write("mine", "mine");
  directory.write("x.tmp", "mine");
  std::filesystem::create_symlink(directory.path("mine"), directory.path("y.tmp"));
  for (const char* name : {"x", "y"}) {
    // Two writers at once, the second within the first.
    ASSERT_TRUE(write_file(directory.path(name), [&](std::ostream& file) {
      EXPECT_TRUE(write_text_file(directory.path(name), "inner"));
      file << "outer";
    }));
    EXPECT_EQ(read_whole(directory.path(name)), "outer");
  }
  EXPECT_EQ(read_whole(directory.path("mine")), "mine");
  EXPECT_EQ(read_whole(directory.path("x.tmp")), "mine");
  EXPECT_EQ(entries_of(directory), (std::vector<std::string>{"mine", "x", "x.tmp", "y", "y.tmp"}));
}

TEST(TextFile, LinksStayAndWhatTheyLeadToIsWritten) {
  const TestDirectory directory;
  directory.write("there/x", "before");
  directory.write("links/x", "");
  for (const char* name : {"x", "new"}) {
    const std::string link = directory.path("links/to_") + name;
    std::filesystem::create_symlink(std::string("../there/") + name, link);
    ASSERT_TRUE(write_text_file(link, "after"));
    EXPECT_EQ(read_whole(directory.path(std::string("there/") + name)), "after");
    EXPECT_TRUE(std::filesystem::is_symlink(link));
  }
  EXPECT_EQ(read_whole(directory.path("links/x")), "");
}

TEST(TextFile, DevicesAreWrittenThemselves) {
  const TestDirectory directory;
  const std::string pipe = directory.path("pipe");
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  std::string read;
  std::thread reader([&] { read = read_whole(pipe); });
  EXPECT_EQ(write_text_file(pipe, "text").message(), "");
  reader.join();
  EXPECT_EQ(read, "text");
  EXPECT_EQ(entries_of(directory), std::vector<std::string>{"pipe"});
  std::filesystem::create_symlink("/dev/null", directory.path("null"));
  EXPECT_EQ(write_text_file(directory.path("null"), "text").message(), "");
  EXPECT_TRUE(std::filesystem::is_character_file("/dev/null"));
  EXPECT_NE(write_text_file("/dev/full", "text").message().find("/dev/full: cannot write the file"), std::string::npos);
  testing::internal::CaptureStdout();  // a file
  std::printf("before ");
  EXPECT_EQ(write_text_file("/dev/stdout", "text").message(), "");
  std::printf(" after");
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "before text after");
}

TEST(TextFile, ErrorsNameThePath) {
  const TestDirectory directory;
  EXPECT_EQ(read_text_file(directory.path("none")).message(), directory.path("none") + ": cannot open the file");
  EXPECT_NE(read_text_file(directory.path("")).message().find("is a directory"), std::string::npos);
  EXPECT_EQ(read_text_file("/proc/self/mem").message(), "/proc/self/mem: cannot be read to its end");
  EXPECT_NE(write_text_file(directory.path("none/x"), "text").message().find(directory.path("none/x")),
            std::string::npos);
  directory.write("file", "");
  EXPECT_NE(make_directory(directory.path("file")).message().find(directory.path("file")), std::string::npos);
  EXPECT_FALSE(write_text_file(directory.path(""), "text"));
  // What std::filesystem throws for without an error code.
  std::filesystem::create_symlink(directory.path("loop"), directory.path("loop"));
  const std::string long_name(300, 'x');
  for (const std::string& name : {std::string("loop"), std::string("loop/a"), long_name, long_name + "/a"}) {
    EXPECT_EQ(make_directory(directory.path(name)).message().find(directory.path(name) + ": "), 0U) << name;
  }
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

/// A locale with decimal commas, until the end of a scope: in C, by a file as localedef makes it, and in C++.
class DecimalComma {
 public:
  DecimalComma() : cpp_(std::locale::global(std::locale(std::locale::classic(), new Comma))) {
    using namespace std::string_literals;
    // Six values: decimal point, thousands separator, grouping, both as wide characters, name of the encoding.
    const std::string values = ",\0.\0\3\3\0\0"s + ",\0\0\0"s + ".\0\0\0"s + "UTF-8\0"s;
    std::string file;
    // Which category, how many values, and where they are.
    for (const std::uint32_t word : {0x20031114U, 6U, 32U, 34U, 36U, 40U, 44U, 48U}) {
      file.append(reinterpret_cast<const char*>(&word), sizeof word);
    }
    directory_.write("comma/LC_NUMERIC", file + values);
    ::setenv("LOCPATH", directory_.path("").c_str(), 1);
    is_set_ = std::setlocale(LC_NUMERIC, "comma") != nullptr;
  }
  ~DecimalComma() {
    std::setlocale(LC_NUMERIC, "C");
    ::unsetenv("LOCPATH");
    std::locale::global(cpp_);
  }
  bool is_set() const { return is_set_ && std::strtod("1,5", nullptr) == 1.5; }

 private:
  struct Comma : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
  };
  TestDirectory directory_;
  std::locale cpp_;
  bool is_set_ = false;
};

TEST(Text, NumbersHaveADecimalPointInEveryLocale) {
  const DecimalComma comma;
  ASSERT_TRUE(comma.is_set());
  EXPECT_EQ(parse_double("-1.5e3"), -1500.0);
  EXPECT_FALSE(parse_double("1,5"));
  EXPECT_EQ(parse_integer("1234567"), 1234567);
  EXPECT_EQ(format_fixed(1234.5, 2), "1234.50");
  EXPECT_EQ(format_general(0.25, 7), "0.25");
  const TestDirectory directory;
  const auto write = [](std::ostream& file) { file << 1234.5; };
  ASSERT_TRUE(write_file(directory.path("x"), write));
  EXPECT_EQ(read_whole(directory.path("x")), "1234.5");
  // What reads and writes numbers by itself: options, cameras, poses, detections.
  const Options options =
      checked(make_options<Options>({{"keyframe.min_translation_m", "0.25"}, {"depth.invalid_values", "0 65535"}}));
  EXPECT_EQ(options.keyframe.min_translation_m, 0.25);
  const std::string defaults = format_options_yaml(list_options<Options>());
  EXPECT_NE(defaults.find("min_translation_m: 0.1\n"), std::string::npos);
  EXPECT_TRUE(read_option_texts(directory.write("default.yaml", defaults)));
  const Camera camera{525.5, 525.25, 319.5, 239.5, 640, 480, {0.25, -0.5, 0.0, 0.0, 1.5}};
  const Camera read = checked(read_camera(directory.write("camera.yaml", format_camera(camera))));
  EXPECT_EQ(read.fy, camera.fy);
  EXPECT_EQ(read.distortion, camera.distortion);
  ASSERT_TRUE(write_tum_trajectory(directory.path("poses.txt"),
                                   {{1'500'000'000, SE3(Quaternion::Identity(), Vec3(0.5, 1.25, 2.0))}}));
  EXPECT_EQ(read_whole(directory.path("poses.txt")),
            "1.500000 0.500000000 1.250000000 2.000000000 0.000000000 0.000000000 0.000000000 1.000000000\n");
  const ClassTable cups = *ClassTable::create({{41, "cup", ClassRole::kMovable, "", 0.1}});
  ASSERT_TRUE(write_detections_json(directory.path("boxes.json"), {{2, {{41, 0.75, {1.5, 2.5, 3.5, 4.5}}}}}));
  EXPECT_EQ(checked(read_detections(directory.path("boxes.json"), cups)).frames.at(0).detections.at(0).score, 0.75);
}

TEST(Text, FormatsNumbers) {
  EXPECT_EQ(format_fixed(1.0 / 3.0, 4), "0.3333");
  EXPECT_EQ(format_fixed(-1e300, 0).size(), 302u);
  EXPECT_EQ(format_general(0.25, 7), "0.25");
  EXPECT_EQ(at_line("f.txt", 3, "bad"), "f.txt:3: bad");
}

}  // namespace
}  // namespace semantic_topo_loop::core
