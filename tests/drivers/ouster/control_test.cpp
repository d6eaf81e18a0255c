// What an emulated sensor answers, and what its client asks: without a socket here, over loopback in
// channel_test.cpp.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "drivers/ouster/sensor_control.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster {
namespace {

using nlohmann::json;
using test::FormulaLidar;

class OusterControl : public testing::Test {
 protected:
  void SetUp() override {
    auto device = SensorDevice::create(std::make_shared<FormulaLidar>(LidarMode{1024, 10}));
    ASSERT_TRUE(device) << device.error().text();
    device_.emplace(std::move(*device));
    auto control = SensorControl::create(*device_, {"OS-1-32", "992000000001", "v3.1.0", seconds(5)},
                                         R"({"udp_dest": "10.0.0.9"})", now_);
    ASSERT_TRUE(control) << control.error().text();
    control_.emplace(std::move(*control));
  }
  json get(const std::string& target, int status = 200) {
    const auto r = control_->http("GET", target, "", "10.0.0.7", now_);
    EXPECT_EQ(r.status, status) << target << ": " << r.body;
    return json::parse(r.body);
  }
  MonotonicTime now_{1'000'000'000};
  std::optional<SensorDevice> device_;
  std::optional<SensorControl> control_;
};

TEST_F(OusterControl, ItsMetadataAreThoseOfTheSimulatedSensor) {
  const auto m = parse_metadata(get("/api/v1/sensor/metadata").dump(), "emulated");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->status, "INITIALIZING");
  EXPECT_EQ(m->mode, (LidarMode{1024, 10}));
  EXPECT_EQ(m->profile, Profile::single);
  EXPECT_EQ(m->pixels_per_column, test::kBeams);
  for (std::size_t row = 0; row < test::kBeams; ++row) {
    EXPECT_NEAR(m->beam_altitude_deg[row], test::altitude_deg(row), 1e-9);
    EXPECT_NEAR(m->beam_azimuth_deg[row], test::azimuth_deg(row), 1e-9);
  }
  EXPECT_NEAR(m->beam_origin_m, test::kOrigin_m, 1e-9);
  EXPECT_NEAR(m->T_sensor_lidar[0], -1, 1e-12);
  EXPECT_NEAR(m->T_sensor_lidar[11], test::kHeight_m, 1e-9);
  now_ = now_ + seconds(6);
  EXPECT_EQ(get("/api/v1/sensor/metadata/sensor_info")["status"], "RUNNING");
  EXPECT_NEAR(get("/api/v1/sensor/metadata/beam_intrinsics")["lidar_origin_to_beam_origin_mm"].get<double>(),
              test::kOrigin_m * 1e3, 1e-9)
      << "for clients that do not know the transform";
  EXPECT_EQ(get("/api/v1/system/firmware")["fw"], "ousteros-image-prod-aries-v3.1.0+emulated");
}

TEST_F(OusterControl, AParameterIsStagedUntilTheSensorStartsAnew) {
  now_ = now_ + seconds(6);
  const auto before = control_->active();
  EXPECT_EQ(get("/api/v1/sensor/cmd/set_config_param?args=udp_dest+10.0.0.8"), "set_config_param");
  EXPECT_EQ(get("/api/v1/sensor/cmd/"
                "set_config_param?args=.+%7B%22azimuth_window%22%3A%5B270000%2C90000%5D%2C%22lidar_mode%22%"
                "3A%22512x10%22%7D"),
            "set_config_param");
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=staged")["udp_dest"], "10.0.0.8");
  get("/api/v1/sensor/cmd/set_config_param?args=.+%7b%22udp_port_imu%22%3a7600%7d");  // hex may be in lower
                                                                                      // case
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=staged+udp_port_imu"), 7600);
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=active")["udp_dest"], "10.0.0.9");
  EXPECT_EQ(control_->active().generation, before.generation);
  get("/api/v1/sensor/cmd/reinitialize");
  const auto& after = control_->active();
  EXPECT_EQ(after.udp_dest, "10.0.0.8");
  EXPECT_EQ(after.metadata.mode, (LidarMode{512, 10}));
  EXPECT_EQ(after.metadata.window, (ColumnWindow{128, 383})) << "the half that looks forward";
  EXPECT_NE(after.metadata.initialization_id, before.metadata.initialization_id);
  EXPECT_GT(after.generation, before.generation);
  EXPECT_EQ(get("/api/v1/sensor/metadata/sensor_info")["status"], "INITIALIZING");
  get("/api/v1/sensor/cmd/set_udp_dest_auto");
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=staged+udp_dest"), "10.0.0.7");
}

TEST_F(OusterControl, RefusesWhatItCannotDoAndKeepsWhatItHad) {
  const auto wrong = [&](const std::string& args, const std::string& part) {
    const std::string text = get("/api/v1/sensor/cmd/set_config_param?args=" + args, 400)["error"];
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  wrong("udp_dest+nowhere", "udp_dest: expected an IPv4 address");
  wrong("udp_dest+10.0.0.8%00%D0", "udp_dest: expected an IPv4 address");
  wrong("%D0+1", "unknown");
  wrong("udp_dest+1.2.3.4.5", "udp_dest: expected an IPv4 address");
  wrong("udp_dest+1.2.3.256", "udp_dest: expected an IPv4 address");
  wrong("lidar_mode+2048x10", "1024x10");
  wrong("lidar_mode+1024x20", "1024x10");
  wrong("udp_port_lidar+70000", "from 0");
  wrong("no_such+1", "unknown");
  wrong(".+%7B%22udp_dest%22%3A%2210.0.0.8%22%2C%22operating_mode%22%3A%22FAST%22%7D", "NORMAL STANDBY");
  // The first of these two could be had.
  wrong(".+%7B%22udp_dest%22%3A%2210.0.0.8%22%2C%22udp_port_imu%22%3A-1%7D", "udp_port_imu");
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=staged")["udp_dest"], "10.0.0.9")
      << "all or nothing";
  get("/api/v1/nonsense", 404);
  get("/api/v1/sensor/cmd/get_config_param?args=active+no_such", 400);
  get("/api/v1/sensor/cmd/get_config_param?args=both", 400);
  EXPECT_EQ(control_->http("PUT", "/api/v1/sensor/config", "{}", "10.0.0.7", now_).status, 405);
  EXPECT_EQ(control_->http("POST", "/api/v1/sensor/config", "{", "10.0.0.7", now_).status, 400);
  EXPECT_EQ(
      control_->http("POST", "/api/v1/sensor/config", R"({".": {"udp_dest": "10.0.0.8"}})", "10.0.0.7", now_)
          .status,
      400)
      << "a map within the map";
  const auto bad = SensorControl::create(*device_, {}, R"({"udp_dest": 5})", now_);
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().code, ErrorCode::bad_input);
}

TEST_F(OusterControl, SpeaksTheOlderCommandsToo) {
  EXPECT_EQ(json::parse(control_->tcp("get_sensor_info ", "10.0.0.7", now_))["prod_line"], "OS-1-32");
  EXPECT_EQ(control_->tcp("set_config_param udp_port_lidar 7600 ", "10.0.0.7", now_), "set_config_param");
  EXPECT_EQ(control_->tcp("reinitialize", "10.0.0.7", now_), "reinitialize");
  EXPECT_EQ(control_->active().metadata.lidar_port, 7600);
  EXPECT_EQ(json::parse(control_->tcp("get_config_param active", "10.0.0.7", now_))["udp_port_lidar"], 7600);
  EXPECT_EQ(control_->tcp("dance", "10.0.0.7", now_), "error: unknown command dance");
  EXPECT_EQ(control_->tcp("set_config_param udp_port_lidar many", "10.0.0.7", now_).substr(0, 6), "error:");
}

TEST_F(OusterControl, StandbyIsAStateOfItsOwn) {
  const auto r =
      control_->http("POST", "/api/v1/sensor/config", R"({"operating_mode": "STANDBY"})", "10.0.0.7", now_);
  EXPECT_EQ(r.status, 200) << r.body;
  EXPECT_TRUE(control_->active().standby);
  now_ = now_ + seconds(6);
  EXPECT_EQ(get("/api/v1/sensor/metadata/sensor_info")["status"], "STANDBY");
  EXPECT_EQ(get("/api/v1/sensor/config")["operating_mode"], "STANDBY");
}

TEST_F(OusterControl, PhaseLockNeedsATimeFromOutside) {
  get("/api/v1/sensor/cmd/set_config_param?args=phase_lock_enable+true");
  get("/api/v1/sensor/cmd/set_config_param?args=phase_lock_offset+90000");
  const auto before = control_->active();
  const std::string refused = get("/api/v1/sensor/cmd/reinitialize", 400)["error"];
  EXPECT_NE(refused.find("TIME_FROM_PTP_1588"), std::string::npos) << refused;
  EXPECT_EQ(control_->active().generation, before.generation) << "goes on as it was";
  EXPECT_FALSE(control_->active().time.phase_lock);
  EXPECT_EQ(control_->tcp("reinitialize", "10.0.0.7", now_).substr(0, 6), "error:");
  for (const auto& [mode, expected] : {std::pair{"TIME_FROM_PTP_1588", SensorTime::Mode::ptp},
                                       {"TIME_FROM_SYNC_PULSE_IN", SensorTime::Mode::sync_pulse}}) {
    get(std::string("/api/v1/sensor/cmd/set_config_param?args=timestamp_mode+") + mode);
    get("/api/v1/sensor/cmd/reinitialize");
    EXPECT_TRUE(control_->active().time.phase_lock);
    EXPECT_EQ(control_->active().time.phase_lock_deg, 90);
    EXPECT_EQ(control_->active().time.mode, expected);
    EXPECT_EQ(get("/api/v1/sensor/metadata")["config_params"]["timestamp_mode"], mode);
  }
  // By POST all at once, or nothing.
  const auto post = [&](const std::string& body) {
    return control_->http("POST", "/api/v1/sensor/config", body, "10.0.0.7", now_).status;
  };
  EXPECT_EQ(post(R"({"timestamp_mode": "TIME_FROM_INTERNAL_OSC"})"), 400);
  EXPECT_EQ(get("/api/v1/sensor/cmd/get_config_param?args=staged")["timestamp_mode"],
            "TIME_FROM_SYNC_PULSE_IN");
  EXPECT_EQ(post(R"({"timestamp_mode": "TIME_FROM_INTERNAL_OSC", "phase_lock_enable": false})"), 200);
  EXPECT_EQ(post(R"({"phase_lock_offset": 360001})"), 400);
  EXPECT_EQ(post(R"({"phase_lock_offset": -1})"), 400);
  EXPECT_EQ(post(R"({"phase_lock_offset": 90.5})"), 400);
  const auto bad = SensorControl::create(*device_, {}, R"({"phase_lock_enable": true})", now_);
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().text().find("phase_lock_enable"), std::string::npos);
}

