"""The light that photographs hold: estimated on the fitted body, so that it can be divided out of an avatar's colours.

What is divided out is kept beside the colours, which stay the photograph's: who shows the avatar without a light sees
the person as photographed, to the byte. One lamp and a room, without colour: a warm lamp and warm skin look alike.
Shadows that the body casts on itself are not divided out: where the fit is off by millimetres that shows their edges
twice (on two participants it cost up to 8 % of what relighting gains).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.light.ambient_occlusion import ambient_occlusion
from glsplat.extras.authoring.light.cloth_normals import cloth_normals
from glsplat.extras.authoring.light.surfaces import nearest_open, opened
from glsplat.extras.authoring.optimize.surface_consistency import as_seen
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import strongest_joint

__all__ = ["CapturedLight", "captured_light", "with_captured_light"]

F64 = NDArray[np.float64]

_DOUBTS = 1.5, 0.7  # of direction and strength: far more than painting unseen sides allows, for a face lit from aside
_LEAST = 0.3  # of the brightest: darker than that a photograph is noise, and dividing by it shows it
_WHITEST = 0.85  # of what light a surface gives back: white cloth and paper, which photographs show as white
_SURE = 0.3  # trust in a vertex's colour above which it tells of the light


@dataclass(frozen=True, eq=False)
class CapturedLight:
    """What light a photograph holds."""

    light: Light
    """In the axes of the avatar's zero pose, scaled so that white cloth is as white as a picture can be where it shines
    brightest."""
    shade: F64
    """[V] of the mesh's vertices as photographed, where nobody looked as painted; irradiance over pi."""
    occlusion: F64
    """[V] ambient occlusion in the photograph's pose."""
    normals: F64
    """[V, 3] unit, in the zero pose, of what the body wears."""


def captured_light(mesh: RiggedMesh, shots: Sequence[FittedPicture], painted: Lamp) -> CapturedLight:
    """Of ``shots``, the front first, of the dressed body ``mesh``; ``painted`` is the light that unseen sides have."""
    front = shots[0]
    vertices, up = front.view.vertices, front.view.root[:, 1]
    normals, still = cloth_normals(mesh, [vertices, mesh.posed(Pose.zero(len(mesh.skeleton)))])
    linear = front.sample(front.view.pixels, front.layer)
    lamp = find_light(normals, linear, front.visibility, up, np.array([0.0, 0, -1]), _DOUBTS)
    occlusion = ambient_occlusion(mesh, vertices)
    ambient = replace(lamp, strength=0.0).shade(normals)
    seen = ambient * opened(occlusion) + lamp.shade(normals) - ambient
    full = _brightest(lamp) * _WHITEST
    least = _LEAST / _WHITEST
    seen = np.maximum(seen / full, least)
    # what nobody sees was painted as if in the other light: alike on what is seen, as bright on the whole
    guessed = painted.shade(normals)
    trust = np.max([shot.visibility for shot in shots], axis=0)
    sure = trust > _SURE
    guessed = guessed * np.exp(np.log(seen / guessed)[sure].mean() if sure.any() else -np.log(_brightest(painted)))
    shade = np.maximum(guessed + trust * (seen - guessed), least)
    ramp = replace(lamp, strength=0.0).shade(np.stack([up, -up])) / full
    sky, ground = (np.full(3, one) for one in ramp)
    direction = front.view.root.T @ lamp.direction
    light = Light.hemisphere(sky, ground, direction, np.full(3, np.pi * lamp.strength / full))
    return CapturedLight(light, np.asarray(shade), occlusion, still)


def with_captured_light(
    avatar: Avatar, mesh: RiggedMesh, captured: CapturedLight, photographed: int | None = None
) -> Avatar:
    """The avatar with the surface of ``mesh``, whose colours hold that light; it is told in the avatar's notes.

    Splats from ``photographed`` on (teeth, lashes) have colours that no photograph gave: these hold no light.
    """
    where = nearest_open(mesh, avatar.splats, captured.occlusion)
    normals = where.directions(captured.normals)
    shade = where.at(captured.shade[:, None])[:, 0]
    if photographed is not None:
        shade[photographed:] = 1.0
    occlusion = opened(where.at(captured.occlusion))
    faces = [number for number, name in enumerate(avatar.skeleton.names) if name in HEAD]
    mine = np.isin(strongest_joint(avatar.skin.joints, avatar.skin.weights), faces)
    if mine.any():  # elsewhere nothing lies behind what is seen but the same body's other side
        shapes = None if avatar.shapes is None else avatar.shapes.take(mine)
        head = replace(avatar, splats=avatar.splats.take(mine), skin=avatar.skin.take(mine), shapes=shapes, levels=())
        normals[mine], occlusion[mine], shade[mine] = as_seen(head, normals[mine], occlusion[mine], shade[mine])
    surface = Surface.of(normals, occlusion, np.repeat(shade[:, None], 3, axis=1))
    meta: dict[str, Any] = dict(avatar.meta) | {"light": captured.light.to_json()}
    return replace(avatar, splats=replace(avatar.splats, surface=surface), meta=meta)


def _brightest(lamp: Lamp) -> float:
    return float(lamp.shade(np.stack([lamp.direction, lamp.up])).max())
