"""What makes an avatar from pictures of a person: the interface, so that the built-in way can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.people import DetectedPerson
from glsplat.meshes import RiggedMesh

if TYPE_CHECKING:
    from glsplat.extras.authoring.fit.body_fit import BodyFit

__all__ = [
    "FittedBody",
    "MadeAvatar",
    "Mask",
    "MeshReconstructor",
    "Options",
    "Picture",
    "Progress",
    "Reconstructor",
    "ReportingReconstructor",
]

Mask = NDArray[np.bool_]
Progress = Callable[[str, float], None]
"""Called with the name of a step and the share of it that is done."""


_HEIGHTS = 0.5, 2.5  # metres
_LEAST_SPLATS, _MOST_SPLATS = 100, 2_000_000
_TEXELS = 256, 8192  # a side


def _silent(step: str, done: float) -> None: ...


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph of the person, upright."""

    rgb: NDArray[np.uint8]  # [H, W, 3] sRGB
    focal: float | None = None  # pixels; None where nobody knows
    person: DetectedPerson | None = None  # what the networks read; None where they have not been asked


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What is wanted of an avatar. Raises FormatError for what nobody can want."""

    height: float | None = None  # metres, without shoes; None where nobody said
    splats: int = 40_000
    seed: int = 0
    steps: int = 400  # of fitting the splats to pictures; 0: none
    texture: int = 2048  # texels a side, where a mesh is made
    keep_light: bool = False  # of the photographs in the colours, and nothing said of it: never lit again
    progress: Progress = _silent

    def __post_init__(self) -> None:
        if self.height is not None and not _HEIGHTS[0] <= self.height <= _HEIGHTS[1]:
            metres = self.height / 100
            hint = f"; is it {metres:.2f}?" if _HEIGHTS[0] <= metres <= _HEIGHTS[1] else ""
            raise FormatError(f"a height needs metres, {_HEIGHTS[0]} to {_HEIGHTS[1]}, not {self.height:g}{hint}")
        if not _LEAST_SPLATS <= self.splats <= _MOST_SPLATS:
            raise FormatError(f"an avatar needs {_LEAST_SPLATS} to {_MOST_SPLATS} splats, not {self.splats}")
        if not _TEXELS[0] <= self.texture <= _TEXELS[1]:
            raise FormatError(f"a texture needs {_TEXELS[0]} to {_TEXELS[1]} texels a side, not {self.texture}")
        if self.steps < 0 or self.seed < 0:
            name = "steps" if self.steps < 0 else "seed"
            raise FormatError(f"{name} needs 0 or more, not {getattr(self, name)}")


class Reconstructor(Protocol):
    """Makes an avatar from pictures. Others add theirs as entry points of the group ``glsplat.reconstructors``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """An avatar on the 55 joints of SMPL-X, in the zero pose, metres, soles on y = 0, facing +z.

        ``pictures`` by the side of the person that they show: always ``front``, perhaps ``back``, ``left``, ``right``;
        ``masks`` [H, W] by the same names, true on the person. Raises GlsplatError in one line.
        """
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedBody:
    """The fitted body, and how well the pictures show it."""

    fit: BodyFit
    mesh: RiggedMesh  # the dressed body in the zero pose; white, unless a mesh was asked for
    unseen: float  # share of the surface that no picture shows
    seen: NDArray[np.float64]  # [V] of its vertices, from 0 guessed to 1 seen squarely
    problem: str  # one line, or empty


@dataclass(frozen=True, eq=False, kw_only=True)
class MadeAvatar(FittedBody):
    """An avatar, and how it came about."""

    avatar: Avatar


@runtime_checkable
class ReportingReconstructor(Protocol):
    """A reconstructor that can say how its avatar came about."""

    def tell(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> MadeAvatar:
        """As ``reconstruct``, with all that led to the avatar."""
        ...


@runtime_checkable
class MeshReconstructor(Protocol):
    """A reconstructor that can make a textured mesh in place of splats."""

    def mesh(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> FittedBody:
        """As ``reconstruct``; what is asked for is ``FittedBody.mesh``."""
        ...
