"""From a rigged, textured mesh to a Gaussian avatar: flat discs that tile the visible surface.

The surface is cut into as many cells as there are splats, by Lloyd's algorithm on a dense sample of it (a centroidal
Voronoi tessellation, in which distance also counts colour and direction, so that cells end at the edges of the
texture and of the cloth, as superpixels do). A splat takes the mean, the covariance, the mean colour and the mean
skinning weights of its cell: spacing, anisotropy and area filtering come from one rule.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.making.visibility import HEAD, Seen, seen_surface
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["SamplerConfig", "make_avatar"]

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerConfig:
    """How a surface is cut into splats. The defaults are tuned on clothed people at 40,000 splats."""

    samples: int = 40  # surface points a splat
    candidates: int = 14  # of them, those that place the cells
    rounds: int = 16  # of Lloyd's algorithm
    hand_share: float = 0.095  # of all splats, a hand
    head_share: float = 0.19  # of all splats
    face_boost: float = 2.0  # density of the face against the rest of the head
    detail_boost: float = 2.5  # density where the texture is busy against where it is plain, less one
    color_weight: float = 0.7  # cells of unit size a colour difference of one is worth
    normal_weight: float = 0.6  # cells of unit size a right angle is worth, over sqrt(2)
    sigma: float = 1.85  # standard deviations of the splat over those of its cell
    inset: float = 0.0  # metres inwards
    probe: int = 512  # pixels of the views that find the visible surface
    reach: float = 0.004  # metres from a seen point within which surface counts as seen
    thickness: float = 0.0004  # metres along the normal, at least
    opacity: float = 0.97


def make_avatar(
    mesh: RiggedMesh,
    splats: int = 40_000,
    seed: int = 0,
    config: SamplerConfig | None = None,
    progress: Progress | None = None,
) -> Avatar:
    """A Gaussian avatar of ``mesh`` in its zero pose: discs on the visible surface, SH degree 0, four influences.

    On the SMPL-X rig, hands and head get a fixed share of the splats. Surface no camera can see in any of a few
    poses (skin under cloth, the inside of the mouth, cut-out texels) gets none. Deterministic in ``seed``.
    Raises FormatError for a mesh with nothing to see or fewer than 100 splats.
    """
    if splats < 100:
        raise FormatError(f"an avatar needs at least 100 splats, not {splats}")
    config = config or SamplerConfig()
    report = progress or (lambda stage, done: None)
    rng = np.random.default_rng(seed)
    report("finding the visible surface", 0.0)
    seen = seen_surface(mesh, config.probe)
    zone = np.where(seen.faces, _face_zones(mesh), -1)
    chosen: list[_Cells] = []
    for index, (label, count) in enumerate(_allot(splats, zone, config)):
        report("placing splats", index / 4)
        cloud = _sample_surface(mesh, seen, zone == label, count * config.samples, rng, config)
        if cloud is not None and count:
            chosen.append(_tessellate(cloud, count, config, rng))
    if not chosen:
        raise FormatError("the mesh shows nothing to put splats on: no area, or only texels of alpha below one half")
    report("placing splats", 1.0)
    means, quats, scales = (np.concatenate([getattr(c, key) for c in chosen]) for key in ("means", "quats", "scales"))
    rgb = np.concatenate([c.rgb for c in chosen])
    weights = np.concatenate([c.weights for c in chosen])
    joint_count = len(mesh.skeleton)
    skin = Skin.create(np.broadcast_to(np.arange(joint_count), weights.shape), weights, joint_count)
    gaussians = Splats.create(means, quats, scales, np.full(len(means), config.opacity), rgb=rgb, antialias=True)
    return Avatar(gaussians, mesh.skeleton, skin, dict(mesh.meta))


@dataclass(frozen=True, slots=True, eq=False)
class _Cloud:
    """M points of the visible surface."""

    points: NDArray[np.float64]  # [M, 3]
    normals: NDArray[np.float64]  # [M, 3]
    rgb: NDArray[np.float64]  # [M, 3]
    share: NDArray[np.float64]  # [M] surface a point stands for, relative
    density: NDArray[np.float64]  # [M] wanted splats by area, relative
    layer: NDArray[np.float64]  # [M] part number
    weights: csr_array  # [M, J]
    area: float  # m^2 of the surface it covers


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    means: NDArray[np.float64]
    quats: NDArray[np.float64]
    scales: NDArray[np.float64]
    rgb: NDArray[np.float64]
    weights: NDArray[np.float64]  # [N, J]


def _sample_surface(
    mesh: RiggedMesh,
    seen: Seen,
    chosen: NDArray[np.bool_],
    count: int,
    rng: np.random.Generator,
    config: SamplerConfig,
) -> _Cloud | None:
    faces = mesh.faces[chosen]
    surface = trimesh.Trimesh(mesh.vertices, faces, process=False, validate=False)
    density = _vertex_density(mesh, config)[faces].mean(axis=1)
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
    solid = rgba[:, 3] >= 0.5
    normals = surface.face_normals[which]
    solid &= seen.shows(points, normals, part_of, config.reach)
    if not solid.any():
        return None
    points, which, bary, corners, rgba, part_of, normals, detail = (
        a[solid] for a in (points, which, bary, corners, rgba, part_of, normals, detail)
    )
    drawn = density[which]

    m, k = len(points), mesh.joints.shape[1]
    values = (bary[:, :, None] * mesh.weights[corners]).reshape(m, -1)
    weights = csr_array(
        (values.ravel(), mesh.joints[corners].reshape(-1), np.arange(m + 1) * 3 * k), shape=(m, len(mesh.skeleton))
    )
    return _Cloud(
        points=points,
        normals=normals,
        rgb=rgba[:, :3],
        share=1 / drawn,
        density=drawn * (1 + config.detail_boost * np.clip(detail / _BUSY, 0, 1)),
        layer=part_of.astype(np.float64),
        weights=weights,
        area=float(surface.area * solid.mean()),
    )


_BUSY = 0.12  # local standard deviation of colour that counts as fully busy


def _detail(part: MeshPart) -> MeshPart:
    """The part with a texture that holds the local standard deviation of its colour (5 x 5 texels)."""
    color = part.texture[..., :3].astype(np.float32) / 255
    variance = cv2.blur(color**2, (5, 5)) - cv2.blur(color, (5, 5)) ** 2
    spread = np.sqrt(np.maximum(variance, 0).sum(axis=2))
    texture = np.repeat(np.rint(np.clip(spread, 0, 1) * 255).astype(np.uint8)[..., None], 4, axis=2)
    return replace(part, texture=texture)


def _vertex_density(mesh: RiggedMesh, config: SamplerConfig) -> NDArray[np.float64]:
    """[V] relative density: the front of the head counts more."""
    names = mesh.skeleton.names
    density = np.ones(len(mesh.vertices))
    if "head" in names:
        head = mesh.skeleton.joints[names.index("head")]
        owns = np.array([name in HEAD for name in names])
        amount = (mesh.weights * owns[mesh.joints]).sum(axis=1) / np.maximum(mesh.weights.sum(axis=1), 1e-9)
        front = np.clip((mesh.vertices[:, 2] - head[2]) / 0.06, 0, 1)
        density *= 1 + (config.face_boost - 1) * amount * front
    return density


_HAND = ("wrist", "index", "middle", "pinky", "ring", "thumb")


def _face_zones(mesh: RiggedMesh) -> NDArray[np.intp]:
    """[F] zone of each triangle by its strongest joint: 0 the rest, 1 left hand, 2 right hand, 3 head."""
    zone_of = np.zeros(len(mesh.skeleton), np.intp)
    for i, name in enumerate(mesh.skeleton.names):
        for zone, side in ((1, "left"), (2, "right")):
            if name.startswith(tuple(f"{side}_{part}" for part in _HAND)):
                zone_of[i] = zone
        if name in HEAD:
            zone_of[i] = 3
    strongest = np.take_along_axis(mesh.joints, mesh.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.median(zone_of[strongest][mesh.faces], axis=1).astype(np.intp)


def _allot(total: int, zone: NDArray[np.intp], config: SamplerConfig) -> list[tuple[int, int]]:
    """Zones that have visible triangles, each with its number of splats; the rest of the body takes what is left."""
    shares = {1: config.hand_share, 2: config.hand_share, 3: config.head_share}
    counts = {label: round(total * share) for label, share in shares.items() if (zone == label).any()}
    if (zone == 0).any():
        counts[0] = total - sum(counts.values())
    else:  # a bust or a hand alone
        scale = total / max(sum(counts.values()), 1)
        counts = {label: round(n * scale) for label, n in counts.items()}
    return sorted(counts.items())


def _tessellate(cloud: _Cloud, count: int, config: SamplerConfig, rng: np.random.Generator) -> _Cells:
    """``count`` cells of the cloud and the Gaussian of each."""
    weight = cloud.share * cloud.density
    size = np.sqrt(cloud.area / count * np.average(cloud.density, weights=cloud.share) / cloud.density)
    features = np.concatenate(
        [
            cloud.points,
            cloud.normals * (config.normal_weight * size[:, None]),
            cloud.rgb * (config.color_weight * size[:, None]),
            cloud.layer[:, None] * (2 * size[:, None]),
        ],
        axis=1,
    )
    # Lloyd's algorithm settles at the square root of the density it is fed (in the plane), so it is fed the square
    thin = _pick(weight * cloud.density, min(count * config.candidates, len(features)), rng)
    some = features[thin]
    count = min(count, len(some))
    sites = some[np.sort(rng.choice(len(some), count, replace=False))]
    for _ in range(config.rounds):
        label = _nearest(sites, some)
        sites = _cell_means(label, some, np.ones(len(some)), sites)
    return _gaussians(cloud, _nearest(sites, features), count, config)


def _pick(weight: NDArray[np.float64], count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """``count`` indices drawn without replacement, with probabilities by ``weight`` (exponential races)."""
    keys = rng.exponential(size=len(weight)) / weight
    return np.sort(np.argpartition(keys, count - 1)[:count])


def _nearest(sites: NDArray[np.float64], features: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.asarray(cKDTree(sites).query(features, workers=-1)[1])


def _cell_means(
    label: NDArray[np.intp], values: NDArray[np.float64], weight: NDArray[np.float64], empty: NDArray[np.float64]
) -> NDArray[np.float64]:
    total = np.bincount(label, weight, minlength=len(empty))
    sums = np.stack([np.bincount(label, weight * column, minlength=len(empty)) for column in values.T], axis=1)
    return np.where(total[:, None] > 0, sums / np.where(total > 0, total, 1)[:, None], empty)


def _gaussians(cloud: _Cloud, label: NDArray[np.intp], count: int, config: SamplerConfig) -> _Cells:
    used = np.bincount(label, minlength=count) > 0
    label, count = (np.cumsum(used) - 1)[label], int(used.sum())
    points, normals = cloud.points, cloud.normals
    area = cloud.share
    zero = np.zeros((count, 3))
    means = _cell_means(label, points, area, zero)
    mean_normal = _cell_means(label, normals, area, zero)
    offset = points - means[label]
    outer = (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
    cov = _cell_means(label, outer, area, np.zeros((count, 9))).reshape(-1, 3, 3)

    # frame: mean normal, then the principal axes of the cell in the tangent plane
    strength = np.linalg.norm(mean_normal, axis=1, keepdims=True)
    flat = np.linalg.eigh(cov)[1][:, :, 0]
    normal = np.where(strength > 0.2, mean_normal / np.maximum(strength, 1e-9), flat)
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    u = np.cross(normal, least)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    basis = np.stack([u, np.cross(normal, u)], axis=2)  # [N, 3, 2]
    planar = np.einsum("nia,nij,njb->nab", basis, cov, basis)
    variance, axes = np.linalg.eigh(planar)
    typical = np.median(variance.sum(axis=1) / 2)
    variance = np.maximum(variance, 0.15 * variance.sum(axis=1, keepdims=True) / 2 + 0.02 * typical)
    tangent = np.einsum("nia,nab->nib", basis, axes)
    across = np.einsum("ni,nij,nj->n", normal, cov, normal)
    frame = np.concatenate([tangent, np.cross(tangent[:, :, 0], tangent[:, :, 1])[:, :, None]], axis=2)
    scales = np.empty((count, 3))
    scales[:, :2] = config.sigma * np.sqrt(variance)
    scales[:, 2] = np.clip(np.sqrt(np.maximum(across, 0)), config.thickness, 0.3 * scales[:, :2].min(axis=1))

    rows = csr_array((area, (label, np.arange(len(label)))), shape=(count, len(label)))
    weights = (rows @ cloud.weights).toarray()
    rgb = _cell_means(label, cloud.rgb, area, zero)
    quats = Rotation.from_matrix(frame).as_quat()[:, [3, 0, 1, 2]]
    means = means - config.inset * normal
    return _Cells(means, quats, scales, rgb, weights)
