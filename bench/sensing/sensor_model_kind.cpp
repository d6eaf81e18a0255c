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

SampleKind kind_of_sheet(const ConfigNode& params) {
  const auto sheet = ConfigDocument::load(params.base_dir() / params.text("sensor"));
  if (!sheet) throw ConfigError(sheet.error());
  if (sheet->has("accelerometer")) return SampleKind::imu;
  if (sheet->has("wheel_radius_m")) return SampleKind::odometry;
  if (sheet->has("status")) return SampleKind::nav_fix;
  if (sheet->has("scan")) return SampleKind::point_cloud;
  return sheet->has("modulation") ? SampleKind::range_image : SampleKind::image;
}

void expect_sheet(const ConfigNode& params, SampleKind kind) {
  const SampleKind found = kind_of_sheet(params);
  if (found == kind) return;
  const Names wanted = names_of(kind), got = names_of(found);
  throw params.error(
      "sensor", fmt::format("expected the sensor model of {}, got {}, the sensor model of {}: give one of "
                            "configs/sensors/ that fits, or the channel `kind: {}`",
                            wanted.sensor, params.text("sensor"), got.sensor, got.kind));
}

}  // namespace rigor
