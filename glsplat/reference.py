"""The float64 twin of every shader, without approximations: the oracle of tests, and documentation. Slow.

Rules: docs/conventions.md, "pixel contract". Each function names the GLSL chunk that it mirrors. Sources: EWA Splatting
(Zwicker et al. 2002), 3DGS (Kerbl et al. 2023), gsplat (projection, clamp), the paper's GA backend (skinning).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera, passes_of, sorting_camera
from glsplat.config import RenderConfig
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.pictures import lifted, to_linear, to_srgb
from glsplat.rotations import is_rigid, quaternion_matrices, sh_basis, signed_axes
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = [
    "MeshLayer",
    "Posed",
    "Projected",
    "blended_rotations",
    "depth_order",
    "dilated_covariances",
    "evaluate_sh",
    "expressed",
    "jacobians",
    "joined",
    "lifted",
    "lit",
    "placed",
    "project",
    "quaternion_matrices",
    "render",
    "render_scene",
    "rest",
    "shading",
    "skin",
]


ALPHA_MAX = 0.99
ALPHA_MIN = 1 / 255
AA_FLOOR = 2.5e-5  # smallest det / det_dilated under antialias (gsplat: 0.005 squared)
POWER = 32  # exponent of the rotation average, see blended_rotations
SOFT = 0.3  # range of the cosine over which occlusion fades the sun out
SELECT = 1e-3  # weight of the dominant column in blended_rotations


@dataclass(frozen=True)
class Posed:
    """Splats after skinning: positions, shapes, rotations."""

    means: F64  # [N, 3]
    shapes: F64  # [N, 3, 3] M with Sigma = M M^T
    rotations: F64  # [N, 3, 3] R_i: posed from canonical directions


@dataclass(frozen=True)
class MeshLayer:
    """Opaque meshes of one view, sampled at pixel centres."""

    colours: F64  # [H, W, 3]
    z: F64  # [H, W] camera z in metres, infinite without a mesh


@dataclass(frozen=True)
class Projected:
    """Splats projected into one view, in pixels."""

    means2d: F64  # [N, 2]
    covars2d: F64  # [N, 3] a, b, c of [[a, b], [b, c]], dilated
    depths: F64  # [N] camera z
    alphas: F64  # [N] opacity after antialias compensation
    extents: F64  # [N] standard deviations at which the quad ends, 0 where culled
    colours: F64  # [N, 3]

    @property
    def visible(self) -> NDArray[np.bool_]:
        """True [N] where the splat is drawn in this view."""
        return self.extents > 0


def rest(splats: Splats) -> Posed:
    """Return the splats at rest: M = R(q) diag(s), the paper's equation for Sigma_i (covariance.glsl)."""
    rotations = quaternion_matrices(splats.quats)
    shapes = rotations * np.asarray(splats.scales, np.float64)[:, None, :]
    return Posed(splats.means.astype(np.float64), shapes, np.broadcast_to(np.eye(3), rotations.shape))


def blended_rotations(blended: F64, anchor: F64, shift: float = 1.0) -> F64:
    """Return R_i [N, 3, 3], the nearest rotation to a blended matrix, continuous through a collapse (rotation.glsl).

    The nearest rotation's quaternion is the top eigenvector of the symmetric 4x4 matrix Q(A) + shift I (Davenport's
    q-method; for a blend of rotations this is Markley's average of their quaternions). Instead of the eigenvector
    this takes P v with P = (Q + I)^32, trace 1, and v the quaternion of the ``anchor`` bone's matrix [N, 3, 3]. That is
    equal to 1e-7 while the two largest eigenvalues differ (two equal weights up to 150 degrees apart). Where they meet
    (a collapse, where the nearest rotation jumps) it swings through the anchor's rotation instead, at most 32 times as
    fast as one joint turns, if the anchor keeps at least half of the weight on its side of that joint (Skin.anchored).
    A thousandth of P's dominant column keeps the answer defined where P v vanishes; where that changes from column to
    column the answer steps by at most 0.3 degrees. ``shift`` is 1 for blends of rotations and 3 where a bone scales or
    reflects, so that Q + shift I has no negative eigenvalue.
    """
    toward, column = _swing(blended, anchor, shift)
    sign = np.where(np.einsum("ni,ni->n", toward, column) < 0, -1.0, 1.0)
    quats = toward + (SELECT * sign)[:, None] * column
    return quaternion_matrices(quats / np.linalg.norm(quats, axis=1, keepdims=True))


