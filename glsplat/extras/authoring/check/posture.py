"""Check that a person is whole, upright and turned to the camera, with arms off the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.networks.people import SIDES, DetectedPerson, degrees_between
from glsplat.extras.authoring.networks.person import LANDMARKS

_NOTE_TURN_DEG = 20.0  # between the shoulders and the expected side
_MAX_TURN_DEG = 57.0  # the network reports up to this for people turned by 45 degrees
_MAX_LEAN_DEG = 20.0  # between the vertical and the trunk, or the line from ankles to nose
_MIN_ARM_ANGLE_DEG = 14.0  # between the line from shoulder to wrist and the trunk's axis
_MIN_VISIBILITY = 0.5  # of a landmark that is in the picture
_MIN_ANKLE_VISIBILITY = 0.6  # if the person reaches the picture's lower edge
_MIN_FOREHEAD_FRACTION = 0.065  # height of the picture above the nose, of the length from nose to ankles
_MAX_CUT_SIDE_FRACTION = 0.5  # of the person's height, at the picture's left or right edge
_SIDES = ("left", "right")
_FOOT = ("ankle", "heel", "foot_index")
_HAND = ("wrist", "index", "pinky", "thumb")
_LEGS = (("hip", "waist"), ("knee", "thighs"), ("ankle", "shins"))
_LEAVE_ROOM = "leave room on all four sides"
_ALONG, _HIDDEN = "hangs along the body", "hidden"


@dataclass(frozen=True)
class Finding:
    """A reason to refuse a picture, or a note on parts of its avatar that are guessed."""

    code: str
    """Key for programs: nobody, several, cut_off, small, lying, turned, face, arms, blurred, bright, dark or mask."""
    text: str
    """One line for people: the problem, and the remedy."""
    refusal: bool = True
    """The picture is refused; otherwise the finding is a note."""

    @property
    def kind(self) -> str:
        """``refusal`` or ``note``."""
        return "refusal" if self.refusal else "note"


def note(code: str, text: str) -> Finding:
    """Return a finding that does not refuse the picture."""
    return Finding(code, text, refusal=False)


LYING = Finding("lying", "the person does not stand upright in the picture; turn the picture, and stand straight")


def cut_off(person: DetectedPerson, mask: NDArray[np.bool_], view: str | None) -> Finding | None:
    """Return the finding of parts beyond the picture's edges: half a person is refused, feet and elbows are noted."""
    height, width = mask.shape
    points = dict(zip(LANDMARKS, person.body.points, strict=True))
    sure = dict(zip(LANDMARKS, person.body.visible, strict=True))
    legs = {place: [f"{side}_{joint}" for side in _SIDES] for joint, place in _LEGS}
    beyond = {place: max(points[name][1] for name in names) >= height for place, names in legs.items()}
    ankles = max(sure[name] for name in legs["shins"])
    beyond["shins"] |= bool(mask[-2:].sum() > 2) and ankles < _MIN_ANKLE_VISIBILITY
    if any(beyond[place] or max(sure[name] for name in names) < _MIN_VISIBILITY for place, names in legs.items()):
        least = {place: min(sure[name] for name in names) for place, names in legs.items()}
        end = next(place for place in legs if beyond[place] or least[place] < _MIN_VISIBILITY)
        return Finding("cut_off", f"the person is seen down to the {end} only; show them whole, shoes included")
    long = max(points[f"{side}_ankle"][1] for side in _SIDES) - points["nose"][1]
    top = bool(mask[:2].sum() > 2 or points["nose"][1] < 0)
    faceless = view == "front" and person.face.presence < _MIN_VISIBILITY
    if top and (faceless or points["nose"][1] < _MIN_FOREHEAD_FRACTION * long):
        return Finding("cut_off", f"the head reaches out of the picture; {_LEAVE_ROOM}")
    rows = max(mask[:, :2].any(axis=1).sum(), mask[:, -2:].any(axis=1).sum())
    trunk = [points[f"{side}_{joint}"][0] for side in _SIDES for joint in ("shoulder", "hip")]
    if rows > _MAX_CUT_SIDE_FRACTION * max(mask.any(axis=1).sum(), 1) or min(trunk) < 0 or max(trunk) > width:
        return Finding("cut_off", f"a side of the person reaches out of the picture; {_LEAVE_ROOM}")
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
    return note("cut_off", f"{' and '.join(cut)} {reach} out of the picture, what is missing is guessed; {_LEAVE_ROOM}")


def lying(person: DetectedPerson) -> Finding | None:
    """Return LYING if the trunk, or the line from ankles to nose, is far from upright."""
    points = person.body.points
    ups = (
        points[[11, 12]].mean(axis=0) - points[[23, 24]].mean(axis=0),
        points[0] - points[[LANDMARKS.index(f"{side}_ankle") for side in _SIDES]].mean(axis=0),
    )
    return LYING if max(abs(np.degrees(np.arctan2(up[0], -up[1]))) for up in ups) > _MAX_LEAN_DEG else None


def turned(person: DetectedPerson, view: str) -> Finding | None:
    """Return the finding of a person who shows another side than ``view``."""

    def away(name: str) -> float:
        return degrees_between(float(np.degrees(person.turn)), SIDES[name])

    noted, limit = _NOTE_TURN_DEG, _MAX_TURN_DEG
    if view in ("left", "right"):  # seen from the side, the network's depths are rough
        noted = limit = 2 * _NOTE_TURN_DEG
    angle = away(view)
    if angle <= noted:
        return None
    if angle <= limit:
        text = f"the person is turned by about {round(angle, -1):.0f} degrees, the far side is guessed"
        return note("turned", f"{text}; stand straight before the camera")
    shown = min(SIDES, key=away)
    if shown != view:
        return Finding("turned", f"this shows the person's {shown}, not the {view}; give the picture to its own option")
    return Finding("turned", f"the person is turned by {angle:.0f} degrees; stand straight before the camera")


def arms(person: DetectedPerson, view: str | None) -> Finding | None:
    """Return the note of arms over or along the body, which hide parts of it."""
    if view not in ("front", "back"):
        return None
    body = person.body
    down = body.points[[23, 24]].mean(axis=0) - body.points[[11, 12]].mean(axis=0)
    where = {}
    for side, other in (_SIDES, _SIDES[::-1]):
        arm = body.point(f"{side}_wrist") - body.point(f"{side}_shoulder")
        out = np.sign((body.point(f"{side}_shoulder") - body.point(f"{other}_shoulder"))[0])
        angle = np.degrees(np.arctan2(arm[0], arm[1]) - np.arctan2(down[0], down[1])) * out
        if (angle + 180) % 360 - 180 < _MIN_ARM_ANGLE_DEG:
            where[side] = _place(person, side, view)
    if not where:
        return None
    if len(set(where.values())) == 1 and len(where) == 2:
        place = next(iter(where.values()))
        both = {_ALONG: "both arms hang along the body", _HIDDEN: "both hands are hidden"}
        text = both.get(place, f"both hands are {place}")
    else:
        text = " and ".join(
            f"the {side} arm {place}" if place == _ALONG else f"the {side} hand is {place.removeprefix('is ')}"
            for side, place in where.items()
        )
    return note("arms", f"{text}: what that hides is guessed; hold both arms well away from the body, palms down")


def _place(person: DetectedPerson, side: str, view: str) -> str:
    """Return the place of a hand whose arm lies against the body, in words."""
    body = person.body
    if body.visible[LANDMARKS.index(f"{side}_wrist")] < _MIN_VISIBILITY:
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
