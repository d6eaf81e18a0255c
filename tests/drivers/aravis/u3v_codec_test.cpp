// USB3 Vision byte by byte, as GenCP 1.2 and USB3 Vision 1.1 lay it out: what both ends of this codec got
// wrong alike would show nowhere else without a third party's client.
#include "drivers/aravis/u3v_codec.h"

#include <gtest/gtest.h>

#include <string_view>

namespace rigor::u3v {
namespace {

std::vector<std::uint8_t> hex(std::string_view text) {
  std::vector<std::uint8_t> out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == ' ') continue;
    out.push_back(static_cast<std::uint8_t>(std::stoul(std::string(text.substr(i++, 2)), nullptr, 16)));
  }
  return out;
}

TEST(U3vCodec, CommandsLieInTheirBytesAsGenCpSays) {
  EXPECT_EQ(encode_read(0x1234, 0x0001020304050607, 0x0890),
            hex("55335643 0040 0008 0c00 3412 0706050403020100 0000 9008"));
  EXPECT_EQ(encode_write(7, 0x00100108, hex("01000000")),
            hex("55335643 0040 0208 0c00 0700 0801100000000000 01000000"));
  EXPECT_EQ(encode_ack({Status::invalid_address, 0x0801, 0x1234, {}}), hex("55335643 0380 0108 0000 3412"));
  EXPECT_EQ(encode_ack(
                {Status::success, static_cast<std::uint16_t>(Command::pending_ack), 7, reserved_and(0x0102)}),
            hex("55335643 0000 0508 0400 0700 0000 0201"));
}

TEST(U3vCodec, EventsLieInTheirBytesAsGenCpSays) {
  const auto bytes = hex("55335645 0000 000c 0c00 0500 0000 0190 0807060504030201");
  EXPECT_EQ(encode_event({kExposureStartEvent, 5, 0x0102030405060708}), bytes);
  const auto e = decode_event(bytes);
  ASSERT_TRUE(e);
  EXPECT_EQ(e->event_id, kExposureStartEvent);
  EXPECT_EQ(e->request_id, 5);
  EXPECT_EQ(e->timestamp_ns, 0x0102030405060708U);
}

TEST(U3vCodec, LeaderAndTrailerLieInTheirBytesAsUsb3VisionSays) {
  const Leader l{3, 0x0102030405060708, PixelFormat::mono16, {2, 4, 0x0140, 0x00C8}};
  const auto leader =
      hex("5533564c 0000 3400 0300000000000000 0000 0100 0807060504030201 07001001"
          "40010000 c8000000 02000000 04000000 0000 0000");
  EXPECT_EQ(encode_leader(l), leader);
  const auto read = decode_leader(leader);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->timestamp_ns, l.timestamp_ns);
  EXPECT_EQ(read->format, l.format);
  EXPECT_EQ(read->region, l.region);
  const auto trailer = hex("55335654 0000 2000 0300000000000000 00a1 0000 0008000000000000 c8000000");
  EXPECT_EQ(encode_trailer({3, 2048, Status::data_discarded, 200}), trailer);
  const auto end = decode_trailer(trailer);
  ASSERT_TRUE(end);
  EXPECT_EQ(end->valid_bytes, 2048U);
  EXPECT_EQ(end->status, Status::data_discarded);
  EXPECT_EQ(end->height_px, 200U);
}

TEST(U3vCodec, ACommandIsAsLongAsItSays) {
  const auto decoded = [](const std::vector<std::uint8_t>& bytes) {
    Request q;
    return decode_request(bytes, q);
  };
  EXPECT_EQ(decoded(hex("55335643 0040 0008 0c00 0100 0000000000000000 0000 0400")), Decoded::ok);
  EXPECT_EQ(decoded(hex("55335643 0040 0008 0c00 0100 0000000000000000 0000 0400 00")), Decoded::bad_length)
      << "a byte more than the header says";
  EXPECT_EQ(decoded(hex("55335643 0040 0008 0c00 0100 0000000000000000 0000 04")), Decoded::bad_length);
  EXPECT_EQ(decoded(hex("55335643 0040 0008 0e00 0100 0000000000000000 0000 0400 0000")), Decoded::bad_length)
      << "READMEM has 12 bytes";
  EXPECT_EQ(decoded(hex("55335643 0040 0208 0800 0100 0000000000000000")), Decoded::bad_length)
      << "WRITEMEM of nothing";
  EXPECT_EQ(decoded(hex("55335643 0040 0208 0900 0100 0000000000000000 ff")), Decoded::ok);
  EXPECT_EQ(decoded(hex("55335643 0040 0008 0c00 01")), Decoded::not_u3v) << "less than a header";
  Request q;
  EXPECT_EQ(decode_request(hex("55335643 0000 0008 0c00 0100 0000000000000000 0000 0400"), q), Decoded::ok);
  EXPECT_FALSE(q.ack_wanted);
  EXPECT_FALSE(decode_leader(hex("5533564c 0000 3400")));
  EXPECT_FALSE(decode_ack(hex("55335643 0000 0108 0400 0100 0000")));
}

}  // namespace
}  // namespace rigor::u3v
