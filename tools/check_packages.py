#!/usr/bin/env python3
"""Checks what is installed where: components of a build folder, or the Debian packages that are made of them.

    check_packages.py --build BUILD_DIR     installs each component, and all at once, into temporary folders
    check_packages.py DEB...                unpacks packages
    check_packages.py --self-test

No file is in two components, and none outside of all; each lies with what it belongs to; nothing has the path of the source
tree in it. Packages are stripped, have no run path, bind their functions when the program starts, have copyright and changelog, and
a manual page for each program. Exit status 1 where something is wrong.
"""
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIBRARY = r"lib/([^/]+/)?"
# (component, what lies there below the prefix, what must be there)
PLACES = [
    ("command", [r"bin/[^/]+", r"share/rigor/(configs|clients)/.+", r"share/man/man1/rigor.*", r"share/bash-completion/completions/rigor",
                 r"share/rigor/examples/[^/]+/[^/]+\.py"],
     ["bin/rigor", "share/rigor/configs/demo.yaml", "share/rigor/configs/rigs/can.yaml",
      "share/rigor/clients/python/rigor_client.py", "share/bash-completion/completions/rigor", "share/rigor/examples/application/detector.py"]),
    ("machine", [r"share/rigor/(udev|sysctl)/[^/]+", r"lib/(udev/rules|sysctl)\.d/[^/]+"],
     ["share/rigor/udev/60-rigor.rules", "share/rigor/sysctl/60-rigor-sysctl.conf"]),
    ("libraries", [LIBRARY + r"librigor_(hal|world|bench)\.so\.[0-9.]+"], []),
    ("sdk", [r"include/.+", LIBRARY + r"cmake/Rigor/[^/]+\.cmake", LIBRARY + r"librigor_[a-z]+\.so", r"share/rigor/examples/.+"],
     ["include/rigor_client.h", "include/rigor/sensor-hal/plugin/plugin.h", "include/rigor/rigor/hal_abi.h",
      "include/rigor/bench/bench.h", "share/rigor/examples/driver/CMakeLists.txt"]),
    ("python", [r"lib/python3/dist-packages/rigor.+", r"share/rigor/examples/python/.+"], ["lib/python3/dist-packages/rigor/__init__.py"]),
]
OF_PACKAGES = {"rigor": ("command", "machine"), "librigor-dev": ("sdk",), "python3-rigor": ("python",)}
DOCUMENTS = ("copyright", "changelog.gz", "changelog.Debian.gz")


def components_of(package):
    return ("libraries",) if re.fullmatch(r"librigor[0-9.]+", package) else OF_PACKAGES.get(package, ())


def files_below(root):
    return {str(p.relative_to(root)): p for p in sorted(root.rglob("*")) if p.is_symlink() or not p.is_dir()}


def names_source(content, root=ROOT):
    """A path of this tree that the bytes have; None where they have none."""
    folders = b"|".join(re.escape(p.name.encode()) for p in ROOT.iterdir() if p.is_dir() and not p.name.startswith("."))
    found = re.search(re.escape(str(root).encode()) + b"/(" + folders + b")[/\\w.-]*", content)
    return found.group(0).decode() if found else None


def check_files(parts):
    """Errors of {part: (components, {path below the prefix: file})}."""
    errors, owner = [], {}
    for part, (components, files) in parts.items():
        patterns = [p for name, places, _ in PLACES for p in places if name in components]
        for path, file in files.items():
            if path in owner:
                errors.append(f"{path}: in {owner[path]} and in {part}")
            owner[path] = part
            if not any(re.fullmatch(p, path) for p in patterns):
                errors.append(f"{path}: expected in none of {part}: tools/check_packages.py says what lies where")
            if not file.is_symlink() and (name := names_source(file.read_bytes())):
                errors.append(f"{path}: has a path of the source tree in it: {name}")
        for name, _, needed in PLACES:
            if name in components:
                errors += [f"{path}: expected in {part}, is not there" for path in needed if path not in files]
        if "libraries" in components:
            for library in ("hal", "world", "bench"):
                if not any(re.fullmatch(LIBRARY + rf"librigor_{library}\.so\.[0-9.]+", path) for path in files):
                    errors.append(f"librigor_{library}.so.VERSION: expected in {part}, is not there")
    return errors


def output(*words, **options):
    return subprocess.run(words, check=True, capture_output=True, text=True, **options).stdout


def check_build(build):
    """Errors of an installation, component by component."""
    script = (Path(build) / "cmake_install.cmake").read_text(encoding="utf-8")
    for more in Path(build).rglob("cmake_install.cmake"):
        script += more.read_text(encoding="utf-8")
    named = set(re.findall(r'CMAKE_INSTALL_COMPONENT STREQUAL "([^"]+)"', script)) - {"Unspecified"}
    errors = [f"component {name}: is in no package" for name in sorted(named - {place[0] for place in PLACES})]
    with tempfile.TemporaryDirectory(prefix="rigor-components-") as folder:
        parts = {}
        for component in sorted(named & {place[0] for place in PLACES}):
            output("cmake", "--install", str(build), "--prefix", f"{folder}/{component}", "--component", component)
            parts[component] = ((component,), files_below(Path(folder) / component))
        errors += check_files(parts)
        output("cmake", "--install", str(build), "--prefix", f"{folder}/whole")
        outside = set(files_below(Path(folder) / "whole")) - {path for _, files in parts.values() for path in files}
        errors += [f"{path}: in no component" for path in sorted(outside)]
        print(", ".join(f"{name}: {len(files)} files" for name, (_, files) in parts.items()))
    return errors


