"""Labelled samples of a rig's simulated sensors, one by one or as a folder."""
from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy
import rigor_client

from . import _display, _rigor
from ._errors import BadInput
from ._rig import set_texts
from ._samples import POINT
from ._sense import Truth


class View:
    """What one channel saw in a sample.

    channel, kind ("image", "range_image", "point_cloud"), device (which draw of `draw_devices`), T_world_sensor (4, 4), lens: of
    pictures and range images a dictionary fx_px, fy_px, cx_px, cy_px, else None.

    array: pixels (height, width[, 3]); range images (2, height, width): range [m] and amplitude, NaN: no return; clouds a structured
    array (n,) of `rigor.POINT`. With truth, per pixel (height, width) or point (n,): truth (a Truth, as rigor.sense has it), depth_m
    (float32, along the optical axis, inf: nothing), category (uint8, id of the class in Dataset.categories, 0: none), instance
    (uint16, from 1; 0: none), and instances: dictionaries id, node, name, category, class, box (x, y, width, height), area_px,
    cut_off, median_depth_m. Without truth they are None and [].
    """

    def __init__(self, channel: str, values: dict):
        self.channel, self.kind, self.device = channel, values["kind"], values["device"]
        self.T_world_sensor, self.lens = values["T_world_sensor"], values["lens"]
        self.depth_m, self.category, self.instance = values["depth_m"], values["category"], values["instance"]
        self.instances = values["instances"]
        self.truth = None if values["truth"] is None else Truth(values["truth"])
        if self.kind == "image":
            kind, each = rigor_client._PIXELS[values["format"]]
            shape = (values["height"], values["width"]) + ((each,) if each > 1 else ())
            self.array = values["bytes"].view(kind).reshape(shape)
        elif self.kind == "range_image":
            self.array = numpy.stack([values["range_m"], values["amplitude"]])
        else:
            self.array = values["bytes"].view(POINT)

    def __repr__(self) -> str:
        return f"<{self.kind} of {self.channel}: {self.array.shape}, {len(self.instances)} things>"

    def _repr_png_(self) -> bytes | None:
        if self.kind == "point_cloud":
            return _display.png(_display.cloud_pixels(self.array["x_m"], self.array["y_m"])[0])
        return _display.png(_display.image_pixels(self.array if self.kind == "image" else self.array[0]))


class DatasetSample(Mapping):
    """One sample: views by channel, `sample["right"]`.

    index, split ("train", "val", "test"), T_world_carrier (4, 4), conditions: what `vary` chose, texts by key; rejected: poses that
    were tried before, as (position (3,), reason, detail).
    """

    def __init__(self, values: dict):
        self.index, self.split, self.T_world_carrier = values["index"], values["split"], values["T_world_carrier"]
        self.conditions, self.rejected = values["conditions"], values["rejected"]
        self._views = {channel: View(channel, view) for channel, view in values["views"].items()}

    def __getitem__(self, channel: str) -> View:
        return self._views[channel]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    def __repr__(self) -> str:
        return f"<sample {self.index} ({self.split}): {', '.join(self._views) or 'left out'}>"


def _number(value) -> str:
    return repr(float(value)).removesuffix(".0")


def _interval(value) -> str:
    """A number, (from, to), or text as the command takes it."""
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, Sequence):
        return "..".join(map(_number, value))
    return _number(value)


def _values(value) -> str:
    """(from, to) of numbers is a range; a list is a choice; text is taken as the command takes it."""
    if isinstance(value, str):
        return value
    if isinstance(value, tuple) and len(value) == 2 and not any(isinstance(v, str) for v in value):
        return _interval(value)
    return ",".join(str(v) for v in (value if isinstance(value, (list, tuple)) else [value]))


def _pose_file(poses: numpy.ndarray) -> str:
    """A CSV file with the rows of an array (n, 7): x, y, z of the world [m], and the quaternion w, x, y, z."""
    poses = numpy.asarray(poses, float)
    if poses.ndim != 2 or poses.shape[1] != 7 or not len(poses):
        raise BadInput("poses", f"expected rows x, y, z, qw, qx, qy, qz, got an array {poses.shape}")
    handle, name = tempfile.mkstemp(prefix="rigor-poses-", suffix=".csv")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write("x_m,y_m,z_m,qw,qx,qy,qz\n")
        file.writelines(",".join(repr(float(v)) for v in row) + "\n" for row in poses)
    return name


