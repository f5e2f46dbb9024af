"""Meshes: textured triangles on a skeleton, as values. Readers are in extras/rigs and extras/formats."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen_mapping, instance, plain
from glsplat.errors import FormatError, PoseError
from glsplat.rotations import unit_vectors
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

__all__ = ["MeshPart", "Morphs", "RiggedMesh", "standing", "vertex_normals"]


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """The triangles that share one texture."""

    name: str
    faces: NDArray[np.int32]  # [F, 3] vertex indices
    uv: NDArray[np.float64]  # [F, 3, 2] a texture coordinate a corner, v axis up, repeats outside [0, 1]
    texture: NDArray[np.uint8]  # [H, W, 4] RGBA, row 0 is v = 1

    @property
    def cutout(self) -> bool:
        """True where texels of alpha below one half cut holes (hair, brows, lashes)."""
        return bool((self.texture[..., 3] < 128).any())

    def sample(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return RGBA in [0, 1] at texture coordinates [..., 2]: bilinear, texel centres at +0.5."""
        height, width = self.texture.shape[:2]
        x = uv[..., 0] % 1.0 * width - 0.5
        y = (1.0 - uv[..., 1] % 1.0) * height - 0.5
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = (x - x0)[..., None], (y - y0)[..., None]
        x1, y1 = np.clip(x0 + 1, 0, width - 1), np.clip(y0 + 1, 0, height - 1)
        x0, y0 = np.clip(x0, 0, width - 1), np.clip(y0, 0, height - 1)
        t = self.texture
        top = t[y0, x0] * (1 - fx) + t[y0, x1] * fx
        return (top * (1 - fy) + (t[y1, x0] * (1 - fx) + t[y1, x1] * fx) * fy) / 255.0


