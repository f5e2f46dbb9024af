"""Is this a picture that an avatar can be made from? Looked at before any work, and answered in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.check.finding import Finding, note
from glsplat.extras.authoring.check.posture import LYING, VIEWS, PostureConfig, arms, cut_off, lying, turned
from glsplat.extras.authoring.check.sharpness import blur_of
from glsplat.extras.authoring.compute.threads import run_in_background
from glsplat.extras.authoring.networks.face import face_probability
from glsplat.extras.authoring.networks.people import DetectedPerson, find_person
from glsplat.extras.authoring.networks.person import (
    DetectedBody,
    bounds,
    enclosing_square,
    find_body_in_box,
    people_mask,
)
from glsplat.extras.authoring.segment.mask import person_mask

__all__ = ["VIEWS", "Capture", "CaptureConfig", "Finding", "check_capture", "is_outline"]


@dataclass(frozen=True)
class CaptureConfig:
    """Where the lines are drawn; pixels, degrees and shares."""

    presence: float = 0.99
    """Of the body network: people have more, dolls, animals and drawings less."""
    face: float = 0.5
    """Of the face network, in a picture from the front."""
    no_face: float = 0.05
    no_hand: float = 0.3
    """Of the networks of face and hands, both: dolls have less."""
    sure_face: float = 0.9
    """Of the face network: nothing but a face gives it."""
    face_presence: float = 0.95
    """Of the body network, where there surely is a face."""
    half_presence: float = 0.5
    """Of the body network, where half of somebody may be seen."""
    apart: float = 0.08
    """Between two faces of a group, in shares of the picture's width."""
    smallest: float = 400.0
    """Pixels that a person has to be high."""
    posture: PostureConfig = field(default_factory=PostureConfig)
    """How the person has to stand."""
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
    strip: float = 0.12
    """Width of the picture beside the first person in which a face is looked for, in heights of that person."""
    other_presence: float = 0.95
    """Of the body network, for a second person, whom both networks have to see."""


@dataclass(frozen=True, eq=False)
class Capture:
    """What the check found, and what it had to work out for that."""

    findings: tuple[Finding, ...]
    person: DetectedPerson | None = None
    mask: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    """[H, W] the person; empty where nobody is found."""

    @property
    def good(self) -> bool:
        """Nothing was found."""
        return not self.findings

    @property
    def refused(self) -> bool:
        """No avatar worth having can be made of it."""
        return any(finding.refusal for finding in self.findings)


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
    sure = person is not None and _is_somebody(picture, person, people, config)
    if not sure:  # grey people in busy rooms: the first network sees nothing, or a piece of the room, the others may
        other = find_person(picture, np.ones_like(people))
        sure = other is not None and _is_somebody(picture, other, people, config)
        person = other if sure or person is None else person
    if person is None or not sure:
        nothing = np.zeros(picture.shape[:2], bool)
        return Capture((_instead(picture, person, people, config),), None, nothing)
    outline = run_in_background(lambda: person_mask(picture, person.body) if given is None else given)
    several = _several(picture, person, people, config)
    mask = outline()
    cut = cut_off(person, mask, view, config.posture)
    half = cut is not None and cut.refusal
    down = None if half else lying(person, config.posture)
    if down is not None:  # the networks know upright people only, so nothing else can be believed
        return Capture((several or down,), person, mask)
    small = _small(mask, config)
    found = [
        several,
        cut,
        None if half else small,  # what is seen of half a person is small, and to go closer is no help
        turned(person, view, config.posture) if view is not None else None,
        _face(person, view, config),
        None if half else arms(person, view, config.posture),
        _blurred(picture, mask, config) if small is None else None,
        _exposure(picture, person, mask, config),
        _mask(person, mask, given is not None) if small is None and not half else None,
    ]
    return Capture(tuple(finding for finding in found if finding is not None), person, mask)