TEST_F(OusterControl, TheMultipurposeIoIsConfiguredAsTheManualSays) {
  const auto post = [&](const std::string& body, int status) {
    const auto r = control_->http("POST", "/api/v1/sensor/config", body, "10.0.0.7", now_);
    EXPECT_EQ(r.status, status) << body << ": " << r.body;
    return r.body;
  };
  post(R"({"multipurpose_io_mode": "INPUT_NMEA_UART", "nmea_leap_seconds": 37,
           "timestamp_mode": "TIME_FROM_SYNC_PULSE_IN", "nmea_baud_rate": "BAUD_115200"})",
       200);
  EXPECT_TRUE(control_->active().time.nmea);
  EXPECT_EQ(control_->active().time.nmea_leap, seconds(37));
  // The examples of the manual: 50 pulses a second of 10 ms, one each 45 degrees.
  post(R"({"multipurpose_io_mode": "OUTPUT_FROM_SYNC_PULSE_IN", "sync_pulse_out_frequency": 50})", 200);
  EXPECT_FALSE(control_->active().time.nmea);
  post(R"({"multipurpose_io_mode": "OUTPUT_FROM_ENCODER_ANGLE", "sync_pulse_out_angle": 45})", 200);
  // Pulses that run into each other.
  const std::string slow = post(R"({"sync_pulse_out_angle": 36})", 400);
  EXPECT_NE(slow.find("pulses of 10 ms every 10 ms"), std::string::npos) << slow;
  post(R"({"multipurpose_io_mode": "OUTPUT_FROM_PTP_1588", "sync_pulse_out_frequency": 100})", 400);
  post(R"({"multipurpose_io_mode": "OUTPUT_FROM_PTP_1588", "sync_pulse_out_frequency": 100,
           "sync_pulse_out_pulse_width": 9})",
       200);
  post(R"({"multipurpose_io_mode": "OUTPUT_FROM_MOON"})", 400);
  post(R"({"sync_pulse_out_frequency": 0})", 400);
  post(R"({"sync_pulse_in_polarity": "ACTIVE_SIDEWAYS"})", 400);
  EXPECT_EQ(get("/api/v1/sensor/config")["multipurpose_io_mode"], "OUTPUT_FROM_PTP_1588");
}

