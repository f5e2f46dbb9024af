"""Run one GLSL function over numpy arrays through transform feedback (every driver, no compute needed)."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.shaders import MeshVariant, SkinVariant, Variant, flatten, link


def run_chunk(
    context: Context,
    text: str,  # a vertex shader with #include lines, inputs named like ``inputs`` and outputs like ``outputs``
    inputs: Mapping[str, NDArray[np.generic]],  # [N] or [N, k]
    outputs: Mapping[str, int],  # name -> floats
    variant: Variant | SkinVariant | MeshVariant | None = None,
    frame: NDArray[np.void] | None = None,
    # sampler -> [rows, columns, components] of uint32, or of what becomes float32
    textures: Mapping[str, NDArray[np.generic]] | None = None,
    uniforms: Mapping[str, float | tuple[float, ...]] | None = None,
    vertices: int | None = None,  # where there are no inputs
) -> dict[str, NDArray[np.float32]]:
    """[N, floats] of each output."""
    ctx = context.ctx
    source = flatten(
        "chunk_under_test.vert.glsl",
        (variant or Variant()).defines(),
        overrides={"chunk_under_test.vert.glsl": text},
    )
    program = link(ctx, "chunk under test", {"vertex_shader": source}, tuple(outputs))
    buffers: list[moderngl.Buffer | moderngl.Texture] = []
    content = []
    count = len(next(iter(inputs.values()))) if vertices is None else vertices
    for name, array in inputs.items():
        data = np.ascontiguousarray(array)
        width = 1 if data.ndim == 1 else data.shape[1]
        kind = {"f": "f4", "u": "u4"}[data.dtype.kind]
        buffers.append(ctx.buffer(data.astype(kind)))
        content.append((buffers[-1], f"{width}{kind}", name))
    total = sum(outputs.values())
    result = ctx.buffer(reserve=count * total * 4)
    if frame is not None:
        block = ctx.buffer(frame.tobytes())
        buffers.append(block)
        member = program["Frame"]
        assert isinstance(member, moderngl.UniformBlock)
        member.binding = 0
        block.bind_to_uniform_block(0)
    for unit, (name, texels) in enumerate((textures or {}).items()):
        rows, columns, components = texels.shape
        dtype, kind = ("u4", np.uint32) if texels.dtype.kind == "u" else ("f4", np.float32)
        buffers.append(ctx.texture((columns, rows), components, np.ascontiguousarray(texels, kind), dtype=dtype))
        buffers[-1].use(unit)
        program[name] = unit
    for name, value in (uniforms or {}).items():
        program[name] = value
    context.scratch.use()
    array_object = ctx.vertex_array(program, content)
    array_object.transform(result, moderngl.POINTS, vertices=count)
    flat = np.frombuffer(result.read(), np.float32).reshape(count, total)
    for item in (array_object, program, result, *buffers):
        item.release()
    out, start = {}, 0
    for name, floats in outputs.items():
        out[name] = flat[:, start : start + floats]
        start += floats
    return out
