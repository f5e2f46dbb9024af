"""A face that moves for a person from a photograph: the open body's expressions, teeth, lids and lashes."""

from __future__ import annotations

from typing import NamedTuple

from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import first_vertices, with_expressions
from glsplat.extras.authoring.faces.blinks import blink_of, blink_that_shuts, with_blink
from glsplat.extras.authoring.faces.eyeballs import eyeballs
from glsplat.extras.authoring.faces.lashes_and_hair import FRINGES, with_lashes
from glsplat.extras.authoring.faces.lids import with_lids
from glsplat.extras.authoring.faces.mouth import with_open_lips, with_teeth
from glsplat.extras.authoring.faces.openings import Opening, openings
from glsplat.meshes import RiggedMesh

__all__ = ["FACE_SPLATS", "MovingFace", "moving_face", "with_face"]

FACE_SPLATS = 1_600
"""Splats that teeth, gums, lids and lashes take of those of an avatar."""

_LASHES, _LONG = 0.45, 0.75  # of opacities and lengths: what photographs show of lashes is there already


class MovingFace(NamedTuple):
    """What a face is made on."""

    mesh: RiggedMesh  # with 52 shapes of ARKit
    eyes: tuple[Opening, ...]  # at rest


def moving_face(mesh: RiggedMesh) -> MovingFace:
    """Of the ``mesh``, whose first vertices are the open body's, with parts called eyes, mouth and skin."""
    moving = with_open_lips(with_expressions(mesh, first_vertices(mesh)))
    eyes = openings(mesh, eyeballs(mesh, "eyes"))
    shares = {blink_of(eye.ball): blink_that_shuts(moving, eye) for eye in eyes}
    return MovingFace(with_blink(moving, shares), tuple(eyes))


def with_face(avatar: Avatar, face: MovingFace, total: int, seed: int = 0, *, seen: bool = True) -> Avatar:
    """The avatar, which was made on ``face.mesh`` and has its shapes, with what its photograph does not show.

    Lids, teeth and lashes are added, about ``total`` splats with them; the rest keeps its places, and its colours but
    in the mouth. Where no eye was ``seen`` (shut lids, dark glasses, a few pixels) there are no lashes beside what the
    photograph has there. Without levels and cones.
    """
    given, lashes = avatar, range(0)
    if seen:
        given = with_lashes(avatar, face.mesh, face.eyes, seed, strength=_LASHES, length=_LONG, light=False)
        lashes = range(len(avatar.splats), len(avatar.splats) + FRINGES * len(face.eyes))
    given = with_lids(given, face.mesh, face.eyes, lashes, seed)
    return with_teeth(given, face.mesh, total - len(given.splats), len(avatar.splats), seed)
