"""The stage of a Tracker for fingers: 25 tracked joints a hand, or a curl from 0 to 1, to 15 rotations of SMPL-X."""

from __future__ import annotations

from math import atan2, exp, sqrt

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.judge import flag_invalid
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import FINGERS, Body
from glsplat.tracking.solve.limits import FINGER_HIGH, FINGER_LOW, THUMB_LIMIT
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, unit

Array = NDArray[np.float64]

RELAXED_CURL = 0.22  # of a hand without tracked fingers
FIST = np.radians([75.0, 95.0, 65.0])  # flexion of the three joints at curl 1
THUMB_FIST = np.radians([[10.0, 25.0, -20.0], [0.0, 25.0, -20.0], [0.0, 35.0, -25.0]])  # left, rotation vectors
MAX_RATE_RAD_S = 40.0  # of each component of a rotation vector
ALTERNATE_BELOW_S = 0.04  # between samples, below which only one hand's fingers are fitted in each sample

# rows of the 25 joints (wrist, thumb 4, then index, middle, ring, pinky 5 each) of each finger's knuckle, or the
# thumb's metacarpal, in the order of SMPL-X: index, middle, pinky, ring, thumb
KNUCKLES = (6, 11, 21, 16, 1)


class BothHandsFingers:
    """The fingers of both hands."""

    def __init__(self, body: Body, smoothing: float) -> None:
        self.hands = (Fingers(body, 0, smoothing), Fingers(body, 1, smoothing))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._count = 0  # of samples
        for hand in self.hands:
            hand.reset()

    def update(
        self, sample: Sample, wrists: tuple[JointPose | None, JointPose | None], dt: float, flags: list[str]
    ) -> list[Array]:
        """Return [15, 3] rotation vectors of the left and the right hand. ``dt`` of 0: the first moment of a body."""
        self._count += 1
        out = []
        for side, (hand, wrist) in enumerate(zip(self.hands, wrists, strict=True)):
            joints, curl = (sample.right_joints, sample.right_curl) if side else (sample.left_joints, sample.left_curl)
            turn = None if wrist is None else wrist[1]
            fit = not 0 < dt < ALTERNATE_BELOW_S or self._count % 2 == side
            try:
                if joints is not None and (len(joints) != 25 or min(map(len, joints)) < 3):
                    raise ValueError
                out.append(hand.update(joints, turn, curl, dt or 1.0, fit))
            except (TypeError, ValueError, IndexError):  # not 25 joints of numbers
                flag_invalid(flags)
                out.append(hand.update(None, turn, None, dt or 1.0))
        return out


