"""Read the rigged person that ``avatar make`` and others start from, and report what is unusual about it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.formats.person import read_person
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.extras.rigs.meshes.rig import read_rig_map
from glsplat.formats.format import opened
from glsplat.formats.registry import sniffed
from glsplat.formats.scene_file import upright
from glsplat.meshes import RiggedMesh
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

from ..args import add_up
from ..usage import UsageError

_SIZE_RANGE_M = 0.3, 3.0  # of people and most objects
_MIN_SHARE = 0.9  # of the requested splats
_BARE_DISTANCE = 0.03  # of the height; a part whose vertices are all farther from any splat has no splats


def add_rig(command: argparse.ArgumentParser) -> None:
    """Add --rig-map, --extra-scale and --up."""
    command.add_argument(
        "--rig-map", type=Path, metavar="JSON", help="of a glTF or VRM: joints by SMPL-X's names, where ours are wrong"
    )
    command.add_argument("--extra-scale", type=float, default=1.0, help="times the file's size (0.01: centimetres)")
    add_up(command, "of a glTF of no person: its axis that points up")


def read_any_person(path: Path, args: argparse.Namespace | None = None) -> RiggedMesh:
    """Return the rigged mesh of a file, read by content; ``args`` has the options of ``add_rig``."""
    rig_map = getattr(args, "rig_map", None)
    scale = float(getattr(args, "extra_scale", 1.0))
    up = str(getattr(args, "up", "y"))
    if not 1e-6 <= scale <= 1e6:
        raise UsageError(f"--extra-scale needs a number above 0, not {scale:g}")
    if is_gltf(path):
        mesh = read_gltf_person(path, rig_map=None if rig_map is None else read_rig_map(rig_map), scale=scale)
        if mesh.skeleton.names != JOINT_NAMES:
            return _turned(mesh, upright(up)[:3, :3])
        if up == "y":
            return mesh
        notes = [*mesh.meta.get("left_out", ()), f"--up {up} is not needed: a person's axes are told by the joints"]
        return replace(mesh, meta={**mesh.meta, "left_out": notes})
    if rig_map is not None or scale != 1 or up != "y":
        raise UsageError(f"{path}: --rig-map, --extra-scale and --up are for glTF and VRM; leave them out")
    if path.suffix.lower() == ".obj":
        raise FormatError(f"{path}: an .obj has no rig; name a rigged body with --body")
    return read_person(path)


def is_gltf(path: Path) -> bool:
    """Return whether a file is glTF or VRM, by content."""
    with opened(path) as start:
        known = sniffed(start)
        return known is not None and known.name in ("glb", "gltf")


def _turned(mesh: RiggedMesh, turn: F64) -> RiggedMesh:
    """Return the mesh rotated by ``turn`` [3, 3] about the origin."""
    if np.array_equal(turn, np.eye(3)):
        return mesh
    whole = np.eye(4)
    whole[:3, :3] = turn
    old = mesh.skeleton
    skeleton = Skeleton(old.names, old.parents, whole @ old.rest, old.inverse_bind @ whole.T)
    morphs = None if mesh.morphs is None else mesh.morphs.turned(turn)
    return replace(mesh, vertices=mesh.vertices @ turn.T, skeleton=skeleton, morphs=morphs)


def diagnostics(mesh: RiggedMesh, avatar: Avatar | None = None, asked: int = 0, scale: float = 1.0) -> Iterator[str]:
    """Yield a line about each unusual property. Raises FormatError for an invisibly small mesh.

    ``asked`` is the requested number of splats of ``avatar``, ``scale`` the factor by which the mesh was read.
    """
    vertices = mesh.posed(Pose.zero(len(mesh.skeleton)))[np.unique(mesh.faces)]
    height = float(np.ptp(vertices[:, 1]))
    if not np.isfinite(vertices).all() or np.ptp(vertices, axis=0).max() < 1e-4:
        raise FormatError("this person would be invisible: less than a tenth of a millimetre; try --extra-scale")
    why = why_not_driven(mesh.skeleton)
    drives = not why
    if not drives:
        named = mesh.meta.get("no_map")
        help_ = f"{named}; a --rig-map may help" if named else why
        yield f"cannot be driven by motions or a headset: {help_}"
    size = height if drives else float(np.ptp(vertices, axis=0).max())
    if not _SIZE_RANGE_M[0] <= size <= _SIZE_RANGE_M[1]:
        tall, better = ("tall", 1.7) if drives else ("from end to end", 1.0)
        yield f"{size:.3g} m {tall}; --extra-scale {better / size * scale:.2g} would make it {better:g} m"
    for line in mesh.meta.get("left_out", ()):
        yield f"{line}"
    if avatar is None:
        return
    if len(avatar.splats) < _MIN_SHARE * asked:
        yield f"{len(avatar.splats)} splats where {asked} were asked for"
    from scipy.spatial import cKDTree  # here: other commands do not need scipy

    near = cKDTree(avatar.splats.means)
    for part in mesh.parts:
        corners = mesh.vertices[np.unique(part.faces)]
        if len(corners) and near.query(corners)[0].min() > _BARE_DISTANCE * max(height, 1e-9):
            yield f'part "{part.name}" has no splats: nothing of it is seen'
