"""What light_error.py and range_error.py share: files of references and of times, PNG files."""
import json
import struct
import sys
import zlib

import numpy as np


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def passes_of(folder, stem, turned=""):
    """The passes of a reference as one array, pass by pass: STEM-reference-N.npy, N from 0 on."""
    files = sorted(folder.glob(f"{stem}-reference-*{turned}.npy"))
    files = [f for f in files if f.stem.endswith("-turned") == bool(turned)]
    if len(files) < 2:
        sys.exit(f"{folder} has {len(files)} passes of {stem}{turned}, expected at least 2: --reference 2 makes them")
    return np.stack([np.load(f).astype(float) for f in files])


def store(folder, stem, content):
    """A small file of arrays and numbers. Its size in KiB."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{stem}.npz"
    np.savez_compressed(file, **content)
    return file, file.stat().st_size / 1024


def runs_of(folder):
    """The runs in all JSON files that benches left in a folder."""
    found = [json.loads(file.read_text()) for file in sorted(folder.glob("*.json"))]
    return [run for bench in found if isinstance(bench, dict) for run in bench.get("runs") or []]


def png(file, rgb):
    """8-bit values, height x width x 3."""
    h, w, _ = rgb.shape
    rows = b"".join(b"\0" + rgb[y].astype(np.uint8).tobytes() for y in range(h))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", w, h, 8, 2, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))
