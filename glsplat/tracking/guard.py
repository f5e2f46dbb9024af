"""The stage of a Tracker that bounds speeds and keeps soles on the floor, whatever the solver returns."""

from __future__ import annotations

from math import acos, cos

from glsplat.tracking.solve.body import ANKLES, FEET, HIPS, KNEES, PELVIS, Body
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, add, distance, mul, nlerp, pull, rotate, slerp
from glsplat.tracking.solve.solution import Solution

LEGS = tuple(zip(HIPS, KNEES, ANKLES, FEET, strict=True))
LEG_JOINTS = frozenset((*HIPS, *KNEES, *ANKLES))
MAX_UNDER_FLOOR_M = 0.008  # of a sole
STEP_PARTS = (0.7, 0.5, 0.35, 0.25, 0.12, 0.06)  # tried in turn where a whole step is too fast


class Guard:
    """Bound the step from the pose shown last to the next one. Changes solutions in place."""

    def __init__(self, body: Body, joint_speed: float, root_speed: float, foot_speed: float) -> None:
        self.body = body
        self.joint_speed, self.root_speed, self.foot_speed = joint_speed, root_speed, foot_speed  # rad/s, m/s, m/s
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next pose passes unchanged, but for the floor."""
        self.last: Solution | None = None
        self.feet: list[Vec] = []

    def update(self, solution: Solution, dt: float) -> None:
        """Bound the speeds of joints, pelvis and feet, and lift soles to the floor. ``dt`` of 0: no past."""
        last = self.last if dt > 0 else None
        slipped = last is not None and self._rates(solution, last, dt)
        if slipped:
            solution.planted, solution.feet = (False, False), (None, None)
        feet, low = self._feet(solution)
        if low < -MAX_UNDER_FLOOR_M or (last is not None and self._fastest(feet, solution, last, dt) > 0):
            solution.planted = (False, False)
            solution.notes.append("limited")
            feet = self._less(solution, last, dt) if last is not None else self._raised(solution, low)
        self.last, self.feet = solution, feet

    def _rates(self, solution: Solution, last: Solution, dt: float) -> bool:
        """Bound the speeds of joints and pelvis. Return whether this moved a foot."""
        most = self.joint_speed * dt
        safe = cos(0.5 * min(most, 3.0))
        rotations, slipped, joint = solution.rotations, False, 0
        for (aw, ax, ay, az), (bw, bx, by, bz) in zip(last.rotations, rotations, strict=True):
            dot = aw * bw + ax * bx + ay * by + az * bz
            if -safe < dot < safe:
                old, new, angle = last.rotations[joint], rotations[joint], 2 * acos(min(abs(dot), 1.0))
                turned = slerp(old, new, most / angle) if angle > 0.1 else nlerp(old, new, most / angle)
                slipped = slipped or joint in LEG_JOINTS or joint == PELVIS
                rotations[joint] = _inside(joint, old, turned, safe)
            joint += 1
        far = distance(solution.pelvis, last.pelvis)
        reach = self.root_speed * dt
        if far > reach:
            slipped = True
            solution.pelvis = pull(last.pelvis, solution.pelvis, reach / far)
        return slipped

    def _less(self, solution: Solution, last: Solution, dt: float) -> list[Vec]:
        """Take the largest part of the step that brings no foot below the floor and moves none too fast."""
        whole = [*solution.rotations]
        pelvis = solution.pelvis
        safe = cos(0.5 * min(self.joint_speed * dt, 3.0))
        solution.feet = (None, None)
        for part in (1.0, *STEP_PARTS):
            if part < 1:
                for joint, old in enumerate(last.rotations):
                    solution.rotations[joint] = _inside(joint, old, slerp(old, whole[joint], part), safe)
                solution.pelvis = pull(last.pelvis, pelvis, part)
            feet, low = self._feet(solution)
            if low < -MAX_UNDER_FLOOR_M:
                feet = self._raised(solution, low)
            near = distance(solution.pelvis, last.pelvis) <= self.root_speed * dt
            if near and self._fastest(feet, solution, last, dt) <= 0:
                return feet
        solution.rotations[:] = last.rotations
        solution.pelvis = last.pelvis
        return self.feet

    def _raised(self, solution: Solution, low: float) -> list[Vec]:
        x, y, z = solution.pelvis
        solution.pelvis = (x, y - low - 0.5 * MAX_UNDER_FLOOR_M, z)
        return self._feet(solution)[0]

    def _fastest(self, feet: list[Vec], solution: Solution, last: Solution, dt: float) -> float:
        """Return the metres by which the faster foot goes too far."""
        root = distance(solution.pelvis, last.pelvis)
        far = max(distance(new, old) for new, old in zip(feet, self.feet, strict=True))
        return far - root - self.foot_speed * dt

    def _feet(self, solution: Solution) -> tuple[list[Vec], float]:
        """Return the balls of both feet, and the height of their lowest point over the floor, metres."""
        balls, low, sole = [], 1e9, self.body.sole
        for side, leg in enumerate(LEGS):
            ball = solution.feet[side]
            if ball is None:
                at, turn = solution.pelvis, solution.rotations[PELVIS]
                for joint in leg:
                    at = add(at, rotate(turn, self.body.offsets[joint]))
                    turn = mul(turn, solution.rotations[joint] if joint < FEET[0] else IDENTITY)
                    low = min(low, at[1] - sole)
                ball = at
            low = min(low, ball[1] - sole)
            balls.append(ball)
        return balls, low


def _inside(joint: int, old: Quat, turned: Quat, safe: float) -> Quat:
    """Bring a rotation inside the joint's limits without turning further from ``old`` than allowed."""
    inside, part = clamp_joint(joint, turned), 1.0  # the way from limit to limit may leave them
    # and clamping may turn the joint further than it may turn: then take less of the step
    while part > 0.03 and abs(sum(a * b for a, b in zip(old, inside, strict=True))) < safe - 1e-9:
        part *= 0.5
        inside = clamp_joint(joint, slerp(old, turned, part))
    return inside if part > 0.03 else old
