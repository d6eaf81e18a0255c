"""Rigs: opened, stepped with a look at their ports, or run."""
from __future__ import annotations

import html
import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence

import rigor_client

from . import _display, _rigor
from ._application import InProcess, command_for
from ._errors import BadInput, WrongState, nearest
from ._samples import Sample, read

_STATUS = rigor_client._STATUS


def value_text(value) -> str:
    """A value for --set, as YAML: JSON is."""
    if isinstance(value, str):
        return value
    return json.dumps(value, default=lambda v: v.tolist() if hasattr(v, "tolist") else os.fspath(v))


def set_texts(values: Mapping[str, object] | None) -> list[str]:
    return [f"{path}={value_text(value)}" for path, value in (values or {}).items()]


def rig_options(set=None, seed=None, **given) -> dict:
    """What the extension module is given: every key has a value."""
    options = {"set": set_texts(set), "clock": "", "record": "", "report": "", "trace": "", "junit": "", "faults_from": "",
               "fail_on": [], "duration_s": None, "live": None, "pace": 0.0, "workers": 0, "replace": False, "control": False}
    if seed is not None:
        options["set"].append(f"seed={int(seed)}")
    options.update(given)
    return options


class Port(rigor_client.Port):
    """A channel as the application sees it, now: `status` (never, fresh, held, overdue, disconnected) of the last cycle,
    `sample` (a Sample, None before the first), `fresh`: it came since the step before.

    name, kind, rate_hz, latency_ms, frame_id, width_px, height_px, names and units of its values. A sample is copied when it is
    first asked for, and stays good.
    """

    def __init__(self, rig: "Rig", index: int, description: dict):
        super().__init__(description)
        self._rig, self._index, self._kept, self._before = rig, index, (-1, None), -1

    @property
    def status(self) -> str:
        return _STATUS[self._rig._open().status(self._index)]

    @status.setter
    def status(self, _):
        pass  # rigor_client.Port's constructor gives it a value

    @property
    def fresh(self) -> bool:
        return self._rig._open().sequence(self._index) != self._before

    @property
    def samples(self) -> list[Sample]:
        return [self.sample] if self.fresh and self.sample is not None else []

    @samples.setter
    def samples(self, _):
        pass

    @property
    def sample(self) -> Sample | None:
        sequence = self._rig._open().sequence(self._index)
        if sequence < 0:
            return None
        if self._kept[0] != sequence:
            self._kept = (sequence, read(*self._rig._open().sample(self._index), self))
        return self._kept[1]

    @sample.setter
    def sample(self, _):
        pass

    def __repr__(self) -> str:
        return f"<port {self.name}: {self.kind}, {self.status}>"

    def _repr_html_(self) -> str:
        sample = self.sample
        return sample._repr_html_() if sample is not None else html.escape(repr(self))


class Report:
    """What came of a run.

    passed: as expected, and nothing went wrong (exit status 0 of `rigor run`); verdict: note, warning or bad; page, recording:
    files that were written, empty where none were. `report["channels"]` and so on: `dict` has all of it (docs/report.md).
    """

    def __init__(self, report):
        self.passed: bool = report.passed
        self.ended_well: bool = report.ended_well
        self.verdict: str = report.verdict
        self.page, self.recording = report.page, report.recording
        self.warnings, self.errors = report.warnings, report.errors
        self._json, self._text = report.json, report.text

    @property
    def dict(self) -> dict:
        return json.loads(self._json)

    def __getitem__(self, key: str):
        return self.dict[key]

    @property
    def text(self) -> str:
        """As the command prints it."""
        return self._text

    def html(self) -> str:
        """The page with plots and pictures, where one was written (`report=` of the rig, a folder)."""
        if not self.page:
            raise WrongState("report", "expected a page, none was written: give the rig report=\"FOLDER\"")
        with open(self.page, encoding="utf-8") as file:
            return file.read()

    def __repr__(self) -> str:
        return f"<report: {'passed' if self.passed else 'not passed'}, verdict {self.verdict}>\n{self._text}"

    def _repr_html_(self) -> str:
        colour = "#080" if self.passed else "#b00"
        page = f'<p><a href="{html.escape(self.page)}">{html.escape(self.page)}</a></p>' if self.page else ""
        return (f'<p style="color:{colour}"><b>{"passed" if self.passed else "not passed"}</b></p>'
                f"<pre>{html.escape(self._text)}</pre>{page}")


