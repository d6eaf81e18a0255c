"""Runs the commands of the documents: what can run here, shortened; what cannot is on the list below, with its reason.

Each document's commands run one after the other in a folder of its own, which has `examples` alone at first, with a Rigor that was
installed into a prefix: rigs and worlds are found as a user finds them. A command that neither runs nor is on the list is
an error, as is an entry of the list that no command matches any more.
"""
import contextlib
import os
import re
import shlex
import signal
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# (document, pattern of the command line, why it does not run here)
NOT_RUN = [
    (r"", r"^\./dev |^cmake |^npm |^tools/|^node ", "builds or tests the tree itself: other lanes do"),
    (r"", r"^sudo ", "changes the machine"),
    (r"packages", r"^docker ", "needs Docker: tools/try_packages.sh tries what the image is made of"),
    (r"", r"^sqlite3 ", "another program, which need not be installed"),
    (r"", r"…", "an example with parts left out"),
    (r"", r"seekurjr-forest|seekurjr-forest-light|stand/seekurjr",
     "minutes of a forest's pictures and scans: tests/cli/test_forest.cpp runs the rigs"),
    (r"", r"rigs/v4l2\.yaml", "needs a kernel with video devices: the kernel lane has them"),
    (r"", r"cut-short\.mcap|demo\.mcap --repair", "repairs a damaged recording: tests/cli/test_runs.cpp makes one"),
    (r"", r"drive\.pcap|room\.pcap|drive\.ubx", "reads a recording of a real device: tests with RIGOR_TEST_DATA do"),
    (r"", r"rigor calibrate (camera|stereo|photon|shading|extrinsics|lidar|tof) ",
     "reads pictures or recordings of a board that the user takes: tests/cli/test_calibrate*.cpp make them"),
    (r"pair-model", r"scan-real\.yaml|before\.mcap|after\.mcap|scan\.yaml|run\.mcap",
     "needs the reader's own device or model: tests/cli/test_calibrate_pair.cpp has one"),
    (r"", r"run rig\.yaml ", "the reader's own rig"),
    (r"drivers/can", r"--clock wall|emulate", "needs a CAN interface: the kernel lane has one"),
    (r"", r"--live 192\.168\.", "an address of another machine"),
    (r"", r"--no-emulators", "needs the emulator in a second terminal, or a device"),
    (r"faults", r"--faults-from live\.mcap", "needs a recording with faults of the reader: tests/cli/test_faults.cpp makes one"),
    (r"worlds", r"world render .*(--bands|--time|--set|radiance\.exr)",
     "the same picture in another light: the plain one runs, tests/cli/test_world_render.cpp has the options"),
    (r"datasets", r"stereo-forest", "minutes of a forest's pictures: tests/cli/test_dataset.cpp makes samples of a small world"),
    (r"pair-watch", r"pair-watch-cameras", "an hour and a half of bench time"),
    (r"pair-watch", r"scan --(acknowledge|learn-again)", "needs an alarm of a minute's baseline: tests/cli/test_pair_watch.cpp has one"),
    (r"forest-localization", r"stem|disc-forest-way-200m|scip|gnss=\{", "needs the files of a whole run before it"),
    (r"stereo", r"stereo-forest|ideal=true", "the same rig with another world: the first runs, tests have the others"),
    (r"calibration/pair", r"calibrate (delay|twin)", "needs sixteen seconds of the demo's pictures: tests/cli/test_calibrate_pair.cpp"),
    (r"calibration/latency|README", r"calibrate (delay|latency)", "needs twenty seconds of the demo: tests/cli/test_calibrate_latency.cpp"),
    (r"python", r"^PYTHONPATH=|^/usr/bin/python3 ", "needs the Python module: tests/python runs the examples and what the guide shows"),
    (r"light-error", r"bench_light|light_error", "minutes of path tracing, by programs of the tree"),
    (r"range-error", r"bench_range|range_error|bench_moving_rig", "minutes of rays, by programs of the tree"),
    (r"world-plugins", r"beehives\.so|hives\.rigor", "needs the plugin that the lines before build: tests/install builds it"),
    (r"tutorial", r"/tmp/detector", "needs the program that the line before builds: tests/cli/test_application_process.cpp runs it"),
    (r"plants", r"arm\.fmu|examples/fmu", "needs the FMU that the lines build: tests/cli/test_plants.cpp makes it"),
    (r"sweep|README", r"sweep forest-discs", "minutes of runs: tests/cli/test_sweep.cpp makes sweeps of a small rig"),
    (r"sweep", r"--slurm|^seq ", "needs a cluster, or GNU parallel: tests/cli/test_sweep_slurm.cpp starts one"),
    (r"platforms|README|forest-localization", r"harvester", "minutes of scans: tests/cli/test_harvester.cpp runs the rig"),
]

