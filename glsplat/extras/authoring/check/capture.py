"""Check whether an avatar can be made from a picture, and report findings in words."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64
from glsplat.extras.authoring.check.posture import LYING, Finding, arms, cut_off, lying, note, turned
from glsplat.extras.authoring.compute.threads import run_in_background
from glsplat.extras.authoring.networks.face import face_probability
from glsplat.extras.authoring.networks.head_parts import head_parts
from glsplat.extras.authoring.networks.people import DetectedPerson, find_person
from glsplat.extras.authoring.networks.person import (
    DetectedBody,
    bounds,
    enclosing_square,
    find_body_in_box,
    people_mask,
)
from glsplat.extras.authoring.segment.mask import person_mask, with_head

_MAX_HEIGHT_PX = 1000  # of the person; larger ones are reduced, since an avatar shows no more detail
_BLUR_PX = 9  # width of the second blur
_GOOD_AGREEMENT, _POOR_AGREEMENT = 0.85, 0.75  # of a mask with the body network
_SATURATED_LEVEL = 253  # of 255
_SEVERAL = Finding("several", "more than one person is in the picture; show one person alone")
# presences are the networks' probabilities
_MIN_BODY_PRESENCE = 0.99  # people have more, dolls, animals and drawings less
_MIN_FACE_PRESENCE = 0.5  # in a picture from the front
_DOLL_FACE_PRESENCE, _DOLL_HAND_PRESENCE = 0.05, 0.3  # dolls have less of both
_SURE_FACE_PRESENCE = 0.9  # only faces have more
_MIN_BODY_PRESENCE_WITH_FACE = 0.95  # together with a sure face
_MIN_PARTIAL_PRESENCE = 0.5  # of a body that may be cut in half
_MIN_SECOND_PRESENCE = 0.95  # of a second body, which both networks must find
_MIN_HEIGHT_PX = 400.0  # of the person
_MIN_FACE_DISTANCE_FRACTION = 0.08  # of the picture's width, between two faces of a group
_MIN_SECOND_FRACTION = 0.12  # area of a second person, of the first one's
_MIN_STRIP_FRACTION = 0.12  # width of a strip beside the person that is searched for faces, of the person's height
_MAX_BLUR = 0.62  # of ``blur_of``
_MAX_WHITE_FRACTION = 0.12  # of the person's pixels, plain white
_MAX_BURNT_FACE_FRACTION = 0.3  # of the face's pixels, with a saturated channel
_MAX_WASHED_FRACTION = 0.25  # of the person's pixels, with a saturated channel, if half of the room's have one
_MIN_BRIGHTNESS_LEVEL = 52.0  # of 255, of the person's brighter parts


def blur_of(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """Return 0 for a sharp picture to 1 for a completely blurred one, inside ``mask`` [H, W] and along its outline.

    A further blur removes most differences between neighbours of a sharp picture and few of a blurred one (Crete et
    al., The Blur Effect, 2007). The worse of the two directions counts, because hands shake in one.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 1.0
    area = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    grey = cv2.cvtColor(np.ascontiguousarray(picture[area]), cv2.COLOR_RGB2GRAY).astype(np.float32)
    inside = mask[area].astype(np.float32)
    scale = _MAX_HEIGHT_PX / grey.shape[0]
    if scale < 1:
        size = max(round(grey.shape[1] * scale), 2), _MAX_HEIGHT_PX
        grey, inside = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (grey, inside))
    inside = cv2.dilate(inside, np.ones((5, 5), np.uint8)) > 0.5
    values = []
    for axis, window in ((0, (1, _BLUR_PX)), (1, (_BLUR_PX, 1))):
        before = np.abs(np.diff(grey, axis=axis))
        after = np.abs(np.diff(cv2.blur(grey, window), axis=axis))
        used = np.take(inside, range(1, inside.shape[axis]), axis=axis)
        total = float(before[used].sum())
        values.append(1 - float(np.maximum(before - after, 0)[used].sum()) / total if total > 0 else 1.0)
    return max(values)


@dataclass(frozen=True, eq=False)
class Capture:
    """The result of the check, with the person and the mask that it found."""

    findings: tuple[Finding, ...]
    person: DetectedPerson | None = None
    mask: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    """[H, W] the person; without true pixels if nobody is found."""

    @property
    def refused(self) -> bool:
        """A finding refuses the picture."""
        return any(finding.refusal for finding in self.findings)


