"""Sort on the CPU: keys to indices, far to near. gpu_sort.py has the same contract.

A key is the camera z of the sorting eye as a sortable uint32 (all 32 bits), nearest smallest; of equal keys the lower
index is the nearer, so it is drawn later. Codes above every depth are the reasons for not drawing a splat. The same
keys give the same bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.renderer.stats import Box

FIRST_CULLED = 0xFFFFFF00
CULL_REASONS = {1: "out of range", 2: "transparent", 3: "degenerate", 4: "outside", 5: "hidden"}
"""Code of project.glsl -> name in the statistics."""


def sorted_indices(keys: NDArray[np.uint32], bits: int = 32) -> NDArray[np.uint32]:
    """Return indices of the splats to draw, far to near; ``bits`` 16 sorts by the upper half of a key only."""
    visible = np.flatnonzero(keys < FIRST_CULLED).astype(np.uint32)
    if bits == 16:
        # numpy sorts 16-bit integers by radix, stable
        return visible[np.argsort((keys[visible] >> 16).astype(np.uint16), kind="stable")[::-1]]
    # key and index in one integer: distinct values, so the fast unstable sort is stable
    packed = (keys[visible].astype(np.uint64) << np.uint64(32)) | visible
    packed.sort()
    return packed.astype(np.uint32)[::-1]


def covered_box(
    tiles: NDArray[np.uint32],  # [N] of the splats that are drawn: x0, y0, x1, y1 of key.vert.glsl, a byte each
    width: int,
    height: int,
) -> Box:
    """Return the box outside of which every view shows only its background.

    With a rim of background wherever it does not reach the picture's edge (read_back.read_bytes).
    """
    if not len(tiles):
        return 0, 0, 0, 0
    # four passes over packed integers: numpy's minimum along [N, 4] bytes takes ten times as long
    x0, y0 = (tiles & 0xFF).min(), (tiles >> 8 & 0xFF).min()
    x1, y1 = (tiles >> 16 & 0xFF).max(), (tiles >> 24).max()
    left, top = max(int(x0) * width // 256 - 1, 0), max(int(y0) * height // 256 - 1, 0)
    right, bottom = min(-(-(int(x1) + 1) * width // 256) + 1, width), min(-(-(int(y1) + 1) * height // 256) + 1, height)
    return left, top, right - left, bottom - top


def count_culled(keys: NDArray[np.uint32]) -> dict[str, int]:
    """Return the number of splats that are not drawn, by reason."""
    if keys.max(initial=0) < FIRST_CULLED:
        return dict.fromkeys(CULL_REASONS.values(), 0)
    codes = np.bincount(keys[keys >= FIRST_CULLED] - np.uint32(FIRST_CULLED), minlength=6)
    return {name: int(codes[code]) for code, name in CULL_REASONS.items()}
