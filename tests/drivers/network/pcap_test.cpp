#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <vector>

#include "drivers/network/pcap_file.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::network {
namespace {

TEST(PcapFile, SaysWhatItDoesNotUnderstand) {
  rigor::test::TemporaryDirectory dir;
  std::ofstream(dir.file("text.pcap")) << "this is no recording at all, but a text";
  const auto text = PcapReader::open(dir.file("text.pcap"));
  ASSERT_FALSE(text);
  EXPECT_EQ(text.error().code, ErrorCode::bad_input);
  EXPECT_FALSE(is_pcap(dir.file("text.pcap")));
  EXPECT_EQ(PcapReader::open(dir.file("none.pcap")).error().code, ErrorCode::not_found);
}

TEST(PcapFile, WhatIsWrittenIsRead) {
  rigor::test::TemporaryDirectory dir;
  const std::vector<std::uint8_t> payload{1, 2, 3};
  {
    auto writer = PcapWriter::create(dir.file("a.pcap"));
    ASSERT_TRUE(writer) << writer.error().text();
    writer->write(RealtimeTime(1'700'000'000'123'456'789), {0x7F000001, 0x7F000002, 5, 6, payload});
    ASSERT_TRUE(writer->flush());
  }
  EXPECT_TRUE(is_pcap(dir.file("a.pcap")));
  auto reader = PcapReader::open(dir.file("a.pcap"));
  ASSERT_TRUE(reader);
  auto record = reader->next();
  ASSERT_TRUE(record && *record && (*record)->udp);
  EXPECT_EQ((*record)->t.ns(), 1'700'000'000'123'456'789);
  EXPECT_EQ((*record)->udp->destination_ipv4, 0x7F000002u);
  EXPECT_EQ((*record)->udp->payload.size(), 3u);
  record = reader->next();
  ASSERT_TRUE(record);
  EXPECT_FALSE(*record);
  EXPECT_FALSE(PcapWriter::create("/nonexistent/a.pcap"));
}

void put(std::vector<std::uint8_t>& out, std::uint64_t v, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(v >> 8 * i));
}

TEST(PcapFile, RawIpIsRead) {
  const std::vector<std::uint8_t> payload{1, 2, 3};
  const auto frame = ethernet_frames({1, 2, 5, 6, payload}, 1).front();
  std::vector<std::uint8_t> file;
  put(file, 0xA1B2C3D4, 4), put(file, 2, 2), put(file, 4, 2), put(file, 0, 8), put(file, 65535, 4);
  put(file, 101, 4);  // LINKTYPE_RAW; libpcap calls it DLT_RAW, which is another number
  put(file, 1'700'000'000, 4), put(file, 5, 4), put(file, frame.size() - 14, 4),
      put(file, frame.size() - 14, 4);
  file.insert(file.end(), frame.begin() + 14, frame.end());
  std::FILE* stream = fmemopen(file.data(), file.size(), "r");
  ASSERT_TRUE(stream);
  auto reader = PcapReader::open(stream, "raw.pcap");
  ASSERT_TRUE(reader);
  const auto record = reader->next();
  ASSERT_TRUE(record && *record && (*record)->udp);
  EXPECT_EQ((*record)->udp->destination_port, 6);
}

// pcapng has 64 bits for a stamp: more than nanoseconds since 1970 have in 64.
TEST(PcapFile, AStampThatIsNoTimeIsDamage) {
  std::vector<std::uint8_t> file;
  const auto block = [&](std::uint32_t type, const std::vector<std::uint8_t>& body) {
    put(file, type, 4), put(file, body.size() + 12, 4);
    file.insert(file.end(), body.begin(), body.end());
    put(file, body.size() + 12, 4);
  };
  std::vector<std::uint8_t> section, interface, packet;
  put(section, 0x1A2B3C4D, 4), put(section, 1, 2), put(section, 0, 2), put(section, ~0ULL, 8);
  put(interface, 1, 2), put(interface, 0, 2), put(interface, 65535, 4);
  put(interface, 9, 2), put(interface, 1, 2), put(interface, 0, 4), put(interface, 0, 4);  // whole seconds
  put(packet, 0, 4), put(packet, 0x70000000, 4), put(packet, 1, 4), put(packet, 4, 4), put(packet, 4, 4);
  put(packet, 0, 4);
  block(0x0A0D0D0A, section), block(1, interface), block(6, packet);
  std::FILE* stream = fmemopen(file.data(), file.size(), "r");
  ASSERT_TRUE(stream);
  auto reader = PcapReader::open(stream, "late.pcapng");
  ASSERT_TRUE(reader) << reader.error().text();
  const auto record = reader->next();
  ASSERT_FALSE(record);
  EXPECT_EQ(reader->frames(), 0u);
  EXPECT_EQ(record.error().code, ErrorCode::protocol);
  EXPECT_NE(record.error().message.find("a stamp between"), std::string::npos) << record.error().text();
}

TEST(PcapFile, ADatagramLongerThanAFrameComesBackFromItsFragments) {
  rigor::test::TemporaryDirectory dir;
  std::vector<std::uint8_t> payload(24'832);
  for (std::size_t i = 0; i < payload.size(); ++i) payload[i] = static_cast<std::uint8_t>(i * 7 + i / 256);
  {
    auto writer = PcapWriter::create(dir.file("a.pcap"));
    ASSERT_TRUE(writer) << writer.error().text();
    writer->write(RealtimeTime(1'700'000'000'000'000'000), {1, 2, 7502, 7502, payload});
    ASSERT_TRUE(writer->flush());
  }
  auto reader = PcapReader::open(dir.file("a.pcap"));
  ASSERT_TRUE(reader);
  for (int frame = 0; frame < 16; ++frame) {
    const auto record = reader->next();
    ASSERT_TRUE(record && *record);
    EXPECT_FALSE((*record)->udp) << "after " << frame + 1 << " of 17 fragments";
  }
  const auto record = reader->next();
  ASSERT_TRUE(record && *record && (*record)->udp);
  EXPECT_EQ((*record)->udp->source_ipv4, 1u);
  EXPECT_EQ((*record)->udp->destination_port, 7502);
  EXPECT_TRUE(std::equal(payload.begin(), payload.end(), (*record)->udp->payload.begin(),
                         (*record)->udp->payload.end()));
  EXPECT_EQ(reader->fragments().fragments, 17u);
  EXPECT_EQ(reader->fragments().datagrams, 1u);
}

}  // namespace
}  // namespace rigor::network
