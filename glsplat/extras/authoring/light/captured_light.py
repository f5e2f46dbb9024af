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

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.light.ambient_occlusion import ambient_occlusion
from glsplat.extras.authoring.light.cloth_normals import cloth_normals
from glsplat.extras.authoring.light.surfaces import locate_splats, open_occlusion
from glsplat.extras.authoring.optimize.surface_consistency import view_consistent
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import strongest_joint

# of the lamp's direction (tangents) and log strength; wide, since faces may be lit from the side
_LAMP_SIGMAS = 1.5, 0.7
_MIN_SHADE_FRACTION = 0.3  # of the brightest; darker parts of photographs are noise, which division would amplify
_MAX_ALBEDO = 0.85  # of white cloth and paper, which photographs show as white
_MIN_VISIBILITY = 0.3


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


def captured_light(mesh: RiggedMesh, shots: Sequence[FittedPicture], painted: Lamp) -> CapturedLight:
    """Return the light of ``shots``, the front first, of the dressed body ``mesh``.

    ``painted`` is the light in which unseen sides were painted.
    """
    front = shots[0]
    vertices, up = front.view.vertices, front.view.root[:, 1]
    normals, zero_normals = cloth_normals(mesh, [vertices, mesh.posed(Pose.zero(len(mesh.skeleton)))])
    linear = front.sample(front.view.pixels, front.layer)
    lamp = find_light(normals, linear, front.visibility, up, np.array([0.0, 0, -1]), _LAMP_SIGMAS)
    occlusion = ambient_occlusion(mesh, vertices)
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
    shade = locations.at(captured.shade[:, None])[:, 0]
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
