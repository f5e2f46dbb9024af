"""GLSL chunks and programs as text: flatten them, check their flags, and map compiler errors to chunks.

A chunk ``noun.glsl`` has functions and no main(); a program ``name.stage.glsl`` includes chunks with
``#include "noun.glsl"`` (each once). Every flag is defined as a number, so shaders write ``#if FLAG``, never
``#ifdef``: a misspelt flag is an error here, where GLSL would read it as 0. This module calls no OpenGL.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import resources

from glsplat.errors import ShaderError

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_CONDITION = re.compile(r"^\s*#(?:if|elif)\b(.*)$")
_NAME = re.compile(r"\b[A-Za-z_]\w*\b")
# Mesa "0:12(3): error", NVIDIA "0(12) : error", Intel and Apple "ERROR: 0:12:"
_LOG_LINE = re.compile(r"^(?:(?:ERROR|WARNING): )?\d+[:(](\d+)\)?(?:\(\d+\))?\s*:?\s*(.*)$", re.MULTILINE)

VERSION = "#version 330 core"
STORAGE_VERSION = "#version 430 core"
"""Version of texts with storage buffers: compute shaders, and shaders that read PULLED."""
ES_HEAD = (
    "#version 300 es\n"
    "precision highp float;\n"
    "precision highp int;\n"
    "precision highp sampler2D;\n"
    "precision highp sampler2DArray;\n"
    "precision highp usampler2D;"
)
"""Head of texts for the target es300, whose fragment shaders have no default precision."""

LAYER_EXTENSIONS = (
    "#extension GL_ARB_shader_viewport_layer_array : enable\n"
    "#extension GL_AMD_vertex_shader_layer : enable\n"
    "#extension GL_NV_viewport_array2 : enable"
)


class Source:
    """Flattened text of one stage, and the chunk and line number of each of its lines."""

    def __init__(self, text: str, origin: list[tuple[str, int]]) -> None:
        self.text = text
        self.origin = origin

    def annotate(self, log: str) -> str:
        """Return a compiler log whose positions name chunk and line instead of the flattened text."""

        def where(match: re.Match[str]) -> str:
            line = int(match.group(1)) - 1
            name, number = self.origin[line] if 0 <= line < len(self.origin) else ("?", 0)
            return f"{name}:{number}: {match.group(2)}"

        return _LOG_LINE.sub(where, log)


@cache
def _read(name: str) -> tuple[str, ...]:
    file = resources.files("glsplat.shaders") / name
    if not file.is_file():
        raise ShaderError(f"no shader chunk {name}")
    return tuple(file.read_text(encoding="utf-8").splitlines())


def flatten(name: str, defines: Mapping[str, int], version: str = VERSION, overrides: Mapping[str, str] = {}) -> Source:
    """Return the text of program stage ``name`` with its chunks, after ``version`` and a #define for each flag.

    ``overrides`` replaces the text of chunks. Raises ShaderError for an unknown chunk or an undefined flag.
    """
    lines: list[str] = []
    origin: list[tuple[str, int]] = []
    seen: set[str] = set()

    def add(chunk: str, trail: tuple[str, ...]) -> None:
        if chunk in trail:
            raise ShaderError(f"{chunk} includes itself through {' > '.join(trail)}")
        if chunk in seen:
            return
        seen.add(chunk)
        text = overrides[chunk].splitlines() if chunk in overrides else _read(chunk)
        for number, line in enumerate(text, 1):
            include = _INCLUDE.match(line)
            if include:
                add(include.group(1), (*trail, chunk))
                continue
            condition = _CONDITION.match(line)
            if condition:
                for flag in _NAME.findall(condition.group(1).split("//")[0]):
                    if flag not in defines:
                        raise ShaderError(f"{chunk}:{number}: flag {flag} is not a field of Variant")
            lines.append(line)
            origin.append((chunk, number))

    add(name, ())
    # define only the flags that this text reads: variants that differ in others share one program
    used = set(_NAME.findall("\n".join(lines)))
    if defines.get("ES"):
        head = ES_HEAD.splitlines()
    else:
        head = [STORAGE_VERSION if defines.get("PULLED") and "PULLED" in used else version]
        if defines.get("VIEWS", 1) > 1 and name.endswith(".vert.glsl"):
            head += LAYER_EXTENSIONS.splitlines()
    head += [f"#define {key} {value}" for key, value in defines.items() if key in used]
    return Source("\n".join(head + lines) + "\n", [("<defines>", i + 1) for i in range(len(head))] + origin)
