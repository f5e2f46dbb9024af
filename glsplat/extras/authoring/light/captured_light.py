"""Estimate the light of photographs on the fitted body, so that it can be divided out of an avatar's colours.

The light is stored beside the colours, which stay the photograph's: without a light the avatar is shown as
photographed, byte for byte. The model is a colourless lamp and a room, since a warm lamp and warm skin look alike.
Shadows that the body casts on itself stay: where the fit is off by millimetres, dividing them out would show their
edges twice (on two participants it cost up to 8 % of the gain of relighting).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array, csr_matrix, diags

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.segments import HANDS
from glsplat.extras.authoring.compute.solvers import conjugate_gradients
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.light.surfaces import locate_splats, open_occlusion
from glsplat.extras.authoring.optimize.surface_consistency import view_consistent
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import unit_vectors
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import strongest_joint

# of the lamp's direction (tangents) and log strength; wide, since faces may be lit from the side
_LAMP_SIGMAS = 1.5, 0.7
_MIN_SHADE_FRACTION = 0.3  # of the brightest; darker parts of photographs are noise, which division would amplify
_MAX_ALBEDO = 0.85  # of white cloth and paper, which photographs show as white
_MIN_VISIBILITY = 0.3
_CLOTH_SMOOTHING_M, _NECK_SMOOTHING_M, _BARE_SMOOTHING_M = 0.03, 0.01, 0.002  # bare: faces and hands
_MAX_COTANGENT = 20.0


@dataclass(frozen=True, eq=False)
class CapturedLight:
    """The light in a photograph."""

    light: Light
    """In the axes of the avatar's zero pose; white cloth under its brightest part is as white as pictures can be."""
    shade: F64
    """[V] irradiance over pi: as photographed, or as painted where no picture looks."""
    occlusion: F64
    """[V] ambient occlusion in the photograph's pose."""
    normals: F64
    """[V, 3] unit, in the zero pose, of the clothes."""


def captured_light(mesh: RiggedMesh, shots: Sequence[FittedPicture], occlusion: F64, painted: Lamp) -> CapturedLight:
    """Return the light of ``shots``, the front first, of the dressed body ``mesh``.

    ``occlusion`` [V] is ambient, in the front's pose; ``painted`` the light in which unseen sides were painted.
    """
    front = shots[0]
    vertices, up = front.view.vertices, front.view.root[:, 1]
    normals, zero_normals = cloth_normals(mesh, [vertices, mesh.posed(Pose.zero(len(mesh.skeleton)))])
    linear = front.sample(front.view.pixels, front.layer)
    lamp = find_light(normals, linear, front.visibility, up, np.array([0.0, 0, -1]), _LAMP_SIGMAS)
    ambient = replace(lamp, strength=0.0).shade(normals)
    visible_shade = ambient * open_occlusion(occlusion) + lamp.shade(normals) - ambient
    full = _brightest(lamp) * _MAX_ALBEDO
    min_shade = _MIN_SHADE_FRACTION / _MAX_ALBEDO
    visible_shade = np.maximum(visible_shade / full, min_shade)
    # unseen surface was painted in the other light: match its mean brightness on visible surface
    painted_shade = painted.shade(normals)
    visibility = np.max([shot.visibility for shot in shots], axis=0)
    sure = visibility > _MIN_VISIBILITY
    ratio = np.log(visible_shade / painted_shade)[sure].mean() if sure.any() else -np.log(_brightest(painted))
    painted_shade = painted_shade * np.exp(ratio)
    shade = np.maximum(painted_shade + visibility * (visible_shade - painted_shade), min_shade)
    ramp = replace(lamp, strength=0.0).shade(np.stack([up, -up])) / full
    sky, ground = (np.full(3, one) for one in ramp)
    direction = front.view.root.T @ lamp.direction
    light = Light.hemisphere(sky, ground, direction, np.full(3, np.pi * lamp.strength / full))
    return CapturedLight(light, np.asarray(shade), occlusion, zero_normals)


