// A small bench of simulated sensors of light, as files: a room with a box on a turntable, a camera, a
// time-of-flight camera, a 2D and a 3D LiDAR. Quick to measure, and with ranges known by hand.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "tests/cli/command.h"

namespace rigor::test {

/// Walls at x = 4 and x = −4; a box of 0.4 m whose centre is 1 m from the axis of the turntable at the
/// origin, on +x at angle 0.
inline constexpr const char* kWorld = R"(
materials:
  - { name: white, reflectance: { red: 0.8, green: 0.8, blue: 0.8, nir: 0.8 } }
  - { name: grey, reflectance: { red: 0.4, green: 0.4, blue: 0.4, nir: 0.4 } }
nodes:
  - { name: turntable, position_m: [0, 0, 0], hinge: { axis: [0, 0, 1] } }
bodies:
  - { name: east, size_m: [0.2, 20, 4], material: white, position_m: [4.1, 0, 0] }
  - { name: west, size_m: [0.2, 20, 4], material: white, position_m: [-4.1, 0, 0] }
  - { name: block, size_m: [0.4, 0.4, 0.4], material: grey, node: turntable, position_m: [1, 0, 0] }
sky:
  zenith_radiance_w_per_m2_sr: { red: 0.4, green: 0.4, blue: 0.4, nir: 0.02 }
  horizon_radiance_w_per_m2_sr: { red: 0.4, green: 0.4, blue: 0.4, nir: 0.02 }
)";
inline constexpr const char* kScanner = R"(
scan: { rotation_hz: 25, start_deg: -90, end_deg: 90, step_deg: 1 }
footprint: { divergence_mrad: [5, 5], sub_rays: 5 }
range: { min_m: 0.05, max_m: 20, step_mm: 1 }
noise: { floor_mm: 4 }
)";
inline constexpr const char* kScanner3d = R"(
scan: { rotation_hz: 10, direction: clockwise, start_deg: 0, end_deg: -360, step_deg: 2 }
beams: { elevation_deg: [-4, 0, 4, 8], fire_us: [0, 2, 4, 6] }
footprint: { divergence_mrad: [3, 1.5], sub_rays: 5 }
range: { min_m: 0.05, max_m: 100, step_mm: 2 }
noise: { floor_mm: 6 }
)";
inline constexpr const char* kTof = R"(
width_px: 32
height_px: 24
intrinsics: { fx_px: 40 }
modulation: { frequencies_mhz: [15], integration_time_ms: 1 }
illumination: { radiant_intensity_w_per_sr: 2 }
pixel: { pitch_um: 40, read_noise_e: 20 }
sampling: { samples: 4 }
)";
inline constexpr const char* kCamera = R"(
width_px: 64
height_px: 48
exposure_us: 8000
intrinsics: { fx_px: 60, fy_px: 60, cx_px: 31.5, cy_px: 23.5 }
optics: { f_number: 2.8 }
)";
/// Sensors sit at the origin's height, south of the turntable's axis, and look along +x or at the box.
inline constexpr const char* kChannels = R"(
channels:
  camera:
    kind: image
    backend: simulated
    rate_hz: 20
    latency_ms: 30
    sensor: camera.yaml
    renderer: rays
    quality: { samples_per_pixel: 2 }
    T_world_sensor: { position_m: [-3, 0, 0.5], look_at_m: [1, 0, 0] }
  tof:
    kind: range_image
    backend: simulated
    rate_hz: 20
    latency_ms: 30
    sensor: tof.yaml
    renderer: rays
    T_world_sensor: { position_m: [-1, 0, 0], look_at_m: [4, 0, 0] }
  flat:
    kind: point_cloud
    backend: simulated
    rate_hz: 25
    latency_ms: 50
    sensor: scanner.yaml
    renderer: rays
    T_world_sensor: { position_m: [0, 0, 0], roll_pitch_yaw_deg: [0, 0, 0] }
  round:
    kind: point_cloud
    backend: simulated
    rate_hz: 10
    latency_ms: 110
    sensor: scanner3d.yaml
    renderer: rays
    T_world_sensor: { position_m: [0, 0, 0], quaternion_wxyz: [1, 0, 0, 0] }
)";

class SensingBench : public ::testing::Test {
 protected:
  void SetUp() override {
    write_file(dir / "world.yaml", kWorld);
    write_file(dir / "scanner.yaml", kScanner);
    write_file(dir / "scanner3d.yaml", kScanner3d);
    write_file(dir / "tof.yaml", kTof);
    write_file(dir / "camera.yaml", kCamera);
    rig(kChannels);
  }
  void rig(const std::string& channels) {
    write_file(
        dir / "rig.yaml",
        "name: bench\nclock: virtual\nduration_s: 0.5\nsimulation: { world: world.yaml }\n" + channels);
  }
  /// One channel of kind point_cloud by `scanner.yaml`, with these keys.
  void scanner_rig(const std::string& keys) {
    rig("channels:\n  flat:\n    kind: point_cloud\n    backend: simulated\n    rate_hz: 25\n    latency_ms: "
        "50\n    sensor: scanner.yaml\n" +
        keys);
  }
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  Said in_dir(std::vector<std::string> words) const { return rigor(std::move(words), dir.path()); }

  TempDir dir;
};

}  // namespace rigor::test
