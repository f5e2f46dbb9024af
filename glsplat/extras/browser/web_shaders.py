"""All programs of the page as one JSON object: the same chunks, assembled for WebGL2 (GLSL ES 3.00).

A program's variants share its text and differ in their #defines. ``web/draw/programs.js`` joins head, defines and body;
the text is that of ``flatten``, byte for byte.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import Any

from glsplat.config import RenderConfig
from glsplat.shaders.slots import FRAME_BLOCK, UNITS
from glsplat.shaders.source import ES_HEAD, flatten
from glsplat.shaders.variant import (
    COLOUR_TEXELS,
    MAX_VIEWS,
    ROW_BITS,
    ResolveVariant,
    SkinVariant,
    Variant,
    record_layout,
)

_ES = "es300"
_POSED = ("posed_mean", "posed_x", "posed_y", "posed_z")

Row = tuple[str, tuple[str, ...], tuple[str, ...], Variant | SkinVariant | ResolveVariant]


def page_variants() -> Iterator[Row]:
    """Yield (name, stages, captured outputs, variant) of each program of the page.

    The page's names are "skin INFLUENCES TURNED SHAPED", "place", "project DEGREE ANTIALIAS VIEWS LIT",
    "splat SHARED_RGB ANTIALIAS VIEWS TRIANGLE" and "resolve".
    """
    for influences in (1, 2, 4, 8):
        for turned in (0, 1):
            for shaped in (0, 1):
                skin = SkinVariant(influences=influences, turned=turned, shaped=shaped, target=_ES)
                yield f"skin {influences} {turned} {shaped}", ("skin.vert",), _POSED, skin
    yield "place", ("place.vert",), _POSED, Variant(target=_ES)
    for views in range(1, MAX_VIEWS + 1):
        for antialias in (0, 1, 2):
            for degree in range(len(COLOUR_TEXELS)):
                for lit in (0, 1):
                    more = {"posed": 1, "turned": int(degree > 0), "antialias": antialias, "views": views, "lit": lit}
                    frame = Variant(sh_degree=degree, stored_degree=degree, target=_ES, **more)
                    captured = tuple(name for name, _ in record_layout(frame))
                    yield f"project {degree} {antialias} {views} {lit}", ("project.vert",), captured, frame
        for shared in (0, 1):
            for compensated in (0, 1):
                for triangle in (0, 1):
                    degree = 1 - shared
                    flags = {"posed": 1, "turned": degree, "antialias": compensated, "views": views, "pulled": 1}
                    drawn = Variant(sh_degree=degree, stored_degree=degree, triangle=triangle, target=_ES, **flags)
                    yield f"splat {shared} {compensated} {views} {triangle}", ("splat.vert", "splat.frag"), (), drawn
    yield "resolve", ("screen.vert", "resolve.frag"), (), ResolveVariant(target=_ES)


@cache
def page_programs() -> dict[str, Any]:
    """Return {"head", "stages": {name: body}, "programs": {name: {"stages", "captured", "defines"}}, "units", ...}.

    ``defines`` has only the flags that a stage reads, by stage. The result is cached: do not change it.
    """
    stages: dict[str, str] = {}
    programs: dict[str, Any] = {}
    for name, parts, captured, variant in page_variants():
        defines: list[list[str]] = []
        for part in parts:
            source = flatten(f"{part}.glsl", variant.defines())
            lines = source.text.splitlines()
            own = [line for line, (chunk, _) in zip(lines, source.origin, strict=True) if chunk == "<defines>"]
            defines.append([line.removeprefix("#define ") for line in own if line.startswith("#define ")])
            stages[part] = "\n".join(lines[len(own) :]) + "\n"
        programs[name] = {"stages": list(parts), "captured": list(captured), "defines": defines}
    config = RenderConfig()
    return {
        "head": ES_HEAD,
        "stages": stages,
        "programs": programs,
        "units": UNITS,
        "frame_block": FRAME_BLOCK,
        "row_bits": ROW_BITS[_ES],
        "colour_texels": COLOUR_TEXELS,
        "knobs": [config.debug.eps2d, config.max_sigma, 0.0, config.debug.cull_margin],
    }


def programs_json() -> bytes:
    """Return ``page_programs`` as JSON, the page's draw/programs.json."""
    return json.dumps(page_programs(), separators=(",", ":")).encode()
