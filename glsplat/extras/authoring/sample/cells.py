"""Tile a surface with splats: cells of a dense sample of it, and the Gaussian of each cell.

The cells come from Lloyd's algorithm: a centroidal Voronoi tessellation whose distance also counts colour and
direction, so that cells end at the edges of texture and cloth, as superpixels do. A splat takes the mean, the
covariance, the mean colour and the mean skinning weights of its cell. So one rule gives spacing, anisotropy and area
filtering.
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

_EXPECTED_SIZE_SAMPLES = 6.0  # weight of a cell's expected size against its samples
_MIN_NORMAL_STRENGTH = 0.2  # length of a cell's mean normal; below it the cell's flattest direction is used
# variance of a splat's short axis, at least: of the mean of both axes, and of the median splat's
_MIN_ASPECT, _MIN_SIZE_FACTOR = 0.15, 0.02
_MAX_THICKNESS_FACTOR = 0.3  # of a splat's shorter axis


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerConfig:
    """How to cut a surface into splats. The defaults are tuned on clothed people at 40,000 splats."""

    samples: int = 40  # surface points for each splat
    candidates: int = 14  # of these, the points that place the cells
    rounds: int = 16  # of Lloyd's algorithm
    hand_share: float = 0.095  # fraction of all splats, for each hand
    head_share: float = 0.19  # fraction of all splats
    face_boost: float = 2.0  # density of the face over that of the rest of the head
    eye_boost: float = 10.0  # density of an eyeball's front over that around it
    detail_boost: float = 2.5  # density of busy texture over that of plain texture, minus one
    color_weight: float = 0.7  # cell sizes that a colour difference of one counts as
    normal_weight: float = 0.6  # cell sizes that a right angle counts as, over sqrt(2)
    sigma: float = 1.85  # standard deviation of a splat over that of its cell
    inset: float = 0.0  # metres inwards
    round_off: float = 0.0  # weight of a round cell of the expected size, in samples
    probe: int = 512  # pixels of the views that find the visible surface; 0: all surface is visible
    reach: float = 0.004  # metres from a visible point within which surface counts as visible
    thickness: float = 0.0004  # metres along the normal, at least
    opacity: float = 0.97


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """M points of the visible surface."""

    points: NDArray[np.float64]  # [M, 3]
    normals: NDArray[np.float64]  # [M, 3]
    rgb: NDArray[np.float64]  # [M, 3]
    share: NDArray[np.float64]  # [M] relative area that a point stands for
    density: NDArray[np.float64]  # [M] wanted splats per area, relative
    layer: NDArray[np.float64]  # [M] number of the mesh's part
    corners: csr_array  # [M, V] barycentric weights of the mesh's vertices
    skin: csr_array  # [V, J] skinning weights, from ``skin_of``
    area: float  # m^2 of the covered surface
    faces: NDArray[np.intp]  # [M] triangle of the mesh
    spread: NDArray[np.float64] | None = None  # [M] factor of the splats' standard deviations; None: 1


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
    """Return ``count`` cells of the cloud, with the Gaussian of each."""
    return prepare_cells(cloud, count, config, rng)()


def prepare_cells(cloud: Cloud, count: int, config: SamplerConfig, rng: np.random.Generator) -> Callable[[], Cells]:
    """Draw the random choices of ``tessellate`` and return the rest of its work as a function.

    The function may run on another core.
    """
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

    def settle() -> Cells:
        sites = first
        for _ in range(config.rounds):
            label = _nearest(sites, some)
            sites = _cell_means(label, some, np.ones(len(some)), sites)
        return _gaussians(cloud, _nearest(sites, features), count, size, config)

    return settle


def skin_of(mesh: RiggedMesh) -> csr_array:
    """Return [V, J] the mesh's skinning weights."""
    count, influences = mesh.joints.shape
    rows = np.arange(count + 1) * influences
    return csr_array((mesh.weights.ravel(), mesh.joints.ravel(), rows), shape=(count, len(mesh.skeleton)))


def avatar_of(cells: Sequence[Cells], mesh: RiggedMesh, opacity: float) -> Avatar:
    """Return an avatar of all cells on ``mesh``, with the four strongest influences of each, and its expressions."""
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
    """Return ``count`` indices drawn without replacement, with probabilities by ``weight`` (exponential races)."""
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
    """Return the Gaussians of the cells; ``size`` [M] is the expected side of a cell at each point, metres."""
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
    normal = np.where(strength > _MIN_NORMAL_STRENGTH, mean_normal / np.maximum(strength, 1e-9), flat)
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    u = np.cross(normal, least)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    basis = np.stack([u, np.cross(normal, u)], axis=2)  # [N, 3, 2]
    planar = np.einsum("nia,nij,njb->nab", basis, cov, basis)
    variance, axes = np.linalg.eigh(planar)
    if config.round_off:  # few samples make a cell look too thin and too small
        members = np.bincount(label, minlength=count)[:, None]
        even = variance.mean(axis=1, keepdims=True)
        variance = (members * variance + config.round_off * even) / (members + config.round_off)
        # pull towards the expected size, which avoids holes
        expected = _cell_means(label, np.square(size)[:, None] / 12, area, np.zeros((count, 1)))
        variance = (members * variance + _EXPECTED_SIZE_SAMPLES * expected) / (members - 1 + _EXPECTED_SIZE_SAMPLES)
    typical = np.median(variance.sum(axis=1) / 2)
    variance = np.maximum(variance, _MIN_ASPECT * variance.mean(axis=1, keepdims=True) + _MIN_SIZE_FACTOR * typical)
    tangent = np.einsum("nia,nab->nib", basis, axes)
    across = np.einsum("ni,nij,nj->n", normal, cov, normal)
    frame = np.concatenate([tangent, np.cross(tangent[:, :, 0], tangent[:, :, 1])[:, :, None]], axis=2)
    scales = np.empty((count, 3))
    scales[:, :2] = config.sigma * np.sqrt(variance)
    if cloud.spread is not None:
        scales[:, :2] *= _cell_means(label, cloud.spread[:, None], area, np.ones((count, 1)))
    scales[:, 2] = np.clip(
        np.sqrt(np.maximum(across, 0)), config.thickness, _MAX_THICKNESS_FACTOR * scales[:, :2].min(axis=1)
    )

    rows = csr_array((area, (label, np.arange(len(label)))), shape=(count, len(label)))
    weights = (rows @ cloud.corners @ cloud.skin).toarray()
    rgb = _cell_means(label, cloud.rgb, area, zero)
    quats = Rotation.from_matrix(frame).as_quat()[:, [3, 0, 1, 2]]
    faces = cloud.faces[_middles(label, lengths(offset), count)]
    means = means - config.inset * normal
    return Cells(means, quats, scales, rgb, weights, faces)


def _middles(label: NDArray[np.intp], distance: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Return [count] the member of each cell that has the least ``distance`` [M]."""
    order = np.lexsort((distance, label))
    return np.asarray(order[np.searchsorted(label[order], np.arange(count))])