def _instead(
    picture: NDArray[np.uint8], person: DetectedPerson | None, people: NDArray[np.float32], config: CaptureConfig
) -> Finding:
    """What to say where nobody stands whole and upright: half of somebody, a group, or the picture on its side."""
    several = len(_faces(picture, people, config)) > 1
    if several or (
        person is not None
        and person.face.presence > config.sure_face
        and _several(picture, person, people, config) is not None
    ):
        return _SEVERAL
    if person is not None and (person.body.presence >= config.presence or person.face.presence > config.sure_face):
        if person.body.presence > config.half_presence:
            cut = cut_off(person, person.body.mask > 0.5, None, config.posture)
            if cut is not None and cut.refusal:
                return cut
    for quarters in (1, 3, 2):
        turned = np.ascontiguousarray(np.rot90(picture, quarters))
        people = people_mask(turned)
        upright = find_person(turned, people)
        if upright is not None and _is_somebody(turned, upright, people, config):
            if lying(upright, config.posture) is None:
                return LYING
    return Finding("nobody", "nobody is found in the picture; show one whole person, upright")


def _faces(picture: NDArray[np.uint8], people: NDArray[np.float32], config: CaptureConfig) -> list[float]:
    """Where people stand from left to right who show their faces, in shares of the picture's width.

    The body network looks at one person, and at a row of people sees none: so at halves and thirds of the row.
    """
    width = picture.shape[1]
    row = bounds(_seen(picture, people))
    left, right = (row[0], row[2]) if row[2] > row[0] else (0.0, float(width))
    found: list[float] = []
    for count in (2, 3):
        for start, end in pairwise(np.linspace(left, right, count + 1)):
            body = _faced(picture, start, end, config)
            if body is not None:
                at = float(body.point("nose")[0]) / width
                if all(abs(at - other) > config.apart for other in found):
                    found.append(at)
    return found


def _faced(picture: NDArray[np.uint8], start: float, end: float, config: CaptureConfig) -> DetectedBody | None:
    """Somebody between two columns of the picture who surely shows their face."""
    body = find_body_in_box(picture, np.array([start, 0.0, end, len(picture)]))
    if body.presence < config.half_presence or face_probability(picture, body) < config.sure_face:
        return None
    return body


def _is_somebody(
    picture: NDArray[np.uint8], person: DetectedPerson, people: NDArray[np.float32], config: CaptureConfig
) -> bool:
    """Two networks have to agree, for one sees bodies in anything and the other people in any foreground; or a face."""
    body = person.body
    seen = _seen(picture, people)
    own = body.mask > 0.5
    sure = person.face.presence > config.sure_face
    if body.presence < (config.face_presence if sure else config.presence) or not own.any():
        return False
    if sure and body.presence >= config.presence and own.mean() > 0.002:
        return True
    shared = (seen & own).sum() / own.sum()
    inside = _inside(own, body.points[11:33], 0.02 * float(np.ptp(np.flatnonzero(own.any(axis=1)))))
    return bool(shared > 0.5 and own.mean() > 0.002 and (sure or inside.mean() > 0.6))


