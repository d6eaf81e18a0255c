// GVSP as bytes, and the way back from packets to frames over a bad network.
#include "drivers/aravis/gvsp_codec.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "drivers/aravis/gvsp_assembler.h"

namespace rigor::gige {
namespace {

GvspBlock make_block(std::uint64_t id, std::uint32_t width, std::uint32_t height,
                     std::uint32_t packet_size = 1400, bool extended = false) {
  GvspBlock b;
  b.block_id = id;
  b.packet_size = packet_size;
  b.extended_ids = extended;
  b.leader = {1, 1'000'000 * id + 5, PixelFormat::mono8, {2, 4, width, height}, 0, 0};
  b.data.resize(std::size_t{width} * height);
  for (std::size_t i = 0; i < b.data.size(); ++i) b.data[i] = static_cast<std::uint8_t>(i * 7 + id * 13);
  return b;
}

std::vector<std::vector<std::uint8_t>> packets(const GvspBlock& b) {
  std::vector<std::vector<std::uint8_t>> out;
  for (std::uint32_t i = 0; i < b.packet_count(); ++i) {
    std::vector<std::uint8_t> d(b.packet_size);
    d.resize(b.encode_packet(i, d));
    out.push_back(std::move(d));
  }
  return out;
}

GvspAssembler assembler_for(const GvspBlock& b) {
  GvspAssemblerOptions o;
  o.packet_size = b.packet_size;
  o.payload_bytes = b.data.size();
  o.extended_ids = b.extended_ids;
  return GvspAssembler(o);
}

constexpr DeviceTime at_ms(std::int64_t ms) { return DeviceTime(ms * 1'000'000); }

TEST(GvspCodec, LeaderIsTheSpecificationsBytes) {
  const auto b = make_block(0x0102, 64, 48);
  std::vector<std::uint8_t> d(100);
  ASSERT_EQ(b.encode_packet(0, d), 44U);
  d.resize(44);
  const std::vector<std::uint8_t> head{0, 0, 1, 2, 1, 0, 0, 0, 0, 0, 0, 1};
  EXPECT_TRUE(std::equal(head.begin(), head.end(), d.begin()));
  EXPECT_EQ(load_be<std::uint64_t>(d, 12), b.leader.timestamp_ticks);
  EXPECT_EQ(load_be<std::uint32_t>(d, 20), 0x01080001U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 24), 64U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 28), 48U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 32), 2U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 36), 4U);
}

TEST(GvspCodec, DataThatFillTheLastPacketHaveNoneBehindIt) {
  auto b = make_block(1, 64, 48);
  const std::size_t slice = b.slice_size();
  for (const std::size_t packets : {1U, 2U, 3U}) {
    b.data.assign(slice * packets, 7);
    EXPECT_EQ(b.packet_count(), packets + 2);
    b.data.push_back(8);
    EXPECT_EQ(b.packet_count(), packets + 3);
    std::vector<std::uint8_t> d(b.packet_size);
    EXPECT_EQ(b.encode_packet(static_cast<std::uint32_t>(packets) + 1, d), 9U) << "a header and a byte";
  }
}

TEST(GvspCodec, TrailerIsTheSpecificationsBytes) {
  auto b = make_block(0x0102, 64, 48);
  std::vector<std::uint8_t> d(100);
  const std::uint32_t last = b.packet_count() - 1;
  ASSERT_EQ(b.encode_packet(last, d), 16U);
  EXPECT_EQ(d[4], 2) << "a trailer";
  EXPECT_EQ(load_be<std::uint32_t>(d, 4) & 0xFFFFFF, last);
  EXPECT_EQ(load_be<std::uint32_t>(d, 8), 0x0001U) << "of an image";
  EXPECT_EQ(load_be<std::uint32_t>(d, 12), 48U);
  b.leader.payload_type |= kChunkFlag;
  ASSERT_EQ(b.encode_packet(last, d), 24U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 8), 0x4001U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 12), 48U);
  EXPECT_EQ(load_be<std::uint32_t>(d, 16), 64U * 48U) << "of picture and chunks";
  EXPECT_EQ(load_be<std::uint32_t>(d, 20), 0U) << "the one layout";
}

