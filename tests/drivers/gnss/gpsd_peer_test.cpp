// Debian's gpsd takes the emulated receiver for a u-blox one: on a pseudo-terminal and over TCP, by UBX (gpsd
// finds out what it is and configures it) and by NMEA. Position, time and satellites are those that were
// measured.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "drivers/gnss/gnss_time.h"
#include "tests/drivers/gnss/formula_receiver.h"

namespace rigor::gnss {
namespace {

using nlohmann::json;

bool installed(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0;
}

/// gpsd at one device, and what it says to its clients.
class Gpsd {
 public:
  Gpsd(const std::string& device, const std::vector<std::string>& options, std::uint16_t port) {
    log_ = testing::TempDir() + "rigor-gpsd-" + std::to_string(::getpid()) + ".log";
    std::vector<std::string> words{"gpsd", "-N", "-n", "-D", "2", "-S", std::to_string(port)};
    words.insert(words.end(), options.begin(), options.end());
    words.push_back(device);
    pid_ = ::fork();
    if (pid_ == 0) {
      std::vector<char*> argv;
      for (auto& w : words) argv.push_back(w.data());
      argv.push_back(nullptr);
      if (!std::freopen(log_.c_str(), "w", stdout) || !std::freopen(log_.c_str(), "a", stderr)) _exit(126);
      ::execvp("gpsd", argv.data());
      _exit(127);
    }
    const std::string client = "127.0.0.1:" + std::to_string(port);
    // gpspipe ends when nobody listens yet.
    test::eventually(
        [&] {
          pipe_ = ::popen(("timeout 20 gpspipe -w " + client + " 2>/dev/null").c_str(), "r");
          std::array<char, 8192> line{};
          if (std::fgets(line.data(), line.size(), pipe_)) return true;
          ::pclose(pipe_);
          pipe_ = nullptr;
          std::this_thread::sleep_for(std::chrono::milliseconds(50));
          return false;
        },
        seconds(10));
  }
  ~Gpsd() {
    ::kill(pid_, SIGTERM);
    ::waitpid(pid_, nullptr, 0);
    if (pipe_) ::pclose(pipe_);
  }
  /// The next report of this class for which `good` holds; null after many lines without one.
  template <class Good>
  json next(const std::string& kind, Good&& good) {
    std::array<char, 16384> line{};
    for (int i = 0; pipe_ && i < 2000 && std::fgets(line.data(), line.size(), pipe_); ++i) {
      const json j = json::parse(line.data(), nullptr, false);
      if (j.is_discarded()) continue;
      for (const json& d : j.value("class", "") == "DEVICES" ? j["devices"] : json::array({j}))
        if (d.value("class", "") == "DEVICE") driver = d.value("driver", driver);
      if (j.value("class", "") == kind && good(j)) return j;
    }
    std::ifstream log(log_);
    ADD_FAILURE() << "no such " << kind << "; gpsd says:\n"
                  << std::string(std::istreambuf_iterator<char>(log), {}).substr(0, 4000);
    return {};
  }
  std::string driver;  ///< what gpsd takes the device for, by its latest report