def _inside(mask: NDArray[np.bool_], points: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """[N] whether points lie in the mask or at most ``reach`` pixels beside it; those outside the picture do not."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    column, row = np.floor(points).astype(int).T
    valid = (row >= 0) & (column >= 0) & (row < mask.shape[0]) & (column < mask.shape[1])
    return valid & (distance[row.clip(0, mask.shape[0] - 1), column.clip(0, mask.shape[1] - 1)] <= reach)


def _several(
    picture: NDArray[np.uint8], person: DetectedPerson, people: NDArray[np.float32], config: CaptureConfig
) -> Finding | None:
    """People beside the first one: what the first network sees and the first person's mask does not cover.

    Who stands farther behind is overlooked beside somebody large, so the first person is painted over as well.
    """
    own = person.body.mask > 0.5
    reach = max(int(0.03 * person.body.crop.side), 3)
    near = cv2.dilate(own.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    beside = _seen(picture, people) & ~near
    if _is_second(picture, beside, near, own, config):
        return _SEVERAL
    without = _painted_over(picture, near)
    if _is_second(without, _seen(without, people_mask(without)), near, own, config):
        return _SEVERAL
    return _SEVERAL if _faces_beside(without, near, own, config) else None


_SEVERAL = Finding("several", "more than one person is in the picture; show one person alone")


def _seen(picture: NDArray[np.uint8], people: NDArray[np.float32]) -> NDArray[np.bool_]:
    """[H, W] where the first network sees people."""
    return enclosing_square(picture).paste(people, picture.shape[:2]) > 0.5


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
        second = find_body_in_box(picture, bounds(labels == index))
        theirs = second.mask > 0.5
        if second.presence > config.other_presence and (theirs & ~near).sum() > 0.5 * theirs.sum():
            return True
    return False


def _faces_beside(
    picture: NDArray[np.uint8], near: NDArray[np.bool_], own: NDArray[np.bool_], config: CaptureConfig
) -> bool:
    """Whether somebody shows a face left or right of the first person, whom the first network does not see.

    ``picture`` is without the first person, who is ``own`` and with a margin ``near``.
    """
    left, top, right, bottom = bounds(near)
    for start, end in ((0.0, left), (right, float(picture.shape[1]))):
        if end - start < config.strip * (bottom - top):
            continue
        second = _faced(picture, start, end, config)
        if second is None:
            continue
        theirs, (x, y) = second.mask > 0.5, second.point("nose").astype(int)
        inside = 0 <= x < picture.shape[1] and 0 <= y < len(picture) and not near[y, x]
        if inside and theirs.sum() > config.other * own.sum() and (theirs & ~near).sum() > 0.5 * theirs.sum():
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


def _small(mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    rows = np.flatnonzero(mask.any(axis=1))
    high = int(rows[-1] - rows[0] + 1) if len(rows) else 0
    if high >= config.smallest:
        return None
    return Finding(
        "small",
        f"the person is {high} pixels high, {config.smallest:.0f} are needed; go closer or take a larger picture",
    )


def _face(person: DetectedPerson, view: str | None, config: CaptureConfig) -> Finding | None:
    """A face that is hidden is guessed; dolls have neither face nor hands."""
    if view != "front" or person.body.point("nose")[1] < 0:
        return None
    if person.face.displaced:
        return note("face", "the face is covered in part, what that hides is guessed; take mask, hand and hair off it")
    if person.face.presence > config.face:
        return None
    hands = max(person.left_hand.presence, person.right_hand.presence)
    if max(person.face.presence / config.no_face, hands / config.no_hand) < 1:
        return Finding("face", "neither face nor hands are found; show a person who looks into the camera")
    return note("face", "no face is seen, it is guessed; look into the camera, hands, hair and hat out of the face")


def _blurred(picture: NDArray[np.uint8], mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    if blur_of(picture, mask) <= config.blur:
        return None
    return Finding("blurred", "the picture is blurred; hold the camera still, clean its lens, use more light")


def _exposure(
    picture: NDArray[np.uint8], person: DetectedPerson, mask: NDArray[np.bool_], config: CaptureConfig
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


def is_outline(person: DetectedPerson, mask: NDArray[np.bool_]) -> bool:
    """Whether a mask [H, W] is about the person's outline, and not a frame's or a picture's round corners."""
    return min(_agreement(person, mask)) > _AGREES


def _mask(person: DetectedPerson, mask: NDArray[np.bool_], given: bool) -> Finding | None:
    """The outline at full resolution has to be the network's, but for its edge, and hold the landmarks."""
    agreement = min(_agreement(person, mask))
    if agreement > _AGREES:
        return None
    if given:
        return Finding("mask", "the given mask is not the person's outline; make the person white, all else black")
    if agreement > _HARDLY:
        return note("mask", "the person's outline is hard to find; choose a plain background, or give a mask")
    return Finding("mask", "the person's outline is not found; choose a plain background, or give a mask")


_AGREES, _HARDLY = 0.85, 0.75


def _agreement(person: DetectedPerson, mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Intersection over union with the network's own mask, and the share of seen landmarks that lie in it."""
    coarse = person.body.mask > 0.5
    agree = (mask & coarse).sum() / max((mask | coarse).sum(), 1)
    reach = 0.015 * person.body.crop.side
    inside = _inside(mask, person.body.points, reach)[person.body.visible > 0.5]
    return float(agree), float(inside.mean()) if len(inside) else 0.0
