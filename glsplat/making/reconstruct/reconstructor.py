"""What makes an avatar from pictures of a person: the interface, so that the built-in way can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.making.networks.people import Person

__all__ = ["Mask", "Options", "Picture", "Progress", "Reconstructor"]

Mask = NDArray[np.bool_]
Progress = Callable[[str, float], None]
"""Called with the name of a step and the share of it that is done."""


def _silent(step: str, done: float) -> None: ...


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph of the person, upright."""

    rgb: NDArray[np.uint8]  # [H, W, 3] sRGB
    focal: float | None = None  # pixels; None where nobody knows
    person: Person | None = None  # what the networks read; None where they have not been asked


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What is wanted of an avatar."""

    height: float | None = None  # metres, without shoes; None where nobody said
    splats: int = 40_000
    seed: int = 0
    steps: int = 60  # of refining on the pictures; 0: none
    progress: Progress = _silent


class Reconstructor(Protocol):
    """Makes an avatar from pictures. Others add theirs as entry points of the group ``glsplat.reconstructors``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """An avatar on the 55 joints of SMPL-X, in the zero pose, metres, soles on y = 0, facing +z.

        ``pictures`` by the side of the person that they show: always ``front``, perhaps ``back``, ``left``, ``right``;
        ``masks`` [H, W] by the same names, true on the person. Raises GlsplatError in one line.
        """
        ...
