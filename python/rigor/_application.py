"""Objects of Python as applications of rigs: within the loop in virtual time, in a process of their own by the wall clock."""
from __future__ import annotations

import ctypes
import inspect
import json
import os
import struct
import sys

import rigor_client

from ._errors import BadInput

Application = rigor_client.Application


class _Memory:
    """The bench's samples, in this process: the place of a sample is its address."""

    @staticmethod
    def view(address: int, size: int) -> memoryview:
        if size == 0:
            return memoryview(b"")
        return memoryview((ctypes.c_ubyte * size).from_address(address)).cast("B").toreadonly()


class InProcess:
    """Calls an application as the bench does: what a process would be sent, within the loop."""

    def __init__(self, application: Application):
        self.application = application

    def start(self, setup: str) -> str:
        self.rig = rigor_client.Rig(json.loads(setup))
        self.turn_ = rigor_client.Turn(self.rig)
        self.ports = list(self.rig.inputs.values())
        self.application.start(self.rig)
        rate_hz = self.application.rate_hz
        return json.dumps({} if rate_hz is None else {"rate_hz": rate_hz})

    def turn(self, body: memoryview) -> bytes:
        turn = self.turn_
        rigor_client._take_turn(self.rig, turn, self.ports, _Memory, body)
        self.application.step(turn)
        return struct.pack("<QII", turn.cycle, len(turn._commands), 0) + b"".join(turn._commands)

    def finish(self) -> None:
        self.application.finish()


def command_for(application) -> list[str]:
    """The words that run a class in a process of its own."""
    cls = application if inspect.isclass(application) else type(application)
    module = sys.modules.get(cls.__module__)
    file = getattr(module, "__file__", None)
    if cls.__qualname__ != cls.__name__ or not file or not os.path.exists(file):
        raise BadInput("application", f"expected, by the wall clock, a class at the top of a file, which a process of its own can "
                       f"import; {cls.__qualname__} of {cls.__module__} is in none. Save it to a file, or use clock=\"virtual\"")
    host = os.path.join(os.path.dirname(os.path.abspath(__file__)), "host.py")
    return [sys.executable, host, os.path.abspath(file), cls.__name__]