class Fingers:
    """One hand's fingers, smoothed."""

    def __init__(self, body: Body, index: int, smoothing: float) -> None:
        self.smoothing = smoothing  # seconds
        sign = 1.0 if index == 0 else -1.0
        joints = body.rest[FINGERS[index]].reshape(5, 3, 3)
        ends = (joints[:, 1] - joints[:, 0], joints[:, 2] - joints[:, 1], joints[:, 2] - joints[:, 1])
        # rest directions of each finger's three bones
        self.bones: list[list[Vec]] = [
            [unit((float(v[f, 0]), float(v[f, 1]), float(v[f, 2]))) for v in ends] for f in range(5)
        ]
        low, high = np.tile(FINGER_LOW, (5, 1, 1)), np.tile(FINGER_HIGH, (5, 1, 1))
        low[4], high[4] = -THUMB_LIMIT, THUMB_LIMIT
        if index == 1:  # turns about y and z change sign
            mirror = np.array([1.0, -1.0, -1.0])
            low, high = np.minimum(low * mirror, high * mirror), np.maximum(low * mirror, high * mirror)
        self.low: Array = low  # [5, 3, 3] finger, joint, rotation vector
        self.high: Array = high
        fist = np.zeros((5, 3, 3))
        fist[:4, :, 2] = -FIST * sign
        fist[4] = THUMB_FIST * np.array([1.0, sign, sign])
        self.fist: Array = np.clip(fist, low, high)
        self.reset()

    def reset(self) -> None:
        """Forget the past: a relaxed hand."""
        self.value: Array = self.fist * RELAXED_CURL
        self.target: Array | None = None

    def update(
        self,
        joints: tuple[tuple[float, ...], ...] | None,
        hand: Quat | None,  # world rotation of the wrist joint that the joints belong to
        curl: float | None,
        dt: float,
        fit: bool = True,
    ) -> Array:
        """Return [15, 3] rotation vectors in SMPL-X's order. Bad joints (not finite, coincident) count as unknown.

        Without ``fit``, tracked fingers go on towards the last fit: at high rates every other sample suffices.
        """
        if joints is None or hand is None:
            target = None
        elif fit or self.target is None:
            target = self.target = self._fit(joints, hand)
        else:
            target = self.target
        if target is None:
            self.target = None
            known = curl is not None and curl == curl
            target = self.fist * (min(max(curl, 0.0), 1.0) if known and curl is not None else RELAXED_CURL)
        most = MAX_RATE_RAD_S * dt
        k = 1.0 if self.smoothing <= 0 else 1 - exp(-dt / self.smoothing)
        self.value = self.value + np.minimum(np.maximum((target - self.value) * k, -most), most)
        return self.value.reshape(15, 3)

    def _fit(self, joints: tuple[tuple[float, ...], ...], hand: Quat) -> Array | None:
        """Turn each bone onto its tracked direction by the smallest rotation, from the knuckle outwards.

        Plain floats: 15 bones are too few for numpy to pay.
        """
        w, x, y, z = hand
        m0, m1, m2 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        m3, m4, m5 = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
        m6, m7, m8 = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
        out: list[float] = []
        for start, bones in zip(KNUCKLES, self.bones, strict=True):
            near = joints[start]
            px = py = pz = qx = qy = qz = 0.0  # the turns v = a x b of this finger's first joints, and their cos
            pc = qc = 1.0
            for level in (0, 1, 2):
                far = joints[start + level + 1]
                dx, dy, dz = far[0] - near[0], far[1] - near[1], far[2] - near[2]
                near = far
                size = dx * dx + dy * dy + dz * dz
                if not 1e-10 < size < 1.0:  # NaN fails as well
                    return None
                k = 1 / sqrt(size)
                dx, dy, dz = dx * k, dy * k, dz * k
                bx, by, bz = m0 * dx + m1 * dy + m2 * dz, m3 * dx + m4 * dy + m5 * dz, m6 * dx + m7 * dy + m8 * dz
                if level:  # into the frame of the joint before: R' b = c b - v x b + v (v.b)/(1 + c)
                    k = (px * bx + py * by + pz * bz) / (1 + pc)
                    bx, by, bz = (
                        pc * bx - py * bz + pz * by + px * k,
                        pc * by - pz * bx + px * bz + py * k,
                        pc * bz - px * by + py * bx + pz * k,
                    )
                    if level == 2:
                        k = (qx * bx + qy * by + qz * bz) / (1 + qc)
                        bx, by, bz = (
                            qc * bx - qy * bz + qz * by + qx * k,
                            qc * by - qz * bx + qx * bz + qy * k,
                            qc * bz - qx * by + qy * bx + qz * k,
                        )
                ax, ay, az = bones[level]
                vx, vy, vz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                c = ax * bx + ay * by + az * bz
                if c < -0.99:  # folded back onto itself: no hand does this
                    return None
                s = sqrt(vx * vx + vy * vy + vz * vz)
                k = atan2(s, c) / s if s > 1e-9 else 1.0
                out += (vx * k, vy * k, vz * k)
                if level == 0:
                    px, py, pz, pc = vx, vy, vz, c
                else:
                    qx, qy, qz, qc = vx, vy, vz, c
        turn: Array = np.array(out).reshape(5, 3, 3)
        return np.minimum(np.maximum(turn, self.low), self.high)
