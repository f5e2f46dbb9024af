"""Check whether an avatar can be made from a picture, and report findings in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.check.finding import Finding, note
from glsplat.extras.authoring.check.posture import LYING, PostureConfig, arms, cut_off, lying, turned
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

__all__ = ["Capture", "CaptureConfig", "Finding", "check_capture", "is_outline"]

_GOOD_AGREEMENT, _POOR_AGREEMENT = 0.85, 0.75  # of a mask with the body network
_SATURATED_LEVEL = 253  # of 255
_SEVERAL = Finding("several", "more than one person is in the picture; show one person alone")


@dataclass(frozen=True)
class CaptureConfig:
    """Thresholds of the check. Presences are the networks' probabilities."""

    min_body_presence: float = 0.99
    """People have more, dolls, animals and drawings less."""
    min_face_presence: float = 0.5
    """In a picture from the front."""
    doll_face_presence: float = 0.05
    """Dolls have less of both this and ``doll_hand_presence``."""
    doll_hand_presence: float = 0.3
    sure_face_presence: float = 0.9
    """Only faces have more."""
    min_body_presence_with_face: float = 0.95
    """Of the body, together with a sure face."""
    min_partial_presence: float = 0.5
    """Of the body, if only half of a person may be shown."""
    min_face_distance: float = 0.08
    """Between two faces of a group, as a fraction of the picture's width."""
    min_height_px: float = 400.0
    """Height of the person."""
    posture: PostureConfig = field(default_factory=PostureConfig)
    max_blur: float = 0.62
    """Of ``blur_of``: 0 sharp, 1 completely blurred."""
    max_white_fraction: float = 0.12
    """Of the person's pixels, plain white."""
    max_burnt_face_fraction: float = 0.3
    """Of the face's pixels, with a saturated colour channel."""
    max_washed_fraction: float = 0.25
    """Of the person's pixels, with a saturated colour channel, if half of the room's have one."""
    min_brightness: float = 52.0
    """8-bit level of the person's brighter parts."""
    min_second_size: float = 0.12
    """Area of a second person, as a fraction of the first one's."""
    min_strip_width: float = 0.12
    """Strips of the picture beside the person are searched for faces if they are wider, in heights of the person."""
    min_second_presence: float = 0.95
    """Of the body of a second person, whom both networks must find."""


@dataclass(frozen=True, eq=False)
class Capture:
    """The result of the check, with the person and the mask that it found."""

    findings: tuple[Finding, ...]
    person: DetectedPerson | None = None
    mask: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    """[H, W] the person; without true pixels if nobody is found."""

    @property
    def good(self) -> bool:
        """There are no findings."""
        return not self.findings

    @property
    def refused(self) -> bool:
        """A finding refuses the picture."""
        return any(finding.refusal for finding in self.findings)


def check_capture(
    picture: NDArray[np.uint8],
    view: str | None = "front",
    config: CaptureConfig | None = None,
    known_mask: NDArray[np.bool_] | None = None,
) -> Capture:
    """Check a picture (RGB uint8 [H, W, 3]) of one of SIDES. Without a person the check ends after that finding.

    ``view`` None accepts any side. ``known_mask`` [H, W] is the person's mask, if it is known.
    """
    config = config or CaptureConfig()
    people = people_mask(picture)
    person = find_person(picture, people)
    sure = person is not None and _is_somebody(picture, person, people, config)
    if not sure:  # the first network misses grey people in busy rooms, so search the whole picture
        other = find_person(picture, np.ones_like(people))
        sure = other is not None and _is_somebody(picture, other, people, config)
        person = other if sure or person is None else person
    if person is None or not sure:
        nothing = np.zeros(picture.shape[:2], bool)
        return Capture((_nobody(picture, person, people, config),), None, nothing)
    outline = run_in_background(lambda: person_mask(picture, person.body) if known_mask is None else known_mask)
    several = _several(picture, person, people, config)
    mask = outline()
    cut = cut_off(person, mask, view, config.posture)
    half = cut is not None and cut.refusal
    down = None if half else lying(person, config.posture)
    if down is not None:  # the networks are reliable for upright people only
        return Capture((several or down,), person, mask)
    small = _small(mask, config)
    found = [
        several,
        cut,
        None if half else small,  # going closer does not help where half of a person is shown
        turned(person, view, config.posture) if view is not None else None,
        _face(person, view, config),
        None if half else arms(person, view, config.posture),
        _blurred(picture, mask, config) if small is None else None,
        _exposure(picture, person, mask, config),
        _mask(person, mask, known_mask is not None) if small is None and not half else None,
    ]
    return Capture(tuple(finding for finding in found if finding is not None), person, mask)


