#!/usr/bin/env python3
"""Runs the tests of a build folder by ctest, once; a failed test fails. Cases of one binary share a process
(tools/test_batches.py).

    run_tests.py BUILD_DIR RESULTS LANE [CTEST-OPTION...]

Tests talk to the wall clock, to sockets and to child processes, and a host may hold a virtual machine up for seconds.
So those that are labelled `wall-clock` or `kernel`, because they judge how fast this machine or what its kernel does,
are run again where they fail, alone, at most twice. No other test is, and where more than MOST_AGAIN such tests failed, the
run fails whatever they do afterwards.

Writes RESULTS/LANE.xml (JUnit: each test once, as it ended), LANE.log (all that ctest said), LANE.batches (what each
process printed), LANE.again (the tests that were run again, one a line, and how that ended) and LANE.failed (the tests that
failed in the end, one a line, and by what). Exit status 1 where the run fails.

    run_tests.py --self-test
"""
import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import test_batches
from check_skips import cases

LABELS = {"wall-clock", "kernel"}
MORE_ATTEMPTS = 2
MOST_AGAIN = 3
# What ctest says of a test that starts or passes: in the log, not on the terminal.
QUIET = re.compile(r"^ +(Start +[0-9]+|Test +#[0-9]+): |^ *[0-9]+/[0-9]+ .* Passed ")


