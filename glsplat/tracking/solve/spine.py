"""Torso: from the head to the pelvis. Neck and spine share bend and twist; the head stays exactly where it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, exp, hypot, pi, sqrt

from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import HEAD, NECK, SPINE1, SPINE2, SPINE3, Body
from glsplat.tracking.solve.heading import head_pitch, head_roll
from glsplat.tracking.solve.limits import BOXES
from glsplat.tracking.solve.quat import Quat, Vec, clamp, mul, rotate, sub, to_quat, wrap, yaw_quat

SPINES = (SPINE1, SPINE2, SPINE3)

# neck and head together, radians: flexion, extension, side, rotation (AAOS 45/45/45/60 for the neck; the joint between
# skull and atlas adds about 15 of nodding: Panjabi 1988)
MAX_FLEXION, MAX_EXTENSION, MAX_SIDE, MAX_ROTATION = 1.0, 1.05, 0.75, 1.15
NECK_SHARE = 0.45  # of the turn from chest to head that the neck joint takes, the head joint takes the rest
CHEST_TURN = 0.25  # of the head's turn that the chest follows
MAX_PELVIS_TILT_RAD = 0.5  # between the pelvis and the line from it to the neck
LEAN_SMOOTHING_S = 0.05
SHIFT_SMOOTHING_S, SHIFT_SHARE = 0.4, 0.5  # how the pelvis follows a neck that leaves the feet
LEAN_BACK_RAD = 0.12  # of a torso, before it shows, and all of it at twice that
MIN_PELVIS_HEIGHT = 0.19  # of the eye height: a deep squat, or sitting on the heels


@dataclass(slots=True)
class Torso:
    """World rotations and positions of pelvis, spine, neck and head joints."""

    pelvis: Quat
    third: Quat  # local rotation of each of the three spine joints
    spine3: Quat
    neck: Quat
    head: Quat
    pelvis_at: Vec
    spine3_at: Vec
    neck_at: Vec
    head_off: float  # radians the head had to give up to the neck's limits


class Spine:
    """Bends the torso below the head. Keeps its smoothed lean and the last neck."""

    def __init__(self, body: Body) -> None:
        self.eye: Vec = body.eye
        self.offset: dict[int, Vec] = {j: body.offsets[j] for j in (*SPINES, NECK, HEAD)}
        rise = [self.offset[joint][1] for joint in (*SPINES, NECK)]
        self.length = sum(rise)
        # lean of the pelvis-neck line = low * pelvis tilt + high * chest tilt, when the tilt grows evenly in between
        self.low: float = (rise[0] + rise[1] * 2 / 3 + rise[2] / 3) / self.length
        self.neck_height: float = body.joints[NECK][1] - body.ground
        self.eye_height: float = body.eye_height
        self.min_pelvis: float = MIN_PELVIS_HEIGHT * body.eye_height
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.lean: tuple[float, float] = (0.0, 0.0)  # radians forwards, to the left
        self.shift: tuple[float, float] = (0.0, 0.0)  # smoothed balance, metres
        self.turned: Vec = (0.0, 0.0, 0.0)  # rotation vector from chest to head, before the limits
        self.neck: Quat | None = None

    def neck_point(self, eye: Vec, head: Quat, yaw: float) -> Vec:
        """Return the position of the neck joint, by the last tilt of the neck."""
        # the last neck: half way to a head turned by 180 degrees would be anywhere
        neck = yaw_quat(yaw) if self.neck is None else self.neck
        return sub(sub(eye, rotate(head, self.eye)), rotate(neck, self.offset[HEAD]))

    def update(
        self,
        eye: Vec,
        head: Quat,  # world rotation of the head joint
        yaw: float,
        head_yaw: float,
        balance: tuple[float, float],  # metres the neck is before / to the left of the feet's middle (heading frame)
        walking: float,  # 0 standing .. 1 walking
        speed: float,
        twist: float,  # radians the hands turn the chest
        dt: float,
    ) -> Torso:
        """Return the torso of this moment."""
        neck_at = self.neck_point(eye, head, yaw)
        drop = self.neck_height - neck_at[1]
        pitch = head_pitch(head)
        self._update_lean(drop, pitch, head_roll(head), balance, walking, speed, neck_at[1], dt)
        fore, side = self.lean
        turn = CHEST_TURN * clamp(wrap(head_yaw - yaw), -1.4, 1.4) + twist
        # a head that looks down or up further than the neck bends takes the chest along
        # (both bounds always: one chosen by the pitch's sign would let a level head in a squat shake the chest)
        surplus = max(pitch - MAX_FLEXION * 0.8 - fore, 0.0) + min(pitch + MAX_EXTENSION * 0.8 - fore, 0.0)
        high = 1 - self.low
        chest_fore = fore * (1 - 0.6 * self.low) / high + clamp(surplus, -0.35, 0.8)
        pelvis_fore = clamp(
            (fore - high * chest_fore) / self.low, fore - MAX_PELVIS_TILT_RAD, fore + 0.5 * MAX_PELVIS_TILT_RAD
        )
        chest_side, pelvis_side = side * (1 - 0.4 * self.low) / high, 0.4 * side
        facing = yaw_quat(yaw)
        pelvis = mul(facing, to_quat((pelvis_fore, 0.0, -pelvis_side)))
        chest = mul(yaw_quat(yaw + turn), to_quat((chest_fore, 0.0, -chest_side)))
        return self.hang(eye, head, pelvis, chest)

    def hang(self, eye: Vec, head: Quat, pelvis: Quat, chest: Quat) -> Torso:
        """Return the torso with its eyes at ``eye``; the spine joints share the turn from pelvis to chest."""
        x, y, z = quat.rotation_vector(quat.inverse_mul(pelvis, chest))
        low_x, low_y, low_z, high_x, high_y, high_z = BOXES[SPINE1]
        third = to_quat((clamp(x / 3, low_x, high_x), clamp(y / 3, low_y, high_y), clamp(z / 3, low_z, high_z)))
        spine1 = mul(pelvis, third)
        spine2 = mul(spine1, third)
        chest = mul(spine2, third)
        vx, vy, vz = quat.rotation_vector(quat.inverse_mul(chest, head))
        lx, ly, lz = self.turned
        if vx * lx + vy * ly + vz * lz < 0 and vx * vx + vy * vy + vz * vz > 4.0:
            # about half a turn from the chest: the same way round as before, not to and fro
            k = 1 - 2 * pi / sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx * k, vy * k, vz * k
        self.turned = (vx, vy, vz)
        kx, ky = clamp(vx, -MAX_EXTENSION, MAX_FLEXION), clamp(vy, -MAX_ROTATION, MAX_ROTATION)
        kz = clamp(vz, -MAX_SIDE, MAX_SIDE)
        off = sqrt((vx - kx) ** 2 + (vy - ky) ** 2 + (vz - kz) ** 2)
        neck = mul(chest, to_quat((kx * NECK_SHARE, ky * NECK_SHARE, kz * NECK_SHARE)))
        self.neck = neck
        skull = head if off < 1e-9 else mul(chest, to_quat((kx, ky, kz)))
        # from the eye down, so that the eye is exact
        x, y, z = eye
        a, b = rotate(skull, self.eye), rotate(neck, self.offset[HEAD])
        neck_at = (x - a[0] - b[0], y - a[1] - b[1], z - a[2] - b[2])
        spine3_at = sub(neck_at, rotate(chest, self.offset[NECK]))
        x, y, z = spine3_at
        a, b = rotate(spine2, self.offset[SPINE3]), rotate(spine1, self.offset[SPINE2])
        c = rotate(pelvis, self.offset[SPINE1])
        pelvis_at = (x - a[0] - b[0] - c[0], y - a[1] - b[1] - c[1], z - a[2] - b[2] - c[2])
        return Torso(pelvis, third, chest, neck, skull, pelvis_at, spine3_at, neck_at, off)

    def _update_lean(
        self,
        drop: float,
        pitch: float,
        roll: float,
        balance: tuple[float, float],
        walking: float,
        speed: float,
        neck_height: float,
        dt: float,
    ) -> None:
        length = self.length
        free = self.eye_height * 0.008  # metres a neck may sink without a bend: breath, soft knees
        most = acos(clamp(1 - (max(drop, 0.0) + free) / length, -0.5, 1.0))
        least = acos(clamp((neck_height - self.min_pelvis) / length, -0.7, 1.0))
        # the pelvis is near the body's mass, which only slow forces move: a quick shift of the neck is a bend
        k = 1.0 if self.neck is None else 1 - exp(-dt / SHIFT_SMOOTHING_S)
        self.shift = (
            self.shift[0] + (balance[0] - self.shift[0]) * k,
            self.shift[1] + (balance[1] - self.shift[1]) * k,
        )
        # people do not lean back for long: a lasting shift backwards is the pelvis' alone
        stand_fore = (balance[0] - (SHIFT_SHARE if self.shift[0] > 0 else 1.0) * self.shift[0]) / length
        stand_side = (balance[1] - SHIFT_SHARE * self.shift[1]) / length
        bow = 0.35 * max(pitch - 0.2, 0.0)
        # a lower head: hips and knees share the bend (a squat keeps the mass over the feet)
        crouch = 0.6 * acos(clamp(1 - max(drop - 0.03 * self.eye_height, 0.0) / length, -0.5, 1.0))
        back = clamp(
            (-stand_fore - LEAN_BACK_RAD) / LEAN_BACK_RAD, 0.0, 1.0
        )  # gradually: walking backwards crosses this
        fore = max(stand_fore, bow, crouch) * (1 - back) + (stand_fore + crouch) * back
        fore = fore * (1 - walking) + walking * max(0.03 + 0.03 * speed, min(bow, 0.5), crouch)
        # a tilted head mostly tilts with its torso
        side = stand_side * (1 - walking) + 0.5 * roll
        fore, side = clamp(fore, -most, most), clamp(side, -most - 0.2, most + 0.2)
        size = hypot(fore, side)
        if size < least:
            fore = sqrt(max(least * least - side * side, 0.0))
        k = 1.0 if self.neck is None else 1 - exp(-dt / LEAN_SMOOTHING_S)
        self.lean = (self.lean[0] + (fore - self.lean[0]) * k, self.lean[1] + (side - self.lean[1]) * k)