def _swing(blended: F64, anchor: F64, shift: float) -> tuple[F64, F64]:
    """Return P v [N, 4], whose length is near 1 far from a collapse, and the dominant column of P."""
    size = np.sqrt((blended**2).sum(axis=(1, 2)) / 3)
    scaled = blended / np.maximum(size, 1)[:, None, None]
    values, vectors = np.linalg.eigh(_davenport(scaled) + shift * np.eye(4))
    relative = np.maximum(values / np.maximum(values[:, -1:], 1e-300), 0) ** POWER
    relative /= relative.sum(axis=1, keepdims=True)
    power = np.einsum("nik,nk,njk->nij", vectors, relative, vectors)
    start = _dominant_column(_davenport(anchor) + np.eye(4))
    return np.einsum("nij,nj->ni", power, start), _dominant_column(power)


def expressed(splats: Splats, shapes: Shapes, weights: F64) -> Posed:
    """Return the splats at rest with an expression; ``weights`` [T] of the shapes (shapes.glsl)."""
    still, rows = rest(splats), shapes.rows
    amount = weights[shapes.targets]
    means = still.means.copy()
    units = shapes.sizes[shapes.targets].astype(np.float64)
    np.add.at(means, rows, (amount * units)[:, None] * shapes.moves)
    bends = np.zeros((len(splats), 2, 3))
    np.add.at(bends, rows, (amount * BEND)[:, None, None] * shapes.bends)
    moved = np.flatnonzero(np.diff(shapes.starts))  # other splats stay bit-identical
    axes, order = quaternion_matrices(splats.quats[moved]), long_axes(splats.scales[moved])
    a, b = (np.take_along_axis(axes, order[:, None, k, None], axis=2)[:, :, 0] + bends[moved, k] for k in (0, 1))
    normal = np.cross(a, b)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
    bent = np.empty_like(axes)
    np.put_along_axis(bent, order[:, None, :], np.stack([a, b, normal], axis=2), axis=2)
    shaped = still.shapes.copy()
    shaped[moved] = bent * splats.scales[moved, None, :].astype(np.float64)
    return Posed(means, shaped, still.rotations)


def skin(
    splats: Splats,
    binding: Skin,
    bones: F64,  # [J, 3, 4]
    mode: str = "polar",  # or raw
    shapes: Shapes | None = None,
    expression: F64 | None = None,  # [T] weights of the shapes; None: all 0
) -> Posed:
    """Return the splats after an expression and linear blend skinning (paper, p_i' and Sigma_i'; skin.glsl)."""
    still = rest(splats) if shapes is None or expression is None else expressed(splats, shapes, expression)
    weights = binding.weights.astype(np.float64)
    blended = np.einsum("nk,nkij->nij", weights, bones[binding.joints])
    means = np.einsum("nij,nj->ni", blended[:, :, :3], still.means) + blended[:, :, 3]
    shift = 1.0 if is_rigid(bones) else 3.0
    rotations = blended_rotations(blended[:, :, :3], bones[binding.joints[:, 0], :, :3], shift)
    linear = rotations if mode == "polar" else blended[:, :, :3]
    return Posed(means, linear @ still.shapes, rotations)


def placed(posed: Posed, transform: F64) -> Posed:
    """Return an item's splats transformed by x -> s R x + t of ``transform`` [4, 4] (place.vert.glsl)."""
    linear = transform[:3, :3]
    turn = linear / np.cbrt(np.linalg.det(linear))
    means = posed.means @ linear.T + transform[:3, 3]
    return Posed(means, linear @ posed.shapes, turn @ posed.rotations)


def joined(parts: Sequence[tuple[Posed, Splats]]) -> tuple[Posed, Splats, NDArray[np.bool_]]:
    """Return the concatenated items of a scene: posed splats, attributes, antialias flags [N]."""
    degree = max(splats.sh_degree for _, splats in parts)
    count = (degree + 1) ** 2
    sh = [np.pad(splats.sh, ((0, 0), (0, count - splats.sh.shape[1]), (0, 0))) for _, splats in parts]
    posed = Posed(*(np.concatenate([getattr(p, n) for p, _ in parts]) for n in ("means", "shapes", "rotations")))
    names = ("means", "quats", "scales", "opacities")
    means, quats, scales, opacities = (np.concatenate([getattr(s, n) for _, s in parts]) for n in names)
    surface = Surface.joined([s.surface for _, s in parts], [len(s) for _, s in parts])
    splats = Splats(means, quats, scales, opacities, np.concatenate(sh), surface=surface)
    return posed, splats, np.concatenate([np.full(len(s), s.antialias) for _, s in parts])


