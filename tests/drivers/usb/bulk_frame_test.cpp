#include "drivers/usb/bulk_frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>

#include "drivers/usb/bulk_source.h"

namespace rigor::usb {
namespace {

BulkFormat format_of(const std::string& text) {
  const auto node = ConfigDocument::parse(text, "test.yaml");
  EXPECT_TRUE(node) << node.error().text();
  auto f = catch_config([&] { return read_bulk_format(*node); });
  EXPECT_TRUE(f) << f.error().text();
  return f ? *f : BulkFormat{};
}
std::string refusal(const std::string& text) {
  const auto node = ConfigDocument::parse(text, "test.yaml");
  auto f = catch_config([&] { return read_bulk_format(*node); });
  return f ? "" : f.error().text();
}

const std::string kTof =
    "{magic: 52474654, header_bytes: 24, width_px: 16, height_px: 12, sequence: {at: 4, type: u32}, "
    "stamp: {at: 8, type: u64, tick_ns: 1000}, length: {at: 16, type: u32}, "
    "planes: [{name: range, scale: 0.001, invalid: [0, 65535]}, {name: amplitude, type: f32}]}";

std::vector<std::byte> tof_planes(std::size_t pixels, unsigned seed) {
  std::vector<float> values(2 * pixels);
  for (std::size_t i = 0; i < pixels; ++i) {
    values[i] = i % 7 == 0 ? NAN : static_cast<float>((seed + i) % 60000 + 1) * 0.001F;
    values[pixels + i] = static_cast<float>(i) * 0.25F;
  }
  std::vector<std::byte> bytes(values.size() * sizeof(float));
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

/// Frames of 1176 bytes: after a length of 60 MiB they were lost for 60 MiB.
TEST(BulkReader, ACorruptLengthCostsLittleMoreThanItsOwnFrame) {
  const BulkFormat f = format_of(kTof);
  std::string good, stream;
  encode_bulk(f, tof_planes(f.pixels(), 1), 1, 0, good);
  std::string corrupt = good;
  const std::uint32_t length = 60 << 20;
  std::memcpy(corrupt.data() + 16, &length, sizeof length);
  stream = corrupt;
  for (int i = 0; i < 3; ++i) stream += good;
  BulkReader reader(f);
  reader.push(stream, 1);
  BulkReader::Frame frame;
  int found = 0;
  while (reader.next(frame)) ++found;
  EXPECT_EQ(found, 3);
  EXPECT_EQ(reader.refused_headers(), 1u);
}

TEST(BulkFormat, SaysWhatAFrameHasAtMost) {
  EXPECT_EQ(format_of(kTof).most_bytes, 2 * 1176u + 65536);
  const auto with = [](const std::string& most) {
    return "{magic: 5247, header_bytes: 6, width_px: 4, height_px: 3, length: {at: 2, max_bytes: " + most +
           "}, planes: [{name: range}]}";
  };
  EXPECT_EQ(format_of(with("100")).most_bytes, 100u);
  EXPECT_THAT(refusal(with("29")), testing::HasSubstr("max_bytes: expected a whole number from 30 to"));
}

TEST(BulkFrame, PlanesComeBackAsTheyWere) {
  for (const char* order : {"little", "big"}) {
    BulkFormat f = format_of(kTof);
    f.big_endian = std::string(order) == "big";
    const auto planes = tof_planes(f.pixels(), 5);
    std::string bytes;
    encode_bulk(f, planes, 77, 123'456'000, bytes);
    EXPECT_EQ(bytes.size(), 24u + 192 * (2 + 4));
    EXPECT_EQ(bytes.substr(0, 4), "RGFT");
    EXPECT_EQ(bulk_field(f, *f.sequence, bytes), 77u);
    EXPECT_EQ(bulk_field(f, *f.stamp, bytes), 123'456u);
    std::vector<std::byte> back(bulk_sample_bytes(f));
    ASSERT_TRUE(decode_bulk(f, bytes, back));
    for (std::size_t i = 0; i < 2 * f.pixels(); ++i) {
      float a = 0, b = 0;
      std::memcpy(&a, planes.data() + i * 4, 4);
      std::memcpy(&b, back.data() + i * 4, 4);
      if (std::isnan(a))
        EXPECT_TRUE(std::isnan(b)) << i;
      else
        EXPECT_NEAR(a, b, 1e-6) << i;
    }
  }
}

TEST(BulkFrame, EveryTypeOfNumberIsReadInBothOrders) {
  // -2 as s16 and s32, 40000 as u16, 3e9 as u32, 1.5 as f32, big-endian, written by hand.
  const std::vector<std::pair<const char*, std::pair<std::string, double>>> cases = {
      {"u8", {std::string("\xC8", 1), 200}},
      {"u16", {std::string("\x9C\x40", 2), 40000}},
      {"s16", {std::string("\xFF\xFE", 2), -2}},
      {"u32", {std::string("\xB2\xD0\x5E\x00", 4), 3e9}},
      {"s32", {std::string("\xFF\xFF\xFF\xFE", 4), -2}},
      {"f32", {std::string("\x3F\xC0\x00\x00", 4), 1.5}},
  };
  for (const auto& [type, what] : cases)
    for (const bool big : {true, false}) {
      const BulkFormat f = format_of(
          std::string("{magic: abcd, header_bytes: 2, width_px: 1, height_px: 1, byte_order: ") +
          (big ? "big" : "little") + ", planes: [{name: range, type: " + type + ", scale: 2, offset: 1}]}");
      std::string raw = what.first;
      if (!big) std::reverse(raw.begin(), raw.end());
      float v = 0;
      ASSERT_TRUE(decode_bulk(f, "\xab\xcd" + raw, std::as_writable_bytes(std::span(&v, 1))));
      EXPECT_FLOAT_EQ(v, static_cast<float>(what.second * 2 + 1)) << type << big;
    }
}

TEST(BulkFrame, ReaderFindsFramesBetweenRubbishInPiecesOfAnySize) {
  const BulkFormat f = format_of(kTof);
  std::mt19937 random(11);
  std::string stream;
  for (std::uint32_t k = 0; k < 100; ++k) {
    if (random() % 2 == 0)
      for (std::size_t i = random() % 5000; i > 0; --i) stream += static_cast<char>(random());
    if (random() % 5 == 0)
      stream += "RGFT" + std::string(20, '\xff');  // a header with a length that cannot be
    if (random() % 5 == 0) stream += "RGF";
    encode_bulk(f, tof_planes(f.pixels(), k), k, k, stream);
  }
  BulkReader reader(f);
  std::uint32_t next = 0;
  std::int64_t at_ns = 0;
  for (std::size_t at = 0; at < stream.size();) {
    const std::size_t n = std::min<std::size_t>(1 + random() % 3000, stream.size() - at);
    reader.push(std::string_view(stream).substr(at, n), ++at_ns);
    at += n;
    BulkReader::Frame frame;
    while (reader.next(frame)) {
      EXPECT_EQ(bulk_field(f, *f.sequence, frame.bytes), next);
      EXPECT_LE(frame.first_ns, frame.last_ns);
      EXPECT_EQ(frame.last_ns, at_ns) << "a frame is there when its last byte came";
      ++next;
    }
  }
  EXPECT_EQ(next, 100u);
  EXPECT_GT(reader.refused_headers(), 5u);
  EXPECT_GT(reader.skipped_bytes(), 10000u);
}

// A device that was slow at first (300 ms from the stamp to the first byte, then 100 ms): its clock is tied
// down by the quickest frames, and until that is settled no frame was measured after it came.
TEST(FrameKeeper, NoFrameWasMeasuredAfterItCame) {
  BulkSettings settings;
  settings.format = format_of(kTof);
  settings.delay = milliseconds(5);
  ChannelConfig config;
  config.period = milliseconds(200);
  config.latency = milliseconds(150);
  FrameKeeper keeper;
  keeper.begin(config, settings);
  RunOrigin origin;
  origin.publish(BenchTime(0));
  const auto planes = tof_planes(settings.format.pixels(), 1);
  Sample sample;
  sample.reserve(bulk_sample_bytes(settings.format));
  BenchTime last;
  for (std::int64_t k = 0; k < 40; ++k) {
    std::string bytes;
    encode_bulk(settings.format, planes, static_cast<std::uint64_t>(k), k * 200'000'000, bytes);
    const std::int64_t delay_ns = k < 5 ? 300'000'000 : 100'000'000 + k * 1000;
    const std::int64_t came = k * 200'000'000 + delay_ns;
    const BulkReader::Frame frame{bytes, came, came + 1'000'000};
    const FrameKeeper::Kept kept = keeper.place(frame, origin);
    EXPECT_TRUE(kept.in_run && kept.in_order) << k;
    EXPECT_EQ(kept.lost, k == 5 ? kept.lost : 0) << k;
    keeper.fill(frame, sample);
    EXPECT_LE(sample.stamp.t_capture.ns(), came - 5'000'000) << k;
    last = sample.stamp.t_capture;
  }
  EXPECT_NEAR(static_cast<double>(last.ns()), 39 * 200e6 + 95e6, 2e6);
}

TEST(BulkFrame, WrongDescriptionsAreRefusedWithTheirPlace) {
  using ::testing::HasSubstr;
  EXPECT_THAT(refusal("{magic: xy, header_bytes: 4, width_px: 1, height_px: 1, planes: [{name: range}]}"),
              HasSubstr("test.yaml:1:9: magic: expected 2 … 16 bytes"));
  EXPECT_THAT(
      refusal("{magic: abcd, header_bytes: 4, width_px: 1, height_px: 1, planes: [{name: amplitude}]}"),
      HasSubstr("planes: expected range"));
  EXPECT_THAT(
      refusal(
          "{magic: abcd, header_bytes: 4, width_px: 1, height_px: 1, sequence: {at: 2, type: u32}, planes: "
          "[{name: range}]}"),
      HasSubstr("within the header of 4 bytes"));
  EXPECT_THAT(refusal("{magic: abcd, header_bytes: 4, width_px: 8000, height_px: 8000, planes: [{name: "
                      "range, type: f32}]}"),
              HasSubstr("64 MiB"));
  EXPECT_THAT(refusal("{magic: abcd, header_bytes: 4, width_px: 4, height_px: 4, size_bytes: 10, planes: "
                      "[{name: range}]}"),
              HasSubstr("size_bytes"));
  EXPECT_THAT(
      refusal(
          "{magic: abcd, header_bytes: 4, width_px: 4, height_px: 4, hight: 10, planes: [{name: range}]}"),
      HasSubstr("hight: unknown key"));
}

}  // namespace
}  // namespace rigor::usb