TEST(GvspCodec, PacketsComeBackAsTheyWentInBothIdModes) {
  for (const bool extended : {false, true}) {
    const auto b = make_block(extended ? 0x10000000001ULL : 65535, 100, 37, 576, extended);
    const auto all = packets(b);
    std::vector<std::uint8_t> data;
    for (std::uint32_t i = 0; i < all.size(); ++i) {
      EXPECT_LE(all[i].size() + kIpUdpHeaderSize, b.packet_size);
      GvspPacket p;
      ASSERT_TRUE(decode_gvsp(all[i], p));
      EXPECT_EQ(p.block_id, b.block_id);
      EXPECT_EQ(p.packet_id, i);
      EXPECT_EQ(p.extended_ids, extended);
      if (i == 0) {
        EXPECT_EQ(p.leader.region, b.leader.region);
      }
      if (i + 1 == all.size()) {
        EXPECT_EQ(p.trailer.height_px, 37U);
      }
      data.insert(data.end(), p.payload.begin(), p.payload.end());
    }
    EXPECT_EQ(data, b.data);
  }
}

TEST(GvspCodec, PacketIdsHave24BitsAndExtendedOnes32) {
  for (const auto& [extended, id] : {std::pair{false, 0xFEDCBAU}, std::pair{true, 0xFEDCBA98U}}) {
    std::array<std::uint8_t, kGvspExtendedHeaderSize> d{};
    const std::size_t size =
        encode_gvsp_status(GvStatus::packet_unavailable, 1, id, GvspFormat::payload, extended, d);
    GvspPacket p;
    ASSERT_TRUE(decode_gvsp(Bytes(d).first(size), p));
    EXPECT_EQ(p.packet_id, id);
    EXPECT_EQ(p.status, GvStatus::packet_unavailable);
    EXPECT_EQ(p.format, GvspFormat::payload);
  }
}

TEST(GvspCodec, BlockZeroIsNone) {
  for (const bool extended : {false, true})
    for (const auto& d : packets(make_block(0, 64, 48, 1400, extended))) {
      GvspPacket p;
      EXPECT_FALSE(decode_gvsp(d, p));
    }
}

TEST(GvspCodec, EveryTruncationIsRefusedOrShorterPayload) {
  const auto b = make_block(1, 64, 48);
  for (const auto& whole : packets(b)) {
    for (std::size_t n = 0; n < whole.size(); ++n) {
      GvspPacket p;
      if (decode_gvsp(Bytes(whole).first(n), p)) {
        EXPECT_EQ(p.format, GvspFormat::payload);
        EXPECT_EQ(p.payload.size(), n - kGvspHeaderSize);
      }
    }
  }
}

TEST(GvspAssembler, TakesAnyOrderAndRepetition) {
  const auto b = make_block(1, 640, 480);
  auto all = packets(b);
  for (std::size_t i = 0; i < 50; ++i) all.push_back(std::vector<std::uint8_t>(all[i]));
  std::shuffle(all.begin(), all.end(), std::mt19937(1));
  auto a = assembler_for(b);
  for (const auto& p : all) a.push(p, at_ms(1));
  AssembledFrame f;
  ASSERT_TRUE(a.take(at_ms(1), f));
  EXPECT_TRUE(f.complete);
  EXPECT_EQ(f.data, b.data);
  EXPECT_EQ(f.leader.timestamp_ticks, b.leader.timestamp_ticks);
  // Copies that came behind the last missing packet met an open frame too: it is taken only by take().
  EXPECT_EQ(a.counters().duplicates, 50U);
  EXPECT_FALSE(a.take(at_ms(1), f));
}

TEST(GvspAssembler, AsksForWhatIsMissingAndNothingElse) {
  const auto b = make_block(1, 640, 480);
  const auto all = packets(b);
  auto a = assembler_for(b);
  const auto lost = [](std::size_t i) { return i == 0 || i == 5 || i == 6 || i == 7 || i == 100; };
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (!lost(i)) a.push(all[i], at_ms(1));
  }
  EXPECT_TRUE(a.resends(at_ms(1)).empty());  // they may be late only
  const auto asked = a.resends(at_ms(3));
  ASSERT_EQ(asked.size(), 3U);
  EXPECT_EQ(asked[0].first_packet, 0U);
  EXPECT_EQ(asked[1].first_packet, 5U);
  EXPECT_EQ(asked[1].last_packet, 7U);
  EXPECT_EQ(asked[2].last_packet, 100U);
  EXPECT_TRUE(a.resends(at_ms(4)).empty());
  EXPECT_EQ(a.resends(at_ms(30)).size(), 3U);  // the answer was lost, too
  for (const std::size_t i : {0, 5, 6, 7, 100}) a.push(all[i], at_ms(31));
  AssembledFrame f;
  ASSERT_TRUE(a.take(at_ms(31), f));
  EXPECT_TRUE(f.complete);
  EXPECT_EQ(f.data, b.data);
}

