// Faults as text: every kind with every key comes back from JSON and from YAML as the same struct; what is
// wrong is refused with the key; how a recording gets them.
#include <gmock/gmock.h>

#include <filesystem>
#include <set>
#include <tuple>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

class NoSignal final : public FrameSignal {
 public:
  double read(const CanFrame&) const noexcept override { return 0; }
  bool write(CanFrame&, double) const noexcept override { return false; }
};

struct CodecCase {
  SampleKind kind;
  std::string yaml;
};
/// Every key of every kind.
const std::vector<CodecCase>& all_faults() {
  static const std::vector<CodecCase> all{
      {kRegisters, "{kind: drop, probability: 0.2, from_s: 10, until_s: 12.000000001}"},
      {kRegisters, "{kind: drop, every_s: 5, for_s: 0.1, from_s: 0.3}"},
      {kRegisters, "{kind: drop, for_s: 0.7, from_s: 1}"},
      {kRegisters, "{kind: drop, when: {channel: table, value: a b, above: 30.5}, for_s: 0.2}"},
      {kRegisters, "{kind: drop, when: {channel: table, value: a, below: -1e-7}}"},
      {kRegisters, "{kind: drop, when: {channel: \"t: {\\\"}\", is: overdue}}"},
      {kRegisters, "{kind: drop, when: {channel: table, is: disconnected}}"},
      {kRegisters, "{kind: burst_loss, share: 0.25, mean_burst: 8}"},
      {kRegisters, "{kind: delay, delay_ms: 0.3, probability: 0.123456789012345}"},
      {kRegisters, "{kind: jitter, min_ms: 1.1, max_ms: 3, probability: 0.5}"},
      {kRegisters, "{kind: jitter, shape: exponential, mean_ms: 1}"},
      {kRegisters, "{kind: jitter, shape: normal, mean_ms: 8, sigma_ms: 3}"},
      {kRegisters, "{kind: stuck, freeze: true}"},
      {kRegisters, "{kind: stuck}"},
      {kRegisters, "{kind: bias, value: b, amount: -2.5, probability: 0}"},
      {SampleKind::image, "{kind: drift, rate_dn_per_s: 1e14}"},
      {SampleKind::point_cloud, "{kind: noise, value: remission, sigma: 0.1}"},
      {SampleKind::point_cloud, "{kind: noise, sigma_m: 0.1, probability: 0.5}"},
      {SampleKind::image, "{kind: spike, amount_dn: 60, share: 0.05, probability: 1}"},
      {SampleKind::image, "{kind: spike, value: intensity, amount_dn: 60, share: 1}"},
      {SampleKind::image, "{kind: spike, amount_dn: 60}"},
      {SampleKind::can_frame, "{kind: bias, dbc: \"/a b/ü.dbc\", value: Wheel.rate, amount: 1}"},
      {SampleKind::image, "{kind: corrupt}"},
      {SampleKind::image, "{kind: corrupt, keep: 0.5}"},
      {SampleKind::image, "{kind: corrupt, flips: 5, keep: 0.5, flagged: false, probability: 0.1}"},
      {kRegisters, "{kind: timestamp, offset_ms: -80.25, probability: 0.5}"},
      {kRegisters, "{kind: clock_skew, ppm: -1000.5}"},
      {kRegisters, "{kind: clock_step, step_ms: -500}"},
      {kRegisters, "{kind: disconnect, from_s: 9, until_s: 9.3}"},
      {kRegisters, "{kind: slow_consumer}"},
      {kRegisters, "{kind: slow_consumer, mode: hold, leases: 12}"}};
  return all;
}

/// What a channel of a kind has, as its faults see it.
class Reader {
 public:
  explicit Reader(SampleKind kind) : source_(std::make_unique<FormulaStream>()) {
    EXPECT_TRUE(source_.configure(fault_config(kind, "")));
    subject_ = source_.faults().subject();
    subject_.find_signal = [](const ConfigNode& node, const std::string&) {
      (void)node.text("dbc");
      return std::make_shared<NoSignal>();
    };
  }
  Result<FaultReading> read(const ConfigNode& node, bool live = false) {
    return catch_config([&] { return read_fault(node, subject_, live); });
  }
  std::string refused(const std::string& json) {
    const auto node = fault_node(json, "fault");
    if (!node) return node.error().text();
    const auto r = read(*node, true);
    return r ? "(accepted)" : r.error().message;
  }

