"""Who stands, by the head alone, and where their feet then are: what network, balance and rest pose say together."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot

from glsplat.tracking.learned.hints import FootHint
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
STAY = 6.0  # seconds likewise, in addition, while they stay
SPOT = 0.3  # metres (likewise) from its mean place that the head of somebody who stays has at most
STAYED = (2.0, 3.0)  # seconds for which it has kept to that: before, nobody is said to stay, and after, they do
CALM, CALMLY = 1.5, (0.4, 0.8)  # seconds of the mean of how surely somebody stands, which says likewise
KNEE = 0.5  # of a foot's shift that its knee takes


class Stance:
    """Where standing feet are, by three guesses of which none has seen them: between the network's and the middle one.

    A lone wild guess is outvoted, and as feet that stand do not move, what is said of them lately is a mean: a long one
    of who stays in one place for seconds, as the head sways over feet that do not.
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
        self.stays: float = 0.0  # how surely they have done so for seconds without a step
        self._before: Vec | None = None
        self._velocity: Vec = (0.0, 0.0, 0.0)
        self._middle: Vec = (0.0, 0.0, 0.0)  # of the head over the ground
        self._yaw = 0.0  # of the head, likewise
        self._for = 0.0  # seconds since the beginning
        self._places: list[Vec] = []
        self._spot: Vec | None = None  # that the head keeps to, a mean
        self._kept = 0.0  # seconds for which it has
        self._calm = 0.0  # how surely somebody has stood lately

    def update(self, targets: Targets, hints: Sequence[FootHint], plain: Sequence[Foot], dt: float) -> float:
        """Brings the hints to where feet stand, as far as somebody stands; how far that is."""
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
        self.stays = tall * self._stayed(eye, dt)
        k = 1 - exp(-dt / (AT_ONCE + LATELY * share + STAY * self.stays))
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

    def _stayed(self, eye: Vec, dt: float) -> float:
        """How surely the head has kept to one place, swaying at most: 0 .. 1."""
        spot = self._spot or eye
        self._kept = self._kept + dt if hypot(eye[0] - spot[0], eye[2] - spot[2]) < SPOT * self.unit else 0.0
        self._spot = pull(spot, eye, max(1 - exp(-dt / STAY), dt / max(self._kept, dt)))
        self._calm += (self.share - self._calm) * max(1 - exp(-dt / CALM), dt / self._for)
        out = 1.0
        for known, (none, all_of_it) in ((self._kept, STAYED), (self._calm, CALMLY)):
            out *= clamp((known - none) / (all_of_it - none), 0.0, 1.0)
        return out

    def _said(self, side: int, hint: FootHint, plain: Foot) -> Vec:
        """By all three, of now."""
        x, _, z = add(self._middle, rotate(yaw_quat(self._yaw), self.home[side]))
        ball, other = hint.ball, plain.ball
        middle = (sorted((x, ball[0], other[0]))[1], ball[1], sorted((z, ball[2], other[2]))[1])
        return pull(middle, ball, NETWORK)
