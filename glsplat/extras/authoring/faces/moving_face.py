"""Give a person from a photograph a moving face: the open body's expressions, teeth, lids and lashes."""

from __future__ import annotations

from typing import NamedTuple

from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.faces.eyes import (
    Opening,
    blink_shape_of,
    closing_weight,
    find_openings,
    fit_eyeballs,
    with_blink,
)
from glsplat.extras.authoring.faces.lashes import LASH_SPLATS, with_lashes
from glsplat.extras.authoring.faces.lids import with_lids
from glsplat.extras.authoring.faces.mouth import with_open_lips, with_teeth
from glsplat.meshes import RiggedMesh

FACE_SPLATS = 1_600
"""Of an avatar, for teeth, gums, lids and lashes."""


class MovingFace(NamedTuple):
    """The mesh and eyes that a moving face is made on."""

    mesh: RiggedMesh  # with 52 shapes of ARKit
    eyes: tuple[Opening, ...]  # at rest


def moving_face(mesh: RiggedMesh) -> MovingFace:
    """Return the moving face of ``mesh``.

    Its first vertices are the open body's.
    """
    moving = with_open_lips(with_expressions(mesh))
    eyes = find_openings(mesh, fit_eyeballs(mesh))
    shares = {blink_shape_of(eye.ball): closing_weight(moving, eye) for eye in eyes}
    return MovingFace(with_blink(moving, shares), tuple(eyes))


def with_face(avatar: Avatar, face: MovingFace, total: int, seed: int = 0, *, eyes_visible: bool = True) -> Avatar:
    """Return the avatar, made on ``face.mesh``, with the parts of a face that its photograph does not show.

    These are lids, teeth and lashes, about ``total`` splats together. Other splats keep their places, and their colours
    except in the mouth. Without ``eyes_visible`` (closed lids, dark glasses, a few pixels) no lashes are added. Levels
    and cones are dropped.
    """
    (mesh, eyes), made, lashes = face, avatar, range(0)
    if eyes_visible:
        made = with_lashes(avatar, mesh, eyes, seed)
        lashes = range(len(avatar.splats), len(avatar.splats) + LASH_SPLATS * len(eyes))
    made = with_lids(made, mesh, eyes, lashes, seed)
    return with_teeth(made, mesh, total - len(made.splats), len(avatar.splats), seed)
