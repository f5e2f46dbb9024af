"""Meshes: their buffers, and the pass that draws them before the splats: colours, and the z that hides splats.

The views of a frame have a target each and are drawn in turn: moderngl cannot attach a layered depth buffer, and in one
target the coordinates of the second view would round differently from those of its own render. Bones are written once.
The background pass copies colours to the layers; the draw pass tests splats against z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer.bounds import Bounds, covered_pixels
from glsplat.renderer.frame_block import FrameBlock
from glsplat.renderer.owned import OwnsObjects, data_texture, owned
from glsplat.renderer.skin import Placement, near_eye
from glsplat.renderer.stats import Box
from glsplat.shaders import MeshVariant, Programs, set_uniforms
from glsplat.shaders.slots import UNITS
from glsplat.skinning.skin import Skin

INFLUENCES = 4
"""Joints a vertex, as for splats."""

_ALPHA_TO_COVERAGE = 0x809E  # GL_SAMPLE_ALPHA_TO_COVERAGE; moderngl has no name for either
_ALPHA_TO_ONE = 0x809F  # GL_SAMPLE_ALPHA_TO_ONE: alpha of the target is coverage

_ATTRIBUTES, _NAMES = "3f 2f 4u2 4f", ("vertex", "uv", "joints0", "weights0")  # of mesh.vert.glsl, skin.glsl
_VERTEX = np.dtype([("vertex", "f4", 3), ("uv", "f4", 2), ("joints", "u2", 4), ("weights", "f4", 4)])

_NO_MESH_Z = 3e38  # camera z where no mesh is: behind every splat
_LINEAR, _LOGARITHMIC = (MeshVariant(influences=INFLUENCES, logarithmic=n) for n in (0, 1))
_LINEAR_RANGE = 1000.0  # far / near up to which 24 bits of 1 / z resolve z to a 17,000th
_SAMPLE_DTYPE = "f1"  # as textures; floats would be 16 bytes a sample to clear, blend and average


class MeshBuffers(OwnsObjects):
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

    def _array(self, programs: Programs, variant: MeshVariant) -> moderngl.VertexArray:
        if variant not in self._arrays:
            content: list[tuple[object, ...]] = [(self._vertices, _ATTRIBUTES, *_NAMES)]
            if variant.shaded:
                content.append((self._shade, "3f", "shade"))
            program = programs.draw("mesh", "mesh", variant)
            array = self._ctx.vertex_array(program, content, index_buffer=self._faces)
            self._arrays[variant] = owned(self._owned, array)
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


class MeshPassKind(NamedTuple):
    """The pictures of its meshes that a frame needs."""

    centres: bool  # colour and z at the pixel centres; splats are tested against this z
    samples: int  # a pixel, for the colour; 1: the centres alone
    depth: bool  # without centres: also the mean z of a pixel, times coverage


class MeshPass(OwnsObjects):
    """Owns the targets of one size and number of views; keeps its pictures while nothing moves."""

    def __init__(
        self, context: Context, programs: Programs, size: tuple[int, int], views: int, kind: MeshPassKind, dtype: str
    ) -> None:
        ctx = context.ctx
        self._ctx, self._programs, self._kind = ctx, programs, kind
        self._drawn: object = None
        self.covered: Box = (0, 0, 0, 0)  # holds all pixels of the meshes
        self._centres: list[_Centres] = []
        self._samples: _Samples | None = None
        self._frames: list[FrameBlock] = []
        with ExitStack() as stack:  # releases everything if an allocation fails
            for _ in range(views):
                self._frames.append(owned(stack, FrameBlock(ctx, 1)))
                if kind.centres:
                    self._centres.append(_Centres(ctx, size, dtype, stack))
            if kind.samples > 1:
                self._samples = _Samples(ctx, size, views, kind, stack)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of all targets."""
        return sum(centres.nbytes for centres in self._centres) + (self._samples.nbytes if self._samples else 0)

    def run(self, cameras: Sequence[Camera], items: Sequence[tuple[MeshBuffers, Placement]], state: object) -> None:
        """Draw the meshes for these views, unless ``state`` is that of the last call."""
        if state == self._drawn:
            return
        self._drawn = None
        bounds = (item.bounds.posed(at.transform, at.bones) for item, at in items)
        self.covered = covered_pixels(cameras, bounds, _NO_SPLATS)
        anchors = np.array([placement.anchor() for _, placement in items])
        origin = near_eye(anchors[0], anchors, cameras[0].position)  # float32 has no bits left far from zero
        for item, placement in items:
            item.place(placement, origin)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        try:
            for view, camera in enumerate(cameras):
                self._draw(view, camera, [item for item, _ in items], origin)
        finally:
            self._ctx.disable(moderngl.DEPTH_TEST)
        self._drawn = state

    def _draw(self, view: int, camera: Camera, items: Sequence[MeshBuffers], origin: NDArray[np.float64]) -> None:
        if self._centres:
            self._frames[view].write([camera], camera.viewmat, origin, _NO_SPLATS)
            self._centres[view].begin()
            for item in items:
                item.draw(self._programs, _LOGARITHMIC, 1)
        if self._samples is not None:
            depths = [item.depths(camera, origin) for item in items]
            near = fitted(camera, min(least for least, _ in depths), max(largest for _, largest in depths))
            fine = near.far <= _LINEAR_RANGE * near.near
            self._frames[view].write([near if fine else camera], camera.viewmat, origin, _NO_SPLATS)
            self._samples.begin()
            for item in items:
                item.draw(self._programs, _LINEAR if fine else _LOGARITHMIC, self._kind.samples)
            self._samples.resolve(self._ctx, view)

    def use(self) -> None:
        """Bind the targets for the background and draw passes."""
        for ending, centres in zip(_ENDINGS, self._centres, strict=False):
            centres.colour.use(UNITS["mesh_colour" + ending])
            centres.z.use(UNITS["mesh_z" + ending])
        if self._samples is not None:
            for ending, averaged in zip(_ENDINGS, self._samples.averaged, strict=False):
                averaged[0].use(UNITS["mesh_samples" + ending])
                for z in averaged[1:]:
                    z.use(UNITS["mesh_z" + ending])


