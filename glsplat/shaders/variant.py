"""Variant: what a program is compiled for. One frozen value, one function that decides it; the program-cache key."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import product

from glsplat.config import RenderConfig
from glsplat.errors import ShaderError

__all__ = ["MAX_VIEWS", "SH_FLOATS", "Variant", "every_variant", "variant_for"]

MAX_VIEWS = 2
"""Views one pass draws: one, or a stereo pair. Longer lists of cameras run pass after pass."""

SH_FLOATS = (3, 12, 28, 48)
"""Floats a splat of SH data on the GPU, by degree; degree 2 is padded to whole vec4s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """Every field becomes a #define with a number; what is 0 is not compiled and its buffers are not bound."""

    sh_degree: int = 0  # 0..3; 0 evaluates no basis and keeps one colour for all views
    influences: int = 0  # joints a splat: 0 (rigid: no skin pass, no bone texture), 1, 2, 4, 8
    views: int = 1  # layers drawn at once; 1 has no layer code
    antialias: int = 0  # opacity compensation, one opacity a view
    raw: int = 0  # skinning by the blended matrix as it is instead of its nearest rotation
    geometry: int = 0  # layers routed by a geometry shader where the vertex shader cannot
    keep_rotation: int = 0  # skin pass hands R_i on (SH under skinning)
    triangle: int = 0  # a splat is one triangle around its ellipse instead of a quad
    cull_hidden: int = 0  # the key pass looks at visibility cones
    cut: int = 0  # splats end at max_sigma although alpha is still above 1/255 there

    def __post_init__(self) -> None:
        if self.sh_degree not in range(4):
            raise ShaderError(f"variant: sh_degree is 0 to 3, not {self.sh_degree}")
        if self.influences not in (0, 1, 2, 4, 8):
            raise ShaderError(f"variant: influences is 0, 1, 2, 4 or 8, not {self.influences}")
        if self.views not in range(1, MAX_VIEWS + 1):
            raise ShaderError(f"variant: views is 1 to {MAX_VIEWS}, not {self.views}")
        if (self.raw or self.keep_rotation) and not self.influences:
            raise ShaderError("variant: raw and keep_rotation are about skinning, but influences is 0")
        if self.keep_rotation != int(bool(self.influences and self.sh_degree)):
            raise ShaderError("variant: keep_rotation goes with influences > 0 and sh_degree > 0")

    def defines(self) -> dict[str, int]:
        """Name -> number for the preprocessor, plus the two facts that follow from the fields."""
        values = {field.name.upper(): int(getattr(self, field.name)) for field in fields(self)}
        values["SHARED_RGB"] = int(self.sh_degree == 0)
        values["SHARED_ALPHA"] = int(not self.antialias)
        return values

    @property
    def record_floats(self) -> int:
        """Floats of one projected record: what the views share, then what differs, view by view."""
        own = 5 + (0 if self.sh_degree == 0 else 3) + (1 if self.antialias else 0)
        shared = (3 if self.sh_degree == 0 else 0) + (0 if self.antialias else 1)
        return shared + own * self.views


def variant_for(
    sh_degree: int,  # of the scene
    influences: int,  # of the scene, 0 = rigid
    views: int,
    config: RenderConfig,
    geometry: bool = False,
    triangle: bool = False,
    antialias: bool = False,  # of the scene
) -> Variant:
    """What a scene needs under a config, and nothing more."""
    degree = min(sh_degree, config.sh_degree)
    joints = min(influences, config.influences) if config.influences else influences
    return Variant(
        sh_degree=degree,
        influences=joints,
        views=views,
        antialias=int(antialias if config.antialias is None else config.antialias),
        raw=int(bool(joints) and config.rotation == "raw"),
        geometry=int(geometry),  # for one view too: it orders the vertices, and a pair has to equal its singles
        keep_rotation=int(bool(joints) and degree > 0),
        triangle=int(triangle),
        cull_hidden=int(config.cull_hidden),
        cut=int(config.max_sigma < 3.33),
    )


def every_variant() -> Iterator[Variant]:
    """All combinations that are allowed (for the test that compiles each)."""
    for degree, joints, views, antialias, raw, geometry, triangle, cull, cut in product(
        range(4), (0, 1, 2, 4, 8), range(1, MAX_VIEWS + 1), (0, 1), (0, 1), (0, 1), (0, 1), (0, 1), (0, 1)
    ):
        if raw and not joints:
            continue
        yield Variant(
            sh_degree=degree,
            influences=joints,
            views=views,
            antialias=antialias,
            raw=raw,
            geometry=geometry,
            keep_rotation=int(bool(joints and degree)),
            triangle=triangle,
            cull_hidden=cull,
            cut=cut,
        )
