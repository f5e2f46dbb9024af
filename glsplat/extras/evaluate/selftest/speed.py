"""Find the largest static scene that keeps a display's rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.skinning.skin import Skin

_FEWEST, _MOST = 1_000, 8_192_000  # splats
_HALVINGS = 3  # of the interval between the largest scene that keeps the rate and the smallest that does not


def frame_ms(context: Context, subject: Subject, frames: int) -> float:
    """Return the median ms of ``frames`` frames of a moving pair, 8 bit and read back, after one warm-up frame."""
    with Renderer(subject.scene, size=(subject.size, subject.size), views=2, context=context) as renderer:
        times = []
        for frame in range(frames + 1):
            renderer.render(subject.views(frame), subject.pose(frame))
            times.append(renderer.timings["total"])
    return float(np.median(times[1:]))


def largest_scene(
    context: Context, size: int = 1024, hertz: float = 72.0, frames: int = 9, tick: Callable[[str], object] = len
) -> dict[str, Any]:
    """Return the most splats whose pair of ``size``² keeps ``hertz``: {"splats" (0: none), "size", "hertz", "tried"}.

    The splats are those of the default avatar at rest, resampled to the same total area.
    """
    avatar, tried = default_avatar(), {}

    def keeps(count: int) -> bool:
        tick(f"{count:,} splats")
        scene: Avatar = resampled(avatar, count)
        tried[count] = round(frame_ms(context, Subject("", scene.splats, size), frames), 3)
        return tried[count] <= 1000 / hertz

    low, high = 0, _FEWEST
    while high <= _MOST and keeps(high):
        low, high = high, 2 * high
    for _ in range(_HALVINGS if 0 < low < _MOST else 0):
        middle = (low + high) // 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return {"splats": low, "size": size, "hertz": hertz, "tried": [[n, tried[n]] for n in sorted(tried)]}


def resampled(avatar: Avatar, count: int, seed: int = 0) -> Avatar:
    """Return the avatar with ``count`` splats of the same total area: fewer larger ones, or copies of smaller ones.

    For timing only: copies are randomly offset within their splat.
    """
    have = len(avatar.splats)
    rng = np.random.default_rng(seed)
    times = -(-count // have)
    index = np.sort(rng.permutation(have * times)[:count]) // times
    splats, shrink = avatar.splats.take(index), np.float32(np.sqrt(have / count))
    offset = splats.scales * rng.normal(0, 1, splats.scales.shape).astype(np.float32) if times > 1 else 0
    w, xyz = splats.quats[:, :1], splats.quats[:, 1:]
    turned = offset + 2 * np.cross(xyz, np.cross(xyz, offset) + w * offset) if times > 1 else 0
    moved = replace(splats, means=(splats.means + turned).astype(np.float32), scales=splats.scales * shrink)
    return Avatar(moved, avatar.skeleton, Skin(avatar.skin.joints[index], avatar.skin.weights[index]), avatar.meta)