class _Centres:
    """Colour and camera z at the pixel centres of one view."""

    def __init__(self, ctx: moderngl.Context, size: tuple[int, int], dtype: str, stack: ExitStack) -> None:
        self.colour = data_texture(stack, ctx, size, 4, dtype=dtype)
        self.z = data_texture(stack, ctx, size, 1)
        depth = owned(stack, ctx.depth_renderbuffer(size))
        # two framebuffers: clear() gives every colour attachment the same value
        self._both = owned(stack, ctx.framebuffer([self.colour, self.z], depth))
        self._far = owned(stack, ctx.framebuffer([self.z]))
        self.nbytes: int = size[0] * size[1] * (_BYTES[dtype] + 4 + 4)

    def begin(self) -> None:
        """Clear and bind the framebuffer."""
        self._both.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._far.clear(_NO_MESH_Z, 0.0, 0.0, 0.0)
        self._both.use()


class _Samples:
    """Samples of one view at a time, and their means for each view."""

    def __init__(
        self, ctx: moderngl.Context, size: tuple[int, int], views: int, kind: MeshPassKind, stack: ExitStack
    ) -> None:
        formats = [(4, _SAMPLE_DTYPE)] + ([(1, "f4")] if kind.depth and not kind.centres else [])
        drawn = [owned(stack, ctx.renderbuffer(size, n, samples=kind.samples, dtype=dtype)) for n, dtype in formats]
        depth = owned(stack, ctx.depth_renderbuffer(size, samples=kind.samples))
        self._drawn = owned(stack, ctx.framebuffer(drawn, depth))
        self.averaged: list[list[moderngl.Texture]] = []
        self._into: list[moderngl.Framebuffer] = []
        for _ in range(views):
            self.averaged.append([data_texture(stack, ctx, size, n, dtype=dtype) for n, dtype in formats])
            self._into.append(owned(stack, ctx.framebuffer(self.averaged[-1])))
        pixel = sum(_BYTES[dtype] * n // 4 for n, dtype in formats)
        self.nbytes: int = size[0] * size[1] * (pixel * views + (pixel + 4) * kind.samples)

    def begin(self) -> None:
        """Clear and bind the framebuffer."""
        self._drawn.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._drawn.use()

    def resolve(self, ctx: moderngl.Context, view: int) -> None:
        """Average the samples into the textures of ``view``."""
        ctx.copy_framebuffer(self._into[view], self._drawn)


_NO_SPLATS = RenderConfig()  # for the fields of the frame block that meshes do not read
_BYTES = {"f1": 4, "f2": 8, "f4": 16}  # of four components
_ENDINGS = ("", "_2")  # of the samplers of each view (mesh_layer.glsl)
