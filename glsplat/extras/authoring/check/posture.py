"""What the check says of how somebody stands in the picture: whole, upright, towards the camera, arms off the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.check.finding import Finding, note
from glsplat.extras.authoring.networks.people import DetectedPerson
from glsplat.extras.authoring.networks.person import LANDMARKS

__all__ = ["LYING", "VIEWS", "PostureConfig", "arms", "cut_off", "lying", "turned"]

VIEWS = {"front": 0.0, "left": -90.0, "back": 180.0, "right": 90.0}
"""Which side of the person is seen, and how many degrees the person has turned to show it, to their own left."""


@dataclass(frozen=True)
class PostureConfig:
    """Where the lines are drawn; degrees and shares."""

    turned: float = 20.0
    """Degrees that the shoulders may be turned from the view that was asked for before a note says so."""
    far_turned: float = 57.0
    """Degrees from which on the picture is refused: of somebody turned by 45 the network says up to this."""
    leaning: float = 20.0
    """Degrees between the picture's upright and the trunk, and the way from the ankles to the nose."""
    arms: float = 14.0
    """Degrees that the line from shoulder to wrist leaves the trunk's axis."""
    seen: float = 0.5
    """Visibility from which on a landmark is believed to be in the picture."""
    feet: float = 0.6
    """The same of ankles, where the person reaches to the picture's lower edge."""
    head: float = 0.065
    """Of the length from nose to ankles that has to be in the picture above the nose: less is no forehead."""
    side: float = 0.5
    """Of the person's height that may reach out of the picture at its left or right edge."""


_SIDES = ("left", "right")
_FOOT = ("ankle", "heel", "foot_index")
_HAND = ("wrist", "index", "pinky", "thumb")
_LEGS = (("hip", "waist"), ("knee", "thighs"), ("ankle", "shins"))
_ROOM = "leave room on all four sides"


def cut_off(person: DetectedPerson, mask: NDArray[np.bool_], view: str | None, config: PostureConfig) -> Finding | None:
    """What of the person is beyond the picture's edges. Half of somebody is refused, a foot or an elbow is guessed."""
    height, width = mask.shape
    points = dict(zip(LANDMARKS, person.body.points, strict=True))
    sure = dict(zip(LANDMARKS, person.body.visible, strict=True))
    legs = {place: [f"{side}_{joint}" for side in _SIDES] for joint, place in _LEGS}
    beyond = {place: max(points[name][1] for name in names) >= height for place, names in legs.items()}
    beyond["shins"] |= bool(mask[-2:].sum() > 2) and max(sure[name] for name in legs["shins"]) < config.feet
    if any(beyond[place] or max(sure[name] for name in names) < config.seen for place, names in legs.items()):
        ends = (place for place, names in legs.items() if beyond[place] or min(sure[n] for n in names) < config.seen)
        return Finding("cut_off", f"the person is seen down to the {next(ends)} only; show them whole, shoes included")
    long = max(points[f"{side}_ankle"][1] for side in _SIDES) - points["nose"][1]
    top = bool(mask[:2].sum() > 2 or points["nose"][1] < 0)
    faceless = view == "front" and person.face.presence < config.seen
    if top and (faceless or points["nose"][1] < config.head * long):
        return Finding("cut_off", f"the head reaches out of the picture; {_ROOM}")
    rows = max(mask[:, :2].any(axis=1).sum(), mask[:, -2:].any(axis=1).sum())
    trunk = [points[f"{side}_{joint}"][0] for side in _SIDES for joint in ("shoulder", "hip")]
    if rows > config.side * max(mask.any(axis=1).sum(), 1) or min(trunk) < 0 or max(trunk) > width:
        return Finding("cut_off", f"a side of the person reaches out of the picture; {_ROOM}")
    parts = {
        "the top of the head": top,
        "the feet": mask[-2:].sum() > 2 or max(points[f"{s}_{p}"][1] for s in _SIDES for p in _FOOT) > height,
        "a hand or an elbow": mask[:, :2].sum() + mask[:, -2:].sum() > 4
        or any(not 0 <= points[f"{s}_{p}"][0] <= width for s in _SIDES for p in _HAND),
    }
    cut = [name for name, missing in parts.items() if missing]
    if not cut:
        return None
    reach = "reaches" if len(cut) == 1 and "feet" not in cut[0] else "reach"
    return note("cut_off", f"{' and '.join(cut)} {reach} out of the picture, what is missing is guessed; {_ROOM}")