 private:
  pid_t pid_ = -1;
  FILE* pipe_ = nullptr;
  std::string log_;
};

struct Way {
  const char *name, *emulator;
  std::vector<std::string> options;
  const char* driver;
  bool ubx;
  double place_deg, height_m;
  std::uint16_t port;
};
class GpsdPeer : public testing::TestWithParam<Way> {};

TEST_P(GpsdPeer, SeesThePlaceTheTimeAndTheSatellites) {
  if (!installed("gpsd") || !installed("gpspipe")) GTEST_SKIP() << "gpsd is not installed";
  const Way& way = GetParam();
  auto receiver = std::make_shared<test::FormulaReceiver>();
  receiver->latitude_deg = -34.9062266, receiver->longitude_deg = 138.6081199, receiver->height_m = -12.5;
  auto emulator = test::start_emulator(way.emulator, receiver);
  const std::string at = emulator->where();
  Gpsd gpsd(at[0] == '/' ? at : "tcp://" + at, way.options, way.port);

  const json tpv = gpsd.next("TPV", [&](const json& j) {
    return j.value("mode", 0) == 3 && j.contains("altHAE") && j.contains("track") &&
           (!way.ubx || j.contains("leapseconds"));
  });
  ASSERT_FALSE(tpv.is_null());
  const double now_s = static_cast<double>(realtime_now().ns()) * 1e-9;
  EXPECT_NEAR(tpv["lat"].get<double>(), receiver->latitude_deg, way.place_deg) << tpv;
  // It drives east: so far at most since the test began.
  EXPECT_GE(tpv["lon"].get<double>(), receiver->longitude_deg - way.place_deg) << tpv;
  EXPECT_LE(tpv["lon"].get<double>(), receiver->longitude_deg + 0.05) << tpv;
  EXPECT_NEAR(tpv["altHAE"].get<double>(), receiver->height_m + 0.5, 0.5 + way.height_m) << tpv;
  EXPECT_NEAR(tpv["speed"].get<double>(), 10, 0.3) << tpv;
  EXPECT_NEAR(tpv["track"].get<double>(), 90, 2) << tpv;
  int y = 0, mo = 0, d = 0, h = 0, mi = 0, s = 0, ms = 0;
  ASSERT_EQ(std::sscanf(tpv["time"].get<std::string>().c_str(), "%d-%d-%dT%d:%d:%d.%dZ", &y, &mo, &d, &h, &mi,
                        &s, &ms),
            7);
  const double then_s = static_cast<double>(realtime_of({y, mo, d, h, mi, s, ms * 1'000'000LL}).ns()) * 1e-9;
  EXPECT_NEAR(now_s, then_s, 15) << tpv;
  if (way.ubx) {
    EXPECT_EQ(tpv["leapseconds"], 18) << tpv;
    EXPECT_NEAR(tpv["eph"].get<double>(), std::sqrt(0.0013), 0.001) << tpv;
  }

  const Sky truth = made_sky(receiver->satellites);
  const json sky = gpsd.next("SKY", [&](const json& j) {
    return j.contains("satellites") && j["satellites"].size() == truth.satellites.size();
  });
  ASSERT_FALSE(sky.is_null());
  EXPECT_EQ(gpsd.driver, way.driver);
  int used = 0;
  for (const json& v : sky["satellites"]) {
    const auto it = std::find_if(truth.satellites.begin(), truth.satellites.end(), [&](const Satellite& t) {
      return nmea_number(t.id) == v["PRN"].get<int>();
    });
    ASSERT_NE(it, truth.satellites.end()) << v;
    EXPECT_EQ(v["el"].get<double>(), it->elevation_deg) << v;
    EXPECT_EQ(v["az"].get<double>(), it->azimuth_deg) << v;
    EXPECT_EQ(v["ss"].get<double>(), it->cn0_dbhz) << v;
    EXPECT_EQ(v["svid"].get<int>(), it->id.satellite) << v;
    // gpsd 3.22 takes Galileo's satellites in GSA of NMEA 4.11 for none.
    if (way.ubx || it->id.gnss != Gnss::galileo) {
      EXPECT_EQ(v["used"].get<bool>(), it->used) << v;
    }
    used += v["used"].get<bool>();
  }
  EXPECT_GE(used, 13);
  EXPECT_NEAR(sky["hdop"].get<double>(), dilution_of(truth).horizontal, 0.006) << sky["hdop"];
}

INSTANTIATE_TEST_SUITE_P(
    Ways, GpsdPeer,
    testing::Values(
        Way{"ubx_on_a_terminal", "{rate_hz: 5}", {}, "u-blox", true, 1e-7, 1e-3, 29471},
        Way{"ubx_of_generation_8", "{rate_hz: 5, generation: 8}", {}, "u-blox", true, 1e-7, 2e-3, 29472},
        Way{"nmea_on_a_terminal", "{rate_hz: 5, speaks: nmea}", {"-b"}, "NMEA0183", false, 2e-7, 0.1, 29473},
        Way{"ubx_over_tcp", "{rate_hz: 5, as: tcp, port: 0}", {}, "u-blox", true, 1e-7, 1e-3, 29474}),
    [](const auto& way) { return way.param.name; });

}  // namespace
}  // namespace rigor::gnss
