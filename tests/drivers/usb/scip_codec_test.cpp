#include "drivers/usb/scip_codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

namespace rigor::usb {
namespace {

ScipReply one_reply(std::string_view bytes) {
  ScipReplyReader reader;
  reader.push(bytes, 5);
  ScipReply reply;
  EXPECT_TRUE(reader.next(reply));
  return reply;
}

ScanRequest request(char values, std::uint32_t first, std::uint32_t last, std::uint32_t cluster = 1) {
  ScanRequest r;
  r.values = values;
  r.first_step = first;
  r.last_step = last;
  r.cluster = cluster;
  return r;
}

// Numbers of the specification's section 6: 1234 is "CB" in two characters, 5432 is "1Dh" in three,
// 16000000 is "m2@0" in four.
TEST(ScipCodec, WritesNumbersAsTheSpecificationsExamples) {
  for (const auto& [value, text] :
       {std::pair{1234u, "CB"}, std::pair{5432u, "1Dh"}, std::pair{16000000u, "m2@0"}}) {
    std::string out;
    scip_encode(value, static_cast<unsigned>(std::string(text).size()), out);
    EXPECT_EQ(out, text);
    EXPECT_EQ(scip_decode(text), value);
  }
  EXPECT_FALSE(scip_decode("C\x7f"));
  EXPECT_FALSE(scip_decode(""));
}

TEST(ScipCodec, SumsOfRealRepliesFit) {
  EXPECT_EQ(scip_sum("00"), 'P');
  EXPECT_EQ(scip_sum("99"), 'b');
  EXPECT_EQ(scip_sum("0E"), 'e');
  // What a URG-04LX answered (urg_library's wiki).
  const auto p = decode_parameters(
      one_reply("PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\n"
                "AMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"));
  ASSERT_TRUE(p);
  EXPECT_EQ(p->max_range_mm, 5600u);
  EXPECT_EQ(p->front_step, 384u);
  const auto id =
      decode_identity(one_reply("VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX;[\n"
                                "FIRM:3.1.00(18/Jan./2007);`\nPROT:SCIP 2.0;N\nSERI:H0614967;V\n\n"));
  ASSERT_TRUE(id);
  EXPECT_EQ(id->serial, "H0614967");
  EXPECT_EQ(decode_time(one_reply("II\n00P\nTIME:081615;N\n\n")), 0x081615u);
  EXPECT_FALSE(decode_identity(one_reply("VV\n00P\nSERI:H0614968;V\n\n"))) << "a wrong sum was taken";
}

TEST(ScipCodec, ScansComeBackAsTheyWere) {
  std::mt19937 random(7);
  for (const char values : {'D', 'S', 'E'})
    for (const std::uint32_t cluster : {0u, 1u, 3u, 99u})
      for (const std::uint32_t width : {1u, 2u, 21u, 32u, 64u, 682u}) {
        const ScanRequest r = request(values, 44, 43 + width, cluster);
        std::vector<std::uint32_t> range(r.count()), intensity(values == 'E' ? r.count() : 0);
        for (auto& v : range) v = static_cast<std::uint32_t>(random() % (values == 'S' ? 4096 : 262144));
        for (auto& v : intensity) v = static_cast<std::uint32_t>(random() % 262144);
        std::string bytes;
        encode_scan(r, ";label", "99", 0x00abcdef, range, intensity, bytes);
        ScipScan scan;
        ASSERT_EQ(decode_scan(one_reply(bytes), scan), ScanDecode::scan) << bytes;
        EXPECT_EQ(scan.request, r);
        EXPECT_EQ(scan.stamp_ms, 0x00abcdefu);
        EXPECT_EQ(scan.range_mm, range);
        EXPECT_EQ(scan.intensity, intensity);
      }
}

TEST(ScipCodec, AnyChangedByteOfAScanIsSeenOrLeavesItsValues) {
  const ScanRequest r = request('D', 44, 100);
  const std::vector<std::uint32_t> range(r.count(), 1234);
  std::string good;
  encode_scan(r, "", "99", 99, range, {}, good);
  for (std::size_t i = 16; i < good.size(); ++i) {  // the echo has no sum
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ 1);
    ScipReplyReader reader;
    reader.push(bad, 0);
    ScipReply reply;
    while (reader.next(reply)) {
      ScipScan scan;
      if (decode_scan(reply, scan) == ScanDecode::scan) {
        EXPECT_EQ(scan.range_mm, range) << "byte " << i;
      }
    }
  }
}

TEST(ScipCodec, ReaderFindsItsPlaceAgainAfterGarbageHalfLinesAndOversize) {
  const ScanRequest r = request('D', 44, 100);
  const std::vector<std::uint32_t> range(r.count(), 777);
  std::string scan_bytes;
  encode_scan(r, "", "99", 1, range, {}, scan_bytes);
  std::mt19937 random(3);
  std::string stream;
  int sent = 0;
  for (int k = 0; k < 200; ++k) {
    switch (random() % 4) {
      case 0:
        for (int i = 0; i < 50; ++i) stream += static_cast<char>(random());
        break;
      case 1:
        stream += scan_bytes.substr(0, random() % scan_bytes.size());
        break;
      case 2:
        stream += std::string(200 + random() % 100000, 'x');
        break;
      default:
        break;
    }
    stream += "\n\n" + scan_bytes;  // what comes after an empty line is whole
    ++sent;
  }
  ScipReplyReader reader;
  int whole = 0;
  for (std::size_t at = 0; at < stream.size();) {
    const std::size_t n = std::min<std::size_t>(1 + random() % 4000, stream.size() - at);
    reader.push(std::string_view(stream).substr(at, n), static_cast<std::int64_t>(at));
    at += n;
    ScipReply reply;
    while (reader.next(reply)) {
      ScipScan scan;
      whole += decode_scan(reply, scan) == ScanDecode::scan;
    }
  }
  EXPECT_EQ(whole, sent);
  EXPECT_GT(reader.dropped(), 10u);
}

/// What a scanner says of itself goes to terminals and into reports.
TEST(ScipCodec, IdentityHasNoControlCharacters) {
  std::string bytes;
  encode_status("VV", "00", bytes);
  bytes.pop_back();  // fields follow
  encode_field("VEND", "Hokuyo\x1b[2J", bytes);
  encode_field("PROD", "URG\x07", bytes);
  encode_field("SERI", "H\xff\x7f", bytes);
  bytes += '\n';
  ScipReplyReader reader;
  reader.push(bytes, 0);
  ScipReply reply;
  ASSERT_TRUE(reader.next(reply));
  const auto id = decode_identity(reply);
  ASSERT_TRUE(id);
  EXPECT_EQ(id->vendor, "Hokuyo?[2J");
  EXPECT_EQ(id->product, "URG?");
  EXPECT_EQ(id->serial, "H??");
}

TEST(ScipCodec, CommandsAreCheckedAsTheSpecificationSays) {
  const auto status = [](std::string_view line) { return std::string(parse_scip_command(line).status); };
  EXPECT_EQ(status("MD0044072501000"), "00");
  EXPECT_EQ(status("MD0044072501000;my label+1"), "00");
  EXPECT_EQ(status("MDx044072501000"), "01");
  EXPECT_EQ(status("MD0044x72501000"), "02");
  EXPECT_EQ(status("MD00440725x1000"), "03");
  EXPECT_EQ(status("MD0725004401000"), "05");
  EXPECT_EQ(status("MD004407250100"), "0C");
  EXPECT_EQ(status("GD004407250100"), "0F");
  EXPECT_EQ(status("MD0044072501x00"), "06");
  EXPECT_EQ(status("MD0044072501000;12345678901234567"), "0G");
  EXPECT_EQ(status("VV;a-b"), "0H");
  EXPECT_EQ(status("TM3"), "01");
  EXPECT_EQ(status("XY"), "0E");
  EXPECT_EQ(status("V"), "0D");
}

TEST(ScipCodec, TheClockGoesOnOverItsWraps) {
  ScipClock clock;
  std::int64_t t = 16'777'000;
  std::int64_t first = clock.unwrap(static_cast<std::uint32_t>(t % kScipClockModulus));
  for (int i = 0; i < 100; ++i) {
    t += 700'000;
    const std::int64_t u = clock.unwrap(static_cast<std::uint32_t>(t % kScipClockModulus));
    EXPECT_EQ(u - first, t - 16'777'000);
  }
  EXPECT_EQ(clock.unwrap(static_cast<std::uint32_t>((t - 30) % kScipClockModulus)) - first,
            t - 30 - 16'777'000);
}

}  // namespace
}  // namespace rigor::usb
