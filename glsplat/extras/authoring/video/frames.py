"""Check frames of a turn: one whole person in each, seen from all around; and estimate which way they face.

The body network measures the turn of shoulders and hips to about ten degrees, and sometimes mistakes a back for a
front; the face network does not. A person turns evenly: of all even turns to the left or right, the one that agrees
with most frames is chosen (Viterbi path through 72 directions).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.check.capture import blur_of, check_capture
from glsplat.extras.authoring.networks.face import find_face
from glsplat.extras.authoring.networks.people import DetectedPerson, degrees_between, find_hand, swap_sides
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.extras.authoring.video.film import MIN_FRAMES, is_video, read_frames

_DIRECTIONS = 72
_SIGMA_DEG = 15.0  # of the network's error; costs are squared errors in sigmas
_MAX_COST = 16.0  # of an outlier of any size
_FLIP_COST = 4.0  # of a back taken for a front
_MIN_FACE, _MAX_FACELESS = 0.9, 0.2  # presence of a visible face, and of none
_FACE_UP_TO_DEG, _FACELESS_FROM_DEG = 110.0, 60.0  # turns that show a face, and that may hide it
_FACE_COST, _FACELESS_COST = 9.0, 2.0  # of a contradiction to these; hair hides faces
_STEPS_DEG = np.concatenate([np.arange(-48.0, -2.9, 3.0), np.arange(3.0, 48.1, 3.0)])  # between frames
_STEP_TOLERANCE = 0.5, 6.0  # sigma of steps: fraction of a step, plus degrees
FrameSource = str | os.PathLike[str]
"""A video, or one of several picture files."""
_MAX_GAP_DEG = 110.0  # of the turn without a frame; a larger part of the person would be a guess
_MAX_FRONT_DEG = 35.0  # of the most frontal frame from the front


def facings(people: Sequence[DetectedPerson], *, in_order: bool) -> F64:
    """Return the turn of each person [N], 0 to 360 degrees to their own left from facing the camera.

    ``in_order``: the pictures follow each other in time, in steps of less than an eighth of a turn.
    """
    grid = np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS
    costs = np.stack([_costs(person, grid) for person in people])  # [N, 72]
    if in_order and len(people) > 2:
        best = min((_path(costs, grid, float(step)) for step in _STEPS_DEG), key=lambda found: found[0])[1]
    else:
        best = costs.argmin(axis=1)
    # pulled towards the measurements, at most half a sigma off the path
    measured = np.array([_measured_turn(person) for person in people])
    off = (measured - grid[best] + 180) % 360 - 180
    return np.asarray((grid[best] + np.clip(off, -_SIGMA_DEG, _SIGMA_DEG) / 2) % 360)


def facing_as(picture: NDArray[np.uint8], person: DetectedPerson, turn: float) -> DetectedPerson:
    """Return the person for a known turn, degrees: swaps left and right if they disagree, and finds the face again."""
    measured = _measured_turn(person)
    if degrees_between(measured, turn) <= degrees_between(180.0 - measured, turn) + _SIGMA_DEG:
        return person
    body = swap_sides(person.body)
    return DetectedPerson(
        body, find_face(picture, body), find_hand(picture, body, "left"), find_hand(picture, body, "right")
    )


def _measured_turn(person: DetectedPerson) -> float:
    """Return the mean turn of shoulders and hips, degrees."""
    world = person.body.world
    across = np.zeros(2)
    for name in ("shoulder", "hip"):
        pair = world[LANDMARKS.index(f"left_{name}")] - world[LANDMARKS.index(f"right_{name}")]
        across += pair[[0, 2]] / max(float(np.hypot(pair[0], pair[2])), 1e-9)
    return float(np.degrees(np.arctan2(across[1], across[0])))


def _costs(person: DetectedPerson, grid: F64) -> F64:
    """Return the cost [72] of each facing direction."""
    measured = _measured_turn(person)
    off = np.minimum((degrees_between(grid, measured) / _SIGMA_DEG) ** 2, _MAX_COST)
    other = np.minimum((degrees_between(grid, 180.0 - measured) / _SIGMA_DEG) ** 2, _MAX_COST) + _FLIP_COST
    cost = np.minimum(off, other)
    front = degrees_between(grid, 0.0)
    if person.face.presence > _MIN_FACE:
        cost = cost + _FACE_COST * (front > _FACE_UP_TO_DEG)
    elif person.face.presence < _MAX_FACELESS:
        cost = cost + _FACELESS_COST * (front < _FACELESS_FROM_DEG)
    return np.asarray(cost)


def _path(costs: F64, grid: F64, step: float) -> tuple[float, NDArray[np.intp]]:
    """Return the cost of the cheapest path through the directions, in steps of about ``step`` degrees, and the path."""
    change = (grid[None] - grid[:, None] - step + 180) % 360 - 180  # [from, to]
    price = (change / (_STEP_TOLERANCE[0] * abs(step) + _STEP_TOLERANCE[1])) ** 2
    total, back = costs[0], []
    for row in costs[1:]:
        sums = total[:, None] + price
        back.append(sums.argmin(axis=0))
        total = sums.min(axis=0) + row
    path = [int(total.argmin())]
    for row in reversed(back):
        path.append(int(row[path[-1]]))
    return float(total.min()), np.array(path[::-1], np.intp)


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a turning person."""

    name: str
    """For messages: the file, or "frame 7"."""
    picture: NDArray[np.uint8]
    """RGB uint8 [H, W, 3]."""
    focal: float | None
    """Pixels; None if unknown."""
    person: DetectedPerson
    mask: NDArray[np.bool_]
    """[H, W] true on the person."""
    blur: float
    """From 0, sharp, to 1, completely blurred."""
    turn: float = 0.0
    """Degrees that the person has turned to their own left from facing the camera."""


