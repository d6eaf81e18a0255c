"""Messages of ROS 2 as the file itself defines them: any type whose definition (ros2msg) lies in the recording.

Arrays of numbers in a message point into its bytes. Nothing in a message is trusted: each length is checked against the bytes
that are there.
"""
from __future__ import annotations

import re
import struct

import numpy

from ._errors import ProtocolError

_NUMBERS = {"bool": ("?", 1), "byte": ("u1", 1), "char": ("u1", 1), "int8": ("i1", 1), "uint8": ("u1", 1), "int16": ("i2", 2),
            "uint16": ("u2", 2), "int32": ("i4", 4), "uint32": ("u4", 4), "int64": ("i8", 8), "uint64": ("u8", 8),
            "float32": ("f4", 4), "float64": ("f8", 8)}
_FIELD = re.compile(r"^(?P<type>[\w/]+)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>\w+)\s*(?P<rest>.*)$")


class Message:
    """One message: its fields are attributes."""

    def __init__(self, type_name: str, fields: dict):
        self.__dict__.update(fields)
        self._type = type_name

    def __repr__(self) -> str:
        def short(value):
            if isinstance(value, numpy.ndarray) and value.size > 8:
                return f"<{value.size} {value.dtype}>"
            return repr(value)
        fields = ", ".join(f"{k}={short(v)}" for k, v in self.__dict__.items() if k != "_type")
        return f"{self._type.split('/')[-1]}({fields})"


class _Field:
    __slots__ = ("name", "number", "size", "text", "struct", "count", "many")

    def __init__(self, name):
        self.name, self.number, self.size, self.text, self.struct, self.count, self.many = name, None, 0, False, None, None, False


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else name


class Definition:
    """A type and those that it contains, from a schema of encoding ros2msg."""

    def __init__(self, type_name: str, text: str):
        self.type = type_name
        texts = {}
        parts = re.split(r"^=+\s*$", text, flags=re.M)
        texts[_short(type_name)] = parts[0]
        for part in parts[1:]:
            head, _, body = part.strip().partition("\n")
            texts[_short(head.removeprefix("MSG:").strip())] = body
        self._texts, self._structs = texts, {}
        self.fields = self._fields(_short(type_name), 0)

    def _find(self, name: str, package: str) -> str:
        short = _short(name)
        for candidate in (short, f"{package}/{name}", f"std_msgs/{name}", f"builtin_interfaces/{name}"):
            if candidate in self._texts:
                return candidate
        raise ProtocolError(self.type, f"expected a definition of {name} in the schema, found none")

    def _fields(self, name: str, depth: int) -> list[_Field]:
        if name in self._structs:
            return self._structs[name]
        if depth > 32:
            raise ProtocolError(self.type, "expected a type that does not contain itself")
        fields = []
        for line in self._texts[name].splitlines():
            line = line.split("#")[0].strip()
            match = _FIELD.match(line) if line else None
            if not match or match["rest"].startswith("="):
                continue  # a comment, or a constant
            field = _Field(match["name"])
            kind, array = match["type"], match["array"]
            if array is not None:
                field.many = True
                field.count = int(array[1:-1]) if array[1:-1].isdigit() else None
            if kind in _NUMBERS:
                field.number, field.size = _NUMBERS[kind]
            elif kind in ("string", "wstring"):
                field.text = True
                if kind == "wstring":
                    raise ProtocolError(self.type, f"{match['name']}: strings of wide characters are not read")
            elif kind in ("time", "duration"):
                raise ProtocolError(self.type, f"{match['name']}: a type of ROS 1; convert the bag to ROS 2")
            else:
                field.struct = self._fields(self._find(kind, name.split("/")[0]), depth + 1)
            fields.append(field)
        self._structs[name] = fields
        return fields

    def decode(self, data) -> Message:
        """The message in these bytes."""
        return _Reader(self, data, None).message(self.fields, self.type)

    def layout(self, data) -> "Layout":
        """Where the numbers of this message lie."""
        layout = Layout()
        _Reader(self, data, layout).message(self.fields, self.type)
        return layout


