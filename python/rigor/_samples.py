"""Samples of channels, from recordings, rigs and single captures alike."""
from __future__ import annotations

import numpy
import rigor_client

from . import _display

#: NumPy type of the points of Rigor's clouds: metres in the sensor's frame (x forward, y left, z up).
POINT = numpy.dtype(rigor_client.POINT)

_BITS = {"Mono10": 10, "BayerRG10": 10, "Mono12": 12, "BayerRG12": 12, "Mono16": 16, "BayerRG16": 16, "Coord3D_C16": 16}


class Sample(rigor_client.Sample):
    """One sample of a channel: stamps on the bench clock (int64 ns) and values by their kind, as attributes.

    sequence, t_capture_ns, t_release_ns, t_arrival_ns, sigma_capture_ns, lost_before, validity (0: good), and the attributes
    that `rigor_client.Sample` lists for each kind. `array()` gives pictures, range images and clouds.
    """
    message = None  #: the message of ROS 2 that it comes from, in a recording

    def _repr_png_(self) -> bytes | None:
        if self.kind == "image":
            return _display.png(_display.image_pixels(self.array(), _BITS.get(getattr(self, "format", ""), 8)))
        if self.kind == "range_image":
            return _display.png(_display.image_pixels(self.array()[0]))
        if self.kind == "point_cloud":
            names = self.array().dtype.names
            x, y = ("x_m", "y_m") if "x_m" in names else ("x", "y")
            return _display.png(_display.cloud_pixels(self.array()[x], self.array()[y])[0])
        return None

    def _repr_html_(self) -> str:
        picture = self._repr_png_()
        if picture is not None:
            return _display.picture_html(picture, repr(self))
        hidden = ("kind", "bytes", "message")
        return _display.table_html([repr(self), ""], [[k, v] for k, v in self.__dict__.items() if k not in hidden])


def read(record: bytes, content, port) -> Sample:
    """From a record of the application protocol and its content."""
    _, kind, *head, _, _, info_bytes, _ = rigor_client._SAMPLE_HEAD.unpack_from(record)
    sample = Sample(rigor_client._KINDS[kind], head, content)
    at = rigor_client._SAMPLE_HEAD.size
    rigor_client._read_info(sample, port, memoryview(record)[at:at + info_bytes])
    return sample
