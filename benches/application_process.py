#!/usr/bin/env python3
"""What an application in a process of its own costs, and what becomes of the loop when it is killed or hangs.

  benches/application_process.py [--rigor build/release/rigor] [--seconds 20] [--instants 200]

In wall-clock time, on a rig with an inertial sensor at 1 kHz, a camera at 5 Hz and a loop at 1 kHz:
  cost   no application; programs in Python and in C++, and the latter as a shared object, that are called
         in every cycle: time from turn to answer, wake-up error and cycle time of the loop
  fail   a program in Python at 50 Hz that is killed, or stopped so that it hangs, at random instants, and is started again:
         every turn and every sample accounted for, and the loop beside that of an undisturbed run
"""
import argparse
import json
import os
import random
import signal
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RIG = """\
duration_s: {seconds}
clock: wall
loop: {{ rate_hz: 1000 }}
simulation: {{ world: {root}/configs/worlds/turntable.yaml, workers: 1 }}
channels:
  imu: {{ kind: imu, backend: simulated, rate_hz: 1000, latency_ms: 20, sensor: {root}/configs/sensors/imu-mems.yaml,
         T_world_sensor: {{ position_m: [2, 0, 0.5], quaternion_wxyz: [1, 0, 0, 0] }} }}
  camera: {{ kind: image, backend: simulated, rate_hz: {camera_hz}, latency_ms: 400, sensor: {root}/configs/sensors/demo-camera.yaml,
            pixel_format: Mono8, exposure_us: 2500, T_world_sensor: {{ position_m: [-0.2, -3.0, 1.6], look_at_m: [0, 0, 0.4] }} }}
sinks:
  out: {{ backend: log, signals: [n] }}
{application}
"""
APP = """\
import rigor_client
class App(rigor_client.Application):
    n = 0
    def step(self, turn):
        open('pid', 'w').write(str(os.getpid())) if self.n == 0 else None
        self.n += len(turn['imu'].samples)
        if turn['camera'].fresh:
            self.n += turn['camera'].sample.bytes[len(turn['camera'].sample.bytes) // 2]
        turn.command('out', n=self.n)
import os
rigor_client.run(App())
"""


def microseconds(ns):
    return f"{ns * 1e-3:9.1f}"


class Bench:
    def __init__(self, rigor, folder):
        self.rigor, self.folder = rigor, folder
        (folder / "app.py").write_text(APP)

    def start(self, seconds, application, camera_hz=5):
        text = RIG.format(seconds=seconds, root=ROOT, camera_hz=camera_hz,
                          application=f"application: {application}" if application else "")
        (self.folder / "rig.yaml").write_text(text)
        return subprocess.Popen([self.rigor, "run", "rig.yaml", "--json"], cwd=self.folder, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def end(self, process):
        out, err = process.communicate()
        if process.returncode != 0:
            raise SystemExit(f"rigor run failed: {err}")
        return json.loads(out)


def row(name, result):
    wake, cycle = result["loop"]["wake_error"], result["loop"]["cycle_time"]
    answer = result.get("application", {}).get("answer")
    answered = f"{microseconds(answer['p50_ns'])} {microseconds(answer['p99_ns'])}" if answer else " " * 19
    print(f"{name:22} {answered} {microseconds(wake['p50_ns'])} {microseconds(wake['p99_ns'])} "
          f"{microseconds(cycle['p50_ns'])} {microseconds(cycle['p99_ns'])} {result['loop']['cycles_skipped']:6}", flush=True)
    return wake["p99_ns"]


def cost(bench, seconds, programs):
    print("microseconds          answer p50       p99  wake p50       p99 cycle p50       p99 skipped")
    p99 = {name: [] for name in programs}
    for _ in range(3):  # in turns, so that a busy minute of the machine falls on all
        for name, application in programs.items():
            p99[name].append(row(name, bench.end(bench.start(seconds, application))))
    least = {name: min(values) for name, values in p99.items()}
    for name in programs:
        print(f"wake-up p99 of {name} to none: {least[name] / least['none']:.2f}")


def fail(bench, instants, how, seed):
    rng = random.Random(seed)
    waits = [rng.uniform(0.2, 0.6) for _ in range(instants)]
    # Ended by SIGTERM: how long two hundred starts of Python take is the machine's to say.
    process = bench.start(3600, "{ command: [python3, app.py], rate_hz: 50, on_exit: restart, answer_timeout_s: 0.2 }")
    hit, last = 0, None
    pid_file = bench.folder / "pid"
    pid_file.unlink(missing_ok=True)
    for wait in waits:
        while process.poll() is None:  # the next process, once it has had its first turn
            pid = pid_file.read_text() if pid_file.exists() else ""
            if pid and pid != last:
                break
            time.sleep(0.005)
        if process.poll() is not None:
            break
        time.sleep(wait * rng.random())
        last = pid
        os.kill(int(pid), signal.SIGKILL if how == "killed" else signal.SIGSTOP)
        hit += 1
    process.terminate()  # the run ends in order
    out, _ = process.communicate()
    result = json.loads(out)
    a, loop = result["application"], result["loop"]
    due = (loop["cycles_run"] + 19) // 20
    samples = sum(a["samples"].values()) + sum(c["superseded"] for c in result["channels"])
    seen = sum(c["delivered"] for c in result["channels"])
    row(f"{how} {hit} times", result)
    print(f"  {a['restarts']} restarts; turns: {a['turns']} given + {a['skipped']} skipped of about {due} due, {a['answered']} answered; "
          f"samples: {samples} accounted for of {seen}; {loop['misses']['total']} misses of {loop['cycles_run']} cycles")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigor", default=ROOT / "build/release/rigor", type=Path)
    parser.add_argument("--seconds", default=20, type=float)
    parser.add_argument("--instants", default=200, type=int)
    options = parser.parse_args()
    benches = options.rigor.resolve().parent / "benches"
    with tempfile.TemporaryDirectory(prefix="rigor-bench-") as folder:
        bench = Bench(options.rigor.resolve(), Path(folder))
        programs = {"none": "", "Python, each cycle": "{ command: [python3, app.py] }"}
        programs["C++, each cycle"] = f"{{ command: [{benches}/application_turns] }}"
        programs["shared object"] = f"{{ library: {benches}/libapplication_turns_plugin.so }}"
        cost(bench, options.seconds, programs)
        print()
        for how in ("killed", "hung"):
            fail(bench, options.instants, how, seed=1)


if __name__ == "__main__":
    main()