def with_captured_light(
    avatar: Avatar, mesh: RiggedMesh, captured: CapturedLight, photographed: int | None = None
) -> Avatar:
    """Return the avatar with the surface of ``mesh`` and the light its colours hold, also in its meta data.

    Splats from ``photographed`` on (teeth, lashes) do not come from the photograph and hold no light.
    """
    locations = locate_splats(mesh, avatar.splats, captured.occlusion)
    normals = locations.directions(captured.normals)
    shade = locations.at(captured.shade)
    if photographed is not None:
        shade[photographed:] = 1.0
    occlusion = open_occlusion(locations.at(captured.occlusion))
    head_joints = [number for number, name in enumerate(avatar.skeleton.names) if name in HEAD]
    mine = np.isin(strongest_joint(avatar.skin.joints, avatar.skin.weights), head_joints)
    if mine.any():  # elsewhere only the body's other side lies behind the visible surface
        shapes = None if avatar.shapes is None else avatar.shapes.take(mine)
        head = replace(avatar, splats=avatar.splats.take(mine), skin=avatar.skin.take(mine), shapes=shapes, levels=())
        normals[mine], occlusion[mine], shade[mine] = view_consistent(head, normals[mine], occlusion[mine], shade[mine])
    surface = Surface.of(normals, occlusion, np.repeat(shade[:, None], 3, axis=1))
    meta: dict[str, Any] = dict(avatar.meta) | {"light": captured.light.to_json()}
    return replace(avatar, splats=replace(avatar.splats, surface=surface), meta=meta)


def _brightest(lamp: Lamp) -> float:
    return float(lamp.shade(np.stack([lamp.direction, lamp.up])).max())


def cloth_normals(mesh: RiggedMesh, poses: list[F64]) -> list[F64]:
    """Return [V, 3] unit normals of the ``mesh`` for each array of vertices in ``poses``, smoothed under clothes.

    It is one implicit step of diffusion over the surface, independent of its triangles (Desbrun et al., Implicit
    Fairing of Irregular Meshes using Diffusion and Curvature Flow, 1999; cotangents after Pinkall and Polthier, 1993).
    """
    stiff, area = _laplacian(mesh)
    part = strongest_joint(mesh.joints, mesh.weights)
    sigma_m = np.full(len(part), _CLOTH_SMOOTHING_M)
    for words, smoothing in ((("neck",), _NECK_SMOOTHING_M), ((*HEAD, *HANDS), _BARE_SMOOTHING_M)):
        mine = [index for index, name in enumerate(mesh.skeleton.names) if any(word in name for word in words)]
        sigma_m[np.isin(part, mine)] = smoothing
    own = (area / sigma_m**2)[:, None]
    normals = np.concatenate([vertex_normals(vertices, mesh.faces) for vertices in poses], axis=1)
    smoothed = conjugate_gradients(csr_matrix(stiff + diags(own[:, 0])), own * normals, normals)
    return [unit_vectors(one) for one in np.split(smoothed, len(poses), axis=1)]


def _laplacian(mesh: RiggedMesh) -> tuple[csr_array, F64]:
    """Return [V, V] the cotangent matrix of the zero pose, which maps constants to 0, and [V] vertex areas."""
    corner, count = mesh.vertices[mesh.faces], len(mesh.vertices)
    rows, columns, values, area = [], [], [], np.full(count, 1e-10)
    for here in range(3):
        first, last = (here + 1) % 3, (here + 2) % 3
        one, other = corner[:, first] - corner[:, here], corner[:, last] - corner[:, here]
        across = np.linalg.norm(np.cross(one, other), axis=1)
        half = (np.einsum("fc,fc->f", one, other) / np.maximum(across, 1e-10)).clip(0, _MAX_COTANGENT) / 2
        ends = mesh.faces[:, first], mesh.faces[:, last]
        rows += [*ends, *ends]
        columns += [*ends[::-1], *ends]
        values += [-half, -half, half, half]
        np.add.at(area, mesh.faces[:, here], across / 6)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return csr_array(entries, shape=(count, count)), area
