"""Errors of Rigor as exceptions.

    try:
        rigor.Rig("rig.yaml")
    except rigor.BadInput as error:
        error.file, error.line, error.column, error.key     # rig.yaml, 14, 12, channels.right.rate_hz
"""
from __future__ import annotations

import re

_PLACE = re.compile(r"^(?P<file>.+?):(?P<line>\d+):(?P<column>\d+)$")
_KEY = re.compile(r"^(?P<key>[A-Za-z_][\w.\-]*): ")


class Error(Exception):
    """What Rigor could not do.

    code: bad_input, not_found, not_writable, unavailable, timeout, protocol, disk_full, io, wrong_state or internal.
    where: the place as a whole, which may be a channel, an option or a path; message: what was expected, what came, what to do.
    file, line, column (from 1), key: of a value in a file; None where the error is of nothing in a file.
    """
    code = "internal"

    def __init__(self, where: str = "", message: str = ""):
        super().__init__(where, message)
        self.where, self.message = where, message
        place, key = _PLACE.match(where), _KEY.match(message)
        self.file: str | None = place["file"] if place else None
        self.line: int | None = int(place["line"]) if place else None
        self.column: int | None = int(place["column"]) if place else None
        self.key: str | None = key["key"] if place and key else None

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


class BadInput(Error, ValueError):
    """A file, an option or a value is wrong; nothing was touched."""
    code = "bad_input"


class NotFound(Error, LookupError):
    """A file, a device or a channel that was named does not exist."""
    code = "not_found"


class NotWritable(Error):
    """An output that was named cannot be written."""
    code = "not_writable"


class Unavailable(Error):
    """The machine lacks something, or an application or a device cannot go on."""
    code = "unavailable"


class Timeout(Error, TimeoutError):
    """A peer did not answer in time."""
    code = "timeout"


class ProtocolError(Error):
    """A peer or a file breaks its format: a recording is damaged."""
    code = "protocol"


class DiskFull(Error):
    """No space is left for an output."""
    code = "disk_full"


class IoError(Error):
    """Another system call failed."""
    code = "io"


class WrongState(Error, RuntimeError):
    """A call that is not allowed now: a rig that was closed or never started."""
    code = "wrong_state"


_CLASSES = {c.code: c for c in (BadInput, NotFound, NotWritable, Unavailable, Timeout, ProtocolError, DiskFull, IoError,
                                WrongState)}


def make(code: str, where: str, message: str) -> Error:
    """The exception of an error; the extension module calls it."""
    return _CLASSES.get(code, Error)(where, message)


def nearest(word: str, names) -> str:
    """"; did you mean 'left'?", or nothing."""
    import difflib
    close = difflib.get_close_matches(word, list(names), 1)
    return f"; did you mean '{close[0]}'?" if close else ""
