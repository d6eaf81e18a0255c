#!/usr/bin/python3
"""Measures the Python module: a step beside C++, recordings, memory of many rigs, and a large recording.

    PYTHONPATH=build/release/python /usr/bin/python3 benches/python_module.py [--quick] [--json FILE] [PART...]

Parts: equality, steps, memory, reading. `build/release/rigor` is the C++ side; RIGOR_COMMAND names another.
"""
import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy
import rigor

SOURCE = Path(__file__).resolve().parents[1]
CONFIGS = SOURCE / "configs"
COMMAND = os.environ.get("RIGOR_COMMAND", SOURCE / "build/release/rigor")


def command(*words):
    began = time.perf_counter()
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.stderr)
    return time.perf_counter() - began, done.stdout


def stepped(rig_file, duration_s, cycles, record, look=False):
    """Seconds of the steps alone, and their number."""
    with rigor.Rig(rig_file, clock="virtual", duration_s=duration_s, record=record, report=False, replace=True,
                   set={"analyses": {}}) as rig:
        rig.step()
        ports, steps = list(rig.ports().values()), 1
        began = time.perf_counter()
        while rig.step(cycles):
            steps += 1
            if look:
                for port in ports:
                    if port.fresh:
                        port.sample
        return time.perf_counter() - began, steps


def equality(quick):
    found = {}
    for name, duration in (("demo", 0.5 if quick else 2), ("rigs/forest-discs", 2 if quick else 10)):
        file = CONFIGS / f"{name}.yaml"
        command("run", file, "--clock", "virtual", "--duration", duration, "--record", "c.mcap", "--report", "r", "--force",
                "--set", "analyses={}")
        stepped(file, duration, 3, "p.mcap")
        found[name] = Path("c.mcap").read_bytes() == Path("p.mcap").read_bytes()
        print(f"{name}: {duration} s, {Path('p.mcap').stat().st_size} bytes, "
              f"{'byte for byte that of rigor run' if found[name] else 'NOT that of rigor run'}")
    return found


