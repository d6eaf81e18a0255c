"""Test cases of one GoogleTest binary in one process, for tools/run_tests.py.

ctest knows each case as a test of its own and would start the binary once for each: three thousand starts of programs
that load up to 185 shared libraries, and as many graphics devices and browsers, which the cases of one process share.
So a run has a ctest project of its own, in which the cases of a binary that ctest treats alike (same timeout, labels,
locks) are one test, at most MOST_CASES of them. Those that do not judge the wall clock run at a lower priority. What such
a process prints is taken apart again: the results are those of the cases, by the names that ctest has for them.
"""
import json
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

MOST_CASES = 40
# Of binaries whose timeout says that their cases are long.
MOST_LONG_CASES, LONG_S = 12, 120
# What a case may add to the timeout of its batch.
MORE_FOR_A_CASE_S = 10
FILTER = "--gtest_filter="
BEGIN = re.compile(r"\[ RUN      \] (\S+)\n")
# Properties that say where a test was defined, and nothing of how it runs.
APART = {"WORKING_DIRECTORY", "_BACKTRACE_TRIPLES", "DEF_SOURCE_LINE"}


@dataclass
class Batch:
    name: str
    cases: list  # tests as ctest lists them
    output: Path


def listing(build, options):
    """The tests of a build folder, as ctest lists them."""
    said = subprocess.run(["ctest", "--test-dir", str(build), "--show-only=json-v1", *options], capture_output=True,
                          text=True, check=False)
    if said.returncode != 0:
        return []
    return [test for test in json.loads(said.stdout)["tests"] if test.get("command")]


def properties(test):
    return {p["name"]: p["value"] for p in test.get("properties", [])}


def filter_of(test):
    """The case in GoogleTest's own words; None: the test is no such case."""
    words = [w for w in test["command"] if w.startswith(FILTER)]
    return words[0][len(FILTER):] if len(words) == 1 and not re.search(r"[*?:]|^-", words[0][len(FILTER):]) else None


def pieces(cases, most):
    """Consecutive cases, at most so many in each piece; a suite is divided only where it is larger than that."""
    suites = []
    for case in cases:
        suite = filter_of(case).rsplit(".", 1)[0]
        if not suites or suites[-1][0] != suite:
            suites.append((suite, []))
        suites[-1][1].append(case)
    piece = []
    for _, suite in suites:
        if piece and len(piece) + len(suite) > most:
            yield piece
            piece = []
        while len(piece) + len(suite) > most:
            yield suite[:most]
            suite = suite[most:]
        piece = piece + suite
    if piece:
        yield piece


def batches_of(tests, folder):
    """(batches, tests that stay alone)."""
    groups, alone = {}, []
    for test in tests:
        have = properties(test)
        if filter_of(test) is None or have.get("RUN_SERIAL") or have.get("DISABLED"):
            alone.append(test)
            continue
        alike = {k: v for k, v in have.items() if k not in APART}
        groups.setdefault((test["command"][0], json.dumps(alike, sort_keys=True)), []).append(test)
    batches, used = [], {}
    for (binary, _), cases in groups.items():
        long = properties(cases[0]).get("TIMEOUT", 0) > LONG_S
        for piece in pieces(cases, MOST_LONG_CASES if long else MOST_CASES):
            if len(piece) == 1:
                alone += piece
                continue
            stem = Path(binary).name
            used[stem] = used.get(stem, 0) + 1
            name = f"{stem} {used[stem]}"
            batches.append(Batch(name, piece, folder / f"{name.replace(' ', '-')}.txt"))
    return batches, alone


def quoted(word):
    equals = "="
    while f"]{equals}]" in word or word.endswith(f"]{equals}"):
        equals += "="
    return f"[{equals}[{word}]{equals}]"


def entry(name, command, have):
    """What CTestTestfile.cmake says of a test."""
    lines = [f"add_test({quoted(name)} {' '.join(quoted(word) for word in command)})"]
    for key, value in have.items():
        if key.startswith("_") or value is None:
            continue
        text = ";".join(map(str, value)) if isinstance(value, list) else {True: "TRUE", False: "FALSE"}.get(
            value, str(value)) if isinstance(value, bool) else str(value)
        lines.append(f"set_tests_properties({quoted(name)} PROPERTIES {key} {quoted(text)})")
    return "\n".join(lines) + "\n"


def yielding(test):
    """What has a test leave the processors to those whose verdict depends on how promptly they run."""
    have = properties(test)
    labels = have.get("LABELS", [])
    return [] if have.get("RUN_SERIAL") or "wall-clock" in labels or "kernel" in labels else ["nice", "-n", "10"]