def check_program(path, file):
    """Errors of a program or shared library of a package."""
    dynamic, sections = output("readelf", "-d", str(file)), output("readelf", "-SW", str(file))
    if re.search(r"\((RPATH|RUNPATH)\)", dynamic):
        yield f"{path}: has a run path"
    if ".symtab" in sections:
        yield f"{path}: is not stripped"
    if "BIND_NOW" not in dynamic and "dist-packages" not in path:
        yield f"{path}: expected to bind functions when the program starts (BIND_NOW)"


def check_debs(debs):
    errors, parts, versions = [], {}, {}
    with tempfile.TemporaryDirectory(prefix="rigor-packages-") as folder:
        for deb in debs:
            name, version, depends, installed = output(
                "dpkg-deb", "-W", "--showformat=${Package}\n${Version}\n${Depends}\n${Installed-Size}\n", deb).split("\n")[:4]
            versions[name] = version
            if not components_of(name):
                errors.append(f"{deb}: a package that tools/check_packages.py does not know")
            root = Path(folder) / name
            output("dpkg-deb", "-x", deb, str(root))
            files = files_below(root)
            outside = [path for path in files if not path.startswith("usr/")]
            errors += [f"{name}: /{path}: expected below /usr" for path in outside]
            documents = {f"usr/share/doc/{name}/{document}" for document in DOCUMENTS}
            errors += [f"{name}: /{path}: is not there" for path in sorted(documents - set(files))]
            rest = {path[4:]: file for path, file in files.items() if path.startswith("usr/") and path not in documents
                    and not path.startswith("usr/share/lintian/")}
            parts[name] = (components_of(name), rest)
            for path, file in rest.items():
                if not file.is_symlink() and file.read_bytes()[:4] == b"\x7fELF":
                    errors += [f"{name}: {error}" for error in check_program(path, file)]
                if path.startswith("bin/") and f"share/man/man1/{Path(path).name}.1.gz" not in rest:
                    errors.append(f"{name}: /usr/{path}: has no manual page")
            for other in re.findall(r"(librigor[0-9.]+|rigor) \(= ([^)]+)\)", depends):
                if other[1] != version:
                    errors.append(f"{name}: depends on {other[0]} {other[1]}, expected {version}")
            print(f"{name:15} {version}  {Path(deb).stat().st_size / 1e6:6.2f} MB, installed {int(installed) / 1e3:6.1f} MB, "
                  f"{len(rest)} files")
        errors += check_files(parts)
    if len(set(versions.values())) != 1:
        errors.append(f"expected packages of one version, got {versions}")
    return errors


def self_test():
    needed = {name: list(paths) for name, _, paths in PLACES}
    needed["libraries"] = [f"lib/x/librigor_{name}.so.0.1" for name in ("hal", "world", "bench")]
    trials = [  # what is planted; changes as (component, path, content; None: gone); what must be said
        ("nothing", [], None),
        ("a file of two", [("sdk", "bin/rigor", b"")], r"bin/rigor: in command and in sdk"),
        ("a file that belongs nowhere", [("command", "share/applications/rigor.desktop", b"")], r"expected in none of command"),
        ("a header with the command", [("command", "include/rigor/x.h", b"")], r"include/rigor/x\.h: expected in none"),
        ("a path of this tree", [("sdk", "lib/x/cmake/Rigor/R.cmake", f"set(X {ROOT}/cmake/x)".encode())], r"R\.cmake: has a path"),
        ("a path that only begins so", [("sdk", "lib/x/cmake/Rigor/R.cmake", f"{ROOT}-dev/x".encode())], None),
        ("no demo", [("command", "share/rigor/configs/demo.yaml", None)], r"demo\.yaml: expected in command"),
        ("a library short", [("libraries", needed["libraries"][0], None)], r"librigor_hal\.so\.VERSION: expected"),
    ]
    wrong = 0
    for what, changes, said in trials:
        with tempfile.TemporaryDirectory() as folder:
            for component, paths in needed.items():
                for path, content in [(p, b"") for p in paths] + [c[1:] for c in changes if c[0] == component]:
                    file = Path(folder) / component / path
                    file.parent.mkdir(parents=True, exist_ok=True)
                    if content is None:
                        file.unlink()
                    else:
                        file.write_bytes(content)
            errors = check_files({name: ((name,), files_below(Path(folder) / name)) for name in needed})
        if not (any(re.search(said, e) for e in errors) if said else not errors):
            wrong += 1
            print(f"self-test: {what}: expected {said or 'nothing'}, got {errors}")
    print(f"self-test: {len(trials)} trials, {wrong} wrong")
    return 1 if wrong else 0


def main():
    words = sys.argv[1:]
    if words == ["--self-test"]:
        return self_test()
    if not words or words[0].startswith("-") and (words[0] != "--build" or len(words) != 2):
        sys.exit("usage: check_packages.py --build BUILD_DIR | DEB... | --self-test")
    errors = check_build(words[1]) if words[0] == "--build" else check_debs(words)
    for error in errors:
        print(f"check_packages: {error}")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
