"""Transfer the open body's expressions and teeth to people with the same topology; find its mouth's lining."""

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
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.teeth import paint_teeth
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

Indices = NDArray[np.intp]
_MIN_OFFSET_M = 1e-5
_MOUTH_BOX_M = ((-0.035, 0.775, 0.08), (0.035, 0.85, 0.175))  # of the open body
_MOUTH_CENTRE_M = (0.0, 0.82, 0.10)  # a point within the open body's mouth
_LIP_WIDTH_M = 0.007  # from the rim
_LOWER_LIP_FRACTION = 0.5  # of the largest move of the rim as the jaw opens: the lower lip moves farther


@dataclass(frozen=True, slots=True, eq=False)
class OpenFace:
    """The embedded file's arrays, in the open body's space, metres."""

    expressions: Morphs  # of the open body's vertices
    mouth: F64  # [M, 3] vertices of teeth and gums
    faces: NDArray[np.int32]  # [F, 3] triangles of teeth and gums, each on one jaw
    tooth: NDArray[np.bool_]  # [F] true for teeth, false for gums
    lower: NDArray[np.bool_]  # [M] vertices on the jaw
    jaw: Mapping[str, F64]  # expression -> [3, 4] affine motion of the jaw


@lru_cache(maxsize=1)
def open_face() -> OpenFace:
    """Return the embedded face (licences beside the file), which is read once."""
    with resources.as_file(resources.files("glsplat.data") / "open_face.npz") as path, np.load(path) as data:
        morphs = Morphs(
            tuple(map(str, data["expr_names"])),
            data["expr_ptr"].astype(np.int64),
            data["expr_idx"].astype(np.uint32),
            data["expr_val"].astype(np.float32),
        )
        faces, lower = data["mouth_faces"].astype(np.int32), data["mouth_lower"].astype(bool)
        joining = np.ptp(lower[faces].astype(np.int8), axis=1) > 0  # such gums would stretch across an open mouth
        return OpenFace(
            expressions=morphs,
            mouth=frozen(data["mouth_vertices"] * float(data["mouth_step"]) + data["mouth_origin"]),
            faces=frozen(faces[~joining]),
            tooth=frozen(data["mouth_tooth"].astype(bool)[~joining]),
            lower=frozen(lower),
            jaw=dict(zip(map(str, data["jaw_names"]), data["jaw_ways"].astype(np.float64), strict=True)),
        )


def with_expressions(mesh: RiggedMesh) -> RiggedMesh:
    """Return the mesh, whose first vertices are the open body's, with the open body's 52 expressions.

    Eyeballs turn by their joints alone, because ARKit's eyeLook shapes move the lids. Offsets are not scaled with the
    head.
    """
    body, morphs, found = open_body(), open_face().expressions, {}
    balls = np.isin(body.part, [JOINT_NAMES.index(name) for name in EYES])
    for name in morphs.names:
        offsets = morphs.dense(name, len(body.vertices))
        moved = np.flatnonzero((np.abs(offsets).max(axis=1) > _MIN_OFFSET_M) & ~balls)
        found[name] = [(moved, offsets[moved])]
    return replace(mesh, morphs=Morphs.of(found))


def with_mouth(mesh: RiggedMesh) -> RiggedMesh:
    """Return the mesh of ``with_expressions`` with a part "teeth": teeth and gums; expressions move the lower ones.

    An affine map from the open body's mouth to that of ``mesh`` places them.
    """
    assert mesh.morphs is not None
    face, body = open_face(), open_body()
    low, high = np.array(_MOUTH_BOX_M)
    near = np.flatnonzero(((body.vertices > low) & (body.vertices < high)).all(axis=1))
    there = _affine(body.vertices[near], mesh.vertices[near])
    moved, first = np.flatnonzero(face.lower), len(mesh.vertices)
    uv, enamel = paint_teeth(face.mouth, face.faces, face.tooth, face.lower)
    offsets = {
        name: (moved + first, (face.mouth[moved] @ motion[:, :3].T + motion[:, 3] - face.mouth[moved]) @ there[:, :3].T)
        for name, motion in face.jaw.items()
    }
    joints, weights = (np.zeros((len(face.mouth), mesh.joints.shape[1]), kind) for kind in (np.int64, np.float64))
    joints[:, 0] = np.where(face.lower, *(JOINT_NAMES.index(name) for name in ("jaw", "head")))
    weights[:, 0] = 1
    return replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, face.mouth @ there[:, :3].T + there[:, 3]]),
        joints=np.concatenate([mesh.joints, joints]),
        weights=np.concatenate([mesh.weights, weights]),
        parts=(*mesh.parts, MeshPart("teeth", (face.faces + first).astype(np.int32), uv, enamel)),
        morphs=mesh.morphs.plus(offsets),
    )


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