def _nobody(
    picture: NDArray[np.uint8], person: DetectedPerson | None, people: NDArray[np.float32], config: CaptureConfig
) -> Finding:
    """Return the finding if no whole, upright person is found: a group, half a person, a turned picture, or nobody."""
    sure_face = person is not None and person.face.presence > config.sure_face_presence
    if len(_faces(picture, people, config)) > 1 or (
        person is not None and sure_face and _several(picture, person, people, config) is not None
    ):
        return _SEVERAL
    if person is not None and (sure_face or person.body.presence >= config.min_body_presence):
        if person.body.presence > config.min_partial_presence:
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
    """Return the horizontal positions of visible faces, as fractions of the picture's width.

    The body network finds one person and fails on a row of people, so halves and thirds of the row are searched.
    """
    width = picture.shape[1]
    row = bounds(_foreground(picture, people))
    left, right = (row[0], row[2]) if row[2] > row[0] else (0.0, float(width))
    found: list[float] = []
    for count in (2, 3):
        for start, end in pairwise(np.linspace(left, right, count + 1)):
            body = _body_with_face(picture, start, end, config)
            if body is not None:
                at = float(body.point("nose")[0]) / width
                if all(abs(at - other) > config.min_face_distance for other in found):
                    found.append(at)
    return found


def _body_with_face(picture: NDArray[np.uint8], start: float, end: float, config: CaptureConfig) -> DetectedBody | None:
    """Return a body with a sure face between two columns of the picture, or None."""
    body = find_body_in_box(picture, np.array([start, 0.0, end, len(picture)]))
    if body.presence < config.min_partial_presence or face_probability(picture, body) < config.sure_face_presence:
        return None
    return body


def _is_somebody(
    picture: NDArray[np.uint8], person: DetectedPerson, people: NDArray[np.float32], config: CaptureConfig
) -> bool:
    """Return whether two networks agree on a person, or a face is sure; each alone has false positives."""
    body = person.body
    own = body.mask > 0.5
    sure = person.face.presence > config.sure_face_presence
    if body.presence < (config.min_body_presence_with_face if sure else config.min_body_presence) or not own.any():
        return False
    if sure and body.presence >= config.min_body_presence and own.mean() > 0.002:
        return True
    shared = (_foreground(picture, people) & own).sum() / own.sum()
    inside = _inside(own, body.points[11:33], 0.02 * float(np.ptp(np.flatnonzero(own.any(axis=1)))))
    return bool(shared > 0.5 and own.mean() > 0.002 and (sure or inside.mean() > 0.6))