def evaluate_sh(sh: F64, directions: F64, degree: int) -> F64:
    """Return the colours [N, 3] of coefficients [N, K, 3] in unit directions [N, 3], 3DGS basis and signs (sh.glsl)."""
    basis = sh_basis(directions, degree).T
    return np.maximum(np.einsum("kn,nkc->nc", basis, sh[:, : len(basis)]) + 0.5, 0)


def shading(posed: Posed, splats: Splats, light: Light) -> F64:
    """Return the factors [N, 3] of colours in linear light; below 0 where there is no surface (light.glsl).

    The factor is irradiance over pi (Ramamoorthi and Hanrahan 2001), divided by the light baked into the colours.
    Normals are fixed in the splats' axes, so they rotate with skin and expression. The sun reaches an occluded point
    within a cone about the normal; sin^2 of its half angle is the openness (Oat and Sander, Ambient Aperture Lighting,
    2007).
    """
    assert splats.surface is not None
    lengths = np.linalg.norm(posed.shapes, axis=1, keepdims=True)
    axes = np.where(lengths > 1e-15, posed.shapes / np.maximum(lengths, 1e-300), 0.0)
    for k in range(3):  # of several zero axes the first
        flat = np.flatnonzero((lengths[:, 0, k] <= 1e-15) & (lengths[:, 0, :k] > 1e-15).all(axis=1))
        axes[flat, :, k] = np.cross(axes[flat, :, (k + 1) % 3], axes[flat, :, (k + 2) % 3])
    local = splats.surface.in_axes(signed_axes(splats.quats, splats.scales))
    normals = np.einsum("nij,nj->ni", axes, local)
    normals /= np.sqrt(np.maximum((normals**2).sum(axis=1, keepdims=True), 1e-12))
    ao = splats.surface.ao
    total = light.irradiance(normals) * ao[:, None]
    if light.sun_direction is not None:
        facing = normals @ light.sun_direction
        reached = np.clip(1 + (facing - np.sqrt(1 - ao)) / SOFT, 0, 1)
        total = total + (np.maximum(facing, 0) * reached)[:, None] * (light.sun_colour / np.pi)
    return np.where((splats.surface.normals != 0).any(axis=1, keepdims=True), total / splats.surface.shades, -1.0)


def lit(colours: F64, factors: F64) -> F64:
    """Return colours [N, 3] times the factors of ``shading``, clamped to [0, 1]; unchanged without a surface."""
    return np.where(factors[:, :1] < 0, colours, to_srgb(to_linear(colours) * np.maximum(factors, 0)))


