#include "bench/sensing/sensor_model_kind.h"

#include <fmt/format.h>

namespace rigor {
namespace {

struct Names {
  const char *sensor, *kind;
};
Names names_of(SampleKind kind) {
  if (kind == SampleKind::point_cloud) return {"a LiDAR", "point_cloud"};
  if (kind == SampleKind::range_image) return {"a time-of-flight camera", "range_image"};
  if (kind == SampleKind::imu) return {"an inertial unit", "imu"};
  if (kind == SampleKind::nav_fix) return {"a satellite receiver", "nav_fix"};
  if (kind == SampleKind::odometry) return {"odometry", "odometry"};
  return {"a camera", "image"};
}

}  // namespace

SampleKind kind_of_sensor_model(const ConfigNode& params) {
  const auto sensor_model = ConfigDocument::load(params.base_dir() / params.text("sensor"));
  if (!sensor_model) throw ConfigError(sensor_model.error());
  if (sensor_model->has("accelerometer")) return SampleKind::imu;
  if (sensor_model->has("wheel_radius_m")) return SampleKind::odometry;
  if (sensor_model->has("status")) return SampleKind::nav_fix;
  if (sensor_model->has("scan")) return SampleKind::point_cloud;
  return sensor_model->has("modulation") ? SampleKind::range_image : SampleKind::image;
}

void expect_sensor_model(const ConfigNode& params, SampleKind kind) {
  const SampleKind found = kind_of_sensor_model(params);
  if (found == kind) return;
  const Names wanted = names_of(kind), got = names_of(found);
  throw params.error(
      "sensor", fmt::format("expected the sensor model of {}, got {}, the sensor model of {}: give one of "
                            "configs/sensors/ that fits, or the channel `kind: {}`",
                            wanted.sensor, params.text("sensor"), got.sensor, got.kind));
}

}  // namespace rigor