@dataclass(frozen=True, eq=False, repr=False)
class Morphs:
    """Sparse morph targets of a mesh: T targets with M vertex offsets in metres, in the mesh's own space.

    Target t, called ``names[t]``, at weight w moves vertex ``vertices[i]`` by w ``offsets[i]`` for all i from
    ``starts[t]`` to ``starts[t + 1]``. Targets add up (glTF 2.0, 3.7.2.2).
    """

    names: tuple[str, ...]
    starts: NDArray[np.int64]  # [T + 1]
    vertices: NDArray[np.uint32]  # [M]
    offsets: NDArray[np.float32]  # [M, 3]

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        return f"Morphs({len(self.names)} targets, {len(self.vertices)} offsets)"

    @classmethod
    def of(
        cls, parts: Mapping[str, Sequence[tuple[NDArray[np.integer], NDArray[np.floating]]]]
    ) -> Morphs:  # name -> vertices [K] and offsets [K, 3] of each mesh
        """Return the merged targets of several meshes, in their order."""
        nothing = [(np.empty(0, np.uint32), np.empty((0, 3)))]
        held = {name: list(of) or nothing for name, of in parts.items()}
        sizes = [sum(len(vertices) for vertices, _ in of) for of in held.values()]
        every = [one for of in held.values() for one in of]
        vertices = [v for v, _ in every] or [np.empty(0, np.uint32)]
        offsets = [o for _, o in every] or [np.empty((0, 3))]
        return cls(
            tuple(held),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
            np.concatenate(vertices).astype(np.uint32),
            np.concatenate(offsets).astype(np.float32),
        )

    def plus(self, more: Mapping[str, tuple[NDArray[np.integer], NDArray[np.floating]]]) -> Morphs:
        """Return the targets with offsets added: ``more`` maps a target to vertices [K] and offsets [K, 3]."""
        parts = {}
        for target, name in enumerate(self.names):
            part = slice(*self.starts[target : target + 2])
            parts[name] = [(self.vertices[part], self.offsets[part]), *([more[name]] if name in more else [])]
        return Morphs.of(parts)

    def dense(self, name: str, count: int) -> NDArray[np.float64]:
        """Return the offsets [count, 3] of all vertices for the target ``name`` at weight 1."""
        out, target = np.zeros((count, 3)), self.names.index(name)
        part = slice(*self.starts[target : target + 2])
        np.add.at(out, self.vertices[part], self.offsets[part].astype(np.float64))
        return out

    def moved(self, pose: Pose, count: int) -> NDArray[np.float64]:
        """Return the offsets [count, 3] of all vertices for the pose's expression, weights clamped to [0, 1]."""
        out = np.zeros((count, 3))
        for weight, part in self._weighted(pose):
            np.add.at(out, self.vertices[part], weight * self.offsets[part].astype(np.float64))
        return out

    def farthest(self, pose: Pose) -> float:
        """Return an upper bound in metres of a vertex's offset for the pose's expression."""
        moves = [w * float(np.linalg.norm(self.offsets[p], axis=1).max(initial=0.0)) for w, p in self._weighted(pose)]
        return sum(moves, 0.0)

    def _weighted(self, pose: Pose) -> Iterator[tuple[float, slice]]:
        """Yield the weight and the rows of ``offsets`` of each target with a positive weight in a pose."""
        for target, name in enumerate(self.names):
            weight = min(max(pose.expression.get(name, 0.0), 0.0), 1.0)
            if weight:
                yield weight, slice(*self.starts[target : target + 2])

    def turned(self, linear: NDArray[np.float64]) -> Morphs:
        """Return the targets with offsets transformed by ``linear`` [3, 3]."""
        return replace(self, offsets=(self.offsets @ linear.T).astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RiggedMesh:
    """Textured triangles in the bind pose of their rig; a rig of one joint is a static object.

    It is drawn opaque in the colours of its textures, with holes where alpha is below one half. Raises FormatError if
    the parts do not fit each other.

    >>> from glsplat.meshes import MeshPart
    >>> red = np.full((4, 4, 4), (255, 0, 0, 255), np.uint8)
    >>> part = MeshPart("front", np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2)), red)
    >>> skeleton = glsplat.Skeleton.from_joints(["root"], [-1], [[0, 0, 0]])
    >>> corners = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> glsplat.RiggedMesh(corners, skeleton, np.zeros((3, 1), int), np.ones((3, 1)), (part,))
    RiggedMesh(3 vertices, 1 triangles, 1 joints)
    """

    vertices: NDArray[np.float64]  # [V, 3] metres, y up, facing +z, in the bind pose
    skeleton: Skeleton
    joints: NDArray[np.int64]  # [V, K] joints of each vertex
    weights: NDArray[np.float64]  # [V, K] >= 0
    parts: tuple[MeshPart, ...]
    meta: Mapping[str, Any] = field(default_factory=dict)  # source, licence, ... of the file
    morphs: Morphs | None = None  # facial expressions by ARKit's names, in the space of ``vertices``

    def __post_init__(self) -> None:
        object.__setattr__(self, "meta", frozen_mapping(instance(self.meta, Mapping, "a mesh's meta")))
        instance(self.skeleton, Skeleton, "a mesh's skeleton")
        for name in ("vertices", "joints", "weights"):
            plain(instance(getattr(self, name), np.ndarray, f"a mesh's {name}"), f"a mesh's {name}")
        for part in instance(self.parts, tuple, "a mesh's parts"):
            instance(part, MeshPart, "a mesh's parts")
        count = self.vertices.shape[0] if self.vertices.ndim else 0
        if self.vertices.shape != (count, 3) or not np.isfinite(self.vertices).all():
            raise FormatError(f"a mesh needs finite vertices (V, 3), not {self.vertices.shape}")
        if self.joints.shape != self.weights.shape or self.joints.shape[:1] != (count,) or self.joints.ndim != 2:
            raise FormatError(f"a mesh of {count} vertices needs joints and weights ({count}, K)")
        if self.joints.size and not 0 <= self.joints.min() <= self.joints.max() < len(self.skeleton):
            raise FormatError(f"a vertex is bound to joint {self.joints.max()} of {len(self.skeleton)}")
        if not self.parts or not sum(len(part.faces) for part in self.parts):
            raise FormatError("a mesh needs at least one triangle")
        if self.morphs is not None:
            if int(self.morphs.vertices.max(initial=0)) >= count or not np.isfinite(self.morphs.offsets).all():
                raise FormatError(f"morph targets need finite offsets of the mesh's {count} vertices")
        for part in self.parts:
            if part.faces.size and not 0 <= part.faces.min() <= part.faces.max() < count:
                raise FormatError(f'part "{part.name}" names vertex {part.faces.max()} of {count}')
            if part.uv.shape != (*part.faces.shape, 2):
                raise FormatError(f'part "{part.name}" needs uv {(*part.faces.shape, 2)}, not {part.uv.shape}')

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles [F, 3] of all parts, in order."""
        return np.concatenate([part.faces for part in self.parts])

    @property
    def face_parts(self) -> NDArray[np.intp]:
        """Index [F] of each triangle's part."""
        return np.repeat(np.arange(len(self.parts)), [len(part.faces) for part in self.parts])

    def without(self, joint: str) -> RiggedMesh:
        """Return the mesh without the triangles that mostly follow ``joint`` or its descendants: a first-person view.

        The corners of removed triangles have a mean weight above one half there. Raises PoseError if there is no such
        joint, or no triangle is left.
        """
        share = (self.weights * self.skeleton.under(joint)[self.joints]).sum(axis=1)
        share = share / np.maximum(self.weights.sum(axis=1), 1e-12)
        keeps = [(part, share[part.faces].mean(axis=1) <= 0.5) for part in self.parts]
        parts = tuple(replace(part, faces=part.faces[keep], uv=part.uv[keep]) for part, keep in keeps if keep.any())
        if not parts:
            raise PoseError(f'a mesh without "{joint}" has no triangle left')
        return replace(self, parts=parts)

    def posed(self, pose: Pose) -> NDArray[np.float64]:
        """Return the vertices [V, 3] after the pose's expression and linear blend skinning."""
        bones = pose.bones(self.skeleton)
        vertices = self.vertices if self.morphs is None else self.vertices + self.morphs.moved(pose, len(self.vertices))
        total = self.weights.sum(axis=1, keepdims=True)
        blended = np.einsum("vk,vkij->vij", self.weights / np.where(total > 0, total, 1), bones[self.joints])
        return np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]

    def __repr__(self) -> str:
        shapes = "" if self.morphs is None else f", {len(self.morphs.names)} shapes"
        triangles = sum(len(part.faces) for part in self.parts)
        return f"RiggedMesh({len(self.vertices)} vertices, {triangles} triangles, {len(self.skeleton)} joints{shapes})"


def standing(vertices: NDArray[np.float64], parts: tuple[MeshPart, ...], source: str) -> RiggedMesh:
    """Return a static mesh, on one joint at the origin; ``vertices`` [V, 3] in metres."""
    count = len(vertices)
    skeleton = Skeleton.from_joints(("root",), [-1], [[0.0, 0.0, 0.0]])
    bound = np.zeros((count, 1), np.int64), np.ones((count, 1))
    return RiggedMesh(vertices, skeleton, *bound, parts, {"source": source})


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return unit normals [V, 3], the area-weighted mean of the adjacent triangles' normals."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(second - first, third - first)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], across[:, axis], len(vertices))
    return unit_vectors(normals, 1e-30)
