"""MeshBuffers: a rigged mesh of a scene on the GPU, and its placement."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer.bounds import Bounds
from glsplat.renderer.owned import data_texture, owned
from glsplat.renderer.skin import Placement
from glsplat.shaders import MeshVariant, Programs, set_uniforms
from glsplat.shaders.slots import UNITS
from glsplat.skinning.skin import Skin

INFLUENCES = 4
"""Joints a vertex, as for splats."""

_ALPHA_TO_COVERAGE = 0x809E  # GL_SAMPLE_ALPHA_TO_COVERAGE; moderngl has no name for either
_ALPHA_TO_ONE = 0x809F  # GL_SAMPLE_ALPHA_TO_ONE: alpha of the target is coverage

_ATTRIBUTES, _NAMES = "3f 2f 4u2 4f", ("vertex", "uv", "joints0", "weights0")  # of mesh.vert.glsl, skin.glsl
_VERTEX = np.dtype([("vertex", "f4", 3), ("uv", "f4", 2), ("joints", "u2", 4), ("weights", "f4", 4)])


class MeshBuffers:
    """One vertex buffer for all parts; a part is a range of triangles and a texture."""

    def __init__(self, context: Context, mesh: RiggedMesh, anisotropy: int) -> None:
        ctx, skin = context.ctx, Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton), INFLUENCES)
        self._ctx, self._rest, self._reach = ctx, mesh.skeleton.joints, reach_of(mesh, skin)
        used = np.unique(mesh.faces)
        self.bounds: Bounds = Bounds.of_mesh(mesh.vertices[used], skin.take(used), len(mesh.skeleton))
        self._placed = np.zeros((len(mesh.skeleton), 3, 4))  # bones about the origin of the last place()
        self._arrays: dict[MeshVariant, moderngl.VertexArray] = {}
        self._ranges: list[tuple[int, int]] = []  # first index and count of each part
        vertices, indices, triangles = [], [], []
        base = first = 0
        for part in mesh.parts:
            index, uv, faces = split_vertices(part)
            block = np.empty(len(index), _VERTEX)
            block["vertex"], block["uv"] = mesh.vertices[index], (0.0, 1.0) + (1.0, -1.0) * uv  # row 0: v = 1
            block["joints"], block["weights"] = skin.joints[index], skin.weights[index]
            vertices.append(block)
            indices.append(index)
            triangles.append(faces + base)
            self._ranges.append((first, faces.size))
            base, first = base + len(block), first + faces.size
        self._indices: NDArray[np.int32] = np.concatenate(indices)  # [M] each vertex's in the mesh: seams split some
        self._cutouts = [part.cutout for part in mesh.parts]
        self._shade: moderngl.Buffer | None = None
        self.shaded = False
        with ExitStack() as stack:  # releases everything if an allocation fails
            self._vertices: moderngl.Buffer = owned(stack, ctx.buffer(np.concatenate(vertices)))
            self._faces: moderngl.Buffer = owned(stack, ctx.buffer(np.concatenate(triangles).astype(np.uint32)))
            most = min(anisotropy, ctx.max_anisotropy)
            self._textures = [owned(stack, _texture(ctx, part, most)) for part in mesh.parts]
            self._bones = data_texture(stack, ctx, (3, len(mesh.skeleton)), 4)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes, mip maps included."""
        texels = sum(texture.width * texture.height * 4 for texture in self._textures)
        shade = 0 if self._shade is None else self._shade.size
        bones = self._bones.width * self._bones.height * 16
        return self._vertices.size + self._faces.size + bones + shade + texels * 4 // 3

    def place(self, placement: Placement, origin: NDArray[np.float64]) -> None:
        """Write the bones about ``origin`` [3], in the world."""
        assert placement.bones is not None
        self._placed = placement.size * (placement.turn @ placement.bones)
        self._placed[:, :, 3] += placement.offset - origin
        self._bones.write(self._placed.astype(np.float32))

    def shade(self, factors: NDArray[np.float32] | None) -> None:
        """Multiply the linear colours of the mesh's vertices by ``factors`` [N, 3] ; None: the mesh is not lit."""
        self.shaded = factors is not None
        if factors is not None:
            values = np.ascontiguousarray(factors[self._indices])
            if self._shade is None:
                self._shade = owned(self._owned, self._ctx.buffer(reserve=values.nbytes, dynamic=True))
            self._shade.write(values)

    def depths(self, camera: Camera, origin: NDArray[np.float64]) -> tuple[float, float]:
        """Return the least and largest camera z in metres that the placed mesh may have; the first may be negative.

        A vertex is a weighted mean of positions around its posed joints, so it lies within balls around these.
        """
        bones = self._placed
        centres = np.einsum("jik,jk->ji", bones[:, :, :3], self._rest) + bones[:, :, 3] + origin
        depth = centres @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        size = self._reach * np.linalg.norm(bones[:, :, :3], ord=2, axis=(1, 2))
        used = self._reach >= 0
        return float((depth - size)[used].min()), float((depth + size)[used].max())

    def draw(self, programs: Programs, variant: MeshVariant, samples: int) -> None:
        """Draw all parts into the bound framebuffer of ``samples`` a pixel, which antialias the edges of cut-outs."""
        array = self._array(programs, replace(variant, shaded=int(self.shaded)))
        self._bones.use(UNITS["bones"])
        switches = (_ALPHA_TO_COVERAGE, _ALPHA_TO_ONE) if samples > 1 else ()
        for switch in switches:
            self._ctx.enable_direct(switch)
        try:
            for (first, count), texture, cutout in zip(self._ranges, self._textures, self._cutouts, strict=True):
                texture.use(UNITS["skin_texture"])
                set_uniforms(array.program, {"lowest": (0.5 / samples) * cutout})
                array.render(moderngl.TRIANGLES, vertices=count, first=first)
        finally:
            for switch in switches:
                self._ctx.disable_direct(switch)

    def release(self) -> None:
        """Delete vertex arrays, buffers and textures."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        self._owned.close()

    def _array(self, programs: Programs, variant: MeshVariant) -> moderngl.VertexArray:
        if variant not in self._arrays:
            content: list[tuple[object, ...]] = [(self._vertices, _ATTRIBUTES, *_NAMES)]
            if variant.shaded:
                content.append((self._shade, "3f", "shade"))
            program = programs.draw("mesh", "mesh", variant)
            self._arrays[variant] = self._ctx.vertex_array(program, content, index_buffer=self._faces)
        return self._arrays[variant]


def fitted(camera: Camera, least: float, largest: float) -> Camera:
    """Return the camera with near and far moved inwards to these depths in metres."""
    near, far = max(camera.near, least * 0.99), min(camera.far, largest * 1.01)
    return replace(camera, near=near, far=max(far, near * 1.001))


def reach_of(mesh: RiggedMesh, skin: Skin) -> NDArray[np.float64]:
    """Return metres [J] from each joint to the farthest vertex that it moves, at rest; -1 if it moves none."""
    reach = np.full(len(mesh.skeleton), -1.0)
    for ids, weights in zip(skin.joints.T, skin.weights.T, strict=True):
        distance = np.linalg.norm(mesh.vertices - mesh.skeleton.joints[ids], axis=1)
        np.maximum.at(reach, ids, np.where(weights > 0, distance, -1.0))
    return reach


def split_vertices(part: MeshPart) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.int64]]:
    """Split vertices where the texture has a seam: return indices [M] in the mesh, uv [M, 2], triangles [F, 3]."""
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
