// Recordings of real LiDARs for tests.
#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "calibration/lidar/lidar_returns.h"
#include "calibration/procedures/recording_input.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "tests/paths.h"

namespace rigor::calibration::test {

namespace fs = std::filesystem;

struct Recording {
  LidarReturns returns;
  models::LidarModel sensor_model;
  std::vector<std::string> warnings;
};

inline fs::path file_of(const std::string& name) { return rigor::test::test_data(name); }
#define NEED_RECORDING(name)                                                          \
  if (!rigor::calibration::test::fs::exists(rigor::calibration::test::file_of(name))) \
  GTEST_SKIP() << "test data: " << (name) << " is not here"

inline Recording read_returns(const std::string& sensor_model, const std::string& name) {
  Recording r;
  auto model = load_lidar_model(fs::path(rigor::test::source_dir()) / "configs/sensors" / sensor_model);
  EXPECT_TRUE(model) << model.error().text();
  r.sensor_model = *model;
  ReturnCollector collector(model->scan);
  auto in = read_samples(file_of(name), "", SampleKind::point_cloud, [&](const Sample& s) {
    std::vector<LidarPoint> points(s.as<PointCloudInfo>()->count);
    std::memcpy(points.data(), s.bytes().data(), points.size() * sizeof(LidarPoint));
    collector.add(points);
    return true;
  });
  EXPECT_TRUE(in) << in.error().text();
  if (in) r.warnings = in->warnings;
  r.returns = collector.take();
  return r;
}

}  // namespace rigor::calibration::test