def steps(quick):
    """The forest rig without a recording: C++ by the command's own report of its loop, Python by a clock round the steps."""
    file, duration = CONFIGS / "rigs/forest-discs.yaml", 5 if quick else 30
    found = {}
    _, said = command("run", file, "--clock", "virtual", "--duration", duration, "--set", "record.file=", "--report", "r", "--force",
                      "--set", "analyses={}", "--json")
    cycles = duration * 200
    found["cpp"] = json.loads(said)["times"]["wall_s"] / cycles * 1e6
    for label, n, look in (("python, step(1)", 1, False), ("python, step(1), every fresh sample read", 1, True),
                           ("python, step(10)", 10, False), ("python, step(200)", 200, False)):
        seconds, _ = stepped(file, duration, n, False, look)
        found[label] = seconds / cycles * 1e6
    for label, us in found.items():
        print(f"{label:42} {us:8.1f} us a cycle, {5000 / us:6.1f} x real time")
    # What a call costs beside the cycle that it runs: a rig that does almost nothing.
    Path("empty.yaml").write_text("name: empty\nclock: virtual\nduration_s: 1000\nloop: { rate_hz: 1000 }\nchannels: {}\n",
                                  encoding="utf-8")
    for n in (1, 1000):
        with rigor.Rig("empty.yaml") as rig:
            rig.step()
            count = 2000 if n == 1000 else 20000
            count = count // 10 if quick else count
            began = time.perf_counter()
            for _ in range(count // (10 if n == 1000 else 1)):
                rig.step(n)
            us = (time.perf_counter() - began) / (count // (10 if n == 1000 else 1)) / n * 1e6
            found[f"empty rig, step({n})"] = us
            print(f"empty rig, step({n}): {us:.2f} us a cycle")
    return found


def memory(quick):
    """Resident memory over rigs that are opened, stepped and closed; slope with its 95 % interval after the first quarter."""
    def resident_kib():
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() // 1024
    n = 60 if quick else 1000
    sizes = numpy.zeros(n, int)  # a list would grow, too
    for k in range(n):
        with rigor.Rig(CONFIGS / "rigs/can.yaml", clock="virtual", duration_s=0.05, record=False, report=False) as rig:
            while rig.step(10):
                rig["turntable"].sample if "turntable" in rig.ports() else None
        sizes[k] = resident_kib()
    half = sizes[n // 4:].astype(float)
    x = numpy.arange(len(half)) - (len(half) - 1) / 2
    slope = (x @ half) / (x @ x)
    residual = half - half.mean() - slope * x
    sigma = numpy.sqrt((residual @ residual) / (len(half) - 2) / (x @ x))
    print(f"{n} rigs: {sizes[0]} KiB after the first, {sizes[n // 4]} after a quarter, {sizes[-1]} after the last; "
          f"slope {slope:.3f} +- {1.96 * sigma:.3f} KiB a rig")
    return {"rigs": n, "first_kib": int(sizes[0]), "quarter_kib": int(sizes[n // 4]), "last_kib": int(sizes[-1]), "slope_kib": slope,
            "interval_kib": 1.96 * sigma}


def reading(quick):
    """A recording with pictures: opened, and each picture summed, beside the same bytes from a plain file."""
    pictures = 100 if quick else 6000
    large = {"channels.right.rate_hz": 100, "channels.left.rate_hz": 0.5, "channels.right.ideal": True,
             "channels.right.latency_ms": 100, "record.compression": "none"}
    # A second of pictures of the demo's camera, then their messages as often as it takes.
    with rigor.Rig("demo", clock="virtual", duration_s=0.3 if quick else 1.0, record="seed.mcap", report=False, replace=True,
                   set=large) as rig:
        rig.run()
    multiply("seed.mcap", "large.mcap", pictures)
    size = Path("large.mcap").stat().st_size
    with open("plain.bin", "wb") as plain:
        channel = rigor.open("large.mcap")["right"]
        for sample in channel:
            plain.write(sample.array().tobytes())
        n, shape = len(channel), channel[0].array().shape
    found = {"bytes": size, "pictures": n}

    def timed(label, call):
        best = min(call() for _ in range(3))
        found[label] = best
        print(f"{label:44} {best:7.3f} s  {size / best / 1e9:6.2f} GB/s")

    def by_rigor(verify):
        def run():
            began = time.perf_counter()
            for sample in rigor.open("large.mcap", verify=verify)["right"]:
                sample.array().sum()
            return time.perf_counter() - began
        return run

    def by_fromfile():
        began = time.perf_counter()
        with open("plain.bin", "rb") as file:
            for _ in range(n):
                numpy.fromfile(file, "u1", shape[0] * shape[1]).sum()
        return time.perf_counter() - began

    def open_alone():
        began = time.perf_counter()
        len(rigor.open("large.mcap")["right"])
        return time.perf_counter() - began
    print(f"{size / 1e9:.2f} GB, {n} pictures of {shape[1]}x{shape[0]}, warm cache")
    timed("rigor.open and len", open_alone)
    timed("rigor, each picture summed", by_rigor(True))
    timed("rigor, each picture summed, verify=False", by_rigor(False))
    timed("numpy.fromfile of the pictures alone, summed", by_fromfile)
    for package in ("mcap", "rosbags"):
        try:
            __import__(package)
        except ImportError:
            print(f"{package}: not installed, and not among Debian's packages: not measured")
    return found


def multiply(source, target, pictures):
    """The messages of `source` again and again until there are so many pictures: one recording, uncompressed."""
    rec = rigor.open(source)
    image, stamp, settings = (rec.topics[f"/right/image{c}"] for c in ("", "/stamp", "/settings"))
    with open(target, "wb") as out:
        Mcap(out, [image, stamp, settings]).write(pictures)


class Mcap:
    """As little of an MCAP writer as a bench needs: chunks of 4 MB with their message indexes, and a summary."""

    def __init__(self, out, topics):
        self.out, self.topics, self.at, self.chunks = out, topics, 0, []

    def put(self, data):
        self.out.write(data)
        self.at += len(data)

    @staticmethod
    def record(op, body):
        return bytes([op]) + len(body).to_bytes(8, "little") + body

    @staticmethod
    def text(value):
        value = value.encode() if isinstance(value, str) else value
        return len(value).to_bytes(4, "little") + value

    def declared(self):
        data = b""
        for i, topic in enumerate(self.topics, 1):
            about = topic._about
            data += self.record(3, i.to_bytes(2, "little") + self.text(about["type"]) + self.text("ros2msg") + self.text(about["schema"]))
            data += self.record(4, i.to_bytes(2, "little") * 2 + self.text(topic.topic) + self.text("cdr") + bytes(4))
        return data

    def write(self, pictures):
        import zlib
        self.put(b"\x89MCAP0\r\n" + self.record(1, self.text("ros2") + self.text("bench")) + self.declared())
        records, index, first, last, count = [], {}, None, 0, 0
        size = 0

        def flush():
            nonlocal records, index, first, size
            if not records:
                return
            data = b"".join(records)
            body = (first.to_bytes(8, "little") + last.to_bytes(8, "little") + len(data).to_bytes(8, "little")
                    + zlib.crc32(data).to_bytes(4, "little") + self.text("") + len(data).to_bytes(8, "little") + data)
            start = self.at
            self.put(self.record(6, body))
            length, offsets = self.at - start, b""
            index_start = self.at
            for channel, entries in index.items():
                offsets += channel.to_bytes(2, "little") + self.at.to_bytes(8, "little")
                rows = b"".join(t.to_bytes(8, "little") + o.to_bytes(8, "little") for t, o in entries)
                self.put(self.record(7, channel.to_bytes(2, "little") + self.text(rows)))
            self.chunks.append(first.to_bytes(8, "little") + last.to_bytes(8, "little") + start.to_bytes(8, "little")
                               + length.to_bytes(8, "little") + self.text(offsets) + (self.at - index_start).to_bytes(8, "little")
                               + self.text("") + len(data).to_bytes(8, "little") * 2)
            records, index, first, size = [], {}, None, 0
        n = len(self.topics[0])
        for k in range(pictures):
            t = 10**9 + k * 10**7
            first = t if first is None else first
            last = t
            for channel in (2, 3, 1):
                body = (channel.to_bytes(2, "little") + k.to_bytes(4, "little") + t.to_bytes(8, "little") * 2
                        + self.topics[channel - 1].data(k % n).tobytes())
                index.setdefault(channel, []).append((t, size))
                records.append(self.record(5, body))
                size += len(records[-1])
                count += 1
            if size > 4 << 20:
                flush()
        flush()
        self.put(self.record(15, bytes(4)))
        summary = self.at
        self.put(self.declared())
        for chunk in self.chunks:
            self.put(self.record(8, chunk))
        channels = {i: pictures for i in (1, 2, 3)}
        counts = b"".join(i.to_bytes(2, "little") + c.to_bytes(8, "little") for i, c in channels.items())
        self.put(self.record(11, count.to_bytes(8, "little") + (3).to_bytes(2, "little") + (3).to_bytes(4, "little") + bytes(8)
                             + len(self.chunks).to_bytes(4, "little") + (10**9).to_bytes(8, "little") + last.to_bytes(8, "little")
                             + self.text(counts)))
        self.put(self.record(2, summary.to_bytes(8, "little") + bytes(12)) + b"\x89MCAP0\r\n")


PARTS = {"equality": equality, "steps": steps, "memory": memory, "reading": reading}


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    options.add_argument("--quick", action="store_true", help="a tenth of the work, to see that it runs")
    options.add_argument("--json", type=Path)
    options = options.parse_args()
    out = options.json.resolve() if options.json else None
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        found = {}
        for part in options.parts or PARTS:
            print(f"-- {part}")
            found[part] = PARTS[part](options.quick)
        os.chdir("/")
    if out:
        out.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
