"""Transfer the open body's expressions, teeth and tongue to people with the same topology; find its mouth's lining."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from glsplat.arrays import F64, frozen
from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.teeth import paint_teeth
from glsplat.extras.authoring.geometry.surface_points import nearest_on
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

Indices = NDArray[np.intp]
Offsets = Mapping[str, tuple[Indices, F64]]
_MAX_UV_DISTANCE = 2e-4  # of the texture's side, between corners of one vertex
_MIN_MATCHES = 4000  # vertices that a person shares with the open body
_FOLLOW_DISTANCE_M = 0.03  # brows, lashes and hair nearer than that follow the skin
_MIN_OFFSET_M = 1e-5
_MOUTH_BOX_M = ((-0.035, 0.775, 0.08), (0.035, 0.85, 0.175))  # of the open body
_TONGUE_RGB, _TONGUE_BACK_FACTOR = (158, 84, 80), 0.35  # sRGB of 255 at the tip; brightness at the back
_MOUTH_CENTRE_M = (0.0, 0.82, 0.10)  # a point within the open body's mouth
_LIP_WIDTH_M = 0.007  # from the rim
_LOWER_LIP_FRACTION = 0.5  # of the largest move of the rim as the jaw opens: the lower lip moves farther


@dataclass(frozen=True, slots=True, eq=False)
class OpenFace:
    """The embedded file's arrays, in the open body's space, metres."""

    expressions: Morphs  # of the open body's vertices
    mouth: F64  # [M, 3] vertices of teeth and gums
    faces: NDArray[np.int32]  # [F, 3] triangles of teeth and gums
    tooth: NDArray[np.bool_]  # [F] true for teeth, false for gums
    lower: NDArray[np.bool_]  # [M] vertices on the jaw
    jaw: Mapping[str, F64]  # expression -> [3, 4] affine motion of the jaw

    @property
    def on_one_jaw(self) -> NDArray[np.bool_]:
        """[F] the faces on one jaw; gums that join both jaws would stretch across an open mouth."""
        below = self.lower[self.faces]
        return np.asarray(below.all(axis=1) | ~below.any(axis=1))


@lru_cache(maxsize=1)
def open_face() -> OpenFace:
    """Return the embedded face (licences beside the file), which is read once."""
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


def match_open_body(mesh: RiggedMesh, part: str = "body") -> Indices:
    """Return for each vertex of the mesh [V] the open body's vertex with the same texture coordinates, or -1.

    People made with MakeHuman share its base mesh and texture layout. Raises FormatError if ``part`` of the mesh has
    another layout.
    """
    body = open_body()
    tree = cKDTree(body.uv.reshape(-1, 2))
    out = np.full(len(mesh.vertices), -1, np.intp)
    for candidate in mesh.parts:
        if candidate.name == part:
            distance, corner = tree.query(candidate.uv.reshape(-1, 2))
            near = distance < _MAX_UV_DISTANCE
            out[candidate.faces.reshape(-1)[near]] = body.faces.reshape(-1)[corner[near]]
    if np.count_nonzero(out >= 0) < _MIN_MATCHES:
        raise FormatError(f'the part "{part}" needs the texture layout of MakeHuman\'s body, which this mesh has not')
    return out


def first_vertices(mesh: RiggedMesh) -> Indices:
    """Return the result of ``match_open_body`` [V] for a mesh whose first vertices are the open body's."""
    every = np.arange(len(mesh.vertices))
    return np.where(every < len(open_body().vertices), every, -1)


def with_expressions(mesh: RiggedMesh, same: Indices) -> RiggedMesh:
    """Return the mesh with the open body's 52 expressions; ``same`` [V] is the result of ``match_open_body``.

    Matched vertices move as the open body's. Brows, lashes and hair follow the nearest point of the skin within 3 cm.
    Eyeballs turn by their joints alone, because ARKit's eyeLook shapes move the lids. Offsets are not scaled with the
    head.
    """
    face = open_face()
    balls = np.isin(open_body().part, [JOINT_NAMES.index(name) for name in EYES])
    same = np.where((same >= 0) & balls[same], -1, same)
    own = np.flatnonzero(same >= 0)
    skin = np.concatenate([one.faces[(same[one.faces] >= 0).all(axis=1)] for one in mesh.parts])
    rest = np.setdiff1d(np.unique(mesh.faces), own)
    rest = rest[_on_head(mesh, rest)]
    _, distance, which, bary = nearest_on(mesh.vertices, skin, mesh.vertices[rest])
    share, corners = bary * np.clip(2 - distance / (_FOLLOW_DISTANCE_M / 2), 0, 1)[:, None], skin[which]
    found = {}
    for name, (rows, moves) in _offsets(face.expressions).items():
        dense = np.zeros((len(open_body().vertices), 3))
        dense[rows] = moves
        offsets = np.zeros((len(mesh.vertices), 3))
        offsets[own] = dense[same[own]]
        offsets[rest] = np.einsum("nk,nkc->nc", share, offsets[corners])
        moved = np.flatnonzero(np.abs(offsets).max(axis=1) > _MIN_OFFSET_M)
        found[name] = [(moved, offsets[moved])]
    return replace(mesh, morphs=Morphs.of(found))


