"""Sheet of an avatar from photographs: outline, landmarks, fitted body, visible surface, result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.check.photos import CheckedPhoto
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.extras.authoring.paint.texels import texels_of
from glsplat.extras.authoring.reconstruct.reconstructor import FittedBody
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0

from ..output import label, stack

Image = NDArray[np.uint8]

_CELL_PX = 480, 720  # width and height
_FOV_DEG = 32.0  # vertical field of view of a phone
_A_POSE = {
    "left_shoulder": (0, 0, -0.7),
    "right_shoulder": (0, 0, 0.7),
    "left_elbow": (0, -0.12, 0),
    "right_elbow": (0, 0.12, 0),
    "left_hip": (0, 0, 0.09),
    "right_hip": (0, 0, -0.09),
}  # axis-angle in radians: arms about 40 degrees below the horizontal, feet a little apart
_OUTLINE, _WRONG = (0, 255, 120), (255, 70, 70)  # RGB
_LEFT, _RIGHT, _FACE, _TRUNK = (255, 170, 0), (0, 190, 255), (255, 255, 0), (255, 255, 255)
_GUESSED = (235, 120, 60)
_SIDE_COLOURS = {"front": (70, 190, 90), "back": (80, 130, 230), "left": (220, 200, 60), "right": (170, 90, 210)}
_SIDE_NAMES = {"front": "green", "back": "blue", "left": "yellow", "right": "violet"}
_MIN_COSINE = 0.15  # to the camera, of a visible surface
_DEPTH_TOLERANCE_M = 0.015
_LIMBS = (
    "shoulder elbow", "elbow wrist", "shoulder hip", "hip knee", "knee ankle", "ankle heel", "heel foot_index"
)  # fmt: skip
_FINGERS = [[0, *range(first, first + 4)] for first in (1, 5, 9, 13, 17)]


def draw(
    shots: Mapping[str, CheckedPhoto], avatar: Avatar | RiggedMesh | None = None, made: FittedBody | None = None
) -> Image:
    """Return RGB uint8 [H, W, 3]: a row per picture, then the visible surface and the result, if there are any."""
    rows = []
    for index, shot in enumerate(shots.values()):
        cells = [_outline(shot), _landmarks(shot)]
        if made is not None:
            cells.append(_fitted(shot, made.fit.views[index]))
        if shot.capture.person is not None:
            cells.append(_details(shot))
        rows.append(cells)
    if made is not None and avatar is not None:
        words = ", ".join(f"{side} {_SIDE_NAMES[side]}" for side in shots)
        rows.append(_four_sides(_visible_surface(avatar, made, list(shots)), f"{words}, guessed orange"))
    if avatar is not None:
        rows.append(_four_sides(avatar, "the avatar"))
    return stack(rows)


class _Frame:
    """Crop of a picture around the person, shown in one cell."""

    def __init__(self, shot: CheckedPhoto) -> None:
        picture, mask = shot.photo.picture, shot.capture.mask
        shown = mask if mask.any() else np.ones(picture.shape[:2], bool)
        rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
        high, wide = 1.1 * (rows[-1] - rows[0] + 1), 1.1 * (columns[-1] - columns[0] + 1)
        self.scale = min(_CELL_PX[1] / high, _CELL_PX[0] / wide)
        self.shift = np.array(_CELL_PX) / 2 - self.scale * np.array([columns[0] + columns[-1], rows[0] + rows[-1]]) / 2
        self.picture = self._moved(picture)
        self.mask = self._moved(mask.astype(np.uint8) * 255) > 127 if mask.size else np.zeros(_CELL_PX[::-1], bool)

    def _moved(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        matrix = np.array([[self.scale, 0, self.shift[0]], [0, self.scale, self.shift[1]]])
        if self.scale < 1:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.4 / self.scale), np.uint8)
        return np.asarray(cv2.warpAffine(picture, matrix, _CELL_PX, borderValue=(40, 40, 40)), np.uint8)

    def points(self, points: F64) -> F64:
        """Return pixels [N, 2] of the picture as pixels of the cell."""
        return np.asarray(points[:, :2] * self.scale + self.shift)


def _outline(shot: CheckedPhoto) -> Image:
    frame = _Frame(shot)
    shown = frame.picture.copy()
    if frame.mask.any():
        shown[~frame.mask] //= 2
    contours, _ = cv2.findContours(frame.mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(shown, contours, -1, _OUTLINE, 2, cv2.LINE_AA)
    found = [finding.code for finding in shot.capture.findings]
    shown = _titled(shown, f"{shot.side}: {', '.join(found) or 'nothing wrong found'}")
    if shot.capture.refused:
        cv2.rectangle(shown, (0, 0), (_CELL_PX[0] - 1, _CELL_PX[1] - 1), _WRONG, 4)
    return shown


def _landmarks(shot: CheckedPhoto) -> Image:
    frame, person = _Frame(shot), shot.capture.person
    shown = (frame.picture // 2).astype(np.uint8)
    if person is None:
        return _titled(shown, "no landmarks")
    where = dict(zip(LANDMARKS, frame.points(person.body.points), strict=True))
    sure = dict(zip(LANDMARKS, person.body.visible, strict=True))
    for part in ("shoulder", "hip"):
        _line(shown, [where[f"left_{part}"], where[f"right_{part}"]], _TRUNK)
    for side, ink in (("left", _LEFT), ("right", _RIGHT)):
        for limb in _LIMBS:
            _line(shown, [where[f"{side}_{end}"] for end in limb.split()], ink)
    for name, point in where.items():
        ink = _LEFT if "left" in name else _RIGHT if "right" in name else _TRUNK
        cv2.circle(shown, _at(point), 4, ink, -1 if sure[name] > 0.5 else 1, cv2.LINE_AA)  # hollow: uncertain
    for hand, ink in ((person.left_hand, _LEFT), (person.right_hand, _RIGHT)):
        if hand.presence > 0.5:
            _hand(shown, frame.points(hand.points), ink)
    if person.face.presence > 0.5:
        for point in frame.points(person.face.points):
            shown[tuple(np.clip(_at(point), 0, np.array(_CELL_PX) - 1)[::-1])] = _FACE
    return _titled(shown, "landmarks (hollow: uncertain)")


def _details(shot: CheckedPhoto) -> Image:
    """Return the face above both hands, as cropped for the networks."""
    person = shot.capture.person
    assert person is not None
    cell = np.full((*_CELL_PX[::-1], 3), 40, np.uint8)
    side = _CELL_PX[0]
    top = _cut(shot, person.face.points, side)
    cell[:side] = _titled(top, f"face: {person.face.presence:.2f}")
    half = _CELL_PX[0] // 2
    # as the picture shows them: the person's right hand stands left in a picture from the front
    hands = sorted(
        ((person.left_hand, _LEFT, "left"), (person.right_hand, _RIGHT, "right")),
        key=lambda entry: float(entry[0].points[:, 0].mean()),
    )
    for column, (hand, ink, name) in enumerate(hands):
        cut = _cut(shot, hand.points, half, ink)
        cell[side : side + half, column * half : (column + 1) * half] = _titled(cut, f"{name}: {hand.presence:.2f}")
    return cell


def _cut(shot: CheckedPhoto, points: F64, side: int, ink: tuple[int, int, int] | None = None) -> Image:
    """Return a square crop around the points, with the points drawn; with ``ink`` as a hand."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    size = max(1.3 * float((high - low).max()), 4.0)
    scale, middle = side / size, (low + high) / 2
    shift = side / 2 - scale * middle
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    shown = np.asarray(cv2.warpAffine(shot.photo.picture, matrix, (side, side), borderValue=(40, 40, 40)), np.uint8)
    here = points[:, :2] * scale + shift
    if ink is not None:
        _hand(shown, here, ink)
    else:
        for point in here:
            cv2.circle(shown, _at(point), 1, _FACE, -1, cv2.LINE_AA)
    return shown


