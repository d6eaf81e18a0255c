#!/usr/bin/env python3
"""Closed loop of `rigor calibrate pair`: known changes of a device, from a simulated recording to errors in standard uncertainties.

usage: tools/pair_loop.py [CASE ...] [--seeds 1] [--duration 3] [--rigor build/release/rigor] [-o report/pair-loop]

CASE (default: all) is a channel of configs/rigs/pairs.yaml (scan, top, camera, tof), whose real side differs in sensor model or mount;
camera-knocked, where the mount alone differs; or camera-same, where nothing does.
Two `rigor run` in virtual time for each seed: with the changes, and, with another seed, after what `rigor calibrate pair` proposed was taken
over. Prints what was planted, what was found, and what is left. Over several seeds: mean and standard deviation of (error / standard
uncertainty), where 0 and 1 are expected. What a seed gave is kept in the output folder and not run again. Exit status: 0, or 2 where a run
failed or a sensor model lacks what is to be changed.
"""
import argparse
import json
import math
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
SENSORS = ROOT / "configs/sensors"
HALF_DEG = math.radians(0.5)
# The camera looks down by atan(0.3 / 5.5): half a degree about the world's z is about its own y and z.
DOWN = math.atan2(0.3, 5.5)
KNOCKED = f"{{ position_m: [-0.1, -3, 1.4], look_at_m: [{-0.1 - 5.5 * math.sin(HALF_DEG):.9f}, {5.5 * math.cos(HALF_DEG) - 3:.9f}, 1.1] }}"
KNOCKED_TURNS = {"mount_x_rad": 0, "mount_y_rad": -HALF_DEG * math.cos(DOWN), "mount_z_rad": -HALF_DEG * math.sin(DOWN)}

# By channel, with a dash and the kind of change where there are several. Sensor model; what is replaced in it: pattern, and a text or a factor
# on the number; mount of the real side; what is planted.
CASES = {
    "scan": ("sick-lms111.yaml", [(r"range: \{", "range: { bias_mm: 20,"), (r"(floor_mm: )([\d.]+)", 2.0), (r"(scale_mm: )([\d.]+)", 2.0)],
             "{ position_m: [0, -3, 0.4], roll_pitch_yaw_deg: [0, 0, 90.5] }",
             {"range_bias_m": 0.02, "range_scale": 0, "mount_z_rad": HALF_DEG, "mount_move_x_m": 0, "mount_move_y_m": 0}),
    "top": ("velodyne-vlp16.yaml", [(r"range: \{", "range: { bias_mm: 20,")],
            "{ position_m: [0, -3, 1.8], roll_pitch_yaw_deg: [0.5, 0, 90] }",
            {"range_bias_m": 0.02, "range_scale": 0, "mount_x_rad": HALF_DEG, "mount_y_rad": 0, "mount_z_rad": 0, "mount_move_x_m": 0,
             "mount_move_y_m": 0, "mount_move_z_m": 0}),
    "camera": ("demo-camera.yaml", [(r"(fx_px: )([\d.]+)", 1.01), (r"(fy_px: )([\d.]+)", 1.01), (r"(read_noise_e: )([\d.]+)", 2.0)],
               KNOCKED,
               {"focal_length": 0.01, "gain": 0, **KNOCKED_TURNS}),
    "camera-knocked": ("demo-camera.yaml", [],
                       KNOCKED,
                       {"focal_length": 0, "gain": 0, **KNOCKED_TURNS}),
    "camera-same": ("demo-camera.yaml", [], None,
                    {"focal_length": 0, "gain": 0, "offset_dn": 0, "mount_x_rad": 0, "mount_y_rad": 0, "mount_z_rad": 0}),
    "tof": ("sr4000.yaml", [(r"\Z", "range_error: { offset_mm: 20 }\n")], None, {"range_offset_m": 0.02, "amplitude_gain": 0}),
}


def call(words, folder):
    said = subprocess.run([str(w) for w in words], cwd=folder, text=True, capture_output=True)
    if said.returncode not in (0, 1):
        print(f"pair_loop: {' '.join(map(str, words))}: exit status {said.returncode}\n{said.stderr[-2000:]}", file=sys.stderr)
        sys.exit(2)
    return said.stdout


