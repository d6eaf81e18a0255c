#!/usr/bin/env python3
"""Lists the tests that were skipped, with their reasons, and refuses those that tests/skipped.txt does not allow.

Reads what `ctest --output-junit` writes. A test that is skipped for want of test data (its reason says "test data")
is allowed everywhere; any other needs a line in tests/skipped.txt:

    Suite.Name*  |  words that its reason contains

With `--count FILE` it prints `passed failed skipped` of one result file and nothing else; with `--notes FILE` the
lines in which tests say what was sent, received, lost, or how long a device was away.
"""
import argparse
import fnmatch
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ALLOWANCE = Path(__file__).resolve().parent.parent / "tests" / "skipped.txt"
# GTEST_SKIP() prints "FILE:LINE: Skipped", then the reason, up to the line that closes the test.
REASON = re.compile(r":\d+: Skipped\n(.*?)(?:\n\s*\n|\n\[|\Z)", re.DOTALL)

NOTE = re.compile(r"^(?!\[|Note:)(?=.*\d)(.*\b(?:sent|received|delivered|lost|back after|came)\b.*)$", re.MULTILINE)


def cases(file):
    """(name, "passed" | "failed" | "skipped", output) of each test of one result file."""
    for case in ElementTree.parse(file).getroot().iter("testcase"):
        status = case.get("status")
        output = case.findtext("system-out") or ""
        if case.find("failure") is not None or status == "fail":
            yield case.get("name"), "failed", output
        elif status == "run":
            yield case.get("name"), "passed", output
        elif case.find("skipped") is not None and "[  SKIPPED ]" in output:
            yield case.get("name"), "skipped", output
        elif status == "disabled":
            yield case.get("name"), "skipped", ":0: Skipped\ndisabled"
        else:  # ctest's "notrun" without our doing: a missing binary, for example
            yield case.get("name"), "failed", output


def allowances():
    rules = []
    if ALLOWANCE.is_file():
        for number, line in enumerate(ALLOWANCE.read_text(encoding="utf-8").splitlines(), 1):
            line = line.split("#")[0].strip()
            if not line:
                continue
            pattern, bar, words = (part.strip() for part in line.partition("|"))
            if not (pattern and bar and words):
                sys.exit(f"{ALLOWANCE}:{number}: expected 'Suite.Name | words of the reason', got '{line}'")
            rules.append((pattern, words))
    return rules


def reason_of(output):
    match = REASON.search(output)
    text = " ".join(match.group(1).split()) if match else ""
    return text or "no reason given"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", action="store_true", help="print 'passed failed skipped' and nothing else")
    parser.add_argument("--notes", action="store_true", help="print what tests counted and nothing else")
    parser.add_argument("results", nargs="+", help="files that ctest --output-junit wrote")
    arguments = parser.parse_args()
    if arguments.count:
        found = [state for file in arguments.results for _, state, _ in cases(file)]
        print(*(found.count(state) for state in ("passed", "failed", "skipped")))
        return 0

    if arguments.notes:
        for file in arguments.results:
            for name, _, output in cases(file):
                for note in NOTE.findall(output):
                    print(f"{name}: {note}")
        return 0

    rules, refused = allowances(), 0
    for file in arguments.results:
        for name, state, output in cases(file):
            if state != "skipped":
                continue
            reason = reason_of(output)
            allowed = "test data" in reason or any(
                fnmatch.fnmatchcase(name, pattern) and words in reason for pattern, words in rules)
            refused += not allowed
            print(f"{Path(file).stem}: {'skipped' if allowed else 'NOT ALLOWED'}: {name}: {reason}")
    if refused:
        print(f"{refused} tests were skipped that tests/skipped.txt does not allow: mend them, or add them there")
    else:
        print("skipped tests: none that is not allowed")
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
