"""The per-splat passes before the sort: skin (if skinned) and key. Vertex shaders with transform feedback."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.passes.frame import FRAME_BINDING
from glsplat.passes.scene import Content, SceneBuffers
from glsplat.shaders import Programs, Variant

__all__ = ["KeyPass", "SkinPass", "bind_frame"]

BONE_UNIT = 0


class SkinPass:
    """Poses every splat once, for all views: mean', M' and, where SH needs it, R_i."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant, scene: SceneBuffers) -> None:
        names = ("posed_mean", "posed_x", "posed_y", "posed_z")
        self._scene = scene
        self._wide = bool(variant.keep_rotation)
        program = programs.feedback("skin", variant, names)
        bind_frame(program)
        _set_unit(program, "bones", BONE_UNIT)
        self.posed: moderngl.Buffer = ctx.buffer(reserve=max(16, scene.count * (64 if self._wide else 52)))
        self._array = ctx.vertex_array(program, scene.rigid_content() + scene.skin_content())

    def content(self) -> Content:
        """The posed splats as attributes of splat_input.glsl."""
        shape = "4f 4f 4f" if self._wide else "3f 3f 3f"
        return [(self.posed, f"4f {shape}", "mean_opacity", "shape_x", "shape_y", "shape_z")]

    def run(self) -> None:
        """Transform all splats by the bone texture."""
        assert self._scene.bones is not None
        self._scene.bones.use(BONE_UNIT)
        self._array.transform(self.posed, moderngl.POINTS, vertices=self._scene.count)

    def read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Means [N, 3] about the scene's origin and shapes [N, 3, 3] of the last run, on the host."""
        floats, stride = (16, 4) if self._wide else (13, 3)
        rows = np.frombuffer(self.posed.read(size=self._scene.count * floats * 4), np.float32).reshape(-1, floats)
        return rows[:, :3], np.stack([rows[:, 4 + stride * i : 7 + stride * i] for i in range(3)], axis=-1)

    def release(self) -> None:
        """Delete the posed buffer and the vertex array."""
        self._array.release()
        self.posed.release()


class KeyPass:
    """A sortable depth a splat, or the reason why no view draws it, and the tiles it touches."""

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        variant: Variant,
        content: Content,
        count: int,
        cover: moderngl.Buffer,  # [N] uint32, borrowed: the order's buffer, which is free until the sort
    ) -> None:
        program = programs.feedback("key", variant, ("key", "cover"), separate=True)
        bind_frame(program)
        self._count = count
        self.keys: moderngl.Buffer = ctx.buffer(reserve=max(16, count * 4))
        self._cover = cover
        self._array = ctx.vertex_array(program, content)
        self._host = np.empty((2, count), np.uint32)

    def run(self) -> None:
        """Write keys and tiles."""
        self._array.transform([self.keys, self._cover], moderngl.POINTS, vertices=self._count)

    def read(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """[N] the keys and [N] the packed tiles on the host; the arrays are reused by the next call."""
        if self._count:
            self.keys.read_into(self._host[0], size=self._count * 4)
            self._cover.read_into(self._host[1], size=self._count * 4)
        return self._host[0], self._host[1]

    def release(self) -> None:
        """Delete the key buffer and the vertex array."""
        self._array.release()
        self.keys.release()


def bind_frame(program: moderngl.Program) -> None:
    """Point a program's Frame block at its slot (a block no function reads is optimised away)."""
    block = program.get("Frame", None)
    if isinstance(block, moderngl.UniformBlock):
        block.binding = FRAME_BINDING


def _set_unit(program: moderngl.Program, name: str, unit: int) -> None:
    sampler = program.get(name, None)
    if isinstance(sampler, moderngl.Uniform):
        sampler.value = unit
