#include "drivers/sick/cola_b.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string_view>

#include "drivers/sick/telegram.h"

namespace rigor::sick {
namespace {

Buffer bytes_of(std::string_view text) { return {text.begin(), text.end()}; }
std::string text_of(Bytes b) { return {b.begin(), b.end()}; }
Buffer framed(std::string_view body) {
  Buffer out;
  append_frame(bytes_of(body), out);
  return out;
}

// The manual's own example (section 4.1.1: log in as authorised client), with its checksum.
TEST(ColaB, FramesAsTheManualDoes) {
  const Buffer values = {0x03, 0xF4, 0x72, 0x47, 0x44};
  Buffer out;
  append_telegram(out, "sMN", "SetAccessMode", values);
  const Buffer expected = {0x02, 0x02, 0x02, 0x02, 0x00, 0x00, 0x00, 0x17, 0x73, 0x4D, 0x4E,
                           0x20, 0x53, 0x65, 0x74, 0x41, 0x63, 0x63, 0x65, 0x73, 0x73, 0x4D,
                           0x6F, 0x64, 0x65, 0x20, 0x03, 0xF4, 0x72, 0x47, 0x44, 0xB3};
  EXPECT_EQ(out, expected);
}

TEST(ColaB, TakesTelegramsFromPiecesOfAnySize) {
  Buffer stream;
  std::vector<std::string> bodies;
  for (int i = 0; i < 40; ++i) {
    bodies.push_back("sSN number_" + std::string(static_cast<std::size_t>(i * 7), 'x') + std::to_string(i));
    append_frame(bytes_of(bodies.back()), stream);
  }
  for (const std::size_t piece : {1u, 2u, 3u, 7u, 64u, 5000u}) {
    FrameParser parser;
    std::vector<std::string> seen;
    for (std::size_t at = 0; at < stream.size(); at += piece) {
      parser.add(Bytes(stream).subspan(at, std::min(piece, stream.size() - at)));
      for (Bytes b = parser.next(); b.data(); b = parser.next()) seen.push_back(text_of(b));
    }
    EXPECT_EQ(seen, bodies) << "in pieces of " << piece;
    EXPECT_EQ(parser.skipped_bytes(), 0u);
    EXPECT_EQ(parser.pending(), 0u);
  }
}

TEST(ColaB, FindsTheTelegramBehindGarbage) {
  Buffer stream = bytes_of("HTTP/1.1 400");
  stream.insert(stream.end(), {2, 2, 2, 2, 2, 2});  // two marks too many
  const Buffer good = framed("sRA STlms 7");
  stream.insert(stream.end(), good.begin() + 4, good.end());  // the last four of the six are its mark
  stream.insert(stream.end(), {2, 2, 2});
  FrameParser parser;
  parser.add(stream);
  EXPECT_EQ(text_of(parser.next()), "sRA STlms 7");
  EXPECT_FALSE(parser.next().data());
  EXPECT_EQ(parser.pending(), 3u);  // may become a mark
  EXPECT_EQ(parser.skipped_bytes(), 12u + 2u);
}

TEST(ColaB, ABadChecksumCostsOneTelegram) {
  Buffer stream = framed("sSN first");
  Buffer bad = framed("sSN second");
  bad.back() ^= 0x10;
  stream.insert(stream.end(), bad.begin(), bad.end());
  const Buffer third = framed("sSN third");
  stream.insert(stream.end(), third.begin(), third.end());
  FrameParser parser;
  parser.add(stream);
  EXPECT_EQ(text_of(parser.next()), "sSN first");
  EXPECT_EQ(text_of(parser.next()), "sSN third");
  EXPECT_EQ(parser.bad_checksums(), 1u);
  EXPECT_EQ(parser.skipped_bytes(), bad.size());
}

TEST(ColaB, ALengthThatNobodySendsTakesNoMemory) {
  FrameParser parser(100);
  Buffer stream = {2, 2, 2, 2, 0x7F, 0xFF, 0xFF, 0xFF, 's', 'S', 'N'};
  const Buffer zero = {2, 2, 2, 2, 0, 0, 0, 0, 0};
  stream.insert(stream.end(), zero.begin(), zero.end());
  const Buffer good = framed("sSN after");
  stream.insert(stream.end(), good.begin(), good.end());
  parser.add(stream);
  EXPECT_EQ(text_of(parser.next()), "sSN after");
  EXPECT_EQ(parser.bad_lengths(), 2u);
  const Buffer big = framed(std::string(101, 'x'));
  parser.add(big);
  EXPECT_FALSE(parser.next().data());
  EXPECT_EQ(parser.bad_lengths(), 3u);
}

TEST(ColaB, HalfATelegramWaitsForItsRest) {
  const Buffer good = framed("sRA DeviceIdent");
  FrameParser parser;
  for (std::size_t i = 0; i + 1 < good.size(); ++i) {
    parser.add(Bytes(good).subspan(i, 1));
    ASSERT_FALSE(parser.next().data()) << i;
  }
  EXPECT_EQ(parser.pending(), good.size() - 1);
  parser.add(Bytes(good).last(1));
  EXPECT_EQ(text_of(parser.next()), "sRA DeviceIdent");
}

// Whatever the noise, what is a telegram is found when it does not begin within a false one; and nothing
// that was not sent comes out.
TEST(ColaB, SurvivesNoise) {
  std::mt19937 random(7);
  for (int round = 0; round < 200; ++round) {
    Buffer stream(random() % 300);
    for (auto& b : stream) b = static_cast<std::uint8_t>(random() % 4);  // many 02
    const std::size_t noise = stream.size();
    std::vector<std::string> sent;
    for (int i = 0; i < 3; ++i) {
      sent.push_back("sSN after_noise " + std::to_string(round * 3 + i));
      append_frame(bytes_of(sent.back()), stream);
    }
    FrameParser parser(1000);
    std::vector<std::string> seen;
    for (std::size_t at = 0; at < stream.size(); at += 11) {
      parser.add(Bytes(stream).subspan(at, std::min<std::size_t>(11, stream.size() - at)));
      for (Bytes b = parser.next(); b.data(); b = parser.next())
        if (text_of(b).starts_with("sSN after")) seen.push_back(text_of(b));
    }
    if (parser.pending() == 0) {
      EXPECT_EQ(seen, sent) << "behind " << noise << " bytes of noise";
    }
  }
}

TEST(Telegrams, AreParsedAsTheyWereRecorded) {
  const Buffer error = {'s', 'F', 'A', 0, 3};
  const auto e = parse_telegram(error);
  ASSERT_TRUE(e);
  EXPECT_TRUE(e->error());
  EXPECT_EQ(e->error_code(), 3);
  EXPECT_EQ(sopas_error_name(3), "VARIABLE_UNKNOWNINDEX");
  const Buffer run_bytes = bytes_of("sMN Run"), stream_bytes = bytes_of("sEA LMDscandata \x01");
  const auto run = parse_telegram(run_bytes);
  ASSERT_TRUE(run);
  EXPECT_TRUE(run->is("sMN", "Run"));
  EXPECT_TRUE(run->values.empty());
  const auto t = parse_telegram(stream_bytes);
  ASSERT_TRUE(t);
  EXPECT_TRUE(t->is("sEA", "LMDscandata"));
  ASSERT_EQ(t->values.size(), 1u);
  EXPECT_EQ(t->values[0], 1);
}

TEST(Telegrams, RefuseWhatIsNone) {
  for (const auto* text : {"", "s", "sRN", "sRN ", "xRN a", "sRNx", "sRN  a", "sRN a\x01"})
    EXPECT_FALSE(parse_telegram(bytes_of(text))) << text;
  EXPECT_EQ(parse_telegram(bytes_of("sFA"))->error_code(), 6);
}

}  // namespace
}  // namespace rigor::sick
