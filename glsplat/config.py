"""RenderConfig: the settings that determine pixels, apart from the scene and the cameras."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache
from numbers import Integral
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from glsplat.arrays import count, instance, number
from glsplat.errors import GlsplatError

__all__ = ["CULL_PSNR", "LEAN", "MAX_BIAS", "MAX_LEVELS", "MAX_SIGMA", "DebugConfig", "RenderConfig", "with_fields"]

CULL_PSNR = 45.0
"""Smallest ``Splats.cones_psnr`` in dB at which ``cull_hidden="auto"`` culls an item's hidden splats."""

MAX_LEVELS = 16
"""Maximum number of levels of detail of an item."""

MAX_BIAS = 8.0
"""Maximum magnitude of lod_bias."""

MAX_SIGMA = 3.33
"""Radius of an opaque splat in standard deviations: alpha is 1/255 there."""

Target = Literal["auto", "fast", "8", "16f", "32f"]
Output = Literal["float32", "uint8"]


@cache
def _literals(kind: Any) -> dict[str, tuple[Any, ...]]:
    """Return the choices of the fields of literal types, by name."""
    return {name: get_args(hint) for name, hint in get_type_hints(kind).items() if get_origin(hint) is Literal}


def _choose(config: Any, **more: tuple[str | int | None, ...]) -> None:
    """Normalise the fields of literal types, and of ``more`` (name: choices), to the equal choice of the same type.

    Raises GlsplatError if there is none.
    """
    for name, choices in (_literals(type(config)) | more).items():  # type: ignore[arg-type]  # mypy takes no type for hashable
        value = getattr(config, name)
        kinds = ((bool, np.bool_), bool), (Integral, int), (str, str)  # also of numpy's scalars and of enums
        kind = next((plain for given, plain in kinds if isinstance(value, given)), type(value))
        found = [choice for choice in choices if type(choice) is kind and choice == value]
        if not found:
            raise GlsplatError(f"{name} needs one of {', '.join(map(str, choices))}, not {value!r:.60}")
        object.__setattr__(config, name, found[0])


def _limit(config: Any, name: str, least: float, most: float, unit: str = "") -> None:
    """Convert a field to float. Raises GlsplatError outside ``least`` to ``most``."""
    value = number(getattr(config, name), name, GlsplatError)
    if not least <= value <= most:
        raise GlsplatError(f"{name} needs {least:g} to {most:g}{unit}, not {value:g}")
    object.__setattr__(config, name, value)


