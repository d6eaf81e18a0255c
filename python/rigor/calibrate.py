"""Models of sensors fitted to recordings of real ones.

    fit = rigor.calibrate.camera("pictures/", target="chessboard:9x6:0.025")
    fit["fx_px"], fit.sigma["fx_px"], fit.covariance
    fit.save("left.yaml")

Each function takes files and folders, and the options of `rigor calibrate NAME` as keywords (`base`, `model` and `channel`
everywhere; docs/calibration.md); it uses all cores for seconds to minutes, and Ctrl-C ends it. Raises BadInput, NotFound,
ProtocolError.
"""
from __future__ import annotations

import json
import os
from pathlib import Path

import numpy

from . import _display, _rigor


class Fit:
    """What a calibration found: `fit["fx_px"]`, `names`, `values`, `sigma` (by name; inf: the data do not say), `covariance`
    ((n, n), in the order of `names`, zero rows for what was held), `warnings`, `notes`, `record_next`, `interrupted` (the best
    so far), `parts` (sensors of their own by name, as (names, values, covariance)); `dict` has all numbers."""

    def __init__(self, result):
        self._result = result
        parameters = result.parameters
        self.title, self.model = result.title, result.model
        self.names = [p[0] for p in parameters]
        self.values = {p[0]: p[1] for p in parameters}
        self.sigma = {p[0]: p[2] for p in parameters}
        self.held = [p[0] for p in parameters if p[3]]
        self.not_identifiable = [p[0] for p in parameters if not p[4]]
        self.covariance: numpy.ndarray = result.covariance
        self.warnings, self.notes, self.record_next = result.warnings, result.notes, result.record_next
        self.interrupted: bool = result.interrupted

    @property
    def parts(self) -> dict[str, tuple[list[str], list[float], numpy.ndarray]]:
        return {name: ([p[0] for p in parameters], [p[1] for p in parameters], covariance)
                for name, (parameters, covariance) in self._result.parts.items()}

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    @property
    def dict(self) -> dict:
        """Parameters, residuals, models compared, details: what `rigor calibrate --json` prints."""
        return json.loads(self._result.json())

    @property
    def text(self) -> str:
        return self._result.text()

    def html(self) -> str:
        """A page with tables and figures that needs no other file."""
        return self._result.html()

    def yaml(self) -> str:
        """The sensor model, with the section `calibration` (parameters, covariance, inputs by their SHA-256)."""
        return self._result.yaml()

    def save(self, file) -> list[str]:
        """Writes the sensor model, and those of the parts beside it; gives their names. Replaces what is there."""
        return [str(f) for f in self._result.save(Path(file))]

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        rows = [[n, f"{self.values[n]:.6g}", f"{self.sigma[n]:.2g}", "held" if n in self.held else ""] for n in self.names]
        return f"<b>{self.title}</b>" + _display.table_html(["parameter", "value", "sigma", ""], rows)


def _paths(value):
    if isinstance(value, (str, os.PathLike)):
        value = [value]
    return [Path(v) for v in value]


_LISTS = ("right", "board", "dark")
_FILES = ("base", "left_model", "right_model", "camera_model", "second_model", "targets", "looked_for_folder")


def _calibrate(what: str, inputs, options: dict) -> Fit:
    options = {name: _paths(v) if name in _LISTS else Path(v) if name in _FILES else v for name, v in options.items()}
    return Fit(_rigor.calibrate(what, {"inputs": _paths(inputs), **options}))


def camera(inputs, *, target: str, **options) -> Fit:
    """Intrinsics and lens of a camera from pictures of a board: pictures, folders, recordings, lists of corners (.vnl, with
    size="WIDTHxHEIGHT"). Pixels. Options: size, start_fx_px, all_corners, rolling_shutter, chromatic, twin, rate_hz,
    longest_gap_ms."""
    return _calibrate("camera", inputs, {"target": target, **options})


def stereo(inputs, *, target: str, **options) -> Fit:
    """Where the right of two cameras is in the frame of the left one, metres. Options: right (its pictures), right_channel, size,
    left_model, right_model (intrinsics to hold), within_ms."""
    return _calibrate("stereo", inputs, {"target": target, **options})


def lidar(inputs, *, base, **options) -> Fit:
    """Biases, angles and gains of the beams of a LiDAR, noise against remission, detection; metres and radians. Options:
    targets (surveyed walls), noise_model."""
    return _calibrate("lidar", inputs, {"base": base, **options})


def tof(inputs=(), **options) -> Fit:
    """Wiggling, offsets, noise, saturation, drift and lens of a time-of-flight camera; metres. Options: raw, board, target,
    distances, unit, amplitude_unit, noise, distance_sigma_m, period_s, window_px."""
    return _calibrate("tof", inputs, options)


def photon(inputs, **options) -> Fit:
    """Gain, noise and saturation of an image sensor by EMVA 1288; DN, electrons, seconds. Options: dark, temperature_c, bits,
    mosaic, grey, sensor_model (False: no base is needed)."""
    return _calibrate("photon", inputs, options)


def shading(inputs, *, base, **options) -> Fit:
    """Fall-off of the light towards the corners. Options: dark, black_dn, mosaic."""
    return _calibrate("shading", inputs, {"base": base, **options})


def extrinsics(inputs, *, target: str, **options) -> Fit:
    """Where a LiDAR or a time-of-flight camera is in a camera's optical frame; metres, radians. Options: camera, second,
    camera_model, second_model, rough, margin_m, sigma_m, still_m, views."""
    return _calibrate("extrinsics", inputs, {"target": target, **options})


def delay(inputs, *, first: str, second: str, **options) -> Fit:
    """By how much the stamps of one channel are off against those of another, s. Options: target, camera_model, largest_s,
    same_quantity."""
    return _calibrate("delay", inputs, {"first": first, "second": second, **options})


def pair(inputs, **options) -> Fit:
    """The sensor model with which the simulated side of a recorded pair would be its device. Options: from_s, until_s."""
    return _calibrate("pair", inputs, options)


def twin(inputs, **options) -> Fit:
    """How far the simulated side of a pair is from the real one. Options: real, simulated, tolerance_ms."""
    return _calibrate("twin", inputs, options)


def latency(inputs, *, channels=(), **options) -> list[dict]:
    """latency_ms of each channel, from the stamps of runs by the wall clock: channel, samples, p50_ns, p99_ns, max_ns, bound_ns,
    present_ns, latency_ms, set (as `set=` takes it), warnings. Options: quantile, confidence, trigger, trigger_to_capture_ms."""
    return _rigor.calibrate_latency({"inputs": _paths(inputs), "channels": list(channels), **options})
