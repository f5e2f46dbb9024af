"""RenderConfig: what the picture must be. Everything that decides pixels, and nothing else, in one frozen value."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from glsplat.arrays import count, number
from glsplat.errors import GlsplatError

__all__ = ["CULL_PSNR", "LEAN", "MAX_BIAS", "MAX_LEVELS", "RenderConfig"]

CULL_PSNR = 45.0
"""Decibels that pictures keep at worst without the splats that ``cull_hidden="auto"`` leaves out."""

MAX_LEVELS = 16
"""Levels of detail of one thing, at most."""

MAX_BIAS = 8.0
"""Halvings of lod_bias either way, at most."""

Target = Literal["auto", "8", "16f", "32f"]
Output = Literal["float32", "uint8"]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RenderConfig:
    """Knobs of a renderer; the defaults are the pixel contract (docs/conventions.md) at its best price.

    Raises GlsplatError for a value out of range.

    >>> glsplat.RenderConfig(output="float32", cull_hidden=True)
    RenderConfig(output='float32', cull_hidden=True)
    """

    target: Target = "auto"  # float target; auto = 32f on software rasterizers, 16f on GPUs (measured)
    output: Output = "uint8"  # uint8: resolved to 8 bit; float32: the target as it is, unclipped
    sorter: Literal["auto", "cpu", "gpu"] = "auto"  # gpu needs OpenGL 4.3
    layers: Literal["auto", "vertex", "geometry"] = "auto"  # who writes gl_Layer; auto probes by rendering
    shape: Literal["auto", "quad", "triangle"] = (
        "auto"  # of a splat; auto = triangle on software rasterizers (measured)
    )
    fetch: Literal["auto", "attributes", "storage"] = (
        "auto"  # of records by the draw; storage needs OpenGL 4.3, auto = there on software rasterizers, up to 500,000
    )
    order: Literal["shared", "per_view"] = "shared"  # one depth order for both eyes, or one an eye
    sort_bits: Literal[16, 32] = 32  # bits of the depth key
    sort_period: int = 1  # sort every n-th moved frame of one pass, keep the old order in between; at rest it is exact
    rotation: Literal["polar", "raw"] = "polar"  # R_i under skinning: nearest rotation, or the blended matrix
    influences: Literal[0, 1, 2, 4, 8] = 0  # joints a splat; 0 = as many as the avatar has
    sh_degree: int = 3  # evaluate at most this degree
    antialias: bool | None = None  # opacity compensation (Mip-Splatting's 2D filter); None: if the splats ask for it
    cull_hidden: bool | Literal["auto"] = False  # leave out splats that are seen from outside their visibility cone
    # (authoring/cones.py); auto: of things whose worst picture keeps CULL_PSNR without them
    cull_margin: float = 0.0  # added to the smallest cosine of every cone: above 0 leaves out more
    eps2d: float = 0.3  # px^2 added to the diagonal of the projected covariance
    max_sigma: float = 3.33  # standard deviations at which a quad ends at the latest
    level: int | Literal["auto"] = 0  # of detail: 0 the finest, a number (or the coarsest there is); auto: by pixels
    lod_bias: float = 0.0  # of auto, in halvings: 1 takes levels that suffice at twice the pixels, -1 at half of them

    mesh_samples: Literal[1, 4] = 4  # points of a pixel at which meshes are drawn; 1 where the driver has no more
    mesh_anisotropy: Literal[1, 2, 4, 8, 16] = 16  # texture samples at most along what is seen at a slant

    def __post_init__(self) -> None:
        allowed: dict[str, tuple[object, ...]] = {
            "target": ("auto", "8", "16f", "32f"),
            "output": ("float32", "uint8"),
            "sorter": ("auto", "cpu", "gpu"),
            "layers": ("auto", "vertex", "geometry"),
            "shape": ("auto", "quad", "triangle"),
            "fetch": ("auto", "attributes", "storage"),
            "order": ("shared", "per_view"),
            "sort_bits": (16, 32),
            "rotation": ("polar", "raw"),
            "influences": (0, 1, 2, 4, 8),
            "sh_degree": (0, 1, 2, 3),
            "antialias": (None, False, True),
            "cull_hidden": (False, True, "auto"),
            "mesh_samples": (1, 4),
            "mesh_anisotropy": (1, 2, 4, 8, 16),
        }
        for name, values in allowed.items():
            value = getattr(self, name)
            # True == 1 and 32.0 == 32: what is kept is the value meant, and a switch is no number
            several = isinstance(value, np.ndarray)  # equals nothing
            fit = [
                v
                for v in values
                if not several and np.isscalar(value) == np.isscalar(v) and _is_switch(v) == _is_switch(value)
            ]
            chosen = next((v for v in fit if v == value), _NOTHING)
            if chosen is _NOTHING:
                raise GlsplatError(f"{name} needs one of {', '.join(map(str, values))}, not {value!r:.60}")
            object.__setattr__(self, name, chosen)
        object.__setattr__(self, "sort_period", count(self.sort_period, "sort_period", GlsplatError))
        if not (isinstance(self.level, str) and self.level == "auto"):
            object.__setattr__(self, "level", count(self.level, "level", GlsplatError))
            if not 0 <= int(self.level) <= MAX_LEVELS:
                raise GlsplatError(f"level needs 0 to {MAX_LEVELS} or auto, not {self.level}")
        for name in ("cull_margin", "eps2d", "lod_bias", "max_sigma"):
            object.__setattr__(self, name, number(getattr(self, name), name, GlsplatError))
        if not 1 <= self.sort_period <= 1000:
            raise GlsplatError(f"sort_period needs 1 to 1000 frames, not {self.sort_period}")
        if not -2 <= self.cull_margin <= 2:
            raise GlsplatError(f"cull_margin needs -2 to 2, not {self.cull_margin:g}")
        if not -MAX_BIAS <= self.lod_bias <= MAX_BIAS:
            raise GlsplatError(f"lod_bias needs -{MAX_BIAS:g} to {MAX_BIAS:g}, not {self.lod_bias:g}")
        if not 0 <= self.eps2d <= 100:
            raise GlsplatError(f"eps2d needs 0 to 100 px^2, not {self.eps2d:g}")
        if not 0 < self.max_sigma <= 3.33:
            raise GlsplatError(f"max_sigma needs a value above 0 and at most 3.33, not {self.max_sigma:g}")

    def __repr__(self) -> str:
        changed = [f"{f.name}={getattr(self, f.name)!r}" for f in fields(self) if getattr(self, f.name) != f.default]
        return f"RenderConfig({', '.join(changed)})"


_NOTHING = object()


def _is_switch(value: object) -> bool:
    return isinstance(value, (bool, np.bool_))


LEAN = RenderConfig(cull_hidden="auto", level="auto", max_sigma=2.5)
"""What ``serve``, ``preview`` and ``demo`` draw with unless they are told ``--exact``: what can be told apart."""
