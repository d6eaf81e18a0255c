#!/usr/bin/env python3
"""How well the reference application knows where it is: 200 m through a stand, mode by mode, seed by seed, without and with faults.

    tools/localization_cases.py                                          # every mode, by the wall clock where the rig says so
    tools/localization_cases.py --modes mixed --seeds 1,2 --faults with
    tools/localization_cases.py --rig av06=stand/seekurjr-forest-light-av06.yaml --modes av06
    tools/localization_cases.py --table-only                             # of what is there already

Each case is a run, its replay, and OUT/MODE-FAULTS-SEED.json. At the end the tables of docs/forest-localization.md. Runs that are there
are not run again. The recording is removed, unless it was not whole, its replay saw something else, or --keep was given.

Faults: 20 % of scans lost, the scanner away for 0.5 s every 30 s, the wheels' angles stuck for 0.5 s every 20 s, and ground where
a side slips every ten seconds. The application uses no camera; where the rig has one (--camera), that is away for 0.5 s every 30 s.
"""
import argparse
import json
import os
import pathlib
import queue
import re
import subprocess
import sys
import threading

ROOT = pathlib.Path(__file__).resolve().parent.parent
RIGS = {"simulated": ROOT / "configs/rigs/seekurjr-forest-light.yaml", "emulated": ROOT / "configs/rigs/seekurjr-forest-emulated.yaml",
        "mixed": ROOT / "configs/rigs/seekurjr-forest-mixed.yaml"}
SCANNER = "[{kind: drop, probability: 0.2}, {kind: disconnect, from_s: 20, for_s: 0.5, every_s: 30}]"
WHEELS = "[{kind: stuck, from_s: 15, for_s: 0.5, every_s: 20}]"
CAMERA_FAULTS = "[{kind: disconnect, from_s: 22, for_s: 0.5, every_s: 30}]"
CAMERA = ("{kind: image, backend: simulated, rate_hz: 2, latency_ms: 100, renderer: rays, exposure_us: 4000, pixel_format: Mono8, "
          f"sensor: {ROOT}/configs/sensors/watched-camera.yaml, parent: robot, "
          "T_parent_sensor: { position_m: [0.45, 0, 0.95], look_at_m: [5.45, 0, 0.6] }}")


def ports_of(text):
    """Keys of the rig that are TCP ports, as (path, port)."""
    found, path = [], []
    for line in text.splitlines():
        key = re.match(r"^( *)(?:- )?(\w+):", line)
        if not key or line.lstrip().startswith("#"):
            continue
        depth = len(key[1]) // 2
        path = path[:depth] + [key[2]]
        inline = re.search(r"[{,] *port: (\d+)", line)
        if key[2] == "port":
            found.append((".".join(path), int(re.search(r"\d+", line)[0])))
        elif inline:
            found.append((".".join(path + ["port"]), int(inline[1])))
    return found


def settings(args, rig, faults, slot):
    """What is different from the rig as it stands there."""
    text = rig.read_text()
    changed = {f"{path}": port + 300 + 20 * slot for path, port in ports_of(text)}
    changed["application.drive.speed_mps"] = args.speed
    if args.camera:
        changed["channels.camera"] = CAMERA
    if faults:
        sides = ["pair.real.", "pair.simulated."] if "\n    pair:" in text else [""]
        changed.update({f"channels.scanner.{side}faults": SCANNER for side in sides})
        changed["channels.wheels.faults"] = WHEELS
        changed["simulation.platforms.robot.model"] = ROOT / "configs/platforms/seekurjr-slippery.yaml"
        if args.camera:
            changed["channels.camera.faults"] = CAMERA_FAULTS
    return [w for key, value in changed.items() for w in ("--set", f"{key}={value}")] + [w for s in args.set for w in ("--set", s)]


def call(args, words, log):
    """`rigor WORDS --json` in a session of its own; its JSON, or None."""
    with open(log, "w") as errors:
        process = subprocess.Popen([str(args.rigor), *words, "--json"], stdout=subprocess.PIPE, stderr=errors, text=True,
                                   start_new_session=True)
        if args.priority:
            pathlib.Path(f"/proc/{process.pid}/autogroup").write_text(str(args.priority))
        out = process.communicate()[0]
    if process.returncode != 0:
        print(f"localization_cases: rigor {' '.join(words)}: {log} says why", file=sys.stderr)
        return None
    return json.loads(out)


def share_lost(result, name):
    """Of the samples that the rate of a channel promises, those that the application never got."""
    channel = next((c for c in result["channels"] if c["name"] == name), None)
    if not channel:
        return None
    return 1 - (channel["fresh"] + channel["superseded"]) / (channel["nominal_rate_hz"] * result["duration_s"])