TEST(GvspAssembler, MarksWhatStaysIncompleteAndSaysWhichPackets) {
  const auto b = make_block(1, 640, 480);
  const auto all = packets(b);
  auto a = assembler_for(b);
  for (std::size_t i = 0; i + 2 < all.size(); ++i) {
    if (i != 3) a.push(all[i], at_ms(0));
  }
  AssembledFrame f;
  EXPECT_FALSE(a.take(at_ms(100), f));
  ASSERT_TRUE(a.take(at_ms(200), f));
  EXPECT_FALSE(f.complete);
  const auto last = static_cast<std::uint32_t>(all.size() - 1);
  EXPECT_EQ(f.missing, (std::vector<PacketRange>{{3, 3}, {last - 1, last}}));
  a.push(all[3], at_ms(201));  // too late: must not open the block again
  EXPECT_EQ(a.counters().late, 1U);
  EXPECT_FALSE(a.take(at_ms(500), f));
  EXPECT_EQ(a.counters().frames_incomplete, 1U);
}

TEST(GvspAssembler, KeepsOrderOverTheRollOfBlockIdsAndCountsGaps) {
  const auto first = make_block(65534, 64, 48);
  auto a = assembler_for(first);
  for (const std::uint64_t id : {65534ULL, 2ULL, 65535ULL}) {  // 1 never comes, 2 overtakes
    for (const auto& p : packets(make_block(id, 64, 48))) a.push(p, at_ms(1));
  }
  AssembledFrame f;
  std::vector<std::uint64_t> ids;
  while (a.take(at_ms(1), f)) {
    ids.push_back(f.block_id);
    EXPECT_TRUE(f.complete);
    EXPECT_EQ(f.data, make_block(f.block_id, 64, 48).data);
  }
  EXPECT_EQ(ids, (std::vector<std::uint64_t>{65534, 65535, 2}));
  EXPECT_EQ(a.counters().frames_lost, 1U);
}

TEST(GvspAssembler, RefusesAFrameOfAnotherSize) {
  const auto agreed = make_block(1, 64, 48);
  auto a = assembler_for(agreed);
  for (const auto& p : packets(make_block(1, 64, 46))) a.push(p, at_ms(0));
  AssembledFrame f;
  ASSERT_TRUE(a.take(at_ms(300), f));
  EXPECT_FALSE(f.complete);
  EXPECT_GT(a.counters().wrong_packet, 0U);
}

/// Range of 64x48 and amplitude of 64x48, 16 bits each.
GvspBlock make_parts(std::uint64_t id, std::uint32_t packet_size = 1400) {
  GvspBlock b = make_block(id, 128, 96, packet_size, true);
  b.leader.payload_type = kMultipartPayload;
  b.leader.part_count = 2;
  b.leader.parts[0] = {kPart3d, kRange, 6144, PixelFormat::coord3d_c16, {2, 4, 64, 48}};
  b.leader.parts[1] = {kPart2d, kIntensity, 6144, PixelFormat::mono16, {2, 4, 64, 48}};
  return b;
}

