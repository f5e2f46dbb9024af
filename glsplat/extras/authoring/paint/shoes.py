"""Choose a pair of shoes like those in the picture, and paint it: with its pixels, and elsewhere in its colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.dress.shoes import feet_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.picture_layers.fill import disc
from glsplat.extras.authoring.paint.picture_layers.layers import rasterize
from glsplat.extras.authoring.paint.ramps import ramp, smoothstep
from glsplat.extras.authoring.paint.skin_tone import face_colour, lab, likeness
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.pictures import to_linear, to_srgb
from glsplat.rotations import component_sums, lengths
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_MIN_VISIBILITY = 0.3
_MIN_FOOT_VERTICES = 60  # visible, of both feet
_BARE_FRACTION, _SHOD_FRACTION = 0.75, 0.5  # of the visible feet that is skin: at least, and at most
# heights in metres above the sole
_SOLE_TOP_M, _UPPER_M, _ANKLE_M, _KNEE_M, _RIM_M = 0.022, (0.04, 0.09), (0.12, 0.17), (0.3, 0.45), 0.06
# differences in CIELAB
_SAME_COLOUR, _OTHER_COLOUR = 13.0, 18.0
_LIGHT_UPPER, _LIGHTER_SOLE, _COLOURED_UPPER, _DARK_UPPER = 62.0, 25.0, 30.0, 18.0
_PATTERNED, _PATTERNED_UPPER = 30.0, 25.0  # range of lightness of trainers with a pattern, and their median
_LEATHER_HUES_DEG = 20.0, 80.0
_SHADE_QUANTILES = 0.1, 0.9
_PICTURE_PX = 900  # height of the picture in which occlusion is tested
_DEPTH_TOLERANCE_M = 0.012
_VISIBILITY_COSINES = 0.12, 0.42
_EDGE_FRACTION = 0.0015  # of the person's height: what the mask takes for a sole may be the floor
_GAP_FRACTIONS = 0.025, 0.06  # of the height: rows of the mask below a fitted shoe
_SITES = 30_000  # points at which the template's texture is read
_MAX_SEEN = 700
_NEAR_M, _ROW_M, _LENGTH_M = 0.015, 0.012, 0.05  # standard deviations of colours around a point, and on the other side
_ROW_WEIGHT, _USUAL_WEIGHT = 0.03, 0.01  # of colours of the same height and length, and of the usual one
_TONES, _TONE_SHARPNESS = 4, 3
_CONTRAST_RANGE = 0.2, 1.0  # of the template's seams, over those in its texture
_FLOOR_DISTANCE, _MAX_FLOOR = 0.1, 0.1  # from the background, square roots of linear light; fraction of seen shoes
_FULL_SEAM, _SEAM_DETAIL = 0.3, 0.6  # of the logarithm of brightness; detail of such seams where no picture looks


class Footwear(NamedTuple):
    """What the feet wear."""

    kind: str  # low shoe, boot, sneaker, sandal, bare or hidden
    template: str | None  # of the library; None: the feet stay as they are


def footwear_of(body: Body, shot: FittedPicture) -> Footwear:
    """Return what the feet in the front picture ``shot`` wear, by colours of skin, sole, upper, ankle and knee."""
    room = Lamp(np.array([0.0, 0.0, -1.0]), shot.view.root[:, 1], 0.0)
    height, skin = shot.mesh.vertices[:, 1], face_colour(body, shot, room)
    linear = np.zeros_like(shot.mesh.vertices)
    visible = body.skin & (shot.visibility > _MIN_VISIBILITY)
    linear[visible] = shot.sample(shot.view.pixels[visible], shot.layer[visible])
    feet = visible & (feet_vertices(body, "left") | feet_vertices(body, "right")) & (height < _UPPER_M[1])
    if skin is None or feet.sum() < _MIN_FOOT_VERTICES:
        return Footwear("hidden", None)
    legs = visible & np.isin(
        body.part, [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in ("ankle", "knee")]
    )

    def colour(some: NDArray[np.bool_], span: tuple[float, float]) -> F64 | None:
        rows = some & (height > span[0]) & (height < span[1])
        return None if rows.sum() < 8 else np.asarray(np.median(linear[rows], axis=0))

    upper, sole = colour(feet, _UPPER_M), colour(feet, (-1.0, _SOLE_TOP_M))
    shades = lab(linear[feet & (height > _UPPER_M[0])])[:, 0]
    ankle, knee = colour(legs, _ANKLE_M), colour(legs, _KNEE_M)
    bare = likeness(linear[feet], skin[None]) > 0.5
    if ankle is not None and likeness(ankle[None], skin[None])[0] > 0.5:  # what is like bare ankles is bare
        bare |= likeness(linear[feet], ankle[None]) > 0.5
    share = float(bare.mean())
    if share > _SHOD_FRACTION or upper is None:
        return Footwear("bare" if share > _BARE_FRACTION else "sandal", None)
    upper, sole, ankle, knee = (None if one is None else lab(one[None])[0] for one in (upper, sole, ankle, knee))
    assert upper is not None
    chroma, hue = float(np.hypot(*upper[1:])), float(np.degrees(np.arctan2(upper[2], upper[1])))
    leather = _LEATHER_HUES_DEG[0] < hue < _LEATHER_HUES_DEG[1]
    lighter = 0.0 if sole is None else float(sole[0] - upper[0])
    if ankle is not None and knee is not None:
        shaft = np.linalg.norm(ankle - upper) < _SAME_COLOUR and np.linalg.norm(ankle - knee) > _OTHER_COLOUR
        if shaft:
            return Footwear("boot", "shoes01")
    patterned = upper[0] > _PATTERNED_UPPER and float(np.ptp(np.quantile(shades, _SHADE_QUANTILES))) > _PATTERNED
    coloured = chroma > _COLOURED_UPPER and not leather
    if upper[0] > _LIGHT_UPPER or lighter > _LIGHTER_SOLE or coloured or patterned:
        return Footwear("sneaker", "shoes02")
    return Footwear("low shoe", "shoes03" if upper[0] < _DARK_UPPER else "shoes01")


@dataclass(frozen=True, eq=False)
class ShoePainter:
    """Colours of points on the shoes of a mesh; ``shoe_painter`` makes one."""

    shot: FittedPicture
    light: Lamp
    where: F64  # [V, 3] vertices of body and shoes in the camera's axes
    normals: F64  # [V, 3]
    depth: NDArray[np.float32]  # [h, w] metres to the nearest leg or shoe, in a smaller picture
    inner: NDArray[np.bool_]  # [H, W] the person without its edge
    rest: F64  # [V, 3] metres, in the zero pose
    colour: F64  # [V, 3] linear, unlit
    lower: F64  # [V] pixels by which the picture shows shoes below the fitted ones, as of heels
    seams: tuple[cKDTree, F64]  # points of the shoes at rest, and the factors [K] of their brightness
    usual: F64  # [3] median colour, square roots of linear light; NaN where the picture's floor is not told apart

    def paint(self, points: SurfacePoints) -> tuple[F64, F64, F64]:
        """Return [M, 3] sRGB colours, [M] visibility and [M] detail of points on the shoes."""
        linear, visibility, shade = self.sample(points)
        tree, factor = self.seams
        seams = factor[tree.query(points.at(self.rest))[1]]
        guess = points.at(self.colour) * (seams * shade)[:, None]
        rgb = to_srgb(guess + visibility[:, None] * (linear - guess))
        detail = self.shot.detail(self.shot.project(points.at(self.where)))
        guessed = _SEAM_DETAIL * ramp(np.abs(np.log(seams)), 0.0, _FULL_SEAM)
        return rgb, visibility, guessed + visibility * (detail - guessed)

    def sample(self, points: SurfacePoints) -> tuple[F64, F64, F64]:
        """Return [M, 3] the picture's linear colours, [M] the points' visibility, and [M] their light."""
        where, normals = points.at(self.where), points.directions(self.normals)
        pixels = self.shot.project(where)
        facing = -component_sums(normals * where) / lengths(where)
        near = where[:, 2] < _pixel(self.depth, pixels, self.depth.shape[0] / self.inner.shape[0]) + _DEPTH_TOLERANCE_M
        pixels[:, 1] += points.at(self.lower[:, None])[:, 0]
        visibility = smoothstep(facing, *_VISIBILITY_COSINES) * near * _pixel(self.inner, pixels, 1.0)
        linear = self.shot.sample(pixels)
        visibility *= ~self.floor(points, pixels, linear)
        return linear, visibility, self.light.shade(normals)

    def floor(self, points: SurfacePoints, pixels: F64, linear: F64) -> NDArray[np.bool_]:
        """Return [M] which points above the sole have the background's colour rather than the shoes' usual one."""
        look = np.sqrt(np.maximum(linear, 0))
        away = lengths(look - np.sqrt(self.shot.background(pixels)))
        other = (away < _FLOOR_DISTANCE) & (away < lengths(look - self.usual) / 2)
        return np.asarray(other & (points.at(self.rest)[:, 1] > _SOLE_TOP_M))


def shoe_painter(body: Body, shot: FittedPicture, light: Lamp, mesh: RiggedMesh) -> ShoePainter:
    """Return the painter of the last part of ``mesh``, its shoes, as ``shot``, the front, shows them in ``light``."""
    view, shoes = shot.view, mesh.parts[-1]
    where = (mesh.posed(Pose(view.rotations)) - mesh.skeleton.joints[0]) @ view.root.T + view.pelvis
    where[: len(view.vertices)] = view.vertices
    legs = np.isin(body.part, [JOINT_NAMES.index(f"{s}_{n}") for s in ("left", "right") for n in ("hip", "knee")])
    cover = np.concatenate([shoes.faces, body.faces[legs[body.faces].all(axis=1)]])
    scale = min(1.0, _PICTURE_PX / shot.mask.shape[0])
    ids, bary = rasterize(mesh, where, shot.focal, shot.mask.shape, cover, scale)
    depth = np.full(ids.shape, np.inf, np.float32)
    depth[ids >= 0] = component_sums(bary[ids >= 0] * where[cover[ids[ids >= 0]], 2])
    edge = disc(max(2, round(_EDGE_FRACTION * shot.picture_layers.height)))
    inner = cv2.erode(shot.mask.astype(np.uint8), edge) > 0
    nothing = np.zeros((len(mesh.vertices), 3))
    normals = vertex_normals(where, mesh.faces)
    sites, uv = _sites_of(mesh)
    rest = mesh.vertices
    lower = _gaps_below(shot, shot.project(where), rest, len(view.vertices))
    seams = cKDTree(rest[:1]), np.ones(1)
    unknown = np.full(3, np.nan)
    painter = ShoePainter(shot, light, where, normals, depth, inner, rest, nothing, lower, seams, unknown)
    linear, visibility, shade = painter.sample(sites)
    if (visibility > 0.5).any():
        told = replace(painter, usual=np.median(np.sqrt(np.maximum(linear[visibility > 0.5], 0)), axis=0))
        without = told.sample(sites)[1]
        if (without > 0.5).sum() > (1 - _MAX_FLOOR) * (visibility > 0.5).sum():  # more is a part of the shoes
            painter, visibility = told, without
    plain, place = linear / shade[:, None], sites.at(rest)
    log = np.log(to_linear(shoes.sample(uv)[:, :3]) @ (0.2126, 0.7152, 0.0722) + 0.004)
    sure = (visibility > 0.5) & (place[:, 1] < _RIM_M)
    colour, smooth = nothing.copy(), np.zeros(len(rest))
    own = np.arange(len(view.vertices), len(rest))
    for sole in (True, False):
        mine, of = own[(rest[own, 1] < _SOLE_TOP_M) == sole], (place[:, 1] < _SOLE_TOP_M) == sole
        known = sure & of if (sure & of).sum() > _TONES**2 else sure
        if known.sum() > _TONES**2:
            colour[mine] = _toned(rest[mine], place[known], plain[known])
        weight, some = _nearness(rest[mine], place[of])
        smooth[mine] = weight @ log[of][some] / np.maximum(weight.sum(axis=1), 1e-9)
    seam = log - sites.at(smooth[:, None])[:, 0]
    seen = np.log((plain[sure].sum(axis=1) + 0.01) / (sites.at(colour)[sure].sum(axis=1) + 0.01))
    contrast = np.clip(_spread(seen) / max(_spread(seam), 1e-3), *_CONTRAST_RANGE)
    return replace(painter, colour=colour, seams=(cKDTree(place), np.exp(contrast * seam).clip(0.4, 1.8)))


def _spread(values: F64) -> float:
    """Return the median distance of values from their median: a few laces in other colours do not count."""
    return float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _gaps_below(shot: FittedPicture, pixels: F64, rest: F64, first: int) -> F64:
    """Return [V] rows by which the mask reaches below each shoe, 0 at its top; their vertices begin at ``first``."""
    lower, height = np.zeros(len(rest)), shot.picture_layers.height
    for sign in (1.0, -1.0):
        mine = first + np.flatnonzero(sign * rest[first:, 0] > 0)
        (left, top), (right, bottom) = pixels[mine].min(axis=0), pixels[mine].max(axis=0)
        columns = shot.mask[:, max(int(left), 0) : int(right) + 1].any(axis=1)
        gap = float(np.flatnonzero(columns).max(initial=0)) - bottom
        if _GAP_FRACTIONS[0] * height < gap < _GAP_FRACTIONS[1] * height:
            lower[mine] = gap * (pixels[mine, 1] - top) / (bottom - top)
    return lower


def _sites_of(mesh: RiggedMesh) -> tuple[SurfacePoints, F64]:
    """Return points spread evenly over the shoes, and their texture coordinates [K, 2]."""
    shoes, rng = mesh.parts[-1], np.random.default_rng(0)
    total = np.cumsum(triangle_areas(mesh.vertices, shoes.faces))
    face = np.searchsorted(total, (np.arange(_SITES) + 0.5) / _SITES * total[-1])
    edge, along = np.sqrt(rng.random(_SITES)), rng.random(_SITES)
    bary = np.stack([1 - edge, edge * (1 - along), edge * along], axis=1)
    return SurfacePoints(shoes.faces[face].astype(np.intp), bary), np.einsum("nk,nkc->nc", bary, shoes.uv[face])


def _toned(places: F64, known: F64, plain: F64) -> F64:
    """Return [M, 3] for each of ``places`` [M, 3] the tone that most points near it have, with soft edges.

    ``known`` [K, 3] are the places of ``plain`` [K, 3], linear colours. Tones stay apart: a mean of them is none.
    """
    weight, some = _nearness(places, known)
    look = np.sqrt(np.maximum(plain[some], 0))
    label = kmeans2(look, look[np.linspace(0, len(look) - 1, _TONES).astype(np.intp)], minit="matrix")[1]
    tones = [label == tone for tone in range(_TONES) if (label == tone).any()]
    share = np.stack([weight[:, mine].sum(axis=1) + _USUAL_WEIGHT * mine.mean() for mine in tones], axis=1)
    share = (share / share.max(axis=1, keepdims=True)) ** _TONE_SHARPNESS
    colours = np.stack([np.median(plain[some][mine], axis=0) for mine in tones])
    return np.asarray(share @ colours / share.sum(axis=1, keepdims=True))


def _nearness(places: F64, known: F64) -> tuple[F64, NDArray[np.intp]]:
    """Return weights [M, K] of ``some`` [K] of the ``known`` points for ``places`` [M, 3], and ``some``.

    Right shoes count as left ones; points of the same height and length on the other side count a little.
    """
    some = np.linspace(0, len(known) - 1, min(_MAX_SEEN, len(known))).astype(np.intp)
    mirrored = [np.concatenate([np.abs(part[:, :1]), part[:, 1:]], axis=1) for part in (places, known[some])]
    apart = np.stack([np.subtract.outer(mirrored[0][:, k], mirrored[1][:, k]) ** 2 for k in range(3)])
    near = np.exp(-apart.sum(axis=0) / (2 * _NEAR_M**2))
    return near + _ROW_WEIGHT * np.exp(-(apart[1] / _ROW_M**2 + apart[2] / _LENGTH_M**2) / 2), some


def _pixel(picture: NDArray[Any], pixels: F64, scale: float) -> NDArray[Any]:
    """Return [M] the nearest pixel's value in a picture scaled by ``scale``."""
    at = np.floor(pixels * scale).astype(np.intp)
    return picture[at[:, 1].clip(0, picture.shape[0] - 1), at[:, 0].clip(0, picture.shape[1] - 1)]
