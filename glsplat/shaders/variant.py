"""Variants: what a program is compiled for. Frozen values, decided in one function each; the program-cache key."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

from glsplat.config import RenderConfig
from glsplat.errors import ShaderError

__all__ = [
    "COLOUR_TEXELS",
    "MAX_VIEWS",
    "ROW_BITS",
    "TARGETS",
    "MeshVariant",
    "ResolveVariant",
    "SkinVariant",
    "Variant",
    "record_layout",
    "variant_for",
]

MAX_VIEWS = 2
"""Views one pass draws: one, or a stereo pair. Longer lists of cameras run pass after pass."""

COLOUR_TEXELS = (1, 3, 7, 12)
"""Texels a splat of SH data on the GPU, by degree: of three floats at degree 0, else of four (degree 2 is padded)."""

ROW_BITS = {"330": 10, "es300": 9}
"""Splats a row of the arena's textures, as a power of two, by target: where a texture is 8192 wide, as SwiftShader's,
1024 splats of SH degree 3 do not fit."""

TARGETS = tuple(ROW_BITS)
"""What a program is assembled for: desktop OpenGL (GLSL 3.30 core), or WebGL2 (GLSL ES 3.00)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """The frame's passes. Every field becomes a #define with a number; what is 0 is not compiled, nothing bound."""

    sh_degree: int = 0  # evaluated, 0..3; 0 evaluates no basis and keeps one colour for all views
    stored_degree: int = 0  # of the scene's colours on the GPU: at least sh_degree
    posed: int = 0  # the splats were posed or placed by the passes of their items
    turned: int = 0  # posed splats carry R_i (SH that turns with them)
    views: int = 1  # layers drawn at once; 1 has no layer code
    antialias: int = 0  # opacity compensation, one opacity a view; 2: of the splats that ask for it
    geometry: int = 0  # layers routed by a geometry shader where the vertex shader cannot
    triangle: int = 0  # a splat is one triangle around its ellipse instead of a quad
    pulled: int = 0  # the draw reads records from a storage buffer by gl_VertexID instead of attributes an instance
    cull_hidden: int = 0  # the key pass looks at visibility cones
    cut: int = 0  # splats end at max_sigma although alpha is still above 1/255 there
    depth: int = 0  # a second target takes weight times camera z
    occluded: int = 0  # meshes at pixel centres, and splats are tested against their z
    sampled: int = 0  # samples a pixel of meshes; without occluded there is nothing else, and coverage is their alpha
    lit: int = 0  # light falls on surfaces (light.glsl)
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
        """Name -> number for the preprocessor, plus the facts that follow from the fields."""
        values = _numbers(self)
        del values["STORED_DEGREE"]  # shaders know it as:
        values["COLOUR_TEXELS"] = COLOUR_TEXELS[self.stored_degree]
        values["ROW_BITS"] = ROW_BITS[self.target]
        values["SHARED_RGB"] = int(self.sh_degree == 0)
        values["SHARED_ALPHA"] = int(not self.antialias)
        return values

    @property
    def record_floats(self) -> int:
        """Floats of one projected record: what the views share, then what differs, view by view."""
        return sum(floats for _, floats in record_layout(self))


def record_layout(variant: Variant) -> list[tuple[str, int]]:
    """(captured varying of project.vert.glsl, which is the attribute of record_input.glsl; floats) of a record."""

    def spread(name: str, floats: int, views: Iterable[int] = range(variant.views)) -> list[tuple[str, int]]:
        return [(f"{name}{view}", floats) for view in views]

    layout = spread("rgb", 3, range(1)) if variant.sh_degree == 0 else spread("rgb", 3)
    layout += spread("alpha", 1) if variant.antialias else spread("alpha", 1, range(1))
    layout += spread("centre", 2) + spread("cholesky", 3)
    return layout + (spread("z", 1) if variant.depth or variant.occluded else [])


@dataclass(frozen=True, slots=True, kw_only=True)
class SkinVariant:
    """The pass that poses one avatar (or one mesh)."""

    influences: int = 4  # joints a splat: 1, 2, 4, 8
    raw: int = 0  # by the blended matrix as it is instead of its nearest rotation
    turned: int = 0  # R_i is handed on (SH that turns with the splat)
    shaped: int = 0  # an expression moves the splats first (shapes.glsl)
    target: str = "330"

    def __post_init__(self) -> None:
        if self.influences not in (1, 2, 4, 8):
            raise ShaderError(f"skin variant: influences is 1, 2, 4 or 8, not {self.influences}")
        _check_target(self.target)

    def defines(self) -> dict[str, int]:
        """Name -> number for the preprocessor."""
        return _numbers(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshVariant:
    """What draws a textured mesh, one view at a time."""

    influences: int = 4  # joints a vertex
    logarithmic: int = 0  # depth of the meshes of a scene by log z: any range, but one depth a pixel and triangle
    shaded: int = 0  # light a vertex

    def defines(self) -> dict[str, int]:
        """Name -> number for the preprocessor."""
        return _numbers(self) | {"VIEWS": 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolveVariant:
    """The pass that makes 8-bit pictures, one view at a time."""

    cull_hidden: int = 0  # what was left out is made up for
    target: str = "330"

    def __post_init__(self) -> None:
        _check_target(self.target)

    def defines(self) -> dict[str, int]:
        """Name -> number for the preprocessor."""
        return _numbers(self) | {"VIEWS": 1, "GEOMETRY": 0}


def variant_for(
    views: int,
    config: RenderConfig,
    *,
    stored_degree: int = 0,  # of the scene
    sh_degree: int = 3,  # asked for by the cameras
    posed: bool = False,
    antialias: frozenset[bool] = frozenset({False}),  # what the scene's items ask for
    geometry: bool = False,
    triangle: bool = False,
    pulled: bool = False,
    depth: bool = False,
    occluded: bool = False,
    sampled: int = 0,  # samples
    numbered: bool = False,
    cones: bool = False,  # some of the splats are culled by them
    lit: bool = False,  # there is light, and some of the splats know their surface
) -> Variant:
    """What a scene needs under a config, and nothing more."""
    degree = min(stored_degree, sh_degree, config.sh_degree)
    asked = antialias if config.antialias is None else frozenset({config.antialias})
    return Variant(
        sh_degree=degree,
        stored_degree=stored_degree,
        posed=int(posed),
        turned=int(posed and degree > 0),
        views=views,
        antialias=2 if len(asked) > 1 else int(True in asked),
        geometry=int(geometry),  # for one view too: it orders the vertices, and a pair has to equal its singles
        triangle=int(triangle),
        pulled=int(pulled),
        cull_hidden=int(cones),
        lit=int(lit),
        cut=int(config.max_sigma < 3.33),
        depth=int(depth),
        occluded=int(occluded),
        sampled=sampled,
        numbered=int(numbered),
    )


def _numbers(variant: Variant | SkinVariant | MeshVariant | ResolveVariant) -> dict[str, int]:
    numbers = [field.name for field in fields(variant) if field.name != "target"]
    values = {name.upper(): int(getattr(variant, name)) for name in numbers}
    return values | {"ES": int(getattr(variant, "target", "330") == "es300")}


def _check_target(target: str) -> None:
    if target not in TARGETS:
        raise ShaderError(f"variant: target is {' or '.join(TARGETS)}, not {target}")
