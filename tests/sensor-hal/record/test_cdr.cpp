#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "sensor-hal/record/ros2_messages.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;

// Named, for g++ 12 takes `{}` in its place for uninitialized.
const msg::Header kNoHeader;

std::vector<std::byte> joined(Pieces pieces) {
  std::vector<std::byte> all;
  for (const Bytes& piece : pieces) all.insert(all.end(), piece.begin(), piece.end());
  return all;
}

template <class M>
std::vector<std::byte> encoded(const M& message) {
  CdrWriter writer;
  return joined(must(writer.write(message)));
}

std::string hex(const std::vector<std::byte>& bytes) {
  std::string text;
  char two[3];
  for (const std::byte b : bytes)
    std::snprintf(two, sizeof two, "%02x", static_cast<unsigned>(b)), text += two;
  return text;
}

// By hand, after the CDR rules: alignment is counted from behind the 4 bytes of encapsulation.
TEST(Cdr, BytesAreThoseOfTheSpecification) {
  const msg::Header header{{1, 2}, "abc"};
  EXPECT_EQ(hex(encoded(header)),
            "00010000"
            "01000000"
            "02000000"
            "04000000"
            "61626300");
  const msg::KeyValue pair{"a", "bc"};  // the second count is aligned to 4, two bytes of padding
  EXPECT_EQ(hex(encoded(pair)),
            "00010000"
            "02000000"
            "6100"
            "0000"
            "03000000"
            "626300");
  msg::PortVisibility cycle{7, -1, {{"p", 3, 2, 4, 5, 6}}};
  EXPECT_EQ(hex(encoded(cycle)),
            "00010000"
            "0700000000000000"
            "ffffffffffffffff"
            "01000000"
            "02000000"
            "7000"
            "000000000000"
            "0300000000000000"
            "02"
            "00000000000000"
            "0400000000000000"
            "0500000000000000"
            "0600000000000000");
  msg::Command command{kNoHeader, "c", 1, 2, {}, {}};  // an empty float64[] brings no alignment of its own
  EXPECT_TRUE(hex(encoded(command))
                  .ends_with("0200000000000000"
                             "00000000"
                             "00000000"));
}

struct Nested {
  std::vector<std::array<double, 2>> pairs;
  std::vector<msg::Vector3> vectors;
  std::vector<std::string> names;
  std::array<std::string, 2> two;
  std::vector<std::int16_t> shorts;
  std::int8_t small = 0;
  std::vector<float> floats;
  bool flag = false;
  static constexpr auto fields() {
    return std::tuple(&Nested::pairs, &Nested::vectors, &Nested::names, &Nested::two, &Nested::shorts,
                      &Nested::small, &Nested::floats, &Nested::flag);
  }
};

TEST(Cdr, RoundTripsNestedSequences) {
  for (std::size_t n = 0; n < 6; ++n) {  // every length shifts what comes after
    Nested in;
    in.pairs.assign(n, {1.5, -2.5});
    in.vectors.assign(n % 3, {1, 2, 3});
    in.names.assign(n, std::string(n, 'x') + std::string(1, '\0') + "y");
    in.two = {std::string(n, 'a'), "b"};
    in.shorts.assign(n, -7);
    in.small = -3;
    in.floats.assign(n % 2, 0.25f);
    in.flag = true;
    Nested out;
    must(CdrReader::read(encoded(in), out));
    EXPECT_EQ(out.pairs, in.pairs);
    EXPECT_EQ(out.vectors.size(), in.vectors.size());
    EXPECT_EQ(out.names, in.names);
    EXPECT_EQ(out.two, in.two);
    EXPECT_EQ(out.shorts, in.shorts);
    EXPECT_EQ(out.small, in.small);
    EXPECT_EQ(out.floats, in.floats);
    EXPECT_TRUE(out.flag);
  }
}

