"""Is this a picture that an avatar can be made from? Looked at before any work, and answered in words."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.making.networks.people import Person, find_person
from glsplat.making.networks.person import LANDMARKS, body_in, bounds, people_mask, whole

from .mask import person_mask
from .sharpness import blur_of

__all__ = ["VIEWS", "Capture", "CaptureConfig", "Finding", "check_capture"]

VIEWS = {"front": 0.0, "left": -90.0, "back": 180.0, "right": 90.0}
"""Which side of the person is seen, and how many degrees the person has turned to show it, to their own left."""


@dataclass(frozen=True)
class CaptureConfig:
    """Where the lines are drawn; pixels, degrees and shares."""

    presence: float = 0.99
    """Of the body network: people have more, dolls, animals and drawings less."""
    face: float = 0.5
    """Of the face network, in a picture from the front."""
    smallest: float = 400.0
    """Pixels that a person has to be high."""
    turned: float = 20.0
    """Degrees that the shoulders may be turned from the view that was asked for."""
    leaning: float = 20.0
    """Degrees between the trunk and the picture's upright."""
    arms: float = 14.0
    """Degrees that the line from shoulder to wrist leaves the trunk's axis."""
    blur: float = 0.62
    """Of ``blur_of``: 0 sharp, 1 nothing but blur."""
    burnt: float = 0.12
    """Share of the person's pixels that are plain white."""
    burnt_face: float = 0.3
    """Share of the face's pixels that have reached the brightest level of some colour."""
    washed: float = 0.25
    """Share of the person's pixels that have, where half of the room has."""
    dark: float = 52.0
    """Levels of 255 that the person's brighter parts have to reach."""
    other: float = 0.12
    """Size of a second person, in sizes of the first."""
    other_presence: float = 0.95
    """Of the body network, for a second person, whom both networks have to see."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a capture."""

    code: str
    """For programs: nobody, several, cut_off, small, lying, turned, face, arms, blurred, bright, dark or mask."""
    text: str
    """One line for people: what was found, and what to do."""


@dataclass(frozen=True, eq=False)
class Capture:
    """What the check found, and what it had to work out for that."""

    findings: tuple[Finding, ...]
    person: Person | None = None
    mask: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    """[H, W] the person; empty where nobody is found."""

    @property
    def good(self) -> bool:
        """Nothing was found."""
        return not self.findings


def check_capture(
    picture: NDArray[np.uint8],
    view: str | None = "front",
    config: CaptureConfig | None = None,
    given: NDArray[np.bool_] | None = None,
) -> Capture:
    """Look at a picture (RGB uint8 [H, W, 3]) of one of VIEWS. A capture without a person ends after that finding.

    ``view`` None is any side, of which nothing is asked. ``given`` [H, W] is the person's outline where it is known;
    else it is found.
    """
    config = config or CaptureConfig()
    people = people_mask(picture)
    person = find_person(picture, people)
    nothing = np.zeros(picture.shape[:2], bool)
    if person is None or not _is_somebody(picture, person, people, config):
        return Capture((_elsewhere(picture, config),), None, nothing)
    mask = person_mask(picture, person.body) if given is None else given
    lying = _lying(person, config)
    if lying is not None:  # the networks know upright people only, so nothing else can be believed
        return Capture((lying,), person, mask)
    small = _small(mask, config)
    found = [
        _several(picture, person, people, config),
        _cut_off(person, mask),
        small,
        _turned(person, view, config) if view is not None else None,
        _face(person, view, config),
        _arms(person, view, config),
        _blurred(picture, mask, config) if small is None else None,
        _exposure(picture, person, mask, config),
        _mask(person, mask, given is not None) if small is None else None,
    ]
    return Capture(tuple(finding for finding in found if finding is not None), person, mask)


def _elsewhere(picture: NDArray[np.uint8], config: CaptureConfig) -> Finding:
    """What to say where nobody stands upright: perhaps the picture has to be turned."""
    for quarters in (1, 3, 2):
        turned = np.ascontiguousarray(np.rot90(picture, quarters))
        people = people_mask(turned)
        person = find_person(turned, people)
        if person is not None and _is_somebody(turned, person, people, config) and _lying(person, config) is None:
            return _LYING
    return Finding("nobody", "nobody is found in the picture; show one whole person, upright")


_LYING = Finding("lying", "the person does not stand upright in the picture; turn the picture, and stand straight")


