// That the LiDAR's and the air's arithmetic is GLSL as well: compiled with the tests, not run.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "sensor-hal/models/one_source.glsl.h"
#include "sensor-hal/models/air/air.glsl.h"
#include "sensor-hal/models/lidar/lidar.glsl.h"

layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Values { float value[]; };

void main() {
  uint i = gl_GlobalInvocationID.x;
  float range_m = value[i];
  float e = lidar_surface_remission(0.5, 0.4, 0.1, 0.5, 0.0, 100.0) *
            air_two_way_transmission(air_fog_extinction_per_m(200.0, 905.0) *
                                     air_way_below_m(1.0, 0.1, range_m, 10.0)) +
            air_rain_extinction_per_m(10.0) + air_snow_extinction_per_m(1.0);
  float x;
  float y;
  float z;
  lidar_risley_direction(1.0, 0.0, 0.0, 0.3, 1.0, 0.3, 2.0, 1.51, x, y, z);
  float q = lidar_received_power(e, range_m, 10.0, 1.0);
  value[i] = lidar_quantise(range_m + lidar_range_sigma_m(q, 0.002, 0.006, 0.17, 1.0), 0.002) + x + y + z +
             lidar_nearest_drop_m(0.5, 0.5, 0.01, 0.003, 300.0) + lidar_remission_units(e, range_m, 100.0, 3.0, 0.0, 0.0);
}
