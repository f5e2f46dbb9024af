"""Programs: compiled and linked, one for each distinct text; errors name the chunk and its line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import moderngl

from glsplat.errors import ShaderError
from glsplat.shaders.slots import bind_slots
from glsplat.shaders.source import STORAGE_VERSION, Source, flatten
from glsplat.shaders.uninterrupted import uninterrupted
from glsplat.shaders.variant import MeshVariant, ResolveVariant, SkinVariant, Variant

__all__ = ["Programs", "link"]


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
