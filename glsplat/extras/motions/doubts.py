"""Check that a retargeted motion is plausible for a person: upright, on the floor, at human speed.

Files lack their unit and up axis, or have wrong ones. A warning names the correction (corrections.py); the motion is
not changed. Thresholds lie beyond 328 clips of the CMU database, in which people climb, hang from bars, stand on their
hands and walk backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glsplat.arrays import F64
from glsplat.motion.fitted import leg_length
from glsplat.motion.motion import Motion
from glsplat.rotations import unit_vectors
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
_SIDES = ("left", "right")
_FEET = [_AT[f"{side}_{part}"] for side in _SIDES for part in ("ankle", "foot")]
_HANDS = [_AT[f"{side}_wrist"] for side in _SIDES]
_LOOKED_AT = 200  # most sampled frames
_STEP = 1 / 30  # seconds between the two frames of a speed
_STRAIGHT = 0.8  # component, along an axis, of the mean direction of trunk and legs: more than that is up
_FALLEN = 0.6  # the same, downwards: more than that is upside down
_FASTEST = 12.0  # m/s, of a sprinter
_HANDS_FASTEST, _USUAL = 10.0, 30.0  # m/s of hands relative to the pelvis; usual frames a second
_FARTHEST = 10.0  # metres above or below the floor
_UNITS = (0.01, 0.0254, 0.001, 0.3048, 0.1)  # metres; the likeliest first
_SPEEDS = (0.2, 6.0)  # m/s of a travelling person
_ABOVE, _BELOW = 0.15, 0.15  # accepted metres from the floor
_WALKS, _FEW, _WAY = 0.4, 8, 1.5  # least m/s, sampled frames and metres of a walk
_LOW = 0.08  # metres of a standing foot above its lowest place
_UPRIGHT, _ALIKE = 0.7, 0.75  # cosines: trunk with the vertical, path with steps
_PACE = (0.6, 1.7)  # accepted ratio of the steps to the path
_GLIDES, _SWAYS = 0.2, 0.06  # the same ratio: most without steps, most if the path has another unit
_AGAINST, _MOSTLY = 0.7, 0.25  # cosine of backward movement; share of the frames
_SLIDES = 60.0  # degrees between the path and that of the steps
_BENT, _WRONG = 0.2, 0.8  # radians of a bent knee; share of bent knees that bend the wrong way


@dataclass(frozen=True)
class _Seen:
    """Sampled frames of a motion, of 55 joints."""

    at: F64  # [M, 55, 3] metres
    speed: F64  # [M, 55, 3] m/s
    low: F64  # [M] height of the lowest foot joint above its rest height, metres
    ahead: F64  # [M, 3] direction in which the pelvis faces
    knees: F64  # [M, 2] flexion, radians
    fastest: float  # 95th percentile of the pelvis' speed, m/s
    hands: float  # 95th percentile of the hands' speed relative to the pelvis, m/s
    leg: float  # length, metres
    seconds: float


def doubt(motion: Motion, skeleton: Skeleton, name: str) -> str:
    """Return one line on what looks wrong in a motion and how to write ``name`` instead; "" if nothing does.

    >>> walk = load_motion("walk", skeleton)
    >>> doubt(walk, skeleton, "walk")
    ''
    """
    if motion.names != JOINT_NAMES or skeleton.names != JOINT_NAMES or why_not_driven(skeleton):
        return ""
    seen = _seen(motion, skeleton)
    what = correction = ""
    looks = (_size, _floor, _sides, _way)
    for look in looks if motion.known_up else (_up, _speed, *looks):  # glTF has seconds, y up
        if not what:  # one error makes later checks fail too
            what, correction = look(seen)
    return f"looks wrong: {what}; if so, write {name}#{correction}" if what else ""


def _seen(motion: Motion, skeleton: Skeleton) -> _Seen:
    count = len(motion)
    step = min(max(1, round(_STEP * motion.fps)), max(1, count - 1))
    first = np.unique(np.linspace(0, max(0, count - 1 - step), min(_LOOKED_AT, count)).astype(np.intp))
    second = np.minimum(first + step, count - 1)
    one, two = (
        np.array([skeleton.forward(motion.rotations[i], motion.trans[i]) for i in at]) for at in (first, second)
    )
    at = one[:, :, :3, 3]
    speed = (two[:, :, :3, 3] - at) * (motion.fps / step)
    low = (at[:, _FEET, 1] - skeleton.joints[_FEET, 1]).min(axis=1)
    ways = np.linalg.norm(motion.trans[step:] - motion.trans[:-step], axis=1) * (motion.fps / step)
    knees = motion.rotations[first][:, [_AT[f"{side}_knee"] for side in _SIDES], 0]
    fastest = float(np.percentile(ways, 95)) if len(ways) else 0.0
    hands = np.linalg.norm(speed[:, _HANDS] - speed[:, :1], axis=2)
    axes = one[:, 0, :3, :3] @ skeleton.rest[0, :3, :3].T
    leg = leg_length(skeleton.joints)
    return _Seen(at, speed, low, axes[:, :, 2], knees, fastest, float(np.percentile(hands, 95)), leg, motion.duration)


def _middle(points: F64, part: str) -> F64:
    return np.asarray(np.mean([points[:, _AT[f"{side}_{part}"]] for side in _SIDES], axis=0))


def _up(seen: _Seen) -> tuple[str, str]:
    hips, shoulders, ankles = (_middle(seen.at, part) for part in ("hip", "shoulder", "ankle"))
    along = (unit_vectors(shoulders - hips) + unit_vectors(hips - ankles)).mean(axis=0) / 2
    axis = int(np.abs(along).argmax())
    sign = "-" if along[axis] < 0 else ""
    if axis != 1 and abs(along[axis]) > _STRAIGHT:
        return f"they lie straight along {sign}{'xyz'[axis]} from first to last", f"up={sign}{'xyz'[axis]}"
    return ("they are upside down", "up=-y") if along[1] < -_FALLEN else ("", "")


def _speed(seen: _Seen) -> tuple[str, str]:
    if seen.hands <= _HANDS_FASTEST:
        return "", ""
    return f"their hands move at {seen.hands:.0f} m/s", f"fps={_USUAL:g}"


def _size(seen: _Seen) -> tuple[str, str]:
    height, (made, _, surely) = float(np.median(seen.low)), _gait(seen)
    sways = surely and abs(made) < _SWAYS and abs(np.degrees(np.angle(made))) < _SLIDES
    if not sways and seen.fastest <= _FASTEST and abs(height) <= _FARTHEST:
        return "", ""
    units = [unit for unit in _UNITS if abs(height) * unit < 2 * seen.leg] or [*_UNITS[:1]]
    if surely and abs(made) < 0.5:  # standing feet give the length of the path
        units.sort(key=lambda unit: abs(np.log(abs(made) / unit)))
    else:
        units.sort(key=lambda unit: not _SPEEDS[0] < seen.fastest * unit < _SPEEDS[1])
    correction = f"scale={units[0]:g}" + ("#floor=0" if abs(height) * units[0] > _ABOVE else "")
    if seen.fastest > _FASTEST:
        return f"they move at {seen.fastest:.0f} m/s", correction
    if abs(height) > _FARTHEST:
        return f"they are {abs(height):.0f} m {'above' if height > 0 else 'below'} the floor", correction
    return f"their way is {1 / abs(made):.0f} times as long as their legs make it", correction


def _floor(seen: _Seen) -> tuple[str, str]:
    lowest, usual = float(np.percentile(seen.low, 5)), float(np.median(seen.low))
    hangs = np.median(_middle(seen.at, "wrist")[:, 1] - seen.at[:, _AT["head"], 1]) > 0
    if lowest > _ABOVE and not hangs:
        return f"the feet are never less than {100 * lowest:.0f} cm above the floor", "floor=0"
    if usual < -_BELOW:
        return f"the feet are {-100 * usual:.0f} cm below the floor", "floor=0"
    return "", ""


def _sides(seen: _Seen) -> tuple[str, str]:
    bent = seen.knees[np.abs(seen.knees) > _BENT]
    if len(bent) < 0.2 * seen.knees.size or np.mean(bent < 0) < _WRONG:
        return "", ""
    return "knees bend forwards, as if left were called right", "sides=swapped"


def _way(seen: _Seen) -> tuple[str, str]:
    goes = seen.speed[:, 0] * (1, 0, 1)
    size = np.linalg.norm(goes, axis=1)
    walks = size > _WALKS
    made, steps, surely = _gait(seen)
    if not steps or float(size[walks].mean() * walks.mean()) * seen.seconds < _WAY:
        return "", ""
    if surely and _PACE[0] < abs(made) < _PACE[1]:
        angle = float(np.degrees(np.angle(made)))
        quarter = round(-angle / 90) * 90 if abs(angle) > _SLIDES else 0
        if quarter:
            how = "back to front" if abs(quarter) == 180 else "sideways"
            return f"they walk {how}, their feet slide", f"turn={abs(quarter) if abs(quarter) == 180 else quarter}"
        return "", ""  # standing feet stay in place, also when walking backwards
    faces = float((unit_vectors(seen.ahead * (1, 0, 1))[walks] * goes[walks]).sum() / size[walks].sum())
    against = faces < -_AGAINST and walks.mean() > _MOSTLY and made.real < _GLIDES
    return ("they move backwards, and their feet do not", "turn=180") if against else ("", "")


def _gait(seen: _Seen) -> tuple[complex, bool, bool]:
    """Return the factor of the pelvis' velocity that keeps a standing foot in place, complex (z + ix); whether the
    person walks; and whether the steps are a multiple of the path."""
    lower = seen.at[:, _FEET, 1].argmin(axis=1)
    body = seen.speed[:, 0]
    foot = seen.speed[np.arange(len(lower)), np.array(_FEET)[lower]] - body
    way, step = body[:, 2] + 1j * body[:, 0], foot[:, 2] + 1j * foot[:, 0]
    trunk = unit_vectors(_middle(seen.at, "shoulder") - _middle(seen.at, "hip"))[:, 1]
    walks = (np.abs(way) > _WALKS) & (seen.low < np.percentile(seen.low, 10) + _LOW) & (trunk > _UPRIGHT)
    if walks.sum() < _FEW:
        return 0j, False, False
    way, step = way[walks], step[walks]
    both = -np.vdot(way, step)
    alike = abs(both) / max(float(np.linalg.norm(way) * np.linalg.norm(step)), 1e-12)
    return complex(both / np.vdot(way, way)), True, alike > _ALIKE