 private:
  FaultySource source_;
  FaultSubject subject_;
};

TEST(FaultCodec, EveryKindWithEveryKeyComesBackFromJsonAndYaml) {
  std::set<FaultKind> kinds;
  for (const CodecCase& c : all_faults()) {
    SCOPED_TRACE(c.yaml);
    Reader reader(c.kind);
    const auto node = ConfigDocument::parse(c.yaml, "rig.yaml");
    ASSERT_TRUE(node) << node.error().text();
    const auto was = reader.read(*node);
    ASSERT_TRUE(was) << was.error().text();
    kinds.insert(was->spec.kind);
    const auto json = fault_node(fault_json(was->spec), "json");
    ASSERT_TRUE(json) << json.error().text();
    const auto from_json = reader.read(*json);
    ASSERT_TRUE(from_json) << fault_json(was->spec) << from_json.error().text();
    EXPECT_EQ(from_json->spec, was->spec) << fault_json(was->spec);
    EXPECT_EQ(from_json->component, was->component);
    EXPECT_EQ(from_json->signal != nullptr, was->signal != nullptr);
    const auto yaml = ConfigDocument::parse(fault_yaml(was->spec), "yaml");
    ASSERT_TRUE(yaml) << yaml.error().text();
    const auto from_yaml = reader.read(*yaml);
    ASSERT_TRUE(from_yaml) << fault_yaml(was->spec) << from_yaml.error().text();
    EXPECT_EQ(from_yaml->spec, was->spec) << fault_yaml(was->spec);
  }
  EXPECT_EQ(kinds.size(), kFaultKinds);
}

TEST(FaultCodec, TextIsAsPeopleWriteIt) {
  Reader reader(kRegisters);
  const auto spec = reader.read(*ConfigDocument::parse("{from_s: 0.3, delay_ms: 80, kind: delay}"))->spec;
  EXPECT_EQ(fault_yaml(spec), "{kind: delay, delay_ms: 80, from_s: 0.3}");
  EXPECT_EQ(fault_json(spec), R"({"kind": "delay", "delay_ms": 80, "from_s": 0.3})");
}

TEST(FaultCodec, WhatIsWrongInJsonIsRefusedWithItsKey) {
  Reader reader(kRegisters);
  EXPECT_EQ(
      reader.refused("[1]"),
      "fault: fault: expected an object of JSON with the keys of a fault, as rigs have them, got array");
  EXPECT_EQ(reader.refused("{\"kind\""), "fault: fault: expected JSON, got \"{\"kind\"\"");
  EXPECT_EQ(reader.refused(R"({"probability": NaN, "kind": "drop"})"),
            R"(fault: fault: expected JSON, got "{"probability": NaN, "kind": "drop"}")");
  EXPECT_THAT(reader.refused(R"({"kind": "dorp"})"),
              AllOf(HasSubstr("kind: expected one of drop, burst_loss, "),
                    HasSubstr("got dorp; did you mean 'drop'?")));
  const auto number = [](const char* got) {
    return AllOf(HasSubstr("delay_ms: expected a number"), HasSubstr(got));
  };
  EXPECT_THAT(reader.refused(R"({"kind": "delay"})"), number("got nothing: the key is missing"));
  EXPECT_THAT(reader.refused(R"({})"),
              AllOf(HasSubstr("kind: expected one of drop, "), HasSubstr("got nothing: the key is missing")));
  EXPECT_THAT(reader.refused(R"({"kind": "delay", "delay_ms": "soon"})"), number("got \"soon\""));
  EXPECT_THAT(reader.refused(R"({"kind": "delay", "delay_ms": "nan"})"), number("got \"nan\""));
  EXPECT_THAT(reader.refused(R"({"kind": "delay", "delay_ms": null})"), number("got "));
  EXPECT_THAT(reader.refused(R"({"kind": {"a": 1}})"), HasSubstr("kind: expected text, got a map"));
  EXPECT_THAT(reader.refused(R"({"kind": "drop", "probabilty": 1})"),
              HasSubstr("probabilty: unknown key; did you mean probability?"));
}

