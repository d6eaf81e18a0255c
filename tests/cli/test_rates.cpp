// Rates that do not divide the loop's: each capture by the formula, the same bytes twice, the same seen
// again.
#include <gmock/gmock.h>

#include "rt-core/period.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/cli/runs_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

class Rates : public Runs {
 protected:
  [[nodiscard]] std::string rig_of(const std::string& loop_hz, const std::vector<std::string>& rates) const {
    std::string rig = "duration_s: 7\nclock: virtual\nloop: { rate_hz: " + loop_hz +
                      " }\nsimulation: { world: " + config("worlds/testbed.yaml") +
                      " }\nrecord: { file: run.mcap }\nchannels:\n";
    for (std::size_t i = 0; i < rates.size(); ++i)
      rig += "  c" + std::to_string(i) + ": { kind: imu, backend: simulated, rate_hz: " + rates[i] +
             ", latency_ms: 4, sensor: " + config("sensors/imu-mems.yaml") +
             ", T_world_sensor: { position_m: [2, 0, 0.5], quaternion_wxyz: [1, 0, 0, 0] } }\n";
    return rig;
  }
  json run(const std::string& rig, const std::vector<std::string>& more = {}) const {
    write_file(dir / "rig.yaml", rig);
    std::vector<std::string> words{"run", "rig.yaml", "--json", "--force"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(std::move(words), dir.path());
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out) : json();
  }
  std::vector<std::int64_t> captures(const std::string& channel) const {
    std::vector<std::int64_t> all;
    const auto reader = record::McapReader::open(file("run.mcap"));
    if (!reader) return all;
    auto cursor =
        (*reader)->messages({.topics = {"/" + channel + "/imu/stamp"}, .order = record::MessageOrder::file});
    record::MessageView view;
    for (auto more = cursor.next(view); more && *more; more = cursor.next(view)) {
      record::msg::SampleStamp m;
      if (!record::CdrReader::read(view.data, m)) break;
      EXPECT_EQ(m.sequence, all.size());
      all.push_back(m.t_capture_ns);
    }
    return all;
  }
  /// round(k·den·10⁹/num), ties up, on paper's terms.
  void expect_formula(const std::string& channel, std::int64_t num, std::int64_t den,
                      std::size_t count) const {
    const auto all = captures(channel);
    ASSERT_EQ(all.size(), count) << channel;
    for (std::size_t k = 0; k < all.size(); ++k)
      ASSERT_EQ(all[k], (2 * static_cast<std::int64_t>(k) * den * 1'000'000'000 + num) / (2 * num))
          << channel << " at " << k;
  }
};

TEST_F(Rates, ThreeAtOnceAreWhereTheFormulaPutsThemAndRepeatByteForByte) {
  const std::string rig = rig_of("1000", {"30", "60", "29.97", "60000/1001"});
  const json first = run(rig);
  const std::string bytes = sha256(dir / "run.mcap"), seen = first["input_sha256"];
  // The last cycle is at 6.999 s: captures until 6.995 s are visible by then, and due.
  expect_formula("c0", 30, 1, 210);
  expect_formula("c1", 60, 1, 420);
  expect_formula("c2", 2997, 100, 210);
  expect_formula("c3", 60000, 1001, 420);
  for (const json& c : first["channels"]) {
    EXPECT_EQ(c["due"], c["delivered"]) << c["name"];
    EXPECT_EQ(c["lost_samples"], 0) << c["name"];
    EXPECT_EQ(c["late_samples"], 0) << c["name"];
  }
  EXPECT_EQ(channel(first, "c2")["nominal_rate_hz"], 29.97);
  EXPECT_EQ(run(rig)["input_sha256"], seen);
  EXPECT_EQ(sha256(dir / "run.mcap"), bytes);
  const Said again = rigor({"replay", file("run.mcap"), "--json"}, dir.path());
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["input_sha256"], seen);
}

TEST_F(Rates, OfTheLoopAreAnyAndReplaysSeeTheSame) {
  for (const char* loop : {"30", "300", "600", "900", "960", "60000/1001"}) {
    const json first = run(rig_of(loop, {"29.97", "10"}));
    const auto rate = parse_rate(loop);
    ASSERT_TRUE(rate);
    EXPECT_EQ(first["loop"]["rate_hz"], rate->hz()) << loop;
    EXPECT_EQ(first["loop"]["cycles_run"], rate->first_index_from(seconds(7))) << loop;
    for (const json& c : first["channels"]) EXPECT_EQ(c["due"], c["delivered"]) << loop << ": " << c["name"];
    const Said again = rigor({"replay", file("run.mcap"), "--json"}, dir.path());
    ASSERT_EQ(again.status, 0) << again.err;
    EXPECT_EQ(json::parse(again.out)["input_sha256"], first["input_sha256"]) << loop;
  }
}

TEST_F(Rates, OfSamplesThatAreDueBeforeTheNextCycleAreSeenInTheFirstOneAfterTheirRelease) {
  std::string rig = rig_of("1000", {"30"});
  rig.replace(rig.find("latency_ms: 4"), 13, "latency_ms: 0.5");
  const json result = run(rig);
  // Captures lie at 0, 33.33 and 66.67 ms past each tenth of a second, releases at 0.5, 33.83 and 67.17: seen
  // in the cycles 1, 34 and 68. Before that the one before is 33, 33.67 and 33.33 ms old.
  const json age = channel(result, "c0")["age"];
  EXPECT_LT(age["max_ns"].get<double>(), 33.8e6);
  EXPECT_EQ(channel(result, "c0")["late_samples"], 0);
}

TEST_F(Rates, ThatAreNoneAreRefusedWithTheirPlaceAndWhatToWrite) {
  const auto refused = [&](const std::string& loop, const std::string& rate) {
    write_file(dir / "rig.yaml", rig_of(loop, {rate}));
    const Said said = rigor({"run", "rig.yaml"}, dir.path());
    EXPECT_EQ(said.status, 2) << rate;
    EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
    return said.err;
  };
  EXPECT_THAT(refused("1000", "60000/0"), HasSubstr("rig.yaml:7:"));
  EXPECT_THAT(refused("1000", "60000/0"),
              HasSubstr("expected a rate whose denominator is not 0, got 60000/0; write 30"));
  EXPECT_THAT(refused("1000", "30/x"), HasSubstr("got 30/x; write 30, 29.97 or 60000/1001"));
  EXPECT_THAT(refused("1000", "-30"), HasSubstr("channels.c0.rate_hz: expected a number from"));
  EXPECT_THAT(refused("1000", ".nan"), HasSubstr("channels.c0.rate_hz: expected a finite number"));
  EXPECT_THAT(refused("1000", "9000000/3"), HasSubstr("expected a rate from 1e-06 to 1e+06, got 9000000/3"));
  EXPECT_THAT(refused("30", "60"),
              HasSubstr("expected a rate of at most the loop's 30 Hz, got 60; raise `loop.rate_hz`"));
  EXPECT_THAT(refused("60001/1", "10"),
              HasSubstr("loop.rate_hz: expected a rate from 1 to 20000, got 60001/1"));
}

}  // namespace
}  // namespace rigor::test
