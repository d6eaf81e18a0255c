// GVCP as bytes: what one side encodes the other decodes, and nothing malformed gets through.
#include "drivers/aravis/gvcp_codec.h"

#include <gtest/gtest.h>

#include <numeric>

namespace rigor::gige {
namespace {

GvcpRequest decoded(const Datagram& d) {
  GvcpRequest q;
  EXPECT_EQ(decode_gvcp_request(d, q), DecodeStatus::ok);
  return q;
}

GvcpAck decoded_ack(const Datagram& d) {
  GvcpAck a;
  EXPECT_EQ(decode_gvcp_ack(d, a), DecodeStatus::ok);
  return a;
}

TEST(GvcpCodec, ReadRegisterIsTheSpecificationsBytes) {
  const std::uint32_t address = 0x0A00;
  const Datagram expected{0x42, 0x01, 0x00, 0x80, 0x00, 0x04, 0x12, 0x34, 0x00, 0x00, 0x0A, 0x00};
  EXPECT_EQ(encode_read_register_cmd(0x1234, std::span(&address, 1)), expected);
}

TEST(GvcpCodec, CommandsAreTheSpecificationsBytes) {
  EXPECT_EQ(encode_action_cmd(0x1234, {0x01020304, 0x05060708, 0x090A0B0C, 0x1112131415161718}),
            (Datagram{0x42, 0x81, 0x01, 0x00, 0x00, 0x14, 0x12, 0x34, 0x01, 0x02, 0x03, 0x04, 0x05, 0x06,
                      0x07, 0x08, 0x09, 0x0A, 0x0B, 0x0C, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18}));
  EXPECT_EQ(encode_packet_resend_cmd(0x1234, {1, 0x0203, 0x040506, 0x070809, false}),
            (Datagram{0x42, 0x00, 0x00, 0x40, 0x00, 0x0C, 0x12, 0x34, 0x00, 0x01,
                      0x02, 0x03, 0x00, 0x04, 0x05, 0x06, 0x00, 0x07, 0x08, 0x09}));
  // With 64-bit block ids the packets come first, and the block behind them.
  EXPECT_EQ(encode_packet_resend_cmd(0x1234, {1, 0x0102030405060708, 9, 10, true}),
            (Datagram{0x42, 0x10, 0x00, 0x40, 0x00, 0x14, 0x12, 0x34, 0x00, 0x01, 0x00, 0x00, 0x00, 0x00,
                      0x00, 0x09, 0x00, 0x00, 0x00, 0x0A, 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08}));
  Datagram force(kGvcpHeaderSize + 56);
  force[0] = 0x42, force[1] = 1, force[3] = 0x04, force[5] = 56, force[7] = 1;
  force[8 + 7] = 0xAA, force[8 + 23] = 0xBB, force[8 + 39] = 0xCC, force[8 + 55] = 0xDD;
  const auto q = decoded(force);
  const auto& f = std::get<ForceIpCmd>(q.body);
  EXPECT_EQ(f.mac[5], 0xAA);
  EXPECT_EQ(f.ip, 0xBBU);
  EXPECT_EQ(f.mask, 0xCCU);
  EXPECT_EQ(f.gateway, 0xDDU);
}

TEST(GvcpCodec, ResendsHavePacketIdsOf24BitsInOrder) {
  const auto q = decoded(encode_packet_resend_cmd(1, {0, 5, 0x040506, 0x070809, false}));
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).first_packet, 0x040506U);
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).last_packet, 0x070809U);
  GvcpRequest refused;
  EXPECT_EQ(decode_gvcp_request(encode_packet_resend_cmd(1, {0, 5, 7, 6, false}), refused),
            DecodeStatus::bad_payload)
      << "the first behind the last";
}

