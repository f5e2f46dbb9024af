"""Priors of the pose for several starts of a fit.

An arm in front of the belly and one behind the back have similar landmarks and outlines, and descent does not pass
from one to the other. The pose network's rough world landmarks usually tell them apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import BETAS, Body
from glsplat.extras.authoring.compute.solvers import least_squares
from glsplat.extras.authoring.fit.kinematics import PLACE, PosedBody
from glsplat.extras.authoring.fit.prior import ARM_BONES, HINGES, MEAN, POSED, SPREAD, PosePrior, arm_mixture
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import degrees_between
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

MIN_ASIDE_RAD = 0.35
"""Turn of a person who has turned aside; the network's world landmarks underestimate larger turns."""
_SIDES = ("left", "right")
_ARM_JOINTS, _LEG_JOINTS = ("shoulder", "elbow"), ("hip", "knee")
_LEG_BONES = tuple(
    (f"{side}_{upper}", f"{side}_{lower}") for side in _SIDES for upper, lower in (("hip", "knee"), ("knee", "ankle"))
)
_TRUNK_BONES = tuple((f"left_{name}", f"right_{name}") for name in ("shoulder", "hip"))
_BONE_SD = 0.12  # of the network's unit vectors along bones
_MAX_TURN_ERROR_DEG = 60.0  # between the shoulders' turn and the view's; with a larger one all depths are wrong
_MAX_HEAD_TURN_RAD = 0.5  # between face and trunk, for the face to correct the trunk's turn
_TURN_SD_RAD = 0.1  # of the turn from network and face
_SHAPE_SD = 0.8  # narrower than usual, because in foreshortened limbs a stout body looks like bent knees
_MIN_CROSSED_SINE = 0.6  # sideways component of crossed forearms
_CROSSED_SLEEVE_FRACTION, _SLEEVE_FRACTION = 0.03, 0.008  # of the height; elbows of crossed arms err by 5 to 7 cm
_READ_SD_RAD = 1.2  # of angles about the mean, while they are fitted to the network's bones
_STANCE_SD_RAD = {"shoulder": 0.35, "elbow": 0.35, "hip": 0.15, "knee": 0.15}  # about the angles read
_AT_EASE_SD_RAD: dict[tuple[str, int], float] = {
    ("elbow", 1): 0.5,
    ("elbow", 2): 0.25,
    **{("shoulder", axis): 0.45 for axis in range(3)},
    **{("hip", axis): 0.2 for axis in range(3)},
    ("knee", 0): 0.2,
}  # about the mean


def stances_of(view: View, body: Body) -> tuple[PosePrior, ...]:
    """Return the priors of a view's pose: posed, and with world landmarks also as these, and like other people.

    With world landmarks that are not trusted the second one is a pose at ease.
    """
    if view.world is None:
        return (POSED,)
    world = trusted_world(view)
    loose = SPREAD.copy()
    for column, (name, axis) in enumerate(HINGES.names):
        loose[column] = max(loose[column], _AT_EASE_SD_RAD.get((_plain(name), axis), 0.0))
    at_ease = PosePrior("at ease", MEAN, loose)
    if world is None:
        return POSED, at_ease
    angles, turn = _angles_along(world, view, body)
    turn = _corrected_by_face(view, turn)
    legs = np.array([_plain(name) in _LEG_JOINTS for name, _ in HINGES.names])
    about = np.array(
        [
            max(wide, _STANCE_SD_RAD[_plain(name)])
            if _plain(name) in _LEG_JOINTS
            else _STANCE_SD_RAD.get(_plain(name), wide)
            for (name, _), wide in zip(HINGES.names, loose, strict=True)
        ]
    )
    bones = _directions(world, ARM_BONES)
    crossed = bones[1, 0] < -_MIN_CROSSED_SINE and bones[3, 0] > _MIN_CROSSED_SINE
    common = turn, _TURN_SD_RAD, _SHAPE_SD, _CROSSED_SLEEVE_FRACTION if crossed else _SLEEVE_FRACTION
    usual = np.where(legs, angles, MEAN)
    return (
        POSED,
        PosePrior("read", angles, about, *common, bones=bones),
        PosePrior("like others", usual, about, *common, angles, arm_mixture(), bones),
    )


