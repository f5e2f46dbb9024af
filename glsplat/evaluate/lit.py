"""A participant's mesh under the light of their capture: what an avatar made of the capture should look like."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from glsplat.camera import Camera, look_at
from glsplat.making.paint.colour import to_linear, to_srgb
from glsplat.making.raster import visible_faces
from glsplat.meshes import RiggedMesh

__all__ = ["lit_picture", "shading"]

SKY, GROUND = np.array([0.52, 0.53, 0.56]), np.array([0.30, 0.28, 0.26])
FAR, SHADOW_SIZE, BIAS = 60.0, 768, 0.012  # metres, pixels, metres


def lit_picture(
    mesh: RiggedMesh, vertices: np.ndarray, camera: Camera, towards: Sequence[float], colour: Sequence[float]
) -> np.ndarray:
    """RGB [H, W, 3] in [0, 1] before black: sky and ground, one far lamp with a soft shadow, no highlights.

    ``towards`` the lamp and its ``colour`` in linear light, as the captures' notes have them; ``vertices`` [V, 3].
    """
    large = camera.resized(camera.width * 2, camera.height * 2)
    ids, bary, light = _light(mesh, vertices, large, towards, colour)
    hit = ids >= 0
    texels = np.zeros((*ids.shape, 3))
    first = 0
    for part in mesh.parts:
        mine = (ids >= first) & (ids < first + len(part.faces))
        uv = np.einsum("nk,nkc->nc", bary[mine], part.uv[ids[mine] - first])
        texels[mine] = part.sample(uv)[:, :3]
        first += len(part.faces)
    picture = np.zeros((*ids.shape, 3))
    picture[hit] = to_srgb(to_linear(texels[hit]) * light[hit])
    return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def shading(
    mesh: RiggedMesh, vertices: np.ndarray, camera: Camera, towards: Sequence[float], colour: Sequence[float]
) -> np.ndarray:
    """Float32 [H, W, 3]: what that light makes of linear colours; half as fine, and carried on beyond the outline."""
    small = camera.resized(max(camera.width // 2, 1), max(camera.height // 2, 1))
    ids, _, light = _light(mesh, vertices, small, towards, colour)
    hit = (ids >= 0).astype(np.uint8)
    if not hit.any():
        return np.ones((camera.height, camera.width, 3), np.float32)
    _, labels = cv2.distanceTransformWithLabels(1 - hit, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    carried = np.zeros((labels.max() + 1, 3), np.float32)
    carried[labels[hit > 0]] = light[hit > 0]
    return np.asarray(cv2.resize(carried[labels], (camera.width, camera.height), interpolation=cv2.INTER_LINEAR))


def _light(
    mesh: RiggedMesh, vertices: np.ndarray, camera: Camera, towards: Sequence[float], colour: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face [H, W] and barycentric coordinates of what each pixel sees, and its light [H, W, 3]; zero beside it."""
    lamp = np.asarray(towards, float) / np.linalg.norm(towards)
    ids, bary = visible_faces(mesh, vertices, camera)
    hit = ids >= 0
    corners = mesh.faces[ids[hit]]
    points = np.einsum("nk,nkc->nc", bary[hit], vertices[corners])
    normals = np.einsum("nk,nkc->nc", bary[hit], _normals(mesh, vertices)[corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    eye = np.linalg.inv(camera.viewmat)[:3, 3]
    normals *= np.where(((eye - points) * normals).sum(axis=1) < 0, -1, 1)[:, None]
    wrapped = np.clip((normals @ lamp + 0.15) / 1.15, 0, None) * _reached(mesh, vertices, points, lamp)
    ambient = GROUND + (SKY - GROUND) * (0.5 + 0.5 * normals[:, 1:2])
    light = np.zeros((*ids.shape, 3))
    light[hit] = ambient + np.asarray(colour) * wrapped[:, None]
    return ids, bary, light


def _normals(mesh: RiggedMesh, vertices: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], np.cross(b - a, c - a))
    return normals


def _reached(mesh: RiggedMesh, vertices: np.ndarray, points: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """[N] share of the lamp's light that is not in shadow."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    reach = np.linalg.norm(vertices - middle, axis=1).max() + 0.05
    focal = SHADOW_SIZE / 2 * FAR / reach
    k = [[focal, 0, SHADOW_SIZE / 2], [0, focal, SHADOW_SIZE / 2], [0, 0, 1]]
    camera = Camera(look_at(middle + FAR * lamp, middle), k, SHADOW_SIZE, SHADOW_SIZE)
    ids, bary = visible_faces(mesh, vertices, camera)
    depth = np.full(ids.shape, np.inf)
    hit = ids >= 0
    along = vertices @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    depth[hit] = (bary[hit] * along[mesh.faces[ids[hit]]]).sum(axis=1)
    where = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    x, y = (focal * where[:, k] / where[:, 2] + SHADOW_SIZE / 2 for k in range(2))
    lit = np.zeros(len(points))
    for right in (-2, 0, 2):
        for down in (-2, 0, 2):
            column = np.clip((x + right).astype(int), 0, SHADOW_SIZE - 1)
            lit += depth[np.clip((y + down).astype(int), 0, SHADOW_SIZE - 1), column] + BIAS > where[:, 2]
    return lit / 9