TEST(GvspCodec, MultiPartFramesAreTheSpecificationsBytes) {
  const auto b = make_parts(0x0102);
  const auto all = packets(b);
  // 1400 − 28 − 20 − 8 bytes a packet, each part's last one shorter.
  ASSERT_EQ(all.size(), 5U + 5U + 2U);
  const auto& leader = all.front();
  ASSERT_EQ(leader.size(), 20U + 12 + 2 * 48);
  EXPECT_EQ(load_be<std::uint32_t>(leader, 4), 0x81000002U) << "leader, extended ids, two parts";
  EXPECT_EQ(load_be<std::uint16_t>(leader, 22), 0x000AU);
  EXPECT_EQ(load_be<std::uint64_t>(leader, 32), 0x0005'0000'0000'1800U) << "3D image of 6144 bytes";
  EXPECT_EQ(load_be<std::uint32_t>(leader, 40), 0x011000B8U);
  EXPECT_EQ(load_be<std::uint16_t>(leader, 52), 4U) << "purpose: range";
  EXPECT_EQ(load_be<std::uint32_t>(leader, 56), 64U);
  EXPECT_EQ(load_be<std::uint32_t>(leader, 80 + 8), 0x01100007U);
  EXPECT_EQ(all[1].size(), 1400U - 28);
  EXPECT_EQ(load_be<std::uint32_t>(all[1], 4), 0x87000000U);
  EXPECT_EQ(load_be<std::uint64_t>(all[6], 20), 0x0100'0000'0000'1800U) << "the second part's first bytes";
  EXPECT_EQ(all[5].size(), 28U + 6144 - 4 * 1344) << "no packet has bytes of two parts";
  const auto& trailer = all.back();
  ASSERT_EQ(trailer.size(), 20U + 4 + 2 * 16);
  EXPECT_EQ(load_be<std::uint64_t>(trailer, 24), 0x0005'0000'0000'1800U);
  GvspPacket p;
  ASSERT_TRUE(decode_gvsp(leader, p));
  ASSERT_EQ(p.leader.part_count, 2);
  EXPECT_EQ(p.leader.parts[1].format, PixelFormat::mono16);
  EXPECT_EQ(p.leader.parts[1].length, 6144U);
  EXPECT_EQ(p.leader.parts[1].region, (Region{2, 4, 64, 48}));
  // More parts than bytes, or than we keep: refused.
  auto lie = leader;
  for (const std::uint8_t n : {std::uint8_t{0}, std::uint8_t{3}, std::uint8_t{255}}) {
    lie[7] = n;
    EXPECT_FALSE(decode_gvsp(lie, p)) << int{n};
  }
  lie.resize(20 + 12 + 255 * kGvspPartInfoSize);  // of bytes there are enough
  for (const std::uint8_t n : {std::uint8_t{kMaxParts + 1}, std::uint8_t{255}}) {
    lie[7] = n;
    EXPECT_FALSE(decode_gvsp(lie, p)) << int{n};
  }
}

TEST(GvspAssembler, PutsPartsTogetherInAnyOrderAndAsksForWhatIsMissing) {
  const auto b = make_parts(7);
  GvspAssemblerOptions o;
  o.packet_size = b.packet_size, o.payload_bytes = b.data.size(), o.extended_ids = true;
  o.part_bytes = {6144, 6144};
  GvspAssembler a(o);
  auto all = packets(b);
  std::mt19937 random(5);
  const auto lost = all[8];
  std::vector<std::vector<std::uint8_t>> sent;
  for (std::size_t i = 0; i < all.size(); ++i)
    if (i != 8) sent.push_back(all[i]);
  std::shuffle(sent.begin(), sent.end(), random);
  for (const auto& d : sent) a.push(d, at_ms(0));
  AssembledFrame f;
  EXPECT_FALSE(a.take(at_ms(1), f));
  const auto asked = a.resends(at_ms(30));
  ASSERT_EQ(asked.size(), 1U);
  EXPECT_EQ(asked[0].first_packet, 8U);
  EXPECT_EQ(asked[0].last_packet, 8U);
  // A packet whose offset is not that of its number must not be written anywhere.
  auto lie = lost;
  lie[27] ^= 1;
  a.push(lie, at_ms(31));
  EXPECT_EQ(a.counters().wrong_packet, 1U);
  a.push(lost, at_ms(32));
  ASSERT_TRUE(a.take(at_ms(33), f));
  EXPECT_TRUE(f.complete);
  EXPECT_EQ(f.data, b.data);
  EXPECT_EQ(f.leader.part_count, 2);
  // Frames of one picture are none of these, nor the other way round.
  const auto picture = make_block(8, 128, 96, 1400, true);
  for (const auto& d : packets(picture)) a.push(d, at_ms(40));
  ASSERT_TRUE(a.take(at_ms(900), f));
  EXPECT_FALSE(f.complete);
}

TEST(GvspAssembler, StopsAskingWhenTheCameraNoLongerHasIt) {
  const auto b = make_block(1, 640, 480);
  const auto all = packets(b);
  auto a = assembler_for(b);
  a.push(all[0], at_ms(0));
  a.push(all[9], at_ms(0));
  ASSERT_FALSE(a.resends(at_ms(2)).empty());
  std::array<std::uint8_t, 8> d{};
  ASSERT_EQ(encode_gvsp_status(GvStatus::packet_unavailable, 1, 1, GvspFormat::payload, false, d), 8U);
  a.push(d, at_ms(3));
  EXPECT_TRUE(a.resends(at_ms(100)).empty());
}

TEST(GvspAssembler, IsBoundedUnderAFloodOfBlocks) {
  const auto b = make_block(1, 64, 48);
  auto a = assembler_for(b);
  for (std::uint64_t id = 1; id < 5000; ++id) {
    GvspBlock lone = b;
    lone.block_id = id;
    a.push(packets(lone)[1], at_ms(0));
  }
  EXPECT_EQ(a.counters().overflow, 5000U - 1 - 8);
}

}  // namespace
}  // namespace rigor::gige
