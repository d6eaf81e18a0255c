"""Reads scans of a SICK scanner with struct alone, from the manual's tables (CoLa-B): the other side of our tests."""
import socket
import struct
import sys


def telegram(body):
    checksum = 0
    for byte in body:
        checksum ^= byte
    return b"\x02\x02\x02\x02" + struct.pack(">I", len(body)) + body + bytes([checksum])


class Scanner:
    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=20)

    def exactly(self, size):
        data = b""
        while len(data) < size:
            piece = self.socket.recv(size - len(data))
            assert piece, "the scanner closed the connection"
            data += piece
        return data

    def receive(self):
        start, size = struct.unpack(">4sI", self.exactly(8))
        assert start == b"\x02\x02\x02\x02"
        body = self.exactly(size)
        assert telegram(body)[-1:] == self.exactly(1), "checksum"
        return body

    def ask(self, body):
        self.socket.sendall(telegram(body))
        while True:
            answer = self.receive()
            if not answer.startswith(b"sSN"):
                return answer


def channels(body, at, width):
    (count,) = struct.unpack_from(">H", body, at)
    at += 2
    found = {}
    for _ in range(count):
        name, scale, offset, start, step, values = struct.unpack_from(">5sffiHH", body, at)
        at += 21
        data = struct.unpack_from(">%d%s" % (values, "H" if width == 2 else "B"), body, at)
        at += values * width
        found[name.decode()] = (scale, offset, start, step, data)
    return found, at


scanner = Scanner(int(sys.argv[1]))
assert scanner.ask(b"sMN SetAccessMode " + struct.pack(">BI", 3, 0xF4724744)) == b"sAN SetAccessMode \x01"
data_config = bytes([1, 0, 1, 0, 0, 0, 0, 0, 1, 0, 1]) + struct.pack(">H", 1)
assert scanner.ask(b"sWN LMDscandatacfg " + data_config) == b"sWA LMDscandatacfg "
assert scanner.ask(b"sMN LMCstartmeas") == b"sAN LMCstartmeas \x00"
assert scanner.ask(b"sMN Run") == b"sAN Run \x01"
assert scanner.ask(b"sEN LMDscandata \x01") == b"sEA LMDscandata \x01"

scans, lost, before, beams = 0, 0, None, 0
while scans < 10:
    body = scanner.receive()
    assert body.startswith(b"sSN LMDscandata ")
    version, device, serial, _, status, telegrams, counter, started, sent = struct.unpack_from(">HHIBBHHII", body, 16)
    assert status == 0
    frequency, measured, encoders = struct.unpack_from(">IIH", body, 16 + 22 + 6)
    assert (frequency, measured, encoders) == (5000, 360, 0), (frequency, measured, encoders)
    wide, at = channels(body, 16 + 22 + 6 + 10, 2)
    narrow, at = channels(body, at, 1)
    position, name = struct.unpack_from(">HH", body, at)
    assert (position, name) == (0, 1)
    length = body[at + 4]
    assert body[at + 5 : at + 5 + length] == b"not defined"
    at += 5 + length
    comment, time, year, month, day, hour, minute, second, micro = struct.unpack_from(">HHHBBBBBI", body, at)
    at += 15
    assert (comment, time) == (0, 1) and year == 1970 and micro < 1000000
    (event,) = struct.unpack_from(">H", body, at)
    assert event == 0 and at + 2 == len(body), "bytes are left"
    assert 0 < (sent - started) % 2**32 < 500000  # microseconds: a turn takes 20 ms, a busy machine more
    scale, offset, start, step, ranges = wide["DIST1"]
    assert (scale, offset, start, step) == (1.0, 0.0, -450000, 5000)
    beams = len(ranges)
    for b, raw in enumerate(ranges):
        assert abs(raw - (2000 + 10 * b)) <= 1, (b, raw)
    assert list(narrow["RSSI1"][4]) == [b % 256 for b in range(beams)]
    if before is not None:
        lost += (counter - before - 1) % 65536
    before = counter
    scans += 1
print("%d scans, %d beams, %d lost" % (scans, beams, lost))