def _is_somebody(
    picture: NDArray[np.uint8], person: Person, people: NDArray[np.float32], config: CaptureConfig
) -> bool:
    """The two networks have to agree: one sees bodies in anything, the other people in any foreground."""
    body = person.body
    seen = _seen(picture, people)
    own = body.mask > 0.5
    if body.presence < config.presence or not own.any():
        return False
    shared = (seen & own).sum() / own.sum()
    inside = _inside(own, body.points[11:33], 0.02 * float(np.ptp(np.flatnonzero(own.any(axis=1)))))
    return bool(shared > 0.5 and own.mean() > 0.002 and inside.mean() > 0.6)


def _inside(mask: NDArray[np.bool_], points: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """[N] whether points lie in the mask or at most ``reach`` pixels beside it; those outside the picture do not."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    column, row = np.floor(points).astype(int).T
    valid = (row >= 0) & (column >= 0) & (row < mask.shape[0]) & (column < mask.shape[1])
    return valid & (distance[row.clip(0, mask.shape[0] - 1), column.clip(0, mask.shape[1] - 1)] <= reach)


def _several(
    picture: NDArray[np.uint8], person: Person, people: NDArray[np.float32], config: CaptureConfig
) -> Finding | None:
    """People beside the first one: what the first network sees and the first person's mask does not cover.

    Who stands farther behind is overlooked beside somebody large, so the first person is painted over as well.
    """
    own = person.body.mask > 0.5
    reach = max(int(0.03 * person.body.crop.side), 3)
    near = cv2.dilate(own.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    beside = _seen(picture, people) & ~near
    if not _is_second(picture, beside, near, own, config):
        without = _painted_over(picture, near)
        if not _is_second(without, _seen(without, people_mask(without)), near, own, config):
            return None
    return Finding("several", "more than one person is in the picture; show one person alone")


def _seen(picture: NDArray[np.uint8], people: NDArray[np.float32]) -> NDArray[np.bool_]:
    """[H, W] where the first network sees people."""
    return whole(picture).paste(people, picture.shape[:2]) > 0.5


def _is_second(
    picture: NDArray[np.uint8],
    rest: NDArray[np.bool_],
    near: NDArray[np.bool_],
    own: NDArray[np.bool_],
    config: CaptureConfig,
) -> bool:
    """Whether one of the larger pieces of ``rest`` is a person who stands mostly outside ``near``."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8))
    for index in np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:3] + 1:
        if stats[index, cv2.CC_STAT_AREA] < config.other * own.sum():
            break
        second = body_in(picture, bounds(labels == index))
        theirs = second.mask > 0.5
        if second.presence > config.other_presence and (theirs & ~near).sum() > 0.5 * theirs.sum():
            return True
    return False


