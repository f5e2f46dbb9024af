"""The open body's face: its expressions, teeth and tongue, carried over to people who are made of the same mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import frozen
from glsplat.errors import FormatError
from glsplat.extras.authoring.body.enamel import painted
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["OpenFace", "matched", "of_open_body", "open_face", "with_expressions", "with_mouth"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]
Offsets = Mapping[str, tuple[Indices, F64]]

_SAME = 2e-4  # of a texture: coordinates that are those of one vertex
_LEAST = 4000  # vertices of the open body that a person shares with it, at least
_REACH = 0.03  # metres within which brows, lashes and hair follow the skin
_STILL = 1e-5  # metres
_ABOUT_MOUTH = ((-0.035, 0.775, 0.08), (0.035, 0.85, 0.175))  # a box of the open body, metres
_TONGUE, _DEEP = (158, 84, 80), 0.35  # sRGB, of 255, where light falls on it; share of that at the back


@dataclass(frozen=True, slots=True, eq=False)
class OpenFace:
    """What the embedded file has, in the open body's own space, metres."""

    expressions: Morphs  # of the open body's vertices
    mouth: F64  # [M, 3] teeth and gums
    faces: NDArray[np.int32]  # [F, 3] of those
    tooth: NDArray[np.bool_]  # [F] enamel, not gum
    lower: NDArray[np.bool_]  # [M] on the jaw
    jaw: Mapping[str, F64]  # expression -> [3, 4] how it moves the jaw

    @property
    def whole(self) -> NDArray[np.bool_]:
        """[F] on one jaw: gums that join both would be strings in an open mouth."""
        below = self.lower[self.faces]
        return np.asarray(below.all(axis=1) | ~below.any(axis=1))


@lru_cache(maxsize=1)
def open_face() -> OpenFace:
    """The embedded file (licences beside it); read once."""
    with resources.as_file(resources.files("glsplat.data") / "open_face.npz") as path, np.load(path) as data:
        names = tuple(map(str, data["expr_names"]))
        morphs = Morphs(
            names,
            data["expr_ptr"].astype(np.int64),
            data["expr_idx"].astype(np.uint32),
            data["expr_val"].astype(np.float32),
        )
        return OpenFace(
            expressions=morphs,
            mouth=frozen(data["mouth_vertices"] * float(data["mouth_step"]) + data["mouth_origin"]),
            faces=frozen(data["mouth_faces"].astype(np.int32)),
            tooth=frozen(data["mouth_tooth"].astype(bool)),
            lower=frozen(data["mouth_lower"].astype(bool)),
            jaw=dict(zip(map(str, data["jaw_names"]), data["jaw_ways"].astype(np.float64), strict=True)),
        )


def matched(mesh: RiggedMesh, part: str = "body") -> Indices:
    """[V] the open body's vertex that each vertex of the mesh is, -1 for none: those of one texture coordinate.

    People of MakeHuman share its base mesh and its texture's layout, whatever their shape. Raises FormatError for a
    mesh whose ``part`` has another layout.
    """
    body = open_body()
    tree = cKDTree(body.uv.reshape(-1, 2))
    out = np.full(len(mesh.vertices), -1, np.intp)
    for one in mesh.parts:
        if one.name == part:
            distance, corner = tree.query(one.uv.reshape(-1, 2))
            mine = distance < _SAME
            out[one.faces.reshape(-1)[mine]] = body.faces.reshape(-1)[corner[mine]]
    if np.count_nonzero(out >= 0) < _LEAST:
        raise FormatError(f'the part "{part}" needs the texture layout of MakeHuman\'s body, which this mesh has not')
    return out


def of_open_body(mesh: RiggedMesh) -> Indices:
    """[V] as of ``matched`` where the mesh's first vertices are the open body's."""
    every = np.arange(len(mesh.vertices))
    return np.where(every < len(open_body().vertices), every, -1)


def with_expressions(mesh: RiggedMesh, same: Indices) -> RiggedMesh:
    """The mesh with the open body's 52 expressions; ``same`` [V] as from ``matched``.

    The body's vertices move as those of the open body; other parts of the head (brows, lashes, hair) follow the place
    of the body nearest to them, within 3 cm. Eyeballs turn by their joints alone: ARKit's eyeLook shapes are
    those of the lids. Their own space is MakeHuman's, so that they are not scaled with the head.
    """
    face = open_face()
    balls = np.isin(open_body().part, [JOINT_NAMES.index(name) for name in EYES])
    same = np.where((same >= 0) & balls[same], -1, same)
    own = np.flatnonzero(same >= 0)
    skin = np.concatenate([one.faces[(same[one.faces] >= 0).all(axis=1)] for one in mesh.parts])
    rest = np.setdiff1d(np.unique(mesh.faces), own)
    rest = rest[_on_head(mesh, rest)]
    _, distance, which, bary = nearest_on(mesh.vertices, skin, mesh.vertices[rest])
    share, corners = bary * np.clip(2 - distance / (_REACH / 2), 0, 1)[:, None], skin[which]
    found = {}
    for name, (rows, moves) in _offsets(face.expressions).items():
        dense = np.zeros((len(open_body().vertices), 3))
        dense[rows] = moves
        offsets = np.zeros((len(mesh.vertices), 3))
        offsets[own] = dense[same[own]]
        offsets[rest] = np.einsum("nk,nkc->nc", share, offsets[corners])
        moved = np.flatnonzero(np.abs(offsets).max(axis=1) > _STILL)
        found[name] = [(moved, offsets[moved])]
    return replace(mesh, morphs=Morphs.of(found))


