"""Avatars from LAM's export: a zip of Gaussians that ride the vertices of a skinned mesh, one each."""

from __future__ import annotations

import json
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.ply import load_ply
from glsplat.making.gltf.reader import read_gltf_person
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["is_lam_zip", "load_lam_zip"]

_MEMBERS = {"offset.ply": 1 << 29, "skin.glb": 1 << 29, "vertex_order.json": 1 << 26}
"""What is read, and how many bytes each may unpack to."""
_ENTRIES = 10_000  # in the directory of the zip


def is_lam_zip(path: str | Path) -> bool:
    """True for a zip that holds a member called offset.ply; False for anything else, readable or not."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(PurePosixPath(name).name == "offset.ply" for name in archive.namelist())
    except (OSError, ValueError, zipfile.BadZipFile):
        return False


def load_lam_zip(path: str | Path, influences: int = 4) -> Avatar:
    """An avatar from a zip as LAM exports it, in the rest pose of its mesh.

    Members, in the zip's root or in one folder: ``offset.ply``, a 3DGS PLY whose x y z is the offset of each splat
    from its mesh vertex and whose f_dc is plain RGB in [0, 1]; ``skin.glb``, the skinned mesh; ``vertex_order.json``,
    a list that is a permutation: splat ``order[i]`` belongs to vertex i of the GLB (without the file, splat i does).
    Morph targets, animations and all other members are ignored: expressions do not move the splats.

    Written from the description of the format; no public sample was at hand to check it against.
    Raises FormatError naming the zip and the member. Nothing is unpacked before the directory's sizes are checked,
    and nothing under a name from the zip.
    """
    try:
        with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory(prefix="glsplat-") as folder:
            found = _find(archive)
            for name, info in found.items():
                (Path(folder) / name).write_bytes(archive.read(info))
            try:
                return _avatar(Path(folder), "vertex_order.json" in found, Path(path).name, influences)
            except FormatError as error:
                raise FormatError(str(error).replace(f"{folder}/", "").replace(f"{folder}\\", "")) from None
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot read the zip ({error.strerror or error})") from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, ValueError) as error:
        raise FormatError(f"{path}: a LAM export is a zip, but {' '.join(str(error).split())[:120]}") from None


def _find(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The members to read, after a look at their number, names and sizes."""
    entries = archive.infolist()
    if len(entries) > _ENTRIES:
        raise FormatError(f"a LAM export has a handful of members, this zip {len(entries)}")
    found: dict[str, zipfile.ZipInfo] = {}
    for info in entries:
        name = PurePosixPath(info.filename).name
        if info.is_dir() or name not in _MEMBERS or "__MACOSX" in info.filename:
            continue
        if name in found:
            raise FormatError(f"two members are called {name}; keep one avatar in a zip")
        if info.file_size > _MEMBERS[name]:
            raise FormatError(f"{name} would unpack to {info.file_size >> 20} MiB, more than {_MEMBERS[name] >> 20}")
        if info.flag_bits & 1:
            raise FormatError(f"{name} is encrypted; unpack the zip and pack it without a password")
        found[name] = info
    for name in ("offset.ply", "skin.glb"):
        if name not in found:
            inside = ", ".join(info.filename[:40] for info in entries[:6]) or "nothing"
            raise FormatError(f"a LAM export needs the member {name}; found {inside}")
    return found


def _avatar(folder: Path, ordered: bool, source: str, influences: int) -> Avatar:
    splats, mesh = load_ply(folder / "offset.ply"), read_gltf_person(folder / "skin.glb", own_joints=True)
    count = len(splats)
    if len(mesh.vertices) != count:
        raise FormatError(
            f"offset.ply has {count} splats, skin.glb {len(mesh.vertices)} vertices; each splat rides one"
        )
    vertex = np.empty(count, np.int64)
    vertex[_order(folder / "vertex_order.json", count) if ordered else np.arange(count)] = np.arange(count)
    rgb = splats.sh[:, 0].astype(np.float64)
    usable = splats.finite()
    if usable.any():
        _check(splats.means[usable], rgb[usable], mesh)
    at = mesh.vertices[vertex] + splats.means
    placed = Splats.create(at, splats.quats, splats.scales, splats.opacities, rgb=rgb)
    skin = Skin.create(mesh.joints[vertex], mesh.weights[vertex], len(mesh.skeleton), influences)
    meta: dict[str, Any] = {
        "source": f"LAM, {source}",
        "body_model": f"{len(mesh.skeleton)} joints of skin.glb",
        "licence": "as the picture and LAM's weights (CC BY-NC 4.0) allow",
    }
    return Avatar(placed, mesh.skeleton, skin, meta)


def _order(path: Path, count: int) -> NDArray[np.int64]:
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise FormatError(f"vertex_order.json: expected a JSON list, but {str(error)[:100]}") from None
    whole = isinstance(data, list) and all(type(value) is int and 0 <= value < count for value in data)
    if not whole or len(data) != count or len(set(data)) != count:
        what = f"a list of {len(data)}" if isinstance(data, list) else type(data).__name__
        raise FormatError(f"vertex_order.json needs every number from 0 to {count - 1} once, found {what}")
    return np.array(data, np.int64)


def _check(offsets: NDArray[np.float32], rgb: NDArray[np.float64], mesh: RiggedMesh) -> None:
    if rgb.min() < -0.02 or rgb.max() > 1.02:
        raise FormatError(
            f"offset.ply needs RGB in [0, 1] in f_dc, as LAM writes it, found {rgb.min():.2f} to {rgb.max():.2f}; "
            "for spherical harmonics and positions, bind the PLY to the mesh with --mesh"
        )
    typical = float(np.median(np.linalg.norm(offsets, axis=1)))
    extent = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if typical > 0.1 * extent:
        raise FormatError(
            f"offset.ply needs offsets from the mesh, found {typical:.3g} m in the median on a mesh of {extent:.3g} m; "
            "if these are positions, bind the PLY to the mesh with --mesh"
        )