def _hand(shown: Image, points: F64, ink: tuple[int, int, int]) -> None:
    for finger in _FINGERS:
        _line(shown, points[finger], ink)


def _titled(shown: Image, text: str) -> Image:
    """Return the picture with text in its upper left corner, readable on any background."""
    shown = np.ascontiguousarray(shown)
    shown[: 26 if len(shown) > 300 else 22] //= 3
    return label(shown, text)


def _line(shown: Image, points: Sequence[F64] | F64, ink: tuple[int, int, int]) -> None:
    cv2.polylines(shown, [np.rint(np.asarray(points)).astype(np.int32)], False, ink, 1, cv2.LINE_AA)


def _at(point: F64) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _fitted(shot: CheckedPhoto, view: FittedView) -> Image:
    frame = _Frame(shot)
    faces = open_body().faces
    light = _shades(view.vertices, faces)
    drawn = _painted(frame.points(view.pixels), view.vertices[:, 2], faces, light[:, None] * (255.0, 235.0, 215.0))
    solid = drawn.any(axis=2)
    shown = frame.picture.copy()
    shown[solid] = (0.45 * shown[solid] + 0.55 * drawn[solid]).astype(np.uint8)
    contours, _ = cv2.findContours(frame.mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(shown, contours, -1, _OUTLINE, 1, cv2.LINE_AA)
    return _titled(shown, f"fit: overlap {view.overlap:.1%}, landmarks {view.landmark_error:.2f} %")


def _shades(vertices: F64, faces: NDArray[np.int32]) -> F64:
    """Return shades [F], 0.35 to 1, of triangles by their angle to the camera; camera axes."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    return np.asarray(0.35 + 0.65 * np.abs(normal[:, 2]) / np.where(length > 0, length, 1))


def _painted(pixels: F64, depth: F64, faces: NDArray[np.int32], colours: F64) -> Image:
    """Return triangles painted in flat colours [F, 3], far to near, on black."""
    drawn = np.zeros((*_CELL_PX[::-1], 3), np.uint8)
    corners = np.rint(pixels[faces] * 16).astype(np.int32)
    for face in np.argsort(-depth[faces].mean(axis=1), kind="stable"):
        cv2.fillConvexPoly(drawn, corners[face], colours[face].tolist(), cv2.LINE_8, 4)
    return drawn


def _visible_surface(avatar: Avatar | RiggedMesh, made: FittedBody, sides: Sequence[str]) -> Avatar | RiggedMesh:
    """Return the avatar tinted by the picture that shows each part of its surface, with its own brightness."""
    colours = np.tile(np.array(_GUESSED, np.float64), (len(made.mesh.vertices), 1)) / 255
    for side, view in reversed(list(zip(sides, made.fit.views, strict=True))):  # the front overrides the rest
        colours[_visible(view, open_body().faces)] = np.array(_SIDE_COLOURS[side]) / 255
    if isinstance(avatar, RiggedMesh):
        return replace(avatar, parts=tuple(_tinted(part, colours) for part in avatar.parts))
    splats = avatar.splats
    tint = colours[cKDTree(made.mesh.vertices).query(splats.means)[1]]
    own = np.clip(splats.sh[:, 0] * SH_C0 + 0.5, 0, 1).mean(axis=1, keepdims=True)
    sh = np.zeros_like(splats.sh)
    sh[:, 0] = (tint * (0.5 + 0.5 * own) - 0.5) / SH_C0
    return replace(avatar, splats=replace(splats, sh=sh))


def _tinted(part: MeshPart, colours: F64) -> MeshPart:
    """Return the mesh with vertex colours [V, 3] blended over its texture."""
    texture = part.texture.copy()
    texels = texels_of(part.uv, texture.shape[1], texture.shape[0])
    tint = SurfacePoints(part.faces[texels.face].astype(np.intp), texels.weights).at(colours)
    shown = texture.reshape(-1, 4)[texels.index, :3].mean(axis=1, keepdims=True)
    texture.reshape(-1, 4)[texels.index, :3] = tint * (127.5 + 0.5 * shown)
    return replace(part, texture=texture)


def _visible(view: FittedView, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return a mask [V] of the vertices that a picture shows, except at grazing angles."""
    low, high = view.pixels.min(axis=0), view.pixels.max(axis=0)
    scale = 1000 / max(float((high - low).max()), 1e-6)
    pixels = (view.pixels - low) * scale + 2
    size = np.ceil((high - low) * scale).astype(int) + 5
    depth = view.vertices[:, 2]
    nearest = np.full((size[1], size[0]), np.inf, np.float32)
    corners = np.rint(pixels[faces] * 16).astype(np.int32)
    for face in np.argsort(-depth[faces].mean(axis=1), kind="stable"):
        cv2.fillConvexPoly(nearest, corners[face], float(depth[faces[face]].mean()), cv2.LINE_8, 4)
    at = np.clip(np.floor(pixels).astype(int), 0, size - 1)
    facing = -(vertex_normals(view.vertices, faces) * view.vertices).sum(axis=1)
    facing /= np.linalg.norm(view.vertices, axis=1)
    return np.asarray((depth <= nearest[at[:, 1], at[:, 0]] + _DEPTH_TOLERANCE_M) & (facing > _MIN_COSINE))


def _four_sides(avatar: Avatar | RiggedMesh, words: str) -> list[Image]:
    rotations = np.zeros((len(avatar.skeleton), 3))
    for joint, bend in _A_POSE.items():
        rotations[avatar.skeleton.names.index(joint)] = bend
    means = avatar.vertices if isinstance(avatar, RiggedMesh) else avatar.splats.means
    low, high = np.percentile(means, (0.1, 99.9), axis=0)
    middle, tall = (low[1] + high[1]) / 2, max(float(high[1] - low[1]), 0.1)
    distance = 1.35 * tall / 2 / np.tan(np.radians(_FOV_DEG) / 2)
    cells = []
    drawn = MeshTruth(avatar, size=_CELL_PX) if isinstance(avatar, RiggedMesh) else Renderer(avatar, size=_CELL_PX)
    with drawn as renderer:
        for name, turn in (("front", 0.0), ("left", 90.0), ("back", 180.0), ("right", -90.0)):
            angle = np.radians(turn)
            eye = (distance * np.sin(angle), middle, distance * np.cos(angle))
            camera = Camera(look_at(eye=eye, target=(0, middle, 0)), pinhole(*_CELL_PX, fov=_FOV_DEG), *_CELL_PX)
            image = renderer.render([camera], Pose(rotations))[0].astype(np.float32)
            shown = image[..., :3] + 96 * (1 - image[..., 3:] / 255)
            cells.append(_titled(np.clip(shown + 0.5, 0, 255).astype(np.uint8), f"{name}: {words}"))
    return cells
