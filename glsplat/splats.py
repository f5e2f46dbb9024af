"""Splats: the attributes of a set of 3D Gaussians, validated once, then immutable."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import Value, flag, frozen, instance, listed, number, own, own_whole, plain, rows, shares
from glsplat.errors import FormatError

if TYPE_CHECKING:
    from glsplat.light.surface import Surface

__all__ = ["SH_C0", "Level", "Levels", "Splats", "checked_levels"]

SH_C0 = 0.28209479177387814
"""Y_0^0, the constant real spherical harmonic: rgb = SH_C0 * f_dc + 0.5 (3DGS)."""


_UNIT_TOLERANCE = 5e-7  # of the squared length of a float32 unit quaternion

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Level(Generic[T]):
    """A coarser level of detail of Splats or an Avatar: fewer splats that look the same from afar.

    ``density``, in pixels per metre, is the largest focal length over depth at which it is drawn. ``psnr`` is the PSNR
    in dB of the worst picture at that density against the finest level.
    """

    content: T
    density: float
    psnr: float | None = None


class Levels(tuple[Level[T], ...]):
    """Levels with the arrays of the splats that they belong to: levels of replaced arrays are dropped."""

    of: tuple[NDArray[np.float32], ...]

    def __new__(cls, levels: Iterable[Level[T]], of: tuple[NDArray[np.float32], ...]) -> Levels[T]:
        """Return a tuple of ``levels``."""
        made = super().__new__(cls, tuple(levels))
        made.of = of
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Levels, (tuple(self), self.of)


def checked_levels(
    levels: Iterable[Level[T]], finest: T, of: tuple[NDArray[np.float32], ...], sizes: Iterable[int]
) -> tuple[Level[T], ...]:
    """Return the validated levels of ``finest``, whose arrays are ``of``; ``sizes``: splat counts, finest first.

    Levels of other arrays, which ``dataclasses.replace`` passes on, are dropped. Raises FormatError for invalid levels.
    """
    if isinstance(levels, Levels) and any(a is not b for a, b in zip(levels.of, of, strict=True)):
        return ()
    found, counts = tuple(levels), list(sizes)
    last = float("inf")
    for i, level in enumerate(found):
        if not isinstance(level, Level) or type(level.content) is not type(finest):
            kind = type(level.content if isinstance(level, Level) else level).__name__
            raise FormatError(f"level {i + 1}: a level of {type(finest).__name__} holds the same, not {kind}")
        if not 0 < level.density < last:
            raise FormatError(
                f"level {i + 1}: densities fall from level to level and are above 0, found {level.density:g}"
            )
        if not 0 < counts[i + 1] < counts[i]:
            raise FormatError(
                f"level {i + 1}: splats grow fewer from level to level, {counts[i + 1]} after {counts[i]}"
            )
        last = level.density
    return Levels(found, of) if found else ()


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Splats(Value):
    """N Gaussians with activated attributes (linear scales and opacities), float32, C-contiguous, read-only.

    NaN, zero quaternions, negative scales and opacities outside [0, 1] are kept, so that loading loses nothing;
    docs/conventions.md says how the renderer handles them. Arrays are converted and copied, except float32 arrays that
    are read-only down to the memory they own: set ``array.flags.writeable = False`` to avoid the copy. Raises
    FormatError if a shape does not fit.

    >>> glsplat.Splats.create([[0, 1, 0]], [[1, 0, 0, 0]], [[0.1, 0.1, 0.1]], opacities=[0.9], rgb=[[1, 0, 0]])
    Splats(1 splats, SH degree 0, 56 bytes)
    """

    means: NDArray[np.float32]  # [N, 3] metres, world or zero-pose frame
    quats: NDArray[np.float32]  # [N, 4] wxyz, normalised (a zero quaternion stays zero)
    scales: NDArray[np.float32]  # [N, 3] standard deviations in metres
    opacities: NDArray[np.float32]  # [N] in [0, 1]
    sh: NDArray[np.float32]  # [N, (degree + 1)^2, 3] raw coefficients; colour = SH . basis + 0.5
    antialias: bool = False  # to be drawn with opacity compensation (RenderConfig.antialias)
    cones: NDArray[np.int8] | None = None  # [N, 4] visibility cone times 127: axis in the splat's axes, smallest cosine
    cones_psnr: float | None = None  # PSNR in dB of the worst picture with culled cones; None: unknown
    levels: tuple[Level[Splats], ...] = ()  # coarser levels, finest first; dropped if an attribute is replaced
    surface: Surface | None = None  # for relighting; None: not lit

    def __init__(
        self,
        means: ArrayLike,  # [N, 3]
        quats: ArrayLike,  # [N, 4] wxyz, any length
        scales: ArrayLike,  # [N, 3]
        opacities: ArrayLike,  # [N]
        sh: ArrayLike,  # [N, K, 3], K 1, 4, 9 or 16
        antialias: bool = False,
        cones: ArrayLike | None = None,  # [N, 4] of whole numbers -128..127
        cones_psnr: float | None = None,
        levels: Iterable[Level[Splats]] = (),
        surface: Surface | None = None,
    ) -> None:
        arrays = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "sh": sh}
        if plain(opacities, "opacities").dtype.kind != "f":  # whole numbers: 0 and 1, or 0 to 255
            shares(opacities, "opacities")
        own_ones = {name: own(array, np.float32, name) for name, array in arrays.items()}
        n = own_ones["means"].shape[0] if own_ones["means"].ndim else 1
        shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        k = 1 if own_ones["sh"].ndim != 3 else own_ones["sh"].shape[1]
        for name, shape in {**shapes, "sh": (n, k, 3)}.items():
            if own_ones[name].shape == (0,) and n == 0:  # an empty list has no second dimension
                own_ones[name] = own_ones[name].reshape(shape)
            if name == "sh" and (own_ones[name].shape != shape or k not in (1, 4, 9, 16)):
                found = own_ones[name].shape
                raise FormatError(f"sh needs shape ({n}, 1|4|9|16, 3) for SH degree 0 to 3, not {found}")
            if own_ones[name].shape != shape:
                raise FormatError(f"{name} needs shape {shape}, not {own_ones[name].shape}")
        turns = own_ones["quats"]
        with np.errstate(all="ignore"):
            unit = bool((np.abs(np.einsum("ij,ij->i", turns, turns) - 1) <= _UNIT_TOLERANCE).all())
        if not unit:
            own_ones["quats"] = frozen(normalised(turns))
        held = None if cones is None else own_whole(cones, np.int8, "cones")
        if held is not None and held.shape != (n, 4):
            raise FormatError(f"cones needs int8 of shape ({n}, 4), not {held.shape}")
        if surface is not None:
            from glsplat.light.surface import Surface  # here: few splats have a surface

            if len(instance(surface, Surface, "surface")) != n:
                raise FormatError(f"a surface needs one row a splat, not {len(surface)} for {n}")
        self._keep(**own_ones, antialias=flag(antialias, "antialias"), cones=held, surface=surface)
        known = held is not None and cones_psnr is not None
        self._keep(cones_psnr=number(cones_psnr, "cones_psnr") if known else None)
        found = levels if isinstance(levels, Levels) else listed(levels, "levels")
        sizes = [n, *(len(one.content) for one in found if isinstance(getattr(one, "content", None), Splats))]
        self._keep(levels=checked_levels(found, self, self.arrays, sizes) if found else ())
        if any(level.content.levels for level in self.levels):
            raise FormatError("a level has no levels of its own")

    @classmethod
    def create(
        cls,
        means: ArrayLike,  # [N, 3]
        quats: ArrayLike,  # [N, 4] wxyz, any length
        scales: ArrayLike,  # [N, 3]
        opacities: ArrayLike,  # [N]
        sh: ArrayLike | None = None,  # [N, K, 3]
        *,
        rgb: ArrayLike | None = None,  # [N, 3] in [0, 1], instead of sh
        antialias: bool = False,
        cones: ArrayLike | None = None,  # [N, 4]
        cones_psnr: float | None = None,
        surface: Surface | None = None,
    ) -> Splats:
        """Return splats of ``sh``, or of plain colours ``rgb``, which have SH degree 0.

        Raises FormatError unless exactly one of ``sh`` and ``rgb`` is given, if a shape does not fit, or if ``rgb``
        is 0 to 255. Colours from -1 to 2 are kept, as spherical harmonics overshoot.
        """
        if (sh is None) == (rgb is None):
            raise FormatError("a splat needs exactly one of sh and rgb")
        if sh is None:
            assert rgb is not None
            colours = shares(rgb, "rgb", hint=", or give sh for more light")
            colours = colours.reshape(0, 3) if colours.shape == (0,) else colours
            if colours.ndim != 2 or colours.shape[1] != 3:
                raise FormatError(f"rgb needs shape (N, 3), not {colours.shape}")
            with np.errstate(over="ignore"):
                sh = frozen(((colours.astype(np.float64) - 0.5) / SH_C0)[:, None, :].astype(np.float32))
        alphas = plain(opacities, "opacities")
        alphas = alphas.reshape(-1) if alphas.ndim == 0 or alphas.shape[1:] == (1,) else alphas
        return cls(means, quats, scales, alphas, sh, antialias, cones, cones_psnr, surface=surface)

    def _repr_png_(self) -> bytes | None:
        """Return a picture for notebooks; None where no OpenGL context can be made."""
        picture: bytes | None = import_module("glsplat.renderer.thumbnail").thumbnail(self)  # which imports this module
        return picture

    def __repr__(self) -> str:
        more = (", antialias" if self.antialias else "") + ("" if self.cones is None else ", visibility cones")
        more += "" if self.surface is None else ", surface"
        more += f", {len(self.levels)} levels" if self.levels else ""
        size = f"{self.nbytes / 1e6:.4g} MB" if self.nbytes >= 1e5 else f"{self.nbytes} bytes"
        return f"Splats({len(self)} splats, SH degree {self.sh_degree}, {size}{more})"

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def arrays(self) -> tuple[NDArray[np.float32], ...]:
        """The arrays means, quats, scales, opacities, sh."""
        return self.means, self.quats, self.scales, self.opacities, self.sh

    @property
    def nbytes(self) -> int:
        """Host memory of the arrays in bytes, without levels."""
        arrays = (self.means, self.quats, self.scales, self.opacities, self.sh, self.cones)
        return sum(a.nbytes for a in arrays if a is not None) + (0 if self.surface is None else self.surface.nbytes)

    def take(self, index: ArrayLike) -> Splats:
        """Return the splats at ``index`` (an integer or boolean array), in that order, without levels.

        Raises FormatError for an index out of range.
        """
        i = rows(index, len(self))
        means, quats, scales, opacities, sh = (frozen(a.take(i, axis=0)) for a in self.arrays)
        cones = None if self.cones is None else frozen(self.cones.take(i, axis=0))
        surface = None if self.surface is None else self.surface.take(i)
        return Splats(means, quats, scales, opacities, sh, self.antialias, cones, self.cones_psnr, surface=surface)

    def finite(self) -> NDArray[np.bool_]:
        """Return a mask [N] of the splats whose attributes are all finite."""
        ok = np.isfinite(self.opacities)
        for array in (self.means, self.quats, self.scales):
            ok &= np.isfinite(array).all(axis=1)
        ok &= np.isfinite(self.sh).all(axis=(1, 2))
        return ok

    def drawable(self) -> NDArray[np.bool_]:
        """Return a mask [N] of the splats that can be drawn: finite, with a non-zero quaternion."""
        return self.finite() & self.quats.any(axis=1)


def normalised(quats: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return unit quaternions [N, 4]; zero and non-finite ones are returned as they are.

    Dividing by the largest component first avoids under- and overflow. Quaternions that are unit within float32
    rounding are unchanged, so that reading a written file is bit-exact.
    """
    with np.errstate(all="ignore"):
        peak = np.abs(quats).max(axis=-1, keepdims=True)
        rounded = np.abs(np.einsum("...i,...i->...", quats, quats)[..., None] - 1) <= _UNIT_TOLERANCE
        usable = np.isfinite(peak) & (peak > 0) & ~rounded
        scaled = quats / np.where(usable, peak, 1)
        unit = scaled / np.where(usable, np.linalg.norm(scaled, axis=-1, keepdims=True), 1)
    return np.where(usable, unit, quats).astype(np.float32)
