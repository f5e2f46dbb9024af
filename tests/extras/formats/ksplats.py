"""A writer of KSPLAT files for the tests, from the description of the format alone."""

from __future__ import annotations

import struct

import numpy as np

from glsplat.splats import Splats

C0 = 0.28209479177387814
RANGE = 32767


def ksplat(
    sections: list[Splats], level: int, *, bucket: int = 4, block: float = 2.0, sh: tuple[float, float] = (-1.5, 1.5)
) -> tuple[bytes, list[Splats]]:
    """The file, and its sections in the order in which they were written."""
    heads, bodies, written = [], [], []
    for splats in sections:
        full, partial = _buckets(splats.means, bucket, block)
        order = np.array([i for members in [*full, *partial] for i in members], int)
        if level == 0:
            full, partial, order = [], [], np.arange(len(splats))
        moved = splats.take(order)
        middles = [(np.floor(splats.means[m[0]] / block) + 0.5) * block for m in [*full, *partial]]
        lengths = np.array([len(members) for members in partial], "<u4")
        sizes = np.array([len(m) for m in [*full, *partial]], int)
        centres = np.repeat(np.array(middles).reshape(-1, 3), sizes, axis=0)
        body = lengths.tobytes() + np.array(middles, "<f4").tobytes() + _records(moved, level, centres, block, sh)
        head = bytearray(1024)
        struct.pack_into("<IIII", head, 0, len(moved), len(moved), bucket, len(middles))
        struct.pack_into("<fHxxIIII", head, 16, block, 12, RANGE, len(body), len(full), len(partial))
        struct.pack_into("<H", head, 40, moved.sh_degree)
        heads.append(bytes(head))
        bodies.append(body)
        written.append(moved)
    count = sum(map(len, written))
    head = bytearray(4096)
    struct.pack_into("<BBxxIIIIH", head, 0, 0, 1, len(sections), len(sections), count, count, level)
    struct.pack_into("<ff", head, 36, *sh)
    return b"".join([bytes(head), *heads, *bodies]), written


def _buckets(means: np.ndarray, size: int, block: float) -> tuple[list[list[int]], list[list[int]]]:
    """Indices of the splats of each full and each partly filled bucket: at most ``size`` of one cell."""
    cells: dict[tuple[int, ...], list[int]] = {}
    full = []
    for i, mean in enumerate(means):
        members = cells.setdefault(tuple(np.floor(mean / block).astype(int)), [])
        members.append(i)
        if len(members) == size:
            full.append(cells.pop(tuple(np.floor(mean / block).astype(int))))
    return full, list(cells.values())


def _records(splats: Splats, level: int, centres: np.ndarray, block: float, sh: tuple[float, float]) -> bytes:
    floats = "<f4" if level == 0 else "<f2"
    out = []
    for i in range(len(splats)):
        if level == 0:
            out.append(splats.means[i].astype("<f4").tobytes())
        else:
            steps = np.rint((splats.means[i].astype(float) - centres[i]) * (RANGE / (block / 2))) + RANGE
            out.append(np.clip(steps, 0, 2 * RANGE + 1).astype("<u2").tobytes())
        out += [splats.scales[i].astype(floats).tobytes(), splats.quats[i].astype(floats).tobytes()]
        rgba = [*(splats.sh[i, 0] * C0 + 0.5), splats.opacities[i]]
        out.append(bytes(int(np.clip(round(float(v) * 255), 0, 255)) for v in rgba))
        for first, stop in ((1, 4), (4, 9)):  # degree by degree, and in a degree red, green, blue
            if splats.sh.shape[1] >= stop:
                own = splats.sh[i, first:stop].T.reshape(-1).astype(float)
                if level == 2:
                    codes = np.floor((np.clip(own, *sh) - sh[0]) / (sh[1] - sh[0]) * 255)
                    out.append(codes.astype(np.uint8).tobytes())
                else:
                    out.append(own.astype(floats).tobytes())
    return b"".join(out)