class Dataset(Sequence):
    """Labelled samples of a rig; see `rigor.dataset`. A sequence: `dataset[7]` is made when it is asked for, and always the same.

    `torch.utils.data.DataLoader` takes it: it has a length, items by number, and is opened afresh in each worker's process.
    channels: (name, kind, whether each sample has another device) each; categories: dictionaries id, name, base, thing.
    """

    def __init__(self, texts: dict, poses=None):
        self._given = (texts, poses)
        texts, made = dict(texts), None
        if poses is not None:
            texts["poses"] = made = _pose_file(poses)
        try:
            self._dataset = _rigor.Dataset(texts)
        finally:
            if made:
                os.unlink(made)
        self.channels, self.categories = self._dataset.channels(), self._dataset.categories()

    def __reduce__(self):
        return Dataset, self._given

    def __len__(self) -> int:
        return self._dataset.size()

    def __getitem__(self, index):
        """A DatasetSample; `len(sample) == 0`: all its poses were rejected. A slice gives a list."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = index.__index__()
        if not -len(self) <= index < len(self):
            raise IndexError(f"expected a sample below {len(self)}, got {index}")
        return DatasetSample(self._dataset.sample(index % len(self)))

    def __iter__(self) -> Iterator[DatasetSample]:
        """Samples in their order, without those that are left out."""
        for index in range(len(self)):
            sample = self[index]
            if len(sample):
                yield sample

    @property
    def manifest(self) -> dict:
        """All that makes the samples what they are: options, version, digests of the files that are read."""
        return json.loads(self._dataset.manifest())

    def save(self, folder, *, layers: Sequence[str] | None = None, exr: bool = False, min_area_px: int = 16, threads: int = 0) -> dict:
        """What `rigor dataset -o` writes: a folder of PNG, NPY or EXR and COCO annotations, or an MCAP file by the ending .mcap. One
        that was made with the same options is continued.

        layers: of truth, some of rigor.dataset.LAYERS (default: depth, instance, class). Ctrl-C ends it between two samples; what is
        whole stays. Gives counts: samples, left_out, annotations, made, there, and seconds.
        """
        return self._dataset.save(Path(folder), None if layers is None else list(layers), exr, min_area_px, threads)

    def __repr__(self) -> str:
        return f"<dataset of {len(self)} samples: {', '.join(f'{name} ({kind})' for name, kind, _ in self.channels)}>"


def dataset(rig, *, channels: Sequence[str] = (), poses=None, within: Sequence[float] | None = None, along=None,
            samples: int | None = None, height=None, yaw=None, pitch=None, roll=None, lateral=None, clearance: float | None = None,
            vary: Mapping[str, object] | None = None, draw_devices: bool = False, truth: bool | None = None, renderer: str = "",
            seed: int | None = None, split: Sequence[float] | None = None, set: Mapping[str, object] | None = None) -> Dataset:
    """Labelled samples of a rig's simulated sensors: pictures, clouds and range images, with classes, boxes, masks, depths.

        for sample in rigor.dataset("demo", channels=["right"], within=(-3, -4, 3, -2), yaw=(60, 120), samples=100,
                                    vary={"joint.turntable": (0, 360)}):
            train(sample["right"].array, sample["right"].instance)

    rig: a rig's name or file, or a dataset's file (docs/datasets.md), whose values the keywords replace. Where samples are taken: poses
    (a CSV file, or an array (n, 7): x, y, z [m], qw, qx, qy, qz of the carrier in the world), within (x0, y0, x1, y1 in metres), along
    (a CSV file of x_m,y_m), or where the rig has its sensors. height, lateral [m], yaw, pitch, roll [deg]: a number or (from, to).
    clearance: poses with anything nearer are rejected [m]. vary: values by key; a tuple of two numbers is a range, a list a choice.

    Sample k depends on these options, the rig's files and k alone. Raises BadInput, NotFound, Unavailable.
    """
    texts = {
        "source": os.fspath(rig), "poses": "", "along": "" if along is None else os.fspath(along),
        "within": "" if within is None else ",".join(map(_number, within)), "set": set_texts(set),
        "vary": [f"{key}={_values(value)}" for key, value in (vary or {}).items()],
        "channels": channels if isinstance(channels, str) else ",".join(channels), "sample": "" if samples is None else str(int(samples)), "seed": "" if seed is None else str(int(seed)),
        "height": _interval(height), "yaw": _interval(yaw), "pitch": _interval(pitch), "roll": _interval(roll),
        "lateral": _interval(lateral), "clearance": _interval(clearance),
        "split": "" if split is None else ",".join(str(v) for v in split), "renderer": renderer, "draw_devices": draw_devices,
        "truth": truth}
    if poses is None or isinstance(poses, (str, os.PathLike)):
        texts["poses"] = "" if poses is None else os.fspath(poses)
        return Dataset(texts)
    return Dataset(texts, poses)


#: Layers of truth that `Dataset.save` can write.
dataset.LAYERS = tuple(_rigor.dataset_layers)
