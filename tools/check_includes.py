#!/usr/bin/env python3
"""Checks that includes only run along the arrows of docs/architecture.md.

Six rules, over every C++ and GLSL source of the tree:
  direction  a file includes only its own component and those that ALLOWED gives its component
  root       a quoted include is a path from the repository's root that exists, or what the build makes of a shader (X.frag.inc)
  rt-core    rt-core includes only itself, the standard library, the compiler, Linux, readerwriterqueue and tl::expected
  vendor     a public header does not include a vendor's header, not even through another header; public is
             what another component of the program includes (tests and benches may look inside)
  circle     the rooms of a component in ROOMS, which are its folders, do not include each other in circles
  length     over 600 lines is a note, never a failure

`--self-test` plants one violation of each rule in a tree of its own and fails when one is not found.
"""
import argparse
import re
import sys
import tempfile
from pathlib import Path

EVERYTHING = object()
# Who may include whom. A component is the longest of these names that a path starts with; `drivers` and `apps`
# count each subfolder as a component of its own.
SIM_BASE = {"rt-core", "sensor-hal", "sim/world"}
ALLOWED = {
    "rt-core": set(),
    "sensor-hal": {"rt-core"},
    "drivers": {"rt-core", "sensor-hal", "drivers/lidar", "drivers/network", "drivers/serial"},
    "drivers/lidar": {"rt-core", "sensor-hal", "drivers/network"},
    "drivers/network": {"rt-core", "sensor-hal"},
    "drivers/serial": {"rt-core", "sensor-hal", "drivers/network"},
    "bridges": {"rt-core", "sensor-hal"},
    "calibration": {"rt-core", "sensor-hal"},
    "calibration/procedures": {"rt-core", "sensor-hal", "drivers", "drivers/network", "calibration", "bench"},
    "apps": {"rt-core", "sensor-hal"},
    "sim/world": {"rt-core", "sensor-hal"},
    "sim/render": SIM_BASE,
    "sim/sensors": SIM_BASE | {"sim/render"},
    "sim/platform": SIM_BASE | {"sim/render"},
    "sim/nature": SIM_BASE | {"sim/render"},
    "sim/gis": SIM_BASE | {"sim/render"},
    "sim/fmu": {"rt-core", "sensor-hal"},
    "bench": SIM_BASE | {"sim/render", "sim/sensors", "sim/platform", "sim/nature", "sim/gis", "sim/fmu"},
    "builtin": {"rt-core", "sensor-hal", "drivers", "drivers/serial", "apps", "bridges", "bench"},
    "clients": set(),
    "cli": EVERYTHING,
    "python": EVERYTHING,
    "tests": EVERYTHING,
    "benches": EVERYTHING,
}
ONE_EACH = ("drivers", "apps", "bridges")
ROOMS = ("bench", "sensor-hal")
LOOKS_INSIDE = ("tests", "benches")
SUFFIXES = (".h", ".hpp", ".cpp", ".glsl", ".comp", ".vert", ".frag")
LENGTH_NOTE = 600

VENDOR = re.compile(
    r"^(?!nlohmann/json_fwd\.hpp)"  # forward declarations leak nothing
    r"(arv|aravis|modbus|libusb|opencv2/|vulkan/|yaml-cpp/|fastcdr/|zstd|lz4|openssl/|nlohmann/|CLI/|spdlog/|fmt/|"
    r"dds/|fastdds/|gtest/|gmock/|benchmark/|ceres/|Random123/|gdal|ogr|sqlite3|SQLiteCpp/|embree3/|boost/|pcap|glib|gio/|assimp/|"
    r"GeographicLib/|libnova/|png|jpeglib|zip\.h|pugixml)")
# Not in it: glm and Eigen, the vocabulary of vectors in sim/, as tl::expected is that of results everywhere.

LINUX_FOLDERS = ("sanitizer/", "sys/", "linux/", "asm/", "net/", "netinet/", "arpa/")
LINUX_HEADERS = set(
    "unistd.h fcntl.h pthread.h sched.h semaphore.h poll.h dirent.h dlfcn.h errno.h signal.h time.h string.h stdio.h "
    "stdlib.h stdint.h malloc.h execinfo.h ucontext.h cpuid.h immintrin.h x86intrin.h syslog.h spawn.h ifaddrs.h "
    "netdb.h grp.h pwd.h termios.h".split())
RT_CORE_LIBRARIES = ("readerwriterqueue/", "tl/expected.hpp")

INCLUDE = re.compile(r'^\s*#\s*include\s*(?:"([^"]+)"|<([^>]+)>)')


def component_of(path):
    """The component of a path from the root, or None for a file outside of all."""
    for name in sorted(ALLOWED, key=len, reverse=True):
        if path.startswith(name + "/"):
            parts = path.split("/")
            if name in ONE_EACH and len(parts) > 2:
                return "/".join(parts[:2])
            return name
    return None