def with_mouth(mesh: RiggedMesh, same: Indices) -> RiggedMesh:
    """Return the mesh with teeth, gums and, if it has none, a tongue; ``same`` [V] is from ``match_open_body``.

    An affine map from the open body's mouth to that of ``mesh`` places them. Expressions move the lower teeth with
    the jaw, and the tongue.
    """
    face, body = open_face(), open_body()
    low, high = np.array(_MOUTH_BOX_M)
    near = ((body.vertices > low) & (body.vertices < high)).all(axis=1)
    own = np.flatnonzero(same >= 0)
    own = own[near[same[own]]]
    there = _affine(body.vertices[same[own]], mesh.vertices[own])
    kept = face.on_one_jaw
    uv, enamel = paint_teeth(face.mouth, face.faces[kept], face.tooth[kept], face.lower)
    names = mesh.skeleton.names
    head = names.index("head")
    jaw = names.index("jaw") if "jaw" in names else head
    bound = np.where(face.lower, jaw, head)
    moved = np.flatnonzero(face.lower)
    offsets = {
        name: (moved, (face.mouth[moved] @ motion[:, :3].T + motion[:, 3] - face.mouth[moved]) @ there[:, :3].T)
        for name, motion in face.jaw.items()
    }
    teeth = face.mouth @ there[:, :3].T + there[:, 3]
    out = _joined(mesh, teeth, bound, "teeth", face.faces[kept], uv, enamel, offsets)
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
    joints: Indices,  # [M] a single joint a vertex
    name: str,
    faces: NDArray[np.integer],
    uv: F64,
    texture: NDArray[np.uint8],
    offsets: Offsets,
) -> RiggedMesh:
    """Return the mesh with a further part, whose vertices expressions move by ``offsets``."""
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
    """Return a texture [64, 2, 4] that darkens towards the tongue's back, at the bottom."""
    light = np.linspace(1, _TONGUE_BACK_FACTOR, 64)[:, None, None] * np.ones((1, 2, 1))
    return np.concatenate([np.rint(_TONGUE_RGB * light), np.full((64, 2, 1), 255)], axis=2).astype(np.uint8)


def _on_head(mesh: RiggedMesh, vertices: Indices) -> NDArray[np.bool_]:
    joints = [index for index, name in enumerate(mesh.skeleton.names) if name in ("head", "jaw", "neck")]
    return np.isin(strongest_joint(mesh.joints, mesh.weights)[vertices], joints)


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
    """Return the affine map [3, 4] from points ``before`` [K, 3] to ``after`` [K, 3], by least squares."""
    homogeneous = np.concatenate([before, np.ones((len(before), 1))], axis=1)
    return np.asarray(np.linalg.lstsq(homogeneous, after, rcond=None)[0].T)


@dataclass(frozen=True, slots=True, eq=False)
class Lining:
    """The lining and the lips, as vertices of the open body (V)."""

    inside: NDArray[np.bool_]  # [V] the lining with its rim
    far: F64  # [V] straight distance from the rim, metres
    lips: NDArray[np.bool_]  # [V] the outer lips
    upper: Indices  # [K] rim of the upper lip, from the person's right to their left
    lower: Indices  # [K] rim of the lower lip


@lru_cache(maxsize=1)
def mouth_lining() -> Lining:
    """Return the lining, an island of MakeHuman's texture layout whose border is the rim. Computed once."""
    body = open_body()
    places, corner = np.unique(np.rint(body.uv.reshape(-1, 2) * 1e5), axis=0, return_inverse=True)
    ends = corner.reshape(-1, 3)[:, [0, 1, 1, 2]].reshape(-1, 2)
    joined = coo_array((np.ones(len(ends)), ends.T), (len(places), len(places)))
    _, island = connected_components(joined, directed=False)
    island_of_face = island[corner.reshape(-1, 3)[:, 0]]
    islands = [body.faces[island_of_face == number] for number in range(island_of_face.max() + 1)]
    skin = np.array([body.skin[faces].all() for faces in islands])
    centres = np.array([body.vertices[faces].reshape(-1, 3).mean(axis=0) for faces in islands])
    distances = np.linalg.norm(centres - _MOUTH_CENTRE_M, axis=1)
    lining = island_of_face == np.flatnonzero(skin)[distances[skin].argmin()]
    inside = np.zeros(len(body.vertices), bool)
    inside[body.faces[lining]] = True
    rim = np.intersect1d(body.faces[lining], body.faces[~lining])
    far, _ = cKDTree(body.vertices[rim]).query(body.vertices)
    lowered = np.linalg.norm(open_face().expressions.dense("jawOpen", len(body.vertices)), axis=1)[rim]
    low = lowered > _LOWER_LIP_FRACTION * lowered.max()
    upper, lower = (lip[np.argsort(body.vertices[lip, 0])] for lip in (rim[~low], rim[low]))
    return Lining(
        inside=frozen(inside),
        far=frozen(far),
        lips=frozen(~inside & body.skin & (far < _LIP_WIDTH_M)),
        upper=frozen(upper),
        lower=frozen(lower),
    )
