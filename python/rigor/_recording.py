"""Recordings: what channels gave, what the application saw, what it commanded. Any MCAP file of ROS 2 is read."""
from __future__ import annotations

import json
import os

import numpy

from . import _display, _foreign, _rigor
from ._errors import BadInput, ProtocolError, nearest
from ._ros import Definition
from ._samples import POINT, Sample

_COMPANIONS = ("stamp", "settings", "amplitude", "fd", "temperature", "quality", "wheels")
_STATUS = ("never", "fresh", "held", "overdue", "disconnected")
#: Type of `Channel.stamps`: times in ns; on the bench clock, or UTC where the file has no stamps of Rigor.
STAMP = numpy.dtype([("sequence", "<u8"), ("t_capture_ns", "<i8"), ("t_release_ns", "<i8"), ("t_arrival_ns", "<i8"),
                     ("sigma_capture_ns", "<i8"), ("lost_before", "<u4"), ("validity", "<u4")])
#: Type of `Channel.visibility`: changes of what the application saw of a channel.
VISIBILITY = numpy.dtype([("cycle", "<u8"), ("t_ns", "<i8"), ("sequence", "<u8"), ("status", "U12")])


def open(path, verify: bool = True, cache_mb: float = 256, skip_damaged: bool = False) -> "Recording":
    """Opens a recording of Rigor, or any MCAP file with messages of ROS 2.

    verify: the checksum of each chunk is checked when it is first read; without it, what lies in chunks that are not
    compressed is not touched before it is asked for. cache_mb: unpacked chunks that are kept for the next access.
    skip_damaged: chunks that are damaged are passed over. Raises NotFound, BadInput, ProtocolError.
    """
    return Recording(path, verify, cache_mb, skip_damaged)


class Topic:
    """The messages of one topic as the file has them: `len`, `[i]` (a decoded message), iteration, `times`, `table`.

    Arrays in messages point into the file, or into the unpacked chunk, and keep that alive.
    """

    def __init__(self, recording: "Recording", about: dict):
        self._file, self._id = recording._file, about["id"]
        self.topic, self.type, self._about = about["topic"], about["type"], about
        self._definition = None

    @property
    def definition(self) -> Definition:
        if self._definition is None:
            if self._about["encoding"] != "cdr" or self._about["schema_encoding"] != "ros2msg":
                raise ProtocolError(self.topic, "expected messages in CDR with a definition in ros2msg, got "
                                    f"{self._about['encoding'] or 'none'} with {self._about['schema_encoding'] or 'none'}")
            self._definition = Definition(self.type, self._about["schema"])
        return self._definition

    def __len__(self) -> int:
        return self._file.count(self._id)

    @property
    def times(self) -> numpy.ndarray:
        """Log times, (n,) int64 ns UTC: when the application could see the sample."""
        return self._file.times(self._id)

    def data(self, i: int) -> numpy.ndarray:
        """The bytes of message i, read-only, without a copy."""
        return self._file.message(self._id, i if i >= 0 else i + len(self))

    def __getitem__(self, i: int):
        if not -len(self) <= i < len(self):
            raise IndexError(f"{self.topic}: message {i} of {len(self)}")
        return self.definition.decode(self.data(i))

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    def columns(self, paths, index: range | None = None) -> list[numpy.ndarray]:
        """Fields of many messages, each (n,) or (n, count); nested ones by dots: "pose.position.x".

        Where all messages have one length it is one pass in C++; otherwise each is decoded.
        """
        index = range(len(self)) if index is None else index
        if not len(index):
            return [numpy.empty(0) for _ in paths]
        rows = self._file.gather(self._id, index[0], len(index), index.step)
        if rows is not None:
            layout = self.definition.layout(rows[0])
            if layout.holds_for(rows) and all(p in layout.numbers for p in paths):
                return [layout.view(rows, p) for p in paths]

        def value(message, path):
            for name in path.split("."):
                message = message[int(name)] if isinstance(message, list) else getattr(message, name)
            return message
        lists = [[] for _ in paths]
        for i in index:
            message = self[i]
            for values, path in zip(lists, paths):
                values.append(value(message, path))
        return [numpy.array(values) for values in lists]

    def __repr__(self) -> str:
        return f"<topic {self.topic}: {len(self)} of {self.type}>"


