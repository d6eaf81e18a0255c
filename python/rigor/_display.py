"""Pictures and tables for notebooks; nothing but NumPy is needed."""
from __future__ import annotations

import base64
import html
import struct
import zlib

import numpy


def png(pixels: numpy.ndarray) -> bytes:
    """A PNG file of uint8 pixels, (height, width) grey or (height, width, 3) RGB."""
    height, width = pixels.shape[:2]
    colour = 2 if pixels.ndim == 3 else 0
    rows = numpy.ascontiguousarray(pixels, "u1").reshape(height, -1)
    lines = numpy.concatenate([numpy.zeros((height, 1), "u1"), rows], axis=1)

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(lines.tobytes(), 4)) + chunk(b"IEND", b""))


def colours(values: numpy.ndarray, low: float, high: float) -> numpy.ndarray:
    """Blue (low) over green to red (high) as uint8 RGB; what is not finite is black."""
    t = numpy.clip((numpy.nan_to_num(values, nan=low, posinf=high, neginf=low) - low) / max(high - low, 1e-12), 0, 1)
    rgb = numpy.stack([numpy.clip(1.5 - numpy.abs(4 * t - c), 0, 1) for c in (3, 2, 1)], axis=-1)
    return (255 * rgb * numpy.isfinite(values)[..., None]).astype("u1")


def image_pixels(image: numpy.ndarray, bits: int = 8) -> numpy.ndarray:
    """Pixels for people: 8 bits, grey or RGB. Floats go from blue to red over their range."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.dtype.kind == "f":
        finite = image[numpy.isfinite(image)]
        low, high = (numpy.percentile(finite, [1, 99]) if finite.size else (0.0, 1.0))
        return colours(image, float(low), float(high))
    if image.dtype.itemsize > 1:
        image = (image >> max(bits - 8, 0)).clip(0, 255)
    return image.astype("u1")[..., :3] if image.ndim == 3 else image.astype("u1")


def cloud_pixels(x: numpy.ndarray, y: numpy.ndarray, size: int = 480) -> tuple[numpy.ndarray, float]:
    """A cloud from above, x up and y to the left, and how many metres it is from the middle to the edge."""
    keep = numpy.isfinite(x) & numpy.isfinite(y)
    x, y = numpy.asarray(x)[keep], numpy.asarray(y)[keep]
    edge = float(numpy.percentile(numpy.hypot(x, y), 99)) * 1.05 if x.size else 1.0
    edge = max(edge, 1e-3)
    picture = numpy.zeros((size, size), "u1")
    row = ((1 - x / edge) * size / 2).astype(int)
    column = ((1 - y / edge) * size / 2).astype(int)
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    picture[row[inside], column[inside]] = 255
    picture[size // 2 - 1:size // 2 + 2, size // 2 - 1:size // 2 + 2] = 128
    return picture, edge


def picture_html(data: bytes, caption: str) -> str:
    return (f'<figure style="margin:0"><img style="image-rendering:pixelated;max-width:100%" src="data:image/png;base64,'
            f'{base64.b64encode(data).decode()}"><figcaption>{html.escape(caption)}</figcaption></figure>')


def table_html(head: list[str], rows: list[list]) -> str:
    def cells(values, tag):
        return "".join(f"<{tag}>{html.escape(str(v))}</{tag}>" for v in values)
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<table><thead><tr>{cells(head, 'th')}</tr></thead><tbody>{body}</tbody></table>"
