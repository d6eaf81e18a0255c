#include "drivers/sick/scanner_device.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/sick/client_dialog.h"
#include "tests/drivers/sick/recorded_dialogue.h"

namespace rigor::sick {
namespace {

ScannerConfig lms111() {
  ScannerConfig c = scanner_config(Family::lms1xx);
  c.pattern = {-45, 0.5, 541};
  return c;
}
ScannerConfig of_recording(const test::Recording& r) {
  const bool tim = r.wide_rssi;
  ScannerConfig c = scanner_config(tim ? Family::tim : Family::lms5xx);
  c.pattern = {r.start_deg, tim ? 1.0 / 3 : 1.0 / 6, static_cast<std::uint32_t>(r.beams)};
  c.scan_frequency_hz = r.frequency_hz;
  c.serial_number = r.serial_number;
  if (!tim) c.location = "SN 18110550";
  return c;
}

class Talk {
 public:
  explicit Talk(ScannerConfig c) : device(std::move(c)) {}
  Buffer ask(std::string_view body_text) {
    return ask(Bytes(reinterpret_cast<const std::uint8_t*>(body_text.data()), body_text.size()));
  }
  Buffer ask(Bytes body) {
    Buffer out;
    device.answer(session, body, DeviceTime(3'600'000'000'000), out);
    FrameParser parser;
    parser.add(out);
    const Bytes b = parser.next();
    EXPECT_TRUE(b.data());
    const Buffer answer(b.begin(), b.end());
    EXPECT_FALSE(parser.next().data()) << "more than one answer";
    return answer;
  }
  void log_in() { (void)ask(std::string_view("sMN SetAccessMode \x03\xF4\x72\x47\x44", 23)); }
  ScannerDevice device;
  Session session;
};
std::string text_of(const Buffer& b) { return {b.begin(), b.end()}; }
Buffer error(std::uint8_t code) { return {'s', 'F', 'A', 0, code}; }
using namespace std::string_view_literals;

// SICK's driver asked real devices, and they answered. The emulated ones are asked the same, byte for byte,
// and answer the same, but for what a device alone knows (hours, switch-ons, its state, its fields).
class RecordedDialogue : public testing::TestWithParam<test::Recording> {};

TEST_P(RecordedDialogue, IsAnsweredAsTheDeviceDid) {
  const auto& r = GetParam();
  RIGOR_SKIP_WITHOUT_RECORDING(r);
  Talk talk(of_recording(r));
  FrameParser parser;
  std::vector<Buffer> requests, answers;
  for (const auto& payload : test::read_payloads(test::recording_path(r))) {
    parser.add(payload);
    for (Bytes b = parser.next(); b.data(); b = parser.next()) {
      const auto t = parse_telegram(b);
      ASSERT_TRUE(t);
      const bool event = t->type == "sSN";
      const bool request = t->type == "sRN" || t->type == "sWN" || t->type == "sMN" || t->type == "sEN";
      if (!event) (request ? requests : answers).emplace_back(b.begin(), b.end());
    }
  }
  ASSERT_EQ(requests.size(), answers.size());
  ASSERT_GT(requests.size(), 20u);
  std::size_t equal = 0;
  for (std::size_t i = 0; i < requests.size(); ++i) {
    const auto asked = parse_telegram(requests[i]);
    const Buffer got = talk.ask(requests[i]);
    const std::string name(asked->name);
    if (name.starts_with("field")) {
      EXPECT_EQ(got, error(3)) << name;  // no fields: as the LMS511 says of those it lacks
      continue;
    }
    const auto said = parse_telegram(got), recorded = parse_telegram(answers[i]);
    ASSERT_TRUE(said && recorded);
    EXPECT_EQ(said->type, recorded->type) << name;
    EXPECT_EQ(said->name, recorded->name);
    const bool own =
        name == "ODoprh" || name == "ODpwrc" || name == "SCdevicestate" || name == "LIDinputstate";
    if (own) continue;
    EXPECT_EQ(text_of(got), text_of(answers[i])) << name;
    ++equal;
  }
  EXPECT_GE(equal, 14u);
  EXPECT_TRUE(talk.session.scans);
  EXPECT_TRUE(talk.device.measuring());
  EXPECT_EQ(talk.session.level, 0) << "`Run` ends the log-in";
}

// And its scans have the layout of the recorded ones: channels, names, scales, angles, blocks, length.
TEST_P(RecordedDialogue, ItsScansAreLaidOutAsRecorded) {
  const auto& r = GetParam();
  RIGOR_SKIP_WITHOUT_RECORDING(r);
  ScannerConfig c = of_recording(r);
  c.distance_scale = 1;
  Talk talk(c);
  CloudMaker clouds;
  MicrosecondClock clock;
  FrameParser parser;
  std::vector<std::byte> memory(2000 * sizeof(LidarPoint));
  std::size_t scans = 0;
  for (const auto& payload : test::read_payloads(test::recording_path(r))) {
    parser.add(payload);
    const Bytes b = parser.next();
    ASSERT_TRUE(b.data());
    const auto t = parse_telegram(b);
    if (t->type == "sWN" || t->name == "SetAccessMode") (void)talk.ask(Buffer(b.begin(), b.end()));
    if (!t->is("sSN", "LMDscandata")) continue;
    ScanData recorded;
    ASSERT_EQ(decode_scan(t->values, recorded), ScanError::none);
    std::uint32_t count = 0;
    ASSERT_TRUE(clouds.fill(recorded, scan_instants(recorded, clock).beam_step, memory, count));
    talk.device.set_scan({reinterpret_cast<const LidarPoint*>(memory.data()), count}, scans, DeviceTime(0),
                         DeviceTime(1));
    Buffer out;
    talk.device.append_scan(out);
    ASSERT_EQ(out.size(), payload.size());
    FrameParser own;
    own.add(out);
    const Bytes again = own.next();
    ScanData made;
    ASSERT_EQ(decode_scan(parse_telegram(again)->values, made), ScanError::none);
    ASSERT_EQ(made.channels16.size(), recorded.channels16.size());
    EXPECT_EQ(made.measurement_frequency_100hz, recorded.measurement_frequency_100hz);
    for (std::size_t i = 0; i < made.channels16.size(); ++i) {
      const auto &m = made.channels16[i], &w = recorded.channels16[i];
      EXPECT_EQ(m.text(), w.text());
      EXPECT_EQ(m.start_deg_e4, w.start_deg_e4);
      EXPECT_EQ(m.step_deg_e4, w.step_deg_e4);
      // Ranges and RSSI of a device's own scan survive the way to points and back.
      for (std::size_t k = 0; k < m.values.size(); ++k)
        if (recorded.channels16[0].values[k] >= kFirstRange) {
          ASSERT_EQ(m.values[k], w.values[k]) << "scan " << scans << " beam " << k;
        }
    }
    for (std::size_t i = 0; i < made.channels8.size(); ++i)
      for (std::size_t k = 0; k < made.channels8[i].values.size(); ++k)
        if (recorded.channels16[0].values[k] >= kFirstRange) {
          ASSERT_EQ(made.channels8[i].values[k], recorded.channels8[i].values[k]);
        }
    ++scans;
  }
  EXPECT_EQ(scans, r.scans);
  EXPECT_EQ(talk.device.counters().astray_points, 0u);
}
INSTANTIATE_TEST_SUITE_P(Sick, RecordedDialogue, testing::Values(test::kLms511, test::kTim781),
                         [](const auto& i) { return std::string(i.index == 0 ? "LMS511" : "TiM781S"); });

TEST(ScannerDevice, TakesNoOrdersFromStrangers) {
  Talk talk(lms111());
  EXPECT_EQ(talk.ask("sMN LMCstartmeas"), error(1));
  EXPECT_EQ(talk.ask("sWN FREchoFilter \x01"), error(10));
  EXPECT_EQ(text_of(talk.ask("sMN SetAccessMode \x03\x01\x02\x03\x04")), "sAN SetAccessMode \0"sv);
  EXPECT_EQ(talk.session.level, 0);
  talk.log_in();
  EXPECT_EQ(talk.session.level, 3);
  EXPECT_EQ(text_of(talk.ask("sMN LMCstartmeas")), "sAN LMCstartmeas \0"sv);
  EXPECT_EQ(text_of(talk.ask("sMN Run")), "sAN Run \1"sv);
  EXPECT_EQ(talk.ask("sMN LMCstopmeas"), error(1)) << "Run logs out";
}

TEST(ScannerDevice, SaysWhatItDoesNotKnow) {
  Talk talk(lms111());
  talk.log_in();
  EXPECT_EQ(talk.ask("sRN NoSuchVariable"), error(3));
  EXPECT_EQ(talk.ask("sWN NoSuchVariable \x01"), error(3));
  EXPECT_EQ(talk.ask("sMN NoSuchMethod"), error(2));
  EXPECT_EQ(talk.ask("sEN NoSuchEvent \x01"), error(15));
  EXPECT_EQ(talk.ask("sXX What"), error(12));
  EXPECT_EQ(talk.ask("\x01\x02\x03"), error(12));
  EXPECT_EQ(talk.ask("sWN LMDscandatacfg \x01"), error(8));
  EXPECT_EQ(talk.ask("sMN SetAccessMode \x03"), error(8));
  EXPECT_EQ(talk.ask("sRN LMDscandata"), error(4)) << "no scan yet";
}

TEST(ScannerDevice, ScanConfigurationIsAnsweredWithItsStatus) {
  Talk talk(lms111());
  talk.log_in();
  // Frequency 1/100 Hz, one sector, step 1/10000 degree, sector's angles (not looked at).
  const auto set = [&](std::uint32_t hz_e2, std::uint32_t step) {
    Buffer body;
    for (const char c : "sMN mLMPsetscancfg "sv) body.push_back(static_cast<std::uint8_t>(c));
    for (const std::uint32_t v : {hz_e2, std::uint32_t{0x00010000} | step >> 16})
      for (int s = 24; s >= 0; s -= 8) body.push_back(static_cast<std::uint8_t>(v >> s));
    for (const std::uint32_t v : {step << 16, 0u, 0u})
      for (int s = 24; s >= 0; s -= 8) body.push_back(static_cast<std::uint8_t>(v >> s));
    const Buffer a = talk.ask(body);
    const auto t = parse_telegram(a);
    return t && t->is("sAN", "mLMPsetscancfg") && t->values.size() == 19 ? int{t->values[0]} : -1;
  };
  EXPECT_EQ(set(5000, 5000), 0);
  EXPECT_EQ(set(2500, 5000), 1) << "its rotor turns at 50 Hz";
  EXPECT_EQ(set(5000, 2500), 2) << "finer than it measures";
  EXPECT_EQ(set(5000, 10000), 0) << "every second beam";
  Buffer out;
  talk.device.set_scan({}, 0, DeviceTime(0), DeviceTime(1));
  talk.device.append_scan(out);
  FrameParser p;
  p.add(out);
  ScanData s;
  const Bytes b = p.next();
  ASSERT_EQ(decode_scan(parse_telegram(b)->values, s), ScanError::none);
  EXPECT_EQ(s.channels16[0].values.size(), 271u);
  EXPECT_EQ(s.channels16[0].step_deg_e4, 10000);
}

// ------------------------------------------------------------------ a client's dialogue with it

Status hold_dialogue(ClientDialog& dialog, Talk& talk) {
  for (int steps = 0; !dialog.done(); ++steps) {
    if (steps > 40) return fail(ErrorCode::internal, "test", "no end");
    Buffer out;
    dialog.request(out);
    FrameParser p;
    p.add(out);
    const Bytes b = p.next();
    const Buffer a = talk.ask(Buffer(b.begin(), b.end()));
    auto taken = dialog.answer(*parse_telegram(a));
    if (!taken) return tl::unexpected<Error>(taken.error());
    if (!*taken) return fail(ErrorCode::internal, "test", "not the answer: " + text_of(a));
  }
  return {};
}

TEST(ClientDialog, SetsWhatIsWishedAndReadsTheRest) {
  ScannerConfig c = scanner_config(Family::lms5xx);
  c.pattern = {-5, 1.0 / 6, 1141};
  Talk talk(c);
  Wish wish;
  wish.where = "front";
  wish.scan_frequency_hz = 25;
  wish.start_deg = 45, wish.stop_deg = 135;
  wish.echoes = EchoFilter::all;
  wish.output_interval = 2;
  ClientDialog dialog(wish);
  auto s = hold_dialogue(dialog, talk);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(dialog.facts().name, "LMS511_FieldEval");
  EXPECT_EQ(dialog.facts().firmware, "V1.80");
  EXPECT_EQ(dialog.facts().start_deg_e4, 450000);
  EXPECT_EQ(dialog.facts().echoes, 5u);
  EXPECT_GE(dialog.max_points(), 541u * 5);
  EXPECT_LT(dialog.max_points(), 550u * 5);
  EXPECT_FALSE(talk.session.scans);
  dialog.begin_stream();
  ASSERT_TRUE(hold_dialogue(dialog, talk));
  EXPECT_TRUE(talk.session.scans);
  EXPECT_TRUE(dialog.streaming());
  EXPECT_TRUE(talk.device.made_scan(2));
  EXPECT_FALSE(talk.device.made_scan(3));
}

TEST(ClientDialog, SaysWhatTheDeviceDoesNotOffer) {
  const auto wrong = [](const Wish& wish) {
    Talk talk(lms111());
    ClientDialog dialog(wish);
    auto s = hold_dialogue(dialog, talk);
    return s ? std::string("no error") : s.error().text();
  };
  Wish w;
  w.where = "front";
  w.scan_frequency_hz = 25;
  EXPECT_THAT(wrong(w), testing::HasSubstr("front: expected a device that scans at 25 Hz by 0.5 degree, got "
                                           "one that does not offer this frequency and scans at 50 Hz"));
  w = {};
  w.resolution_deg = 0.25;
  EXPECT_THAT(wrong(w), testing::HasSubstr("does not offer this resolution"));
  w = {};
  w.start_deg = -80;
  EXPECT_THAT(wrong(w), testing::HasSubstr("LOCALCONDITIONFAILED"));
  w = {};
  w.password_hash = 0x12345678;
  EXPECT_THAT(wrong(w), testing::HasSubstr("password_hash"));
}

TEST(ClientDialog, WaitsBehindEventsForItsAnswer) {
  ClientDialog dialog(Wish{});
  const std::string event = "sSN LFErec \x01";
  const auto t = parse_telegram(Bytes(reinterpret_cast<const std::uint8_t*>(event.data()), event.size()));
  const auto taken = dialog.answer(*t);
  ASSERT_TRUE(taken);
  EXPECT_FALSE(*taken);
}

}  // namespace
}  // namespace rigor::sick