# A run that goes on while the document's commands talk to it: (document, words of rigor).
BESIDE = {
    "docs/faults.md": ["run", "demo", "--clock", "virtual", "--pace", "1", "--duration", "600", "--json"],
    "README.md": ["run", "demo", "--clock", "virtual", "--pace", "1", "--duration", "600", "--json"],
}
# These are shown to be refused.
REFUSED = [r"fault demo left\.real dely"]
SECONDS = "0.3"  # of every run
LONGEST_S = 180
SLOW_S = 5  # what takes longer is named
AT_ONCE = 3  # documents
ATTEMPTS = 3  # of a command that keeps time by the wall clock, or talks to a run that does; others fail at once


class Runner:
    def __init__(self, prefix, folder, document):
        self.folder, self.document, self.beside = folder, document, None
        self.env = {**os.environ, "PATH": f"{prefix}/bin:{os.environ['PATH']}", "XDG_RUNTIME_DIR": str(folder)}

    def start(self, words):
        with open(self.folder / ".said", "w", encoding="utf-8") as said:
            return subprocess.Popen(words, cwd=self.folder, env=self.env, stdout=said, stderr=subprocess.STDOUT)

    def until(self, process, there):
        """Waits until something is there, or the process has ended."""
        end = time.monotonic() + LONGEST_S
        while process.poll() is None and not there() and time.monotonic() < end:
            time.sleep(0.1)

    def until_interrupted(self, words):
        """What a command says that runs until Ctrl-C."""
        process = self.start(words)
        said = self.folder / ".said"
        self.until(process, lambda: said.stat().st_size > 0)
        early = process.poll()
        process.send_signal(signal.SIGINT)
        process.wait(timeout=LONGEST_S)
        return early is None and process.returncode == 0, said.read_text(encoding="utf-8")

    def begin_beside(self, words):
        if self.beside is None:
            self.beside = self.start(["rigor", *words])
            self.until(self.beside, lambda: any((self.folder / "rigor").glob("*.sock")))

    def end_beside(self):
        if self.beside is not None:
            self.beside.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.beside.wait(timeout=LONGEST_S)
            self.beside.kill()
            self.beside = None

    def run(self, line):
        """None, or what is wrong."""
        words = shlex.split(line.replace("$PWD", str(self.folder)), comments=True)
        behind = words[-1] == "&"
        words = words[:-1] if behind else words
        if behind:
            self.begin_beside(words[1:])
            return None
        if words[1] in ("fault", "pair") and self.document in BESIDE:
            self.begin_beside(BESIDE[self.document])
        if words[1] == "run":
            self.end_beside()
            words = shortened(words)
        if words[1] == "replay" and "--live" in words:
            words += ["--live-end", "--pace", "0"]
        if words[1:3] == ["world", "render"]:
            words += ["--width", "96", "--height", "54"]
        try:
            if words[1] == "emulate":
                good, said = self.until_interrupted(words)
            else:
                done = subprocess.run(words, cwd=self.folder, env=self.env, text=True, capture_output=True,
                                      timeout=LONGEST_S, check=False)
                good, said = done.returncode == 0, done.stdout + done.stderr
        except subprocess.TimeoutExpired:
            return f"did not end within {LONGEST_S} s"
        if any(re.search(p, line) for p in REFUSED):
            good = not good
        # `rigor doctor` says with status 1 that the machine lacks something.
        if good or words[1] == "doctor":
            return None
        return "fails: " + " / ".join(said.strip().splitlines()[-3:])