def jacobians(x: F64, y: F64, z: F64, camera: Camera) -> F64:
    """Return the projection's Jacobians [N, 2, 3] at camera coordinates [N], clamped as in gsplat (project.glsl)."""
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    margin_x, margin_y = 0.3 * 0.5 * camera.width / fx, 0.3 * 0.5 * camera.height / fy
    tx = np.clip(x / z, -cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    ty = np.clip(y / z, -cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    zero = np.zeros_like(z)
    return np.stack([np.stack([fx / z, zero, -fx * tx / z], -1), np.stack([zero, fy / z, -fy * ty / z], -1)], -2)


def dilated_covariances(T: F64, eps2d: float) -> tuple[F64, F64, F64, F64, F64]:
    """Return dilated a, b, c and the determinants before and after, of Sigma2D = T T^T, T [N, 2, 3] (project.glsl).

    Lagrange: det(T T^T) = |T_0 x T_1|^2, a sum of squares where a c - b^2 would cancel.
    """
    a, b, c = (T[:, 0] ** 2).sum(-1), (T[:, 0] * T[:, 1]).sum(-1), (T[:, 1] ** 2).sum(-1)
    det = (np.cross(T[:, 0], T[:, 1]) ** 2).sum(-1)
    return a + eps2d, b, c + eps2d, det, det + eps2d * (a + c) + eps2d**2


def project(
    posed: Posed,
    splats: Splats,
    camera: Camera,
    config: RenderConfig | None = None,
    antialias: NDArray[np.bool_] | None = None,  # [N] of a scene whose items differ; default: the splats' own flag
    light: Light | None = None,
) -> Projected:
    """Return the splats in one view: EWA projection, culling, colour (project.glsl, extent.glsl, sh.glsl)."""
    config = config or RenderConfig()
    asked = splats.antialias if antialias is None else antialias
    with np.errstate(all="ignore"):
        R, t = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
        x, y, z = (posed.means @ R.T + t).T
        fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
        width, height = camera.width, camera.height
        a, b, c, det, dilated = dilated_covariances(jacobians(x, y, z, camera) @ R @ posed.shapes, config.debug.eps2d)

        alphas = np.minimum(splats.opacities.astype(np.float64), 1.0)
        compensation = np.sqrt(np.maximum(det / dilated, AA_FLOOR))
        alphas = alphas * np.where(asked if config.antialias is None else config.antialias, compensation, 1.0)
        extents = np.minimum(config.max_sigma, np.sqrt(2 * np.log(alphas / ALPHA_MIN)))
        means2d = np.stack([fx * x / z + cx, fy * y / z + cy], -1)
        reach_x, reach_y = extents * np.sqrt(a), extents * np.sqrt(c)
        drawn = splats.finite() & (np.abs(splats.quats).max(-1, initial=0) > 0)
        drawn &= (z > camera.near) & (z < camera.far) & (alphas >= ALPHA_MIN)
        drawn &= (dilated > 0) & np.isfinite(dilated) & np.isfinite(means2d).all(-1)
        drawn &= (means2d[:, 0] + reach_x > 0) & (means2d[:, 0] - reach_x < width)
        drawn &= (means2d[:, 1] + reach_y > 0) & (means2d[:, 1] - reach_y < height)

        view_direction = posed.means - camera.position
        view_direction /= np.linalg.norm(view_direction, axis=1, keepdims=True)
        direction = np.einsum("nji,nj->ni", posed.rotations, view_direction)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        degree = min(splats.sh_degree, camera.sh_degree, config.sh_degree)
        colours = evaluate_sh(splats.sh.astype(np.float64), np.nan_to_num(direction), degree)
        if light is not None and splats.surface is not None:
            colours = lit(colours, shading(posed, splats, light))
    return Projected(means2d, np.stack([a, b, c], -1), z, alphas, np.where(drawn, extents, 0.0), colours)


def depth_order(means: F64, viewmat: F64) -> NDArray[np.intp]:
    """Return indices [N] far to near by camera z as float32; at equal depth the lower index is nearer (sort.py)."""
    with np.errstate(all="ignore"):
        depths = (means @ viewmat[2, :3] + viewmat[2, 3]).astype(np.float32)
    return np.argsort(np.nan_to_num(depths, nan=np.inf), kind="stable")[::-1]


def composite(view: Projected, order: NDArray[np.intp], camera: Camera, mesh: MeshLayer | None = None) -> F64:
    """Return the blended view [H, W, 5]: premultiplied over, far to near, on the background (splat.frag.glsl).

    ``mesh`` hides splats whose mean is behind a mesh. Channel 4 is the sum of weight times z.
    """
    image = np.zeros((camera.height, camera.width, 5))
    image[..., :3] = camera.background
    if mesh is not None:
        hit = np.isfinite(mesh.z)
        image[hit] = np.concatenate([mesh.colours[hit], np.ones((hit.sum(), 1)), mesh.z[hit][:, None]], axis=1)
    for i in order[view.visible[order]]:
        a, b, c = view.covars2d[i]
        det = a * c - b * b
        (mx, my), k = view.means2d[i], view.extents[i]
        rx, ry = k * np.sqrt(a) + 1, k * np.sqrt(c) + 1
        x0, x1 = int(np.clip(np.floor(mx - rx), 0, camera.width)), int(np.clip(np.ceil(mx + rx), 0, camera.width))
        y0, y1 = int(np.clip(np.floor(my - ry), 0, camera.height)), int(np.clip(np.ceil(my + ry), 0, camera.height))
        if x0 >= x1 or y0 >= y1:
            continue
        dx = np.arange(x0, x1) + 0.5 - mx
        dy = (np.arange(y0, y1) + 0.5 - my)[:, None]
        distance2 = np.maximum((c * dx * dx - 2 * b * dx * dy + a * dy * dy) / det, 0)
        alpha = np.minimum(ALPHA_MAX, view.alphas[i] * np.exp(-0.5 * distance2))
        alpha[(alpha < ALPHA_MIN) | (distance2 > k * k * (1 + 1e-9))] = 0
        if mesh is not None:
            alpha[view.depths[i] > mesh.z[y0:y1, x0:x1]] = 0
        patch = image[y0:y1, x0:x1]
        patch *= 1 - alpha[..., None]
        patch[..., :3] += alpha[..., None] * view.colours[i]
        patch[..., 3] += alpha
        patch[..., 4] += alpha * view.depths[i]
    return image


def render(
    splats: Splats,
    cameras: Sequence[Camera],
    binding: Skin | None = None,
    bones: F64 | None = None,  # [J, 3, 4]
    config: RenderConfig | None = None,
    shapes: Shapes | None = None,
    expression: F64 | None = None,  # [T] weights of the shapes
    light: Light | None = None,
) -> F64:
    """Return the frame [V, H, W, 4]: RGB over the background (unclipped) and accumulated alpha, rows top down."""
    config = config or RenderConfig()
    posed = rest(splats)
    if binding is not None and bones is not None:
        posed = skin(splats, binding, bones, config.debug.rotation, shapes, expression)
    return _layers(posed, splats, cameras, config, light)[..., :4]


def render_scene(
    parts: Sequence[tuple[Posed, Splats]],  # the items in their order, posed and placed
    cameras: Sequence[Camera],
    meshes: Sequence[MeshLayer] | None = None,  # one a camera
    config: RenderConfig | None = None,
    light: Light | None = None,
) -> tuple[F64, F64]:
    """Return images [V, H, W, 4] of several items, and expected depths [V, H, W] in metres, 0 where alpha is 0."""
    config = config or RenderConfig()
    posed, splats, antialias = joined(parts)
    image = _layers(posed, splats, cameras, config, light, antialias, meshes)
    alpha = image[..., 3]
    return image[..., :4], np.divide(image[..., 4], alpha, out=np.zeros_like(alpha), where=alpha > 0)


def _layers(
    posed: Posed,
    splats: Splats,
    cameras: Sequence[Camera],
    config: RenderConfig,
    light: Light | None,
    antialias: NDArray[np.bool_] | None = None,
    meshes: Sequence[MeshLayer] | None = None,
) -> F64:
    """Return all views [V, H, W, 5] of ``composite``; the views of a pass share a depth order (camera.passes_of)."""
    layers = []
    for indices in passes_of(cameras, config.debug.order == "shared"):
        order = depth_order(posed.means, sorting_camera([cameras[i] for i in indices]))
        for i in indices:
            view = project(posed, splats, cameras[i], config, antialias, light)
            layers.append(composite(view, order, cameras[i], meshes[i] if meshes else None))
    return np.stack(layers)


def _davenport(m: F64) -> F64:
    """Return Q [N, 4, 4] of m [N, 3, 3]: q^T Q q = trace(R(q)^T m) for unit q = wxyz (skin.glsl)."""
    m00, m01, m02 = m[:, 0, 0], m[:, 0, 1], m[:, 0, 2]
    m10, m11, m12 = m[:, 1, 0], m[:, 1, 1], m[:, 1, 2]
    m20, m21, m22 = m[:, 2, 0], m[:, 2, 1], m[:, 2, 2]
    wx, wy, wz = m21 - m12, m02 - m20, m10 - m01
    xy, xz, yz = m01 + m10, m02 + m20, m12 + m21
    rows = (
        (m00 + m11 + m22, wx, wy, wz),
        (wx, m00 - m11 - m22, xy, xz),
        (wy, xy, m11 - m00 - m22, yz),
        (wz, xz, yz, m22 - m00 - m11),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _dominant_column(matrix: F64) -> F64:
    """Return the column [N, 4] with the largest diagonal entry, at unit length (rank one: the eigenvector)."""
    index = np.argmax(np.diagonal(matrix, axis1=1, axis2=2), axis=1)
    column = matrix[np.arange(len(matrix)), :, index]
    return column / np.maximum(np.linalg.norm(column, axis=1, keepdims=True), 1e-300)
