"""Samples of simulated channels without a run, with what a perfect sensor would have known."""
from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy

from . import _display, _rigor
from ._rig import rig_options
from ._samples import Sample, read


class Truth:
    """Ground truth, element by element of a sample: pixels (height, width) or points (n,).

    node: uint64, id in the world (0: nothing); class_index: uint16 into class_names ([0] is empty); range_m: float32, metres
    along the ray (inf: nothing); normal: float32, (…, 3), of the surface, in the sensor's frame; flow_px_per_s: float32,
    (…, 2), cameras alone: motion of the point in the picture, pixels a second; else None.
    """

    def __init__(self, values: dict):
        self.node, self.class_index, self.class_names = values["node"], values["class_index"], values["class_names"]
        self.range_m, self.normal, self.flow_px_per_s = values["range_m"], values["normal"], values["flow_px_per_s"]

    def classes(self) -> numpy.ndarray:
        """Names of the classes, element by element."""
        return numpy.array(self.class_names)[self.class_index]

    def boxes(self) -> list[dict]:
        """Of a picture: node, class, box (x0, y0, x1, y1 in pixels, the last included) and pixels of each node that is seen."""
        found = []
        for node in numpy.unique(self.node[self.node > 0]):
            rows, columns = numpy.nonzero(self.node == node)
            found.append({"node": int(node), "class": self.class_names[self.class_index[rows[0], columns[0]]],
                          "box": (int(columns.min()), int(rows.min()), int(columns.max()), int(rows.max())), "pixels": len(rows)})
        return found

    def __repr__(self) -> str:
        return f"<truth of {self.node.shape}: {', '.join(n for n in self.class_names if n) or 'nothing'}>"

    def _repr_png_(self) -> bytes | None:
        if self.node.ndim != 2:
            return None
        return _display.png(_display.image_pixels(numpy.where(numpy.isinf(self.range_m), numpy.nan, self.range_m)))


class Sensor:
    """A simulated channel of a rig, whose samples are taken one by one; the world stays open between them.

        camera = rigor.Sensor("demo", "right", seed=7)
        picture, truth = camera.sense(at=2.0)

    joints: of the world, degrees by name. ideal: without the sensor's errors; only: of its effects these alone. renderer: "rays"
    or "raster" in place of the rig's. truth=False: samples come without. Raises BadInput, NotFound, Unavailable.
    """

    def __init__(self, rig, channel: str, *, seed: int | None = None, set: Mapping[str, object] | None = None,
                 joints: Mapping[str, float] | None = None, ideal: bool = False, only: Sequence[str] = (), renderer: str = "",
                 truth: bool | None = None):
        options = {"channel": channel, "joints_deg": list((joints or {}).items()), "ideal": ideal, "only": list(only),
                   "renderer": renderer, "truth": truth is not False}
        try:
            self._probe = _rigor.Probe(os.fspath(rig), rig_options(set, seed, duration_s=1.0), options)
        except ValueError as error:
            # Inertial units, receivers and odometry know no truth; who did not ask for it gets the sample alone.
            if truth is not None or getattr(error, "where", "") != "--truth":
                raise
            options["truth"] = False
            self._probe = _rigor.Probe(os.fspath(rig), rig_options(set, seed, duration_s=1.0), options)
        self.channel, self.kind = channel, self._probe.kind

    def sample(self, at: float = 0.0) -> tuple[Sample, Truth | None]:
        """The sample of a virtual run at that instant (s), with stamps and settings, and the truth."""
        record, content, truth, directions = self._probe.capture(float(at))
        port = type("Port", (), {"names": ()})
        sample = read(record, content, port)
        sample.directions = directions  # of a range image: each pixel's ray in the sensor's frame, (height, width, 3)
        return sample, None if truth is None else Truth(truth)

    def sense(self, at: float = 0.0):
        """The array of `sample(at)`, and the truth. Of imu, nav_fix and odometry the sample in place of an array."""
        sample, truth = self.sample(at)
        return (sample.array() if self.kind in ("image", "range_image", "point_cloud") else sample), truth

    @property
    def renderer(self) -> str:
        """What measures, in words."""
        return self._probe.renderer

    def __repr__(self) -> str:
        return f"<sensor {self.channel}: {self.kind}>"


def sense(rig, channel: str, at: float = 0.0, *, seed: int | None = None, set: Mapping[str, object] | None = None, **how):
    """One sample of a simulated channel, and what a perfect sensor would have known: (array, Truth).

    at: s since the start; the world stands as at the start, with `joints=` in degrees by name. `how`: as Sensor has it. Pictures
    are (height, width[, 3]), range images (2, height, width): range [m] and amplitude, clouds structured arrays (n,).
    """
    return Sensor(rig, channel, seed=seed, set=set, **how).sense(at)
