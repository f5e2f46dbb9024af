"""A fitted body's hands and face, fitted to what their own networks see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.fit.body_fit import BodyFit, assembled, dressed
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.face import fit_face
from glsplat.extras.authoring.fit.hands import fit_hand
from glsplat.extras.authoring.fit.kinematics import fully_posed
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import DetectedPerson
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["fit_details"]

F64 = NDArray[np.float64]

_HANDS = {
    side: [k for k, name in enumerate(JOINT_NAMES) if name.startswith(f"{side}_") and name[-1] in "123"]
    for side in ("left", "right")
}  # rows of the fingers' joints
_HEAD = [JOINT_NAMES.index(name) for name in ("neck", "head")]
_MOVED = [
    k
    for k, name in enumerate(JOINT_NAMES)
    if k in _HEAD or k > JOINT_NAMES.index("head") or name.endswith(("elbow", "wrist"))
]  # joints whose skin lies elsewhere afterwards


def fit_details(
    fit: BodyFit, views: Sequence[View], people: Sequence[DetectedPerson | None], body: Body | None = None
) -> BodyFit:
    """The ``fit`` of the ``views`` with hands and face as the networks read them in the same pictures.

    Fingers, forearms, neck and head turn; the face's features and the eyes' joints move in ``rest`` and ``joints``;
    hair and sleeves meet the masks anew. What is not believed stays as it was: a hand that no view shows, a face in
    a view from behind or under a scarf. Raises FormatError.
    """
    if not len(fit.views) == len(views) == len(people):
        raise FormatError(f"details need a view and a person each of {len(fit.views)}, not {len(views)}, {len(people)}")
    body = body or open_body()
    rotations = [seen.rotations.copy() for seen in fit.views]
    for side in ("left", "right"):
        _set_hand(body, fit, views, people, side, rotations)
    bare, joints = body.shaped(fit.betas)
    for seen, view, person, turns in zip(fit.views, views, people, rotations, strict=True):
        found = fit_face(body, fit, seen, view, person.face) if person is not None and view.side == "front" else None
        if found is not None:
            turns[_HEAD] = found[0][_HEAD]
            bare = bare + found[1]
            for eye in EYE_SIDES:
                joints[JOINT_NAMES.index(f"{eye}_eye_smplhf")] += found[1][eyeball(body, eye).vertices[0]]
            break  # one picture shapes the face
    if all((turns == seen.rotations).all() for turns, seen in zip(rotations, fit.views, strict=True)):
        return fit  # a face that is believed turns the head at least a little
    poses = [
        fully_posed(body, fit.betas, seen.root, seen.pelvis, turns)
        for seen, turns in zip(fit.views, rotations, strict=True)
    ]
    moved = (body.skin_weights * np.isin(body.skin_joints, _MOVED)).sum(axis=1)
    offsets = moved * dressed(body, bare, poses, views, fit.offsets) + (1 - moved) * fit.offsets
    detailed = assembled(body, bare, joints, offsets, poses, rotations, views, [seen.strays for seen in fit.views])
    told = [replace(seen, doubts=old.doubts) for seen, old in zip(detailed.views, fit.views, strict=True)]
    return replace(detailed, views=tuple(told))


def _set_hand(
    body: Body,
    fit: BodyFit,
    views: Sequence[View],
    people: Sequence[DetectedPerson | None],
    side: str,
    rotations: list[F64],
) -> None:
    """Write one hand into the views' ``rotations`` [55, 3] each; views that do not show it get another's fingers."""
    arm = [JOINT_NAMES.index(f"{side}_{name}") for name in ("elbow", "wrist")]
    fingers: list[F64 | None] = []
    for seen, view, person, turns in zip(fit.views, views, people, rotations, strict=True):
        hand = None if person is None else person.left_hand if side == "left" else person.right_hand
        found = None if hand is None else fit_hand(body, fit, seen, view, hand, side)
        fingers.append(None if found is None else found[_HANDS[side]])
        if found is not None:
            turns[arm] = found[arm]
    known = next((each for each in fingers if each is not None), None)
    for turns, each in zip(rotations, fingers, strict=True):
        if known is not None:
            turns[_HANDS[side]] = known if each is None else each
