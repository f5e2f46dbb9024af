"""Signs of how far the network and the analytic solver may be believed: what was seen lately, and where they differ."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, log

from glsplat.tracking.learned.hints import Hint
from glsplat.tracking.solve.body import PELVIS, Body
from glsplat.tracking.solve.quat import Vec, add, clamp, length, rotate, sub, swing_twist_y, wrap, yaw_quat
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.spine import Torso
from glsplat.tracking.solve.stepping.legs import Legs

__all__ = ["SIGNS", "Signs"]

SIGNS = 50
"""How many there are. Lengths are in units of eyes at 1.6 m, logarithms of them and of m/s over FLOOR."""

FLOOR = 0.02  # metres, m/s, rad/s: what is smaller is as good as nothing
LATELY = (0.25, 1.0, 4.0)  # seconds: of running means
WALKS = (0.25, 0.6)  # m/s of the head over the ground, in the mean of a second: stands below, walks above
PEAK = 20.0  # seconds in which the tallest height is forgotten


@dataclass(slots=True)
class _Means:
    """Running means of one number, one for each of LATELY."""

    at: list[float]

    def update(self, value: float, dt: float) -> list[float]:
        self.at = [a + (value - a) * (1 - exp(-dt / tau)) for a, tau in zip(self.at, LATELY, strict=True)]
        return self.at


class Signs:
    """Both bodies and the targets, as numbers that do not know the room, nor left from right."""

    def __init__(self, body: Body) -> None:
        self.k: float = 1.6 / body.eye_height
        self.rest: float = body.joints[PELVIS][1] - body.ground
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._before: tuple[Vec, float, list[Vec | None]] | None = None
        self._place: list[Vec] = []
        self._tall = self._time = 0.0
        self._speed, self._rise, self._turn, self._hands, self._pelvis, self._feet, self._height = (
            _Means([0.0] * len(LATELY)) for _ in range(7)
        )

    @property
    def standing(self) -> float:
        """1 for somebody whose head has hardly gone anywhere lately .. 0 who walks."""
        slow, fast = WALKS
        part = clamp((fast - self._speed.at[1]) / (fast - slow), 0.0, 1.0)
        return part * part * (3 - 2 * part)

    def update(self, targets: Targets, hint: Hint, guessed: Torso, plain: Torso, legs: Legs, dt: float) -> list[float]:
        """[SIGNS] of this moment. ``guessed``: the network's torso; ``plain`` and ``legs``: the analytic body."""
        k, eye = self.k, targets.eye
        yaw = swing_twist_y(targets.head)
        if yaw is None:
            yaw = self._before[1] if self._before else 0.0
        level = yaw_quat(-yaw)
        hands = [None if at is None else sub(at, eye) for at in (targets.left, targets.right)]
        first = self._before is None
        then, turned, held = self._before or (eye, yaw, hands)
        self._before = (eye, yaw, hands)
        rate = 1 / max(dt, 1e-4)
        self._time += dt
        if first:
            self._place, self._tall = [eye] * len(LATELY), eye[1]
            self._height.at = [eye[1] * k] * len(LATELY)
        moved = sub(eye, then)
        speed = self._speed.update(hypot(moved[0], moved[2]) * rate * k, dt)
        rise = self._rise.update(abs(moved[1]) * rate * k, dt)
        turn = self._turn.update(abs(wrap(yaw - turned)) * rate, dt)
        swung = [length(sub(a, b)) * rate * k for a, b in zip(hands, held, strict=True) if a and b]
        waves = self._hands.update(max(swung, default=0.0), dt)
        height = self._height.update(eye[1] * k, dt)
        self._tall = max(eye[1], self._tall + (eye[1] - self._tall) * (1 - exp(-dt / PEAK)))
        self._place = [
            add(a, tuple([(e - v) * (1 - exp(-dt / tau)) for e, v in zip(eye, a, strict=True)]))  # type: ignore[arg-type]
            for a, tau in zip(self._place, LATELY, strict=True)
        ]
        away = [hypot(a[0] - eye[0], a[2] - eye[2]) * k for a in self._place]
        up, ahead, side = (rotate(targets.head, v)[1] for v in ((0, 1, 0), (0, 0, 1), (1, 0, 0)))
        seen = [hand for hand in hands if hand] or [(0.0, -0.7 / k, 0.0)]
        out = [eye[1] * k, up, ahead, abs(side), *map(_log, speed), *map(_log, rise[:2]), *map(_log, turn[1:])]
        out += [*map(_log, away[1:]), height[2] - eye[1] * k, (self._tall - eye[1]) * k]
        out += [
            float(sum(hand is not None for hand in hands)),
            max(v[1] for v in seen) * k,
            min(v[1] for v in seen) * k,
        ]
        far = [hypot(v[0], v[2]) * k for v in seen]
        out += [max(far), min(far), *map(_log, waves[:2]), length(sub(seen[0], seen[-1])) * k]

        off = rotate(level, sub(guessed.pelvis_at, plain.pelvis_at))
        apart = hypot(off[0], off[2]) * k
        out += [_log(apart), off[2] * k, abs(off[0]) * k, off[1] * k, _log(self._pelvis.update(apart, dt)[1])]
        balls = [foot.ball for foot in hint.feet], [foot.ball for foot in legs.feet]
        gaps = [length(sub(a, b)) * k for a, b in zip(*balls, strict=True)]
        out += [_log(0.5 * sum(gaps)), max(gaps), _log(self._feet.update(0.5 * sum(gaps), dt)[1])]
        a, b = swing_twist_y(guessed.pelvis), swing_twist_y(plain.pelvis)
        out += [0.0 if a is None or b is None else abs(wrap(a - b))]
        for torso, feet in zip((guessed, plain), balls, strict=True):
            x, y, z = rotate(level, sub(torso.pelvis_at, eye))
            middle = rotate(level, sub(tuple([0.5 * (p + q) for p, q in zip(*feet, strict=True)]), torso.pelvis_at))
            out += [z * k, abs(x) * k, y * k, middle[2] * k, abs(middle[0]) * k]
            out += [hypot(feet[0][0] - feet[1][0], feet[0][2] - feet[1][2]) * k]
        stands = [foot.stands for foot in hint.feet]
        out += [min(stands), max(stands), 0.5 * sum(foot.sure for foot in hint.feet)]
        out += [0.5 * sum(foot.planted for foot in legs.feet), float(legs.gait.walking), min(self._time, 10.0) / 10]
        return out


def _log(value: float) -> float:
    return log(FLOOR + value)