def check_capture(
    picture: NDArray[np.uint8], view: str | None = "front", known_mask: NDArray[np.bool_] | None = None
) -> Capture:
    """Check a picture (RGB uint8 [H, W, 3]) of one of SIDES. Without a person the check ends after that finding.

    ``view`` None accepts any side. ``known_mask`` [H, W] is the person's mask, if it is known.
    """
    people = people_mask(picture)
    person = find_person(picture, people)
    sure = person is not None and _is_somebody(picture, person, people)
    if not sure:  # the first network misses grey people in busy rooms, so search the whole picture
        other = find_person(picture, np.ones_like(people))
        sure = other is not None and _is_somebody(picture, other, people)
        person = other if sure or person is None else person
    if person is None or not sure:
        nothing = np.zeros(picture.shape[:2], bool)
        return Capture((_nobody(picture, person, people),), None, nothing)
    body, face = person.body, person.face
    outline = run_in_background(lambda: person_mask(picture, body) if known_mask is None else known_mask)
    parts = run_in_background(lambda: head_parts(picture, face))
    several = _several(picture, person, people)
    person = replace(person, head_parts=parts())
    mask = outline() if known_mask is not None else with_head(outline(), person.head_parts)
    cut = cut_off(person, mask, view)
    half = cut is not None and cut.refusal
    down = None if half else lying(person)
    if down is not None:  # the networks are reliable for upright people only
        return Capture((several or down,), person, mask)
    small = _small(mask)
    found = [
        several,
        cut,
        None if half else small,  # going closer does not help where half of a person is shown
        turned(person, view) if view is not None else None,
        _face(person, view),
        None if half else arms(person, view),
        _blurred(picture, mask) if small is None else None,
        _exposure(picture, person, mask),
        _mask(person, mask, known_mask is not None) if small is None and not half else None,
    ]
    return Capture(tuple(finding for finding in found if finding is not None), person, mask)


def _nobody(picture: NDArray[np.uint8], person: DetectedPerson | None, people: F32) -> Finding:
    """Return the finding if no whole, upright person is found: a group, half a person, a turned picture, or nobody."""
    sure_face = person is not None and person.face.presence > _SURE_FACE_PRESENCE
    if len(_faces(picture, people)) > 1 or (
        person is not None and sure_face and _several(picture, person, people) is not None
    ):
        return _SEVERAL
    if person is not None and (sure_face or person.body.presence >= _MIN_BODY_PRESENCE):
        if person.body.presence > _MIN_PARTIAL_PRESENCE:
            cut = cut_off(person, person.body.mask > 0.5, None)
            if cut is not None and cut.refusal:
                return cut
    for quarters in (1, 3, 2):
        turned = np.ascontiguousarray(np.rot90(picture, quarters))
        people = people_mask(turned)
        upright = find_person(turned, people)
        if upright is not None and _is_somebody(turned, upright, people):
            if lying(upright) is None:
                return LYING
    return Finding("nobody", "nobody is found in the picture; show one whole person, upright")


def _faces(picture: NDArray[np.uint8], people: F32) -> list[float]:
    """Return the horizontal positions of visible faces, as fractions of the picture's width.

    The body network finds one person and fails on a row of people, so halves and thirds of the row are searched.
    """
    width = picture.shape[1]
    row = bounds(_foreground(picture, people))
    left, right = (row[0], row[2]) if row[2] > row[0] else (0.0, float(width))
    found: list[float] = []
    for count in (2, 3):
        for start, end in pairwise(np.linspace(left, right, count + 1)):
            body = _body_with_face(picture, start, end)
            if body is not None:
                at = float(body.point("nose")[0]) / width
                if all(abs(at - other) > _MIN_FACE_DISTANCE_FRACTION for other in found):
                    found.append(at)
    return found


def _body_with_face(picture: NDArray[np.uint8], start: float, end: float) -> DetectedBody | None:
    """Return a body with a sure face between two columns of the picture, or None."""
    body = find_body_in_box(picture, np.array([start, 0.0, end, len(picture)]))
    if body.presence < _MIN_PARTIAL_PRESENCE or face_probability(picture, body) < _SURE_FACE_PRESENCE:
        return None
    return body


def _is_somebody(picture: NDArray[np.uint8], person: DetectedPerson, people: F32) -> bool:
    """Return whether two networks agree on a person, or a face is sure; each alone has false positives."""
    body = person.body
    own = body.mask > 0.5
    sure = person.face.presence > _SURE_FACE_PRESENCE
    if body.presence < (_MIN_BODY_PRESENCE_WITH_FACE if sure else _MIN_BODY_PRESENCE) or not own.any():
        return False
    if sure and body.presence >= _MIN_BODY_PRESENCE and own.mean() > 0.002:
        return True
    shared = (_foreground(picture, people) & own).sum() / own.sum()
    inside = _inside(own, body.points[11:33], 0.02 * float(np.ptp(np.flatnonzero(own.any(axis=1)))))
    return bool(shared > 0.5 and own.mean() > 0.002 and (sure or inside.mean() > 0.6))


