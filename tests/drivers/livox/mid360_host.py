#!/usr/bin/env python3
"""A host of a Livox Mid-360 by its protocol document alone: struct, zlib and binascii, none of Rigor's code.

mid360_host.py ADDRESS COMMAND_PORT SEARCH_PORT PACKETS: searches, sets the device to each of its data types, takes PACKETS
packets of points of each and as long its readings, and prints as JSON what it saw. Anything that is not as the document says ends
it with a message and status 1.
"""
import binascii
import json
import math
import socket
import struct
import sys
import time
import zlib


def expect(holds, what):
    if not holds:
        sys.exit(f"mid360_host.py: expected {what}")


def command(sequence, identity, data=b""):
    head = struct.pack("<BBHIHBB6s", 0xAA, 0, 24 + len(data), sequence, identity, 0, 0, b"")
    return head + struct.pack("<HI", binascii.crc_hqx(head, 0xFFFF), zlib.crc32(data) if data else 0) + data


def answered(datagram, sequence, identity):
    expect(len(datagram) >= 24, "an answer of at least 24 bytes")
    sof, version, length, seq, cmd, kind, sender, _, crc16, crc32 = struct.unpack("<BBHIHBB6sHI", datagram[:24])
    data = datagram[24:]
    expect((sof, version, length) == (0xAA, 0, len(datagram)), "0xAA, version 0 and the answer's length")
    expect((seq, cmd, kind, sender) == (sequence, identity, 1, 1), f"an answer to {identity:#06x}")
    expect(crc16 == binascii.crc_hqx(datagram[:18], 0xFFFF), "the header's CRC-16")
    expect(crc32 == (zlib.crc32(data) if data else 0), "the data's CRC-32")
    return data


class Host:
    def __init__(self, address, port):
        self.sequence = 0
        self.to = (address, port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((address, 0))
        self.socket.settimeout(10)

    def ask(self, identity, data=b"", port=None):
        self.sequence += 1
        self.socket.sendto(command(self.sequence, identity, data), (self.to[0], port or self.to[1]))
        return answered(self.socket.recv(2000), self.sequence, identity)

    def set(self, *parameters):
        data = struct.pack("<HH", len(parameters), 0)
        for key, value in parameters:
            data += struct.pack("<HH", key, len(value)) + value
        answer = self.ask(0x0100, data)
        expect(answer == b"\0\0\0", f"parameters to be taken, got {answer.hex()}")


def packet_of(datagram):
    version, length, interval, dots, count, frame, kind, time_type, _, crc, stamp = struct.unpack("<BHHHHBBB12sIQ", datagram[:36])
    expect((version, length) == (0, len(datagram)), "version 0 and the packet's length")
    expect(crc == zlib.crc32(datagram[28:]), "the packet's CRC-32")
    return {"interval": interval, "dots": dots, "count": count, "type": kind, "time": time_type, "stamp": stamp, "data": datagram[36:]}


def ranges_of(packet):
    size = {1: 14, 2: 8, 3: 10}[packet["type"]]
    expect(len(packet["data"]) == size * packet["dots"], f"{packet['dots']} points of {size} bytes")
    for i in range(packet["dots"]):
        point = packet["data"][i * size:(i + 1) * size]
        if packet["type"] == 3:
            depth, theta, phi, _, _ = struct.unpack("<IHHBB", point)
            expect(theta <= 18000 and phi <= 36000, "angles within 180 and 360 degrees")
            yield depth / 1000, 90 - theta / 100
        else:
            x, y, z, _, _ = struct.unpack("<iiiBB" if packet["type"] == 1 else "<hhhBB", point)
            unit = 1000 if packet["type"] == 1 else 100
            r = math.sqrt(x * x + y * y + z * z)
            yield r / unit, math.degrees(math.asin(z / r)) if r else 0


def main():
    address, command_port, search_port, packets = sys.argv[1], *map(int, sys.argv[2:5])
    host = Host(address, command_port)
    code, device, serial, ip, port = struct.unpack("<BB16s4sH", host.ask(0x0000, port=search_port))
    expect((code, device, port) == (0, 9, command_port), "a Mid-360 at its command port")
    seen = {"serial": serial.rstrip(b"\0").decode(), "ip": ".".join(map(str, ip)), "types": {}}
    points, readings = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for s in (points, readings):
        s.bind((address, 0))
        s.settimeout(10)
    own = bytes(map(int, address.split(".")))
    where = [own + struct.pack("<HH", s.getsockname()[1], lidar) for s, lidar in ((points, 0), (readings, 0))]
    for kind in (1, 2, 3):
        host.set((0x0000, bytes([kind])), (0x0006, where[0]), (0x0007, where[1]), (0x001C, b"\1"), (0x001A, b"\1"))
        got, ranges, elevations, until = [], [], [], time.monotonic() + 20
        while len(got) < packets:
            expect(time.monotonic() < until, f"{packets} packets of type {kind} within 20 s")
            p = packet_of(points.recv(2000))
            if p["type"] == kind:
                got.append(p)
        for p in got:
            expect(p["dots"] == 96 and p["interval"] == 4750, "96 points in 475 µs")
            for r, elevation in ranges_of(p):
                if r > 0:
                    ranges.append(r)
                    elevations.append(elevation)
        steps = [b["stamp"] - a["stamp"] for a, b in zip(got, got[1:])]
        counts = [(b["count"] - a["count"]) * 480000 == b["stamp"] - a["stamp"] or b["count"] < a["count"] for a, b in zip(got, got[1:])]
        seen["types"][kind] = {
            "packets": len(got), "shortest_step_ns": min(steps), "counts_go_with_stamps": all(counts), "returns": len(ranges),
            "range_m": [min(ranges), max(ranges)], "elevation_deg": [min(elevations), max(elevations)]}
    reading = packet_of(readings.recv(2000))
    expect((reading["type"], len(reading["data"])) == (0, 24), "a reading of six numbers")
    seen["imu"] = struct.unpack("<ffffff", reading["data"])
    state = host.ask(0x0101, struct.pack("<HHH", 1, 0, 0x8006))
    expect(state == struct.pack("<BHHHB", 0, 1, 0x8006, 1, 1), f"SAMPLING, got {state.hex()}")
    print(json.dumps(seen))


main()
