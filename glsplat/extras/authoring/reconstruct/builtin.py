"""The built-in reconstructor: fits the open body to the pictures, dresses it, and paints it with their colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.segments import arm_segments
from glsplat.extras.authoring.compute.threads import run_in_background
from glsplat.extras.authoring.dress.shoes import with_shoes
from glsplat.extras.authoring.dress.skirt import dress
from glsplat.extras.authoring.faces.moving_face import FACE_SPLATS, moving_face, with_face
from glsplat.extras.authoring.fit.body_fit import BodyFit, fit_body
from glsplat.extras.authoring.fit.details import fit_details
from glsplat.extras.authoring.fit.eyes import read_eyes
from glsplat.extras.authoring.fit.face import face_turn
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.light.captured_light import captured_light, with_captured_light
from glsplat.extras.authoring.light.surfaces import ambient_occlusion
from glsplat.extras.authoring.networks.face import EyeLook
from glsplat.extras.authoring.networks.people import DetectedPerson, find_person
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.extras.authoring.optimize.photo_fit import fitted_to_photos
from glsplat.extras.authoring.optimize.surface_consistency import load_compiled
from glsplat.extras.authoring.paint.bake import bake
from glsplat.extras.authoring.paint.inpaint.hair import with_hair
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.shoes import footwear_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.reconstruct.reconstructor import FittedBody, MadeAvatar, Mask, Options, Picture
from glsplat.extras.authoring.sample.scatter import even_points, scatter
from glsplat.extras.authoring.templates.hair import MIN_AGREEMENT, FittedHair, bared, fit_hair, haired
from glsplat.extras.authoring.templates.hair_mask import seen_hair
from glsplat.extras.authoring.templates.hair_splats import HAIR_SPLATS, covered_by_hair, hair_splats, with_template_hair
from glsplat.extras.authoring.templates.head_view import head_view
from glsplat.extras.authoring.templates.library import HAIR, hand_skin, template
from glsplat.meshes import RiggedMesh

SIDES = ("front", "back", "left", "right")
_MIN_SPLATS_WITH_FACE = 8_000  # below, an avatar has none to spare for teeth and lashes
_MIN_SPLATS_WITH_HAIR = 3 * HAIR_SPLATS
_MIN_ARM_VISIBILITY = 0.4
_MIN_FACE_PRESENCE = 0.5
_MIN_HAND_PRESENCE, _MAX_WRIST_GAP = 0.8, 0.4  # the gap between the wrists of hand and arm, in forearms
_LIGHT_POINTS = 20_000  # for the light and the unseen fraction of a mesh
MIN_TRUST = 0.1
"""Trust below which a point counts as unseen: pictures show it at too grazing an angle."""
PHONE_FOCAL_FACTOR = 1.37
"""Focal length of a usual phone camera, in heights of an upright picture."""


class Builtin:
    """Fits, dresses and paints; needs the networks of ``glsplat models get``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """Return the avatar; see ``Reconstructor``."""
        return self.report(pictures, masks, options).avatar

    def report(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> MadeAvatar:
        """Return the avatar with the fit and the mesh it was made from."""
        loaded = None if options.keep_light else run_in_background(load_compiled)  # fitting leaves a core idle
        body, fit, bald, looks, parts = _fitted(pictures, masks, options)
        dressed, posed = bald[0].mesh, bald[0].view.vertices
        occlusion = None if options.keep_light else run_in_background(lambda: ambient_occlusion(dressed, posed))
        hair, worn = None, f"painted, a template needs {_MIN_SPLATS_WITH_HAIR} splats"
        if options.splats >= _MIN_SPLATS_WITH_HAIR:
            hair, worn = _template_hair(body, fit, bald[0], parts)
        if hair is None:
            shots = with_hair(body, bald)
        else:
            hair, shots = bared(hair, bald)
        mesh = shots[0].mesh
        shod, footwear = _shod(body, fit, shots[0])
        whole, notes = shod or mesh, {"hair": worn, "shoes": footwear}
        rng = np.random.default_rng(options.seed)
        face = run_in_background(lambda: moving_face(whole)) if options.splats >= _MIN_SPLATS_WITH_FACE else None
        covered, elsewhere = (None, 0) if hair is None else (covered_by_hair(hair), HAIR_SPLATS)
        if covered is not None:
            covered = np.pad(covered, (0, len(whole.vertices) - len(covered)))
        scattered = scatter(whole, options.splats - (FACE_SPLATS if face else 0), rng, covered, elsewhere)
        own = scattered.points.take(scattered.points.corners[:, 0] < len(mesh.vertices))  # middles lose thin stripes
        bare = None if hair is None else haired(hair)
        painter = painter_of(body, shots, own, looks, shod, hand_skin(), bare)
        locks = None if hair is None else run_in_background(lambda: hair_splats(hair, painter.light, options.seed))
        captured = None
        if occlusion is not None:
            captured = run_in_background(lambda: captured_light(mesh, shots, occlusion(), painter.light))
        painted = painter.paint(scattered.points)
        options.progress("placing splats", 0.0)
        avatar = scattered.avatar(face().mesh if face else whole, painted.rgb, painted.detail, rng, painted.guessed)
        unseen = float(np.average(painted.visibility < MIN_TRUST, weights=1 / scattered.density))
        options.progress("placing splats", 1.0)
        avatar = fitted_to_photos(avatar, whole, painter.colours, shots, options.seed, options.steps, options.progress)
        if hair is not None and locks is not None:
            avatar = with_template_hair(avatar, hair, locks())
        photographed = len(avatar.splats)
        if face:
            options.progress("giving it a face", 0.0)
            avatar = with_face(avatar, face(), options.splats, options.seed, eyes_visible=bool(looks))
        if captured is not None and loaded is not None:
            options.progress("finding the light", 0.0)
            loaded()
            avatar = with_captured_light(avatar, mesh, captured(), photographed)
            options.progress("finding the light", 1.0)
        avatar = replace(avatar, meta=dict(avatar.meta) | {"templates": notes})
        return MadeAvatar(avatar=avatar, fit=fit, mesh=mesh, unseen=unseen, seen=_trust(shots), problem=fit.problem)

    def mesh(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> FittedBody:
        """Return the dressed body, textured with the pictures."""
        body, fit, bald, looks, _ = _fitted(pictures, masks, options)
        shots = with_hair(body, bald)
        shod, footwear = _shod(body, fit, shots[0])
        mesh = shots[0].mesh
        even = even_points(mesh, _LIGHT_POINTS)
        painter = painter_of(body, shots, even, looks, shod, hand_skin())
        unseen = float((painter.paint(even).visibility < MIN_TRUST).mean())
        options.progress("painting textures", 0.5)
        mesh = bake(shod or mesh, painter.colours, options.texture)
        mesh = replace(mesh, meta=dict(mesh.meta) | {"templates": {"shoes": footwear}})
        options.progress("painting textures", 1.0)
        return FittedBody(fit=fit, mesh=mesh, unseen=unseen, seen=_trust(shots), problem=fit.problem)


def _template_hair(
    body: Body, fit: BodyFit, front: FittedPicture, parts: NDArray[np.uint8] | None
) -> tuple[FittedHair | None, str]:
    """Return the hair of the ``front`` picture as a template, None where the painted head is safer, and a note.

    ``parts`` are the person's ``head_parts``.
    """
    head = head_view(body, fit, front)
    seen = seen_hair(head, parts)
    hair = None if seen is None else fit_hair(head, seen, tuple(HAIR))
    if hair is None:
        return None, "painted, " + ("none is found" if seen is None else "short, below a hat")
    if hair.agreement < MIN_AGREEMENT:
        return None, f"painted, {hair.name} agrees by {hair.agreement:.2f}, not {MIN_AGREEMENT:g}"
    return hair, f"template {hair.name}, agreement {hair.agreement:.2f}"


class _Fitted(NamedTuple):
    """The body fitted to the pictures, and the pictures that paint it."""

    body: Body
    fit: BodyFit
    shots: tuple[FittedPicture, ...]  # before hair is added behind the body
    looks: Mapping[str, EyeLook]
    head_parts: NDArray[np.uint8] | None  # of the front


def _fitted(pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> _Fitted:
    if "front" not in pictures:
        raise FormatError("an avatar needs a picture of the front")
    sides = [side for side in SIDES if side in pictures]
    options.progress("reading landmarks", 0.0)
    people = {side: pictures[side].person or _person(pictures[side], side) for side in sides}
    views = [_view(side, pictures[side], masks[side], people[side]) for side in sides]
    options.progress("fitting the body", 0.15)
    body = open_body()
    fit = fit_body(views, options.height)
    fit = fit_details(fit, views, [people[side] for side in sides])
    options.progress("painting", 0.35)
    mesh, seen = dress(body, fit, views, pictures["front"].rgb)
    shots = tuple(
        FittedPicture(
            pictures[side].rgb,
            masks[side],
            view.focal,
            fitted,
            mesh,
            arm_segments(body),
            _arms(people[side]),
            people[side].face.presence > _MIN_FACE_PRESENCE,
        )
        for side, view, fitted in zip(sides, views, seen, strict=True)
    )
    looks = read_eyes(pictures["front"].rgb, people["front"].face)
    if not any(look.visible for look in looks.values()):
        looks = {}  # closed lids and dark glasses are painted as pictured
    return _Fitted(body, fit, shots, looks, people["front"].head_parts)


def _shod(body: Body, fit: BodyFit, shot: FittedPicture) -> tuple[RiggedMesh | None, str]:
    """Return the dressed body with shoes, or None if its feet stay, and a note on what they wear."""
    footwear = footwear_of(body, shot)
    if footwear.template is None:
        return None, f"{footwear.kind}, feet as fitted"
    floor = fit.joints[0] - shot.mesh.skeleton.joints[0]
    bare = body.shaped(fit.betas)[0] - floor
    note = f"{footwear.kind}, template {footwear.template}"
    return with_shoes(body, bare, shot.mesh, template(footwear.template)), note


def _trust(shots: Sequence[FittedPicture]) -> F64:
    return np.asarray(np.max([shot.visibility for shot in shots], axis=0))


def _person(picture: Picture, side: str) -> DetectedPerson:
    person = find_person(picture.rgb)
    if person is None:
        raise FormatError(f"nobody is found in the {side} picture; show one whole person, upright")
    return person


def _arms(person: DetectedPerson) -> F64:
    """Return pixels [2, 24, 2] of shoulders, elbows, wrists and hands, left and right; NaN where not detected."""
    arms = []
    for side, hand in (("left", person.left_hand), ("right", person.right_hand)):
        names = [LANDMARKS.index(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist")]
        arm, fingers = person.body.points[names], hand.points[:, :2]
        long = max(float(np.linalg.norm(arm[2] - arm[1])), 1.0)
        seen = hand.presence > _MIN_HAND_PRESENCE and float(np.linalg.norm(fingers[0] - arm[2])) < _MAX_WRIST_GAP * long
        sure = person.body.visible[names][:, None] > _MIN_ARM_VISIBILITY
        arms.append(np.concatenate([np.where(sure, arm, np.nan), np.where(seen, fingers, np.nan)]))
    return np.stack(arms)


def _view(side: str, picture: Picture, mask: Mask, person: DetectedPerson) -> View:
    focal = picture.focal or PHONE_FOCAL_FACTOR * max(picture.rgb.shape[:2])
    face = face_turn(open_body(), person.face, focal, picture.rgb.shape[1] / 2) if side == "front" else None
    return View(mask, person.body.points, person.body.visible, focal, side=side, world=person.body.world, face=face)