def _changed(config: Any) -> str:
    changed = [f"{f.name}={getattr(config, f.name)!r}" for f in fields(config) if getattr(config, f.name) != f.default]
    return f"{type(config).__name__}({', '.join(changed)})"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DebugConfig:
    """Settings for measurements and tests: the alternatives that the defaults choose from.

    Raises GlsplatError for an invalid value.
    """

    layers: Literal["auto", "vertex", "geometry"] = "auto"  # shader that writes gl_Layer; auto probes by rendering
    shape: Literal["auto", "quad", "triangle"] = "auto"  # geometry of a splat; auto: triangle on software rasterizers
    fetch: Literal["auto", "attributes", "storage"] = "auto"  # source of the draw's records; storage needs OpenGL
    # 4.3; auto: storage on software rasterizers, up to 500,000 records
    order: Literal["shared", "per_view"] = "shared"  # one depth order for both eyes, or one per eye
    sort_bits: Literal[16, 32] = 32  # width of the depth key
    sort_period: int = 1  # sort every n-th frame with motion and reuse the order in between; still frames are exact
    rotation: Literal["polar", "raw"] = "polar"  # R_i under skinning: nearest rotation, or the blended matrix
    influences: Literal[0, 1, 2, 4, 8] = 0  # joints per splat; 0: all of the avatar's
    cull_margin: float = 0.0  # added to the smallest cosine of every visibility cone; above 0 culls more
    eps2d: float = 0.3  # px^2 added to the diagonal of the projected covariance
    mesh_samples: Literal[1, 4] = 4  # mesh samples per pixel; 1 if the driver supports no more
    mesh_anisotropy: Literal[1, 2, 4, 8, 16] = 16  # maximum anisotropy of mesh textures

    def __post_init__(self) -> None:
        _choose(self)
        object.__setattr__(self, "sort_period", count(self.sort_period, "sort_period", GlsplatError))
        if not 1 <= self.sort_period <= 1000:
            raise GlsplatError(f"sort_period needs 1 to 1000 frames, not {self.sort_period}")
        _limit(self, "cull_margin", -2, 2)
        _limit(self, "eps2d", 0, 100, " px^2")

    def __repr__(self) -> str:
        return _changed(self)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RenderConfig:
    """Settings of a renderer; the defaults meet the pixel contract (docs/conventions.md) at the lowest cost.

    Raises GlsplatError for an invalid value.

    >>> glsplat.RenderConfig(output="float32", cull_hidden=True)
    RenderConfig(output='float32', cull_hidden=True)
    """

    target: Target = "auto"  # of the blending; auto: 32f on software rasterizers, 16f on GPUs; fast: 8 instead of 32f
    output: Output = "uint8"  # uint8: resolved to 8 bit; float32: the unclipped target
    sorter: Literal["auto", "cpu", "gpu"] = "auto"  # gpu needs OpenGL 4.3; auto: cpu on software
    # rasterizers, gpu above 65,536 splats, else the faster in a measurement of some ms
    sh_degree: int = 3  # evaluate at most this degree
    antialias: bool | None = None  # opacity compensation (Mip-Splatting's 2D filter); None: by Splats.antialias
    cull_hidden: bool | Literal["auto"] = False  # cull splats seen from outside their visibility cone
    # (authoring/cones.py); auto: only of items with a cones_psnr of CULL_PSNR or more
    max_sigma: float = MAX_SIGMA  # maximum radius of a splat in standard deviations
    level: int | Literal["auto"] = 0  # level of detail: 0 the finest, higher are coarser; auto: by pixels
    lod_bias: float = 0.0  # bias of auto: 1 takes levels sharp enough for twice the pixels, -1 for half
    debug: DebugConfig = DebugConfig()

    def __post_init__(self) -> None:
        flags, levels = (None, False, True), ("auto", *range(MAX_LEVELS + 1))
        _choose(self, sh_degree=(0, 1, 2, 3), antialias=flags, cull_hidden=(False, True, "auto"), level=levels)
        _limit(self, "lod_bias", -MAX_BIAS, MAX_BIAS)
        sigma = number(self.max_sigma, "max_sigma", GlsplatError)
        if not 0 < sigma <= MAX_SIGMA:
            raise GlsplatError(f"max_sigma needs a number above 0, at most {MAX_SIGMA}, not {sigma:g}")
        object.__setattr__(self, "max_sigma", sigma)
        instance(self.debug, DebugConfig, "debug", GlsplatError)

    def __repr__(self) -> str:
        return _changed(self)


def with_fields(config: RenderConfig, **values: Any) -> RenderConfig:
    """Return ``config`` with changed fields, of its own or of its ``debug``.

    >>> from glsplat.config import with_fields
    >>> with_fields(glsplat.RenderConfig(), target="16f", sort_bits=16)
    RenderConfig(target='16f', debug=DebugConfig(sort_bits=16))
    """
    debug = instance(values.pop("debug", config.debug), DebugConfig, "debug", GlsplatError)
    of_debug = {name: values.pop(name) for name in list(values) if hasattr(debug, name)}
    return replace(config, **values, debug=replace(debug, **of_debug))


LEAN = RenderConfig(target="fast", cull_hidden="auto", level="auto", max_sigma=2.5)
"""Default of ``serve``, ``preview`` and ``demo`` without ``--exact``: faster, with barely visible differences."""