def _inside(mask: NDArray[np.bool_], points: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Return whether points [N, 2] lie in the mask or within ``reach`` pixels of it; false outside the picture."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    column, row = np.floor(points).astype(int).T
    valid = (row >= 0) & (column >= 0) & (row < mask.shape[0]) & (column < mask.shape[1])
    return valid & (distance[row.clip(0, mask.shape[0] - 1), column.clip(0, mask.shape[1] - 1)] <= reach)


def _several(
    picture: NDArray[np.uint8], person: DetectedPerson, people: NDArray[np.float32], config: CaptureConfig
) -> Finding | None:
    """Return the finding of a second person, in the foreground outside the first person's mask.

    The network overlooks distant people beside a large one, so the search is repeated with the first person painted
    over.
    """
    own = person.body.mask > 0.5
    reach = max(int(0.03 * person.body.crop.side), 3)
    near = cv2.dilate(own.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    beside = _foreground(picture, people) & ~near
    if _is_second(picture, beside, near, own, config):
        return _SEVERAL
    without = _painted_over(picture, near)
    if _is_second(without, _foreground(without, people_mask(without)), near, own, config):
        return _SEVERAL
    return _SEVERAL if _faces_beside(without, near, own, config) else None


def _foreground(picture: NDArray[np.uint8], people: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the mask [H, W] of ``people``, the result of ``people_mask``."""
    return enclosing_square(picture).paste(people, picture.shape[:2]) > 0.5


def _is_second(
    picture: NDArray[np.uint8],
    rest: NDArray[np.bool_],
    near: NDArray[np.bool_],
    own: NDArray[np.bool_],
    config: CaptureConfig,
) -> bool:
    """Return whether one of the three largest components of ``rest`` is a person mostly outside ``near``."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8))
    for index in np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:3] + 1:
        if stats[index, cv2.CC_STAT_AREA] < config.min_second_size * own.sum():
            break
        second = find_body_in_box(picture, bounds(labels == index))
        theirs = second.mask > 0.5
        if second.presence > config.min_second_presence and (theirs & ~near).sum() > 0.5 * theirs.sum():
            return True
    return False


def _faces_beside(
    picture: NDArray[np.uint8], near: NDArray[np.bool_], own: NDArray[np.bool_], config: CaptureConfig
) -> bool:
    """Return whether a face is visible left or right of the first person.

    ``picture`` has the first person painted over; ``own`` is their mask, ``near`` the mask with a margin.
    """
    left, top, right, bottom = bounds(near)
    for start, end in ((0.0, left), (right, float(picture.shape[1]))):
        if end - start < config.min_strip_width * (bottom - top):
            continue
        second = _body_with_face(picture, start, end, config)
        if second is None:
            continue
        theirs, (x, y) = second.mask > 0.5, second.point("nose").astype(int)
        inside = 0 <= x < picture.shape[1] and 0 <= y < len(picture) and not near[y, x]
        if inside and theirs.sum() > config.min_second_size * own.sum() and (theirs & ~near).sum() > 0.5 * theirs.sum():
            return True
    return False


def _painted_over(picture: NDArray[np.uint8], area: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the picture with an area inpainted from the room, at the networks' resolution."""
    scale = min(256 / max(picture.shape[:2]), 1.0)
    size = max(round(picture.shape[1] * scale), 1), max(round(picture.shape[0] * scale), 1)
    hidden = cv2.resize(area.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    filled = cv2.inpaint(small, hidden.astype(np.uint8), 3, cv2.INPAINT_TELEA)
    return np.where(area[..., None], cv2.resize(filled, picture.shape[1::-1]), picture).astype(np.uint8)


def _small(mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    rows = np.flatnonzero(mask.any(axis=1))
    high = int(rows[-1] - rows[0] + 1) if len(rows) else 0
    if high >= config.min_height_px:
        return None
    return Finding(
        "small",
        f"the person is {high} pixels high, {config.min_height_px:.0f} are needed; go closer or take a larger picture",
    )


def _face(person: DetectedPerson, view: str | None, config: CaptureConfig) -> Finding | None:
    """Note a hidden face, which is guessed; refuse dolls, which have neither face nor hands."""
    if view != "front" or person.body.point("nose")[1] < 0:
        return None
    if person.face.displaced:
        return note("face", "the face is covered in part, what that hides is guessed; take mask, hand and hair off it")
    if person.face.presence > config.min_face_presence:
        return None
    hands = max(person.left_hand.presence, person.right_hand.presence)
    if max(person.face.presence / config.doll_face_presence, hands / config.doll_hand_presence) < 1:
        return Finding("face", "neither face nor hands are found; show a person who looks into the camera")
    return note("face", "no face is seen, it is guessed; look into the camera, hands, hair and hat out of the face")


def _blurred(picture: NDArray[np.uint8], mask: NDArray[np.bool_], config: CaptureConfig) -> Finding | None:
    if blur_of(picture, mask) <= config.max_blur:
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
    burnt = _saturated(skin) > config.max_burnt_face_fraction
    washed = _saturated(picture[~mask]) > 0.5 and _saturated(colours) > config.max_washed_fraction
    if burnt or washed or (colours.min(axis=1) >= _SATURATED_LEVEL).mean() > config.max_white_fraction:
        return Finding(
            "bright", "the person is overexposed, parts are plain white; use less light, no window before you"
        )
    brightness = colours.max(axis=1)
    if np.percentile(brightness, 95) < config.min_brightness:
        return Finding("dark", "the person is underexposed; use more light, and none behind you")
    return None


def _saturated(colours: NDArray[np.uint8]) -> float:
    """Return the fraction of colours [N, 3] with a saturated channel; 0 for none."""
    return float((colours.max(axis=1) >= _SATURATED_LEVEL).mean()) if len(colours) else 0.0


def is_outline(person: DetectedPerson, mask: NDArray[np.bool_]) -> bool:
    """Return whether a mask [H, W] is roughly the person, and not a frame or a picture's round corners."""
    return _agreement(person, mask) > _GOOD_AGREEMENT


def _mask(person: DetectedPerson, mask: NDArray[np.bool_], known: bool) -> Finding | None:
    agreement = _agreement(person, mask)
    if agreement > _GOOD_AGREEMENT:
        return None
    if known:
        return Finding("mask", "the given mask is not the person's outline; make the person white, all else black")
    if agreement > _POOR_AGREEMENT:
        return note("mask", "the person's outline is hard to find; choose a plain background, or give a mask")
    return Finding("mask", "the person's outline is not found; choose a plain background, or give a mask")


def _agreement(person: DetectedPerson, mask: NDArray[np.bool_]) -> float:
    """Return the lesser of the IoU with the network's mask and the fraction of visible landmarks in the mask."""
    coarse = person.body.mask > 0.5
    agree = (mask & coarse).sum() / max((mask | coarse).sum(), 1)
    reach = 0.015 * person.body.crop.side
    inside = _inside(mask, person.body.points, reach)[person.body.visible > 0.5]
    return min(float(agree), float(inside.mean()) if len(inside) else 0.0)
