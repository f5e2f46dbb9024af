"""Gait phase of a walking user, from arm swing and the head's bob and sway."""

from __future__ import annotations

from math import atan2, cos, exp, hypot, pi, sin, sqrt

from glsplat.tracking.solve.leg import REFERENCE_LEG_M
from glsplat.tracking.solve.quat import Vec, clamp

TURN = 2 * pi
START_SPEED, STOP_SPEED = 0.40, 0.25  # m/s (of a 1.7 m person): walking begins and ends
START_AWAY_M, STOP_AWAY_M = 0.4, 0.2  # from where the body was lately (about 0.8 s ago): likewise
ARM_LAG = 0.06  # turns by which the opposite hand follows the foot's most forward moment
MID_STANCE_PHASE = 0.31  # at which the head is nearest to that foot's side
TRACK_SMOOTHING_S, RATE_SMOOTHING_S = 0.6, 0.03  # of the head's path without sway, of the cues' derivatives
ARM_MEAN_S, HEIGHT_MEAN_S = 1.2, 0.6  # of the means of the cues
FIRST_FREQUENCY = 0.8  # strides a second
MAX_PULL = 0.3  # strides a second by which the natural frequency pulls


class Gait:
    """Phase in turns: 0 = the left foot lands, 0.5 = the right one. A phase-locked loop over three cues.

    Human walking is a strong prior: opposite hand and foot swing together; the head is lowest in double support and
    highest in mid-stance (running: lowest in mid-stance), and sways to the standing foot's side (Perry & Burnfield,
    Gait Analysis, 2010; Collins, Adamczyk & Kuo 2009 for the arms).
    """

    def __init__(self, leg: float) -> None:
        self.size: float = (
            leg / REFERENCE_LEG_M
        )  # length scale of the body; speeds scale by its root (equal Froude number)
        self.pace: float = sqrt(self.size)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.phase: float = 0.0
        self.frequency: float = FIRST_FREQUENCY
        self.walking: bool = False
        self._last: tuple[float, float, float] | None = None  # arm, height, sway
        self._mean = [0.0, 0.0]  # arm, height
        self._rate = [0.0, 0.0, 0.0]
        self._track: tuple[float, float] | None = None

    def duty(self, speed: float) -> float:
        """Return the part of a stride with the foot's ball on the ground: 0.56 walking, falling to 0.34 running."""
        v = speed / self.pace
        return 0.58 - 0.02 * v if v < 1.9 else max(0.542 - 0.3 * (v - 1.9), 0.34)

    def natural_frequency(self, speed: float) -> float:
        """Return the strides a second at a walking or running speed (m/s), by the usual cadence curves."""
        v = speed / self.pace
        return 0.5 * min(1.15 + 0.55 * v, 2.2 + 0.17 * v) / self.pace

    def update(
        self,
        neck: Vec,
        yaw: float,
        left: Vec | None,
        right: Vec | None,
        course: Vec,  # m/s over the last stride
        speed: float,
        away: float,  # metres from where the body was lately: tells walking from swaying
        first_left: bool,  # start with the left foot where the cues are too weak
        dt: float,
    ) -> None:
        """Advance the phase by dt seconds."""
        s, c = sin(yaw), cos(yaw)
        arm = 0.0
        if left is not None and right is not None:
            arm = 0.5 * ((right[0] - left[0]) * s + (right[2] - left[2]) * c)
        # sway is across the way the body goes, whichever way it faces
        way = hypot(course[0], course[2])
        if way > 0.1:
            s, c = course[0] / way, course[2] / way
        if self._track is None:
            self._track = (neck[0], neck[2])
        k = 1 - exp(-dt / TRACK_SMOOTHING_S)
        x, z = self._track
        self._track = x, z = (x + (neck[0] - x) * k, z + (neck[2] - z) * k)
        now = (arm, neck[1], (neck[0] - x) * c - (neck[2] - z) * s)
        if self._last is None:
            self._last, self._mean = now, [0.0, neck[1]]
        smooth = 1 - exp(-dt / RATE_SMOOTHING_S)
        for i in (0, 1, 2):
            self._rate[i] += ((now[i] - self._last[i]) / max(dt, 1e-4) - self._rate[i]) * smooth
        for i, tau in ((0, ARM_MEAN_S), (1, HEIGHT_MEAN_S)):
            self._mean[i] += (now[i] - self._mean[i]) * (1 - exp(-dt / tau))
        self._last = now

        v = speed / self.pace
        starting = not self.walking and v > START_SPEED and away > START_AWAY_M * self.size
        if self.walking and (v < STOP_SPEED or away < STOP_AWAY_M * self.size):
            self.walking = False
        if starting:
            self.walking = True
            self.frequency = self.natural_frequency(speed)
        if not self.walking:
            return
        natural = self.natural_frequency(speed)
        omega = TURN * self.frequency
        # every cue: a phase and a weight
        a, a_rate = arm - (0.0 if starting else self._mean[0]), self._rate[0]
        arm_phase, arm_size = (atan2(-a_rate / omega, a) / TURN) - ARM_LAG, hypot(a, a_rate / omega)
        b, b_rate = neck[1] - self._mean[1], self._rate[1]
        low = 0.06 + 0.12 * clamp((v - 1.9) / 0.6, 0.0, 1.0)
        bob_phase, bob_size = atan2(b_rate / (2 * omega), -b) / (2 * TURN) + low, hypot(b, b_rate / (2 * omega))
        w, w_rate = now[2], self._rate[2]
        sway_phase, sway_size = atan2(-w_rate / omega, w) / TURN + MID_STANCE_PHASE, hypot(w, w_rate / omega)
        arm_weight = clamp(arm_size / (0.12 * self.size), 0.0, 1.0) if left is not None and right is not None else 0.0
        bob_weight = 0.5 * clamp(bob_size / (0.02 * self.size), 0.0, 1.0)
        sway_weight = (0.3 - 0.25 * arm_weight) * clamp(sway_size / (0.02 * self.size), 0.0, 1.0)
        if starting:
            self.phase = arm_phase if arm_weight > 0.4 else (self.duty(speed) if first_left else self.duty(speed) - 0.5)
            self.phase %= 1.0
            return
        error = arm_weight * _wrapped(arm_phase - self.phase, 1.0)
        error += sway_weight * _wrapped(sway_phase - self.phase, 1.0)
        error += bob_weight * _wrapped(bob_phase - self.phase, 0.5)
        total = arm_weight + sway_weight + bob_weight
        error /= max(total, 1.0)
        pull = clamp(natural - self.frequency, -MAX_PULL, MAX_PULL)
        self.frequency = clamp(self.frequency + dt * (3.0 * error + 1.5 * pull), 0.5 * natural, 1.6 * natural)
        rate = self.frequency + 4.0 * error
        self.phase = (self.phase + dt * clamp(rate, 0.3 * self.frequency, 2.5 * self.frequency)) % 1.0


def _wrapped(value: float, period: float) -> float:
    return (value + 0.5 * period) % period - 0.5 * period
