#include "io/cbor.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>
#include <string>
#include <vector>

#include "io/json_field.h"

namespace semantic_topo_loop::core {
namespace {

CborReader reader_of(const std::string& bytes) {
  const auto* const begin = reinterpret_cast<const std::uint8_t*>(bytes.data());
  return {"value", begin, begin + bytes.size()};
}

std::string hex(const std::string& bytes) {
  std::string text;
  for (const char byte : bytes) {
    for (const int digit : {(byte >> 4) & 15, byte & 15}) text += "0123456789abcdef"[digit];
  }
  return text;
}

template <class Write>
std::string written(const Write& write) {
  CborWriter writer;
  write(&writer);
  return writer.take();
}

TEST(Cbor, WritesTheExamplesOfTheStandard) {
  // RFC 8949, appendix A.
  const auto integer = [](std::int64_t value) { return hex(written([=](CborWriter* w) { w->integer(value); })); };
  EXPECT_EQ(integer(0), "00");
  EXPECT_EQ(integer(23), "17");
  EXPECT_EQ(integer(24), "1818");
  EXPECT_EQ(integer(1000), "1903e8");
  EXPECT_EQ(integer(1000000), "1a000f4240");
  EXPECT_EQ(integer(1000000000000), "1b000000e8d4a51000");
  EXPECT_EQ(integer(-1), "20");
  EXPECT_EQ(integer(-1000), "3903e7");
  EXPECT_EQ(integer(std::numeric_limits<std::int64_t>::min()), "3b7fffffffffffffff");
  const auto number = [](double value) { return hex(written([=](CborWriter* w) { w->number(value); })); };
  EXPECT_EQ(number(1.1), "fb3ff199999999999a");
  EXPECT_EQ(number(100000.0), "fa47c35000");
  EXPECT_EQ(number(1e300), "fb7e37e43c8800759c");
  EXPECT_EQ(number(-4.1), "fbc010666666666666");
  const std::string nested = written([](CborWriter* w) {
    w->map(2);
    w->text("a");
    w->array(2);
    w->flag(true);
    w->null();
    w->text("bc");
    w->flag(false);
  });
  EXPECT_EQ(hex(nested), "a2616182f5f6626263f4");
}

TEST(Cbor, NumbersComeBackToTheLastBit) {
  std::mt19937_64 random(3);
  std::vector<double> numbers = {0.0,
                                 -0.0,
                                 0.1,
                                 1.5,
                                 std::numeric_limits<double>::denorm_min(),
                                 std::numeric_limits<double>::max(),
                                 std::numeric_limits<float>::max()};
  std::vector<std::int64_t> integers = {std::numeric_limits<std::int64_t>::min(),
                                        std::numeric_limits<std::int64_t>::max()};
  for (int i = 0; i < 200; ++i) {
    numbers.push_back(std::ldexp(static_cast<double>(random()), static_cast<int>(random() % 900) - 450));
    integers.push_back(static_cast<std::int64_t>(random() >> random() % 64));
  }
  const std::string bytes = written([&](CborWriter* writer) {
    writer->array(numbers.size() + integers.size());
    for (const double value : numbers) writer->number(value);
    for (const std::int64_t value : integers) writer->integer(~value);
  });
  CborReader reader = reader_of(bytes);
  std::size_t i = 0;
  const std::size_t count = reader.elements([&] {
    if (i < numbers.size()) {
      const double value = reader.number();
      EXPECT_EQ(value, numbers[i]);
      EXPECT_EQ(std::signbit(value), std::signbit(numbers[i]));
    } else {
      EXPECT_EQ(reader.integer(), ~integers[i - numbers.size()]);
    }
    ++i;
  });
  EXPECT_EQ(count, numbers.size() + integers.size());
  EXPECT_EQ(reader.problem(), "");
}

TEST(Cbor, MembersAreReadInAnyOrderAndOthersPassedOver) {
  const std::string bytes = written([](CborWriter* writer) {
    writer->array(2);
    writer->map(4);
    for (const char* name : {"first", "second", "other", "third"}) {
      writer->text(name);
      writer->text(std::string("the ") + name);
    }
    writer->integer(7);
  });
  for (const std::vector<const char*>& order :
       {std::vector<const char*>{"first", "second", "third"}, {"third", "first", "second"}, {"second"}, {}}) {
    CborReader reader = reader_of(bytes);
    int elements = 0, behind = 0;
    reader.elements([&] {
      if (elements++ > 0) {
        behind = static_cast<int>(reader.integer());
        return;
      }
      CborReader::Members members(&reader);
      EXPECT_FALSE(members.has("fourth"));
      for (const char* name : order) {
        EXPECT_TRUE(members.has(name));
        members.member(name, [&] { EXPECT_EQ(reader.text(), std::string("the ") + name); });
      }
    });
    EXPECT_EQ(reader.problem(), "");
    EXPECT_EQ(behind, 7);
  }
}

TEST(Cbor, NamesThePlaceOfTheFirstProblem) {
  const std::string bytes = written([](CborWriter* writer) {
    writer->map(1);
    writer->text("frames");
    writer->array(3);
    writer->integer(1);
    writer->number(2.5);
    writer->text("three");
  });
  CborReader reader = reader_of(bytes);
  CborReader::Members members(&reader);
  members.member("frames", [&] { reader.elements([&] { reader.integer(); }); });
  members.member("gone", [&] { FAIL() << "after a problem nothing is read"; });
  EXPECT_EQ(reader.problem(), "value.frames[1] = 2.5 must be an integer");
  CborReader without = reader_of(bytes);
  CborReader::Members(&without).member("gone", [] { FAIL(); });
  EXPECT_EQ(without.problem(), "value has no 'gone'");
  CborReader array = reader_of(bytes);
  CborReader::Row row(&array);
  EXPECT_EQ(array.problem(), "value must be an array");
}

TEST(Cbor, WhatIsNotOneValueIsDamaged) {
  const auto is_damaged = [](const std::string& bytes) { return reader_of(bytes).problem() == "value is damaged"; };
  EXPECT_FALSE(is_damaged("\x01"));
  EXPECT_TRUE(is_damaged(""));
  EXPECT_TRUE(is_damaged("\x01\x01"));
  EXPECT_TRUE(is_damaged("\x19\x01")) << "half an integer";
  EXPECT_TRUE(
      is_damaged("\x65"
                 "four"))
      << "half a text";
  EXPECT_TRUE(is_damaged("\x9b\x7f\xff\xff\xff\xff\xff\xff\xff")) << "an array of 2^63 - 1";
  EXPECT_TRUE(is_damaged("\xbb\x80\xff\xff\xff\xff\xff\xff\xff")) << "twice as many are few";
  EXPECT_TRUE(is_damaged("\x9f\xff")) << "of no known size";
  EXPECT_TRUE(is_damaged("\x41\x01")) << "bytes";
  EXPECT_TRUE(is_damaged(std::string(100'000, '\x81') + '\x01')) << "deep";
  EXPECT_TRUE(is_damaged("\xa1\x01\x02")) << "a key that is no text";
  // Whatever bytes are taken for sound are those that a parser takes, too, and can be read.
  std::mt19937 random(7);
  int sound = 0;
  for (int i = 0; i < 20'000; ++i) {
    std::string bytes(1 + random() % 8, '\0');
    for (char& byte : bytes) byte = static_cast<char>(random() % 3 == 0 ? random() : 0x60 + random() % 0x50);
    if (is_damaged(bytes)) continue;
    ++sound;
    EXPECT_FALSE(Json::from_cbor(bytes, true, false).is_discarded());
    CborReader as_array = reader_of(bytes), as_map = reader_of(bytes), as_text = reader_of(bytes);
    as_array.elements([&] { CborReader::Members(&as_array).member("a", [&] { as_array.number(); }); });
    CborReader::Members(&as_map).member("", [&] { as_map.elements([&] { as_map.text(); }); });
    as_text.text();
  }
  EXPECT_GT(sound, 200);
}

}  // namespace
}  // namespace semantic_topo_loop::core
