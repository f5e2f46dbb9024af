"""Surface: normal, occlusion and shade of the surface under each splat, seven bytes, for relighting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64, Value, frozen, own_whole
from glsplat.errors import FormatError
from glsplat.rotations import unit_vectors

SHADE_ONE, SHADE_STEPS = 192, 32
"""A shade's byte b stands for 2^((b - 192) / 32), 1/64 to 3.9: half a level of 255 in a colour."""


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Surface(Value):
    """Surfaces of N splats, in the frame of their means. Immutable; raises FormatError where shapes do not fit.

    A normal of three zeros means no surface: such a splat is never lit, its colour is shown as it is.
    ``shade`` is the light in the splats' colours, irradiance over pi: albedo = colour in linear light / shade;
    None where colours are albedo already.
    """

    normals: NDArray[np.int8]  # [N, 3] times 127, about unit length, out of the body
    occlusion: NDArray[np.uint8]  # [N] as of glTF's textures: 255 where all ambient light arrives, 0 where none does
    shade: NDArray[np.uint8] | None  # [N, 3] rgb (SHADE_STEPS)

    def __init__(
        self,
        normals: ArrayLike,  # [N, 3] of whole numbers -128..127
        occlusion: ArrayLike,  # [N] of whole numbers 0..255
        shade: ArrayLike | None = None,  # [N, 3] of whole numbers 0..255
    ) -> None:
        held = own_whole(normals, np.int8, "normals")
        opened = own_whole(occlusion, np.uint8, "occlusion")
        shades = None if shade is None else own_whole(shade, np.uint8, "shade")
        n = len(held)
        if held.shape == (0,):
            held = held.reshape(0, 3)
        for name, array, shape in (("normals", held, (n, 3)), ("occlusion", opened, (n,)), ("shade", shades, (n, 3))):
            if array is not None and array.shape != shape:
                raise FormatError(f"a surface's {name} needs shape {shape}, not {array.shape}")
        self._keep(normals=held, occlusion=opened, shade=shades)

    @classmethod
    def of(cls, normals: F64, occlusion: F64, shade: F64 | None = None) -> Surface:
        """Pack unit normals [N, 3] (zero for none), occlusion [N] in [0, 1] and shades [N, 3] above 0."""
        packed = np.rint(np.nan_to_num(np.asarray(normals)) * 127).clip(-127, 127).astype(np.int8)
        opened = np.rint(np.nan_to_num(np.asarray(occlusion)).clip(0, 1) * 255).astype(np.uint8)
        return cls(packed, opened, None if shade is None else encoded_shades(shade))

    @classmethod
    def joined(cls, parts: Sequence[Surface | None], counts: Sequence[int]) -> Surface | None:
        """Concatenate the surfaces of several things of ``counts`` splats; None where no part has any."""
        if all(part is None for part in parts):
            return None
        whole = [cls.none(count) if part is None else part for part, count in zip(parts, counts, strict=True)]
        shaded = any(part.shade is not None for part in whole)
        return cls(
            np.concatenate([part.normals for part in whole]),
            np.concatenate([part.occlusion for part in whole]),
            np.concatenate([part.shades_or_one() for part in whole]) if shaded else None,
        )

    @classmethod
    def none(cls, count: int) -> Surface:
        """Return the surface of ``count`` splats that are never lit."""
        return cls(np.zeros((count, 3), np.int8), np.full(count, 255, np.uint8))

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return self.normals.nbytes + self.occlusion.nbytes + (0 if self.shade is None else self.shade.nbytes)

    @property
    def units(self) -> F64:
        """Unit normals [N, 3], zero where there is none."""
        return unit_vectors(np.maximum(self.normals.astype(np.float64), -127))

    @property
    def ao(self) -> F64:
        """The share [N] of ambient light that arrives, 0 to 1."""
        return self.occlusion / 255.0

    @property
    def shades(self) -> F64:
        """The light [N, 3] in the colours; 1 where they are albedo."""
        return decoded_shades(self.shades_or_one())

    def shades_or_one(self) -> NDArray[np.uint8]:
        """Return the bytes of the shade [N, 3]; those of 1 for albedo."""
        return np.full((len(self), 3), SHADE_ONE, np.uint8) if self.shade is None else self.shade

    def take(self, index: Any) -> Surface:
        """Return the surfaces of the splats at ``index`` (integers or booleans)."""
        shade = None if self.shade is None else frozen(self.shade[index])
        return Surface(frozen(self.normals[index]), frozen(self.occlusion[index]), shade)

    def turned(self, linear: F64) -> Surface:
        """Return the surface with normals turned by [3, 3] or [N, 3, 3]: the inverse transpose of a linear map."""
        turned = np.einsum("...ij,...j->...i", np.broadcast_to(linear, (len(self), 3, 3)), self.units)
        return Surface(Surface.of(unit_vectors(turned), self.ao).normals, self.occlusion, self.shade)

    def in_axes(self, axes: F64) -> F64:
        """Return the normals [N, 3] in splats' own axes, the columns of ``axes`` [N, 3, 3]."""
        return np.asarray(np.einsum("nij,ni->nj", axes, self.units))

    def __len__(self) -> int:
        return len(self.normals)

    def __repr__(self) -> str:
        return f"Surface({len(self)} splats, {'albedo' if self.shade is None else 'shaded'})"


def encoded_shades(shade: F64) -> NDArray[np.uint8]:
    """Return the bytes of shades above 0, clamped."""
    steps = np.log2(np.maximum(np.nan_to_num(np.asarray(shade, np.float64), nan=1.0), 1e-6)) * SHADE_STEPS
    return np.rint(steps + SHADE_ONE).clip(0, 255).astype(np.uint8)


def decoded_shades(shade: NDArray[np.uint8]) -> F64:
    """Return the shades of bytes."""
    return np.asarray(np.exp2((shade.astype(np.float64) - SHADE_ONE) / SHADE_STEPS))
