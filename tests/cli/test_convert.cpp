// Packets and telegrams as points, and what `rigor inspect` says of them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "drivers/gnss/nmea.h"
#include "drivers/gnss/ubx.h"
#include "drivers/sick/cola_b.h"
#include "drivers/sick/scan_data.h"
#include "tests/cli/command.h"
#include "tests/drivers/ouster/record_sensor.h"
#include "tests/drivers/velodyne/formula_lidar.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// `scans` telegrams of a scanner at 50 Hz with 10 beams from 1 m on, one payload each; after the third, two
/// are missing.
std::string telegrams(int scans) {
  std::string text = "[";
  for (int k = 0; k < scans; ++k) {
    sick::ScanData s;
    s.scan_counter = static_cast<std::uint16_t>(k);
    s.time_since_startup_us = static_cast<std::uint32_t>(1'000'000 + 20'000 * (k < 3 ? k : k + 2));
    s.time_of_transmission_us = s.time_since_startup_us + 15'000;
    s.scan_frequency_hz_e2 = 5000;
    s.measurement_frequency_100hz = 180;
    sick::ScanChannel c;
    c.name = {'D', 'I', 'S', 'T', '1'};
    c.start_deg_e4 = 0, c.step_deg_e4 = 10000;
    for (int i = 0; i < 10; ++i) c.values.push_back(static_cast<std::uint16_t>(1000 + 100 * i));
    s.channels16.push_back(c);
    sick::Buffer body, frame;
    for (const char ch : std::string("sSN LMDscandata ")) body.push_back(static_cast<std::uint8_t>(ch));
    sick::encode_scan(s, body);
    sick::append_frame(body, frame);
    std::string hex;
    for (const std::uint8_t b : frame) {
      constexpr const char* kDigits = "0123456789abcdef";
      hex += (hex.empty() ? "" : ":") + std::string{kDigits[b >> 4], kDigits[b & 15]};
    }
    text += (k ? ",\n" : "\n") + std::string("{ \"tcp.payload\": \"") + hex + "\" }";
  }
  return text + "\n]\n";
}

class Convert : public ::testing::Test {
 protected:
  Said in_dir(const std::vector<std::string>& words) { return rigor(words, dir.path()); }
  TempDir dir;
};

TEST_F(Convert, PacketsBecomeARecordingOfPoints) {
  velodyne::test::record_rotor((dir / "a.pcap").string(), 20, 754);
  const Said made = in_dir({"convert", "a.pcap", "-o", "a.mcap", "--json"});
  ASSERT_EQ(made.status, 0) << made.err;
  const json said = json::parse(made.out);
  EXPECT_GE(said["scans"], 15);
  const Said inspect = in_dir({"inspect", "a.mcap", "--json"});
  ASSERT_EQ(inspect.status, 0) << inspect.err;
  const json report = json::parse(inspect.out);
  bool found = false;
  for (const json& topic : report["topics"])
    if (topic["topic"] == "/points/points") {
      found = true;
      EXPECT_EQ(topic["messages"], said["scans"]);
      EXPECT_EQ(topic["type"], "sensor_msgs/msg/PointCloud2");
      EXPECT_NEAR(topic["rate_hz"].get<double>(), 20, 1.5);
    }
  EXPECT_TRUE(found) << inspect.out;
  EXPECT_GT(std::stoull(report["first_ns"].get<std::string>()), 1'699'999'999'000'000'000ULL)
      << "of the packets";
  // What is there stays.
  const std::string before = read_file(dir / "a.mcap");
  const Said again = in_dir({"convert", "a.pcap", "-o", "a.mcap"});
  EXPECT_EQ(again.status, 2);
  EXPECT_EQ(read_file(dir / "a.mcap"), before);
  EXPECT_EQ(in_dir({"convert", "a.pcap", "-o", "a.mcap", "--force"}).status, 0);
  EXPECT_EQ(read_file(dir / "a.mcap"), before) << "and comes out the same";
}

TEST_F(Convert, OneScanBecomesAPcd) {
  write_file(dir / "s.json", telegrams(6));
  const Said made = in_dir({"convert", "s.json", "-o", "s.pcd", "--scan", "2"});
  ASSERT_EQ(made.status, 0) << made.err;
  const std::string pcd = read_file(dir / "s.pcd");
  EXPECT_THAT(pcd, HasSubstr("POINTS 10"));
  const Said none = in_dir({"convert", "s.json", "-o", "t.pcd", "--scan", "6"});
  EXPECT_EQ(none.status, 2);
  EXPECT_THAT(none.err,
              HasSubstr("--scan: expected a number from 0 to 5, as the recording has 6 scans, got 6"));
  EXPECT_FALSE(std::filesystem::exists(dir / "t.pcd"));
}

TEST_F(Convert, FramesOfAnOusterBecomeImages) {
  ASSERT_TRUE(
      ouster::test::record_sensor((dir / "a.pcap").string(), (dir / "a.json").string(), {.frames = 3}));
  for (const std::string field : {"signal", "reflectivity", "near_infrared", "range"}) {
    const Said picture = in_dir({"convert", "a.pcap", "--image", field, "-o", field + ".png", "--json"});
    ASSERT_EQ(picture.status, 0) << picture.err;
    const std::string png = read_file(dir / (field + ".png"));
    ASSERT_GT(png.size(), 24u);
    EXPECT_EQ(png.substr(1, 3), "PNG");
    EXPECT_EQ(static_cast<std::uint8_t>(png[18]) * 256 + static_cast<std::uint8_t>(png[19]), 512) << "wide";
    EXPECT_EQ(static_cast<std::uint8_t>(png[23]), ouster::test::kBeams) << "high";
    const Said all = in_dir({"convert", "a.pcap", "--image", field, "-o", field + ".mcap"});
    ASSERT_EQ(all.status, 0) << all.err;
    EXPECT_EQ(all.out, field + ".mcap: 3 scans\n");
    const json report = json::parse(in_dir({"inspect", field + ".mcap", "--json"}).out);
    std::uint64_t images = 0;
    for (const json& topic : report["topics"])
      if (topic["type"] == "sensor_msgs/msg/Image")
        images = std::max(images, topic["messages"].get<std::uint64_t>());
    EXPECT_EQ(images, 3u) << report["topics"];
  }
  // Rows of the formula's sensor have greys of five times their number; one in a hundred is brighter.
  const json white =
      json::parse(in_dir({"convert", "a.pcap", "--image", "reflectivity", "-o", "b.png", "--json"}).out);
  EXPECT_EQ(white["full_scale"], 155);
  EXPECT_EQ(in_dir({"convert", "a.pcap", "--image", "signal", "-o", "a.pcd"}).status, 2);
  EXPECT_EQ(in_dir({"convert", "a.pcap", "-o", "c.png"}).status, 2);
  EXPECT_NE(in_dir({"convert", "a.pcap", "--image", "infrared", "-o", "c.png"}).status, 0);
  std::filesystem::remove(dir / "a.json");
  const Said alone = in_dir({"convert", "a.pcap", "--image", "signal", "-o", "c.png"});
  EXPECT_EQ(alone.status, 2);
  EXPECT_THAT(alone.err, HasSubstr("--metadata"));
}

TEST_F(Convert, WhatIsNoSuchRecordingIsRefused) {
  write_file(dir / "a.txt", "text");
  EXPECT_THAT(in_dir({"convert", "a.txt", "-o", "a.mcap"}).err, HasSubstr("expected packets of a Velodyne"));
  EXPECT_THAT(in_dir({"convert", "b.pcap", "-o", "a.mcap"}).err, HasSubstr("found no such file"));
  EXPECT_THAT(in_dir({"convert", "a.txt", "-o", "a.las"}).err,
              HasSubstr("expected a file that ends in .mcap"));
  EXPECT_FALSE(std::filesystem::exists(dir / "a.mcap"));
}

TEST_F(Convert, InspectKnowsTelegrams) {
  write_file(dir / "s.json", telegrams(9));
  const Said said = in_dir({"inspect", "s.json", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json report = json::parse(said.out);
  EXPECT_EQ(report["scans"], 9);
  EXPECT_EQ(report["points"], 90);
  EXPECT_NEAR(report["rate_hz"].get<double>(), 50, 0.1);
  EXPECT_NEAR(report["range_m"]["minimum"].get<double>(), 1.0, 1e-3);
  EXPECT_NEAR(report["range_m"]["maximum"].get<double>(), 1.9, 1e-3);
  EXPECT_EQ(report["gaps"]["count"], 1);
  const Said text = in_dir({"inspect", "s.json"});
  EXPECT_THAT(text.out, HasSubstr("s.json: 9 scans of a SICK scanner"));
  write_file(dir / "other.json", "{}");
  const Said other = in_dir({"inspect", "other.json"});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err, HasSubstr("expected telegrams"));
}

TEST_F(Convert, AReceiversLogIsToldAndBecomesARecordingOfFixes) {
  gnss::Buffer log;
  for (int k = 0; k < 50; ++k) {
    if (k == 20) continue;  // one is missing
    gnss::NavPvt v;
    v.itow_ms = 1000 + 100 * static_cast<std::uint32_t>(k);
    v.year = 2024, v.month = 3, v.day = 2, v.hour = 1, v.second = static_cast<std::uint8_t>(k / 10);
    v.nano = k % 10 * 100'000'000;
    v.valid = 7, v.fix_type = 3, v.flags = k < 40 ? 1 : 1 | 2 | 2 << 6, v.satellites = 9;
    v.latitude_e7 = 485'000'000 + k, v.longitude_e7 = -92'500'000, v.height_mm = 431'000 + k;
    gnss::append_nav_pvt(log, v);
    if (k == 30) log.push_back(0x42);
  }
  gnss::append_sentence(log, "GNTXT,01,01,02,end");
  write_file(dir / "a.ubx", std::string(log.begin(), log.end()));
  const Said told = in_dir({"inspect", "a.ubx", "--json"});
  ASSERT_EQ(told.status, 0) << told.err;
  const json said = json::parse(told.out);
  EXPECT_EQ(said["solutions"], 49);
  EXPECT_EQ(said["by_status"]["RTK fixed"], 10);
  EXPECT_EQ(said["messages"]["UBX NAV-PVT"], 49);
  EXPECT_EQ(said["messages"]["GNTXT"], 1);
  EXPECT_EQ(said["garbage_bytes"], 1);
  EXPECT_EQ(said["gaps"], 1);
  EXPECT_EQ(said["first"], "2024-03-02T01:00:00.000Z");
  EXPECT_NEAR(said["rate_hz"].get<double>(), 10, 1e-9);
  EXPECT_THAT(in_dir({"inspect", "a.ubx"}).out, HasSubstr("solutions  49 at 10.00 Hz, 1 gaps"));
  const Said made = in_dir({"convert", "a.ubx", "-o", "a.mcap", "--json"});
  ASSERT_EQ(made.status, 0) << made.err;
  const Said inspect = in_dir({"inspect", "a.mcap", "--json"});
  ASSERT_EQ(inspect.status, 0) << inspect.err;
  EXPECT_THAT(inspect.out, HasSubstr("sensor_msgs/msg/NavSatFix"));
  EXPECT_THAT(inspect.out, HasSubstr("/gnss"));
  EXPECT_EQ(in_dir({"convert", "a.ubx", "-o", "a.pcd"}).status, 2);
  write_file(dir / "none.nmea", "$GNTXT,01,01,02,nothing*4B\r\n");
  const Said none = in_dir({"inspect", "none.nmea"});
  EXPECT_EQ(none.status, 2);
  EXPECT_THAT(none.err, HasSubstr("found no solution in it"));
}

}  // namespace
}  // namespace rigor::test
