"""A chain of layers that works out only what a picture changes in a plain background.

A person before a background of one colour fills a third of a square. Where a layer's pixel sees nothing but background,
it is what it is for the background alone, which is worked out once a size and colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .layers import Area, Layer, Range

__all__ = ["Network"]

F32 = NDArray[np.float32]

_WORTH = 0.8  # share of the picture that may differ from the background for this to be less work


class Network:
    """Layers one after another; ``seen`` are the places of those whose outcome is asked for."""

    def __init__(self, layers: Sequence[Layer], seen: Sequence[int]) -> None:
        self._layers = tuple(layers)
        self._seen = frozenset(seen)
        self._kept: _Background | None = None

    def __call__(self, picture: F32) -> list[F32]:
        """What the layers that are asked for make of a picture [H, W, C]; the arrays are the caller's own."""
        area = _foreground(picture)
        if area and _size(area) > _WORTH * picture.shape[0] * picture.shape[1]:
            stages = self._stages(picture)
            return [stages[index + 1] for index in sorted(self._seen)]
        stages = self._background(picture)
        found, part = [], picture[_cut(area)] if area else picture
        for index, layer in enumerate(self._layers):
            if area:
                before = stages[index]
                wanted = _reach(layer, area, before)
                part = layer(_window(layer, wanted, before, part, area)) if wanted else part
                area = wanted
            if index in self._seen:
                whole = stages[index + 1].copy()
                if area:
                    whole[_cut(area)] = part
                found.append(whole)
        return found

    def _stages(self, picture: F32) -> list[F32]:
        """The picture and what each layer makes of it."""
        stages = [picture]
        for layer in self._layers:
            edge = (layer.padding, layer.padding)
            stages.append(layer(np.pad(stages[-1], (edge, edge, (0, 0)))))
        return stages

    def _background(self, picture: F32) -> list[F32]:
        """The stages of a picture of one colour all over, that of the corner."""
        key = picture.shape, picture[0, 0].tobytes()
        kept = self._kept
        if kept is None or kept.key != key:
            plain = np.ascontiguousarray(np.broadcast_to(picture[0, 0], picture.shape))
            kept = self._kept = _Background(key, self._stages(plain))
        return kept.stages


@dataclass(frozen=True, eq=False)
class _Background:
    key: tuple[tuple[int, ...], bytes]
    stages: list[F32]


def _foreground(picture: F32) -> Area | None:
    """The rectangle of what has not the colour of the corner; None where there is nothing."""
    differs = (picture != picture[0, 0]).any(axis=2)
    rows, columns = (np.flatnonzero(differs.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    return (int(rows[0]), int(rows[-1]) + 1), (int(columns[0]), int(columns[-1]) + 1)


def _size(area: Area) -> int:
    return (area[0][1] - area[0][0]) * (area[1][1] - area[1][0])


def _reach(layer: Layer, area: Area, before: F32) -> Area | None:
    """Where the layer sees any of ``area``; None where it does nowhere, such as at a border that pooling cuts off."""
    rows, columns = (layer.reach(changed, extent) for changed, extent in zip(area, before.shape[:2], strict=True))
    return (rows, columns) if rows[0] < rows[1] and columns[0] < columns[1] else None


def _window(layer: Layer, wanted: Area, before: F32, part: F32, area: Area) -> F32:
    """What ``wanted`` of the layer sees: ``part`` at ``area``, ``before`` around it, zeros around the picture."""
    sees = [layer.sees(one) for one in wanted]
    inside = [(max(0, first), min(extent, last)) for (first, last), extent in zip(sees, before.shape[:2], strict=True)]
    common = [(max(a[0], b[0]), min(a[1], b[1])) for a, b in zip(inside, area, strict=True)]
    window = before[_cut(inside)].copy()
    window[_cut(_from(common, inside))] = part[_cut(_from(common, area))]
    around = [(one[0] - all_[0], all_[1] - one[1]) for one, all_ in zip(inside, sees, strict=True)]
    return np.pad(window, (*around, (0, 0)))


def _from(ranges: Sequence[Range], origin: Sequence[Range]) -> list[Range]:
    """Ranges as they are counted within others."""
    return [(a - start, b - start) for (a, b), (start, _) in zip(ranges, origin, strict=True)]


def _cut(area: Sequence[Range]) -> tuple[slice, ...]:
    return tuple(slice(first, last) for first, last in area)
