// Packets as bytes. The expected ones were written from the protocol document by Python's struct, zlib.crc32
// and binascii.crc_hqx.
#include "drivers/livox/livox_packet.h"

#include <gtest/gtest.h>

#include "tests/drivers/livox/made_livox.h"

namespace rigor::livox {
namespace {

using test::bytes_of_hex;

const char* const kMillimetres =
    "004e006400030001020701010000000000000000000000004744301b141a99be1c000000e803000030f8ffff2c01000032000000"
    "000000"
    "000000000000000000c7cfffff32090100ffffffffff15";
const char* const kCentimetres =
    "003c006400030001020702010000000000000000000000009c4b6348141a99be1c000000640038ff1e0032000000000000000000"
    "2dfb85"
    "1a0000ff15";
const char* const kSpherical =
    "00380032000200ffff0003020000000000000000000000005fa3228d00002a36fe9c9717d0070000282394110a00dc0500009411"
    "786914"
    "04";
const char* const kImu =
    "003c00000001002a00000000000000000000000000000000c08028e3404b4c00000000000000803e000000bf0000803f00000000"
    "000000"
    "3e0000803f";

PacketHead head_of_three() {
  PacketHead h;
  h.udp_count = 513;
  h.frame_count = 7;
  h.time_type = TimeType::ptp;
  h.timestamp_ns = 123456789012;
  h.interval_ns = 10'000;
  return h;
}
const std::vector<Point> kThree{{1, -2, 0.3F, 50, 0}, {}, {-12.345F, 67.89F, -0.001F, 255, 0x15}};

Packet parsed(const std::vector<std::uint8_t>& bytes) {
  PacketFault fault{};
  const auto p = Packet::parse(bytes, fault);
  EXPECT_TRUE(p) << text_of(fault);
  return *p;
}

TEST(LivoxPacket, OfPointsIsAsTheDocumentSays) {
  std::vector<std::uint8_t> out;
  compose_points(DataType::cartesian_mm, head_of_three(), kThree, out);
  EXPECT_EQ(out, bytes_of_hex(kMillimetres));
  compose_points(DataType::cartesian_cm, head_of_three(), kThree, out);
  EXPECT_EQ(out, bytes_of_hex(kCentimetres));
  // Azimuth 45° level, 2 m; 45° from the zenith towards −y, 1.5 m.
  const float h = 2 * std::sqrt(0.5F), v = 1.5F * std::sqrt(0.5F);
  PacketHead head;
  head.udp_count = 65535;
  head.time_type = TimeType::gps;
  head.timestamp_ns = 1'700'000'000'000'000'000;
  head.interval_ns = 5'000;
  compose_points(DataType::spherical, head, std::vector<Point>{{h, h, 0, 10, 0}, {0, -v, v, 20, 4}}, out);
  EXPECT_EQ(out, bytes_of_hex(kSpherical));
}

TEST(LivoxPacket, OfTheInertialUnitIsAsTheDocumentSays) {
  PacketHead head;
  head.udp_count = 42;
  head.timestamp_ns = 5'000'000;
  const ImuReading reading{{0.25F, -0.5F, 1}, {0, 0.125F, 1}};
  EXPECT_EQ(compose_imu(head, reading), bytes_of_hex(kImu));
  const auto bytes = bytes_of_hex(kImu);
  const Packet p = parsed(bytes);
  EXPECT_EQ(p.data_type(), DataType::imu);
  EXPECT_EQ(p.imu().turn_rate_radps, reading.turn_rate_radps);
  EXPECT_EQ(p.imu().acceleration_g, reading.acceleration_g);
}

TEST(LivoxPacket, IsReadAsItWasWritten) {
  for (const char* hex : {kMillimetres, kCentimetres}) {
    const auto bytes = bytes_of_hex(hex);
    const Packet p = parsed(bytes);
    const bool fine = hex == kMillimetres;
    EXPECT_EQ(p.data_type(), fine ? DataType::cartesian_mm : DataType::cartesian_cm);
    EXPECT_EQ(p.time_type(), TimeType::ptp);
    EXPECT_EQ(p.udp_count(), 513);
    EXPECT_EQ(p.frame_count(), 7);
    EXPECT_EQ(p.timestamp_ns(), 123456789012u);
    EXPECT_EQ(p.interval_ns(), 10'000);
    ASSERT_EQ(p.dots(), 3u);
    EXPECT_EQ(p.offset_ns(0), 0);
    EXPECT_EQ(p.offset_ns(1), 5'000);
    EXPECT_EQ(p.offset_ns(2), 10'000);
    EXPECT_FALSE(p.point(1).is_return());
    const Point last = p.point(2);
    EXPECT_NEAR(last.x_m, -12.345, fine ? 1e-5 : 5.1e-3);
    EXPECT_NEAR(last.y_m, 67.89, 1e-5);
    EXPECT_NEAR(last.z_m, fine ? -0.001 : 0, 1e-6);
    EXPECT_EQ(last.reflectivity, 255);
    EXPECT_EQ(last.tag, 0x15);
  }
  const auto bytes = bytes_of_hex(kSpherical);
  const Packet p = parsed(bytes);
  EXPECT_EQ(p.time_type(), TimeType::gps);
  EXPECT_NEAR(p.point(0).x_m, 2 * std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(p.point(0).y_m, 2 * std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(p.point(0).z_m, 0, 1e-6);
  EXPECT_NEAR(p.point(1).y_m, -1.5 * std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(p.point(1).z_m, 1.5 * std::sqrt(0.5), 1e-6);
}

TEST(LivoxPacket, SaysWhatIsWrong) {
  const auto good = bytes_of_hex(kMillimetres);
  const auto fault_of = [](std::vector<std::uint8_t> b) {
    PacketFault fault = PacketFault::none;
    EXPECT_FALSE(Packet::parse(b, fault));
    return fault;
  };
  const auto changed = [&](std::size_t at, std::uint8_t to) {
    auto b = good;
    b[at] = to;
    return b;
  };
  EXPECT_EQ(fault_of({good.begin(), good.begin() + 35}), PacketFault::too_short);
  EXPECT_EQ(fault_of({}), PacketFault::too_short);
  EXPECT_EQ(fault_of(changed(0, 1)), PacketFault::wrong_version);
  EXPECT_EQ(fault_of(changed(1, 77)), PacketFault::wrong_length);
  EXPECT_EQ(fault_of({good.begin(), good.end() - 1}), PacketFault::wrong_length);
  EXPECT_EQ(fault_of(changed(10, 4)), PacketFault::wrong_type);
  EXPECT_EQ(fault_of(changed(11, 3)), PacketFault::wrong_type);
  EXPECT_EQ(fault_of(changed(5, 2)), PacketFault::wrong_count);
  EXPECT_EQ(fault_of(changed(5, 0)), PacketFault::wrong_count);
  EXPECT_EQ(fault_of(changed(10, 0)), PacketFault::wrong_count) << "a reading of another length";
  EXPECT_EQ(fault_of(changed(28, 0x15)), PacketFault::wrong_checksum) << "the timestamp is checked";
  EXPECT_EQ(fault_of(changed(77, 0)), PacketFault::wrong_checksum);
  // The header's other fields are not; a checksum of 0 was not made.
  PacketFault fault{};
  EXPECT_TRUE(Packet::parse(changed(7, 9), fault));
  auto unchecked = changed(77, 0);
  std::fill(unchecked.begin() + 24, unchecked.begin() + 28, std::uint8_t{0});
  EXPECT_TRUE(Packet::parse(unchecked, fault));
}

TEST(LivoxPacket, LeavesOutWhatItsTypeCannotSay) {
  std::vector<std::uint8_t> out;
  compose_points(DataType::cartesian_cm, {}, std::vector<Point>{{400, 0, 0, 9, 0}, {327.67F, 0, 0, 9, 0}},
                 out);
  EXPECT_FALSE(parsed(out).point(0).is_return());
  EXPECT_EQ(parsed(out).point(0).reflectivity, 0);
  EXPECT_NEAR(parsed(out).point(1).x_m, 327.67, 1e-4);
}

}  // namespace
}  // namespace rigor::livox
