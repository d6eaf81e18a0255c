// LiDAR models as files: those that come along, and complaints with their place.
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "tests/paths.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <set>

namespace rigor {
namespace {

using models::LidarModel;
using testing::HasSubstr;
constexpr double kDegree = std::numbers::pi / 180;

Result<LidarModel> read(const std::string& text) {
  auto root = ConfigDocument::parse(text, "lidar.yaml");
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_lidar_model(*root);
}
LidarModel config(const std::string& name) {
  auto m = load_lidar_model(rigor::test::source_dir() + "/configs/sensors/" + name + ".yaml");
  EXPECT_TRUE(m) << m.error().text();
  return m ? *m : LidarModel{};
}
std::string complaint(const std::string& text) {
  auto m = read(text);
  EXPECT_FALSE(m);
  return m ? "" : m.error().text();
}

TEST(LidarConfigs, HaveTheColumnsOfTheirDevices) {
  struct Row {
    const char* name;
    std::size_t beams, columns;
    double first_deg, last_deg, period_s;
  };
  for (const Row& r : {Row{"sick-lms111", 1, 541, -135, 135, 0.02},
                       {"sick-lms511", 1, 1141, -95, 95, 0.04},
                       {"sick-tim781s", 1, 811, -135, 135, 1 / 15.0},
                       {"hokuyo-urg04lx", 1, 683, -119.8828125, 119.8828125, 0.1},
                       {"hokuyo-utm30lx", 1, 1081, -135, 135, 0.025},
                       {"velodyne-vlp16", 16, 1809, 0, -359.92, 0.1},
                       {"velodyne-hdl64e", 64, 2084, 0, -359.94, 0.1},
                       {"ouster-os1-64", 64, 1024, 0, -359.6484375, 0.1}}) {
    const LidarModel m = config(r.name);
    EXPECT_EQ(m.scan.beams.size(), r.beams) << r.name;
    EXPECT_EQ(m.scan.columns, r.columns) << r.name;
    EXPECT_NEAR(m.scan.azimuth_rad(0) / kDegree, r.first_deg, 1e-6) << r.name;
    EXPECT_NEAR(m.scan.azimuth_rad(m.scan.columns - 1) / kDegree, r.last_deg, 0.01) << r.name;
    EXPECT_NEAR(std::abs(2 * std::numbers::pi / m.scan.rotation_radps), r.period_s, 1e-9) << r.name;
  }
  const LidarModel rosette = config("rosette");
  EXPECT_EQ(rosette.scan.kind, models::LidarScanKind::rosette);
  EXPECT_EQ(rosette.scan.columns, 10000U);
}

TEST(LidarConfigs, Vlp16HasTheBeamsAndTimesOfItsManual) {
  const LidarModel m = config("velodyne-vlp16");
  ASSERT_EQ(m.scan.beams.size(), 16U);
  const double elevation[] = {-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15};
  for (std::size_t i = 0; i < 16; ++i) {
    EXPECT_NEAR(m.scan.beams[i].elevation_rad / kDegree, elevation[i], 1e-9);
    EXPECT_NEAR(m.scan.beams[i].fire_time_s, 2.304e-6 * static_cast<double>(i), 1e-12);
    // Beams are as high above the middle as they point down: 15° and 11.2 mm, mirrored.
    EXPECT_NEAR(m.scan.beams[i].vertical_offset_m, -m.scan.beams[15 - i].vertical_offset_m, 1e-12);
  }
  EXPECT_NEAR(m.scan.beams[0].vertical_offset_m, 0.0112, 1e-12);
  EXPECT_NEAR(m.scan.column_period_s, 55.296e-6, 1e-15);
  EXPECT_LT(m.scan.rotation_radps, 0);
  EXPECT_DOUBLE_EQ(m.range.step_m, 0.002);
}

TEST(LidarYaml, OneNumberStandsForAllBeams) {
  const auto m = read(
      "scan: { rotation_hz: 10, step_deg: 1 }\nrange: { max_m: 10 }\n"
      "beams: { radial_offset_mm: [12], elevation_deg: [1, 2, 3] }\n");
  ASSERT_TRUE(m) << m.error().text();
  ASSERT_EQ(m->scan.beams.size(), 3U);
  EXPECT_DOUBLE_EQ(m->scan.beams[2].radial_offset_m, 0.012);
  EXPECT_EQ(m->scan.columns, 360U);
}

TEST(LidarYaml, ErrorsInTheMeanAreOfTheRange) {
  const auto m = read(
      "scan: { rotation_hz: 10, step_deg: 1 }\n"
      "range: { max_m: 10, bias_mm: -3, scale: 1.002, remission_bias_mm: 20, incidence_bias_mm: -7 }\n");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_DOUBLE_EQ(m->range.bias_m, -0.003);
  EXPECT_DOUBLE_EQ(m->range.scale, 1.002);
  EXPECT_DOUBLE_EQ(m->range.remission_bias_m, 0.02);
  EXPECT_DOUBLE_EQ(m->range.incidence_bias_m, -0.007);
}

TEST(LidarYaml, DefaultsAreAPerfectSensor) {
  const auto m =
      read("scan: { rotation_hz: 25, start_deg: -90, end_deg: 90, step_deg: 0.5 }\nrange: { max_m: 10 }\n");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->scan.columns, 361U);
  EXPECT_EQ(m->footprint.sub_rays, 1);
  EXPECT_EQ(m->noise.floor_m, 0);
  EXPECT_EQ(m->noise.scale_m, 0);
  EXPECT_EQ(m->range.step_m, 0);
  EXPECT_EQ(m->range.scale, 1);
  EXPECT_EQ(m->range.remission_bias_m, 0);
  EXPECT_EQ(m->range.incidence_bias_m, 0);
  EXPECT_EQ(m->remission.maximum, 0);
  EXPECT_EQ(m->detection.minimum_remission, 0);
  EXPECT_EQ(m->retro.crosstalk, 0);
  EXPECT_EQ(m->sun.half_angle_rad, 0);
}

const char* const kScan = "scan: { rotation_hz: 10, step_deg: 1 }\n";

TEST(LidarYaml, ComplainsWithPlaceAndKey) {
  const std::string scan = kScan, range = "range: { max_m: 10 }\n";
  // Line and column, then the way to the key.
  EXPECT_THAT(complaint(scan + range + "fotprint: {}\n"), HasSubstr("lidar.yaml:3:1: fotprint: unknown key"));
  EXPECT_THAT(complaint(scan + range + "fotprint: {}\n"), HasSubstr("footprint"));
  EXPECT_THAT(complaint(scan + range + "noise: { floor_mm: -1 }\n"),
              HasSubstr("lidar.yaml:3:20: noise.floor_mm"));
  EXPECT_THAT(complaint(scan + range + "noise: { floor_mm: .nan }\n"),
              HasSubstr("lidar.yaml:3:20: noise.floor_mm"));
  EXPECT_THAT(complaint(scan + range + "noise: { scale_mm: .inf }\n"), HasSubstr("noise.scale_mm"));
  EXPECT_THAT(complaint(scan + range + "footprint: { sub_rays: 0 }\n"), HasSubstr("footprint.sub_rays"));
  EXPECT_THAT(complaint(scan + range + "footprint: { sub_rays: 257 }\n"), HasSubstr("footprint.sub_rays"));
  EXPECT_THAT(complaint(scan + range + "footprint: { sub_rays: 5, most_sub_rays: 5 }\n"),
              HasSubstr("footprint.most_sub_rays"));
  EXPECT_THAT(complaint(scan + range + "footprint: { sub_rays: 2, most_sub_rays: 40 }\n"),
              HasSubstr("footprint.most_sub_rays"));
  EXPECT_TRUE(read(scan + range + "footprint: { sub_rays: 5, most_sub_rays: 40 }\n"));
  EXPECT_THAT(complaint(scan + range + "footprint: { divergence_mrad: [] }\n"), HasSubstr("divergence_mrad"));
  EXPECT_THAT(complaint(scan + range + "echoes: { returns: strongst }\n"), HasSubstr("strongest"));
  EXPECT_THAT(complaint(scan), HasSubstr("range"));
  EXPECT_THAT(complaint(range), HasSubstr("scan"));
  EXPECT_THAT(complaint("scan: { rotation_hz: 0, step_deg: 1 }\n" + range),
              HasSubstr("lidar.yaml:1:22: scan.rotation_hz"));
  EXPECT_THAT(complaint("scan: { rotation_hz: 10 }\n" + range), HasSubstr("step_deg or column_us"));
  EXPECT_THAT(complaint("scan: { rotation_hz: 10, step_deg: 1, column_us: 5 }\n" + range),
              HasSubstr("step_deg or column_us"));
  EXPECT_THAT(complaint("scan: { rotation_hz: 10, step_deg: 1, start_deg: 10, end_deg: -10 }\n" + range),
              HasSubstr("scan.end_deg"));
  EXPECT_THAT(complaint(scan + "range: { min_m: 11, max_m: 10 }\n"), HasSubstr("min < max"));
  EXPECT_THAT(complaint(scan + range + "beams: { elevation_deg: [1, 2], fire_us: [0, 1, 2] }\n"),
              HasSubstr("lidar.yaml:3:42: beams.fire_us"));
  EXPECT_THAT(complaint(scan + range + "beams: { elevation_deg: [1, 95] }\n"), HasSubstr("lidar.yaml:3:29"));
  EXPECT_THAT(complaint(scan + range + "remission: { range_exponent: 2 }\n"), HasSubstr("reference_range"));
}

TEST(LidarYaml, RefusesMoreBeamsAndColumnsThanAnyDeviceHas) {
  std::string list = "0";
  for (int i = 1; i <= 4096; ++i) list += ", 0";
  EXPECT_THAT(
      complaint(std::string(kScan) + "range: { max_m: 10 }\nbeams: { elevation_deg: [" + list + "] }\n"),
      HasSubstr("1 to 4096"));
  EXPECT_THAT(complaint("scan: { rotation_hz: 10, column_us: 1e-9 }\nrange: { max_m: 10 }\n"),
              HasSubstr("columns"));
  // Each within its limit, but not together.
  std::string most = "0";
  for (int i = 1; i < 4096; ++i) most += ", 0";
  EXPECT_THAT(
      complaint("scan: { rotation_hz: 10, step_deg: 0.01 }\nrange: { max_m: 10 }\nbeams: { elevation_deg: [" +
                most + "] }\n"),
      HasSubstr("firings"));
}

TEST(LidarModel, RefusesWhatAFileCouldNotSay) {
  LidarModel m;
  ASSERT_TRUE(m.validate());
  m.scan.beams.clear();
  EXPECT_FALSE(m.validate());
  m = {};
  m.footprint.sub_rays = 0;
  EXPECT_FALSE(m.validate());
  m = {};
  m.scan.beams[0].range_bias_m = std::nan("");
  EXPECT_FALSE(m.validate());
  m = {};
  m.scan.columns = 0;
  EXPECT_FALSE(m.validate());
  m = {};
  m.scan.columns = 1000;
  m.scan.column_period_s = 1;
  EXPECT_FALSE(m.validate()) << "longer than the points' offsets can say";
  m = {};
  m.range.max_m = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(m.validate());
}

TEST(LidarModel, ARosetteGoesOnWithoutRepeating) {
  const LidarModel m = config("rosette");
  std::set<std::pair<int, int>> cells[2];
  double widest = 0;
  for (int scan = 0; scan < 2; ++scan)
    for (std::uint32_t c = 0; c < m.scan.columns; ++c) {
      const auto aim =
          models::rosette_aim(m.scan.beams[0], m.scan.prisms, 0.1 * scan + c * m.scan.column_period_s);
      const double off = std::acos(aim.direction[0]);
      widest = std::max(widest, off);
      cells[scan].insert({static_cast<int>(std::floor(aim.direction[1] * 400)),
                          static_cast<int>(std::floor(aim.direction[2] * 400))});
    }
  EXPECT_NEAR(2 * widest / kDegree, 38.4, 1.5);
  // The second scan sees places that the first did not.
  std::size_t fresh = 0;
  for (const auto& cell : cells[1]) fresh += cells[0].count(cell) == 0;
  EXPECT_GT(fresh, cells[1].size() / 10);
}

}  // namespace
}  // namespace rigor
