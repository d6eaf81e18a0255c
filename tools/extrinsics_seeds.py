#!/usr/bin/env python3
"""Closed loop of `rigor calibrate extrinsics`: a board on a turntable before a simulated camera and a simulated LiDAR, seed by seed.

usage: tools/extrinsics_seeds.py [--seeds 20] [--first 1] [--duration 8] [--amplitude 50] [--period 16] [--views 40] [--sensor MODEL.yaml]
                                 [--rigor build/release/rigor] [-o report/extrinsics-seeds]

Each seed is a `rigor run` in virtual time, whose recording is calibrated. The rig's mounts are the truth. Prints for each parameter mean
and standard deviation of (error / standard uncertainty) over the seeds, where 0 and 1 are expected, and the joint chi-squared by the whole
covariance with its limits at 0.001. What a seed gave is kept in the output folder and not run again. Exit status: 0 chi-squared
is within its limits, 1 it is not, 2 a run failed.
"""
import argparse
import json
import math
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
CAMERA, LOOK_AT, LIDAR, LIDAR_YAW_DEG = (-0.2, -2.2, 1.5), (0, 0, 1.2), (0.0, -2.2, 1.3), 90
NAMES = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"]

WORLD = """
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
ground: { material: grey, other_material: grey, half_extent_m: 20, cell_m: 5, noise_contrast: 0 }
sun:
  direction_to_sun: [-0.25, -0.75, 0.6]
  irradiance_w_per_m2: { red: 4.6, green: 4.7, blue: 4.2, nir: 2.8 }
sky:
  zenith_radiance_w_per_m2_sr: { red: 0.20, green: 0.30, blue: 0.50, nir: 0.07 }
  horizon_radiance_w_per_m2_sr: { red: 0.45, green: 0.50, blue: 0.55, nir: 0.20 }
"""

RIG = """
name: extrinsics-seeds
seed: 1
clock: virtual
loop: {{ rate_hz: 1000, overrun: skip }}
simulation:
  world: world.yaml
  workers: 2
  joints:
    turntable: {{ channel: turntable, position: position, rate: rate, unit: deg }}
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
      - {{ name: position, table: input_registers, address: 0, type: s32, byte_order: ABCD, scale: 0.001, unit: deg }}
      - {{ name: rate, table: input_registers, address: 2, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }}
  camera:
    kind: image
    backend: simulated
    rate_hz: 20
    latency_ms: 100
    sensor: {configs}/sensors/demo-camera.yaml
    pixel_format: Mono8
    exposure_us: 2500
    T_world_sensor: {{ position_m: {camera}, look_at_m: {look_at} }}
  lidar:
    kind: point_cloud
    backend: simulated
    rate_hz: 10
    latency_ms: 110
    sensor: {lidar_model}
    renderer: rays
    T_world_sensor: {{ position_m: {lidar}, roll_pitch_yaw_deg: [0, 0, {yaw}] }}
sinks:
  table_command:
    backend: modbus
    emulated_by: turntable
    latency_ms: 10
    address: 127.0.0.1
    port: 5020
    registers:
      - {{ name: enable, table: holding_registers, address: 0, type: u16 }}
      - {{ name: target_rate, table: holding_registers, address: 4, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }}
    safe: {{ enable: 0, target_rate: 0 }}
emulators:
  turntable: {{ backend: modbus, address: 127.0.0.1, port: 5020, model: turntable, joint: turntable }}
application: {{ name: turntable-sweep, table: table_command, amplitude_deg: {amplitude}, period_s: {period}, rate_hz: 50 }}
"""


