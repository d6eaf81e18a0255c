"""Messages of ROS 2 by the definitions in the file: any type, whole, cut and damaged."""
import random
import struct
import types
import unittest

import numpy
from rigor import _foreign, _ros

TEXT = """std_msgs/Header header
float64[3] fixed
geometry_msgs/Vector3 v   # nested
string[] names
float64[] values
uint8 flag
int64 t
Thing[] things
uint8 CONSTANT=3
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: my_msgs/Thing
uint8 a
float32 b
"""


def message(k, frame="map", names=("ab", "c")):
    """A message in CDR, written by hand."""
    body = bytearray()

    def put(code, *values):
        for value in values:
            body.extend(bytes(-len(body) % struct.calcsize(code)) + struct.pack("<" + code, value))

    def text(value):
        put("I", len(value) + 1)
        body.extend(value.encode() + b"\0")
    put("i", 7), put("I", 5), text(frame)
    put("d", 1, 2, 3)
    put("d", 4, 5, k)
    put("I", len(names))
    for name in names:
        text(name)
    put("I", 2), put("d", 8, k)
    put("B", 9), put("q", -k)
    put("I", 2), put("B", 1), put("f", 2.5), put("B", 3), put("f", k)
    return b"\0\1\0\0" + bytes(body)


class Definitions(unittest.TestCase):
    def setUp(self):
        self.definition = _ros.Definition("my_msgs/msg/Mine", TEXT)

    def test_every_field_is_read(self):
        m = self.definition.decode(message(6))
        self.assertEqual((m.header.stamp.sec, m.header.frame_id, m.v.z, m.names, m.flag, m.t), (7, "map", 6, ["ab", "c"], 9, -6))
        self.assertEqual((m.fixed.tolist(), m.values.tolist(), m.things[1].b), ([1, 2, 3], [8, 6], 6))
        self.assertFalse(hasattr(m, "CONSTANT"))

    def test_many_of_one_layout_are_read_at_once(self):
        rows = numpy.stack([numpy.frombuffer(message(k), "u1") for k in range(5)])
        layout = self.definition.layout(rows[0])
        self.assertTrue(layout.holds_for(rows))
        for path, expected in (("t", [-k for k in range(5)]), ("v.z", [*range(5)]), ("things.1.b", [*range(5)]),
                               ("values", [[8, k] for k in range(5)])):
            self.assertEqual(layout.view(rows, path).tolist(), expected)
        # The same number of bytes, and other lengths within: not the same layout.
        other = numpy.frombuffer(message(1, names=("a", "bc")), "u1")
        self.assertEqual(len(other), rows.shape[1])
        self.assertFalse(layout.holds_for(numpy.stack([rows[0], other])))

    def test_what_is_cut_is_refused_and_what_is_damaged_never_reads_beyond(self):
        whole = message(3)
        for n in range(len(whole)):
            with self.assertRaises(_ros.ProtocolError):
                self.definition.decode(whole[:n])
        draw = random.Random(1)
        for _ in range(500):
            damaged = bytearray(whole)
            damaged[draw.randrange(len(whole))] = draw.randrange(256)
            try:
                self.definition.decode(bytes(damaged))
            except _ros.ProtocolError:
                pass

    def test_a_type_without_definition_is_named(self):
        with self.assertRaisesRegex(_ros.ProtocolError, "expected a definition of Missing"):
            _ros.Definition("my_msgs/msg/Mine", "Missing m")


class Foreign(unittest.TestCase):
    def test_pictures_with_padded_rows(self):
        m = types.SimpleNamespace(encoding="rgb8", is_bigendian=0, step=20, width=6, height=3, data=numpy.arange(60, dtype="u1"))
        picture = _foreign.pixels(m)
        self.assertEqual((picture.shape, picture[1, 0, 0]), ((3, 6, 3), 20))
        m.height = 4
        with self.assertRaises(ValueError):
            _foreign.pixels(m)

    def test_clouds_with_fields_of_their_own(self):
        fields = [types.SimpleNamespace(name="x", offset=0, datatype=7, count=1),
                  types.SimpleNamespace(name="i", offset=12, datatype=2, count=1)]
        m = types.SimpleNamespace(width=2, height=1, point_step=16, is_bigendian=0, fields=fields, data=numpy.arange(32, dtype="u1"))
        self.assertEqual(_foreign.points(m)["i"].tolist(), [12, 28])


if __name__ == "__main__":
    unittest.main()