def run_case(args, mode, faults, seed, slot):
    name = f"{mode}-{'faults' if faults else 'calm'}-{seed}"
    rig, recording, log = args.rigs[mode], args.output / f"{name}.mcap", args.output / f"{name}.stderr"
    duration_s = args.way / args.speed + 15
    words = ["run", str(rig), "--no-control", "--duration", f"{duration_s:g}", "--record", str(recording), "--report", "",
             "--set", f"seed={seed}", *settings(args, rig, faults, slot)]
    result = call(args, words + (["--clock", "virtual"] if args.virtual else []), log)
    if not result:
        return False
    case = {"mode": mode, "faults": faults, "seed": seed, "clock": result["clock"], "duration_s": result["duration_s"],
            "load": os.getloadavg()[1], "localization": result["analyses"]["localization"], "recording": result["recording"],
            "cycles": [result["loop"]["cycles_run"], result["loop"]["cycles_skipped"]],
            "lost": {c: share_lost(result, c) for c in ("scanner", "wheels", "camera")},
            "seen": result["input_sha256"], "times": result["times"], "command": "rigor " + " ".join(words)}
    inspected = call(args, ["inspect", str(recording)], log)
    case["whole"] = bool(inspected) and result["recording"]["dropped"] == 0 and inspected["messages"] == result["recording"]["messages"]
    # Map and way are files beside the rig: its name, and what was changed of it, belong to the replay.
    replayed = call(args, ["replay", str(recording), str(rig), "--report", "", *settings(args, rig, faults, slot)], log)
    case["replayed"] = replayed["input_sha256"] if replayed else "failed"
    (args.output / f"{name}.json").write_text(json.dumps(case, indent=1))
    if not args.keep and case["whole"] and case["replayed"] == case["seen"]:
        recording.unlink()
    print(f"{name}: {case['localization']['text']}", flush=True)
    return True


def span(values, form):
    """From the least to the greatest."""
    values = [v for v in values if v is not None]
    if not values:
        return "–"
    low, high = form(min(values)), form(max(values))
    return low if low == high else f"{low}–{high}"


def table(args):
    cases = [json.loads(f.read_text()) for f in sorted(args.output.glob("*-*-*.json"))]
    print("| | runs | way | lost: scans; wheels | median, by seed | p95 | worst | searching | whole | replayed the same |\n"
          "|---|---|---|---|---|---|---|---|---|---|")
    for mode in args.rigs:
        for faults in (False, True):
            found = sorted((c for c in cases if (c["mode"], c["faults"]) == (mode, faults)), key=lambda c: c["seed"])
            if not found:
                continue
            errors = [c["localization"] for c in found]

            def mm(key):
                return ", ".join(f"{1e3 * e[key]:.0f}" for e in errors) + " mm"

            lost = [span([c["lost"][k] for c in found], lambda v: f"{100 * max(v, 0):.0f}") + " %" for k in ("scanner", "wheels")]
            print(f"| {mode}{', faults' if faults else ''} | {len(found)} | {span([e['way_m'] for e in errors], '{:.0f}'.format)} m | "
                  f"{'; '.join(lost)} | {mm('median_m')} | {mm('p95_m')} | {mm('worst_m')} | "
                  f"{sum(e['searching'] for e in errors)} | {sum(c['whole'] for c in found)} | "
                  f"{sum(c['replayed'] == c['seen'] for c in found)} |")


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    p.add_argument("--rigor", type=pathlib.Path, default=ROOT / "build/release/rigor")
    p.add_argument("-o", "--output", type=pathlib.Path, default=pathlib.Path("report/localization"))
    p.add_argument("--rig", action="append", default=[], metavar="MODE=FILE", help="another rig, or another file for a mode")
    p.add_argument("--modes", help="separated by commas; default: all")
    p.add_argument("--seeds", default="1,2,3,4,5")
    p.add_argument("--faults", choices=("without", "with", "both"), default="both")
    p.add_argument("--way", type=float, default=200, help="metres (200)")
    p.add_argument("--speed", type=float, default=0.8, help="m/s (0.8)")
    p.add_argument("--camera", action="store_true", help="a small camera beside, of which the application makes no use")
    p.add_argument("--virtual", action="store_true", help="in virtual time, whatever the rig says")
    p.add_argument("--at-once", type=int, default=2, help="runs at a time (2)")
    p.add_argument("--priority", type=int, default=0, help="-20 to 19: of each run as a whole (its autogroup); less than 0 needs root")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    p.add_argument("--keep", action="store_true", help="keep all recordings")
    p.add_argument("--table-only", action="store_true")
    args = p.parse_args()
    args.rigs = dict(RIGS) | {name: pathlib.Path(file) for name, file in (r.split("=", 1) for r in args.rig)}
    modes = args.modes.split(",") if args.modes else list(args.rigs)
    args.output.mkdir(parents=True, exist_ok=True)
    todo, failed = queue.Queue(), []
    for seed in args.seeds.split(","):
        for faults in {"without": [False], "with": [True], "both": [False, True]}[args.faults]:
            for mode in modes:
                if not args.table_only and not (args.output / f"{mode}-{'faults' if faults else 'calm'}-{seed}.json").exists():
                    todo.put((mode, faults, int(seed)))

    def work(slot):
        while True:
            try:
                case = todo.get_nowait()
            except queue.Empty:
                return
            if not run_case(args, *case, slot):
                failed.append(case)

    threads = [threading.Thread(target=work, args=(slot,)) for slot in range(args.at_once)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    table(args)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
