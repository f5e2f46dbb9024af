"""Splats: the attributes of a set of 3D Gaussians, checked once, immutable afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.errors import FormatError

__all__ = ["SH_C0", "Splats"]

SH_C0 = 0.28209479177387814
"""Y_0^0, the constant real spherical harmonic: rgb = SH_C0 * f_dc + 0.5 (3DGS)."""


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """N Gaussians with activated attributes (linear scales and opacities), float32, C-contiguous.

    Values are stored as they came: NaN, zero quaternions, negative scales and opacities outside [0, 1] are
    legal here and have a stated fate in the renderer (docs/conventions.md), so that loading loses nothing.
    """

    means: NDArray[np.float32]  # [N, 3] metres, world or zero-pose frame
    quats: NDArray[np.float32]  # [N, 4] wxyz, normalised (a zero quaternion stays zero)
    scales: NDArray[np.float32]  # [N, 3] standard deviations in metres
    opacities: NDArray[np.float32]  # [N] in [0, 1]
    sh: NDArray[np.float32]  # [N, (degree + 1)^2, 3] raw coefficients; colour = SH . basis + 0.5
    antialias: bool = False  # meant to be drawn with opacity compensation for the dilation (RenderConfig.antialias)
    cones: NDArray[np.int8] | None = None  # [N, 4] visibility cone / 127: axis in the splat's own axes, smallest cosine

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in shapes.items():
            _require(name, getattr(self, name), shape)
        if self.sh.ndim != 3 or self.sh.shape[0] != n or self.sh.shape[1] not in (1, 4, 9, 16):
            raise FormatError(f"sh needs shape ({n}, 1|4|9|16, 3) for SH degree 0 to 3, not {self.sh.shape}")
        _require("sh", self.sh, (n, self.sh.shape[1], 3))
        if self.cones is not None and (self.cones.shape != (n, 4) or self.cones.dtype != np.int8):
            raise FormatError(f"cones needs int8 of shape ({n}, 4), not {self.cones.dtype} of {self.cones.shape}")

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
        cones: NDArray[np.int8] | None = None,  # [N, 4]
    ) -> Splats:
        """Convert, normalise the quaternions and check the shapes.

        Raises FormatError when a shape does not fit or not exactly one of ``sh`` and ``rgb`` is given.
        """
        if (sh is None) == (rgb is None):
            raise FormatError("a splat needs exactly one of sh and rgb")
        if sh is None:
            sh = ((np.asarray(rgb, np.float64) - 0.5) / SH_C0)[:, None, :]
        return cls(
            _f32(means),
            normalised(_f32(quats)),
            _f32(scales),
            _f32(np.asarray(opacities).reshape(-1)),
            _f32(sh),
            antialias,
            cones,
        )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def nbytes(self) -> int:
        """Host memory of the arrays in bytes."""
        arrays = (self.means, self.quats, self.scales, self.opacities, self.sh, self.cones)
        return sum(a.nbytes for a in arrays if a is not None)

    def take(self, index: ArrayLike) -> Splats:
        """The splats at ``index`` (an integer or boolean array), in that order."""
        i = np.asarray(index)
        i = i if i.dtype == bool else i.astype(np.intp)  # an empty list has no integer type
        cones = None if self.cones is None else self.cones[i]
        return Splats(
            self.means[i], self.quats[i], self.scales[i], self.opacities[i], self.sh[i], self.antialias, cones
        )

    def finite(self) -> NDArray[np.bool_]:
        """[N] True where every attribute is finite."""
        ok = np.isfinite(self.opacities)
        for array in (self.means, self.quats, self.scales):
            ok &= np.isfinite(array).all(axis=1)
        ok &= np.isfinite(self.sh).all(axis=(1, 2))
        return ok


def normalised(quats: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit quaternions [N, 4]; zero and non-finite ones are returned as they are.

    Dividing by the largest component first keeps tiny and huge quaternions from under- or overflowing. What is unit
    to float32 rounding stays as it is, so that reading a written file changes no bit.
    """
    with np.errstate(all="ignore"):
        peak = np.abs(quats).max(axis=-1, keepdims=True)
        rounded = np.abs(np.einsum("...i,...i->...", quats, quats)[..., None] - 1) <= 5e-7
        usable = np.isfinite(peak) & (peak > 0) & ~rounded
        scaled = quats / np.where(usable, peak, 1)
        unit = scaled / np.where(usable, np.linalg.norm(scaled, axis=-1, keepdims=True), 1)
    return np.where(usable, unit, quats).astype(np.float32)


def _f32(array: ArrayLike) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32)


def _require(name: str, array: NDArray[np.float32], shape: tuple[int, ...]) -> None:
    if array.shape != shape or array.dtype != np.float32:
        raise FormatError(f"{name} needs float32 of shape {shape}, not {array.dtype} of {array.shape}")
