"""Hands to reach for: a lost one is held for a moment, then sinks to the side; a found one is taken up again."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

from glsplat.tracking.solve.arms import Arm
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, conj, mul, nlerp, pull, rotate, sub, to_quat, unit
from glsplat.tracking.solve.spine import Torso

__all__ = ["Hands"]

HOLD, SINK, REGAIN = 0.25, 0.35, 0.2  # seconds: a lost hand stays, sinks to the side, is taken up again


@dataclass(slots=True)
class _Memory:
    """Where a hand was last, in the chest's frame."""

    at: Vec = (0.0, 0.0, 0.0)
    turn: Quat = IDENTITY
    known: bool = False
    lost: float = 0.0  # seconds
    away: float = 0.0  # 1 lost .. 0 tracked


class Hands:
    """Both hands, remembered in the chest's frame."""

    def __init__(self, arms: tuple[Arm, Arm]) -> None:
        self.arms = arms
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._memory = (_Memory(), _Memory())

    def reach_for(self, index: int, at: Vec | None, hand: Quat, torso: Torso, dt: float) -> tuple[Vec, Quat]:
        """Place and rotation of hand ``index``, which is tracked at ``at``, or lost (None)."""
        memory = self._memory[index]
        inverse = conj(torso.spine3)
        if at is not None and memory.away <= 0:
            memory.at, memory.turn = rotate(inverse, sub(at, torso.spine3_at)), mul(inverse, hand)
            memory.lost, memory.known = 0.0, True
            return at, hand
        if at is not None:  # found again: over in a moment
            memory.away = max(0.0, memory.away - dt / REGAIN)
            memory.lost = 0.0
        else:
            memory.away = 1.0
            memory.lost += dt
        rest_at, rest_turn = self._relaxed(index, torso)
        if not memory.known:  # never seen
            memory.at, memory.turn, memory.known, memory.lost = rest_at, rest_turn, True, HOLD
        if memory.lost > HOLD:
            k = 1 - exp(-dt / SINK)
            memory.at, memory.turn = pull(memory.at, rest_at, k), nlerp(memory.turn, rest_turn, k)
        free = rotate(torso.spine3, memory.at)
        place = (torso.spine3_at[0] + free[0], torso.spine3_at[1] + free[1], torso.spine3_at[2] + free[2])
        turn = mul(torso.spine3, memory.turn)
        if at is not None:
            e = memory.away * memory.away * (3 - 2 * memory.away)
            return pull(at, place, e), nlerp(hand, turn, e)
        return place, turn

    def _relaxed(self, index: int, torso: Torso) -> tuple[Vec, Quat]:
        """A hanging hand, the palm towards the thigh, in the chest's frame: gravity and the pelvis decide where."""
        arm = self.arms[index]
        sign = arm.sign
        inverse = conj(torso.spine3)
        down = unit(rotate(inverse, rotate(torso.pelvis, (0.12 * sign, -1.0, 0.12))))
        far = 0.96 * arm.reach
        x, y, z = arm.rest
        turn = mul(inverse, mul(torso.pelvis, to_quat((0.0, 0.0, -1.45 * sign))))
        return (x + down[0] * far, y + down[1] * far, z + down[2] * far), turn
