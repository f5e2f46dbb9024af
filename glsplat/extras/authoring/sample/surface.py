"""Make a Gaussian avatar from a rigged, textured mesh: flat discs that tile the visible surface (cells.py)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.mesh_shapes import area_factors
from glsplat.extras.authoring.geometry.surface_points import barycentric_matrix
from glsplat.extras.authoring.geometry.visibility import EYES, HEAD, VisiblePart, visible_surface
from glsplat.extras.authoring.sample.cells import Cells, Cloud, SamplerConfig, avatar_of, skin_of, tessellate
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skin import strongest_joint

Progress = Callable[[str, float], None]
MIN_SPLATS = 100
"""Of an avatar."""
_FULL_DETAIL_SPREAD = 0.12  # local standard deviation of a texture's colour
_DETAIL_PATCH_PX = 5
_FACE_DEPTH_M = 0.06  # before the head's joint, where the face's density is reached
_EYE_FRONT_COSINE, _EYE_BACK_DENSITY = 0.5, 0.2  # of an eyeball; its back is never visible
_MIN_ALPHA = 0.5
_HAND = ("wrist", "index", "middle", "pinky", "ring", "thumb")


def make_avatar(
    mesh: RiggedMesh,
    splats: int = 40_000,
    seed: int = 0,
    config: SamplerConfig | None = None,
    progress: Progress | None = None,
) -> Avatar:
    """Return a Gaussian avatar of ``mesh`` in its zero pose: discs on the visible surface, of SH degree 0.

    It has four influences for each splat, and the mesh's expressions as shapes. On the SMPL-X rig, hands and head get a
    fixed share of the splats. Surface that no camera sees in any of a few poses (skin under cloth, the inside of the
    mouth, cut-out texels) gets none. Deterministic in ``seed``. Raises FormatError for a mesh without visible surface,
    or for fewer than 100 splats.
    """
    if splats < MIN_SPLATS:
        raise FormatError(f"an avatar needs at least {MIN_SPLATS} splats, not {splats}")
    config = config or SamplerConfig()
    report = progress or (lambda stage, done: None)
    rng = np.random.default_rng(seed)
    report("finding the visible surface", 0.0)
    visible = visible_surface(mesh, config.probe) if config.probe else None
    zone = face_zones(mesh) if visible is None else np.where(visible.faces, face_zones(mesh), -1)
    chosen: list[Cells] = []
    for index, (label, count) in enumerate(allot(splats, zone, config)):
        report("placing splats", index / 4)
        cloud = _sample_surface(mesh, visible, zone == label, count * config.samples, rng, config)
        if cloud is not None and count:
            chosen.append(tessellate(cloud, count, config, rng))
    if not chosen:
        raise FormatError("the mesh shows nothing to put splats on: no area, or only texels of alpha below one half")
    report("placing splats", 1.0)
    return avatar_of(chosen, mesh, config.opacity)


def _sample_surface(
    mesh: RiggedMesh,
    visible: VisiblePart | None,
    chosen: NDArray[np.bool_],
    count: int,
    rng: np.random.Generator,
    config: SamplerConfig,
) -> Cloud | None:
    faces = mesh.faces[chosen]
    surface = trimesh.Trimesh(mesh.vertices, faces, process=False, validate=False)
    density = face_densities(mesh, config)[chosen]
    share = surface.area_faces * density
    if not share.sum() > 0:
        return None
    points, which = trimesh.sample.sample_surface(
        surface, count, face_weight=share, seed=int(rng.integers(2**31)), sample_color=False
    )
    points, which = np.asarray(points), np.asarray(which)
    bary = trimesh.triangles.points_to_barycentric(surface.triangles[which], points)
    corners = faces[which]

    part_of = mesh.face_parts[chosen][which]
    rgba, detail = np.ones((len(points), 4)), np.zeros(len(points))
    first = np.cumsum([0] + [len(part.faces) for part in mesh.parts])
    original = np.flatnonzero(chosen)[which]
    for i, part in enumerate(mesh.parts):
        mine = np.flatnonzero(part_of == i)
        uv = np.einsum("nk,nkc->nc", bary[mine], part.uv[original[mine] - first[i]])
        rgba[mine], detail[mine] = part.sample(uv), _detail(part).sample(uv)[:, 0]
    kept = rgba[:, 3] >= _MIN_ALPHA
    normals = surface.face_normals[which]
    if visible is not None:
        kept &= visible.is_visible(points, normals, part_of, config.reach)
    if not kept.any():
        return None
    points, which, bary, corners, rgba, part_of, normals, detail = (
        a[kept] for a in (points, which, bary, corners, rgba, part_of, normals, detail)
    )
    density_at = density[which]
    return Cloud(
        points=points,
        normals=normals,
        rgb=rgba[:, :3],
        share=1 / density_at,
        density=density_at * (1 + config.detail_boost * np.clip(detail / _FULL_DETAIL_SPREAD, 0, 1)),
        layer=part_of.astype(np.float64),
        corners=barycentric_matrix(corners, bary, len(mesh.vertices)),
        skin=skin_of(mesh),
        area=float(surface.area * kept.mean()),
        faces=original[kept],
    )


def _detail(part: MeshPart) -> MeshPart:
    """Return the part with a texture of the local standard deviation of its colour."""
    color, patch = part.texture[..., :3].astype(np.float32) / 255, (_DETAIL_PATCH_PX,) * 2
    variance = cv2.blur(color**2, patch) - cv2.blur(color, patch) ** 2
    spread = np.sqrt(np.maximum(variance, 0).sum(axis=2))
    texture = np.repeat(np.rint(np.clip(spread, 0, 1) * 255).astype(np.uint8)[..., None], 4, axis=2)
    return replace(part, texture=texture)


def face_densities(mesh: RiggedMesh, config: SamplerConfig) -> NDArray[np.float64]:
    """Return [F] relative densities of splats: higher for the front of the head, highest for the front of eyeballs.

    Surface that expressions unfold (lids, lips) counts by its largest area.
    """
    names = mesh.skeleton.names
    density = np.ones(len(mesh.vertices))
    if "head" in names:
        head = mesh.skeleton.joints[names.index("head")]
        owns = np.array([name in HEAD for name in names])
        amount = (mesh.weights * owns[mesh.joints]).sum(axis=1) / np.maximum(mesh.weights.sum(axis=1), 1e-9)
        front = np.clip((mesh.vertices[:, 2] - head[2]) / _FACE_DEPTH_M, 0, 1)
        density *= 1 + (config.face_boost - 1) * amount * front
    return np.asarray(density[mesh.faces].mean(axis=1)) * _eye_densities(mesh, config.eye_boost) * area_factors(mesh)


def _eye_densities(mesh: RiggedMesh, boost: float) -> NDArray[np.float64]:
    """Return [F] factors for eyeballs: an iris is a centimetre wide and needs more splats than skin."""
    density = np.ones(len(mesh.faces))
    owner = strongest_joint(mesh.joints, mesh.weights)[mesh.faces[:, 0]]
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    for joint, name in enumerate(mesh.skeleton.names):
        ball = owner == joint
        if name in EYES and ball.any():
            away = middle[ball] - mesh.vertices[mesh.faces[ball]].mean(axis=(0, 1))
            front = away[:, 2] > _EYE_FRONT_COSINE * np.linalg.norm(away, axis=1)
            density[ball] = np.where(front, boost, _EYE_BACK_DENSITY)
    return density


def joint_zones(names: Sequence[str]) -> NDArray[np.intp]:
    """Return [J] the zone of each joint: 0 the rest, 1 left hand, 2 right hand, 3 head."""
    hands = [tuple(f"{side}_{part}" for part in _HAND) for side in ("left", "right")]
    zones = [3 if name in HEAD else 1 if name.startswith(hands[0]) else 2 * name.startswith(hands[1]) for name in names]
    return np.array(zones, np.intp)


def face_zones(mesh: RiggedMesh) -> NDArray[np.intp]:
    """Return [F] the zone of each triangle, by its strongest joint (``joint_zones``)."""
    strongest = strongest_joint(mesh.joints, mesh.weights)
    return np.median(joint_zones(mesh.skeleton.names)[strongest][mesh.faces], axis=1).astype(np.intp)


def allot(total: int, zone: NDArray[np.intp], config: SamplerConfig) -> list[tuple[int, int]]:
    """Return the zones with visible triangles, each with its number of splats; the body takes the remainder."""
    shares = {1: config.hand_share, 2: config.hand_share, 3: config.head_share}
    counts = {label: round(total * share) for label, share in shares.items() if (zone == label).any()}
    if (zone == 0).any():
        counts[0] = total - sum(counts.values())
    else:  # a bust or a hand alone
        scale = total / max(sum(counts.values()), 1)
        counts = {label: round(n * scale) for label, n in counts.items()}
    return sorted(counts.items())
