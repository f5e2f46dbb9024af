"""Torso: from the head to the pelvis. Neck and spine share bend and twist; the head stays exactly where it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, exp, hypot, pi, sqrt

from glsplat.tracking.solve.body import HEAD, NECK, PELVIS, SPINE1, SPINE2, SPINE3, Body
from glsplat.tracking.solve.heading import head_pitch, head_roll
from glsplat.tracking.solve.limits import BOXES
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    clamp,
    inverse_mul,
    mul,
    rotate,
    rotation_vector,
    to_quat,
    wrap,
    yaw_quat,
)

__all__ = ["Spine", "Torso"]

# neck and head together, radians: flexion, extension, side, rotation (AAOS 45/45/45/60 for the neck; the joint between
# skull and atlas adds about 15 of nodding: Panjabi 1988)
FLEXION, EXTENSION, SIDE, ROTATION = 1.0, 1.05, 0.75, 1.15
NECK_SHARE = 0.45  # of the turn from chest to head that the neck joint takes, the head joint takes the rest
CHEST_TURN = 0.25  # of the head's turn that the chest follows
PELVIS_TILT = 0.5  # radians at most between the pelvis and the line from it to the neck
BEND_SMOOTHING = 0.05  # seconds
SHIFT, SHARE = 0.4, 0.5  # seconds, share: how the pelvis follows a neck that leaves the feet
BACK = 0.12  # radians a torso leans back before it shows, and all of it at twice that
LOWEST_PELVIS = 0.19  # of the eye height: a deep squat, or sitting on the heels


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
    """Keeps the lean of the torso, which is smoothed, and the last chest, which the neck hangs on."""

    def __init__(self, body: Body) -> None:
        self.eye: Vec = body.eye
        self.offset: dict[int, Vec] = {j: body.offsets[j] for j in (HEAD, NECK, SPINE3, SPINE2, SPINE1)}
        rise = (self.offset[SPINE1][1], self.offset[SPINE2][1], self.offset[SPINE3][1], self.offset[NECK][1])
        self.length = sum(rise)
        # lean of the pelvis-neck line = low * pelvis tilt + high * chest tilt, when the tilt grows evenly in between
        self.low: float = (rise[0] + rise[1] * 2 / 3 + rise[2] / 3) / self.length
        self.neck_height: float = body.joints[NECK][1] - body.ground
        self.stature: float = body.eye_height
        self.lowest: float = LOWEST_PELVIS * body.eye_height
        self.rest_pelvis: Vec = body.joints[PELVIS]
        self.lean: tuple[float, float] = (0.0, 0.0)
        self.shift: tuple[float, float] = (0.0, 0.0)
        self.turned: Vec = (0.0, 0.0, 0.0)  # rotation vector from chest to head, before the limits
        self.chest: Quat | None = None
        self.neck: Quat | None = None

    def reset(self) -> None:
        """Forget the past."""
        self.chest = self.neck = None
        self.lean = self.shift = (0.0, 0.0)
        self.turned = (0.0, 0.0, 0.0)

    def neck_point(self, eye: Vec, head: Quat, yaw: float) -> Vec:
        """Where the neck joint is, by the last tilt of the neck."""
        # the last neck: half way to a head turned by 180 degrees would be anywhere
        neck = yaw_quat(yaw) if self.neck is None else self.neck
        a, b = rotate(head, self.eye), rotate(neck, self.offset[HEAD])
        return (eye[0] - a[0] - b[0], eye[1] - a[1] - b[1], eye[2] - a[2] - b[2])

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
        """The torso of this moment."""
        neck_at = self.neck_point(eye, head, yaw)
        drop = self.neck_height - neck_at[1]
        pitch = head_pitch(head, yaw)
        self._lean(drop, pitch, head_roll(head), balance, walking, speed, neck_at[1], dt)
        fore, side = self.lean
        turn = CHEST_TURN * clamp(wrap(head_yaw - yaw), -1.4, 1.4) + twist
        # a head that looks down or up further than the neck bends takes the chest along
        # (both bounds always: one chosen by the pitch's sign would let a level head in a squat shake the chest)
        surplus = max(pitch - FLEXION * 0.8 - fore, 0.0) + min(pitch + EXTENSION * 0.8 - fore, 0.0)
        high = 1 - self.low
        chest_fore = fore * (1 - 0.6 * self.low) / high + clamp(surplus, -0.35, 0.8)
        pelvis_fore = clamp((fore - high * chest_fore) / self.low, fore - PELVIS_TILT, fore + 0.5 * PELVIS_TILT)
        chest_side, pelvis_side = side * (1 - 0.4 * self.low) / high, 0.4 * side
        facing = yaw_quat(yaw)
        pelvis = mul(facing, to_quat((pelvis_fore, 0.0, -pelvis_side)))
        chest = mul(yaw_quat(yaw + turn), to_quat((chest_fore, 0.0, -chest_side)))
        return self.hang(eye, head, pelvis, chest)

    def hang(self, eye: Vec, head: Quat, pelvis: Quat, chest: Quat) -> Torso:
        """The torso whose eyes are at ``eye``, for these world rotations: the spine shares what is between them."""
        x, y, z = rotation_vector(inverse_mul(pelvis, chest))
        low_x, low_y, low_z, high_x, high_y, high_z = BOXES[SPINE1]
        third = to_quat((clamp(x / 3, low_x, high_x), clamp(y / 3, low_y, high_y), clamp(z / 3, low_z, high_z)))
        spine1 = mul(pelvis, third)
        spine2 = mul(spine1, third)
        self.chest = chest = mul(spine2, third)
        vx, vy, vz = rotation_vector(inverse_mul(chest, head))
        lx, ly, lz = self.turned
        if vx * lx + vy * ly + vz * lz < 0 and vx * vx + vy * vy + vz * vz > 4.0:
            # about half a turn from the chest: the same way round as before, not to and fro
            k = 1 - 2 * pi / sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx * k, vy * k, vz * k
        self.turned = (vx, vy, vz)
        kx, ky, kz = clamp(vx, -EXTENSION, FLEXION), clamp(vy, -ROTATION, ROTATION), clamp(vz, -SIDE, SIDE)
        off = sqrt((vx - kx) ** 2 + (vy - ky) ** 2 + (vz - kz) ** 2)
        whole = (kx, ky, kz)
        neck = mul(chest, to_quat((kx * NECK_SHARE, ky * NECK_SHARE, kz * NECK_SHARE)))
        self.neck = neck
        skull = head if off < 1e-9 else mul(chest, to_quat(whole))
        # from the eye down, so that the eye is exact
        x, y, z = eye
        a, b = rotate(skull, self.eye), rotate(neck, self.offset[HEAD])
        neck_at = (x - a[0] - b[0], y - a[1] - b[1], z - a[2] - b[2])
        c = rotate(chest, self.offset[NECK])
        spine3_at = (neck_at[0] - c[0], neck_at[1] - c[1], neck_at[2] - c[2])
        a, b, c = (
            rotate(spine2, self.offset[SPINE3]),
            rotate(spine1, self.offset[SPINE2]),
            rotate(pelvis, self.offset[SPINE1]),
        )
        pelvis_at = (
            spine3_at[0] - a[0] - b[0] - c[0],
            spine3_at[1] - a[1] - b[1] - c[1],
            spine3_at[2] - a[2] - b[2] - c[2],
        )
        return Torso(pelvis, third, chest, neck, skull, pelvis_at, spine3_at, neck_at, off)

    def _lean(
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
        free = self.stature * 0.008  # metres a neck may sink without a bend: breath, soft knees
        most = acos(clamp(1 - (max(drop, 0.0) + free) / length, -0.5, 1.0))
        least = acos(clamp((neck_height - self.lowest) / length, -0.7, 1.0))
        # the pelvis is near the body's mass, which only slow forces move: a quick shift of the neck is a bend
        k = 1.0 if self.chest is None else 1 - exp(-dt / SHIFT)
        self.shift = (
            self.shift[0] + (balance[0] - self.shift[0]) * k,
            self.shift[1] + (balance[1] - self.shift[1]) * k,
        )
        # nobody leans back for long: the whole of a lasting shift backwards is the pelvis'
        stand_fore = (balance[0] - (SHARE if self.shift[0] > 0 else 1.0) * self.shift[0]) / length
        stand_side = (balance[1] - SHARE * self.shift[1]) / length
        bow = 0.35 * max(pitch - 0.2, 0.0)
        # a lower head: hips and knees share the bend (a squat keeps the mass over the feet)
        crouch = 0.6 * acos(clamp(1 - max(drop - 0.03 * self.stature, 0.0) / length, -0.5, 1.0))
        back = clamp((-stand_fore - BACK) / BACK, 0.0, 1.0)  # gradually: walking backwards crosses this
        fore = max(stand_fore, bow, crouch) * (1 - back) + (stand_fore + crouch) * back
        fore = fore * (1 - walking) + walking * max(0.03 + 0.03 * speed, min(bow, 0.5), crouch)
        # a tilted head mostly tilts with its torso
        side = stand_side * (1 - walking) + 0.5 * roll
        fore, side = clamp(fore, -most, most), clamp(side, -most - 0.2, most + 0.2)
        size = hypot(fore, side)
        if size < least:
            fore = sqrt(max(least * least - side * side, 0.0))
        k = 1.0 if self.chest is None else 1 - exp(-dt / BEND_SMOOTHING)
        self.lean = (self.lean[0] + (fore - self.lean[0]) * k, self.lean[1] + (side - self.lean[1]) * k)
