// `rigor tune` and what runs make of its lock.
#include <gmock/gmock.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "bench/tune/lock_file.h"
#include "bench/tune/tuner.h"
#include "tests/cli/sensing_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class Tune : public SensingBench {
 protected:
  void SetUp() override {
    SensingBench::SetUp();
    scanner_rig(kTolerant);
  }
  static constexpr const char* kTolerant =
      "    T_world_sensor: { position_m: [0, 0, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n"
      "    tolerance: { range_m: 0.05, outliers: 0.2 }\n";
};

TEST_F(Tune, WritesALockThatVirtualRunsAskFor) {
  const Said without = in_dir({"run", "rig.yaml", "--json"});
  EXPECT_EQ(without.status, 2);
  EXPECT_THAT(without.err, AllOf(HasSubstr("rig.yaml:7:5: channels.flat"), HasSubstr("rigor tune rig.yaml")));

  const Said tuned = in_dir({"tune", "rig.yaml", "--json"});
  ASSERT_EQ(tuned.status, 0) << tuned.err;
  const json channel = json::parse(tuned.out)["channels"][0];
  EXPECT_EQ(channel["name"], "flat");
  EXPECT_GT(channel["trials"].size(), 3u);
  const json chosen = channel["chosen"];
  EXPECT_LE(chosen["range_rmse_m"], 0.05);
  EXPECT_LE(chosen["outliers"], 0.2);
  for (const json& t : channel["trials"]) {
    if (t["meets"]) {
      EXPECT_GE(t["p50_ms"], chosen["p50_ms"]) << "the cheapest of those that meet it";
    }
  }

  const auto lock = load_lock(dir / "rig.lock.yaml");
  ASSERT_TRUE(lock && *lock);
  EXPECT_FALSE((*lock)->cpu.empty());
  EXPECT_EQ((*lock)->channels.at("flat").choice.engine, chosen["renderer"]);
  const Said with = in_dir({"run", "rig.yaml", "--json"});
  EXPECT_EQ(with.status, 0) << with.err;
}

TEST_F(Tune, RefusesALockOfSomethingElse) {
  ASSERT_EQ(in_dir({"tune", "rig.yaml"}).status, 0);
  ASSERT_EQ(in_dir({"run", "rig.yaml"}).status, 0);
  const auto stale = [&](const char* what) {
    const Said said = in_dir({"run", "rig.yaml"});
    EXPECT_EQ(said.status, 2) << what;
    EXPECT_THAT(said.err, AllOf(HasSubstr("rig.lock.yaml"), HasSubstr("flat"), HasSubstr("rigor tune")))
        << what;
  };
  std::string sensor = kScanner;
  write_file(dir / "scanner.yaml", sensor + "wavelength_nm: 850\n");
  stale("another sensor");
  write_file(dir / "scanner.yaml", sensor);
  EXPECT_EQ(in_dir({"run", "rig.yaml"}).status, 0) << "and back";
  std::string world = kWorld;
  world.replace(world.find("4.1, 0, 0"), 3, "5.1");
  write_file(dir / "world.yaml", world);
  stale("another world");
  write_file(dir / "world.yaml", kWorld);
  scanner_rig(std::string(kTolerant) + "    phase_us: 100\n");
  stale("other keys");
}

TEST_F(Tune, SaysHowNearTheEnginesComeWhereNoneIsGoodEnough) {
  scanner_rig(
      "    T_world_sensor: { position_m: [0, 0, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n"
      "    tolerance: { range_m: 1e-9, outliers: 0 }\n");
  const Said said = in_dir({"tune", "rig.yaml"});
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.out, AllOf(HasSubstr("rays"), HasSubstr("outliers"), HasSubstr("nothing was written")));
  EXPECT_FALSE(std::filesystem::exists(dir / "rig.lock.yaml"));
  const Said wall = in_dir({"run", "rig.yaml", "--clock", "wall", "--duration", "0.2"});
  EXPECT_EQ(wall.status, 2);
  EXPECT_THAT(wall.err, HasSubstr("no engine meets its tolerance"));
}

TEST_F(Tune, IsDoneAtArmOnTheWallClock) {
  const Said said =
      in_dir({"run", "rig.yaml", "--clock", "wall", "--duration", "0.2", "--json", "--progress", "json"});
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.err, HasSubstr(R"("task":"tune")"));
  EXPECT_FALSE(std::filesystem::exists(dir / "rig.lock.yaml"));
}

class TuneCamera : public SensingBench {
 protected:
  void SetUp() override {
    SensingBench::SetUp();
    tolerate("2");
  }
  void tolerate(const std::string& radiance) {
    rig("channels:\n  eye:\n    kind: image\n    backend: simulated\n    rate_hz: 20\n    latency_ms: 30\n   "
        " sensor: "
        "camera.yaml\n    T_world_sensor: { position_m: [-3, 0, 0.5], look_at_m: [1, 0, 0] }\n    tolerance: "
        "{ "
        "radiance: " +
        radiance + " }\n");
  }
  [[nodiscard]] json trials() const {
    const Said said = in_dir({"tune", "rig.yaml", "--json"});
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out)["channels"][0]["trials"] : json::array();
  }
};

