"""MeshBuffers: the vertices, triangles and textures of a rigged mesh on the GPU, staged once."""

from __future__ import annotations

from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.shaders.slots import UNITS
from glsplat.skinning.skin import Skin

__all__ = ["INFLUENCES", "MeshBuffers", "corners"]

INFLUENCES = 4
"""Joints a vertex, as for splats."""

_ALPHA_TO_COVERAGE = 0x809E  # GL_SAMPLE_ALPHA_TO_COVERAGE; moderngl has no name for either
_ALPHA_TO_ONE = 0x809F  # GL_SAMPLE_ALPHA_TO_ONE: the target keeps how much is covered, not how much alpha

VERTEX = np.dtype([("vertex", "f4", 3), ("uv", "f4", 2), ("joints", "u2", 4), ("weights", "f4", 4)])


class MeshBuffers:
    """One vertex buffer for all parts; a part is a range of triangles and a texture."""

    ranges: list[tuple[int, int]]  # first index and count of each part

    def __init__(self, ctx: moderngl.Context, mesh: RiggedMesh, skin: Skin, anisotropy: float) -> None:
        vertices, triangles, self.ranges = [], [], []
        indices = []
        base = first = 0
        for part in mesh.parts:
            index, uv, faces = corners(part)
            block = np.empty(len(index), VERTEX)
            block["vertex"], block["uv"] = mesh.vertices[index], (0.0, 1.0) + (1.0, -1.0) * uv  # row 0: v = 1
            block["joints"], block["weights"] = skin.joints[index], skin.weights[index]
            vertices.append(block)
            indices.append(index)
            triangles.append(faces + base)
            self.ranges.append((first, faces.size))  # of the index buffer
            base, first = base + len(block), first + faces.size
        self.indices: NDArray[np.int32] = np.concatenate(indices)  # [M] each vertex's in the mesh: seams split some
        self.triangles: int = first // 3
        self.cutouts: list[bool] = [part.cutout for part in mesh.parts]
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            self.vertices: moderngl.Buffer = ctx.buffer(np.concatenate(vertices))
            stack.callback(self.vertices.release)
            self.faces: moderngl.Buffer = ctx.buffer(np.concatenate(triangles).astype(np.uint32))
            stack.callback(self.faces.release)
            self.textures: list[moderngl.Texture] = []
            for part in mesh.parts:
                self.textures.append(_texture(ctx, part, anisotropy))
                stack.callback(self.textures[-1].release)
            self.bones: moderngl.Texture = ctx.texture((3, len(mesh.skeleton)), 4, dtype="f4")
            stack.callback(self.bones.release)
            self.bones.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._owned = stack.pop_all()

    @property
    def content(self) -> tuple[object, ...]:
        """The vertex buffer as attributes of mesh.vert.glsl and skin.glsl."""
        return (self.vertices, "3f 2f 4u2 4f", "vertex", "uv", "joints0", "weights0")

    def draw(self, ctx: moderngl.Context, array: moderngl.VertexArray, samples: int) -> None:
        """All parts into the bound framebuffer of so many samples; cut-outs end by alpha to coverage where it has some.

        ``array`` is this mesh's, with a program that includes cutout.glsl; the bone texture is written already.
        """
        self.bones.use(UNITS["bones"])
        switches = (_ALPHA_TO_COVERAGE, _ALPHA_TO_ONE) if samples > 1 else ()
        for switch in switches:
            ctx.enable_direct(switch)
        try:
            for (first, count), texture, cutout in zip(self.ranges, self.textures, self.cutouts, strict=True):
                texture.use(UNITS["skin_texture"])
                array.program["lowest"] = (0.5 / samples) * cutout
                array.render(moderngl.TRIANGLES, vertices=count, first=first)
        finally:
            for switch in switches:
                ctx.disable_direct(switch)

    @property
    def nbytes(self) -> int:
        """GPU bytes, mip maps included."""
        texels = sum(t.width * t.height * 4 for t in self.textures)
        return self.vertices.size + self.faces.size + self.bones.width * self.bones.height * 16 + texels * 4 // 3

    def release(self) -> None:
        """Delete buffers and textures."""
        self._owned.close()


def corners(part: MeshPart) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.int64]]:
    """Vertices split where the texture has a seam: index [M] in the mesh, uv [M, 2], triangles [F, 3] of those."""
    uv = np.ascontiguousarray(part.uv.reshape(-1, 2), np.float32)
    keys = np.concatenate([part.faces.reshape(-1, 1).astype(np.int32), uv.view(np.int32)], axis=1)
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    return unique[:, 0], np.ascontiguousarray(unique[:, 1:]).view(np.float32), inverse.reshape(-1, 3)


def _texture(ctx: moderngl.Context, part: MeshPart, anisotropy: float) -> moderngl.Texture:
    pixels = part.texture
    if part.cutout:
        alpha = pixels[..., 3:].astype(np.float32) / 255
        pixels = np.concatenate([np.rint(pixels[..., :3] * alpha).astype(np.uint8), pixels[..., 3:]], axis=2)
    height, width = pixels.shape[:2]
    texture = ctx.texture((width, height), 4, np.ascontiguousarray(pixels))
    texture.build_mipmaps()  # averages the stored values: no gamma here either
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    texture.anisotropy = anisotropy
    return texture
