"""GLSL chunks and programs: flattened, checked against the variant, compiled, and errors traced to their chunk.

A chunk ``noun.glsl`` holds functions and no main(); a program ``name.stage.glsl`` includes chunks with
``#include "noun.glsl"`` (each once). Every flag is defined to a number, so ``#if FLAG`` and never ``#ifdef``: a
misspelt flag is an error here, where GLSL would take it for 0.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources

import moderngl

from glsplat.errors import ShaderError
from glsplat.shaders.slots import bind_slots
from glsplat.shaders.uninterrupted import uninterrupted
from glsplat.shaders.variant import MeshVariant, ResolveVariant, SkinVariant, Variant, variant_for

__all__ = ["MeshVariant", "Programs", "ResolveVariant", "SkinVariant", "Source", "Variant", "flatten", "variant_for"]

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_CONDITION = re.compile(r"^\s*#(?:if|elif)\b(.*)$")
_NAME = re.compile(r"\b[A-Za-z_]\w*\b")
# Mesa "0:12(3): error", NVIDIA "0(12) : error", Intel and Apple "ERROR: 0:12:"
_LOG_LINE = re.compile(r"^(?:(?:ERROR|WARNING): )?\d+[:(](\d+)\)?(?:\(\d+\))?\s*:?\s*(.*)$", re.MULTILINE)

VERSION = "#version 330 core"
STORAGE_VERSION = "#version 430 core"
"""Of texts with storage buffers: compute shaders, and what reads PULLED."""
LAYER_EXTENSIONS = (
    "#extension GL_ARB_shader_viewport_layer_array : enable\n"
    "#extension GL_AMD_vertex_shader_layer : enable\n"
    "#extension GL_NV_viewport_array2 : enable"
)


class Source:
    """Flattened text of one stage and, for each of its lines, the chunk and line it came from."""

    def __init__(self, text: str, origin: list[tuple[str, int]]) -> None:
        self.text = text
        self.origin = origin

    def annotate(self, log: str) -> str:
        """A compiler log whose positions name chunk and line instead of the flattened text."""

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
    """Text of program stage ``name`` with its chunks, after ``version`` and one #define a flag.

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
    # only the flags this text reads: programs that differ in others are the same text, and compiled once
    used = set(_NAME.findall("\n".join(lines)))
    head = [STORAGE_VERSION if defines.get("PULLED") and "PULLED" in used else version]
    if defines.get("VIEWS", 1) > 1 and name.endswith(".vert.glsl"):
        head += LAYER_EXTENSIONS.splitlines()
    head += [f"#define {key} {value}" for key, value in defines.items() if key in used]
    return Source("\n".join(head + lines) + "\n", [("<defines>", i + 1) for i in range(len(head))] + origin)


class Programs:
    """Compiled programs of one context, one for each distinct text; owns them."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._cache: dict[tuple[object, ...], moderngl.Program | moderngl.ComputeShader] = {}

    def __len__(self) -> int:
        return len(self._cache)

    def feedback(
        self, name: str, variant: Variant | SkinVariant, varyings: Sequence[str], separate: bool = False
    ) -> moderngl.Program:
        """Program ``name``.vert.glsl that captures ``varyings`` (into one buffer, or one each) and draws nothing."""
        return self._get(name, {"vertex_shader": f"{name}.vert.glsl"}, variant, varyings, separate)

    def draw(
        self,
        vertex: str,
        fragment: str,
        variant: Variant | MeshVariant | ResolveVariant,
        overrides: Mapping[str, str] = {},  # texts of chunks
    ) -> moderngl.Program:
        """Program of two stages; with ``variant.geometry`` ``vertex``.geom.glsl routes the layers.

        With ``variant.pulled`` it needs OpenGL 4.3.
        """
        stages = {"vertex_shader": f"{vertex}.vert.glsl", "fragment_shader": f"{fragment}.frag.glsl"}
        if variant.defines().get("GEOMETRY"):
            stages["geometry_shader"] = f"{vertex}.geom.glsl"
        return self._get(vertex, stages, variant, overrides=overrides)

    def _get(
        self,
        name: str,
        stages: Mapping[str, str],
        variant: Variant | SkinVariant | MeshVariant | ResolveVariant,
        varyings: Sequence[str] = (),
        separate: bool = False,
        overrides: Mapping[str, str] = {},
    ) -> moderngl.Program:
        sources = {stage: flatten(file, variant.defines(), overrides=overrides) for stage, file in stages.items()}
        key = (*(source.text for source in sources.values()), *varyings, separate)
        if key not in self._cache:
            self._cache[key] = bind_slots(link(self._ctx, name, sources, varyings, separate))
        program = self._cache[key]
        assert isinstance(program, moderngl.Program)
        return program

    def compute(self, name: str) -> moderngl.ComputeShader:
        """Compute shader ``name``.comp.glsl; needs OpenGL 4.3."""
        source = flatten(f"{name}.comp.glsl", {}, STORAGE_VERSION)
        key = (source.text,)
        if key not in self._cache:
            try:
                with uninterrupted():
                    self._cache[key] = self._ctx.compute_shader(source.text)
            except moderngl.Error as error:
                raise ShaderError(_message(f"{name}.comp.glsl", {"compute_shader": source}, str(error))) from None
        program = self._cache[key]
        assert isinstance(program, moderngl.ComputeShader)
        return program

    def release(self) -> None:
        """Delete all programs."""
        for program in self._cache.values():
            program.release()
        self._cache.clear()


def link(
    ctx: moderngl.Context,
    name: str,
    stages: Mapping[str, Source],
    varyings: Sequence[str] = (),
    separate: bool = False,
) -> moderngl.Program:
    """Compile and link; a ShaderError names the chunk and its line."""
    try:
        with uninterrupted():
            return ctx.program(
                vertex_shader=stages["vertex_shader"].text,
                fragment_shader=stages["fragment_shader"].text if "fragment_shader" in stages else None,
                geometry_shader=stages["geometry_shader"].text if "geometry_shader" in stages else None,
                varyings=tuple(varyings),
                varyings_capture_mode="separate" if separate else "interleaved",
            )
    except moderngl.Error as error:
        raise ShaderError(_message(name, stages, str(error))) from None


def _message(name: str, stages: Mapping[str, Source], log: str) -> str:
    # moderngl titles the log with the stage that failed; a link error belongs to none
    failed = next((stage for stage in stages if stage in log.lower().replace(" ", "_")), next(iter(stages)))
    body = "\n".join(line for line in log.splitlines() if line.strip() and not set(line.strip()) <= {"="})
    return f"{name} does not compile:\n{stages[failed].annotate(body)}"
