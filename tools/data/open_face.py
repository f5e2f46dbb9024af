"""Writes glsplat/data/open_face.npz: the open body's expressions, and teeth and gums in its mouth.

python -m tools.data.open_face open_body55.npz ict_face.npz glsplat/data/open_face.npz

Expressions are MakeHuman's face units as the body archive has them. Teeth and gums are ICT-FaceKit's, made smaller and
moved behind the lips; the lower ones follow the jaw, whose way is that of the tongue, which MakeHuman turns rigidly.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.io.files import replace_file

_SIZE = 0.82  # of ICT's teeth: the mouths' widths, 36 and 44 mm between the corners
_LIPS = (
    np.array([0.0, -0.0336, 0.1079]),
    np.array([0.0, 0.8118, 0.1470]),
)  # ICT's lips and foremost tooth; where they go
_ALONG = 0.0045  # metres from a tooth, of gums
_FRONT = 0.116  # metres of z; nobody sees what lies further back
_JAW = ("jawOpen", "jawForward", "jawLeft", "jawRight")  # what moves the lower teeth
_TONGUE = 13380, 13606  # vertices of MakeHuman's base mesh
_STEP = 1e-6  # metres a unit of stored places


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("body", "ict", "out"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args()
    body, ict = np.load(options.body), np.load(options.ict)
    vertices, faces, tooth, lower = _mouth(ict)
    held = {key: body[key] for key in ("expr_names", "expr_ptr", "expr_idx", "expr_val")}
    held["mouth_vertices"] = np.rint((vertices - _LIPS[1]) / _STEP).astype(np.int32)
    held |= {"mouth_origin": _LIPS[1], "mouth_step": np.array(_STEP), "mouth_faces": faces.astype(np.uint16)}
    held |= {"mouth_tooth": tooth, "mouth_lower": lower}
    held["jaw_names"] = np.array(_JAW)
    held["jaw_ways"] = np.stack([_rigid(*_tongue(body, name)) for name in _JAW])
    packed = io.BytesIO()
    np.savez_compressed(packed, **held)
    replace_file(options.out, [packed.getvalue()])


def _mouth(ict: np.lib.npyio.NpzFile) -> tuple[F64, NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Vertices [M, 3] in the open body's space, triangles [F, 3], which of those are tooth, which vertices are low."""
    names = list(ict["materials"])
    quads, material = ict["faces"].astype(np.int64), ict["face_material"]
    at = (ict["neutral"].astype(np.float64) - _LIPS[0]) * _SIZE + _LIPS[1]
    moved = np.abs(ict["expression_delta"][list(ict["expression_names"]).index("jawOpen")]).sum(axis=1) > 0
    tooth = material == names.index("Teeth")
    chosen = tooth | _gums(quads, material == names.index("GumsTongue"), tooth, ict["neutral"])
    triangles = np.concatenate([quads[chosen][:, [0, 1, 2]], quads[chosen][:, [0, 2, 3]]])
    kinds = np.concatenate([tooth[chosen], tooth[chosen]])
    whole = (triangles >= 0).all(axis=1)
    seen = whole & (at[triangles, 2] > _FRONT).all(axis=1)
    used, first = np.unique(triangles[seen], return_inverse=True)
    return at[used], first.reshape(-1, 3), kinds[seen], moved[used]


def _gums(
    quads: NDArray[np.int64], soft: NDArray[np.bool_], tooth: NDArray[np.bool_], at: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Those of ``soft`` [F], which are gums, tongue and palate, that lie along teeth."""
    distance = cKDTree(at[np.unique(quads[tooth])]).query(at)[0]
    return np.asarray(soft & (distance[quads] < _ALONG).all(axis=1))


def _tongue(body: np.lib.npyio.NpzFile, name: str) -> tuple[F64, F64]:
    """The tongue's vertices [K, 3] at rest and in that expression."""
    target = list(body["expr_names"]).index(name)
    part = slice(*body["expr_ptr"][target : target + 2])
    offsets = np.zeros(body["v_template"].shape)
    offsets[body["expr_idx"][part]] = body["expr_val"][part]
    mine = (body["hm08_vertex"] >= _TONGUE[0]) & (body["hm08_vertex"] < _TONGUE[1])
    rest = body["v_template"][mine].astype(np.float64)
    return rest, rest + offsets[mine]


def _rigid(before: F64, after: F64) -> F64:
    """[3, 4] the rotation and the way that take points nearest to where they are afterwards (Kabsch 1976)."""
    middle, there = before.mean(axis=0), after.mean(axis=0)
    first, _, last = np.linalg.svd((after - there).T @ (before - middle))
    turn = first @ np.diag([1, 1, np.linalg.det(first @ last)]) @ last
    return np.concatenate([turn, (there - turn @ middle)[:, None]], axis=1)


if __name__ == "__main__":
    main()