def with_mouth(mesh: RiggedMesh, same: Indices) -> RiggedMesh:
    """The mesh, which has expressions, with teeth, gums and, where it has none, a tongue; all but the tongue still.

    They are set where the lips of ``mesh`` are: by the affine map that takes the open body's mouth to its own.
    """
    face, body = open_face(), open_body()
    low, high = np.array(_ABOUT_MOUTH)
    near = ((body.vertices > low) & (body.vertices < high)).all(axis=1)
    own = np.flatnonzero(same >= 0)
    own = own[near[same[own]]]
    there = _affine(body.vertices[same[own]], mesh.vertices[own])
    whole = face.whole
    uv, enamel = painted(face.mouth, face.faces[whole], face.tooth[whole], face.lower)
    names = mesh.skeleton.names
    head = names.index("head")
    jaw = names.index("jaw") if "jaw" in names else head
    bound = np.where(face.lower, jaw, head)
    offsets = {}
    for name, way in face.jaw.items():
        moved = np.flatnonzero(face.lower)
        offsets[name] = (moved, (face.mouth[moved] @ way[:, :3].T + way[:, 3] - face.mouth[moved]) @ there[:, :3].T)
    teeth = face.mouth @ there[:, :3].T + there[:, 3]
    out = _joined(mesh, teeth, bound, "teeth", face.faces[whole], uv, enamel, offsets)
    tongue = _tongue(body)
    if np.isin(tongue, same).any():
        return out
    faces = np.searchsorted(tongue, body.faces[np.isin(body.faces[:, 0], tongue)])
    at = body.vertices[tongue] @ there[:, :3].T + there[:, 3]
    moves = {}
    for name, (rows, values) in _offsets(face.expressions).items():
        mine = np.isin(rows, tongue)
        moves[name] = (np.searchsorted(tongue, rows[mine]), values[mine] @ there[:, :3].T)
    back = (body.vertices[tongue, 2] - body.vertices[tongue, 2].min()) / np.ptp(body.vertices[tongue, 2])
    coordinates = np.stack(np.broadcast_arrays(0.5, back[faces]), axis=2)
    return _joined(out, at, np.full(len(tongue), jaw), "tongue", faces, coordinates, _tongue_texture(), moves)


def _joined(
    mesh: RiggedMesh,
    vertices: F64,
    joints: Indices,  # [M] the one that moves a vertex
    name: str,
    faces: NDArray[np.integer],
    uv: F64,
    texture: NDArray[np.uint8],
    offsets: Offsets,
) -> RiggedMesh:
    """The mesh with one more part, whose vertices expressions move by ``offsets``."""
    first, influences = len(mesh.vertices), mesh.joints.shape[1]
    bound = np.zeros((len(vertices), influences), np.int64)
    weights = np.zeros((len(vertices), influences))
    bound[:, 0], weights[:, 0] = joints, 1
    parts = {} if mesh.morphs is None else {n: [value] for n, value in _offsets(mesh.morphs).items()}
    for key, (rows, moves) in offsets.items():
        parts.setdefault(key, []).append((rows + first, moves))
    part = MeshPart(name, (np.asarray(faces) + first).astype(np.int32), np.asarray(uv, np.float64), texture)
    return replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, vertices]),
        joints=np.concatenate([mesh.joints, bound]),
        weights=np.concatenate([mesh.weights, weights]),
        parts=(*mesh.parts, part),
        morphs=Morphs.of(parts),
    )


def _tongue_texture() -> NDArray[np.uint8]:
    """[64, 2, 4] a tongue, darker towards the back, which is below."""
    light = np.linspace(1, _DEEP, 64)[:, None, None] * np.ones((1, 2, 1))
    return np.concatenate([np.rint(_TONGUE * light), np.full((64, 2, 1), 255)], axis=2).astype(np.uint8)


def _on_head(mesh: RiggedMesh, vertices: Indices) -> NDArray[np.bool_]:
    names = mesh.skeleton.names
    strongest = strongest_joint(mesh.joints, mesh.weights)[vertices]
    held = [index for index, name in enumerate(names) if name in ("head", "jaw", "neck")]
    return np.isin(strongest, held)


def _tongue(body: Body) -> Indices:
    eyes = np.isin(body.part, [JOINT_NAMES.index(name) for name in EYES])
    return np.flatnonzero(~body.skin & ~eyes)


def _offsets(morphs: Morphs) -> dict[str, tuple[Indices, F64]]:
    out = {}
    for target, name in enumerate(morphs.names):
        part = slice(*morphs.starts[target : target + 2])
        out[name] = morphs.vertices[part].astype(np.intp), morphs.offsets[part].astype(np.float64)
    return out


def _affine(before: F64, after: F64) -> F64:
    """[3, 4] the affine map nearest to taking points [K, 3] to those, by least squares."""
    held = np.concatenate([before, np.ones((len(before), 1))], axis=1)
    return np.asarray(np.linalg.lstsq(held, after, rcond=None)[0].T)