TEST(GvcpCodec, SizesOfMemoryAreBoundedAndAligned) {
  const auto status = [](const Datagram& d) {
    GvcpRequest q;
    return decode_gvcp_request(d, q);
  };
  EXPECT_EQ(status(encode_read_memory_cmd(1, {0, 4})), DecodeStatus::ok);
  EXPECT_EQ(status(encode_read_memory_cmd(1, {0, 0})), DecodeStatus::bad_payload);
  EXPECT_EQ(status(encode_read_memory_cmd(1, {0, kGvcpMaxReadMemory})), DecodeStatus::ok);
  EXPECT_EQ(status(encode_read_memory_cmd(1, {0, kGvcpMaxReadMemory + 4})), DecodeStatus::bad_payload);
  EXPECT_EQ(status(encode_read_memory_cmd(1, {2, 4})), DecodeStatus::bad_alignment);
  EXPECT_EQ(status(encode_read_memory_cmd(1, {0, 6})), DecodeStatus::bad_alignment);
  const std::array<std::uint8_t, 6> six{};
  EXPECT_EQ(status(encode_write_memory_cmd(1, 0, six)), DecodeStatus::bad_alignment);
  EXPECT_EQ(status(encode_write_memory_cmd(1, 0, Bytes(six).first(4))), DecodeStatus::ok);
  auto zero = encode_read_memory_cmd(1, {0, 4});
  zero[6] = zero[7] = 0;
  EXPECT_EQ(status(zero), DecodeStatus::not_gvcp) << "request 0 is none";
}

TEST(GvcpCodec, AcknowledgesAreTheSpecificationsBytes) {
  EXPECT_EQ(encode_write_ack(GvStatus::write_protect, GvcpCommand::write_register_ack, 5, 0x0102),
            (Datagram{0x80, 0x04, 0x00, 0x83, 0x00, 0x04, 0x00, 0x05, 0x00, 0x00, 0x01, 0x02}));
  EXPECT_EQ(encode_pending_ack(6, 250),
            (Datagram{0x00, 0x00, 0x00, 0x89, 0x00, 0x04, 0x00, 0x06, 0x00, 0x00, 0x00, 0xFA}));
  DiscoveryAck d;
  d.version_major = 1, d.version_minor = 2, d.device_mode = 0x80000001;
  d.mac = {2, 0, 127, 0, 0, 1};
  d.supported_ip_configuration = 4, d.current_ip_configuration = 6;
  d.ip = 0x7F000002, d.mask = 0xFF000000, d.gateway = 5;
  d.manufacturer = "a", d.model = std::string(32, 'b'), d.version = "c", d.manufacturer_info = "d";
  d.serial = "e", d.user_name = "f";
  const auto ack = encode_discovery_ack(3, d);
  const Bytes p = Bytes(ack).subspan(kGvcpHeaderSize);
  EXPECT_EQ(load_be<std::uint16_t>(p, 2), 2);
  EXPECT_EQ(load_be<std::uint32_t>(p, 4), 0x80000001U);
  EXPECT_TRUE(std::equal(d.mac.begin(), d.mac.end(), p.begin() + 10));
  EXPECT_EQ(load_be<std::uint32_t>(p, 16), 4U);
  EXPECT_EQ(load_be<std::uint32_t>(p, 20), 6U);
  EXPECT_EQ(load_be<std::uint32_t>(p, 36), 0x7F000002U);
  EXPECT_EQ(load_be<std::uint32_t>(p, 52), 0xFF000000U);
  EXPECT_EQ(load_be<std::uint32_t>(p, 68), 5U);
  EXPECT_EQ(p[72], 'a');
  EXPECT_EQ(p[104], 'b');
  EXPECT_EQ(p[104 + 30], 'b');
  EXPECT_EQ(p[104 + 31], 0) << "the field ends with a 0";
  EXPECT_EQ(p[136], 'c');
  EXPECT_EQ(p[168], 'd');
  EXPECT_EQ(p[216], 'e');
  EXPECT_EQ(p[232], 'f');
}