class Channel:
    """The samples of a channel: `len`, `[i]` (a Sample), slices (again a Channel, nothing is read), iteration.

        left = rigor.open("demo.mcap")["left"]
        for picture in left[::10]: picture.array().mean()
        left.stamps.t_capture_ns; left.array()
    """

    def __init__(self, recording: "Recording", name: str, main: Topic, companions: dict[str, Topic], index: range | None = None):
        self.name, self.topic, self.type = name, main.topic, main.type
        self._recording, self._main, self._companions = recording, main, companions
        self._index = range(len(main)) if index is None else index
        self.kind = _foreign.kind_of(main.type, companions)

    def __len__(self) -> int:
        return len(self._index)

    def __getitem__(self, i):
        if isinstance(i, slice):
            return Channel(self._recording, self.name, self._main, self._companions, self._index[i])
        return self._sample(self._index[i])

    def __iter__(self):
        return (self._sample(i) for i in self._index)

    @property
    def times(self) -> numpy.ndarray:
        """Log times, (n,) int64 ns UTC."""
        return self._main.times[self._slice()]

    @property
    def stamps(self) -> numpy.recarray:
        """Of every sample (n,), type STAMP, int64 ns on the bench clock: `stamps.t_capture_ns`.

        Where the file has no stamps of Rigor: the capture from the header, release and arrival from the log time, all UTC.
        """
        index, out = self._index, numpy.zeros(len(self), STAMP)
        if "stamp" in self._companions and len(self):
            where = self._companion_index("stamp")
            values = self._companions["stamp"].columns(STAMP.names, where)
            for name, column in zip(STAMP.names, values):
                out[name] = column
        elif len(self):
            out["sequence"] = numpy.arange(index.start, index.stop, index.step)
            out["t_release_ns"] = out["t_arrival_ns"] = self.times
            out["t_capture_ns"] = _foreign.header_times(self._main, index, self.times)
        return out.view(numpy.recarray)

    def array(self) -> numpy.ndarray:
        """All samples in one array.

        Pictures (n, height, width[, values]); range images (n, height, width), metres; clouds: all points one after the other,
        a structured array with the field `sample`; everything else: a structured array (n,), units in the names. Take a
        slice of the channel first where all of it is too much; `[i].array()` does not copy.
        """
        return _foreign.stack(self)

    @property
    def amplitude(self) -> numpy.ndarray:
        """Of range images: (n, height, width) float32, electrons."""
        if "amplitude" not in self._companions:
            raise AttributeError(f"{self.name}: no amplitude was recorded")
        return _foreign.stack_pictures(self._companions["amplitude"], self._index)

    @property
    def visibility(self) -> numpy.ndarray:
        """Which of its samples the application saw: changes, a structured array (m,) of type VISIBILITY.

        In cycles that are not named nothing changed; a sample that was `fresh` is `held` in the cycle after.
        """
        name = self.name.split("/")[0]
        return self._recording._visibility().get(name, numpy.empty(0, VISIBILITY))

    def status_at(self, cycles) -> numpy.ndarray:
        """Status of the channel's port in these cycles of the loop: (n,) of never, fresh, held, overdue, disconnected."""
        cycles, changes = numpy.atleast_1d(cycles), self.visibility
        at = numpy.searchsorted(changes["cycle"], cycles, "right") - 1
        status = numpy.where(at >= 0, changes["status"][numpy.maximum(at, 0)] if len(changes) else "never", "never")
        passed = (at >= 0) & (status == "fresh") & (changes["cycle"][numpy.maximum(at, 0)] != cycles) if len(changes) else False
        return numpy.where(passed, "held", status)

    def _slice(self) -> slice:
        index = self._index
        return slice(index.start, index.stop if index.stop >= 0 else None, index.step)

    def _companion_index(self, name: str) -> range:
        """Of the companion's messages those that belong to this channel's samples."""
        if len(self._companions[name]) != len(self._main):
            raise ProtocolError(self._companions[name].topic, f"expected {len(self._main)} messages, one for each sample, got "
                                f"{len(self._companions[name])}; rigor inspect says what the recording lacks")
        return self._index

    def _companion(self, name: str, i: int):
        topic = self._companions.get(name)
        if topic is None:
            return None
        if len(topic) == len(self._main):
            return topic[i]
        j = int(numpy.searchsorted(topic.times, self._main.times[i]))
        return topic[j] if j < len(topic) and topic.times[j] == self._main.times[i] else None

    def _sample(self, i: int) -> Sample:
        return _foreign.sample(self, i)

    def __repr__(self) -> str:
        return f"<channel {self.name}: {len(self)} of {self.type}>"

    def _repr_html_(self) -> str:
        first = self[0]._repr_html_() if len(self) and self.kind in ("image", "range_image", "point_cloud") else ""
        return _display.table_html([repr(self)], []) + first


class Pair(Channel):
    """The samples of a pair: those of its real side; `simulated` are those of the other, of the same instants."""

    def __init__(self, recording, name, real: Channel, simulated: Channel):
        super().__init__(recording, name, real._main, real._companions)
        self.real, self.simulated = real, simulated