TEST(OusterDevice, AFrameBeginsAtItsPartOfASecondHoweverLongItRuns) {
  const auto device = SensorDevice::create(std::make_shared<FormulaLidar>(LidarMode{512, 7}));
  ASSERT_TRUE(device);
  EXPECT_EQ(device->begin(6).ns(), 857'142'857);
  EXPECT_EQ(device->begin(7).ns(), 1'000'000'000);
  EXPECT_EQ(device->begin(7ULL * 86'400 * 365 + 1).ns(), 86'400LL * 365 * 1'000'000'000 + 142'857'142);
}

TEST(OusterDevice, APacketIsFullWithItsLastColumnAndEachColumnHasItsTime) {
  auto device = SensorDevice::create(std::make_shared<FormulaLidar>(LidarMode{1024, 10}));
  ASSERT_TRUE(device);
  const Metadata m = device->metadata({Profile::single, {512, 10}, {0, 511}});
  EXPECT_EQ(device->filled(0, 0, m).ns(), 3'125'000);
  EXPECT_EQ(device->filled(2, 31, m).ns(), 300'000'000);
  auto scan = device->make_scan();
  ASSERT_TRUE(device->measure(0, BenchTime(0), {}, scan));
  const auto layout = layout_of(m);
  LidarPacketWriter w(layout);
  device->compose(2, 3, &scan, m, 1000, w);
  PacketFault fault{};
  const auto p = LidarPacket::parse(w.bytes(), layout, fault);
  ASSERT_TRUE(p);
  for (std::uint32_t i = 0; i < 16; ++i) {
    EXPECT_EQ(p->column(i).timestamp_ns(),
              200'001'000U + static_cast<std::uint64_t>(std::llround((48 + i) * 195'312.5)))
        << i;
    // Half as many columns as the simulated sensor measures: every second one.
    EXPECT_NEAR(p->column(i).pixel(5).range_mm,
                1e3 * (FormulaLidar::range_m(2 * (48 + i), 5) + test::kOrigin_m) *
                    (FormulaLidar::range_m(2 * (48 + i), 5) > 0 ? 1 : 0),
                0.51)
        << i;
  }
}

TEST(OusterDevice, ShiftsTheRowsOfItsImagesForward) {
  const auto device = SensorDevice::create(std::make_shared<FormulaLidar>());
  ASSERT_TRUE(device);
  const Metadata m = device->metadata({Profile::single, {512, 10}, {0, 511}});
  // Beams look 4.2 and 1.4 degrees to either side: 6 and 2 columns of 512.
  for (std::size_t row = 0; row < test::kBeams; ++row)
    EXPECT_EQ(m.pixel_shift[row], static_cast<std::int32_t>(row % 4) * 4) << row;
}

/// Of beam 0, in the first two columns: a return beyond what 32 bits of millimetres count, and a bright one.
class ExtremeLidar final : public SampleProvider {
 public:
  Geometry geometry() const override { return lidar_.geometry(); }
  const models::LidarScan* scan() const override { return lidar_.scan(); }
  Status capture(const Request&, Sample& sample) override {
    const models::LidarScan& s = *scan();
    const auto at = [&](std::uint32_t column, double range_m, double remission) {
      return packet_lidar::test::point_at(models::rotor_aim(s.beams[0], s.azimuth_rad(column)), range_m,
                                          remission, column * s.column_period_s, 0, 0);
    };
    packet_lidar::test::store_points(std::vector{at(0, 4'294'987.5, 50), at(1, 10, 300)}, sample);
    return {};
  }

 private:
  FormulaLidar lidar_;
};

TEST(OusterDevice, GivesNoReturnThatIsTooFarAndNoReflectivityAbove255) {
  auto device = SensorDevice::create(std::make_shared<ExtremeLidar>());
  ASSERT_TRUE(device);
  const Metadata m = device->metadata({Profile::single, {512, 10}, {0, 511}});
  auto scan = device->make_scan();
  ASSERT_TRUE(device->measure(0, BenchTime(0), {}, scan));
  const auto layout = layout_of(m);
  LidarPacketWriter w(layout);
  device->compose(0, 0, &scan, m, 0, w);
  PacketFault fault{};
  const auto p = LidarPacket::parse(w.bytes(), layout, fault);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->column(0).pixel(0).range_mm, 0U);
  EXPECT_NEAR(p->column(1).pixel(0).range_mm, 10'016, 1);
  EXPECT_EQ(p->column(1).pixel(0).reflectivity, 255);
}

TEST(OusterDevice, RefusesASensorModelOfAnotherScanner) {
  class Other final : public SampleProvider {
   public:
    explicit Other(models::LidarScan s) : scan_(std::move(s)) {}
    Geometry geometry() const override { return {SampleKind::point_cloud, 0, 0, 1 << 20, "lidar"}; }
    const models::LidarScan* scan() const override { return &scan_; }
    Status capture(const Request&, Sample&) override { return {}; }
    models::LidarScan scan_;
  };
  const auto message = [](const std::function<void(models::LidarScan&)>& change) {
    models::LidarScan s = *FormulaLidar().scan();
    change(s);
    const auto device = SensorDevice::create(std::make_shared<Other>(s));
    return device ? std::string() : device.error().text();
  };
  EXPECT_EQ(message([](models::LidarScan&) {}), "");
  EXPECT_NE(message([](models::LidarScan& s) { s.beams.pop_back(); }).find("31 beams"), std::string::npos);
  EXPECT_NE(message([](models::LidarScan& s) { s.columns = 1000; }).find("1000 columns"), std::string::npos);
  EXPECT_NE(message([](models::LidarScan& s) { s.rotation_radps *= -1; }).find("clockwise"),
            std::string::npos);
  EXPECT_NE(message([](models::LidarScan& s) { s.beams[4].horizontal_offset_m = 0.01; }).find("beam 4"),
            std::string::npos);
  EXPECT_FALSE(SensorDevice::create(nullptr));
}

}  // namespace
}  // namespace rigor::ouster
