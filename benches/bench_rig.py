#!/usr/bin/env python3
"""How fast a whole rig runs, and where the time goes.

usage: benches/bench_rig.py [RIG.yaml] [--duration 10] [--runs 3] [--cpus 0,1] [--device NVIDIA] [--set KEY=VALUE ...]
                            [--rigor build/release/rigor] [-o bench_rig.json]

Runs the rig (configs/rigs/seekurjr-forest.yaml) in virtual time, as fast as it goes, and prints of the fastest run: frames a second
of wall and of bench time by channel, and the seconds of each stage, from what `rigor run --json` tells under `times`. Runs on
the CPUs that are named alone. The first pictures of a run wait for the world to be made: `longest` shows them, and a second,
shorter run takes that away from the rates (steady).
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent


def run(args, duration_s):
    with tempfile.TemporaryDirectory() as folder:
        command = [str(args.rigor), "run", str(args.rig), "--clock", "virtual", "--duration", str(duration_s), "--json",
                   "--no-control", "--record", f"{folder}/bench.mcap", "--set", "report="]
        if args.device:
            command += ["--set", f"simulation.device={args.device}"]
        for s in args.set:
            command += ["--set", s]
        before = time.monotonic()
        said = subprocess.run(command, stdout=subprocess.PIPE)
        whole_s = time.monotonic() - before
        if said.returncode != 0:
            sys.exit(f"bench_rig: {' '.join(command)}: exit status {said.returncode}")
        result = json.loads(said.stdout)
        result["process_s"] = whole_s
        return result


def stages(result):
    """Name, seconds of wall time, of CPU time (None: not known), and how often."""
    t = result["times"]
    rows = []
    for s in t["sensors"]:
        n = s["captures"]
        rows += [(f"{s['channel']}: {stage}", s[f"{stage}_s"], None, n) for stage in ("world", "collect", "prepare", "light", "model")]
    cycles = result["loop"]["cycles_run"]
    rows += [(f"loop: {name}", s, None, cycles) for name, s in t["loop_s"].items()]
    if "recorder_cpu_s" in t:
        rows.append(("recorder", None, t["recorder_cpu_s"], result["recording"]["messages"]))
    return rows


def main():
    p = argparse.ArgumentParser()
    p.add_argument("rig", type=pathlib.Path, nargs="?", default=ROOT / "configs/rigs/seekurjr-forest.yaml")
    p.add_argument("--rigor", type=pathlib.Path, default=ROOT / "build/release/rigor")
    p.add_argument("--duration", type=float, default=10, help="seconds of bench time")
    p.add_argument("--runs", type=int, default=3)
    p.add_argument("--cpus", default="0,1")
    p.add_argument("--device", default="", help="Vulkan device by a part of its name")
    p.add_argument("--set", action="append", default=[])
    p.add_argument("-o", "--output", type=pathlib.Path)
    args = p.parse_args()
    allowed = os.sched_getaffinity(0)
    cpus = {int(c) for c in args.cpus.split(",")} & allowed or allowed
    os.sched_setaffinity(0, cpus)
    load = os.getloadavg()[0]
    runs = [run(args, args.duration) for _ in range(args.runs)]
    best = min(runs, key=lambda r: r["times"]["wall_s"])
    short = run(args, args.duration / 4)
    t, wall_s, bench_s = best["times"], best["times"]["wall_s"], best["duration_s"]
    steady_s = wall_s - short["times"]["wall_s"]
    steady_bench_s = bench_s - short["duration_s"]
    print(f"{best['rig']}, {best['renderer']}, {len(cpus)} CPUs; load of the machine before: {load:.1f}")
    print(f"{bench_s:.1f} s of bench time in {wall_s:.2f} s ({bench_s / wall_s:.3f} of real time; "
          f"all {args.runs}: {', '.join('%.2f' % r['times']['wall_s'] for r in runs)} s), "
          f"steady {steady_bench_s / steady_s:.3f}; {t['cpu_s']:.1f} s of CPU time, {t['cpu_s'] / wall_s:.2f} CPUs; "
          f"start to end of the process {best['process_s']:.1f} s")
    print("\n| channel | samples | a second of bench time | a second of wall time |\n|---|---|---|---|")
    frames = 0
    for c in best["channels"]:
        n = c["fresh"] + c["superseded"]
        frames += n
        print(f"| {c['name']} | {n} | {n / bench_s:.2f} | {n / wall_s:.2f} |")
    print(f"| all | {frames} | {frames / bench_s:.1f} | {frames / wall_s:.1f} |")
    print("\n| stage | s | of the wall time | each |\n|---|---|---|---|")
    for name, s, cpu_s, n in sorted(stages(best), key=lambda r: -(r[1] if r[1] is not None else r[2])):
        took = s if s is not None else cpu_s
        note = "" if s is not None else " (CPU)"
        print(f"| {name} | {took:.3f}{note} | {100 * took / wall_s:.1f} % | {1e3 * took / max(n, 1):.3f} ms |")
    for s in t["sensors"]:
        print(f"\n{s['channel']}: {s['captures']} captures, {s['wall_s'] / s['captures'] * 1e3:.1f} ms each, longest "
              f"{s['longest_ms']:.0f} ms, {s['cpu_s'] / s['captures'] * 1e3:.1f} ms of CPU on its own thread", end="")
    measuring_s = sum(s["wall_s"] for s in t["sensors"])
    print(f"\n\nMeasuring takes {measuring_s:.1f} s of {wall_s:.1f} s on the simulators' workers (together "
          f"{measuring_s / wall_s:.2f} at a time), the loop {sum(t['loop_s'].values()):.2f} s, the recorder "
          f"{t.get('recorder_cpu_s', 0):.2f} s of CPU.")
    if args.output:
        args.output.write_text(json.dumps({"runs": runs, "short": short, "cpus": len(cpus), "load": load}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
