"""The built-in way: the open body fitted to the pictures, dressed, and painted with what they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.segments import segments_of
from glsplat.extras.authoring.compute.threads import aside
from glsplat.extras.authoring.dress.skirt import dress
from glsplat.extras.authoring.faces.moving_face import FACE_SPLATS, moving_face, with_face
from glsplat.extras.authoring.fit.body_fit import BodyFit, fit_body
from glsplat.extras.authoring.fit.details import fit_details
from glsplat.extras.authoring.fit.eyes import EyeLook, read_eyes
from glsplat.extras.authoring.fit.face import face_turn
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.light.captured_light import captured_light, with_captured_light
from glsplat.extras.authoring.networks.people import DetectedPerson, find_person
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.extras.authoring.optimize.photo_fit import fitted_to_photos
from glsplat.extras.authoring.optimize.surface_consistency import ready
from glsplat.extras.authoring.paint.bake import bake
from glsplat.extras.authoring.paint.inpaint.hair import with_hair
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.reconstruct.reconstructor import (
    FittedBody,
    MadeAvatar,
    Mask,
    MeshReconstructor,
    Options,
    Picture,
    ReportingReconstructor,
)
from glsplat.extras.authoring.sample.scatter import even_points, scatter

__all__ = ["PHONE", "SIDES", "Builtin", "FittedBody", "MadeAvatar", "MeshReconstructor", "ReportingReconstructor"]

SIDES = ("front", "back", "left", "right")
_FACED = 8_000  # splats of an avatar that has some to spare for teeth and lashes
_HARDLY = 0.1  # of a point that a picture shows too flatly to be believed
_SURE = 0.4  # visibility of an arm that is where the network has it
_HAND, _NEAR = 0.8, 0.4  # presence of a hand; how far its wrist is from the arm's, in forearms
_LIT = 20_000  # points that light and unseen share are found on
PHONE = 1.37
"""Focal length of a usual phone camera, in heights of an upright picture."""


class Builtin:
    """Fits, dresses and paints; needs the networks of ``glsplat models get``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """An avatar; see ``Reconstructor``."""
        return self.tell(pictures, masks, options).avatar

    def tell(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> MadeAvatar:
        """The avatar with all that led to it."""
        body, fit, bald, looks = _fitted(pictures, masks, options)
        loaded = None if options.keep_light else aside(ready)  # where a core has nothing to do
        shots = with_hair(body, bald)
        mesh = shots[0].mesh
        rng = np.random.default_rng(options.seed)
        face = aside(lambda: moving_face(mesh)) if options.splats >= _FACED else None
        strewn = scatter(mesh, options.splats - (FACE_SPLATS if face else 0), rng)
        painter = painter_of(body, shots, strewn.points, looks)
        captured = None if options.keep_light else aside(lambda: captured_light(mesh, shots, painter.light))
        painted = painter.paint(strewn.points)
        options.progress("placing splats", 0.0)
        avatar = strewn.avatar(face().mesh if face else mesh, painted.rgb, painted.detail, rng)
        unseen = float(np.average(painted.visibility < _HARDLY, weights=1 / strewn.density))
        options.progress("placing splats", 1.0)
        avatar = fitted_to_photos(
            avatar, mesh, painter.colours, shots, options.seed, options.steps, options.texture, options.progress
        )
        photographed = len(avatar.splats)
        if face:
            options.progress("giving it a face", 0.0)
            avatar = with_face(avatar, face(), options.splats, options.seed, eyes_visible=bool(looks))
        if captured is not None and loaded is not None:
            options.progress("finding the light", 0.0)
            loaded()
            avatar = with_captured_light(avatar, mesh, captured(), photographed)
            options.progress("finding the light", 1.0)
        return MadeAvatar(avatar=avatar, fit=fit, mesh=mesh, unseen=unseen, seen=_seen(shots), problem=fit.problem)

    def mesh(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> FittedBody:
        """The dressed body with the pictures in its textures."""
        body, fit, bald, looks = _fitted(pictures, masks, options)
        shots = with_hair(body, bald)
        mesh = shots[0].mesh
        even = even_points(mesh, _LIT)
        painter = painter_of(body, shots, even, looks)
        unseen = float((painter.paint(even).visibility < _HARDLY).mean())
        options.progress("painting textures", 0.5)
        mesh = bake(mesh, painter.colours, options.texture)
        options.progress("painting textures", 1.0)
        return FittedBody(fit=fit, mesh=mesh, unseen=unseen, seen=_seen(shots), problem=fit.problem)


class _Fitted(NamedTuple):
    """The body in the pictures, and what paints it."""

    body: Body
    fit: BodyFit
    shots: tuple[FittedPicture, ...]  # no hair hangs behind it yet
    looks: Mapping[str, EyeLook]


def _fitted(pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> _Fitted:
    if "front" not in pictures:
        raise FormatError("an avatar needs a picture of the front")
    sides = [side for side in SIDES if side in pictures]
    options.progress("reading landmarks", 0.0)
    people = {side: pictures[side].person or _person(pictures[side], side) for side in sides}
    views = [_view(side, pictures[side], masks[side], people[side]) for side in sides]
    options.progress("fitting the body", 0.15)
    body = open_body()
    fit = fit_body(views, options.height, body)
    fit = fit_details(fit, views, [people[side] for side in sides], body)
    options.progress("painting", 0.35)
    mesh, seen = dress(body, fit, views)
    shots = tuple(
        FittedPicture(pictures[side].rgb, masks[side], view.focal, fitted, mesh, segments_of(), _arms(people[side]))
        for side, view, fitted in zip(sides, views, seen, strict=True)
    )
    looks = read_eyes(pictures["front"].rgb, people["front"].face)
    if not any(look.seen for look in looks.values()):
        looks = {}  # closed lids and dark glasses stay what they are
    return _Fitted(body, fit, shots, looks)


def _seen(shots: Sequence[FittedPicture]) -> NDArray[np.float64]:
    return np.asarray(np.max([shot.visibility for shot in shots], axis=0))


def _person(picture: Picture, side: str) -> DetectedPerson:
    person = find_person(picture.rgb)
    if person is None:
        raise FormatError(f"nobody is found in the {side} picture; show one whole person, upright")
    return person


def _arms(person: DetectedPerson) -> NDArray[np.float64]:
    """[2, 24, 2] pixels of shoulders, elbows, wrists and hands, left and right; NaN where no network believes them."""
    arms = []
    for side, hand in (("left", person.left_hand), ("right", person.right_hand)):
        names = [LANDMARKS.index(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist")]
        arm, fingers = person.body.points[names], hand.points[:, :2]
        long = max(float(np.linalg.norm(arm[2] - arm[1])), 1.0)
        seen = hand.presence > _HAND and float(np.linalg.norm(fingers[0] - arm[2])) < _NEAR * long
        sure = person.body.visible[names][:, None] > _SURE
        arms.append(np.concatenate([np.where(sure, arm, np.nan), np.where(seen, fingers, np.nan)]))
    return np.stack(arms)


def _view(side: str, picture: Picture, mask: Mask, person: DetectedPerson) -> View:
    focal = picture.focal or PHONE * max(picture.rgb.shape[:2])
    face = face_turn(open_body(), person.face, focal, picture.rgb.shape[1] / 2) if side == "front" else None
    return View(mask, person.body.points, person.body.visible, focal, side=side, world=person.body.world, face=face)