TEST(GvcpCodec, CommandsComeBackAsTheyWent) {
  const std::array<std::uint32_t, 3> addresses{0x0, 0x938, 0x10008};
  auto q = decoded(encode_read_register_cmd(7, addresses));
  EXPECT_EQ(q.request_id, 7);
  EXPECT_TRUE(q.ack_required());
  const auto read = std::get<ReadRegisterCmd>(q.body).addresses.view();
  EXPECT_TRUE(std::equal(read.begin(), read.end(), addresses.begin(), addresses.end()));

  const std::array<RegisterWrite, 2> writes{{{0xA00, 2}, {0xD00, 0xC350}}};
  q = decoded(encode_write_register_cmd(8, writes));
  ASSERT_EQ(std::get<WriteRegisterCmd>(q.body).writes.count, 2U);
  EXPECT_EQ(std::get<WriteRegisterCmd>(q.body).writes.items[1].address, 0xD00U);
  EXPECT_EQ(std::get<WriteRegisterCmd>(q.body).writes.items[1].value, 0xC350U);

  q = decoded(encode_read_memory_cmd(9, {0x200, 512}));
  EXPECT_EQ(std::get<ReadMemoryCmd>(q.body).address, 0x200U);
  EXPECT_EQ(std::get<ReadMemoryCmd>(q.body).count, 512);

  const std::array<std::uint8_t, 8> data{1, 2, 3, 4, 5, 6, 7, 8};
  const auto wm = encode_write_memory_cmd(10, 0x10200, data);
  q = decoded(wm);
  const auto& m = std::get<WriteMemoryCmd>(q.body);
  EXPECT_EQ(m.address, 0x10200U);
  EXPECT_TRUE(std::equal(m.data.begin(), m.data.end(), data.begin(), data.end()));

  q = decoded(encode_packet_resend_cmd(11, {0, 65535, 3, 0xABCDEF, false}));
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).block_id, 65535U);
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).last_packet, 0xABCDEFU);
  EXPECT_FALSE(q.ack_required());
  q = decoded(encode_packet_resend_cmd(12, {0, 0x123456789ABCULL, 0x1000000, 0x1000001, true}));
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).block_id, 0x123456789ABCULL);
  EXPECT_EQ(std::get<PacketResendCmd>(q.body).first_packet, 0x1000000U);

  q = decoded(encode_action_cmd(13, {1, 2, 3, {}}));
  EXPECT_EQ(std::get<ActionCmd>(q.body).group_mask, 3U);
  EXPECT_FALSE(std::get<ActionCmd>(q.body).time_ticks);
  auto scheduled = encode_action_cmd(13, {1, 2, 3, 0x0102030405060708});
  EXPECT_EQ(scheduled.size(), kGvcpHeaderSize + 20);
  EXPECT_EQ(scheduled[1], 0x81);
  EXPECT_EQ(std::get<ActionCmd>(decoded(scheduled).body).time_ticks, 0x0102030405060708U);
  scheduled[1] = 0x01;  // the time is there and does not count
  EXPECT_FALSE(std::get<ActionCmd>(decoded(scheduled).body).time_ticks);
  auto without = encode_action_cmd(13, {1, 2, 3, {}});
  without[1] = 0x81;  // and one that is missing
  EXPECT_EQ(decode_gvcp_request(without, q), DecodeStatus::bad_payload);
  EXPECT_TRUE(std::holds_alternative<DiscoveryCmd>(decoded(encode_discovery_cmd(14)).body));
}