def changed(sensor, changes):
    text = (SENSORS / sensor).read_text()
    for pattern, by in changes:
        text, n = re.subn(pattern, by if isinstance(by, str) else lambda m: f"{m[1]}{float(m[2]) * by:.9g}", text)
        if n == 0:
            print(f"pair_loop: {sensor}: expected text like {pattern}, found none", file=sys.stderr)
            sys.exit(2)
    return text


def alone(name):
    """The rig with one of its channels."""
    head, channels = (ROOT / "configs/rigs/pairs.yaml").read_text().split("channels:\n")
    (own,) = [c for c in re.split(r"^(?=  \w)", channels, flags=re.M) if c.startswith(f"  {name}:")]
    return (head + "channels:\n" + own).replace("../", f"{ROOT}/configs/")


def calibrate(args, folder, recording, name, proposed):
    out = call([args.rigor, "calibrate", "pair", recording, "--channel", name, "--json", "--force", "-o", proposed, "--from", "0"], folder)
    return json.loads(out)


def one_seed(args, name, seed):
    """Answers of `rigor calibrate pair` before and after its proposal."""
    channel = name.split("-")[0]
    folder = args.output / f"{name}-{seed}"
    kept = folder / "answers.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    folder.mkdir(parents=True, exist_ok=True)
    sensor, changes, mount, _ = CASES[name]
    real = folder / "real.yaml"
    real.write_text(changed(sensor, changes))
    before = folder / "simulated.yaml"
    before.write_text(changed(sensor, []))
    planted = ["--set", f"channels.{channel}.pair.real.sensor={real}", "--set", f"channels.{channel}.pair.simulated.sensor={before}"]
    if mount:
        planted += ["--set", f"channels.{channel}.pair.real.T_world_sensor={mount}"]
    rig = folder / "rig.yaml"
    rig.write_text(alone(channel))
    answers = []
    for k in range(2):
        recording = folder / f"{k}.mcap"
        call([args.rigor, "run", rig, "--duration", args.duration, "--record", recording, "--force",
              "--no-control", "--progress", "none", "--set", f"seed={2 * seed + k}", *planted], folder)
        answers.append(calibrate(args, folder, recording, channel, folder / f"proposed-{k}.yaml"))
        recording.unlink()
        planted += ["--set", f"channels.{channel}.pair.simulated.sensor={folder / 'proposed-0.yaml'}"]
        if "value" in answers[0].get("mount", {}):
            planted += ["--set", f"channels.{channel}.pair.simulated.T_world_sensor={answers[0]['mount']['value']}"]
    kept.write_text(json.dumps(answers))
    return answers


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("case", nargs="*", choices=[[], *CASES])
    p.add_argument("--seeds", type=int, default=1)
    p.add_argument("--duration", type=float, default=3, help="seconds of virtual time (3)")
    p.add_argument("--rigor", type=pathlib.Path, default=ROOT / "build/release/rigor")
    p.add_argument("-o", "--output", type=pathlib.Path, default=pathlib.Path("report/pair-loop"))
    args = p.parse_args()
    args.output, args.rigor = args.output.resolve(), args.rigor.resolve()
    for name in args.case or CASES:
        truth = CASES[name][3]
        off = {k: ([], []) for k in truth}
        print(f"{name}: planted, found, what is left after the proposal; of {args.seeds} seeds (error / standard uncertainty): mean, "
              "standard deviation")
        for seed in range(1, args.seeds + 1):
            last = [a["change"] for a in one_seed(args, name, seed)]
            for k, planted in truth.items():
                for side, want in ((0, planted), (1, 0)):
                    c = last[side].get(k)
                    if c and c["sigma"] and math.isfinite(c["sigma"]):
                        off[k][side].append((c["value"] - want) / c["sigma"])
        for k, planted in truth.items():
            cells = []
            for side in (0, 1):
                c, all_off = last[side].get(k), off[k][side]
                n = len(all_off)
                text = f"{c['value']:+.6f} ± {c['sigma']:.6f}" if c and n else "open"
                if n > 1:
                    mean = sum(all_off) / n
                    text += f" ({mean:+.2f}, {math.sqrt(sum((x - mean) ** 2 for x in all_off) / (n - 1)):.2f})"
                cells.append(text)
            print(f"  {k:16} {planted:+.6f}   {cells[0]}   {cells[1]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
