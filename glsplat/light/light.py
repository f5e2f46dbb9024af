"""Light of a scene: an ambient part from all around and one sun or far lamp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64, Value, frozen, plain
from glsplat.errors import FormatError
from glsplat.rotations import SH_FACTORS, sh_basis, sh_rotations

_MAX_VALUE = 1e4  # of a coefficient or a colour; more is a mistake of units
_UNIT_TOLERANCE = 1e-3  # of a direction's length: written with three digits
_SIGNS = np.sign(SH_FACTORS[:9])  # remove the Condon-Shortley sign, which the colours of splats have
_SPREAD = np.repeat([1.0, 2 / 3, 0.25], [1, 3, 5])  # from radiance of degree l to irradiance over pi, diffuse
_MEAN, _RISE = SH_FACTORS[0], SH_FACTORS[2]  # of light from everywhere, and of light that grows upwards


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Light(Value):
    """Distant light in linear sRGB: radiance 1 from everywhere shows a surface in exactly its albedo.

    ``ambient`` are nine coefficients of radiance in real spherical harmonics, (l, m) = (0, 0), (1, -1), (1, 0) to
    (2, 2), without the Condon-Shortley sign, world axes; a constant radiance c has the first one c sqrt(4 pi). The sun
    shines from ``sun_direction`` (from the scene to the light, unit) with irradiance ``sun_colour`` on surfaces that
    face it; pi lights as much as radiance 1 from everywhere. Raises FormatError for invalid numbers.

    >>> from glsplat.light import Light
    >>> Light.preset("left")
    Light(mean radiance (0.30, 0.30, 0.32), sun from (-0.79, 0.43, 0.43))
    >>> Light.uniform(1.0).irradiance([[0, 1, 0]]).round(6).tolist()  # over pi
    [[1.0, 1.0, 1.0]]
    """

    ambient: F64  # [9, 3]
    sun_direction: F64 | None  # [3] unit; None: no sun
    sun_colour: F64  # [3]

    def __init__(
        self,
        ambient: ArrayLike,  # [9, 3]
        sun_direction: ArrayLike | None = None,  # [3]
        sun_colour: ArrayLike = (0.0, 0.0, 0.0),  # [3], none below 0
    ) -> None:
        held = _numbers(ambient, "a light's ambient", (9, 3))
        colour = _numbers(sun_colour, "the sun's color", (3,))
        if (colour < 0).any():
            raise FormatError(f"the sun's color needs numbers of 0 and more, not {colour.tolist()}")
        way = None
        if sun_direction is not None:
            way = _numbers(sun_direction, "the sun's direction", (3,))
            length = float(np.linalg.norm(way))
            if not abs(length - 1) <= _UNIT_TOLERANCE:
                raise FormatError(f"the sun's direction needs a unit vector towards the light, not {way.tolist()}")
            way = frozen(way / length)
        elif colour.any():
            raise FormatError("a sun needs a direction beside its color")
        self._keep(ambient=held, sun_direction=way, sun_colour=colour)

    @classmethod
    def uniform(cls, radiance: ArrayLike = 1.0) -> Light:
        """Return the light of one radiance, a number or rgb, from everywhere."""
        ambient = np.zeros((9, 3))
        ambient[0] = np.asarray(radiance, np.float64) / _MEAN
        return cls(ambient)

    @classmethod
    def hemisphere(
        cls,
        sky: ArrayLike,  # [3] irradiance over pi on surfaces that face up
        ground: ArrayLike,  # [3] likewise, down
        sun_direction: ArrayLike | None = None,  # [3] of any length but zero
        sun_colour: ArrayLike = (0.0, 0.0, 0.0),  # [3]
    ) -> Light:
        """Return light that grows evenly from the ground to the sky, and perhaps a sun."""
        up, down = np.asarray(sky, np.float64), np.asarray(ground, np.float64)
        ambient = np.zeros((9, 3))
        ambient[0] = (up + down) / 2 / _MEAN
        ambient[1] = (up - down) / 2 / (_RISE * _SPREAD[1])
        if sun_direction is None:
            return cls(ambient, None, sun_colour)
        way = _numbers(sun_direction, "the sun's direction", (3,))
        length = float(np.linalg.norm(way))
        if not length > 1e-9:
            raise FormatError(f"the sun's direction needs a vector that is not zero, not {way.tolist()}")
        return cls(ambient, way / length, sun_colour)

    @classmethod
    def preset(cls, name: str) -> Light:
        """Return one of ``PRESETS``; a face keeps about its brightness. Raises FormatError for another name."""
        if name not in PRESETS:
            raise FormatError(f"a light is one of {', '.join(PRESETS)}, or a JSON file, not {name!r:.60}")
        sky, ground, way, colour = PRESETS[name]
        return cls.hemisphere(sky, ground, way, np.multiply(colour, np.pi))

    @classmethod
    def from_json(cls, data: Any) -> Light:
        """Parse {"ambient": [[r, g, b] x 9], "sun": {"direction": [x, y, z], "color": [r, g, b]}}, or a preset's name.

        The sun may be missing. Raises FormatError.
        """
        if isinstance(data, str):
            return cls.preset(data)
        if not isinstance(data, Mapping):
            raise FormatError(f"a light is an object with ambient and perhaps sun, not {type(data).__name__}")
        for key in data:
            if key not in ("ambient", "sun"):
                raise FormatError(f"a light has the keys ambient and sun, not {str(key)!r:.40}")
        if "ambient" not in data:
            raise FormatError("a light needs ambient: nine coefficients of three numbers (0 for none)")
        sun = data.get("sun")
        if sun is None:
            return cls(data["ambient"])
        if not isinstance(sun, Mapping) or set(sun) != {"direction", "color"}:
            raise FormatError("a light's sun is an object with direction and color")
        return cls(data["ambient"], sun["direction"], sun["color"])

    def to_json(self) -> dict[str, Any]:
        """Return the object that ``from_json`` reads."""
        out: dict[str, Any] = {"ambient": self.ambient.tolist()}
        if self.sun_direction is not None:
            out["sun"] = {"direction": self.sun_direction.tolist(), "color": self.sun_colour.tolist()}
        return out

    def irradiance(self, normals: ArrayLike) -> F64:
        """Return the ambient irradiance over pi [N, 3] on surfaces with unit normals [N, 3], never below 0.

        After Ramamoorthi and Hanrahan, An Efficient Representation for Irradiance Environment Maps (2001).
        """
        return np.maximum(sh_irradiance(np.asarray(normals, np.float64)) @ self.ambient, 0)

    def uniforms(self) -> NDArray[np.float32]:
        """Return light.glsl's uniforms [11, 4]: nine coefficients by monomials, the sun's direction and colour."""
        out = np.zeros((11, 4), np.float32)
        out[:9, :3] = self.ambient * (np.abs(SH_FACTORS[:9]) * _SPREAD)[:, None]
        if self.sun_direction is not None:
            out[9, :3], out[10, :3] = self.sun_direction, self.sun_colour / np.pi
        return out

    def turned(self, turn: F64) -> Light:
        """Return the light turned by a rotation [3, 3]; coefficients that get too large are clamped."""
        matrix = sh_rotations(np.asarray(turn, np.float64), 2) * _SIGNS * _SIGNS[:, None]
        way = None if self.sun_direction is None else np.asarray(turn, np.float64) @ self.sun_direction
        return Light(np.clip(matrix @ self.ambient, -_MAX_VALUE, _MAX_VALUE), way, self.sun_colour)

    def same(self, other: Light | None) -> bool:
        """Return whether the other one lights everything alike."""
        return other is not None and bool((self.uniforms() == other.uniforms()).all())

    def __repr__(self) -> str:
        mean = ", ".join(f"{v:.2f}" for v in self.ambient[0] * _MEAN)
        way = self.sun_direction
        sun = "" if way is None else f", sun from ({', '.join(f'{v:.2f}' for v in way)})"
        return f"Light(mean radiance ({mean}){sun})"


Preset = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], tuple[float, ...]]

PRESETS: dict[str, Preset] = {
    "studio": ((0.62, 0.63, 0.66), (0.42, 0.41, 0.40), (0.35, 0.6, 0.8), (0.55, 0.53, 0.50)),
    "day": ((0.60, 0.66, 0.76), (0.36, 0.34, 0.30), (0.4, 0.85, 0.5), (0.75, 0.71, 0.64)),
    "evening": ((0.32, 0.36, 0.50), (0.26, 0.22, 0.20), (-0.7, 0.3, 0.65), (0.95, 0.62, 0.36)),
    "night": ((0.14, 0.16, 0.22), (0.10, 0.10, 0.12), (0.5, 0.7, 0.5), (0.20, 0.24, 0.34)),
    "left": ((0.34, 0.35, 0.38), (0.26, 0.25, 0.26), (-0.85, 0.46, 0.46), (0.90, 0.87, 0.82)),
    "right": ((0.34, 0.35, 0.38), (0.26, 0.25, 0.26), (0.85, 0.46, 0.46), (0.90, 0.87, 0.82)),
}
"""Lights by name: sky, ground, direction to the sun, its colour over pi. Left and right as seen from the front."""


def sh_irradiance(normals: F64) -> F64:
    """Return irradiance over pi [N, 9] on unit normals [N, 3] by each coefficient of radiance (light.glsl)."""
    return np.asarray(sh_basis(normals, 2) * (_SIGNS * _SPREAD))


def _numbers(value: ArrayLike, what: str, shape: tuple[int, ...]) -> F64:
    array = plain(value, what)
    if array.shape != shape:
        raise FormatError(f"{what} needs {' x '.join(map(str, shape))} numbers, not an array of {array.shape}")
    held = np.array(array, np.float64)
    if not (np.isfinite(held).all() and np.abs(held).max() <= _MAX_VALUE):
        raise FormatError(f"{what} needs finite numbers up to {_MAX_VALUE:g}")
    return frozen(held)