def family(component):
    if component in ALLOWED:
        return component
    first = component.split("/")[0]
    return first if first in ONE_EACH else component


def allows(includer, included):
    allowed = ALLOWED[family(includer)]
    return includer == included or allowed is EVERYTHING or family(included) in allowed


def may_include_in_rt_core(header):
    standard = "/" not in header and "." not in header
    return (standard or header in LINUX_HEADERS or header.startswith(LINUX_FOLDERS)
            or header.startswith(RT_CORE_LIBRARIES))


class Tree:
    def __init__(self, root):
        self.root = Path(root)
        self.quoted = {}  # file -> [(line, target)]
        self.angled = {}  # file -> [(line, header)]
        self.errors = []
        self.notes = []
        for top in sorted({name.split("/")[0] for name in ALLOWED}):
            for file in sorted((self.root / top).rglob("*")):
                if file.suffix in SUFFIXES and "node_modules" not in file.parts and file.is_file():
                    self.read(file)

    def read(self, file):
        name = file.relative_to(self.root).as_posix()
        lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
        if len(lines) > LENGTH_NOTE:
            self.notes.append(f"{name}: note: {len(lines)} lines; a file with one subject is rarely over {LENGTH_NOTE}")
        self.quoted[name], self.angled[name] = [], []
        for number, line in enumerate(lines, 1):
            match = INCLUDE.match(line)
            if match and match.group(1):
                self.quoted[name].append((number, match.group(1)))
            elif match:
                self.angled[name].append((number, match.group(2)))

    def error(self, file, line, rule, message):
        self.errors.append((file, line, rule, message))

    def check(self):
        public = set()
        for file, includes in self.quoted.items():
            home = component_of(file)
            if home is None:
                self.error(file, 1, "direction", "this folder is not in ALLOWED of tools/check_includes.py: "
                                                 "decide whom it may include")
                continue
            for line, target in includes:
                if self.is_compiled_shader(target, home):
                    continue
                there = component_of(target)
                if there is None or not (self.root / target).is_file():
                    self.error(file, line, "root", f'"{target}" is not a file, seen from the repository\'s root')
                    continue
                if not allows(home, there):
                    self.error(file, line, "direction", f'{home} must not include {there} ("{target}")')
                if home != there and home not in LOOKS_INSIDE:
                    public.add(target)
        self.check_rt_core()
        self.check_vendor(public)
        for component in ROOMS:
            self.check_circles(component)
        return self.errors

    def is_compiled_shader(self, target, component):
        shader = target.removesuffix(".inc")
        return shader != target and any(Path(file).name == shader and component_of(file) == component
                                        for file in self.quoted)

    def check_rt_core(self):
        for file, includes in self.angled.items():
            if component_of(file) != "rt-core":
                continue
            for line, header in includes:
                if not may_include_in_rt_core(header):
                    self.error(file, line, "rt-core", f"rt-core must not include <{header}>")

    def check_circles(self, component):
        """One error for each include of a circle of rooms."""
        def room(path):
            parts = path.removeprefix(component + "/").split("/")
            return parts[0] if path.startswith(component + "/") and len(parts) > 1 else None

        ways = {}  # room -> {room that it includes: [(file, line)]}
        for file, includes in self.quoted.items():
            for line, target in includes:
                if room(file) and room(target) and room(file) != room(target):
                    ways.setdefault(room(file), {}).setdefault(room(target), []).append((file, line))

        def leads(start, end):
            seen, todo = set(), [start]
            while todo:
                here = todo.pop()
                if here == end:
                    return True
                if here not in seen:
                    seen.add(here)
                    todo += ways.get(here, {})
            return False

        for start, ends in ways.items():
            for end, places in ends.items():
                if leads(end, start):
                    for file, line in places:
                        self.error(file, line, "circle", f"{component}/{end} includes {component}/{start}, too")

    def check_vendor(self, public):
        for header in sorted(public):
            if component_of(header) == "clients":
                continue  # they stand alone at the user's, with what their first lines ask for
            seen, todo = set(), [(header, [])]
            while todo:
                file, way = todo.pop()
                if file in seen or file not in self.quoted:
                    continue
                seen.add(file)
                for line, vendor in self.angled[file]:
                    if VENDOR.match(vendor):
                        through = f" through {' -> '.join(way + [file])}" if way else ""
                        self.error(header, line if not way else 1, "vendor",
                                   f"public header includes <{vendor}>{through}")
                todo += [(target, way + [file]) for _, target in self.quoted[file]]


def report(tree):
    for note in tree.notes:
        print(note)
    for file, line, rule, message in sorted(tree.errors):
        print(f"{file}:{line}: error: [{rule}] {message}")
    count = sum(len(v) for v in tree.quoted.values())
    print(f"includes: {len(tree.quoted)} files, {count} includes from the root, {len(tree.errors)} errors")
    return 1 if tree.errors else 0


