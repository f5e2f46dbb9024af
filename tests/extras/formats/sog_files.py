"""SOG files for the tests, made by hand and not by the writer."""

from __future__ import annotations

import json
import zipfile
from io import BytesIO
from typing import Any

import numpy as np

from glsplat.extras.formats.sog.package import encoded


def webp(pixels: Any, width: int = 2, height: int = 2) -> bytes:
    """Rows of RGBA (RGB: opaque), the rest opaque black."""
    image = np.zeros((width * height, 4), np.uint8)
    image[:, 3] = 255
    rows = np.array(pixels, np.uint8)
    image[: len(rows), : rows.shape[1]] = rows
    return encoded(image.reshape(height, width, 4))


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    out = BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return out.getvalue()


def by_hand(version: int = 2) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Two splats of degree 1, with numbers that can be followed."""
    book = [0.0] * 256
    meta: dict[str, Any] = {
        "means": {"mins": [-1, 0, 0], "maxs": [1, 2, 0], "files": ["means_l.webp", "means_u.webp"]},
        "quats": {"files": ["quats.webp"]},
        "scales": {"files": ["scales.webp"]},
        "sh0": {"files": ["sh0.webp"]},
        "shN": {"files": ["shN_centroids.webp", "shN_labels.webp"]},
    }
    if version == 2:
        meta |= {"version": 2, "count": 2, "asset": {"generator": "a test"}}
        meta["scales"]["codebook"] = [-1.0, -2.0, -3.0, *book[3:]]
        meta["sh0"]["codebook"] = [0.5, 0.25, -0.5, *book[3:]]
        meta["shN"] |= {"count": 65, "bands": 1, "codebook": [0.0, 0.125, -0.125, *book[3:]]}
    else:
        meta["means"]["shape"] = [2, 3]
        meta["scales"] |= {"mins": [-1, -2, -3], "maxs": [-1, -2, -1]}
        meta["sh0"] |= {"mins": [0, 0, 0, -2], "maxs": [1, 2, 0, 2]}
        meta["shN"] |= {"mins": -1, "maxs": 1}
    palette = np.zeros((64 * 2 * 3, 3), np.uint8)
    palette[0:3] = [[1, 2, 0], [0, 1, 2], [2, 2, 2]]  # the three coefficients of set 0
    palette[63 * 3 : 64 * 3] = 2
    palette[64 * 3 : 64 * 3 + 3] = [[0, 0, 1], [0, 0, 0], [1, 0, 0]]  # of set 64: the first of the second row
    files = {
        # x: 0xFFFF and 0x8000 of 65535 between -1 and 1, y: 0 and 0xFFFF between 0 and 2
        "means_l.webp": webp([[255, 0, 0], [0, 255, 0]]),
        "means_u.webp": webp([[255, 0, 0], [128, 255, 0]]),
        # (w x y z) the largest is w, all others nearly 0; the largest is y, w at its most
        "quats.webp": webp([[128, 128, 128, 252], [255, 128, 128, 254]]),
        "scales.webp": webp([[0, 1, 2], [2, 2, 2]]),
        "sh0.webp": webp([[0, 1, 2, 255], [2, 2, 2, 51]]),
        "shN_centroids.webp": webp(palette, 64 * 3, 2),
        "shN_labels.webp": webp([[0, 0, 0], [64, 0, 0]]),
    }
    return meta, files


def pack(meta: dict[str, Any], files: dict[str, bytes], **more: bytes) -> bytes:
    return zipped({"meta.json": json.dumps(meta).encode(), **files, **more})
