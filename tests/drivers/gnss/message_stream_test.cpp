// Frames in a stream of bytes: split anywhere, between garbage, with lengths and checksums that lie.
#include "drivers/gnss/message_stream.h"

#include <gtest/gtest.h>

#include "drivers/gnss/nmea.h"
#include "tests/drivers/gnss/gnss_test_tools.h"

namespace rigor::gnss {
namespace {

using test::bytes_of;

Buffer mixed() {
  Buffer b;
  append_nav_eoe(b, 1000);
  append_sentence(b, "GNZDA,120000.00,01,02,2024,00,00");
  append_rtcm(b, bytes_of("corrections"));
  NavPvt pvt;
  pvt.itow_ms = 1000;
  append_nav_pvt(b, pvt);
  append_sentence(b, "GNRMC,120000.00,V,,,,,,,010224,,,N,V");
  return b;
}

std::string kinds_of(MessageStream& s) {
  std::string k;
  while (const auto m = s.next())
    k += m->kind == Message::Kind::ubx ? 'u' : m->kind == Message::Kind::nmea ? 'n' : 'r';
  return k;
}

TEST(MessageStream, FindsEachKindHoweverTheStreamIsSplit) {
  const Buffer all = mixed();
  for (std::size_t piece = 1; piece <= all.size(); ++piece) {
    MessageStream s;
    std::string kinds;
    for (std::size_t at = 0; at < all.size(); at += piece) {
      s.add(Bytes(all).subspan(at, std::min(piece, all.size() - at)));
      kinds += kinds_of(s);
    }
    ASSERT_EQ(kinds, "unrun") << piece;
    ASSERT_EQ(s.counters().garbage, 0U) << piece;
    ASSERT_EQ(s.counters().bytes, all.size());
  }
}

TEST(MessageStream, GarbageBetweenMessagesIsCountedAndCostsNone) {
  MessageStream s;
  Buffer b;
  for (int i = 0; i < 5; ++i) {
    for (const int g : {0x00, 0xFF, 0xB5, 0x24, 0x47, 0xD3, 0x41, 0xB5})
      b.push_back(static_cast<std::uint8_t>(g));
    append_nav_eoe(b, 1000);
    b.push_back(0xD3);
    b.push_back('$');
    append_sentence(b, "GNZDA,120000.00,01,02,2024,00,00");
  }
  s.add(b);
  EXPECT_EQ(kinds_of(s), "ununununun");
  EXPECT_EQ(s.counters().garbage, 5U * 10);
}

TEST(MessageStream, ALengthThatLiesCostsItsFrameAlone) {
  Buffer b;
  append_nav_eoe(b, 1);
  const std::size_t liar = b.size();
  append_nav_eoe(b, 2);
  for (int i = 3; i < 600; ++i) append_nav_eoe(b, static_cast<std::uint32_t>(i));
  // Within what a message may have: it waits for 3000 bytes, and finds all that came meanwhile.
  b[liar + 4] = 0xB8, b[liar + 5] = 0x0B;
  MessageStream s;
  s.add(b);
  std::vector<std::uint32_t> got;
  while (const auto m = s.next()) got.push_back(*parse_nav_eoe(m->payload));
  ASSERT_EQ(got.size(), 598U);
  EXPECT_EQ(got[0], 1U);
  EXPECT_EQ(got[1], 3U);
  EXPECT_EQ(s.counters().bad_checksums, 1U);
  // Beyond it: nothing is waited for.
  b[liar + 5] = 0xFF;
  MessageStream quick;
  quick.add(Bytes(b).first(liar + 24));
  EXPECT_EQ(kinds_of(quick), "uu");
  EXPECT_EQ(quick.counters().bad_lengths, 1U);
}

TEST(MessageStream, BrokenChecksumsAreNotTaken) {
  for (std::size_t at = 2; at < 12; ++at) {
    Buffer b;
    append_nav_eoe(b, 0x01020304);
    b[at] ^= 0x10;
    MessageStream s;
    s.add(b);
    EXPECT_EQ(kinds_of(s), "") << at;
    (void)s.finish();
    EXPECT_EQ(kinds_of(s), "") << at;
  }
  for (const char* text :
       {"$GNZDA,120000.00,01,02,2024,00,00*00\r\n", "$GNZDA,120000.00,01,02,2024,00,00\r\n",
        "$GNZDA,120000.00,01,02,2024,00,00*7\r\n", "$GNZDA,120000.00,01,02,2024,00,00*ZZ\r\n"}) {
    MessageStream s;
    s.add(bytes_of(text));
    EXPECT_EQ(kinds_of(s), "") << text;
    EXPECT_EQ(s.counters().bad_checksums, 1U) << text;
  }
}

TEST(MessageStream, ASentenceThatIsCutOffEndsAtTheNext) {
  Buffer b;
  for (const char c : std::string("$GNRMC,1200")) b.push_back(static_cast<std::uint8_t>(c));
  append_sentence(b, "GNZDA,120000.00,01,02,2024,00,00");
  MessageStream s;
  s.add(b);
  const auto m = s.next();
  ASSERT_TRUE(m);
  EXPECT_EQ(m->text, "GNZDA,120000.00,01,02,2024,00,00");
  EXPECT_EQ(s.counters().garbage, 11U);
}

TEST(MessageStream, ALineWithoutAnEndIsGivenUp) {
  MessageStream s;
  Buffer b(300, 'A');
  b[0] = '$';
  append_nav_eoe(b, 7);
  s.add(b);
  EXPECT_EQ(kinds_of(s), "u");
}

TEST(MessageStream, TheEndOfARecordingHidesNoMessage) {
  Buffer b{0xB5, 0x62, 0x01, 0x07, 0x5C, 0x00, 1, 2, 3};  // a frame that breaks off
  append_nav_eoe(b, 7);
  MessageStream s;
  s.add(b);
  EXPECT_EQ(kinds_of(s), "");
  EXPECT_TRUE(s.finish());
  EXPECT_EQ(kinds_of(s), "u");
}

TEST(MessageStream, ChecksumsOfPublishedMessages) {
  // UBX-CFG-MSG of u-blox's protocol description: switches NMEA GLL off.
  const std::uint8_t cfg[] = {0xB5, 0x62, 0x06, 0x01, 0x03, 0x00, 0xF0, 0x01, 0x00, 0xFB, 0x11};
  Buffer made;
  append_cfg_msg(made, ubx_id(0xF0, 0x01), 0);
  EXPECT_EQ(made, Buffer(std::begin(cfg), std::end(cfg)));
  // RTCM 10403, example of message 1005.
  const std::uint8_t rtcm[] = {0xD3, 0x00, 0x13, 0x3E, 0xD7, 0xD3, 0x02, 0x02, 0x98, 0x0E, 0xDE, 0xEF, 0x34,
                               0xB4, 0xBD, 0x62, 0xAC, 0x09, 0x41, 0x98, 0x6F, 0x33, 0x36, 0x0B, 0x98};
  MessageStream s;
  s.add(rtcm);
  EXPECT_EQ(kinds_of(s), "r");
  Buffer again;
  append_rtcm(again, Bytes(rtcm).subspan(3, 19));
  EXPECT_EQ(again, Buffer(std::begin(rtcm), std::end(rtcm)));
}

}  // namespace
}  // namespace rigor::gnss
