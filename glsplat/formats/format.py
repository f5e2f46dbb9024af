"""What a file format is to the rest of the house. Each format's module has one of these; __init__.py lists them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.consent.canonical import CONSENT
from glsplat.formats.files import Source, sampled
from glsplat.splats import Splats
from glsplat.views import splats_of

__all__ = ["Format", "Start", "clamped_opacities", "hidden", "positive_scales"]


_PLACED = 1e-3  # metres, or of an axis


@dataclass(frozen=True, eq=False)
class Start:
    """What recognising a file goes by."""

    head: bytes  # the first 512 bytes; empty where the file is
    size: int
    named: bool  # whether the name ends in one of the format's suffixes
    file: BinaryIO

    @property
    def text(self) -> bool:
        """Whether the head may be text: no control characters but tabs and line ends."""
        return not any(byte < 32 and byte not in b"\t\n\r" for byte in self.head)

    def spread(self) -> bytes:
        """The file, or of a large one blocks spread evenly over it (files.sampled)."""
        return sampled(self.file, 0, self.size)


def _nothing(_: Splats | Avatar) -> Iterator[str]:
    return iter(())


@dataclass(frozen=True, eq=False)
class Format:
    """One file format: how it is called, recognised, read and written.

    ``load`` gets an open file at its start, its size, and the folder of its other files (None where it has none);
    ``save`` a scene and where it goes (files.replace_file writes), and is None where a format is read only. Both raise
    FormatError. ``loses`` says, a sentence each, what a saved file does not keep of a scene, rounding apart; that a
    rig, visibility cones or levels are dropped is said already where ``rigs``, ``cones`` or ``levels`` is False.
    ``order`` says which splats of a scene a file has, in the order it has them in, for a format that does not have all
    as they come.
    """

    name: str  # as ``format=`` takes it
    title: str  # as messages say it
    suffixes: tuple[str, ...]  # lower case, with the dot, or "meta.json"; the first is the usual, the longest counts
    sniff: Callable[[Start], bool]
    load: Callable[[BinaryIO, int, Path | None], Splats | Avatar]
    save: Callable[[Splats | Avatar, Source], None] | None
    loses: Callable[[Splats | Avatar], Iterator[str]] = _nothing
    rigs: bool = False  # holds avatars
    cones: bool = False  # holds visibility cones
    levels: bool = False  # holds levels of detail
    order: Callable[[Splats], NDArray[np.intp]] | None = None
    marked: bool = True  # begins with a mark of its own; formats without one are tried last

    def losses(self, scene: Splats | Avatar) -> Iterator[str]:
        """What a file of this format does not keep of ``scene``, beyond rounding, a sentence each."""
        if isinstance(scene, Avatar) and not self.rigs:
            pose = (
                "zero pose" if _bound_at_rest(scene) else "pose it was bound in (glsplat avatar export writes others)"
            )
            yield f"the rig of {len(scene.skeleton)} joints is dropped, the file holds the {pose}"
            if scene.shapes is not None:
                yield f"the {len(scene.shapes)} shapes of the face are dropped"
            if isinstance(scene.meta.get(CONSENT), dict):
                yield "the signed consent is dropped, only a .glb carries one"
        if splats_of(scene).cones is not None and not self.cones:
            yield "the visibility cones are dropped"
        if scene.levels and not self.levels:
            count = len(scene.levels)
            yield f"{count} coarser level{'s' if count > 1 else ''} of detail dropped, the file holds the finest"
        yield from self.loses(scene)


def _bound_at_rest(avatar: Avatar) -> bool:
    """Whether the splats as they are stored are those of the zero pose."""
    zero = avatar.skeleton.rest @ avatar.skeleton.inverse_bind
    return bool(np.abs(zero - np.eye(4)).max() < _PLACED)


def clamped_opacities(scene: Splats | Avatar) -> Iterator[str]:
    """The sentence of a format whose opacities are those between 0 and 1."""
    splats = splats_of(scene)
    outside = int((splats.drawable() & ((splats.opacities < 0) | (splats.opacities > 1))).sum())
    if outside:
        yield f"{outside} opacities outside 0 to 1 are clamped"


def hidden(which: NDArray[np.bool_]) -> Iterator[str]:
    """The sentence of a format without the numbers that keep ``which`` [N] splats from being drawn."""
    if which.any():
        yield f"{int(which.sum())} splats that are never drawn (not finite, or a zero quaternion) become transparent"


def positive_scales(scene: Splats | Avatar) -> Iterator[str]:
    """The sentence of a format whose scales have no sign."""
    with np.errstate(invalid="ignore"):
        negative = int((splats_of(scene).scales < 0).any(axis=1).sum())
    if negative:
        yield f"{negative} splats with negative scales are written with positive ones (their shape is the same)"