class Recording:
    """A file of samples. `recording["left"]` is a Channel (of a pair: Pair); "left/simulated", or a topic, will do, too."""

    def __init__(self, path, verify=True, cache_mb=256, skip_damaged=False):
        self.path = os.fspath(path)
        self._file = _rigor.Recording(self.path, verify, int(cache_mb * 2**20), skip_damaged)
        self.topics: dict[str, Topic] = {}
        for about in self._file.channels():
            self.topics.setdefault(about["topic"], Topic(self, about))
        self.channels: dict[str, Channel] = {}
        for topic, main in self.topics.items():
            companions = {c: self.topics[f"{topic}/{c}"] for c in _COMPANIONS if f"{topic}/{c}" in self.topics}
            if "stamp" in companions:
                name = topic.strip("/").rsplit("/", 1)[0]
                self.channels[name] = Channel(self, name, main, companions)
        for name in {n.removesuffix("/real") for n in self.channels if n.endswith("/real")}:
            if f"{name}/simulated" in self.channels:
                self.channels[name] = Pair(self, name, self.channels[f"{name}/real"], self.channels[f"{name}/simulated"])
        if not self.channels:  # by others: each topic is a channel
            for topic, main in self.topics.items():
                self.channels[topic] = Channel(self, topic, main, {})
        self._seen = None

    def __getitem__(self, name: str) -> Channel:
        if name in self.channels:
            return self.channels[name]
        if name in self.topics:
            return Channel(self, name, self.topics[name], {})
        known = sorted(self.channels)
        raise BadInput(self.path, f"expected one of its channels ({', '.join(known) or 'none'}) or a topic, got \"{name}\""
                       + nearest(name, [*known, *self.topics]))

    def __contains__(self, name: str) -> bool:
        return name in self.channels or name in self.topics

    def __iter__(self):
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def keys(self):
        return self.channels.keys()

    @property
    def about(self) -> dict:
        """profile, library, bytes, messages, good, indexed, truncated, lost_bytes, damaged_chunks, notes, compressions."""
        return self._file.about()

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name, later ones over earlier ones."""
        merged: dict[str, dict[str, str]] = {}
        for name, values in self._file.metadata():
            merged.setdefault(name, {}).update(values)
        return merged

    @property
    def attachments(self) -> list[tuple[str, str, bytes]]:
        """(name, media type, content)."""
        return self._file.attachments()

    @property
    def rig(self) -> str:
        """The rig of the run as it was read, YAML; empty where the file is not of a run of Rigor."""
        return self.metadata.get("rigor", {}).get("rig", "")

    def to_utc_ns(self, t_ns):
        """UTC, ns since 1970, of instants on the bench clock."""
        about = self.metadata.get("rigor", {})
        if "epoch_utc_ns" not in about:
            raise BadInput(self.path, "expected a recording of a run of Rigor, whose metadata have the epoch")
        return numpy.asarray(t_ns, "i8") + (int(about["epoch_utc_ns"]) - int(about["epoch_bench_ns"]))

    @property
    def duration_s(self) -> float:
        """Between the first and the last message."""
        ends = [(t[0], t[-1]) for t in (topic.times for topic in self.topics.values()) if len(t)]
        return (max(e for _, e in ends) - min(s for s, _ in ends)) * 1e-9 if ends else 0.0

    def commands(self, sink: str) -> numpy.ndarray:
        """What the application commanded a sink: a structured array (n,) of sequence, t_ns (UTC), t_effect_ns (bench clock)
        and a field for each value, in the units of the sink."""
        topic = self.topics.get("/rigor/commands")
        found = [(t, m) for t, m in zip(topic.times, topic) if m.channel == sink] if topic else []
        if not found:
            return numpy.empty(0, [("sequence", "u8"), ("t_ns", "i8"), ("t_effect_ns", "i8")])
        dtype = [("sequence", "u8"), ("t_ns", "i8"), ("t_effect_ns", "i8")] + [(n, "f8") for n in found[0][1].names]
        return numpy.array([(m.sequence, t, m.t_effect_ns, *m.values) for t, m in found], dtype)

    @property
    def events(self) -> list:
        """What happened: messages with channel, kind, code, value, text."""
        return list(self.topics.get("/rigor/events", ()))

    @property
    def faults(self) -> list:
        """Begins and ends of faults: messages with channel, kind, begins, fault (its keys)."""
        return list(self.topics.get("/rigor/faults", ()))

    def _visibility(self) -> dict[str, numpy.ndarray]:
        if self._seen is None:
            seen: dict[str, list] = {}
            for message in self.topics.get("/rigor/visibility", ()):
                for e in message.entries:
                    # The bit above the status says which side of a pair was handed on.
                    status = _STATUS[e.status & 0x0f] if e.status & 0x0f < len(_STATUS) else "never"
                    seen.setdefault(e.channel, []).append((message.cycle, message.t_bench_ns, e.sequence, status))
            self._seen = {name: numpy.array(rows, VISIBILITY) for name, rows in seen.items()}
        return self._seen

    def __repr__(self) -> str:
        return f"<recording {self.path}: {self.duration_s:.3f} s, channels {', '.join(self.channels) or 'none'}>"

    def _repr_html_(self) -> str:
        rows = [[c.name, c.type, len(c)] for c in self.channels.values()]
        return _display.table_html(["channel", "type", "samples"], rows)

    def summary(self) -> dict:
        """For machines: channels with type and number of samples, duration, state of the file."""
        return json.loads(json.dumps({"path": self.path, "duration_s": self.duration_s, **self.about,
                                      "channels": {c.name: {"type": c.type, "samples": len(c)} for c in self.channels.values()}},
                                     default=list))
