#!/usr/bin/env python3
"""Checks that what the documents say can be typed and followed.

In fenced blocks marked `console`, each line `$ rigor COMMAND …` or `$ ./dev COMMAND …`, and in other fenced or indented blocks
each line that begins with `rigor`, must name a command that exists, with options that its --help knows; relative links and pictures must
lead to files. With --run, the commands are run as tools/docs_commands.py says: in a fresh folder for each document, after an
install into a prefix.
"""
import argparse
import re
import shlex
import subprocess
import sys
from pathlib import Path

import docs_commands

ROOT = Path(__file__).resolve().parent.parent
RIGOR = ROOT / "build" / "release" / "rigor"
LINK = re.compile(r"!?\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")


def help_text(command):
    done = subprocess.run([*command, "--help"], capture_output=True, text=True, timeout=60, cwd=ROOT, check=False)
    return done.stdout if done.returncode == 0 else None


def command_lines(text):
    """(line number, command line) of each command in fenced blocks; a line that ends in a backslash goes on."""
    fence, pending, start = None, "", 0
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            fence = line.strip()[3:] if fence is None else None
            pending = ""
            continue
        if fence is None:
            begins = line.startswith("    rigor ")
        else:
            begins = line.startswith("$ ") if fence == "console" else line.startswith("rigor ")
        if not (begins or pending):
            continue
        start = start if pending else number
        pending += line.strip().removeprefix("$ ") if not pending else " " + line.strip()
        if pending.endswith("\\"):
            pending = pending[:-1]
            continue
        yield start, pending
        pending = ""


def words_in(line):
    """The words of each program of a command line."""
    for part in re.split(r"\s(?:&&|\||;|&)(?:\s|$)", line):
        words = shlex.split(part, comments=True)
        if words:
            yield words


def check_command(words, known_help):
    """What is wrong with a command line, or None."""
    while words and (words[0] == "sudo" or re.match(r"^\w+=", words[0])):
        words = words[1:]
    program = words[0] if words else ""
    if program not in ("rigor", "build/release/rigor", "./dev"):
        return None
    if program == "./dev":
        usage = known_help(("./dev",)) or ""
        if len(words) > 1 and not re.search(rf"^  {re.escape(words[1])}\b", usage, re.MULTILINE):
            return f"./dev has no command '{words[1]}'"
        options = [w for w in words[2:] if w.startswith("--")] if words[1:2] != ["run"] else []
        missing = [o for o in options if o.split("=")[0] not in usage]
        return f"./dev help does not name {missing[0]}" if missing else None
    command = (str(RIGOR), words[1]) if len(words) > 1 and not words[1].startswith("-") else (str(RIGOR),)
    if len(words) > 2 and not words[2].startswith("-") and re.search(rf"^  {re.escape(words[2])}\s", known_help(command) or "", re.MULTILINE):
        command = (*command, words[2])  # rigor world import …
    usage = known_help(command)
    if usage is None:
        return f"'rigor {' '.join(words[1:2])} --help' does not exit with 0"
    for option in (w.split("=")[0] for w in words[1:] if re.match(r"^--?[a-z]", w)):
        if not re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", usage):
            return f"the help of 'rigor {' '.join(command[1:])}' does not name {option}"
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", action="store_true", help="run the commands, too")
    parser.add_argument("--only", default="", help="run those of documents whose name contains this")
    parser.add_argument("--again", type=Path, help="a file for the commands that were run again, a line each")
    options = parser.parse_args()
    cache = {}

    def known_help(command):
        if command not in cache:
            cache[command] = help_text(command)
        return cache[command]

    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    errors, commands, by_document = [], 0, {}
    for document in documents:
        name = document.relative_to(ROOT)
        text = document.read_text(encoding="utf-8")
        lines = list(command_lines(text))
        by_document[str(name)] = lines
        for number, line in lines:
            for words in words_in(line):
                commands += 1
                wrong = check_command(words, known_help)
                if wrong:
                    errors.append(f"{name}:{number}: {wrong}")
        for number, line in enumerate(text.splitlines(), 1):
            for target in LINK.findall(line):
                if "://" not in target and not (document.parent / target).exists():
                    errors.append(f"{name}:{number}: the link leads nowhere: {target}")
    if options.run:
        failed, again = docs_commands.run_all(ROOT, {d: c for d, c in by_document.items() if options.only in d},
                                              whole=not options.only)
        errors += failed
        if options.again:
            options.again.write_text("".join(line + "\n" for line in again), encoding="utf-8")
    print(*errors, sep="\n", end="\n" if errors else "")
    print(f"docs: {len(documents)} documents, {commands} command lines, {len(errors)} errors")
    if not commands:
        print("docs: no command line found: the check has lost its sight")
    return 1 if errors or not commands else 0


if __name__ == "__main__":
    sys.exit(main())
