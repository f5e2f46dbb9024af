"""Standing users, detected by the head alone, and their feet: combined from network, balance and rest pose."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot

from glsplat.extras.learned.hints import FootHint
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.quat import Vec, add, clamp, pull, rotate, scale, sub, swing_twist_y, wrap, yaw_quat
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.stepping.foot import Foot

__all__ = ["Stance"]

DRIFT = 0.4  # seconds of the low pass of the head's velocity: who sways or gestures comes back
STANDS, MOVES = 0.08, 0.3  # m/s (of eyes at 1.6 m) of that below which somebody stands, above which they do not
TALL = (0.82, 0.9)  # of the eye height: lower, somebody squats or sits, higher, they stand
NETWORK = 0.5  # of a standing foot's place that is the network's; the rest is the middle one of all three
HOME = (0.17, 0.14)  # metres (likewise) that balls of standing feet are aside of and behind the eyes, in the median
LATELY = 0.6  # seconds over which the head's place and the feet's places are a mean while somebody stands
AT_ONCE = 0.02  # seconds likewise, while they do not
KNEE = 0.5  # of a foot's shift that its knee takes


class Stance:
    """Positions of standing feet from three guesses: half way between the network's and the median.

    The median rejects a lone wild guess. Standing feet do not move, so recent guesses are averaged.
    """

    def __init__(self, body: Body) -> None:
        self.eye_height: float = body.eye_height
        self.unit: float = body.eye_height / 1.6
        aside, behind = [metres * self.unit for metres in HOME]
        self.home: tuple[Vec, Vec] = ((aside, 0.0, -behind), (-aside, 0.0, -behind))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.share: float = 1.0  # how surely somebody stands: 0 .. 1
        self._before: Vec | None = None
        self._velocity: Vec = (0.0, 0.0, 0.0)
        self._middle: Vec = (0.0, 0.0, 0.0)  # of the head over the ground
        self._yaw = 0.0  # of the head, likewise
        self._for = 0.0  # seconds since the beginning
        self._places: list[Vec] = []

    def update(self, targets: Targets, hints: Sequence[FootHint], plain: Sequence[Foot], dt: float) -> float:
        """Move the hints to where feet stand, by the weight of standing; return that weight."""
        eye, seen = targets.eye, swing_twist_y(targets.head)
        if self._before is None:
            self._before, self._middle, self._yaw = eye, eye, seen or 0.0
        self._for += dt
        least = dt / self._for  # a start in mid-walk: the first velocities count at once
        velocity = scale(sub(eye, self._before), 1 / dt)
        self._velocity = pull(self._velocity, velocity, max(1 - exp(-dt / DRIFT), least))
        self._before = eye
        drift = hypot(self._velocity[0], self._velocity[2]) / self.unit
        low, high = TALL
        tall = clamp((eye[1] / self.eye_height - low) / (high - low), 0.0, 1.0)
        self.share = share = tall * clamp((MOVES - drift) / (MOVES - STANDS), 0.0, 1.0)
        k = 1 - exp(-dt / (AT_ONCE + LATELY * share))
        self._middle = pull(self._middle, eye, max(k, least))
        self._yaw = wrap(self._yaw + wrap((self._yaw if seen is None else seen) - self._yaw) * max(k, least))
        places = [self._said(i, hint, foot) for i, (hint, foot) in enumerate(zip(hints, plain, strict=True))]
        if not self._places:
            self._places = places
        self._places = [pull(a, b, max(k, least)) for a, b in zip(self._places, places, strict=True)]
        for hint, place in zip(hints, self._places, strict=True):
            x, z = share * (place[0] - hint.ball[0]), share * (place[2] - hint.ball[2])
            hint.ball = add(hint.ball, (x, 0.0, z))
            hint.knee = add(hint.knee, (KNEE * x, 0.0, KNEE * z))
        return share

    def _said(self, side: int, hint: FootHint, plain: Foot) -> Vec:
        """Return the combined position of this moment."""
        x, _, z = add(self._middle, rotate(yaw_quat(self._yaw), self.home[side]))
        ball, other = hint.ball, plain.ball
        middle = (sorted((x, ball[0], other[0]))[1], ball[1], sorted((z, ball[2], other[2]))[1])
        return pull(middle, ball, NETWORK)
