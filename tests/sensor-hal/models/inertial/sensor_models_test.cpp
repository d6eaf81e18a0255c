// The sensor models that come along.
#include <gtest/gtest.h>

#include <cmath>

#include "sensor-hal/models/gnss/gnss_yaml.h"
#include "sensor-hal/models/imu/imu_yaml.h"
#include "sensor-hal/models/odometry/odometry_yaml.h"
#include "tests/paths.h"

namespace rigor {
namespace {

const std::filesystem::path kSensorModels =
    std::filesystem::path(rigor::test::source_dir()) / "configs/sensors";

TEST(SensorModels, OfAnInertialUnit) {
  const auto m = load_imu_model(kSensorModels / "imu-mems.yaml");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_TRUE(models::check(*m));
  // 0.014 (°/s)/√Hz, over positive frequencies.
  EXPECT_NEAR(m->gyroscope.white[0], 0.014 / std::sqrt(2) * M_PI / 180, 1e-9);
  EXPECT_NEAR(m->accelerometer.resolution * 32768, m->accelerometer.range, 1e-6);
  EXPECT_NEAR(m->gyroscope.resolution * 32768, m->gyroscope.range, 1e-6);
}

TEST(SensorModels, OfReceiversAddUpToTheirStatedAccuracy) {
  const auto single = load_gnss_model(kSensorModels / "gnss-single.yaml"),
             rtk = load_gnss_model(kSensorModels / "gnss-rtk.yaml");
  ASSERT_TRUE(single) << single.error().text();
  ASSERT_TRUE(rtk) << rtk.error().text();
  const auto sigma = [](const models::GnssModel& m) {
    return std::hypot(m.best.white_horizontal_m, m.best.drift_horizontal_m, m.multipath_horizontal_m);
  };
  EXPECT_NEAR(sigma(*single) * 1.1774, 1.5, 0.02);
  EXPECT_NEAR(sigma(*rtk) * 1.1774, 0.01, 2e-4);
  const double up =
      std::hypot(rtk->best.white_vertical_m, rtk->best.drift_vertical_m, rtk->multipath_vertical_m);
  EXPECT_NEAR(up * 0.6745, 0.01, 4e-4);
  EXPECT_EQ(rtk->status, FixStatus::rtk_fixed);
}

TEST(SensorModels, OfOdometry) {
  const auto m = load_odometry_model(kSensorModels / "odometry-skid-steer.yaml");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_TRUE(models::check(*m));
}

}  // namespace
}  // namespace rigor
