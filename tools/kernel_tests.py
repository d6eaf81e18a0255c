#!/usr/bin/env python3
"""Writes the CTestTestfile.cmake of the kernel lane: the tests labelled `kernel` of a build, with their time limits.

    kernel_tests.py BUILD_DIR FOLDER

The tests then run by `ctest --test-dir FOLDER` wherever BUILD_DIR can be read, for example in a guest that cannot write
to it. Prints how many there are.
"""
import json
import subprocess
import sys
from pathlib import Path


def quoted(text):
    """A bracket argument of CMake: nothing in it is special."""
    assert "]==]" not in text
    return f"[==[{text}]==]"


def main():
    build, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    listing = subprocess.run(
        ["ctest", "--test-dir", str(build), "--show-only=json-v1", "--label-regex", "^kernel$"],
        capture_output=True, text=True, check=True)
    lines = []
    for test in json.loads(listing.stdout)["tests"]:
        command = test.get("command")
        if not command:
            sys.exit(f"{test['name']}: its binary is not built")
        properties = {p["name"]: p["value"] for p in test["properties"]}
        lines.append(f"add_test({quoted(test['name'])} {' '.join(map(quoted, command))})")
        lines.append(f"set_tests_properties({quoted(test['name'])} PROPERTIES"
                     f" TIMEOUT {properties.get('TIMEOUT', 120):g}"
                     f" WORKING_DIRECTORY {quoted(properties.get('WORKING_DIRECTORY', str(build)))}"
                     ' SKIP_REGULAR_EXPRESSION "\\\\[  SKIPPED \\\\]")')
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "CTestTestfile.cmake").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(len(lines) // 2)


if __name__ == "__main__":
    main()