TEST(GvcpCodec, AcknowledgesOfAnotherLengthAreRefused) {
  const auto status = [](const Datagram& d) {
    GvcpAck a;
    return decode_gvcp_ack(d, a);
  };
  const std::array<std::uint8_t, 8> data{};
  const auto ack = [&](GvcpCommand c, std::size_t bytes) {
    return encode_ack(GvStatus::success, static_cast<std::uint16_t>(c), 1, Bytes(data).first(bytes));
  };
  EXPECT_EQ(status(ack(GvcpCommand::read_register_ack, 8)), DecodeStatus::ok);
  EXPECT_EQ(status(ack(GvcpCommand::read_register_ack, 6)), DecodeStatus::bad_payload) << "half a register";
  EXPECT_EQ(status(ack(GvcpCommand::write_register_ack, 8)), DecodeStatus::bad_payload);
  EXPECT_EQ(status(ack(GvcpCommand::write_memory_ack, 2)), DecodeStatus::bad_payload);
  EXPECT_EQ(status(ack(GvcpCommand::read_memory_ack, 4)), DecodeStatus::bad_payload) << "an address alone";
  auto longer = ack(GvcpCommand::read_register_ack, 8);
  longer.push_back(0);
  EXPECT_EQ(status(longer), DecodeStatus::not_gvcp) << "more than its header says";
}

TEST(GvcpCodec, AcknowledgesComeBackAsTheyWent) {
  DiscoveryAck d;
  d.version_major = 1, d.version_minor = 2, d.device_mode = 0x80000001;
  d.mac = {2, 0, 127, 0, 0, 1};
  d.ip = 0x7F000002, d.mask = 0xFF000000, d.gateway = 5;
  d.supported_ip_configuration = 4, d.current_ip_configuration = 4;
  d.manufacturer = "Rigor", d.model = "m", d.version = "v", d.manufacturer_info = std::string(60, 'x');
  d.serial = "S1", d.user_name = "left";
  const auto bytes = encode_discovery_ack(3, d);
  EXPECT_EQ(bytes.size(), kGvcpHeaderSize + kDiscoveryAckSize);
  const auto back = std::get<DiscoveryAck>(decoded_ack(bytes).body);
  EXPECT_EQ(back.mac, d.mac);
  EXPECT_EQ(back.ip, d.ip);
  EXPECT_EQ(back.mask, d.mask);
  EXPECT_EQ(back.gateway, d.gateway);
  EXPECT_EQ(back.serial, "S1");
  EXPECT_EQ(back.user_name, "left");
  EXPECT_EQ(back.manufacturer_info, std::string(47, 'x'));  // cut, with its terminator kept

  const std::array<std::uint32_t, 2> values{5, 0xFFFFFFFF};
  const auto r = decoded_ack(encode_read_register_ack(4, values));
  EXPECT_EQ(std::get<ReadRegisterAck>(r.body).values.items[1], 0xFFFFFFFFU);
  const auto w =
      decoded_ack(encode_write_ack(GvStatus::write_protect, GvcpCommand::write_register_ack, 5, 1));
  EXPECT_EQ(w.status, GvStatus::write_protect);
  EXPECT_EQ(std::get<WriteRegisterAck>(w.body).index, 1);
  const auto p = decoded_ack(encode_pending_ack(6, 250));
  EXPECT_EQ(std::get<PendingAck>(p.body).time_to_completion_ms, 250);
  const auto e = decoded_ack(encode_ack(GvStatus::access_denied, 0x81, 7, {}));
  EXPECT_EQ(e.status, GvStatus::access_denied);
}

