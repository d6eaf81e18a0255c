// The recording of a VLP-16 in the test data, counted by plain loops over its bytes, against the reader, the
// decoder and the report.
#include <gtest/gtest.h>

#include <array>
#include <fstream>
#include <iterator>
#include <vector>

#include "drivers/network/pcap_file.h"
#include "drivers/velodyne/cloud_stream.h"
#include "drivers/velodyne/pcap_report.h"
#include "tests/paths.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::velodyne {
namespace {

using network::PcapReader;

const std::string kRecording = rigor::test::test_data("velodyne_vlp16/vlp16_stationary_room.pcap").string();

std::vector<std::uint8_t> bytes_of(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
std::uint32_t le(const std::vector<std::uint8_t>& b, std::size_t at, int n) {
  std::uint32_t v = 0;
  for (int i = n - 1; i >= 0; --i) v = v << 8 | b[at + static_cast<std::size_t>(i)];
  return v;
}

/// The file by hand: 24 bytes of header, then 16 bytes before each Ethernet frame, 42 bytes of headers in
/// each.
struct ByHand {
  std::uint64_t data = 0, position = 0, returns = 0;
  std::array<std::uint64_t, 16> per_laser{};
  std::uint32_t least = 65535, greatest = 0;
  explicit ByHand(const std::vector<std::uint8_t>& b) {
    for (std::size_t at = 24; at + 16 <= b.size();) {
      const std::size_t length = le(b, at + 8, 4), payload = at + 16 + 42;
      if (length == 42 + 1206) {
        ++data;
        for (std::size_t block = 0; block < 12; ++block)
          for (std::size_t channel = 0; channel < 32; ++channel)
            if (const std::uint32_t r = le(b, payload + block * 100 + 4 + channel * 3, 2); r != 0) {
              ++returns;
              ++per_laser[channel % 16];
              least = std::min(least, r), greatest = std::max(greatest, r);
            }
      } else if (length == 42 + 512) {
        ++position;
      }
      at += 16 + length;
    }
  }
};

class VelodyneRecording : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(kRecording)) GTEST_SKIP() << "test data: no " << kRecording;
  }
};

TEST_F(VelodyneRecording, IsReportedReturnForReturn) {
  const ByHand hand(bytes_of(kRecording));
  const auto r = inspect_pcap(kRecording);
  ASSERT_TRUE(r) << r.error().text();
  EXPECT_EQ(r->frames, 1150u);
  EXPECT_EQ(r->data_packets, hand.data);
  EXPECT_EQ(r->data_packets, 965u);
  EXPECT_EQ(r->position_packets, hand.position);
  EXPECT_EQ(r->malformed, 0u);
  EXPECT_EQ(r->valid_returns, hand.returns);
  EXPECT_EQ(r->points_handed_on, hand.returns) << "the decoder loses a return";
  EXPECT_GT(hand.returns, 200'000u);
  ASSERT_EQ(r->returns_per_laser.size(), 16u);
  for (std::size_t i = 0; i < 16; ++i) EXPECT_EQ(r->returns_per_laser[i], hand.per_laser[i]) << "laser " << i;
  EXPECT_NEAR(r->minimum_range_m, hand.least * 0.002, 1e-9);
  EXPECT_NEAR(r->greatest_range_m, hand.greatest * 0.002, 1e-9);
  // Its factory bytes say HDL-32E; its time says what it is.
  EXPECT_EQ(r->product_byte, 0x21);
  EXPECT_EQ(r->model_by_byte, Model::hdl32e);
  EXPECT_EQ(r->model_by_timing, Model::vlp16);
  EXPECT_EQ(r->model, Model::vlp16);
  EXPECT_EQ(r->gaps, 0u);
  EXPECT_NEAR(r->packets_per_s, 753.5, 0.5);
  // It turns at 20 Hz and begins at 212.52 degrees.
  EXPECT_NEAR(r->rotation_hz, 20, 0.1);
  EXPECT_EQ(r->revolutions, static_cast<std::uint64_t>(r->turns - (360 - 212.52) / 360));
  EXPECT_FALSE(r->ended_by);
}

TEST_F(VelodyneRecording, EveryReturnOfAWholeRevolutionIsInItsCloud) {
  auto reader = PcapReader::open(kRecording);
  ASSERT_TRUE(reader);
  CloudStream stream(PacketDecoder::create(Model::vlp16, factory_calibration(Model::vlp16)).value(), {});
  std::uint64_t clouds = 0, points = 0;
  const RealtimeTime epoch(1'415'069'209'000'000'000);
  while (true) {
    auto record = reader->next();
    ASSERT_TRUE(record) << record.error().text();
    if (!*record) break;
    if (!(*record)->udp || (*record)->udp->payload.size() != kDataBytes) continue;
    stream.take((*record)->udp->payload, BenchTime(0) + ((*record)->t - epoch), [&](const Cloud& c) {
      ++clouds;
      points += c.points.size();
      EXPECT_EQ(c.validity, 0u);
      EXPECT_GT(c.points.back().t_offset_ns, 49'000'000);
      EXPECT_LT(c.points.back().t_offset_ns, 51'000'000);
    });
  }
  EXPECT_EQ(stream.counters().packets, 965u);
  EXPECT_EQ(stream.counters().malformed, 0u);
  EXPECT_EQ(clouds, inspect_pcap(kRecording)->revolutions);
  EXPECT_GT(points, clouds * 10'000);
}

TEST_F(VelodyneRecording, ThatBreaksOffIsToldUpToThere) {
  rigor::test::TemporaryDirectory dir;
  auto bytes = bytes_of(kRecording);
  // Within the third frame: 24 + two records of 16 + 1248.
  const std::size_t third = 24 + 2 * (16 + 1248);
  bytes.resize(third + 500);
  std::ofstream(dir.file("cut.pcap"), std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  const auto r = inspect_pcap(dir.file("cut.pcap"));
  ASSERT_TRUE(r);
  EXPECT_EQ(r->data_packets, 2u);
  ASSERT_TRUE(r->ended_by);
  EXPECT_NE(r->ended_by->text().find("packet 3 at byte " + std::to_string(third)), std::string::npos)
      << r->ended_by->text();
}

}  // namespace
}  // namespace rigor::velodyne
