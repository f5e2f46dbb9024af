"""The interface of reconstructors, which make avatars from pictures of a person."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.people import DetectedPerson
from glsplat.meshes import RiggedMesh

if TYPE_CHECKING:
    from glsplat.extras.authoring.fit.body_fit import BodyFit

Mask = NDArray[np.bool_]
Progress = Callable[[str, float], None]
"""Called with the name of a step and the fraction of it that is done."""


_HEIGHT_RANGE_M = 0.5, 2.5
_MIN_SPLATS, _MAX_SPLATS = 100, 2_000_000
_TEXTURE_RANGE_PX = 256, 8192


def _silent(step: str, done: float) -> None: ...


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph of the person, upright."""

    rgb: NDArray[np.uint8]  # [H, W, 3] sRGB
    focal: float | None = None  # pixels; None if unknown
    person: DetectedPerson | None = None  # detected by the networks; None: not yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of a reconstruction. Raises FormatError for values out of range."""

    height: float | None = None  # metres, without shoes; None if unknown
    splats: int = 40_000
    seed: int = 0
    steps: int = 200  # of fitting the splats to pictures; 0: none
    texture: int = 2048  # texels a side, where a mesh is made
    keep_light: bool = False  # in the colours, as photographed: the avatar is never relit
    progress: Progress = _silent

    def __post_init__(self) -> None:
        if self.height is not None and not _HEIGHT_RANGE_M[0] <= self.height <= _HEIGHT_RANGE_M[1]:
            metres = self.height / 100
            hint = f"; is it {metres:.2f}?" if _HEIGHT_RANGE_M[0] <= metres <= _HEIGHT_RANGE_M[1] else ""
            raise FormatError(
                f"a height needs metres, {_HEIGHT_RANGE_M[0]} to {_HEIGHT_RANGE_M[1]}, not {self.height:g}{hint}"
            )
        if not _MIN_SPLATS <= self.splats <= _MAX_SPLATS:
            raise FormatError(f"an avatar needs {_MIN_SPLATS} to {_MAX_SPLATS} splats, not {self.splats}")
        if not _TEXTURE_RANGE_PX[0] <= self.texture <= _TEXTURE_RANGE_PX[1]:
            raise FormatError(
                f"a texture needs {_TEXTURE_RANGE_PX[0]} to {_TEXTURE_RANGE_PX[1]} texels a side, not {self.texture}"
            )
        if self.steps < 0 or self.seed < 0:
            name = "steps" if self.steps < 0 else "seed"
            raise FormatError(f"{name} needs 0 or more, not {getattr(self, name)}")


class Reconstructor(Protocol):
    """Makes an avatar from pictures. Plugins are entry points of the group ``glsplat.reconstructors``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """Return an avatar on the 55 joints of SMPL-X, in the zero pose, metres, soles on y = 0, facing +z.

        ``pictures`` by the side of the person that they show: always ``front``, optionally ``back``, ``left``,
        ``right``; ``masks`` [H, W] by the same names, true on the person. Raises GlsplatError in one line.
        """
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedBody:
    """The fitted body and the trust in its surface."""

    fit: BodyFit
    mesh: RiggedMesh  # the dressed body in the zero pose; white, unless a mesh was asked for
    unseen: float  # fraction of the surface that no picture shows
    seen: F64  # [V] trust of its vertices, from 0, guessed, to 1, seen frontally
    problem: str  # one line, or empty


@dataclass(frozen=True, eq=False, kw_only=True)
class MadeAvatar(FittedBody):
    """An avatar and the body it was made from."""

    avatar: Avatar


@runtime_checkable
class ReportingReconstructor(Protocol):
    """A reconstructor that also returns the fitted body."""

    def report(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> MadeAvatar:
        """Reconstruct the avatar; return it with the fitted body."""
        ...


@runtime_checkable
class MeshReconstructor(Protocol):
    """A reconstructor that also makes textured meshes."""

    def mesh(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> FittedBody:
        """Reconstruct a textured mesh: ``FittedBody.mesh``."""
        ...
