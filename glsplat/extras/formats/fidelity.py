"""Measure the differences between a file and the splats that were saved in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats import registry
from glsplat.io.files import Source
from glsplat.splats import SH_C0, Splats

_CHUNK = 1 << 14  # splats compared at a time
_ROUNDING = 1e-6  # of a coordinate; float32 has 1.2e-7


@dataclass(frozen=True)
class Error:
    """The largest and the mean difference of one attribute, over all splats that could be compared."""

    largest: float
    mean: float

    def __str__(self) -> str:
        return f"{self.largest:.2g} ({self.mean:.2g})"


@dataclass(frozen=True)
class Fidelity:
    """Differences between the splats of a scene and of its file.

    Splats that are finite and have a rotation on both sides are compared. ``saved`` and ``found`` are their numbers.
    """

    saved: int
    found: int
    positions: Error  # metres
    rounded: bool  # no position differs by more than rounding to float32 where the splat is
    scales: Error  # percent of the largest of the splat's three; a sign does not count
    rotations: Error  # degrees of the rotation between them
    colours: Error  # of 255 levels: the colour of SH degree 0, the worst channel, negative ones drawn as 0
    view: Error  # of 255 levels: SH of degree 1 and above, RMS over directions, worst channel
    opacities: Error  # in [0, 1], clamped

    def words(self) -> Iterator[str]:
        """Yield a phrase for each difference that is larger than rounding to float32."""
        if self.found != self.saved:
            yield f"{self.saved - self.found} of {self.saved} splats are not there"
        for name, unit, error, rounding in (
            ("positions", "m", self.positions, np.inf if self.rounded else 0),
            ("scales", "%", self.scales, 1e-3),
            ("rotations", "degrees", self.rotations, 1e-3),
            ("colours", "levels of 255", self.colours, 1e-2),
            ("view-dependent colours", "levels", self.view, 1e-2),
            ("opacities", "", self.opacities, 1e-5),
        ):
            if error.largest > rounding:
                yield f"{name} {error} {unit}".rstrip()


def read_back(scene: Splats | Avatar, path: Source) -> Fidelity:
    """Compare ``scene`` with the file at ``path`` in which it was saved. Raises FormatError."""
    name = registry.recognise(path)
    order = registry.all_formats()[name].order
    saved = splats_of(scene)
    return fidelity(saved, splats_of(registry.load_splats(path, format=name)), None if order is None else order(saved))


def fidelity(saved: Splats, found: Splats, order: NDArray[np.intp] | None = None) -> Fidelity:
    """Return the differences between ``saved`` and the splats ``found`` in its file.

    Splat i of the file is splat ``order[i]`` of those saved (Format.order), or splat i without an order. Raises
    FormatError if the file has another number of splats than ``saved`` or ``order``.
    """
    if len(found) != (len(saved) if order is None else len(order)):
        expected = len(saved) if order is None else len(order)
        raise FormatError(f"{len(found)} splats were read back, not the {expected} that were written")
    sums: dict[str, list[tuple[float, float, int]]] = {name: [] for name in _MEASURES}
    rounded = True
    for at in range(0, len(found), _CHUNK):
        rows = np.arange(at, min(at + _CHUNK, len(found)))
        a, b = saved.take(rows if order is None else order[rows]), found.take(rows)
        usable = a.finite() & b.finite() & a.quats.any(axis=1) & b.quats.any(axis=1)
        a, b = a.take(usable), b.take(usable)
        for name, measure in _MEASURES.items():
            off = measure(a, b)
            sums[name].append((float(off.max(initial=0)), float(off.sum()), len(off)))
        # relative to each splat's own position: a far one would hide errors of the near ones
        rounded &= bool((np.abs(b.means.astype(np.float64) - a.means) <= _ROUNDING * np.abs(a.means) + 1e-12).all())
    errors = {}
    for name, parts in sums.items():
        count = sum(part[2] for part in parts)
        total = sum(part[1] for part in parts)
        errors[name] = Error(max((part[0] for part in parts), default=0.0), total / count if count else 0.0)
    return Fidelity(len(saved), len(found), rounded=rounded, **errors)


def _positions(a: Splats, b: Splats) -> F64:
    return np.linalg.norm(b.means.astype(np.float64) - a.means, axis=1)


def _scales(a: Splats, b: Splats) -> F64:
    before, after = np.abs(a.scales.astype(np.float64)), np.abs(b.scales.astype(np.float64))
    off, largest = np.abs(after - before).max(axis=1, initial=0), before.max(axis=1, initial=0)
    return 100 * np.divide(off, largest, out=np.zeros_like(off), where=largest > 0)


def _rotations(a: Splats, b: Splats) -> F64:
    before, after = a.quats.astype(np.float64), b.quats.astype(np.float64)
    apart = np.minimum(np.linalg.norm(after - before, axis=1), np.linalg.norm(after + before, axis=1))
    return np.degrees(4 * np.arcsin(np.minimum(apart / 2, 1)))  # exact for small angles, where a cosine is not


def _colours(a: Splats, b: Splats) -> F64:
    before, after = (np.maximum(s.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0) for s in (a, b))
    return 255 * np.abs(after - before).max(axis=1, initial=0)


def _view(a: Splats, b: Splats) -> F64:
    coefficients = max(a.sh.shape[1], b.sh.shape[1])
    before, after = (np.zeros((len(a), coefficients, 3)) for _ in range(2))
    before[:, : a.sh.shape[1]], after[:, : b.sh.shape[1]] = a.sh, b.sh
    # the basis is orthonormal over the sphere, whose area is 4 pi
    power = ((after - before)[:, 1:] ** 2).sum(axis=1) / (4 * np.pi)
    return 255 * np.sqrt(power).max(axis=1, initial=0)


def _opacities(a: Splats, b: Splats) -> F64:
    return np.abs(np.clip(b.opacities.astype(np.float64), 0, 1) - np.clip(a.opacities, 0, 1))


_MEASURES: dict[str, Callable[[Splats, Splats], F64]] = {
    "positions": _positions,
    "scales": _scales,
    "rotations": _rotations,
    "colours": _colours,
    "view": _view,
    "opacities": _opacities,
}
