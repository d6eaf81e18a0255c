#!/usr/bin/env python3
"""A soak test: runs a rig for long and says whether it leaks, loses count, stops, or falls silent.

usage: tools/soak.py --self-test
       tools/soak.py RIG.yaml --for 3600 [--clock wall|virtual] [--fault-every 10 --seed 1] [--set KEY=VALUE ...]
                     [--rigor build/release/rigor] [-o DIR]

The rig runs in a process of its own (and its emulators in theirs) until the time is over, then it is told to end by SIGINT.
Meanwhile, every few seconds: memory of the processes from /proc, and whether the loop has gone on, asked over the control
socket. With --fault-every a fault of a random kind on a random channel or sink comes that often, over the same socket.
Afterwards: the slope of memory with its confidence interval, the accounts of every channel, and what `rigor inspect` says of the
recording. DIR/soak.json has it all; exit status 0 where nothing was wrong, 1 where something was, 2 for bad input.
docs/soak.md explains the figures.
"""
import argparse
import json
import math
import os
import pathlib
import random
import signal
import socket
import subprocess
import sys
import time

# What is asked for of each kind of fault: keys for any channel; VALUE stands for `value` and UNIT for its unit.
LOSSES = [
    ("drop", lambda r: {"probability": round(r.uniform(0.1, 1), 2)}),
    ("burst_loss", lambda r: {"share": round(r.uniform(0.1, 0.5), 2), "mean_burst": r.randint(2, 6)}),
    ("disconnect", lambda r: {}),
]
TIMES = [
    ("delay", lambda r: {"delay_ms": r.randint(5, 150)}),
    ("jitter", lambda r: {"shape": "exponential", "mean_ms": r.randint(1, 40)}),
]
SOURCES_ONLY = [
    ("stuck", lambda r: {"freeze": r.random() < 0.5}),
    ("corrupt", lambda r: {"flips": r.randint(1, 64), "keep": round(r.uniform(0.3, 1), 2)}),
    ("timestamp", lambda r: {"offset_ms": r.randint(-60, 60)}),
    ("clock_skew", lambda r: {"ppm": r.randint(-500, 500)}),
    ("clock_step", lambda r: {"step_ms": r.randint(-80, 80)}),
    ("slow_consumer", lambda r: {"mode": "unread"} if r.random() < 0.5 else {"mode": "hold", "leases": r.randint(1, 4)}),
]
# The amount of a changed value by its unit.
AMOUNTS = {"dn": 20.0, "m": 0.3, "rad": 0.1, "mps": 0.2, "mps2": 0.5, "radps": 0.1, "k": 2.0, "": 0.5}
CHANGES = {
    "bias": lambda r, a, u: {f"amount{u}": round(r.uniform(-a, a), 4)},
    "drift": lambda r, a, u: {f"rate{u}_per_s": round(r.uniform(-a, a) / 4, 4)},
    "noise": lambda r, a, u: {f"sigma{u}": round(r.uniform(0, a), 4)},
    "spike": lambda r, a, u: {f"amount{u}": round(r.uniform(0, 4 * a), 4), "probability": 0.3},
}
KINDS = sorted([k for k, _ in LOSSES + TIMES + SOURCES_ONLY] + list(CHANGES))

# Two-sided 95 % points of Student's distribution by degrees of freedom.
STUDENT = {1: 12.71, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262, 10: 2.228, 12: 2.179,
           14: 2.145, 16: 2.120, 18: 2.101, 20: 2.086, 24: 2.064, 30: 2.042}


def student(freedom):
    return next((t for f, t in sorted(STUDENT.items()) if f >= freedom), 1.96)


PORT = 64  # places of a port
RING = 4096  # most slots of a source: what may be in its ring when the run ends


def line_through(t, y):
    """Least squares: slope, and the residuals."""
    n = len(t)
    mt, my = sum(t) / n, sum(y) / n
    tt = sum((a - mt) ** 2 for a in t)
    b = sum((a - mt) * (c - my) for a, c in zip(t, y)) / tt
    return b, [c - my - b * (a - mt) for a, c in zip(t, y)], tt, mt


