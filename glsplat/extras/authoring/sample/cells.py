"""Splats that tile a surface: cells of a dense sample of it, and the Gaussian of each cell.

The cells come from Lloyd's algorithm (a centroidal Voronoi tessellation, in which distance also counts colour and
direction, so that cells end at the edges of the texture and of the cloth, as superpixels do). A splat takes the mean,
the covariance, the mean colour and the mean skinning weights of its cell: spacing, anisotropy and area filtering come
from one rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.threads import run_in_background
from glsplat.extras.authoring.geometry.mesh_shapes import shapes_of
from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["Cells", "Cloud", "SamplerConfig", "avatar_of", "begun", "skin_of", "tessellate"]

_USUAL = 6.0  # samples that a cell's expected size is worth where few were drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerConfig:
    """How a surface is cut into splats. The defaults are tuned on clothed people at 40,000 splats."""

    samples: int = 40  # surface points a splat
    candidates: int = 14  # of them, those that place the cells
    rounds: int = 16  # of Lloyd's algorithm
    hand_share: float = 0.095  # of all splats, a hand
    head_share: float = 0.19  # of all splats
    face_boost: float = 2.0  # density of the face against the rest of the head
    eye_boost: float = 10.0  # density of the front of an eyeball against what is around it
    detail_boost: float = 2.5  # density where the texture is busy against where it is plain, less one
    color_weight: float = 0.7  # cells of unit size a colour difference of one is worth
    normal_weight: float = 0.6  # cells of unit size a right angle is worth, over sqrt(2)
    sigma: float = 1.85  # standard deviations of the splat over those of its cell
    inset: float = 0.0  # metres inwards
    round_off: float = 0.0  # samples that a round cell of the same size is worth against those drawn
    probe: int = 512  # pixels of the views that find the visible surface; 0: all of it is
    reach: float = 0.004  # metres from a seen point within which surface counts as seen
    thickness: float = 0.0004  # metres along the normal, at least
    opacity: float = 0.97


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """M points of the visible surface."""

    points: NDArray[np.float64]  # [M, 3]
    normals: NDArray[np.float64]  # [M, 3]
    rgb: NDArray[np.float64]  # [M, 3]
    share: NDArray[np.float64]  # [M] surface a point stands for, relative
    density: NDArray[np.float64]  # [M] wanted splats by area, relative
    layer: NDArray[np.float64]  # [M] part number
    corners: csr_array  # [M, V] shares of the mesh's vertices
    skin: csr_array  # [V, J] of those, as of ``skin_of``
    area: float  # m^2 of the surface it covers
    faces: NDArray[np.intp]  # [M] triangle of the mesh


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The Gaussians of N cells, in the zero pose."""

    means: NDArray[np.float64]
    quats: NDArray[np.float64]
    scales: NDArray[np.float64]
    rgb: NDArray[np.float64]
    weights: NDArray[np.float64]  # [N, J]
    faces: NDArray[np.intp]  # [N] triangle at the middle


def tessellate(cloud: Cloud, count: int, config: SamplerConfig, rng: np.random.Generator) -> Cells:
    """``count`` cells of the cloud and the Gaussian of each."""
    return begun(cloud, count, config, rng)()


def begun(cloud: Cloud, count: int, config: SamplerConfig, rng: np.random.Generator) -> Callable[[], Cells]:
    """What makes the cells of ``tessellate``, perhaps on another core; what is left to chance is drawn before."""
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
    first = some[np.sort(rng.choice(len(some), count, replace=False))]

    def settled() -> Cells:
        sites = first
        for _ in range(config.rounds):
            label = _nearest(sites, some)
            sites = _cell_means(label, some, np.ones(len(some)), sites)
        return _gaussians(cloud, _nearest(sites, features), count, size, config)

    return settled


def skin_of(mesh: RiggedMesh) -> csr_array:
    """[V, J] the mesh's skinning weights."""
    count, influences = mesh.joints.shape
    rows = np.arange(count + 1) * influences
    return csr_array((mesh.weights.ravel(), mesh.joints.ravel(), rows), shape=(count, len(mesh.skeleton)))


