"""Several ways in which somebody may stand, for a fit to begin with: one alone takes crossed arms for spread ones.

A picture is flat, so an arm before the belly and one behind the back look alike to landmarks and outline, and descent
does not go from one to the other. The pose network's rough metres know which it is, most of the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import BETAS, Body
from glsplat.extras.authoring.compute.levenberg import least_squares
from glsplat.extras.authoring.fit.kinematics import PLACE, PosedBody
from glsplat.extras.authoring.fit.prior import ARM_BONES, HINGES, MEAN, POSED, SPREAD, PosePrior
from glsplat.extras.authoring.fit.standing.arms import arm_mixture
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import degrees_between
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["ASIDE", "metres_of", "misread", "stances_of"]

F64 = NDArray[np.float64]

ASIDE = 0.35
"""Radians of the metres' turn from which on somebody has turned aside; from there on these fall short of the truth."""

_SIDES = ("left", "right")
_ARMS, _LEGS = ("shoulder", "elbow"), ("hip", "knee")
_NUMBERS = {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27}  # left; the right is next
_LEG_BONES = tuple(
    (f"{side}_{upper}", f"{side}_{lower}") for side in _SIDES for upper, lower in (("hip", "knee"), ("knee", "ankle"))
)
_ACROSS = tuple((f"left_{name}", f"right_{name}") for name in ("shoulder", "hip"))
_DIRECTION = 0.12  # how far off a bone's rough direction is, as a share of its length
_TURNED = 60.0  # degrees between the shoulders' turn and the view's: a network that errs there errs in all depths
_LOOKS = 0.5  # radians that a head may be turned for the trunk to be taken to be turned like it
_TURN = 0.1  # radians about the turn that metres and face have said
_SHAPE = 0.8  # of shape, one standard deviation: where limbs fore-shorten, a stout body looks like knees that bend
_CROSSED = 0.6  # so much across, each to the other side, do crossed forearms point
_SLEEVES = 0.03, 0.008  # of the figure: of crossed arms, whose elbows' landmarks stray by 5 to 7 cm, and of others
_FREE = 1.2  # radians that an angle may leave the mean for it
_READ = {"shoulder": 0.35, "elbow": 0.35, "hip": 0.15, "knee": 0.15}  # radians about what was read
_LOOSE: dict[tuple[str, int], float] = {
    ("elbow", 1): 0.5,
    ("elbow", 2): 0.25,
    **{("shoulder", axis): 0.45 for axis in range(3)},
    **{("hip", axis): 0.2 for axis in range(3)},
    ("knee", 0): 0.2,
}  # radians about the mean


def stances_of(view: View, body: Body) -> tuple[PosePrior, ...]:
    """How the person of a view may stand: posed as asked; where the view has metres, as these say, and like others.

    Metres that are not believed leave somebody at ease.
    """
    if view.world is None:
        return (POSED,)
    metres = metres_of(view)
    loose = SPREAD.copy()
    for column, (name, axis) in enumerate(HINGES.names):
        loose[column] = max(loose[column], _LOOSE.get((_plain(name), axis), 0.0))
    at_ease = PosePrior("at ease", MEAN, loose)
    if metres is None:
        return POSED, at_ease
    angles, turn = _read(metres, view, body)
    turn = _faced(view, turn)
    legs = np.array([_plain(name) in _LEGS for name, _ in HINGES.names])
    about = np.array(
        [
            max(wide, _READ[_plain(name)]) if _plain(name) in _LEGS else _READ.get(_plain(name), wide)
            for (name, _), wide in zip(HINGES.names, loose, strict=True)
        ]
    )
    said = unit_vectors(np.array([_at(metres, end) - _at(metres, start) for start, end in ARM_BONES]))
    crossed = said[1, 0] < -_CROSSED and said[3, 0] > _CROSSED
    sleeve = _SLEEVES[0 if crossed else 1]
    read = PosePrior("read", angles, about, turn, _TURN, _SHAPE, sleeve, bones=said)
    usual = np.where(legs, angles, MEAN)
    return POSED, read, PosePrior("like others", usual, about, turn, _TURN, _SHAPE, sleeve, angles, arm_mixture(), said)


def _faced(view: View, turn: float) -> float:
    """The metres' ``turn`` in radians, put right by the face's: who is turned looks at the camera, not past it."""
    if view.face is None:
        return turn
    faced = -float(np.radians((view.face - view.turn + 180) % 360 - 180))  # about the camera's y, which looks down
    if abs(faced - turn) > _LOOKS:
        return turn
    return faced if abs(faced) > abs(turn) > ASIDE and faced * turn > 0 else (turn + faced) / 2


def metres_of(view: View) -> F64 | None:
    """[33, 3] the network's metres of a view where it has any that face the side that the view shows, else None."""
    if view.world is None:
        return None
    across = _at(view.world, "left_shoulder") - _at(view.world, "right_shoulder")
    turn = float(np.degrees(np.arctan2(across[2], across[0])))
    return view.world if degrees_between(turn, view.turn) <= _TURNED else None


def misread(world: F64, joints: F64) -> float:
    """How far the arms of fitted ``joints`` [55, 3] point elsewhere than those of the network's metres [33, 3].

    Mean distance between unit vectors along upper arms and forearms, 0 to 2; both in camera axes.
    """
    said = unit_vectors(np.array([_at(world, end) - _at(world, start) for start, end in ARM_BONES]))
    starts, ends = ([JOINT_NAMES.index(bone[k]) for bone in ARM_BONES] for k in (0, 1))
    return float(np.linalg.norm(said - unit_vectors(joints[ends] - joints[starts]), axis=1).mean())


def _plain(name: str) -> str:
    """A joint's name without its side."""
    return name.removeprefix("left_").removeprefix("right_")


def _read(metres: F64, view: View, body: Body) -> tuple[F64, float]:
    """[D] angles of arms and legs, and the turn, that point the bones as the network's ``metres`` [33, 3] do."""
    columns = np.array([k for k, (name, _) in enumerate(HINGES.names) if _plain(name) in _ARMS + _LEGS])
    bones = (*ARM_BONES, *_LEG_BONES, *_ACROSS)
    said = unit_vectors(np.array([_at(metres, end) - _at(metres, start) for start, end in bones]))
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
        residual = np.concatenate([((unit - said) / _DIRECTION).ravel(), (x[1:] - MEAN[columns]) / _FREE])
        if not derive:
            return residual, np.zeros((0, 0))
        change = change[..., np.concatenate([[4], PLACE + columns])]
        along = np.einsum("bc,bcp->bp", unit, change)
        slope = (change - unit[..., None] * along[:, None]) / length[..., None] / _DIRECTION
        free = np.eye(len(x))[1:] / _FREE
        return residual, np.concatenate([slope.reshape(-1, len(x)), free])

    x = least_squares(equations, np.concatenate([[0.0], MEAN[columns]]), 30)
    angles = MEAN.copy()
    angles[columns] = x[1:]
    return angles, float(x[0])


def _at(world: F64, joint: str) -> F64:
    return np.asarray(world[_NUMBERS[_plain(joint)] + joint.startswith("right_")])