def self_test():
    good = {
        "rt-core/a.h": "#include <atomic>\n#include <sys/mman.h>\n#include <tl/expected.hpp>\n",
        "sensor-hal/channel/c.h": '#include "rt-core/a.h"\n',
        "drivers/can/can.h": '#include "sensor-hal/channel/c.h"\n#include "drivers/can/raw.h"\n',
        "drivers/can/raw.h": '#include "rt-core/a.h"\n#include "drivers/network/udp.h"\n',
        "drivers/network/udp.h": '#include "rt-core/a.h"\n',
        "drivers/can/raw.cpp": '#include <libusb.h>\n',
        "sim/world/w.h": '#include "sensor-hal/channel/c.h"\n',
        "sim/render/r.cpp": '#include "sim/world/w.h"\n#include <vulkan/vulkan.h>\n#include "sky.frag.inc"\n',
        "sim/render/shaders/sky.frag": "void main() {}\n",
        "bench/run/run.cpp": '#include "bench/files/file.h"\n',
        "builtin/registry.cpp": '#include "bench/run/run.h"\n#include "drivers/can/can.h"\n',
        "bench/files/file.h": '#include "rt-core/a.h"\n',
        "bench/run/run.h": '#include "sensor-hal/channel/c.h"\n',
        "calibration/core/fit.h": '#include "rt-core/a.h"\n',
        "calibration/procedures/p.cpp": '#include "bench/run/run.h"\n#include "calibration/core/fit.h"\n',
        "cli/main.cpp": '#include "drivers/can/can.h"\n#include "sim/world/w.h"\n#include <CLI/CLI.hpp>\n',
    }
    planted = [  # (rule, file, text): each must be found, in that file
        ("direction", "rt-core/back.cpp", '#include "sensor-hal/channel/c.h"\n'),
        ("direction", "drivers/usb/u.cpp", '#include "drivers/can/raw.h"\n'),
        ("direction", "bridges/ros2/b.cpp", '#include "drivers/can/raw.h"\n'),
        ("direction", "sensor-hal/models/m.glsl.h", '#include "sim/world/w.h"\n'),
        ("direction", "sim/world/up.frag", '#include "sim/render/shade.glsl"\n'),
        ("direction", "drivers/network/n.cpp", '#include "drivers/can/raw.h"\n'),
        ("direction", "sensor-hal/channel/d.cpp", '#include "drivers/network/udp.h"\n'),
        ("direction", "apps/demo/d.cpp", '  #  include "drivers/can/can.h"\n'),
        ("root", "sim/sensors/s.cpp", '#include "../world/w.h"\n'),
        ("root", "sim/sensors/t.cpp", '#include "sim/world/missing.h"\n'),
        ("root", "sim/sensors/u.cpp", '#include "sky.frag.inc"\n'),
        ("direction", "bench/run/up.cpp", '#include "cli/command.h"\n'),
        ("direction", "calibration/core/up.cpp", '#include "calibration/procedures/p.h"\n'),
        ("direction", "bench/run/driver.cpp", '#include "drivers/can/can.h"\n'),
        ("direction", "bench/run/calibrated.cpp", '#include "calibration/core/fit.h"\n'),
        ("circle", "bench/files/file.cpp", '#include "bench/run/run.h"\n'),
        ("rt-core", "rt-core/log.cpp", "#include <spdlog/spdlog.h>\n"),
        ("vendor", "drivers/modbus/m.h", "#include <modbus/modbus.h>\n"),
        ("vendor", "sensor-hal/record/outer.h", '#include "sensor-hal/record/inner.h"\n'),
    ]
    helpers = {
        "sim/render/shade.glsl": "float shade() { return 1.0; }\n",
        "sensor-hal/record/inner.h": "#include <zstd.h>\n",
        "cli/command.h": "int command();\n",
        "calibration/procedures/p.h": "int procedure();\n",
        "cli/wire.cpp": '#include "drivers/modbus/m.h"\n#include "sensor-hal/record/outer.h"\n',
    }

    def run(files):
        with tempfile.TemporaryDirectory() as folder:
            for name, text in files.items():
                path = Path(folder, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            return Tree(folder).check()

    failures = [f"a good tree was refused: {e}" for e in run(good)]
    for rule, file, text in planted:
        found = run({**good, **helpers, file: text})
        if not any(e[0] == file and e[2] == rule for e in found):
            failures.append(f"a planted violation of [{rule}] in {file} was not found")
    for failure in failures:
        print(f"self-test: {failure}")
    print(f"self-test: {len(planted)} planted violations, {len(failures)} failures")
    return 1 if failures else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--self-test", action="store_true", help="plant violations and see that each is found")
    parser.add_argument("root", nargs="?", default=Path(__file__).resolve().parent.parent)
    arguments = parser.parse_args()
    if arguments.self_test:
        return self_test()
    tree = Tree(arguments.root)
    tree.check()
    return report(tree)


if __name__ == "__main__":
    sys.exit(main())
