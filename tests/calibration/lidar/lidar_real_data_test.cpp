// Recordings of real devices.
#include <gtest/gtest.h>

#include <iostream>

#include "calibration/lidar/lidar_fit.h"
#include "tests/calibration/lidar/recorded_returns.h"

namespace rigor::calibration {
namespace {

using test::read_returns;
using test::Recording;

TEST(LidarRealData, BiasesOfAVlp16HalveWhatIsLeftOnSectorsThatWereWithheld) {
  NEED_RECORDING("velodyne_vlp16/vlp16_stationary_room.pcap");
  const Recording r = read_returns("velodyne-vlp16.yaml", "velodyne_vlp16/vlp16_stationary_room.pcap");
  ASSERT_EQ(r.warnings.size(), 1u);
  EXPECT_NE(r.warnings[0].find("0x21 says HDL-32E"), std::string::npos) << r.warnings[0];
  const auto fit = fit_lidar(r.returns, r.sensor_model);
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_TRUE(fit->bias && fit->noise);
  std::cout << fit->result.model << ": withheld " << fit->bias->held_out_rms_m << " m against "
            << fit->bias->held_out_uncorrected_m << "; noise in a withheld band to "
            << fit->noise->withheld_error << "\n";
  EXPECT_TRUE(fit->bias->model.beams) << fit->bias->model.name;
  EXPECT_EQ(fit->bias->planes.size(), 2u);
  EXPECT_LE(fit->bias->held_out_rms_m, 0.6 * fit->bias->held_out_uncorrected_m);
  EXPECT_LE(fit->noise->withheld_error, 0.1);
  EXPECT_LE(fit->noise->result.parameters.size(), 5u);
  EXPECT_GT(fit->noise->bands.front().measured_m, 1.8 * fit->noise->bands.back().measured_m);
}

TEST(LidarRealData, NoiseOfAnLms511IsOneNumber) {
  NEED_RECORDING("sick_lidar/20210301_lms511.json");
  const Recording r = read_returns("sick-lms511.yaml", "sick_lidar/20210301_lms511.json");
  EXPECT_EQ(r.returns.scans, 136u);
  const auto fit = fit_range_noise(r.returns, r.sensor_model);
  ASSERT_TRUE(fit) << fit.error().text();
  std::cout << "sigma " << fit->sigma_m << ", by rounded values " << fit->rounded_sigma_m << "\n";
  EXPECT_NEAR(fit->sigma_m, 0.0036, 0.0003);
  EXPECT_NEAR(fit->rounded_sigma_m, 0.0036, 0.0003);
  EXPECT_EQ(fit->result.model, "constant");
  ASSERT_EQ(fit->result.not_identifiable.size(), 1u);
  EXPECT_EQ(fit->result.not_identifiable[0].first, "noise_slope");
}

/// Bright walls of a small room: what no surface there has is not what the device cannot see.
TEST(LidarRealData, NoThresholdIsToldWhereTheRoomHasNoDarkSurfaces) {
  for (const auto& [sensor_model, name] :
       {std::pair{"sick-lms511.yaml", "sick_lidar/20210301_lms511.json"},
        {"sick-tim781s.yaml", "sick_lidar/20210125-tim781s-scandata.json"}}) {
    NEED_RECORDING(name);
    const Recording r = read_returns(sensor_model, name);
    const auto fit = fit_lidar(r.returns, r.sensor_model, {.noise_model = "constant"});
    ASSERT_TRUE(fit) << fit.error().text();
    for (const char* p : {"minimum_remission", "limit_remission"})
      EXPECT_EQ(fit->result.find(p), nullptr) << name << ": " << p << " " << fit->result.find(p)->value;
  }
}

TEST(LidarRealData, NoiseOfATim781s) {
  NEED_RECORDING("sick_lidar/20210125-tim781s-scandata.json");
  const Recording r = read_returns("sick-tim781s.yaml", "sick_lidar/20210125-tim781s-scandata.json");
  EXPECT_EQ(r.returns.scans, 140u);
  const auto fit = fit_range_noise(r.returns, r.sensor_model);
  ASSERT_TRUE(fit) << fit.error().text();
  std::cout << "sigma " << fit->sigma_m << ", by rounded values " << fit->rounded_sigma_m << "\n";
  EXPECT_NEAR(fit->sigma_m, 0.0116, 0.0008);
}

}  // namespace
}  // namespace rigor::calibration