def unit(v):
    n = math.sqrt(sum(x * x for x in v))
    return [x / n for x in v]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def truth():
    """Position and rotation vector of the LiDAR in the camera's optical frame."""
    forward = unit([b - a for a, b in zip(CAMERA, LOOK_AT)])
    right = unit(cross(forward, [0, 0, 1]))
    optical = [right, cross(forward, right), forward]  # rows: axes of the camera in the world
    yaw = math.radians(LIDAR_YAW_DEG)
    columns = [[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    r = [[sum(a * b for a, b in zip(row, column)) for column in columns] for row in optical]
    t = [sum(a * (q - p) for a, p, q in zip(row, CAMERA, LIDAR)) for row in optical]
    angle = math.acos(max(-1, min(1, (r[0][0] + r[1][1] + r[2][2] - 1) / 2)))
    axis = [(r[2][1] - r[1][2]), (r[0][2] - r[2][0]), (r[1][0] - r[0][1])]
    return t + [x * angle / (2 * math.sin(angle)) for x in axis]


def solve(a, b):
    """x of a x = b, by elimination with pivots."""
    n = len(b)
    m = [list(row) + [x] for row, x in zip(a, b)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(m[k][i]))
        m[i], m[pivot] = m[pivot], m[i]
        for k in range(i + 1, n):
            f = m[k][i] / m[i][i]
            m[k] = [x - f * y for x, y in zip(m[k], m[i])]
    x = [0.0] * n
    for i in reversed(range(n)):
        x[i] = (m[i][n] - sum(m[i][k] * x[k] for k in range(i + 1, n))) / m[i][i]
    return x


def chi_squared_quantile(z, freedom):
    """Wilson and Hilferty, of the standard normal quantile z."""
    c = 2 / (9 * freedom)
    return freedom * (1 - c + z * math.sqrt(c)) ** 3


def one_seed(args, seed):
    kept = args.output / f"{seed}.json"
    if kept.exists():
        return json.loads(kept.read_text())
    recording, partial = args.output / f"{seed}.mcap", args.output / f"{seed}.part.mcap"
    run = [args.rigor, "run", args.output / "rig.yaml", "--duration", args.duration, "--set", f"seed={seed}", "--set", "report=",
           "--record", partial, "--progress", "none"]
    t = truth()
    rough = ",".join(f"{x:.3f}" for x in t[:3]) + ",0,-8,5"
    calibrate = [args.rigor, "calibrate", "extrinsics", recording, "--camera", "camera", "--camera-model",
                 ROOT / "configs/sensors/demo-camera.yaml", "--second", "lidar", "--target", "chessboard:9x6:0.1", "--rough", rough,
                 "--still", "1", "--views", args.views, "--json", "--progress", "none"]
    if not recording.exists():
        partial.unlink(missing_ok=True)
        subprocess.run([str(x) for x in run], stdout=subprocess.DEVNULL, check=True)
        partial.rename(recording)
    out = subprocess.run([str(x) for x in calibrate], stdout=subprocess.PIPE, check=True).stdout
    if not args.keep:
        recording.unlink()
    kept.write_bytes(out)
    return json.loads(out)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--seeds", type=int, default=20)
    p.add_argument("--first", type=int, default=1)
    p.add_argument("--duration", type=float, default=8)
    p.add_argument("--amplitude", type=float, default=50, help="of the turntable, degrees")
    p.add_argument("--period", type=float, default=16, help="of the turntable, s")
    p.add_argument("--views", type=int, default=40)
    p.add_argument("--sensor", type=pathlib.Path, default=ROOT / "configs/sensors/velodyne-vlp16.yaml", help="sensor model of the LiDAR")
    p.add_argument("--rigor", type=pathlib.Path, default=ROOT / "build/release/rigor")
    p.add_argument("--keep", action="store_true", help="keep the recordings")
    p.add_argument("-o", "--output", type=pathlib.Path, default=pathlib.Path("report/extrinsics-seeds"))
    args = p.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    settings = {k: str(getattr(args, k)) for k in ("duration", "amplitude", "period", "views", "sensor", "rigor")}
    noted = args.output / "settings.json"
    if noted.exists() and json.loads(noted.read_text()) != settings:
        p.error(f"{args.output} holds seeds of other settings: give another --output")
    noted.write_text(json.dumps(settings))
    (args.output / "world.yaml").write_text(WORLD)
    (args.output / "rig.yaml").write_text(
        RIG.format(configs=ROOT / "configs", camera=list(CAMERA), look_at=list(LOOK_AT), lidar=list(LIDAR), yaw=LIDAR_YAW_DEG,
                   lidar_model=args.sensor.resolve(), amplitude=args.amplitude, period=args.period))
    expected, z, chi2, views, scales = truth(), [[] for _ in NAMES], 0.0, [], []
    try:
        for seed in range(args.first, args.first + args.seeds):
            j = one_seed(args, seed)
            by_name = j["parameters"]
            error = [by_name[n]["value"] - e for n, e in zip(NAMES, expected)]
            for k, n in enumerate(NAMES):
                z[k].append(error[k] / by_name[n]["sigma"])
            here = sum(a * b for a, b in zip(error, solve(j["covariance"], error)))
            chi2 += here
            views.append(j["views"])
            scales.append(j["plane_scale"])
            print(f"seed {seed}: chi-squared {here:5.1f} of 6, views {j['views']}, point noise {1000 * j['sigma_point_m']:.1f} mm, plane scale "
                  f"{j['plane_scale']:.2f}; error in mm and mrad " + " ".join(f"{1000 * e:+.2f}" for e in error), flush=True)
    except subprocess.CalledProcessError as e:
        print(f"extrinsics_seeds: {' '.join(e.cmd)}: status {e.returncode}", file=sys.stderr)
        return 2
    n = len(z[0])
    for name, values in zip(NAMES, z):
        mean = sum(values) / n
        deviation = math.sqrt(sum((x - mean) ** 2 for x in values) / max(1, n - 1))
        print(f"{name:7} error / standard uncertainty: mean {mean:+.2f} ± {deviation / math.sqrt(n):.2f}, standard deviation {deviation:.2f}")
    low, high = chi_squared_quantile(-3.2905, 6 * n), chi_squared_quantile(3.2905, 6 * n)
    print(f"joint chi-squared {chi2:.1f} of {6 * n} (limits {low:.0f} to {high:.0f})")
    return 0 if low <= chi2 <= high else 1


if __name__ == "__main__":
    sys.exit(main())