/// A fault whose names do not fit an event: it begins, and what is told of it.
FaultChange long_change(const std::string& name) {
  ChannelDescription description;
  description.kind = SampleKind::can_frame;
  FaultSubject subject;
  subject.channel = "left.real";
  subject.kind = SampleKind::can_frame;
  subject.description = &description;
  subject.find_signal = [](const ConfigNode& node, const std::string&) {
    (void)node.text("dbc");
    return std::make_shared<NoSignal>();
  };
  FaultInjector injector;
  injector.configure(subject, 1, {});
  injector.arm();
  injector.start(BenchTime(0), milliseconds(1));
  const auto node = fault_node(
      R"({"kind": "bias", "dbc": "/)" + name + R"(.dbc", "value": ")" + name + R"(", "amount": 1})", "json");
  EXPECT_TRUE(node);
  const auto fault = injector.make_live(*node);
  EXPECT_TRUE(fault) << fault.error().text();
  if (!fault) return {};
  injector.add(*fault);
  injector.begin_cycle(BenchTime(5'000'000));
  return injector.poll_change();
}

std::string long_name() {
  std::string name;
  for (int i = 0; i < 1500; ++i) name += "ü";
  return name;
}

TEST(FaultCodec, AnEventShowsALongOneInPart) {
  const FaultChange change = long_change(long_name());
  ASSERT_TRUE(change && change.event);
  const std::string text = change.event->as<EventInfo>()->text.data();
  EXPECT_THAT(text,
              ::testing::StartsWith("live fault 0 of left.real begins in cycle 5: {kind: bias, dbc: \"/üü"));
  EXPECT_LT(text.size(), 300u);
  EXPECT_TRUE(text.ends_with("ü")) << "not within a character: " << text;
}

TEST(FaultCodec, ARecordingHoldsALongOneWhole) {
  const std::string name = long_name(), file = ::testing::TempDir() + "fault_codec.mcap";
  FaultChange change = long_change(name);
  ASSERT_TRUE(change);
  change.begins = false;
  change.seen = 9, change.dropped = 1, change.changed = 2, change.delayed = 3;
  RecorderOptions options;
  options.virtual_time = true;
  auto recorder = Recorder::create(file, options, {}, {{"motor", {"rate"}}}, {});
  ASSERT_TRUE(recorder) << recorder.error().text();
  (*recorder)->begin(BenchTime(0));
  (*recorder)->record_fault(change);
  (*recorder)->end_cycle(5, BenchTime(5'000'000));
  ASSERT_TRUE((*recorder)->stop());

  auto reader = record::McapReader::open(file);
  ASSERT_TRUE(reader);
  auto cursor = (*reader)->messages({.topics = {"/rigor/faults"}, .order = record::MessageOrder::file});
  record::MessageView view;
  const auto more = cursor.next(view);
  ASSERT_TRUE(more && *more);
  record::msg::Fault m;
  ASSERT_TRUE(record::CdrReader::read(view.data, m));
  EXPECT_EQ(m.channel, "left.real");
  EXPECT_EQ(m.index, 0u);
  EXPECT_EQ(m.kind, "bias");
  EXPECT_TRUE(m.live);
  EXPECT_FALSE(m.begins);
  EXPECT_EQ(std::tuple(m.seen, m.dropped, m.changed, m.delayed), std::tuple(9u, 1u, 2u, 3u));
  Reader frames(SampleKind::can_frame);
  const auto node = fault_node(m.fault, "recording");
  ASSERT_TRUE(node) << node.error().text();
  const auto back = frames.read(*node, true);
  ASSERT_TRUE(back) << back.error().text();
  EXPECT_EQ(back->spec.value, name);
  EXPECT_EQ(back->spec.dbc, "/" + name + ".dbc");

  // Cut short it is refused; lengths that are not there take no memory.
  const std::vector<std::byte> bytes(view.data.begin(), view.data.end());
  for (std::size_t n = 0; n + 8 < bytes.size(); n += n < 200 ? 1 : 97)
    EXPECT_FALSE(record::CdrReader::read(record::Bytes(bytes.data(), n), m)) << n;
  for (std::size_t i = 4; i < 100; i += 4) {
    auto wrong = bytes;
    std::memset(wrong.data() + i, 0xff, 4);
    record::msg::Fault of_wrong;
    (void)record::CdrReader::read(wrong, of_wrong);
    EXPECT_LE(of_wrong.fault.size() + of_wrong.channel.size() + of_wrong.kind.size(), bytes.size()) << i;
  }
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace rigor::test