def ctest(build, junit, log, options):
    """Runs ctest; its exit status."""
    junit.unlink(missing_ok=True)
    command = ["ctest", "--test-dir", str(build), "--output-on-failure", "--no-tests=error", "--output-junit",
               str(junit.resolve()), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace") as run:
        for line in run.stdout:
            log.write(line)
            if not QUIET.match(line):
                print(line, end="", flush=True)
    return run.returncode


def failed_in(junit):
    return [name for name, state, _ in cases(junit) if state == "failed"] if junit.is_file() else []


def may_run_again(tests):
    """Names of the tests with one of LABELS."""
    return {test["name"] for test in tests if LABELS & set(test_batches.properties(test).get("LABELS", []))}


def exactly(name):
    """As an expression of ctest -R."""
    return "^" + re.sub(r"([][.*+?()^$|\\])", r"\\\1", name) + "$"


def replace_result(junit, name, other):
    """Puts the test's result of `other` in place of that in `junit`, and mends the sums of the suite."""
    tree = ElementTree.parse(junit)
    suite = tree.getroot()
    newer = next(c for c in ElementTree.parse(other).getroot().iter("testcase") if c.get("name") == name)
    for i, case in enumerate(list(suite)):
        if case.tag == "testcase" and case.get("name") == name:
            suite[i] = newer
    suite.set("failures", str(sum(c.get("status") == "fail" for c in suite.iter("testcase"))))
    tree.write(junit, encoding="UTF-8", xml_declaration=True)


def again(build, junit, log, name):
    """Runs one test alone until it passes, at most MORE_ATTEMPTS times; how that ended."""
    other = junit.with_suffix(".again.tmp")
    try:
        for attempt in range(2, MORE_ATTEMPTS + 2):
            print(f"again, alone: {name} (attempt {attempt})", flush=True)
            status = ctest(build, other, log, ["-R", exactly(name)])
            if [case[0] for case in cases(other)] != [name]:
                raise RuntimeError(f"ctest -R '{exactly(name)}' did not run this test alone")
            replace_result(junit, name, other)
            if status == 0:
                return f"passed at attempt {attempt}"
        return f"failed {MORE_ATTEMPTS + 1} times"
    finally:
        other.unlink(missing_ok=True)


def tell_failures(junit, batches):
    """Prints what the failed cases of batches said, as ctest does of a test."""
    in_batches = {test["name"] for batch in batches for test in batch.cases}
    for name, state, output in cases(junit):
        if state == "failed" and name in in_batches:
            print(f"    Test: {name} ...***Failed\n{output}", flush=True)


# What says in one line why a test failed: GoogleTest's place, a sanitizer's or Python's error, or how its process ended.
# The first of these that is found counts.
REASONS = [re.compile(pattern, re.MULTILINE) for pattern in (
    r"^Not run: .*$", r"^\S+:\d+: Failure\n.*(?:\n(?!\[|$).*){0,4}",
    r"^.*(?:ERROR: |runtime error: |WARNING: ThreadSanitizer).*$", r"^[\w.]*(?:Error|Exception)(?:: .*)?$",
    r"^(?:The process ended here: |All cases passed, and then ).*$")]


def reason_of(output):
    found = next((match for pattern in REASONS if (match := pattern.search(output))), None)
    return " ".join((found.group() if found else output.strip().rpartition("\n")[2] or "it said nothing").split())[:300]


def run(build, results, lane, options):
    junit, account = results / f"{lane}.xml", []
    folder = results / f"{lane}.batches"
    shutil.rmtree(folder, ignore_errors=True)
    tests = test_batches.listing(build, options)
    batches = test_batches.write_project(tests, folder)
    with open(results / f"{lane}.log", "w", encoding="utf-8") as log:
        status = ctest(folder, junit, log, ["--parallel", str(os.cpu_count() + 1)])
        if junit.is_file():
            test_batches.take_apart(junit, batches)
            tell_failures(junit, batches)
        failed = failed_in(junit)
        if status != 0 and not failed:
            print(f"ctest ended with status {status}, and no test failed", flush=True)
            (results / f"{lane}.failed").write_text(f"ctest: ended with status {status}, and no test failed\n", encoding="utf-8")
            return 1
        labelled = may_run_again(tests)
        candidates = [name for name in failed if name in labelled]
        too_many = len(candidates) > MOST_AGAIN
        for name in candidates:
            account.append(f"{name}: " + ("not run again" if too_many else again(build, junit, log, name)))
    (results / f"{lane}.again").write_text("".join(line + "\n" for line in account), encoding="utf-8")
    ended_badly = [(name, reason_of(output)) for name, state, output in cases(junit) if state == "failed"] if junit.is_file() else []
    (results / f"{lane}.failed").write_text("".join(f"{name}: {why}\n" for name, why in ended_badly), encoding="utf-8")
    at_once = [name for name in failed if name not in labelled]
    if at_once:
        print(f"failed, and not run again, for they judge neither the wall clock nor a kernel: {len(at_once)}")
        print("".join(f"  {name}\n" for name in at_once), end="")
    if account:
        print(f"run again, for they judge the wall clock or a kernel: {0 if too_many else len(account)}")
        print("".join(f"  {line}\n" for line in account), end="")
    if too_many:
        print(f"{len(candidates)} of those failed: more than {MOST_AGAIN} is no accident, and fails the lane")
    return 1 if too_many or failed_in(junit) else 0


# ------------------------------------------------------------------ self-test

# Speaks as a GoogleTest binary: the cases of its filter, and what each does is told by the end of its name.
BINARY = """#!/bin/sh
status=0
n=$(cat "$0.processes" 2>/dev/null || echo 0)
echo $((n + 1)) >"$0.processes"
for case in $(echo "${1#--gtest_filter=}" | tr : ' '); do
  n=$(cat "$0.$case" 2>/dev/null || echo 0)
  echo $((n + 1)) >"$0.$case"
  echo "[ RUN      ] $case"
  how='       OK '
  case $case in
    *.Fails) how='  FAILED  ' status=1 ;;
    *.FailsOnce) [ $n -ge 1 ] || how='  FAILED  ' status=1 ;;
    *.Skips) printf 'a.cpp:1: Skipped\\nno device here\\n\\n'; how='  SKIPPED ' ;;
    *.Dies) exit 3 ;;
  esac
  echo "[$how] $case (7 ms)"
  case $case in *.Leaks) status=9 ;; esac
done
exit $status
"""


def planted(folder, tests):
    """A ctest project: (name, label, how many times a shell command fails before it passes), or None for that: a case of
    a GoogleTest binary."""
    lines = []
    binary = folder / "binary"
    binary.write_text(BINARY, encoding="utf-8")
    binary.chmod(0o755)
    counts = {"processes": folder / "binary.processes"}
    for name, label, failures in tests:
        count = counts[name] = folder / (f"binary.{name}" if failures is None else f"{abs(hash(name))}.count")
        if failures is None:
            lines.append(f"add_test([==[{name}]==] {binary} [==[--gtest_filter={name}]==] --gtest_also_run_disabled_tests)")
            lines.append(f"set_tests_properties([==[{name}]==] PROPERTIES TIMEOUT 60 LABELS [==[{label}]==])")
            continue
        script = f"n=$(cat '{count}' 2>/dev/null || echo 0); echo $((n + 1)) >'{count}'; [ $n -ge {failures} ]"
        lines.append(f"add_test([==[{name}]==] sh -c [==[{script}]==])")
        if label:
            lines.append(f"set_tests_properties([==[{name}]==] PROPERTIES LABELS {label})")
    (folder / "CTestTestfile.cmake").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return counts


# Names of cases with parameters go on as gtest prints these.
PARAMETER = "A/Wall.Clock/a+b  # GetParam() = 4-byte object <01-00 [x]>"


def self_test():
    never = 99
    passes = ("Always.Passes", "", 0)
    trials = [  # what is planted; exit status; test: attempts; failed in the end; lines of the account
        ("all pass", [passes], 0, {"Always.Passes": 1}, [], []),
        ("labelled, fails once", [passes, (PARAMETER, "wall-clock", 1), ("A/Wall.Clock/a+bc", "wall-clock", 0)],
         0, {"Always.Passes": 1, PARAMETER: 2, "A/Wall.Clock/a+bc": 1}, [],
         [PARAMETER + ": passed at attempt 2"]),
        ("labelled, fails twice", [passes, ("Kernel.Device", "kernel", 2)], 0, {"Kernel.Device": 3}, [],
         ["Kernel.Device: passed at attempt 3"]),
        ("labelled, never passes", [passes, ("Wall.Never", "wall-clock", never)], 1, {"Wall.Never": 3}, ["Wall.Never"],
         ["Wall.Never: failed 3 times"]),
        ("unlabelled, fails once", [passes, ("Race.Once", "", 1)], 1, {"Race.Once": 1}, ["Race.Once"], []),
        ("another label, fails once", [passes, ("Race.Once", "one-thread", 1)], 1, {"Race.Once": 1}, ["Race.Once"], []),
        ("both kinds", [("Race.Once", "", 1), ("Wall.Once", "wall-clock", 1)], 1, {"Race.Once": 1, "Wall.Once": 2},
         ["Race.Once"], ["Wall.Once: passed at attempt 2"]),
        ("as many labelled as are run again", [passes] + [(f"Wall.{i:02}", "wall-clock", 1) for i in range(MOST_AGAIN)], 0, {"Wall.02": 2}, [],
         [f"Wall.{i:02}: passed at attempt 2" for i in range(MOST_AGAIN)]),
        ("one labelled more", [passes] + [(f"Wall.{i:02}", "wall-clock", 1) for i in range(MOST_AGAIN + 1)], 1, {"Wall.03": 1},
         [f"Wall.{i:02}" for i in range(MOST_AGAIN + 1)], [f"Wall.{i:02}: not run again" for i in range(MOST_AGAIN + 1)]),
        ("no test", [], 1, {}, [], []),
        ("cases share a process", [("S.A", "", None), ("S.B", "", None), ("S.Skips", "", None), passes], 0,
         {"S.A": 1, "S.B": 1, "S.Skips": 1, "processes": 1}, [], []),
        ("a case fails", [("S.A", "", None), ("S.Fails", "", None), ("S.B", "", None)], 1, {"S.Fails": 1, "S.B": 1},
         ["S.Fails"], []),
        ("a labelled case fails once", [("S.A", "wall-clock", None), ("S.FailsOnce", "wall-clock", None), passes], 0,
         {"S.A": 1, "S.FailsOnce": 2, "processes": 2}, [], ["S.FailsOnce: passed at attempt 2"]),
        ("a case ends the process", [("S.A", "", None), ("S.Dies", "", None), ("S.B", "", None)], 1, {"S.A": 1, "S.Dies": 1},
         ["S.B", "S.Dies"], []),
        ("the process fails after its cases", [("S.A", "", None), ("S.Leaks", "", None)], 1, {"S.A": 1}, ["S.Leaks"], []),
        ("other labels, other processes", [("S.A", "wall-clock", None), ("S.Dies", "one-thread", None)], 1,
         {"S.A": 1}, ["S.Dies"], []),
        ("a suite that is larger than a batch", [(f"S.N{i}", "", None) for i in range(test_batches.MOST_CASES + 5)], 0,
         {"S.N0": 1, "S.N44": 1}, [], []),
    ]
    wrong = 0
    for what, tests, status, attempts, failed, account in trials:
        with tempfile.TemporaryDirectory() as folder:
            build, results = Path(folder) / "build", Path(folder) / "results"
            build.mkdir()
            results.mkdir()
            counts = planted(build, tests)
            said = subprocess.run([sys.executable, __file__, str(build), str(results), "lane"], capture_output=True,
                                  text=True, check=False)
            file, accounts = results / "lane.xml", results / "lane.again"
            found = {
                "status": said.returncode,
                "attempts": {name: int(counts[name].read_text()) for name in attempts},
                "results": len(list(cases(file))) if tests else 0,
                "failed": sorted(failed_in(file)),
                "skipped": [case[0] for case in cases(file) if case[1] == "skipped"] if tests else [],
                "account": sorted(accounts.read_text().splitlines()) if accounts.is_file() else [],
            }
            expected = {"status": status, "attempts": attempts, "results": len(tests), "failed": failed,
                        "skipped": [test[0] for test in tests if test[0].endswith(".Skips")], "account": sorted(account)}
            for key, value in expected.items():
                if found[key] != value:
                    wrong += 1
                    print(f"self-test: {what}: {key}: expected {value}, found {found[key]}\n{said.stdout}{said.stderr}")
            file = results / "lane.failed"
            told = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
            if sorted(line.split(": ")[0] for line in told) != (failed if tests else ["ctest"]):
                wrong += 1
                print(f"self-test: {what}: lane.failed: expected {failed}, found {told}")
            for name in [line.split(":")[0] for line in account] + failed:
                if f"  {name}" not in said.stdout:
                    wrong += 1
                    print(f"self-test: {what}: the last lines do not name {name}\n{said.stdout}")
    for output, why in [("[ RUN      ] S.A\n/a/b.cpp:7: Failure\nExpected: 1\n  Actual: 2\n[  FAILED  ] S.A (1 ms)\n",
                         "/a/b.cpp:7: Failure Expected: 1 Actual: 2"),
                        ("==7==ERROR: AddressSanitizer: heap-use-after-free on 0x1\n    #0 f\n",
                         "==7==ERROR: AddressSanitizer: heap-use-after-free on 0x1"),
                        ("Traceback:\n  x\nValueError: no", "ValueError: no"), ("", "it said nothing")]:
        if reason_of(output) != why:
            wrong += 1
            print(f"self-test: reason: expected {why!r}, found {reason_of(output)!r}")
    print(f"self-test: {len(trials)} trials, {wrong} wrong")
    return 1 if wrong else 0


def main():
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
    if len(sys.argv) < 4:
        sys.exit("usage: run_tests.py BUILD_DIR RESULTS LANE [CTEST-OPTION...] | run_tests.py --self-test")
    return run(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4:])


if __name__ == "__main__":
    sys.exit(main())