def _inside(mask: NDArray[np.bool_], points: F64, reach: float) -> NDArray[np.bool_]:
    """Return whether points [N, 2] lie in the mask or within ``reach`` pixels of it; false outside the picture."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    column, row = np.floor(points).astype(int).T
    valid = (row >= 0) & (column >= 0) & (row < mask.shape[0]) & (column < mask.shape[1])
    return valid & (distance[row.clip(0, mask.shape[0] - 1), column.clip(0, mask.shape[1] - 1)] <= reach)


def _several(picture: NDArray[np.uint8], person: DetectedPerson, people: F32) -> Finding | None:
    """Return the finding of a second person, in the foreground outside the first person's mask.

    The network overlooks distant people beside a large one, so the search is repeated with the first person painted
    over.
    """
    own = person.body.mask > 0.5
    reach = max(int(0.03 * person.body.crop.side), 3)
    near = cv2.dilate(own.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    beside = _foreground(picture, people) & ~near
    if _is_second(picture, beside, near, own):
        return _SEVERAL
    without = _painted_over(picture, near)
    if _is_second(without, _foreground(without, people_mask(without)), near, own):
        return _SEVERAL
    return _SEVERAL if _faces_beside(without, near, own) else None


def _foreground(picture: NDArray[np.uint8], people: F32) -> NDArray[np.bool_]:
    """Return the mask [H, W] of ``people``, the result of ``people_mask``."""
    return enclosing_square(picture).paste(people, picture.shape[:2]) > 0.5


def _is_second(
    picture: NDArray[np.uint8], rest: NDArray[np.bool_], near: NDArray[np.bool_], own: NDArray[np.bool_]
) -> bool:
    """Return whether one of the three largest components of ``rest`` is a person mostly outside ``near``."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8))
    for index in np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:3] + 1:
        if stats[index, cv2.CC_STAT_AREA] < _MIN_SECOND_FRACTION * own.sum():
            break
        second = find_body_in_box(picture, bounds(labels == index))
        theirs = second.mask > 0.5
        if second.presence > _MIN_SECOND_PRESENCE and (theirs & ~near).sum() > 0.5 * theirs.sum():
            return True
    return False


def _faces_beside(picture: NDArray[np.uint8], near: NDArray[np.bool_], own: NDArray[np.bool_]) -> bool:
    """Return whether a face is visible left or right of the first person.

    ``picture`` has the first person painted over; ``own`` is their mask, ``near`` the mask with a margin.
    """
    left, top, right, bottom = bounds(near)
    for start, end in ((0.0, left), (right, float(picture.shape[1]))):
        if end - start < _MIN_STRIP_FRACTION * (bottom - top):
            continue
        second = _body_with_face(picture, start, end)
        if second is None:
            continue
        theirs, (x, y) = second.mask > 0.5, second.point("nose").astype(int)
        inside = 0 <= x < picture.shape[1] and 0 <= y < len(picture) and not near[y, x]
        if inside and theirs.sum() > _MIN_SECOND_FRACTION * own.sum() and (theirs & ~near).sum() > 0.5 * theirs.sum():
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


def _small(mask: NDArray[np.bool_]) -> Finding | None:
    rows = np.flatnonzero(mask.any(axis=1))
    high = int(rows[-1] - rows[0] + 1) if len(rows) else 0
    if high >= _MIN_HEIGHT_PX:
        return None
    return Finding(
        "small",
        f"the person is {high} pixels high, {_MIN_HEIGHT_PX:.0f} are needed; go closer or take a larger picture",
    )


def _face(person: DetectedPerson, view: str | None) -> Finding | None:
    """Note a hidden face, which is guessed; refuse dolls, which have neither face nor hands."""
    if view != "front" or person.body.point("nose")[1] < 0:
        return None
    if person.face.displaced:
        return note("face", "the face is covered in part, what that hides is guessed; take mask, hand and hair off it")
    if person.face.presence > _MIN_FACE_PRESENCE:
        return None
    hands = max(person.left_hand.presence, person.right_hand.presence)
    if max(person.face.presence / _DOLL_FACE_PRESENCE, hands / _DOLL_HAND_PRESENCE) < 1:
        return Finding("face", "neither face nor hands are found; show a person who looks into the camera")
    return note("face", "no face is seen, it is guessed; look into the camera, hands, hair and hat out of the face")


def _blurred(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> Finding | None:
    if blur_of(picture, mask) <= _MAX_BLUR:
        return None
    return Finding("blurred", "the picture is blurred; hold the camera still, clean its lens, use more light")


def _exposure(picture: NDArray[np.uint8], person: DetectedPerson, mask: NDArray[np.bool_]) -> Finding | None:
    colours = picture[mask]
    skin = colours[:0]
    if person.face.presence > 0.5:
        face = np.zeros(mask.shape, np.uint8)
        cv2.fillConvexPoly(face, cv2.convexHull(person.face.points[:, :2].astype(np.int32)), 1)
        skin = picture[face > 0]
    burnt = _saturated(skin) > _MAX_BURNT_FACE_FRACTION
    washed = _saturated(picture[~mask]) > 0.5 and _saturated(colours) > _MAX_WASHED_FRACTION
    if burnt or washed or (colours.min(axis=1) >= _SATURATED_LEVEL).mean() > _MAX_WHITE_FRACTION:
        return Finding(
            "bright", "the person is overexposed, parts are plain white; use less light, no window before you"
        )
    brightness = colours.max(axis=1)
    if np.percentile(brightness, 95) < _MIN_BRIGHTNESS_LEVEL:
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