TEST(Cdr, LargeBytesAreBorrowedNotCopied) {
  const auto pixels = noise(5000, 1);
  CdrWriter writer;
  const msg::Image image{kNoHeader, 50, 100, "mono8", 0, 100, pixels};
  const Pieces pieces = must(writer.write(image));
  ASSERT_EQ(pieces.size(), 2u);
  EXPECT_EQ(pieces[1].data(), pixels.data());
  const msg::PointCloud2 cloud{kNoHeader, 1, 5, {}, false, 1000, 5000, pixels, true};
  const auto bytes = joined(must(writer.write(cloud)));
  EXPECT_EQ(bytes.back(), std::byte{1}) << "is_dense comes after the borrowed data";
  msg::PointCloud2 back;
  must(CdrReader::read(bytes, back));
  EXPECT_TRUE(std::equal(back.data.begin(), back.data.end(), pixels.begin(), pixels.end()));
  EXPECT_GE(back.data.data(), bytes.data());
  EXPECT_LT(back.data.data(), bytes.data() + bytes.size());
}

struct Wrong {
  ByteView bytes;
  std::uint32_t after = 0;
  static constexpr auto fields() { return std::tuple(&Wrong::bytes, &Wrong::after); }
};

TEST(Cdr, RefusesToMisalignAfterBorrowedBytes) {
  const auto bytes = noise(5001, 1);
  CdrWriter writer;
  EXPECT_FALSE(writer.write(Wrong{bytes, 1}));
  EXPECT_TRUE(writer.write(Wrong{Bytes(bytes).first(5), 1}))
      << "small ones are copied, and the writer is usable again";
}

TEST(Cdr, TruncatedAndHostileMessagesAreErrors) {
  msg::CameraInfo info;
  info.header.frame_id = "camera";
  info.distortion_model = "plumb_bob";
  info.d = {1, 2, 3, 4, 5};
  const auto whole = encoded(info);
  msg::CameraInfo out;
  must(CdrReader::read(whole, out));
  EXPECT_EQ(out.d, info.d);
  for (std::size_t n = 0; n < whole.size(); ++n) {
    const std::vector<std::byte> cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));
    EXPECT_FALSE(CdrReader::read(cut, out)) << n << " bytes";
  }
  for (std::size_t at = 4; at + 4 <= whole.size(); at += 4)
    for (const std::uint32_t value : {0x7fffffffu, 0xffffffffu, 0x10000000u}) {
      auto bytes = whole;
      std::memcpy(bytes.data() + at, &value, 4);
      (void)CdrReader::read(bytes, out);
      EXPECT_LE(out.d.size(), whole.size());
    }
  auto longer = whole;
  longer.resize(whole.size() + 8);
  const Status other = CdrReader::read(longer, out);
  ASSERT_FALSE(other);
  EXPECT_THAT(other.error().text(), testing::HasSubstr("another type"));
  auto pl_cdr = whole;
  pl_cdr[1] = std::byte{3};
  EXPECT_FALSE(CdrReader::read(pl_cdr, out));
}

TEST(Cdr, ReadsBigEndianMessages) {
  const unsigned char bytes[] = {0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 2, 'x', 0};
  msg::Header header;
  must(CdrReader::read(std::as_bytes(std::span(bytes)), header));
  EXPECT_EQ(header.stamp.sec, 1);
  EXPECT_EQ(header.stamp.nanosec, 2u);
  EXPECT_EQ(header.frame_id, "x");
}

TEST(Schema, NamesEveryTypeThatItContainsOnce) {
  const std::string text = schema_text(msg::PointCloud2::kType);
  for (const char* part :
       {"MSG: std_msgs/Header\n", "MSG: builtin_interfaces/Time\n", "MSG: sensor_msgs/PointField\n"}) {
    const auto at = text.find(part);
    ASSERT_NE(at, std::string::npos) << part;
    EXPECT_EQ(text.find(part, at + 1), std::string::npos) << part;
  }
  EXPECT_TRUE(text.starts_with("std_msgs/Header header\n"));
  EXPECT_EQ(schema_text("nothing/msg/Here"), "");
  EXPECT_EQ(schema_text("nothing"), "");
}

}  // namespace
}  // namespace rigor::record