TEST_F(TuneCamera, MeasuresTheLightByBothEngines) {
  std::map<std::string, double> error_of;
  for (const json& t : trials()) {
    EXPECT_GT(t["radiance"], 0) << t["choice"] << ": no setting is the reference";
    EXPECT_LT(t["radiance"], 2) << t["choice"];
    EXPECT_GE(t["timed"], 3);
    EXPECT_LE(t["p50_ms"], t["max_ms"]);
    error_of[t["choice"]] = t["radiance"];
  }
  EXPECT_LT(error_of.at("rays, 16 samples per pixel, in full"),
            0.6 * error_of.at("rays, 1 sample per pixel, in full"))
      << "more samples, less noise";
  const std::string engines = json(error_of).dump();
  EXPECT_THAT(engines, HasSubstr("raster, supersampling 1, 1 instant"));
  // And the lock is what a run in virtual time goes by.
  EXPECT_TRUE(std::filesystem::exists(dir / "rig.lock.yaml"));
  const Said run = in_dir({"run", "rig.yaml", "--json"});
  EXPECT_EQ(run.status, 0) << run.err;
}

TEST_F(TuneCamera, DropsNoneOfItsEffects) {
  write_file(dir / "camera.yaml",
             std::string(kCamera) + "shutter: { line_time_us: 20, motion_blur: true }\n");
  for (const json& t : trials())
    EXPECT_THAT(t["choice"], Not(HasSubstr("1 instant"))) << "neither blur nor rows";
}

TEST_F(TuneCamera, OfABlackWorldIsRefused) {
  write_file(dir / "camera.yaml", kCamera);
  std::string world = kWorld;
  world.erase(world.find("sky:"));
  world +=
      "sky:\n  zenith_radiance_w_per_m2_sr: { red: 0, green: 0, blue: 0, nir: 0 }\n  "
      "horizon_radiance_w_per_m2_sr: { red: 0, green: 0, blue: 0, nir: 0 }\n";
  write_file(dir / "world.yaml", world);
  const Said said = in_dir({"tune", "rig.yaml"});
  EXPECT_EQ(said.status, 2) << said.out;
  EXPECT_THAT(said.err, AllOf(HasSubstr("eye"), HasSubstr("light")));
}

TEST_F(Tune, TakesFewerRaysOnlyForAShareOfOutliersThatIsGiven) {
  const auto fewest = [&] {
    int n = 99;
    const Said said = in_dir({"tune", "rig.yaml", "--json"});
    const json told = json::parse(said.out);
    for (const json& t : told["channels"][0]["trials"]) {
      const std::string choice = t["choice"];
      n = std::min(n, std::stoi(choice.substr(choice.find(", ") + 2)));
    }
    return n;
  };
  EXPECT_EQ(fewest(), 1);
  scanner_rig(
      "    T_world_sensor: { position_m: [0, 0, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n"
      "    tolerance: { range_m: 0.05 }\n");
  EXPECT_EQ(fewest(), 5) << "the sensor model's";
}

TEST_F(Tune, HasNothingToDoWithoutATolerance) {
  rig(kChannels);
  const Said said = in_dir({"tune", "rig.yaml"});
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("tolerance"));
}

TEST(RangeErrors, CountWhatIsOffMissedAndFalse) {
  const auto point = [](float range, int t) { return LidarPoint{range, 0, 0, 0, t, 0, 0, 0}; };
  const std::vector<LidarPoint> reference{point(10, 0), point(10, 1), point(10, 2), point(10, 3)};
  const std::vector<LidarPoint> points{point(10.03F, 0), point(9.96F, 1), point(11, 2), point(10, 7)};
  const RangeError e = difference_of(reference, points, 0.5);
  EXPECT_NEAR(e.rmse_m, std::sqrt((0.03 * 0.03 + 0.04 * 0.04) / 2), 1e-6);
  EXPECT_DOUBLE_EQ(e.outliers, 3.0 / 5) << "one off, one missed, one false, two good";
  const float nan = std::nanf("");
  const RangeError image =
      difference_of(std::vector<float>{1, 2, nan, nan}, std::vector<float>{1.1F, nan, 3, nan}, 0.5);
  EXPECT_NEAR(image.rmse_m, 0.1, 1e-6);
  EXPECT_DOUBLE_EQ(image.outliers, 2.0 / 3);
}

TEST(LockFiles, ComeBackAsTheyWereWritten) {
  const TempDir dir;
  LockFile lock;
  lock.cpu = "Some \"CPU\" @ 2 GHz: fast";
  lock.gpu = "rays";
  EngineChoice choice;
  choice.engine = "raster";
  choice.allowed_error_rad = 0.0005;
  choice.pixels_per_rad = 1000;
  choice.sub_rays = 5;
  lock.channels["a"] = {choice, 1.5, 2.5, 0.01, 0.002, 0, "abc"};
  ASSERT_TRUE(save_lock(dir / "x.lock.yaml", lock));
  const auto back = load_lock(dir / "x.lock.yaml");
  ASSERT_TRUE(back && *back) << (back ? "" : back.error().text());
  EXPECT_EQ((*back)->cpu, "Some CPU @ 2 GHz: fast");
  EXPECT_EQ((*back)->channels.at("a").choice, choice);
  EXPECT_EQ((*back)->channels.at("a").digest, "abc");
  EXPECT_NEAR((*back)->channels.at("a").outliers, 0.002, 1e-9);
  EXPECT_FALSE(*load_lock(dir / "none.lock.yaml"));
}

}  // namespace
}  // namespace rigor::test
