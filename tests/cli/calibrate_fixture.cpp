#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

constexpr const char* kWorld = R"(
materials:
  - { name: grey, reflectance: { red: 0.34, green: 0.34, blue: 0.34, nir: 0.40 } }
  - { name: paper, reflectance: { red: 0.80, green: 0.80, blue: 0.80, nir: 0.82 } }
  - { name: ink, reflectance: { red: 0.04, green: 0.04, blue: 0.04, nir: 0.05 } }
nodes:
  # Not upright: the board's normal goes round a cone, so that no shift and no turn is left free.
  - { name: turntable, position_m: [0, 0, 1.2], roll_pitch_yaw_deg: [35, 0, 0], hinge: { axis: [0, 0, 1] } }
bodies:
  - name: chessboard
    node: turntable
    size_m: [1.1, 0.8, 0.02]
    position_m: [0, 0, 0]
    roll_pitch_yaw_deg: [60, 0, 0]
    material: paper
    chessboard: { columns: 9, rows: 6, square_m: 0.1, dark_material: ink }
  - { name: wall, size_m: [8, 0.2, 6], position_m: [0, 2.5, 2], material: grey }
  - { name: side, size_m: [0.2, 8, 6], position_m: [3, 0, 2], material: grey }
ground: { material: grey, other_material: grey, half_extent_m: 20, cell_m: 5, noise_contrast: 0 }
sun:
  direction_to_sun: [-0.25, -0.75, 0.6]
  irradiance_w_per_m2: { red: 4.6, green: 4.7, blue: 4.2, nir: 2.8 }
sky:
  zenith_radiance_w_per_m2_sr: { red: 0.20, green: 0.30, blue: 0.50, nir: 0.07 }
  horizon_radiance_w_per_m2_sr: { red: 0.45, green: 0.50, blue: 0.55, nir: 0.20 }
)";

constexpr const char* kBoardRig = R"(
name: calibration-recording
seed: 1
clock: virtual
loop: { rate_hz: 1000, overrun: skip }
simulation:
  world: world.yaml
  workers: 2
  joints:
    turntable: { channel: turntable, position: position, rate: rate, unit: deg }
channels:
  turntable:
    kind: registers
    backend: modbus
    emulated_by: turntable
    rate_hz: 100
    latency_ms: 10
    address: 127.0.0.1
    port: 5020
    registers:
      - { name: position, table: input_registers, address: 0, type: s32, byte_order: ABCD, scale: 0.001, unit: deg }
      - { name: rate, table: input_registers, address: 2, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }
  left:
    kind: image
    rate_hz: 20
    latency_ms: 100
    pair:
      active: real
      real: { backend: aravis, emulated_by: left, device: Rigor-left, interface: 127.0.0.1, pixel_format: Mono8, exposure_us: 2500, gain_db: 0, trigger: free_run }
      simulated:
        backend: simulated
        sensor: CONFIGS/sensors/demo-camera.yaml
        pixel_format: Mono8
        exposure_us: 2500
        T_world_sensor: { position_m: [-0.2, -2.2, 1.5], look_at_m: [0, 0, 1.2] }
  right:
    kind: image
    backend: simulated
    rate_hz: 5
    latency_ms: 100
    sensor: CONFIGS/sensors/demo-camera.yaml
    pixel_format: Mono8
    exposure_us: 2500
    T_world_sensor: { position_m: [0.2, -2.2, 1.5], look_at_m: [0, 0, 1.2] }
  top:
    kind: point_cloud
    backend: simulated
    rate_hz: 10
    latency_ms: 110
    sensor: CONFIGS/sensors/velodyne-vlp16.yaml
    renderer: rays
    T_world_sensor: { position_m: [0.0, -2.2, 1.3], roll_pitch_yaw_deg: [0, 0, 90] }
sinks:
  table_command:
    backend: modbus
    emulated_by: turntable
    latency_ms: 10
    address: 127.0.0.1
    port: 5020
    registers:
      - { name: enable, table: holding_registers, address: 0, type: u16 }
      - { name: target_rate, table: holding_registers, address: 4, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }
    safe: { enable: 0, target_rate: 0 }
emulators:
  turntable: { backend: modbus, address: 127.0.0.1, port: 5020, model: turntable, joint: turntable }
  left:
    backend: aravis
    address: 127.0.0.1
    vendor: Rigor
    serial: left
    rate_hz: 20
    sensor: CONFIGS/sensors/demo-camera.yaml
    T_world_sensor: { position_m: [-0.2, -2.2, 1.5], look_at_m: [0, 0, 1.2] }
application: { name: turntable-sweep, table: table_command, amplitude_deg: 50, period_s: 6, rate_hz: 50 }
)";

constexpr const char* kWallRig = R"(
name: still
seed: 1
clock: virtual
loop: { rate_hz: 1000, overrun: skip }
simulation: { world: world.yaml, workers: 2 }
channels:
  tof:
    kind: range_image
    backend: simulated
    rate_hz: 10
    latency_ms: 80
    sensor: CONFIGS/sensors/sr4000.yaml
    renderer: rays
    T_world_sensor: { position_m: [-2.5, 0.5, 2], look_at_m: [-2.5, 2.5, 2] }
)";

std::string with_configs(std::string text) {
  const std::string here = "CONFIGS/";
  for (std::size_t at = 0; (at = text.find(here, at)) != std::string::npos;)
    text.replace(at, here.size(), config(""));
  return text;
}

}  // namespace

const CalibrationRecordings& CalibrationRecordings::get() {
  static const CalibrationRecordings recordings;
  return recordings;
}

CalibrationRecordings::CalibrationRecordings() {
  write_file(dir_ / "world.yaml", kWorld);
  write_file(dir_ / "board.yaml", with_configs(kBoardRig));
  write_file(dir_ / "wall.yaml", with_configs(kWallRig));
  const auto record = [&](const std::string& name, const std::string& seconds) {
    const Said said =
        rigor({"run", name + ".yaml", "--duration", seconds, "--record", name + ".mcap"}, dir_.path());
    EXPECT_EQ(said.status, 0) << said.err;
  };
  record("board", "2.4");
  record("wall", "1");
}

}  // namespace rigor::test