def avatar_of(cells: Sequence[Cells], mesh: RiggedMesh, opacity: float) -> Avatar:
    """An avatar of all these cells on ``mesh``, with the four strongest influences of each, and its expressions."""
    means, quats, scales = (np.concatenate([getattr(c, key) for c in cells]) for key in ("means", "quats", "scales"))
    rgb = np.concatenate([c.rgb for c in cells])
    weights = np.concatenate([c.weights for c in cells])
    joints = len(mesh.skeleton)
    skin = run_in_background(lambda: Skin.create(np.broadcast_to(np.arange(joints), weights.shape), weights, joints))
    splats = Splats.create(means, quats, scales, np.full(len(means), opacity), rgb=rgb, antialias=True)
    faces = np.concatenate([c.faces for c in cells])
    shapes = None if mesh.morphs is None else shapes_of(splats, mesh, mesh.morphs, faces)
    return Avatar(splats, mesh.skeleton, skin(), dict(mesh.meta), shapes=shapes)


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


def _gaussians(
    cloud: Cloud, label: NDArray[np.intp], count: int, size: NDArray[np.float64], config: SamplerConfig
) -> Cells:
    """``size`` [M] is the side of a cell that has the density wanted there, metres."""
    used = np.bincount(label, minlength=count) > 0
    label, count = (np.cumsum(used) - 1)[label], int(used.sum())
    points, normals = cloud.points, cloud.normals
    area = cloud.share
    zero = np.zeros((count, 3))
    means = _cell_means(label, points, area, zero)
    mean_normal = _cell_means(label, normals, area, zero)
    offset = points - means[label]
    cov = np.empty((count, 3, 3))
    for row in range(3):
        products = offset[:, row, None] * offset[:, row:]
        cov[:, row, row:] = cov[:, row:, row] = _cell_means(label, products, area, zero[:, row:])

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
    if config.round_off:  # few samples make a cell look thinner and smaller than it is
        members = np.bincount(label, minlength=count)[:, None]
        even = variance.mean(axis=1, keepdims=True)
        variance = (members * variance + config.round_off * even) / (members + config.round_off)
        # and one of a few samples says little of its own size: holes would show where it is thought too small
        usual = _cell_means(label, np.square(size)[:, None] / 12, area, np.zeros((count, 1)))
        variance = (members * variance + _USUAL * usual) / (members - 1 + _USUAL)
    typical = np.median(variance.sum(axis=1) / 2)
    variance = np.maximum(variance, 0.15 * variance.sum(axis=1, keepdims=True) / 2 + 0.02 * typical)
    tangent = np.einsum("nia,nab->nib", basis, axes)
    across = np.einsum("ni,nij,nj->n", normal, cov, normal)
    frame = np.concatenate([tangent, np.cross(tangent[:, :, 0], tangent[:, :, 1])[:, :, None]], axis=2)
    scales = np.empty((count, 3))
    scales[:, :2] = config.sigma * np.sqrt(variance)
    scales[:, 2] = np.clip(np.sqrt(np.maximum(across, 0)), config.thickness, 0.3 * scales[:, :2].min(axis=1))

    rows = csr_array((area, (label, np.arange(len(label)))), shape=(count, len(label)))
    weights = (rows @ cloud.corners @ cloud.skin).toarray()
    rgb = _cell_means(label, cloud.rgb, area, zero)
    quats = Rotation.from_matrix(frame).as_quat()[:, [3, 0, 1, 2]]
    faces = cloud.faces[_middles(label, lengths(offset), count)]
    means = means - config.inset * normal
    return Cells(means, quats, scales, rgb, weights, faces)


def _middles(label: NDArray[np.intp], distance: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """[count] the member of each cell that has the least ``distance`` [M]."""
    order = np.lexsort((distance, label))
    return np.asarray(order[np.searchsorted(label[order], np.arange(count))])