class Layout:
    """Where a message's numbers lie: it holds for every message with the same lengths in the same places."""

    def __init__(self):
        self.numbers: dict[str, tuple[int, str, int | None]] = {}  # path: offset, dtype, count (None: one number)
        self.lengths: list[tuple[int, int]] = []  # offset of a u32, value
        self.head: bytes = b""

    def holds_for(self, rows: numpy.ndarray) -> bool:
        """Whether it describes all these messages, one a row."""
        if not all((rows[:, i] == b).all() for i, b in enumerate(self.head)):
            return False
        if not self.lengths:
            return True
        at = numpy.array([offset for offset, _ in self.lengths])
        wanted = numpy.array([value for _, value in self.lengths], "<u4").view("u1").reshape(-1, 4)
        return bool((rows[:, at[:, None] + numpy.arange(4)] == wanted).all())

    def view(self, rows: numpy.ndarray, path: str) -> numpy.ndarray:
        """A field of all messages, one a row, without a copy."""
        offset, dtype, count = self.numbers[path]
        size = numpy.dtype(dtype).itemsize * (1 if count is None else count)
        part = numpy.ndarray((len(rows),) if count is None else (len(rows), count), dtype, rows, offset,
                             (rows.strides[0],) if count is None else (rows.strides[0], numpy.dtype(dtype).itemsize))
        if offset + size > rows.shape[1]:
            raise ProtocolError(path, "a message is shorter than its fields")
        return part


class _Reader:
    def __init__(self, definition, data, layout):
        self.type, self.data, self.layout = definition.type, memoryview(data), layout
        if len(self.data) < 4 or self.data[0] != 0 or self.data[1] > 1:
            raise ProtocolError(self.type, "expected a message in plain CDR")
        self.order = "<" if self.data[1] == 1 else ">"
        self.at = 4
        if layout is not None:
            layout.head = bytes(self.data[:2])

    def take(self, size: int) -> int:
        at = self.at
        if size > len(self.data) - at:
            raise ProtocolError(self.type, f"byte {at}: expected {size} bytes more, the message has {len(self.data) - at}")
        self.at = at + size
        return at

    def align(self, size: int):
        self.at += -(self.at - 4) % size

    def length(self, least: int) -> int:
        self.align(4)
        at = self.take(4)
        n = struct.unpack_from(self.order + "I", self.data, at)[0]
        if n * least > len(self.data) - self.at:
            raise ProtocolError(self.type, f"byte {at}: a length of {n} is more than the message holds")
        if self.layout is not None:
            self.layout.lengths.append((at, n if self.order == "<" else int.from_bytes(n.to_bytes(4, "big"), "little")))
        return n

    def text(self) -> str:
        n = self.length(1)
        at = self.take(n)
        return bytes(self.data[at:at + max(n - 1, 0)]).decode("utf-8", "replace")

    def message(self, fields, name, path="") -> Message:
        return Message(name, {f.name: self.value(f, path + f.name) for f in fields})

    def value(self, f: _Field, path: str):
        if not f.many:
            if f.number:
                self.align(f.size)
                at = self.take(f.size)
                if self.layout is not None:
                    self.layout.numbers[path] = (at, self.order + f.number, None)
                return struct.unpack_from(self.order + _CODE[f.number], self.data, at)[0]
            return self.text() if f.text else self.message(f.struct, f.name, path + ".")
        n = f.count if f.count is not None else self.length(f.size if f.number else 4 if f.text else 1)
        if f.number:
            if n > 0:
                self.align(f.size)
            at = self.take(n * f.size)
            if self.layout is not None:
                self.layout.numbers[path] = (at, self.order + f.number, n)
            return numpy.frombuffer(self.data, self.order + f.number, n, at) if n else numpy.empty(0, self.order + f.number)
        if f.text:
            return [self.text() for _ in range(n)]
        return [self.message(f.struct, f.name, f"{path}.{i}.") for i in range(n)]


_CODE = {"?": "?", "u1": "B", "i1": "b", "u2": "H", "i2": "h", "u4": "I", "i4": "i", "u8": "Q", "i8": "q", "f4": "f", "f8": "d"}