def _painted_over(picture: NDArray[np.uint8], area: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The picture with the room's colours continued into an area, as coarsely as the networks look."""
    scale = min(256 / max(picture.shape[:2]), 1.0)
    size = max(round(picture.shape[1] * scale), 1), max(round(picture.shape[0] * scale), 1)
    hidden = cv2.resize(area.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    filled = cv2.inpaint(small, hidden.astype(np.uint8), 3, cv2.INPAINT_TELEA)
    return np.where(area[..., None], cv2.resize(filled, picture.shape[1::-1]), picture).astype(np.uint8)


def _cut_off(person: Person, mask: NDArray[np.bool_]) -> Finding | None:
    height, width = mask.shape
    points = dict(zip(LANDMARKS, person.body.points, strict=True))
    parts = {
        "the head": mask[:2].sum() > 2 or points["nose"][1] < 0,
        "the feet": mask[-2:].sum() > 2 or max(points[f"{s}_{p}"][1] for s in _SIDES for p in _FOOT) > height,
        "a hand": mask[:, :2].sum() + mask[:, -2:].sum() > 4
        or any(not 0 <= points[f"{s}_{p}"][0] <= width for s in _SIDES for p in _HAND),
    }
    cut = [name for name, beyond in parts.items() if beyond]
    if not cut:
        return None
    reach = "reaches" if len(cut) == 1 and "feet" not in cut[0] else "reach"
    return Finding("cut_off", f"{' and '.join(cut)} {reach} out of the picture; leave room on all four sides")


_SIDES = ("left", "right")
_FOOT = ("ankle", "heel", "foot_index")
_HAND = ("wrist", "index", "pinky", "thumb")


def _small(mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    rows = np.flatnonzero(mask.any(axis=1))
    high = int(rows[-1] - rows[0] + 1) if len(rows) else 0
    if high >= config.smallest:
        return None
    return Finding(
        "small",
        f"the person is {high} pixels high, {config.smallest:.0f} are needed; go closer or take a larger picture",
    )


def _lying(person: Person, config: CaptureConfig) -> Finding | None:
    up = person.body.points[[11, 12]].mean(axis=0) - person.body.points[[23, 24]].mean(axis=0)
    return _LYING if abs(np.degrees(np.arctan2(up[0], -up[1]))) > config.leaning else None


def _turned(person: Person, view: str, config: CaptureConfig) -> Finding | None:
    """Whether another side is shown than the one that was asked for."""

    def away(name: str) -> float:
        return float(abs((np.degrees(person.turn) - VIEWS[name] + 180) % 360 - 180))

    allowed = config.turned if view in ("front", "back") else 2 * config.turned  # from the side depth is a rough guess
    if away(view) <= allowed:
        return None
    seen = min(VIEWS, key=away)
    if seen != view:
        return Finding("turned", f"this shows the person's {seen}, not the {view}; give the picture to its own option")
    return Finding("turned", f"the person is turned by {away(view):.0f} degrees; stand straight before the camera")


def _face(person: Person, view: str | None, config: CaptureConfig) -> Finding | None:
    if view != "front" or person.face.presence > config.face or person.body.point("nose")[1] < 0:
        return None
    return Finding("face", "no face is found; look into the camera, hair and hat out of the face")


def _arms(person: Person, view: str | None, config: CaptureConfig) -> Finding | None:
    if view not in ("front", "back"):
        return None
    body = person.body
    down = body.points[[23, 24]].mean(axis=0) - body.points[[11, 12]].mean(axis=0)
    angles = []
    for side, other in (_SIDES, _SIDES[::-1]):
        arm = body.point(f"{side}_wrist") - body.point(f"{side}_shoulder")
        out = np.sign((body.point(f"{side}_shoulder") - body.point(f"{other}_shoulder"))[0])
        angle = np.degrees(np.arctan2(arm[0], arm[1]) - np.arctan2(down[0], down[1])) * out
        angles.append((angle + 180) % 360 - 180)
    if min(angles) >= config.arms:
        return None
    which = "the arms lie" if max(angles) < config.arms else "an arm lies"
    return Finding("arms", f"{which} against the body; hold both well away from it, palms to the camera or down")


def _blurred(picture: NDArray[np.uint8], mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    if blur_of(picture, mask) <= config.blur:
        return None
    return Finding("blurred", "the picture is blurred; hold the camera still, clean its lens, use more light")


def _exposure(
    picture: NDArray[np.uint8], person: Person, mask: NDArray[np.bool_], config: CaptureConfig
) -> Finding | None:
    colours = picture[mask]
    skin = colours[:0]
    if person.face.presence > 0.5:
        face = np.zeros(mask.shape, np.uint8)
        cv2.fillConvexPoly(face, cv2.convexHull(person.face.points[:, :2].astype(np.int32)), 1)
        skin = picture[face > 0]
    burnt = len(skin) > 0 and (skin.max(axis=1) >= 253).mean() > config.burnt_face
    room = picture[~mask].max(axis=1) >= 253
    washed = room.mean() > 0.5 and (colours.max(axis=1) >= 253).mean() > config.washed if len(room) else False
    if burnt or washed or (colours.min(axis=1) >= 253).mean() > config.burnt:
        return Finding(
            "bright", "the person is overexposed, parts are plain white; use less light, no window before you"
        )
    brightness = colours.max(axis=1)
    if np.percentile(brightness, 95) < config.dark:
        return Finding("dark", "the person is underexposed; use more light, and none behind you")
    return None


def _mask(person: Person, mask: NDArray[np.bool_], given: bool) -> Finding | None:
    """The outline at full resolution has to be the network's, but for its edge, and hold the landmarks."""
    coarse = person.body.mask > 0.5
    agree = (mask & coarse).sum() / max((mask | coarse).sum(), 1)
    reach = 0.015 * person.body.crop.side
    seen = person.body.visible > 0.5
    inside = _inside(mask, person.body.points, reach)[seen]
    if agree > 0.85 and inside.mean() > 0.85:
        return None
    if given:
        return Finding("mask", "the given mask is not the person's outline; make the person white, all else black")
    return Finding("mask", "the person's outline is not found; choose a plain background, or give a mask")