def slope(t, y, blocks=8):
    """Slope of y over t with two 95 % intervals that allow for the samples' hanging together.

    blocks: means of blocks, each much longer than what lasts in the samples; their line, Student's distribution.
    newey_west: the line of all samples, Bartlett's weights up to the lag 4 n^(1/3) (Newey and West, Econometrica 1987).
    """
    n = len(t)
    if n < 3 * blocks:
        return None
    b, rest, tt, mt = line_through(t, y)
    x = [(a - mt) * e for a, e in zip(t, rest)]
    lags = min(n // 4, math.ceil(4 * n ** (1 / 3)))
    total = sum(v * v for v in x)
    for lag in range(1, lags + 1):
        total += 2 * (1 - lag / (lags + 1)) * sum(x[i] * x[i - lag] for i in range(lag, n))
    nw = 1.96 * math.sqrt(max(total, 0)) / tt
    size = n // blocks
    bt = [sum(t[n - (k + 1) * size:n - k * size]) / size for k in range(blocks)]
    by = [sum(y[n - (k + 1) * size:n - k * size]) / size for k in range(blocks)]
    bb, brest, btt, _ = line_through(bt, by)
    half = student(blocks - 2) * math.sqrt(sum(e * e for e in brest) / (blocks - 2) / btt)
    return {"per_hour": bb * 3600, "from": (bb - half) * 3600, "to": (bb + half) * 3600, "blocks": blocks,
            "newey_west": {"per_hour": b * 3600, "from": (b - nw) * 3600, "to": (b + nw) * 3600, "lags": lags}}


def memory_kib(pid):
    """Rss, Pss and what is the process' own of its memory; None where it is gone."""
    found = {}
    try:
        for row in open(f"/proc/{pid}/smaps_rollup"):
            word = row.split()
            if word[0][:-1] in ("Rss", "Pss", "Private_Clean", "Private_Dirty", "Swap"):
                found[word[0][:-1]] = int(word[1])
    except OSError:
        return None
    if not found:
        return None
    return {"rss": found.get("Rss", 0), "pss": found.get("Pss", 0), "swap": found.get("Swap", 0),
            "own": found.get("Private_Clean", 0) + found.get("Private_Dirty", 0)}


def children_of(pid):
    try:
        kids = [int(w) for w in open(f"/proc/{pid}/task/{pid}/children").read().split()]
    except OSError:
        return []
    return kids + [g for k in kids for g in children_of(k)]


def cpu_s(pid):
    """Of all threads; a run that does not go on and has had none is starved, not stuck."""
    try:
        fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return 0.0


def counted(path):
    try:
        return len(os.listdir(path))
    except OSError:
        return None


class Bench:
    """The run under test."""

    def __init__(self, args, out):
        self.args, self.out = args, out
        self.env = dict(os.environ, XDG_RUNTIME_DIR=str(out / "sockets"))
        (out / "sockets").mkdir(mode=0o700, exist_ok=True)
        self.recording = out / "soak.mcap"
        self.asked = self.asked_again = 0
        command = [str(args.rigor), "run", str(args.rig), "--json", "--clock", args.clock, "--set", "report=",
                   "--duration", str(args.virtual_s if args.clock == "virtual" else args.for_s + 60)]
        command += ["--record", str(self.recording)]
        for s in args.set:
            command += ["--set", s]
        self.command = command
        self.process = subprocess.Popen(command, env=self.env, stdout=open(out / "run.json", "w"),
                                        stderr=open(out / "run.stderr", "w"), stdin=subprocess.DEVNULL)

    def ask(self, seconds=60, **request):
        """One request over the run's control socket (docs/faults.md): its answer, or None and why: a text where there was no answer.

        Asked in this process, because on a busy machine a process of its own may take minutes to start. Asked again every 10 s
        under the same `id`, so that nothing is done twice.
        """
        self.asked += 1
        line = json.dumps({**request, "id": f"soak-{self.asked}"}).encode() + b"\n"
        until, why, tries = time.monotonic() + seconds, "there is no socket", 0
        while time.monotonic() < until and self.process.poll() is None:
            tries += 1
            try:
                path = next((self.out / "sockets" / "rigor").glob(f"*.{self.process.pid}.sock"))
                with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as s:
                    s.settimeout(10)
                    s.connect(str(path))
                    s.sendall(line)
                    answer = s.makefile("rb").readline()
                if answer.endswith(b"\n"):
                    self.asked_again += tries > 1
                    answer = json.loads(answer)
                    return (answer["result"], None) if answer["ok"] else (None, answer["error"])
                why = "it closed the connection"
            except StopIteration:
                return None, why
            except OSError as e:
                why = str(e) or "no answer within 10 s"
            time.sleep(0.2)
        self.asked_again += tries > 1
        return None, f"asked {tries} times in {seconds} s: {why}"

    def end(self, seconds=300):
        """SIGINT, then the exit status; None where it had to be killed."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return None


class Faults:
    """Draws faults, and keeps what became of each."""

    def __init__(self, bench, seed):
        self.bench, self.random = bench, random.Random(seed)
        self.made, self.refused, self.unanswered, self.deck = {}, {}, [], []

    def next(self, places):
        # Every kind comes once before one comes again; where none of the places takes it, that is told.
        if not self.deck:
            self.deck = self.random.sample(KINDS, len(KINDS))
        kind = self.deck.pop()
        for place in self.random.sample(places, len(places)):
            for keys in self.keys(kind, place):
                fault = {"kind": kind, **keys, "for_s": round(self.random.uniform(1, 8), 1)}
                answer, why = self.bench.ask(command="fault", channel=place["name"], fault=fault)
                if answer is not None:
                    self.made[kind] = self.made.get(kind, 0) + 1
                    return
                if isinstance(why, str):
                    self.unanswered.append({"kind": kind, "place": place["name"], "why": why})
                    return
                self.refused[kind] = why["message"][:300]

    def keys(self, kind, place):
        for name, make in LOSSES + TIMES + SOURCES_ONLY:
            if name == kind:
                yield make(self.random)
        if kind in CHANGES:
            values = place.get("values", [])
            for v in self.random.sample(values, len(values)):
                name, unit = v["name"], v.get("unit", "")
                found = CHANGES[kind](self.random, AMOUNTS.get(unit, 0.5), f"_{unit}" if unit in AMOUNTS and unit else "")
                yield {"value": name, **found}


def places_of(channels):
    """Where faults can be, and on which values, from the answer to `channels`."""
    out = []
    for c in channels["faults_at"]:
        values = [v if isinstance(v, dict) else {"name": v} for v in c.get("values", [])]
        out.append({"name": c.get("name") or c["channel"], "values": values})
    return out


def check_accounts(result):
    """What does not add up, in words; and one row of numbers for each channel.

    source    received = taken by the bench + still in its ring (at most its slots) + ring full
    faults    taken = handed on + dropped + disconnected + no slot + waiting at the end
    port      taken by the loop = before the start + shown + superseded + overflow + not yet due at the end
    """
    wrong, rows = [], []
    for c in result.get("channels", []):
        a = c.get("accounts")
        if not a:
            wrong.append(f"{c['name']}: no accounts")
            continue
        rows.append({"channel": c["name"], **a})
        for place in a["sources"]:
            parts = [place[k] for k in ("handed_on", "dropped", "disconnected", "no_slot", "waiting")]
            if place["taken"] != sum(parts):
                wrong.append(f"{place['name']}: taken {place['taken']}, but handed on, dropped, disconnected, no slot, waiting "
                             f"are {' + '.join(map(str, parts))}")
            left = place["received"] - place["ring_full"] - place["taken"]
            if not 0 <= left <= RING:
                wrong.append(f"{place['name']}: received {place['received']}, ring full {place['ring_full']}, taken "
                             f"{place['taken']}: {left} are left over")
        if len(a["sources"]) == 1 and a["taken_by_loop"] != a["sources"][0]["handed_on"]:
            wrong.append(f"{c['name']}: handed on {a['sources'][0]['handed_on']}, but the loop took {a['taken_by_loop']}")
        if not 0 <= a["not_due_at_end"] <= PORT:
            wrong.append(f"{c['name']}: {a['not_due_at_end']} samples in the port at the end, which holds {PORT}")
    return wrong, rows


def check_faults(result, faults):
    """Whether the run knows every fault that it said it had taken, and no other."""
    asked, unanswered = sum(faults.made.values()), len(faults.unanswered)
    known = begun = 0
    for c in result.get("faults", []):
        earlier = c.get("earlier", {})
        live = [f for f in c["faults"] if f["live"]]
        known += len(live) + earlier.get("faults", 0)
        begun += sum(f["times"] for f in live) + earlier.get("times", 0)
    wrong = [f"no answer to {u['kind']} of {u['place']}: {u['why']}" for u in faults.unanswered]
    if not asked <= known <= asked + unanswered:
        wrong.append(f"{asked} faults were taken, {unanswered} requests had no answer, but the run knows {known}")
    if begun != known:
        wrong.append(f"the run knows {known} faults, of which {begun} began")
    return wrong, {"known": known, "begun": begun}


def check_recording(args, bench, result):
    said = subprocess.run([str(args.rigor), "inspect", str(bench.recording), "--json"], capture_output=True, text=True)
    if said.returncode != 0:
        return [f"rigor inspect: {said.stderr.strip()}"], {}
    told = json.loads(said.stdout)
    wrong = []
    recording = result.get("recording", {})
    if not told.get("complete", told.get("indexed", True)):
        wrong.append("the recording has no end: " + json.dumps(told)[:300])
    if recording.get("dropped", 0):
        wrong.append(f"the recorder left out {recording['dropped']} samples")
    if "messages" in told and told["messages"] != recording.get("messages"):
        wrong.append(f"{told['messages']} messages in the file, {recording.get('messages')} written")
    taken = [c["accounts"]["taken_by_loop"] for c in result.get("channels", []) if "pair" not in c and "accounts" in c]
    if all("pair" not in c for c in result.get("channels", [])) and taken:
        written = recording.get("samples", 0) + recording.get("dropped", 0) + recording.get("after_end", 0)
        if sum(taken) != written:
            wrong.append(f"the loop took {sum(taken)} samples, the recorder wrote, left out or got too late {written}")
    return wrong, told


def self_test():
    """Plants what must be found: slopes of series that hang together, and accounts that do not add up."""
    failures = []
    draw = random.Random(1)
    for rho, least in ((0.0, 0.88), (0.9, 0.88)):
        held = 0
        for _ in range(300):
            e, y = 0.0, []
            for i in range(576):
                e = rho * e + draw.gauss(0, 1)
                y.append(2.0 * i * 5 / 3600 + e)
            s = slope([5 * i for i in range(576)], y)
            held += s["from"] <= 2 <= s["to"]
        if not least <= held / 300 <= 0.985:
            failures.append(f"the interval of the slope holds the truth {held} times in 300 at a correlation of {rho}")
    source = {"name": "a", "received": 12, "ring_full": 1, "taken": 10, "handed_on": 6, "dropped": 2, "disconnected": 1, "no_slot": 0,
              "waiting": 1}
    whole = {"taken_by_loop": 6, "before_start": 0, "shown": 4, "superseded": 1, "overflow": 0, "not_due_at_end": 1}
    def wrong(port=None, place=None):
        accounts = {**whole, **(port or {}), "sources": [{**source, **(place or {})}]}
        return check_accounts({"channels": [{"name": "a", "accounts": accounts}]})[0]
    if wrong():
        failures.append(f"accounts that add up: {wrong()}")
    for planted in ({"dropped": 1}, {"received": 10}, {"received": 9000}):
        if len(wrong(place=planted)) != 1:
            failures.append(f"not found once: {planted} in a source")
    for planted in ({"taken_by_loop": 5}, {"not_due_at_end": 65}, {"not_due_at_end": -1}):
        if len(wrong(port=planted)) != 1:
            failures.append(f"not found once: {planted} in a port")
    asked = Faults(None, 1)
    asked.made, asked.unanswered = {"drop": 2, "bias": 1}, []
    entry = {"channel": "a", "faults": [{"live": False, "times": 3}, {"live": True, "times": 1}],
             "earlier": {"faults": 2, "times": 2}}
    if check_faults({"faults": [entry]}, asked)[0]:
        failures.append("faults that add up")
    for planted, count in (({"earlier": {"faults": 1, "times": 1}}, 1), ({"earlier": {"faults": 2, "times": 1}}, 1)):
        if len(check_faults({"faults": [{**entry, **planted}]}, asked)[0]) != count:
            failures.append(f"not found: {planted} in the faults that a run knows")
    for f in failures:
        print(f"self-test: {f}")
    print(f"self-test: {len(failures)} failures")
    return 1 if failures else 0


def main():
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
    p = argparse.ArgumentParser(description="Runs a rig for long and says what went wrong.")
    p.add_argument("rig", type=pathlib.Path)
    p.add_argument("--rigor", type=pathlib.Path, default=pathlib.Path("build/release/rigor"))
    p.add_argument("--for", dest="for_s", type=float, default=3600, help="wall time in seconds")
    p.add_argument("--clock", choices=("wall", "virtual"), default="wall")
    p.add_argument("--virtual-s", type=float, default=1e6, help="end after this much virtual time, if it comes first")
    p.add_argument("--fault-every", type=float, default=0, help="seconds of wall time; 0: none")
    p.add_argument("--seed", type=int, default=1, help="of the faults")
    p.add_argument("--sample-every", type=float, default=5)
    p.add_argument("--warm-up", type=float, default=0.2, help="share of the time before the slope counts")
    p.add_argument("--hang", type=float, default=120, help="seconds without a step forward that are one")
    p.add_argument("--start", type=float, default=900, help="seconds until it answers for the first time, at most")
    p.add_argument("--keep", action="store_true", help="keep the recording")
    p.add_argument("--set", action="append", default=[])
    p.add_argument("-o", "--output", type=pathlib.Path, default=pathlib.Path("soak"))
    args = p.parse_args()
    if not args.rig.exists() or not args.rigor.exists():
        print(f"soak: expected a rig and the program, {args.rig if not args.rig.exists() else args.rigor} is not there",
              file=sys.stderr)
        return 2
    args.rigor = args.rigor.resolve()
    args.output.mkdir(parents=True, exist_ok=True)
    out = args.output.resolve()
    bench, problems = Bench(args, out), []
    faults = Faults(bench, args.seed) if args.fault_every else None
    samples, places, cycle, progress, cpu = [], None, -1, time.monotonic(), 0.0
    started = time.monotonic()
    next_fault = started + 15
    ended_itself = False
    while time.monotonic() - started < args.for_s:
        time.sleep(args.sample_every)
        now = time.monotonic() - started
        if bench.process.poll() is not None:
            ended_itself = True
            break
        all_pids = [bench.process.pid] + children_of(bench.process.pid)
        memory = [m for m in map(memory_kib, all_pids) if m]
        answer, why = bench.ask(command="channels")
        if answer is not None:
            places = places_of(answer)
            at = answer.get("cycle")
            if at is None:  # what came from the sources goes on as the loop does
                at = sum(c.get("received", 0) for c in answer.get("channels", []))
            if at != cycle:
                cycle, progress, cpu = at, time.monotonic(), cpu_s(bench.process.pid)
        if time.monotonic() - progress > (args.hang if places else args.start):
            used = cpu_s(bench.process.pid) - cpu
            problems.append((f"no step forward for {args.hang} s at {now:.0f} s" if places else
                             f"it did not start within {args.start} s") + f" and {used:.1f} s of CPU time: {why}")
            break
        if memory and places:
            samples.append({"t_s": round(now, 1), "cycle": cycle, "threads": counted(f"/proc/{bench.process.pid}/task"),
                            "files": counted(f"/proc/{bench.process.pid}/fd"), "processes": len(memory),
                            **{k: sum(m[k] for m in memory) for k in memory[0]}, "own_run": memory[0]["own"]})
        if faults and places and time.monotonic() >= next_fault:
            next_fault += args.fault_every
            faults.next(places)
        if len(samples) % 60 == 1:
            write(out / "progress.json", {"t_s": now, "samples": samples[-1:], "faults": faults.made if faults else {}})
    wall_s = time.monotonic() - started
    ran_out = ended_itself and bench.process.returncode == 0
    code = bench.end()
    if ended_itself and not ran_out:
        problems.append(f"it ended by itself after {wall_s:.0f} s with status {code}")
    elif code is None:
        problems.append("it did not end within 300 s of SIGINT, and was killed")
    elif code != 0:
        problems.append(f"it ended with status {code}")
    try:
        result = json.loads((out / "run.json").read_text())
    except ValueError:
        result = {}
        problems.append("it did not say what the run was like: " + (out / "run.stderr").read_text()[-500:])
    wrong, rows = check_accounts(result)
    problems += wrong
    wrong, inspected = check_recording(args, bench, result)
    problems += wrong
    known = {}
    if faults:
        wrong, known = check_faults(result, faults)
        problems += wrong
    steady = [s for s in samples if s["t_s"] >= args.warm_up * wall_s]
    told = {
        "command": " ".join(bench.command), "version": result.get("version"), "clock": args.clock,
        "wall_s": round(wall_s, 1), "bench_s": result.get("duration_s"), "cpus": os.cpu_count(),
        "problems": problems,
        "memory_kib": {k: {"first": steady[0][k], "last": steady[-1][k], "most": max(s[k] for s in samples),
                           "slope": slope([s["t_s"] for s in steady], [s[k] for s in steady])}
                       for k in ("rss", "pss", "own", "own_run", "threads", "files")} if steady else {},
        "accounts": rows,
        "loop": {k: result.get("loop", {}).get(k) for k in ("cycles_run", "cycles_skipped", "overruns", "reason")},
        "recording": {k: v for k, v in result.get("recording", {}).items()},
        "inspected": {k: v for k, v in inspected.items() if not isinstance(v, (list, dict))},
        "faults": {"made": faults.made, "refused": {k: v for k, v in faults.refused.items() if k not in faults.made},
                   "unanswered": faults.unanswered, **known} if faults else {},
        "asked_again": bench.asked_again,
        "samples": samples,
    }
    write(out / "soak.json", told)
    if not args.keep and not problems:
        bench.recording.unlink(missing_ok=True)
    print(summary(told))
    return 1 if problems else 0


def write(path, what):
    part = path.with_suffix(".part")
    part.write_text(json.dumps(what, indent=1))
    part.replace(path)


def summary(told):
    lines = [f"{told['wall_s']:.0f} s of wall time, {told['bench_s'] or 0:.0f} s of the bench's on the {told['clock']} clock"]
    for k, m in told["memory_kib"].items():
        s = m["slope"]
        unit = "KiB" if k in ("rss", "pss", "own", "own_run") else ""
        slope_text = (f"{s['per_hour']:+.1f} {unit} an hour ({s['from']:+.1f} to {s['to']:+.1f})" if s
                      else "too few samples for a slope")
        lines.append(f"{k:8} {m['last']} {unit}, most {m['most']}; {slope_text}")
    if told["faults"]:
        made = told["faults"]["made"]
        lines.append(f"faults   {sum(made.values())} ({told['faults']['known']} known to the run): "
                     + ", ".join(f"{n} {k}" for k, n in sorted(made.items())))
    for row in told["accounts"]:
        lines.append("account  " + ", ".join(f"{k} {v}" for k, v in row.items() if k != "sources"))
        lines += ["         " + ", ".join(f"{k} {v}" for k, v in place.items()) for place in row["sources"]]
    lines += [f"WRONG    {p}" for p in told["problems"]] or ["nothing was wrong"]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