class Rig:
    """A rig, as `rigor run` runs it, from one's own program.

        with rigor.Rig("demo", clock="virtual", set={"channels.right.rate_hz": 10}) as rig:
            while rig.step(10):
                if rig["right"].fresh:
                    rig.command("table_command", enable=1, target_rate=rig["right"].sample.array().mean() / 10)
        print(rig.report)

    rig: a file, or the name of one that came along. clock: "virtual" or "wall"; None: as the rig says. seed; set: values of the
    rig by their path, as --set has them. duration_s; record: a file, report: a folder; False: none, whatever the rig says.
    application: an object or a class derived from rigor.Application, in place of the rig's own; in virtual time it is called
    within the loop, by the wall clock a class runs in a process of its own. params: what it finds as `rig.params`.
    fail_on: findings that fail the run, as --fail-on. faults_from: a recording whose live faults come again. live: a port, or
    "ADDRESS:PORT", where a page shows the run. replace: earlier files are replaced, else they are kept under a number.

    A rig in virtual time is stepped or run, one by the wall clock is run. The GIL is free while the loop goes round. Raises
    BadInput and NotFound with the place in the file, Unavailable, NotWritable.
    """

    def __init__(self, rig, *, clock: str | None = None, seed: int | None = None, set: Mapping[str, object] | None = None,
                 duration_s: float | None = None, record=None, report=None, application=None,
                 params: Mapping[str, object] | None = None, fail_on: Sequence[str] = (), faults_from=None, junit=None, trace=None,
                 live=None, pace: float = 0, workers: int = 0, replace: bool = False, control: bool = False):
        if clock not in (None, "virtual", "wall"):
            raise BadInput("clock", f"expected \"virtual\", \"wall\" or None, got {clock!r}")
        values, called = dict(set or {}), None
        if application is not None:
            if clock == "wall":
                values["application"] = {"command": command_for(application), "params": dict(params or {})}
            else:
                made = application() if isinstance(application, type) else application
                called = InProcess(made)
                values["application"] = {"name": "python", "params": dict(params or {})}

        def output(value):
            return "-" if value is False else "" if value is None else os.fspath(value)
        options = rig_options(values, seed, clock=clock or "", duration_s=duration_s, record=output(record), report=output(report),
                              fail_on=list(fail_on), faults_from=output(faults_from), junit=output(junit), trace=output(trace),
                              live=None if live is None else str(live), pace=float(pace), workers=int(workers), replace=replace,
                              control=control)
        self.report: Report | None = None
        self._rig = None
        rig = _rigor.Rig(os.fspath(rig), options, called)
        if called and not rig.virtual_time:
            raise BadInput("application", "expected clock=\"virtual\" or clock=\"wall\" with an application, for the rig's own "
                           "clock is the wall's: say which")
        self._rig, self._state = rig, "made"
        self._ports: dict[str, Port] = {}
        self._outputs: dict[str, dict] = {}
        self._pairs: list[str] = []
        self._commanded: dict[str, dict[str, float]] = {}

    # ---------------------------------------------------------------- running

    def prepare(self) -> "Rig":
        """Opens the devices and takes all memory; `with`, `step` and `run` do so, too. Ctrl-C ends it."""
        if self._state == "made":
            self._open().prepare()
            self._state = "prepared"
            setup = json.loads(self._rig.setup())
            self.name, self.clock, self.seed = setup["rig"], setup["clock"], setup["seed"]
            self.loop_rate_hz, self.duration_s = setup["loop_rate_hz"], setup["duration_s"]
            self._pairs = setup["pairs"]
            self._ports = {d["name"]: Port(self, i, d) for i, d in enumerate(setup["inputs"])}
            self._outputs = {d["name"]: d for d in setup["outputs"]}
            self._warn()
        return self

    def __enter__(self) -> "Rig":
        return self.prepare()

    def __exit__(self, kind, value, trace):
        try:
            if kind is None and self._state == "running":
                self.finish()
        finally:
            self.close()

    def step(self, cycles: int = 1) -> bool:
        """Runs so many cycles of the loop, in virtual time. False: the run is over. The first call starts the run.

        Ctrl-C, and what the application raises, come out of this call.
        """
        self._begin()
        for port in self._ports.values():
            port._before = self._rig.sequence(port._index)
        return self._rig.step(int(cycles))

    def _begin(self):
        if self._state in ("made", "prepared"):
            self.prepare()
            self._rig.start()
            self._state = "running"
        if self._state != "running":
            raise WrongState(getattr(self, "name", "rig"), "the run is over: open the rig again")

    def run(self, progress: Callable[[float], None] | None = None) -> Report:
        """Runs to the end of the rig's duration, and reports. `progress(seconds of bench time)` is called a few times a second;
        Ctrl-C, and what `progress` raises, end the run."""
        if self._state == "made":
            self.prepare()
        if self._state == "running" or self._rig.virtual_time:
            cycles = max(1, int(self.loop_rate_hz / 10)) if progress else 1 << 40
            more = True
            while more:
                more = self.step(cycles)
                if progress:
                    progress(self.t_s)
            return self.finish()
        self._state = "running"
        try:
            return self._ended(self._rig.run((lambda cycle: progress(cycle / self.loop_rate_hz)) if progress else None))
        finally:
            self._state = "ended"

    def finish(self) -> Report:
        """Ends the run where it stands: closes the devices and the recording, and reports. Also `rig.report`."""
        if self._state == "ended" and self.report is not None:
            return self.report
        if self._state == "prepared":
            self._rig.start()
        elif self._state != "running":
            raise WrongState("rig", "finish() comes once, after step()")
        self._state = "ended"
        return self._ended(self._rig.finish())

    def close(self) -> None:
        """Closes the devices. A run that goes on is broken off: what was recorded is whole."""
        if self._rig is not None:
            self._rig.close()
        self._state = "ended"

    def _ended(self, report) -> Report:
        self._warn()
        self.report = Report(report)
        return self.report

    def _warn(self):
        for text in self._rig.take_warnings():
            warnings.warn(text, RuntimeWarning, stacklevel=4)

    def _open(self):
        if self._rig is None:
            raise WrongState("rig", "the rig could not be opened")
        return self._rig

    # ---------------------------------------------------------------- looking and commanding, between steps

    @property
    def cycle(self) -> int:
        """Cycles of the loop so far."""
        return self._rig.cycle

    @property
    def t_s(self) -> float:
        """Bench time of the next cycle since the start, s."""
        return self._rig.cycle / self.loop_rate_hz

    def ports(self) -> dict[str, Port]:
        """The channels as an application sees them, by name: live objects, good until the run ends."""
        return dict(self.prepare()._ports)

    def __getitem__(self, name: str) -> Port:
        ports = self.prepare()._ports
        if name not in ports:
            raise BadInput("channel", f"expected a channel of this rig ({', '.join(ports)}), got \"{name}\"{nearest(name, ports)}")
        return ports[name]

    @property
    def outputs(self) -> dict[str, dict]:
        """The sinks by name: names and units of their values, latency_ms."""
        return dict(self.prepare()._outputs)

    def command(self, sink: str, **values: float) -> None:
        """Commands a sink as an application would in the next cycle, in virtual time. Values that are not named keep what they were commanded
        last; the first command names them all."""
        outputs = self.prepare()._outputs
        if sink not in outputs:
            raise BadInput("sink", f"expected a sink of this rig ({', '.join(outputs) or 'none'}), got \"{sink}\""
                           + nearest(sink, outputs))
        names = outputs[sink]["names"]
        unknown = [n for n in values if n not in names]
        if unknown:
            raise BadInput(sink, f"expected values of {', '.join(names)}, got \"{unknown[0]}\"{nearest(unknown[0], names)}")
        wanted = {**self._commanded.get(sink, {}), **values}
        missing = [n for n in names if n not in wanted]
        if missing:
            raise BadInput(sink, f"expected a value for each of {', '.join(names)} in the first command, got none for "
                           f"{', '.join(missing)}")
        self._begin()
        self._rig.command(sink, [float(wanted[n]) for n in names])
        self._commanded[sink] = wanted

    def fault(self, channel: str, kind: str, for_s: float | None = None, **keys) -> None:
        """Injects a fault from the next cycle on, as rigs have them: `rig.fault("right", "drop", probability=0.2, for_s=3)`."""
        fault = {"kind": kind, **keys, **({} if for_s is None else {"for_s": for_s})}
        self._open().fault(channel, value_text(fault))

    def clear_faults(self, channel: str = "") -> None:
        """Ends the injected faults of a channel, or of all."""
        self._open().clear_faults(channel)

    def switch(self, pair: str, active: str) -> None:
        """Which side of a pair the application is given from the next cycle on: "real" or "simulated"."""
        self._open().switch_pair(pair, active)

    @property
    def pairs(self) -> list[str]:
        return list(self.prepare()._pairs)

    def expected(self) -> list[dict]:
        """What the rig expects and what the cycles so far say of it: of, quantity, bounds, state (holds, violated, undecided,
        unknown), sentence, looked_at, outside, first_s, minimum, maximum."""
        return self._open().expected()

    @property
    def live_url(self) -> str:
        """Where a browser finds the run; empty without `live`."""
        return self._open().live_url

    def __repr__(self) -> str:
        name = getattr(self, "name", "rig")
        return f"<rig {name}: {self._state}, cycle {self.cycle if self._rig else 0}>"

    def _repr_html_(self) -> str:
        if not self._ports or self._state == "ended":
            return self.report._repr_html_() if self.report else html.escape(repr(self))
        return _display.table_html([repr(self), "kind", "status"], [[p.name, p.kind, p.status] for p in self._ports.values()])


def rigs() -> dict[str, str]:
    """The rigs that came along: their first sentence by name."""
    return {name: about for name, about, _ in _rigor.installed_rigs()}
