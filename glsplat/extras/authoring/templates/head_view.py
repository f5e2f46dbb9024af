"""The head of a fitted body in the front picture: its place, the bare skull, and metres in the picture's plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.compute.threads import locked_cached_property
from glsplat.extras.authoring.fit.body_fit import BodyFit
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.paint.picture_layers.layers import rasterize
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.rotations import nearest_rotations
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_DEPTH_HEIGHT_PX = 900  # of the picture with the body's depth
_EYE_ROW_M = 0.02  # above and below the eyes: where the head's width is measured


@dataclass(frozen=True, eq=False)
class HeadView:
    """The head in a picture. Heights and widths are metres in the picture's plane from the bare head's middle."""

    body: Body
    shot: FittedPicture
    skull: NDArray[np.bool_]  # [V] vertices of head and jaw
    bare: F64  # [V, 3] the body without clothes and hair, in the zero pose, on the dressed mesh's floor
    rotation: F64  # [3, 3] from the zero pose to the camera's axes
    offset: F64  # [3]
    depth: NDArray[np.float32]  # camera z of the body with a bare head, infinite beside it

    @locked_cached_property
    def middle(self) -> F64:
        """[3] of the bare head in the zero pose."""
        return np.asarray(self.bare[self.skull].mean(axis=0))

    @property
    def camera_z(self) -> float:
        """Distance of the head's middle from the camera, metres."""
        return float(self.camera(self.middle[None])[0, 2])

    @property
    def scale(self) -> float:
        """Pixels a metre at the head."""
        return self.shot.focal / self.camera_z

    @property
    def up(self) -> F64:
        """Unit vector [2] from the head's middle upwards in the picture, x to the right and y down."""
        return np.asarray(self.rotation[:2, 1] / np.linalg.norm(self.rotation[:2, 1]))

    @locked_cached_property
    def sizes(self) -> HeadSizes:
        """Heights and width of the bare head."""
        flat, eyes = self.plane_of(self.bare[self.skull]), self.bare[_eyeballs(self.body)]
        eye_height = float(np.median(self.plane_of(eyes)[:, 1]))
        row = np.abs(flat[:, 1] - eye_height) < _EYE_ROW_M
        half_width = float(np.abs(flat[row, 0]).max())
        return HeadSizes(flat[:, 1].max(), flat[:, 1].min(), eye_height, half_width, float(eyes[:, 1].mean()))

    def camera(self, rest: F64) -> F64:
        """Return points [M, 3] of the zero pose, carried by the head, in the camera's axes."""
        return rest @ self.rotation.T + self.offset

    def rest(self, camera: F64) -> F64:
        """Return points [M, 3] in the camera's axes in the zero pose."""
        return (camera - self.offset) @ self.rotation

    def plane(self, pixels: F64) -> F64:
        """Return metres [..., 2] aside and up in the picture's plane, of pixels [..., 2]."""
        up = self.up
        away = (pixels - self.shot.project(self.camera(self.middle[None]))[0]) / self.scale
        return np.stack([away @ np.array([-up[1], up[0]]), away @ up], axis=-1)

    def plane_of(self, rest: F64) -> F64:
        """Return metres [M, 2] in the picture's plane, of points [M, 3] of the zero pose."""
        return self.plane(self.shot.project(self.camera(rest)))

    def body_z(self, pixels: F64) -> NDArray[np.float32]:
        """Return [M] the camera z of the body with a bare head at pixels [M, 2]; infinite beside it."""
        return value_at(self.depth, pixels, self.depth.shape[0] / self.shot.mask.shape[0])


class HeadSizes(NamedTuple):
    """Heights and width of a bare head in the picture's plane, metres from its middle."""

    top: float
    chin: float
    eyes: float
    half_width: float  # at the eyes
    eyes_rest: float  # height of the eyes in the zero pose, above the floor


def head_view(body: Body, fit: BodyFit, shot: FittedPicture) -> HeadView:
    """Return the head of the fitted body in the front picture."""
    view, mesh = shot.view, shot.mesh
    dressed = fit.rest - (fit.joints[0] - mesh.skeleton.joints[0])
    bare = dressed - fit.offsets[:, None] * offset_directions(body, body.shaped(fit.betas)[0])
    skull = body.skin & np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "jaw")])
    rest, there = mesh.vertices[skull], view.vertices[skull]
    rotation = nearest_rotations(((there - there.mean(axis=0)).T @ (rest - rest.mean(axis=0)))[None])[0]
    offset = there.mean(axis=0) - rotation @ rest.mean(axis=0)
    vertices = view.vertices.copy()
    vertices[skull] = bare[skull] @ rotation.T + offset
    scale = min(1.0, _DEPTH_HEIGHT_PX / shot.mask.shape[0])
    ids, share = rasterize(mesh, vertices, shot.focal, shot.mask.shape, mesh.faces, scale)
    depth = np.full(ids.shape, np.inf, np.float32)
    hit = ids >= 0
    depth[hit] = (share[hit] * vertices[mesh.faces[ids[hit]], 2]).sum(axis=1)
    return HeadView(body, shot, skull, bare, rotation, offset, depth)


def _eyeballs(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of the eyeballs."""
    return np.isin(body.part, [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]) & ~body.skin


def value_at(picture: NDArray[Any], pixels: F64, scale: float = 1.0) -> NDArray[Any]:
    """Return [M] the nearest values of ``picture`` [H, W] at pixels [M, 2] times ``scale``, clamped to its edge."""
    height, width = picture.shape[:2]
    at = np.floor(pixels * scale).astype(np.intp)
    return picture[at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)]
