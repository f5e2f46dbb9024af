"""Variants: the compile-time options of programs, as frozen values, which are also keys of the program cache."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from glsplat.config import MAX_SIGMA, RenderConfig
from glsplat.errors import ShaderError

MAX_VIEWS = 2
"""Views of one pass: one, or a stereo pair. Longer lists of cameras take several passes."""

COLOUR_TEXELS = (1, 3, 7, 12)
"""Texels of SH data per splat, by degree: of three floats at degree 0, else of four (degree 2 is padded)."""

ROW_BITS = {"330": 10, "es300": 9}
"""Log2 of the splats in a row of the arena's textures, by target: 1024 splats of SH degree 3 do not fit into a texture
that is 8192 wide, as SwiftShader's is."""

TARGETS = tuple(ROW_BITS)
"""Targets of a program: desktop OpenGL (GLSL 3.30 core), or WebGL2 (GLSL ES 3.00)."""


class Options:
    """Base of the options of a program: frozen dataclasses of numbers, and perhaps a ``target``."""

    __slots__ = ()

    def defines(self) -> dict[str, int]:
        """Return the #defines by name: the fields, and numbers that follow from them."""
        numbers = [field.name for field in fields(self) if field.name != "target"]  # type: ignore[arg-type]
        values = {name.upper(): int(getattr(self, name)) for name in numbers}
        return values | {"ES": int(getattr(self, "target", "330") == "es300")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant(Options):
    """Options of the passes of a frame. Every field becomes a #define; code of a field that is 0 is not compiled."""

    sh_degree: int = 0  # degree that is evaluated, 0 to 3; 0 keeps one colour for all views
    stored_degree: int = 0  # degree of the scene's colours on the GPU: at least sh_degree
    posed: int = 0  # the skin or place passes of the items wrote the splats
    turned: int = 0  # posed splats carry R_i, which rotates their SH
    views: int = 1  # layers drawn at once; 1 has no layer code
    antialias: int = 0  # opacity compensation, one opacity per view; 2: only of splats that request it
    geometry: int = 0  # a geometry shader routes layers where the vertex shader cannot
    triangle: int = 0  # a splat is one triangle around its ellipse instead of a quad
    pulled: int = 0  # the draw reads records from a storage buffer by gl_VertexID instead of instance attributes
    cull_hidden: int = 0  # the key pass culls by visibility cones
    cut: int = 0  # splats end at max_sigma although alpha is still above 1/255 there
    depth: int = 0  # a second target accumulates weight times camera z
    occluded: int = 0  # meshes hide splats by their z at pixel centres
    sampled: int = 0  # mesh samples per pixel; without occluded there are no splats, and coverage is alpha
    lit: int = 0  # surfaces are lit (light.glsl)
    numbered: int = 0  # an attribute numbers the splats where the driver's gl_VertexID does not
    target: str = "330"  # or "es300": one draw a view, records pulled from a texture

    def __post_init__(self) -> None:
        if not (self.sh_degree in range(4) and self.stored_degree in range(4)):
            raise ShaderError(f"variant: sh_degree is 0 to 3, not {self.sh_degree} of {self.stored_degree}")
        if self.sh_degree > self.stored_degree:
            raise ShaderError(f"variant: sh_degree {self.sh_degree} needs stored_degree, which is {self.stored_degree}")
        if self.views not in range(1, MAX_VIEWS + 1):
            raise ShaderError(f"variant: views is 1 to {MAX_VIEWS}, not {self.views}")
        if self.antialias not in (0, 1, 2):
            raise ShaderError(f"variant: antialias is 0, 1 or 2, not {self.antialias}")
        if self.turned != int(bool(self.posed and self.sh_degree)):
            raise ShaderError("variant: turned goes with posed and sh_degree > 0")
        if self.antialias == 2 and not self.posed:
            raise ShaderError("variant: antialias 2 needs posed, whose opacities carry the sign")
        _check_target(self.target)
        if self.target == "es300" and self.geometry:
            raise ShaderError("variant: es300 has no geometry shaders")

    def defines(self) -> dict[str, int]:
        """Return the #defines by name: the fields, and numbers that follow from them."""
        values = Options.defines(self)
        del values["STORED_DEGREE"]  # shaders use COLOUR_TEXELS instead
        values["COLOUR_TEXELS"] = COLOUR_TEXELS[self.stored_degree]
        values["ROW_BITS"] = ROW_BITS[self.target]
        values["SHARED_RGB"] = int(self.sh_degree == 0)
        values["SHARED_ALPHA"] = int(not self.antialias)
        return values

    @property
    def record_floats(self) -> int:
        """Return the number of floats in one projected record."""
        return sum(floats for _, floats in record_layout(self))


def record_layout(variant: Variant) -> list[tuple[str, int]]:
    """Return (name, floats) of a record's parts: varyings of project.vert.glsl, attributes of record_input.glsl."""

    def spread(name: str, floats: int, views: Iterable[int] = range(variant.views)) -> list[tuple[str, int]]:
        return [(f"{name}{view}", floats) for view in views]

    layout = spread("rgb", 3, range(1)) if variant.sh_degree == 0 else spread("rgb", 3)
    layout += spread("alpha", 1) if variant.antialias else spread("alpha", 1, range(1))
    layout += spread("centre", 2) + spread("cholesky", 3)
    return layout + (spread("z", 1) if variant.depth or variant.occluded else [])


@dataclass(frozen=True, slots=True, kw_only=True)
class SkinVariant(Options):
    """Options of the skin pass of one avatar."""

    influences: int = 4  # joints per splat: 1, 2, 4, 8
    raw: int = 0  # use the blended matrix instead of its nearest rotation
    turned: int = 0  # write R_i, which rotates the splat's SH
    shaped: int = 0  # apply an expression first (shapes.glsl)
    target: str = "330"

    def __post_init__(self) -> None:
        if self.influences not in (1, 2, 4, 8):
            raise ShaderError(f"skin variant: influences is 1, 2, 4 or 8, not {self.influences}")
        _check_target(self.target)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshVariant(Options):
    """Options of the mesh pass, which draws a textured mesh in one view."""

    influences: int = 4  # joints per vertex
    logarithmic: int = 0  # depth by log z: any range, but one depth per pixel and triangle
    shaded: int = 0  # a light factor per vertex

    def defines(self) -> dict[str, int]:
        """Return the #defines by name."""
        return Options.defines(self) | {"VIEWS": 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolveVariant(Options):
    """Options of the resolve pass, which makes the 8-bit picture of one view."""

    cull_hidden: int = 0  # compensate opacity for culled splats (lift.glsl)
    target: str = "330"

    def __post_init__(self) -> None:
        _check_target(self.target)

    def defines(self) -> dict[str, int]:
        """Return the #defines by name."""
        return Options.defines(self) | {"VIEWS": 1, "GEOMETRY": 0}


def variant_for(
    views: int,
    config: RenderConfig,
    *,
    stored_degree: int = 0,  # of the scene
    sh_degree: int = 3,  # of the cameras
    posed: bool = False,
    antialias: frozenset[bool] = frozenset({False}),  # flags of the scene's items
    cones: bool = False,  # some splats have visibility cones
    **fields: Any,  # others of the variant, as numbers or bools
) -> Variant:
    """Return the smallest variant that draws a scene under ``config``."""
    degree = min(stored_degree, sh_degree, config.sh_degree)
    asked = antialias if config.antialias is None else frozenset({config.antialias})
    others: dict[str, Any] = {name: int(value) for name, value in fields.items()}
    return Variant(
        sh_degree=degree,
        stored_degree=stored_degree,
        posed=int(posed),
        turned=int(posed and degree > 0),
        views=views,
        antialias=2 if len(asked) > 1 else int(True in asked),
        cull_hidden=int(cones),
        cut=int(config.max_sigma < MAX_SIGMA),
        **others,
    )


def _check_target(target: str) -> None:
    if target not in TARGETS:
        raise ShaderError(f"variant: target is {' or '.join(TARGETS)}, not {target}")