TEST(GvcpCodec, EveryTruncationIsRefused) {
  const std::array<std::uint32_t, 3> addresses{0x0, 0x938, 0x10008};
  const std::array<RegisterWrite, 2> writes{{{0xA00, 2}, {0xD00, 0xC350}}};
  const std::array<std::uint8_t, 8> data{};
  for (const auto& whole : {encode_read_register_cmd(1, addresses), encode_write_register_cmd(1, writes),
                            encode_read_memory_cmd(1, {0, 4}), encode_write_memory_cmd(1, 0, data),
                            encode_packet_resend_cmd(1, {0, 1, 1, 2, false})}) {
    for (std::size_t n = 0; n < whole.size(); ++n) {
      GvcpRequest q;
      // The length field names the whole: a part of it is none of ours.
      EXPECT_EQ(decode_gvcp_request(Bytes(whole).first(n), q), DecodeStatus::not_gvcp);
      if (n < kGvcpHeaderSize) continue;
      // And where the length field lies along with it, the payload does not fit its command.
      Datagram lie(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));
      store_be(MutableBytes(lie), 4, static_cast<std::uint16_t>(n - kGvcpHeaderSize));
      const auto s = decode_gvcp_request(lie, q);
      if (s == DecodeStatus::ok) {
        EXPECT_EQ((n - kGvcpHeaderSize) % 4, 0U);  // fewer registers or data, but whole ones
        EXPECT_TRUE(std::holds_alternative<ReadRegisterCmd>(q.body) ||
                    std::holds_alternative<WriteRegisterCmd>(q.body) ||
                    std::holds_alternative<WriteMemoryCmd>(q.body));
      }
    }
  }
}

TEST(GvcpCodec, BadAlignmentKeyAndIdAreToldApart) {
  GvcpRequest q;
  const std::uint32_t odd = 0x0A02;
  EXPECT_EQ(decode_gvcp_request(encode_read_register_cmd(1, std::span(&odd, 1)), q),
            DecodeStatus::bad_alignment);
  EXPECT_EQ(decode_gvcp_request(encode_read_memory_cmd(1, {0x200, 510}), q), DecodeStatus::bad_alignment);
  EXPECT_EQ(decode_gvcp_request(encode_read_memory_cmd(1, {0x200, 540}), q), DecodeStatus::bad_payload);
  EXPECT_EQ(decode_gvcp_request(encode_packet_resend_cmd(1, {0, 1, 5, 4, false}), q),
            DecodeStatus::bad_payload);
  EXPECT_EQ(decode_gvcp_request(encode_discovery_cmd(0), q), DecodeStatus::not_gvcp);
  auto key = encode_discovery_cmd(1);
  key[0] = 0x43;
  EXPECT_EQ(decode_gvcp_request(key, q), DecodeStatus::not_gvcp);
  const std::vector<std::uint32_t> many(136, 0);
  EXPECT_TRUE(encode_read_register_cmd(1, many).empty());
}

TEST(GvcpCodec, AcknowledgesWithoutTheirPayloadAreRefused) {
  GvcpAck a;
  EXPECT_EQ(decode_gvcp_ack(encode_ack(GvStatus::success, 0x81, 7, {}), a), DecodeStatus::bad_payload);
  const std::array<std::uint8_t, 100> short_discovery{};
  EXPECT_EQ(decode_gvcp_ack(encode_ack(GvStatus::success, 0x03, 7, short_discovery), a),
            DecodeStatus::bad_payload);
  EXPECT_EQ(decode_gvcp_ack(encode_discovery_cmd(1), a), DecodeStatus::not_gvcp);
}

TEST(GvcpCodec, NamesThatDevicesGiveAreTextForTerminalsJsonAndXml) {
  DiscoveryAck d;
  d.manufacturer = "Bl\xC3\xA4u";                 // UTF-8 stays
  d.model = "red\x1B[31m\x7F";                    // an escape sequence
  d.serial = "\xFF\xC0\xAF\xED\xA0\x80";          // no UTF-8: a stray byte, overlong, a surrogate
  d.user_name = "\xC2\x85 \xEF\xBF\xBE cut\xC3";  // a C1 control, a noncharacter, half a letter
  const auto back = std::get<DiscoveryAck>(decoded_ack(encode_discovery_ack(3, d)).body);
  EXPECT_EQ(back.manufacturer, "Bl\xC3\xA4u");
  EXPECT_EQ(back.model, "red?[31m?");
  EXPECT_EQ(back.serial, "??????");
  EXPECT_EQ(back.user_name, "?? ??? cut?");
}

}  // namespace
}  // namespace rigor::gige