def write_project(tests, folder):
    """Writes the ctest project of a run into `folder`, which is made; its batches."""
    folder.mkdir(parents=True, exist_ok=True)
    batches, alone = batches_of(tests, folder.resolve())
    text = "".join(entry(test["name"], yielding(test) + test["command"], properties(test)) for test in alone)
    for batch in batches:
        have, first = properties(batch.cases[0]), batch.cases[0]["command"]
        # Whether a case was skipped is said by its own lines, and not by those of its batch.
        have.pop("SKIP_REGULAR_EXPRESSION", None)
        if "TIMEOUT" in have:
            have["TIMEOUT"] += MORE_FOR_A_CASE_S * (len(batch.cases) - 1)
        have["COST"] = have.get("COST", 0) + len(batch.cases)
        words = [w for w in first[1:] if not w.startswith(FILTER)]
        cases = FILTER + ":".join(filter_of(case) for case in batch.cases)
        text += entry(batch.name, [*yielding(batch.cases[0]), "sh", "-c", 'out=$0; exec "$@" >"$out" 2>&1', str(batch.output),
                                   first[0], cases, *words], have)
    (folder / "CTestTestfile.cmake").write_text(text, encoding="utf-8")
    return batches


def sections(output):
    """Name: (state or None where the case did not end, seconds, text) of each case that a process began."""
    found = {}
    begins = list(BEGIN.finditer(output))
    for begin, after in zip(begins, begins[1:] + [None]):
        name, text = begin.group(1), output[begin.start():after.start() if after else len(output)]
        ends = list(re.finditer(r"\[(       OK |  FAILED  |  SKIPPED )\] " + re.escape(name) + r"\b[^\n]*?(?:\((\d+) ms\))?\n",
                                text))
        if not ends:
            found[name] = (None, 0, text)
            continue
        state = {"OK": "passed", "FAILED": "failed", "SKIPPED": "skipped"}[ends[0].group(1).strip()]
        found[name] = (state, int(ends[0].group(2) or 0) / 1000, text[:ends[0].end()])
    return found


def result(name, state, seconds, text):
    """A test case of JUnit, as ctest writes one."""
    case = ElementTree.Element("testcase", name=name, classname=name, time=f"{seconds:.3f}",
                               status={"passed": "run", "failed": "fail", "skipped": "notrun"}[state])
    if state == "failed":
        ElementTree.SubElement(case, "failure", message="")
    elif state == "skipped":
        ElementTree.SubElement(case, "skipped", message="")
    # What XML cannot hold.
    ElementTree.SubElement(case, "system-out").text = re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd]", "?", text)
    return case


def results_of(batch, ended_well, why):
    """The results of its cases. `ended_well`: the process had exit status 0; `why`: what ctest says where it had not."""
    output = batch.output.read_text(encoding="utf-8", errors="replace") if batch.output.is_file() else ""
    found, results, stopped_in = sections(output), [], None
    for test in batch.cases:
        state, seconds, text = found.get(filter_of(test), ("not begun", 0, ""))
        if state is None:
            state, stopped_in = "failed", test["name"]
            text += f"\nThe process ended here: {why}\n"
        elif state == "not begun":
            state = "failed"
            text = f"Not run: the process of {batch.name} had ended in {stopped_in or 'nothing'}: {why}\n{output[-2000:]}"
        results.append(result(test["name"], state, seconds, text))
    if not ended_well and not any(r.get("status") == "fail" for r in results):
        last = batch.cases[-1]["name"]
        results[-1] = result(last, "failed", 0, f"All cases passed, and then the process failed: {why}\n{output[-4000:]}")
    return results


def take_apart(junit, batches):
    """Puts the results of the cases in place of those of their batches."""
    tree = ElementTree.parse(junit)
    suite, of_name = tree.getroot(), {batch.name: batch for batch in batches}
    for case in list(suite.iter("testcase")):
        batch = of_name.get(case.get("name"))
        if not batch:
            continue
        failure = case.find("failure")
        why = (failure.get("message") if failure is not None else "") or case.get("status")
        place = list(suite).index(case)
        suite.remove(case)
        for offset, one in enumerate(results_of(batch, case.get("status") == "run", why)):
            suite.insert(place + offset, one)
    cases = list(suite.iter("testcase"))
    suite.set("tests", str(len(cases)))
    suite.set("failures", str(sum(c.get("status") == "fail" for c in cases)))
    suite.set("skipped", str(sum(c.find("skipped") is not None for c in cases)))
    tree.write(junit, encoding="UTF-8", xml_declaration=True)