def shortened(words):
    for i, word in enumerate(words):
        if word == "--duration":
            return [*words[:i + 1], SECONDS, *words[i + 2:]]
    return [*words, "--duration", SECONDS]


def reason_not_to(document, line):
    for entry in NOT_RUN:
        if re.search(entry[0], document) and re.search(entry[1], line):
            return entry
    return None


def run_document(root, prefix, folder, document, lines, wall_clock):
    """(Errors, commands that were run again, entries of NOT_RUN that were used, how many commands were run) of one document."""
    errors, again, used, ran = [], [], set(), 0
    folder.mkdir()
    (folder / "examples").symlink_to(Path(root) / "examples")
    runner = Runner(prefix, folder, document)
    for number, line in lines:
        entry = reason_not_to(document, line)
        if entry:
            used.add(entry)
            continue
        if not line.startswith("rigor "):
            errors.append(f"{document}:{number}: neither run nor on the list of tools/docs_commands.py: {line}")
            continue
        alone = takes_ports(line)
        with wall_clock if alone else contextlib.nullcontext():
            since = time.monotonic()
            attempt, wrong = 1, runner.run(line)
            while wrong and attempt < ATTEMPTS and (alone or line.startswith(("rigor fault ", "rigor pair "))):
                print(f"docs: {document}:{number}: again: `{line}` {wrong}", flush=True)
                attempt, wrong = attempt + 1, runner.run(line)
        ran += 1
        took = time.monotonic() - since
        if attempt > 1:
            again.append(f"{document}:{number}: " + (f"failed {attempt} times" if wrong else f"passed at attempt {attempt}"))
        if took > SLOW_S:
            print(f"docs: {document}:{number}: {took:.0f} s: {line[:90]}", flush=True)
        if wrong:
            errors.append(f"{document}:{number}: `{line}` {wrong}")
    runner.end_beside()
    return errors, again, used, ran


def takes_ports(line):
    """Emulators, the live view, and what waits for devices, have their own ports and keep time by the wall clock: one such
    command at a time."""
    command = line.split(" #")[0]
    if "--live" in command:
        return True
    return command.startswith(("rigor run ", "rigor emulate ", "rigor devices")) and "--clock virtual" not in command


def run_all(root, by_document, whole=True):
    """(Errors, commands that were run again). `whole`: all documents are there, so that an entry of the list without a command
    is an error."""
    began, wall_clock = time.monotonic(), threading.Lock()
    with tempfile.TemporaryDirectory(prefix="rigor-docs-") as temporary:
        prefix = Path(temporary) / "prefix"
        done = subprocess.run(["cmake", "--install", "build/release", "--prefix", str(prefix)], cwd=root, text=True,
                              capture_output=True, check=False)
        if done.returncode != 0:
            return [f"cmake --install build/release: {done.stderr.strip()}"], []
        with ThreadPoolExecutor(AT_ONCE) as pool:
            results = list(pool.map(
                lambda item: run_document(root, prefix, Path(temporary) / re.sub(r"\W", "-", item[0]), *item, wall_clock),
                by_document.items()))
    errors = [error for part, _, _, _ in results for error in part]
    again = [line for _, part, _, _ in results for line in part]
    used = set().union(*(part for _, _, part, _ in results))
    if whole:
        errors += [f"tools/docs_commands.py: no command is like `{e[1]}` any more" for e in NOT_RUN if e not in used]
    print(f"docs: {sum(ran for _, _, _, ran in results)} commands run in {time.monotonic() - began:.0f} s")
    return errors, again
