"""Fit a fitted body's hands and face to the landmarks of their networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.fit.body_fit import BodyFit, assemble_fit, fit_clothes
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.face import fit_face
from glsplat.extras.authoring.fit.hands import fit_hand
from glsplat.extras.authoring.fit.kinematics import fully_posed
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import DetectedPerson
from glsplat.skinning.smplx import JOINT_NAMES

_FINGER_JOINTS = {
    side: [k for k, name in enumerate(JOINT_NAMES) if name.startswith(f"{side}_") and name[-1] in "123"]
    for side in ("left", "right")
}
_HEAD_JOINTS = [JOINT_NAMES.index(name) for name in ("neck", "head")]
_MOVED_JOINTS = [
    k
    for k, name in enumerate(JOINT_NAMES)
    if k in _HEAD_JOINTS or k > JOINT_NAMES.index("head") or name.endswith(("elbow", "wrist"))
]


def fit_details(fit: BodyFit, views: Sequence[View], people: Sequence[DetectedPerson | None]) -> BodyFit:
    """Return the ``fit`` of ``views`` with hands and face fitted to the networks' ``people`` in the same pictures.

    Fingers, forearms, neck and head turn; the face's features and the eyes' joints move in ``rest`` and ``joints``;
    hair and sleeves are fitted to the masks again. Hands and faces that are hidden or not credible stay unchanged.
    """
    body = open_body()
    rotations = [fitted.rotations.copy() for fitted in fit.views]
    for side in ("left", "right"):
        _set_hand(body, fit, views, people, side, rotations)
    bare, joints = body.shaped(fit.betas)
    for fitted, view, person, turns in zip(fit.views, views, people, rotations, strict=True):
        found = fit_face(body, fit, fitted, view, person.face) if person is not None and view.side == "front" else None
        if found is not None:
            turns[_HEAD_JOINTS] = found[0][_HEAD_JOINTS]
            bare = bare + found[1]
            for eye in EYE_SIDES:
                joints[JOINT_NAMES.index(f"{eye}_eye_smplhf")] += found[1][eyeball(body, eye).vertices[0]]
            break  # one picture is enough for the face
    if all((turns == fitted.rotations).all() for turns, fitted in zip(rotations, fit.views, strict=True)):
        return fit  # any fitted face turns the head at least a little
    poses = [
        fully_posed(body, fit.betas, fitted.root, fitted.pelvis, turns)
        for fitted, turns in zip(fit.views, rotations, strict=True)
    ]
    moved = (body.skin_weights * np.isin(body.skin_joints, _MOVED_JOINTS)).sum(axis=1)
    offsets = moved * fit_clothes(body, bare, poses, views, fit.offsets) + (1 - moved) * fit.offsets
    errors = [fitted.landmark_error for fitted in fit.views]
    detailed = assemble_fit(body, bare, joints, offsets, poses, rotations, views, errors)
    pairs = zip(detailed.views, fit.views, strict=True)
    return replace(detailed, views=tuple(replace(new, uncertainty=old.uncertainty) for new, old in pairs))


def _set_hand(
    body: Body,
    fit: BodyFit,
    views: Sequence[View],
    people: Sequence[DetectedPerson | None],
    side: str,
    rotations: list[F64],
) -> None:
    """Set one hand in the views' ``rotations`` [55, 3]; views that do not show it get the fingers of another view."""
    arm = [JOINT_NAMES.index(f"{side}_{name}") for name in ("elbow", "wrist")]
    fingers: list[F64 | None] = []
    for fitted, view, person, turns in zip(fit.views, views, people, rotations, strict=True):
        hand = None if person is None else person.left_hand if side == "left" else person.right_hand
        found = None if hand is None else fit_hand(body, fit, fitted, view, hand, side)
        fingers.append(None if found is None else found[_FINGER_JOINTS[side]])
        if found is not None:
            turns[arm] = found[arm]
    known = next((each for each in fingers if each is not None), None)
    for turns, each in zip(rotations, fingers, strict=True):
        if known is not None:
            turns[_FINGER_JOINTS[side]] = known if each is None else each