def _corrected_by_face(view: View, turn: float) -> float:
    """Return the trunk's ``turn`` in radians, corrected by the face's, because turned people look at the camera."""
    if view.face is None:
        return turn
    faced = -float(np.radians((view.face - view.turn + 180) % 360 - 180))  # about the camera's y, which looks down
    if abs(faced - turn) > _MAX_HEAD_TURN_RAD:
        return turn
    return faced if abs(faced) > abs(turn) > MIN_ASIDE_RAD and faced * turn > 0 else (turn + faced) / 2


def trusted_world(view: View) -> F64 | None:
    """Return the view's world landmarks [33, 3] if they face the side that the view shows, else None."""
    if view.world is None:
        return None
    across = view.world[LANDMARKS.index("left_shoulder")] - view.world[LANDMARKS.index("right_shoulder")]
    turn = float(np.degrees(np.arctan2(across[2], across[0])))
    return view.world if degrees_between(turn, view.turn) <= _MAX_TURN_ERROR_DEG else None


def arm_direction_error(world: F64, joints: F64) -> float:
    """Return the mean distance (0 to 2) of unit vectors along the arms of ``world`` [33, 3] and ``joints`` [55, 3].

    Both are in camera axes, metres.
    """
    starts, ends = ([JOINT_NAMES.index(bone[k]) for bone in ARM_BONES] for k in (0, 1))
    away = _directions(world, ARM_BONES) - unit_vectors(joints[ends] - joints[starts])
    return float(np.linalg.norm(away, axis=1).mean())


def _plain(name: str) -> str:
    """Return a joint's name without its side."""
    return name.removeprefix("left_").removeprefix("right_")


def _angles_along(world: F64, view: View, body: Body) -> tuple[F64, float]:
    """Return the angles [D] of arms and legs, and the turn, that point bones along those of ``world`` [33, 3]."""
    columns = np.array([k for k, (name, _) in enumerate(HINGES.names) if _plain(name) in _ARM_JOINTS + _LEG_JOINTS])
    bones = (*ARM_BONES, *_LEG_BONES, *_TRUNK_BONES)
    target = _directions(world, bones)
    ends = body.points_of_joints([name for bone in bones for name in bone])
    place = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])

    def equations(x: F64, derive: bool) -> tuple[F64, F64]:
        angles = MEAN.copy()
        angles[columns] = x[1:]
        place[4] = x[0]
        where, moves = PosedBody(body, HINGES, view.facing, np.zeros(BETAS), place, angles).derivatives(ends)
        bone, change = where[1::2] - where[::2], (moves[1::2] - moves[::2])[..., BETAS:]
        length = np.linalg.norm(bone, axis=1)[:, None]
        unit = bone / length
        residual = np.concatenate([((unit - target) / _BONE_SD).ravel(), (x[1:] - MEAN[columns]) / _READ_SD_RAD])
        if not derive:
            return residual, np.zeros((0, 0))
        change = change[..., np.concatenate([[4], PLACE + columns])]
        along = np.einsum("bc,bcp->bp", unit, change)
        slope = (change - unit[..., None] * along[:, None]) / length[..., None] / _BONE_SD
        free = np.eye(len(x))[1:] / _READ_SD_RAD
        return residual, np.concatenate([slope.reshape(-1, len(x)), free])

    x = least_squares(equations, np.concatenate([[0.0], MEAN[columns]]), 30)
    angles = MEAN.copy()
    angles[columns] = x[1:]
    return angles, float(x[0])


def _directions(world: F64, bones: Sequence[tuple[str, str]]) -> F64:
    """Return unit vectors [B, 3] along bones between landmarks."""
    return unit_vectors(np.array([world[LANDMARKS.index(end)] - world[LANDMARKS.index(start)] for start, end in bones]))
