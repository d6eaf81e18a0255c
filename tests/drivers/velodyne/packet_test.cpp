// Bytes of the packets: checked by hand-made packets here and by a recording in recording_test.cpp.
#include "drivers/velodyne/velodyne_packet.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace rigor::velodyne {
namespace {

DataPacketWriter example() {
  DataPacketWriter w;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    w.set_azimuth(b, static_cast<std::uint32_t>(35'980 + 40 * b));
    for (std::size_t c = 0; c < kChannels; ++c)
      w.set(b, c, {static_cast<std::uint16_t>(1000 * b + c), static_cast<std::uint8_t>(c * 8)});
  }
  w.finish(3'599'999'999, ReturnMode::last, 0x22);
  return w;
}

TEST(VelodynePacket, LiesInItsBytesAsTheManualSays) {
  const DataPacketWriter w = example();
  const Bytes b = w.bytes();
  ASSERT_EQ(b.size(), 1206u);
  EXPECT_EQ(b[100], 0xFF);
  EXPECT_EQ(b[101], 0xEE);
  EXPECT_EQ(b[102] + 256 * b[103], 20);  // block 1: 36020 cdeg go once round
  EXPECT_EQ(b[104 + 3 * 5] + 256 * b[104 + 3 * 5 + 1], 1005);
  EXPECT_EQ(b[104 + 3 * 5 + 2], 40);
  EXPECT_EQ(b[1200] + 256u * b[1201] + 65536u * b[1202] + 16777216u * b[1203], 3'599'999'999u);
  EXPECT_EQ(b[1204], 0x38);
  EXPECT_EQ(b[1205], 0x22);
  PacketFault fault{};
  const auto p = DataPacket::parse(b, fault);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->azimuth_cdeg(0), 35'980u);
  EXPECT_EQ(p->at(11, 31).range_raw, 11'031);
  EXPECT_EQ(p->at(11, 31).intensity, 248);
  EXPECT_EQ(p->timestamp_us(), 3'599'999'999u);
  EXPECT_EQ(p->mode(), ReturnMode::last);
}

TEST(VelodynePacket, SaysWhatIsWrongWithOne) {
  const DataPacketWriter w = example();
  const auto fault_with = [&](std::size_t at, std::uint8_t value) {
    std::vector<std::uint8_t> b(w.bytes().begin(), w.bytes().end());
    b[at] = value;
    PacketFault fault{};
    EXPECT_FALSE(DataPacket::parse(b, fault));
    return fault;
  };
  EXPECT_EQ(fault_with(1100, 0xFE), PacketFault::block_flag);
  EXPECT_EQ(fault_with(3, 0xFF), PacketFault::azimuth);
  EXPECT_EQ(fault_with(1203, 0xFF), PacketFault::timestamp);
  EXPECT_EQ(fault_with(1204, 0x36), PacketFault::return_mode);
  PacketFault fault{};
  EXPECT_FALSE(DataPacket::parse(w.bytes().subspan(1), fault));
  EXPECT_EQ(fault, PacketFault::size);
}

TEST(VelodynePacket, AnAzimuthOf36000IsZeroAndWhatIsAboveIsRefused) {
  const DataPacketWriter w = example();
  const auto with_azimuth = [&](std::uint16_t cdeg, PacketFault& fault) {
    static std::vector<std::uint8_t> b;
    b.assign(w.bytes().begin(), w.bytes().end());
    b[2] = static_cast<std::uint8_t>(cdeg), b[3] = static_cast<std::uint8_t>(cdeg >> 8);
    return DataPacket::parse(b, fault);
  };
  PacketFault fault{};
  const auto full = with_azimuth(36'000, fault);
  ASSERT_TRUE(full) << text_of(fault);
  EXPECT_EQ(full->azimuth_cdeg(0), 0u);
  EXPECT_TRUE(full->says_full_turn());
  const auto last = with_azimuth(35'999, fault);
  ASSERT_TRUE(last);
  EXPECT_EQ(last->azimuth_cdeg(0), 35'999u);
  EXPECT_FALSE(last->says_full_turn());
  EXPECT_FALSE(with_azimuth(36'001, fault));
  EXPECT_EQ(fault, PacketFault::azimuth);
}

TEST(VelodynePacket, CountsRangeInTwoMillimetres) {
  EXPECT_EQ(range_raw_of(1.0), 500);
  EXPECT_EQ(range_raw_of(1.0009), 500);
  EXPECT_EQ(range_raw_of(1.0011), 501);
  EXPECT_EQ(range_raw_of(0), 0);
  EXPECT_EQ(range_raw_of(131.07), 65535);
  EXPECT_EQ(range_raw_of(131.08), 0) << "does not fit and is no return";
}

TEST(VelodynePacket, PositionsCarryPpsAndNmea) {
  NmeaRmc rmc{true, 2026, 7, 3, 21, 59, 58, 48.20849, -16.37208, 1.5, 271.5};
  const std::string sentence = compose_rmc(rmc);
  const auto bytes = compose_position({123'456'789, PpsStatus::locked, sentence});
  EXPECT_EQ(bytes[202], 2);
  EXPECT_EQ(bytes[206], '$');
  const auto p = parse_position(bytes);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->timestamp_us, 123'456'789u);
  EXPECT_EQ(p->pps, PpsStatus::locked);
  EXPECT_EQ(p->nmea, sentence);
  const auto back = parse_rmc(p->nmea);
  ASSERT_TRUE(back) << sentence;
  EXPECT_TRUE(back->valid);
  EXPECT_EQ(back->year, 2026);
  EXPECT_EQ(back->hour, 21);
  EXPECT_EQ(back->second, 58);
  EXPECT_NEAR(back->latitude_deg, rmc.latitude_deg, 1e-6);  // minutes to four places
  EXPECT_NEAR(back->longitude_deg, rmc.longitude_deg, 1e-6);
  EXPECT_FALSE(parse_position(Bytes(bytes).first(511)));
}

TEST(VelodynePacket, ASentenceWithBytesThatAreNoTextIsNone) {
  auto bytes = compose_position({0, PpsStatus::locked, "$GPRMC,\x1B[31m"});
  ASSERT_TRUE(parse_position(bytes));
  EXPECT_EQ(parse_position(bytes)->nmea, "");
  bytes[213] = 0xFF;
  EXPECT_EQ(parse_position(bytes)->nmea, "");
  bytes[213] = '\r';
  EXPECT_EQ(parse_position(bytes)->nmea, "$GPRMC,");
}

TEST(VelodynePacket, ReadsASentenceOfAReceiverAndRefusesABrokenOne) {
  // From the manual of a Garmin GPS 18x, the receiver that Velodyne sells.
  const char* good = "$GPRMC,225446,A,4916.45,N,12311.12,W,000.5,054.7,191194,020.3,E*68";
  const auto rmc = parse_rmc(good);
  ASSERT_TRUE(rmc);
  EXPECT_NEAR(rmc->latitude_deg, 49 + 16.45 / 60, 1e-12);
  EXPECT_NEAR(rmc->longitude_deg, -(123 + 11.12 / 60), 1e-12);
  EXPECT_EQ(rmc->year, 1994);
  EXPECT_NEAR(rmc->speed_mps, 0.257, 1e-3);
  std::string bad = good;
  bad[10] = '7';
  EXPECT_FALSE(parse_rmc(bad)) << "checksum";
  EXPECT_FALSE(parse_rmc("$GPRMC*4B"));
  EXPECT_FALSE(parse_rmc(""));
}

TEST(VelodynePacket, TheHourGoesOnWhereTheDeviceStartsAnew) {
  HourClock clock;
  const auto a = clock.unwrap(3'599'999'000);
  const auto b = clock.unwrap(327);
  EXPECT_EQ((b - a).ns(), 1'327'000);
  // One that was overtaken comes from the hour before.
  EXPECT_EQ((clock.unwrap(3'599'999'999) - a).ns(), 999'000);
  EXPECT_EQ((clock.unwrap(1327) - a).ns(), 2'327'000);
}

}  // namespace
}  // namespace rigor::velodyne