LYING = Finding("lying", "the person does not stand upright in the picture; turn the picture, and stand straight")


def lying(person: DetectedPerson, config: PostureConfig) -> Finding | None:
    """Whether the trunk is far from upright, or all of the person: a picture askew has its trunks put right."""
    points = person.body.points
    ups = (
        points[[11, 12]].mean(axis=0) - points[[23, 24]].mean(axis=0),
        points[0] - points[[LANDMARKS.index(f"{side}_ankle") for side in _SIDES]].mean(axis=0),
    )
    return LYING if max(abs(np.degrees(np.arctan2(up[0], -up[1]))) for up in ups) > config.leaning else None


def turned(person: DetectedPerson, view: str, config: PostureConfig) -> Finding | None:
    """Whether another side is shown than the one that was asked for."""

    def away(name: str) -> float:
        return float(abs((np.degrees(person.turn) - VIEWS[name] + 180) % 360 - 180))

    # from the side depth is a rough guess
    note_at, most = (config.turned, config.far_turned) if view in ("front", "back") else (2 * config.turned,) * 2
    angle = away(view)
    if angle <= note_at:
        return None
    if angle <= most:
        told = f"the person is turned by about {round(angle, -1):.0f} degrees, the far side is guessed"
        return note("turned", f"{told}; stand straight before the camera")
    seen = min(VIEWS, key=away)
    if seen != view:
        return Finding("turned", f"this shows the person's {seen}, not the {view}; give the picture to its own option")
    return Finding("turned", f"the person is turned by {angle:.0f} degrees; stand straight before the camera")


def arms(person: DetectedPerson, view: str | None, config: PostureConfig) -> Finding | None:
    """Arms that lie over the body or along it, and where; what they hide is guessed."""
    if view not in ("front", "back"):
        return None
    body = person.body
    down = body.points[[23, 24]].mean(axis=0) - body.points[[11, 12]].mean(axis=0)
    where = {}
    for side, other in (_SIDES, _SIDES[::-1]):
        arm = body.point(f"{side}_wrist") - body.point(f"{side}_shoulder")
        out = np.sign((body.point(f"{side}_shoulder") - body.point(f"{other}_shoulder"))[0])
        angle = np.degrees(np.arctan2(arm[0], arm[1]) - np.arctan2(down[0], down[1])) * out
        if (angle + 180) % 360 - 180 < config.arms:
            where[side] = _place(person, side, view, config)
    if not where:
        return None
    if len(set(where.values())) == 1 and len(where) == 2:
        place = next(iter(where.values()))
        said = {_ALONG: "both arms hang along the body", _HIDDEN: "both hands are hidden"}.get(
            place, f"both hands are {place}"
        )
    else:
        said = " and ".join(
            f"the {side} arm {place}" if place == _ALONG else f"the {side} hand is {place.removeprefix('is ')}"
            for side, place in where.items()
        )
    return note("arms", f"{said}: what that hides is guessed; hold both arms well away from the body, palms down")


_ALONG, _HIDDEN = "hangs along the body", "hidden"


def _place(person: DetectedPerson, side: str, view: str, config: PostureConfig) -> str:
    """Where the hand of an arm is that lies against the body."""
    body = person.body
    if body.visible[LANDMARKS.index(f"{side}_wrist")] < config.seen:
        return _HIDDEN
    shoulders, hips = (body.points[[low, low + 1]].mean(axis=0) for low in (11, 23))
    axis = hips - shoulders
    hand = body.points[[LANDMARKS.index(f"{side}_{part}") for part in _HAND]].mean(axis=0)
    (x, y), (right, low), long = axis, hand - shoulders, max(float(np.hypot(*axis)), 1.0)
    along, across = float(x * right + y * low) / long**2, abs(float(x * low - y * right)) / long
    half = float(np.linalg.norm(body.points[11] - body.points[12])) / 2
    if along < -0.1:
        return "at the head"
    if across > 0.8 * half or along > 1.15:
        return _ALONG
    front = {"front": ("before the chest", "before the belly"), "back": ("behind the back", "behind the back")}[view]
    return front[along > 0.5]