class FramePicture(NamedTuple):
    """A candidate frame."""

    name: str
    rgb: NDArray[np.uint8]  # [H, W, 3] sRGB
    focal: float | None  # pixels


def frames_of(sources: Sequence[FrameSource], count: int) -> tuple[list[FramePicture], bool]:
    """Return the pictures of one video, at most ``count``, or of all files, and whether they follow each other in time.

    Raises FormatError, one line that names the file.
    """
    if not sources:
        raise FormatError("no frames: give a video, or pictures of the person from all around")
    if len(sources) == 1 and is_video(sources[0]):
        film = enumerate(read_frames(sources[0], count), 1)
        return [FramePicture(f"frame {number}", rgb, None) for number, rgb in film], True
    if len(sources) < MIN_FRAMES:
        few = "neither a video nor several pictures" if len(sources) == 1 else f"only {len(sources)} pictures"
        raise FormatError(
            f"{sources[0]}: {few}; give a video (.mp4, .mov, .webm, .mkv, .avi), or at least {MIN_FRAMES} pictures "
            "from all around"
        )
    pictures: list[FramePicture] = []
    for source in sources:
        if is_video(source):
            raise FormatError(f"{source}: one video alone, or pictures alone, not both")
        photo = read_photo(source)
        pictures.append(FramePicture(str(source), photo.picture, photo.focal))
    return pictures, False


def check_frames(
    pictures: Sequence[FramePicture],
    *,
    in_order: bool,
    anyway: bool = False,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[list[Frame], list[str]]:
    """Return the usable frames, the most frontal first, and a line for each picture that is left out.

    Raises CaptureError for too few frames, or a turn with large gaps or without a front. ``anyway`` keeps frames in
    which the check found faults, and accepts part of a turn.
    """
    frames: list[Frame] = []
    left_out: list[str] = []
    for index, (name, picture, focal) in enumerate(pictures):
        progress(index / len(pictures))
        capture = check_capture(picture, None)
        found = [finding for finding in capture.findings if not anyway or finding.code == "nobody"]
        if capture.person is None or found:
            left_out.append(f"{name} is left out: {found[0].text if found else 'nobody is found'}")
            continue
        frames.append(Frame(name, picture, focal, capture.person, capture.mask, blur_of(picture, capture.mask)))
    if len(frames) < MIN_FRAMES:
        why = f"; {left_out[0]}" if left_out else ""
        raise CaptureError(f"{len(frames)} of {len(pictures)} frames will do, {MIN_FRAMES} are needed{why}")
    turns = facings([frame.person for frame in frames], in_order=in_order)
    frames = [
        replace(frame, turn=float(turn), person=facing_as(frame.picture, frame.person, float(turn)))
        for frame, turn in zip(frames, turns, strict=True)
    ]
    if not anyway:
        _check_turn(frames)
    best = min(range(len(frames)), key=lambda index: _frontal(frames[index]))
    return [frames[best], *frames[:best], *frames[best + 1 :]], left_out


def _check_turn(frames: Sequence[Frame]) -> None:
    """Raise CaptureError for a person who does not turn all around, or without a frame from the front."""
    turns = np.sort([frame.turn % 360 for frame in frames])
    gap = float(np.diff(turns, append=turns[0] + 360).max())
    if gap > 360 - 90:
        raise CaptureError(
            f"the person turns by {360 - gap:.0f} degrees only; let them turn on the spot once, all around"
        )
    if gap > _MAX_GAP_DEG:
        raise CaptureError(
            f"no frame shows {gap:.0f} degrees of the turn; let the person turn on the spot once, evenly"
        )
    nearest = min(degrees_between(frame.turn, 0.0) for frame in frames)
    if nearest > _MAX_FRONT_DEG:
        raise CaptureError(f"no frame shows the front: the nearest is turned by {nearest:.0f} degrees")


def _frontal(frame: Frame) -> float:
    """Return a cost, least for the best front: turn, a hidden face, blur."""
    return degrees_between(frame.turn, 0.0) / 10 + 3 * (1 - frame.person.face.presence) + 4 * frame.blur
