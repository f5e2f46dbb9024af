"""Programs: compile and link each distinct text once; errors name the chunk and its line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

import moderngl

from glsplat.errors import ShaderError
from glsplat.shaders.slots import FRAME_BLOCK, UNITS
from glsplat.shaders.source import STORAGE_VERSION, Source, flatten
from glsplat.shaders.variant import Options


class Programs:
    """Compiled programs of one context, one for each distinct text, which it owns."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._cache: dict[tuple[object, ...], moderngl.Program | moderngl.ComputeShader] = {}

    def __len__(self) -> int:
        return len(self._cache)

    def feedback(self, name: str, variant: Options, varyings: Sequence[str]) -> moderngl.Program:
        """Return the program ``name``.vert.glsl that captures ``varyings``, interleaved in one buffer."""
        return self._get(name, {"vertex_shader": f"{name}.vert.glsl"}, variant, varyings)

    def draw(
        self,
        vertex: str,
        fragment: str,
        variant: Options,
        overrides: Mapping[str, str] = {},  # texts of chunks
    ) -> moderngl.Program:
        """Return the program of two stages; with ``variant.geometry`` ``vertex``.geom.glsl routes the layers.

        ``variant.pulled`` needs OpenGL 4.3.
        """
        stages = {"vertex_shader": f"{vertex}.vert.glsl", "fragment_shader": f"{fragment}.frag.glsl"}
        if variant.defines().get("GEOMETRY"):
            stages["geometry_shader"] = f"{vertex}.geom.glsl"
        return self._get(vertex, stages, variant, overrides=overrides)

    def _get(
        self,
        name: str,
        stages: Mapping[str, str],
        variant: Options,
        varyings: Sequence[str] = (),
        overrides: Mapping[str, str] = {},
    ) -> moderngl.Program:
        sources = {stage: flatten(file, variant.defines(), overrides=overrides) for stage, file in stages.items()}
        key = (*(source.text for source in sources.values()), *varyings)
        if key not in self._cache:
            self._cache[key] = link(self._ctx, name, sources, varyings)
        program = self._cache[key]
        assert isinstance(program, moderngl.Program)
        return program

    def compute(self, name: str) -> moderngl.ComputeShader:
        """Return the compute shader ``name``.comp.glsl; needs OpenGL 4.3."""
        source = flatten(f"{name}.comp.glsl", {}, STORAGE_VERSION)
        key = (source.text,)
        if key not in self._cache:
            try:
                with _deferred_signals():
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
) -> moderngl.Program:
    """Return the linked program, its samplers and Frame block bound to their slots.

    Raises ShaderError, which names the chunk and its line.
    """
    try:
        with _deferred_signals():
            program: moderngl.Program = ctx.program(
                vertex_shader=stages["vertex_shader"].text,
                fragment_shader=stages["fragment_shader"].text if "fragment_shader" in stages else None,
                geometry_shader=stages["geometry_shader"].text if "geometry_shader" in stages else None,
                varyings=tuple(varyings),
                varyings_capture_mode="interleaved",
            )
    except moderngl.Error as error:
        raise ShaderError(_message(name, stages, str(error))) from None
    block = program.get("Frame", None)
    if isinstance(block, moderngl.UniformBlock):
        block.binding = FRAME_BLOCK
    set_uniforms(program, UNITS)
    return program


def set_uniforms(program: moderngl.Program | moderngl.ComputeShader, values: Mapping[str, Any]) -> None:
    """Set uniforms by name, those that changed; the compiler removes those that the program does not read.

    A uniform that is set here has to be set nowhere else.
    """
    if program.extra is None:
        program.extra = {}
    for name, value in values.items():
        if program.extra.get(name) == value:
            continue
        uniform = program.get(name, None)
        if isinstance(uniform, moderngl.Uniform):
            uniform.value = value
        program.extra[name] = value


@contextmanager
def _deferred_signals() -> Iterator[None]:
    """Call Python signal handlers only after the block: moderngl crashes if one raises while it compiles."""
    if threading.current_thread() is not threading.main_thread():  # handlers run on the main thread alone
        yield
        return
    deferred: list[tuple[int, FrameType | None]] = []
    handlers: dict[int, Any] = {}

    def defer(number: int, frame: FrameType | None) -> None:
        deferred.append((number, frame))

    try:
        for number in signal.valid_signals():
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, defer)
        yield
    finally:
        for replaced, former in handlers.items():
            signal.signal(replaced, former)
        for received, frame in deferred:
            handlers[received](received, frame)


def _message(name: str, stages: Mapping[str, Source], log: str) -> str:
    # moderngl titles the log with the stage that failed; a link error has none
    failed = next((stage for stage in stages if stage in log.lower().replace(" ", "_")), next(iter(stages)))
    body = "\n".join(line for line in log.splitlines() if line.strip() and not set(line.strip()) <= {"="})
    return f"{name} does not compile:\n{stages[failed].annotate(body)}"
