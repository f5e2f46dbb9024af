"""Check frames of a turn: one whole person in each, seen from all around."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.check.capture import blur_of, check_capture
from glsplat.extras.authoring.networks.people import DetectedPerson, degrees_between
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.extras.authoring.video.film import MIN_FRAMES, is_video, read_frames
from glsplat.extras.authoring.video.turns import facing_as, facings

FrameSource = str | os.PathLike[str]
"""A video, or one of several picture files."""

_MAX_GAP_DEG = 110.0  # of the turn without a frame; a larger part of the person would be a guess
_MAX_FRONT_DEG = 35.0  # of the most frontal frame from the front


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


class FramePictures(NamedTuple):
    """Pictures from all around a person."""

    pictures: Sequence[FramePicture]
    in_order: bool  # whether they follow each other in time


class CheckedFrames(NamedTuple):
    """The usable frames of a turn."""

    frames: Sequence[Frame]  # the most frontal first
    left_out: Sequence[str]  # a line for each that was left out


def frames_of(sources: Sequence[FrameSource], count: int) -> FramePictures:
    """Return the pictures of one video, at most ``count``, or of all the picture files.

    Raises FormatError, one line that names the file.
    """
    if not sources:
        raise FormatError("no frames: give a video, or pictures of the person from all around")
    if len(sources) == 1 and is_video(sources[0]):
        film = enumerate(read_frames(sources[0], count), 1)
        return FramePictures([FramePicture(f"frame {number}", rgb, None) for number, rgb in film], True)
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
    return FramePictures(pictures, False)


def check_frames(
    pictures: Sequence[FramePicture],
    *,
    in_order: bool,
    anyway: bool = False,
    progress: Callable[[float], None] = lambda done: None,
) -> CheckedFrames:
    """Return the usable frames.

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
    _check_count(frames, left_out, len(pictures))
    turns = facings([frame.person for frame in frames], in_order=in_order)
    frames = [
        replace(frame, turn=float(turn), person=facing_as(frame.picture, frame.person, float(turn)))
        for frame, turn in zip(frames, turns, strict=True)
    ]
    if not anyway:
        _check_turn(frames)
    best = min(range(len(frames)), key=lambda index: _frontal(frames[index]))
    return CheckedFrames([frames[best], *frames[:best], *frames[best + 1 :]], left_out)


def _check_count(frames: Sequence[Frame], left_out: Sequence[str], total: int) -> None:
    if len(frames) >= MIN_FRAMES:
        return
    why = f"; {left_out[0]}" if left_out else ""
    raise CaptureError(f"{len(frames)} of {total} frames will do, {MIN_FRAMES} are needed{why}")


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
