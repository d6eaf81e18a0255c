#!/usr/bin/env python3
"""A SCIP 2.0 client from the specification alone, for a terminal: scip_reader.py DEVICE SCANS.

Says what the scanner is, reads its clock, takes SCANS scans by MD and one by GD, checks every sum."""
import os
import select
import sys
import termios
import time
import tty


class Scanner:
    def __init__(self, path):
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.fd, termios.TCSANOW)
        self.pending = b""

    def send(self, line):
        os.write(self.fd, line.encode() + b"\n")

    def line(self):
        end = time.monotonic() + 10
        while b"\n" not in self.pending:
            ready, _, _ = select.select([self.fd], [], [], max(0, end - time.monotonic()))
            assert ready, "the scanner says nothing"
            self.pending += os.read(self.fd, 4096)
        line, self.pending = self.pending.split(b"\n", 1)
        return line.decode()

    def reply(self):
        lines = []
        while True:
            line = self.line()
            if not line:
                return lines
            lines.append(line)


def total(text):
    return chr((sum(text.encode()) & 0x3F) + 0x30)


def checked(line):
    assert total(line[:-1]) == line[-1], line
    return line[:-1]


def number(text):
    value = 0
    for c in text:
        value = value << 6 | (ord(c) - 0x30)
    return value


def fields(lines):
    for line in lines:
        text, mark = line.rsplit(";", 1)
        assert total(text) == mark, line
    return dict(line.rsplit(";", 1)[0].split(":", 1) for line in lines)


def ranges(lines):
    data = "".join(checked(line) for line in lines)
    assert len(data) % 3 == 0
    return [number(data[i:i + 3]) for i in range(0, len(data), 3)]


def main():
    scanner, wanted = Scanner(sys.argv[1]), int(sys.argv[2])
    scanner.send("QT")
    while True:
        if (r := scanner.reply()) and r[0] == "QT":
            break
    scanner.send("VV")
    print(fields(scanner.reply()[2:]))
    scanner.send("PP")
    p = {k: int(v) for k, v in fields(scanner.reply()[2:]).items() if k != "MODL"}
    scanner.send("TM0")
    assert scanner.reply()[1] == "00P"
    scanner.send("TM1")
    before = number(checked(scanner.reply()[2]))
    scanner.send("TM2")
    assert scanner.reply()[1] == "00P"
    steps = p["AMAX"] - p["AMIN"] + 1
    scanner.send("MD%04d%04d010%02d;read" % (p["AMIN"], p["AMAX"], wanted))
    assert scanner.reply()[1] == "00P"
    stamps = []
    for k in range(wanted):
        lines = scanner.reply()
        assert lines[0].endswith("%02d;read" % (wanted - 1 - k)), lines[0]
        assert lines[1] == "99b"
        stamps.append(number(checked(lines[2])))
        r = ranges(lines[3:])
        assert len(r) == steps, len(r)
        assert sum(p["DMIN"] <= mm <= p["DMAX"] for mm in r) > steps // 2, r
    assert all(b - a == 60000 // p["SCAN"] for a, b in zip(stamps, stamps[1:])), stamps
    assert stamps[0] >= before
    scanner.send("BM")
    assert scanner.reply()[1] == "00P"
    scanner.send("GD%04d%04d02" % (p["AMIN"], p["AMAX"]))
    lines = scanner.reply()
    assert lines[1] == "00P" and len(ranges(lines[3:])) == (steps + 1) // 2, lines[:3]
    scanner.send("QT")
    assert scanner.reply()[1] == "00P"
    print("%d scans of %d steps, stamps %s ms" % (wanted, steps, stamps))


main()
