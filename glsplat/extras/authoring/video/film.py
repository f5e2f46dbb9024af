"""Video files: all frames, or evenly spread sharp ones, upright, without trust in what its header says."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.photo.photo_file import MAX_PIXELS, MAX_SIDE_PX
from glsplat.io.files import open_regular

__all__ = ["FEWEST", "each_frame", "is_video", "read_frames"]

FEWEST = 8
"""Frames that a turn needs."""
_MOST_BYTES = 4_000_000_000
_MOST_FRAMES = 20_000  # five minutes at sixty a second
_LOOKED_AT = 5  # frames of which the sharpest is taken
_MIDDLE = 0.6  # share of the time from one frame to the next in which those lie
_GREY = 360  # pixels of the shorter side that sharpness is judged by
_SEE = "give an .mp4, .mov, .webm, .mkv or .avi, or picture files"


def is_video(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as a video does. Raises FormatError for what cannot be read."""
    with open_regular(Path(path)) as (file, _):
        head = file.read(64)
    # playlists and other text that name further files or addresses are none
    movie = head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
    return movie or head[:4] == b"\x1aE\xdf\xa3" or (head[:4] == b"RIFF" and head[8:12] == b"AVI ")


def read_frames(path: str | os.PathLike[str], count: int) -> list[NDArray[np.uint8]]:
    """At most ``count`` frames, RGB uint8 [H, W, 3], in order: of each stretch of the video the sharpest of a few.

    Upright, reduced to MAX_SIDE_PX. Raises FormatError, one line that names the file.
    """
    if not is_video(path):
        raise FormatError(f"{path}: not a video; {_SEE}")
    if os.path.getsize(path) > _MOST_BYTES:
        raise FormatError(f"{path}: a video has at most {_MOST_BYTES // 10**9} GB here; cut out the turn")
    with _opened(path) as film:
        told = film.get(cv2.CAP_PROP_FRAME_COUNT)
        if not (np.isfinite(told) and FEWEST <= told <= _MOST_FRAMES):
            told = _counted(film, path)
    with _opened(path) as film:
        frames, seen = _chosen(film, path, int(told), count)
    if seen < told - max(2, 0.02 * told):  # the header promised more
        with _opened(path) as film:
            frames, seen = _chosen(film, path, seen, count)
    if seen < FEWEST:
        raise FormatError(f"{path}: a video needs at least {FEWEST} frames, this has {seen}; film a whole turn")
    return frames


def each_frame(path: str | os.PathLike[str]) -> Iterator[NDArray[np.uint8]]:
    """All frames, RGB uint8 [H, W, 3], as they are. Raises FormatError for what is no video, or is cut off at once."""
    with _opened(path) as film:
        read, picture = film.read()
        if not read or picture is None:
            raise FormatError(f"{path}: the video is damaged; its first frame cannot be read")
        while read and picture is not None:
            if picture.ndim != 3 or picture.shape[2] != 3 or picture.shape[0] * picture.shape[1] > MAX_PIXELS:
                raise FormatError(f"{path}: frames of {picture.shape} are not pictures in colour of a usable size")
            yield np.ascontiguousarray(picture[..., ::-1])
            read, picture = film.read()


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[cv2.VideoCapture]:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read once: what is wrong is said by us, in one line
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        film = cv2.VideoCapture(str(Path(path).absolute()), cv2.CAP_FFMPEG)
    finally:
        cv2.utils.logging.setLogLevel(level)
    try:
        if not film.isOpened():
            raise FormatError(f"{path}: the video is damaged or of an unknown kind; {_SEE}")
        yield film
    finally:
        film.release()


def _counted(film: cv2.VideoCapture, path: str | os.PathLike[str]) -> int:
    count = 0
    while film.grab():
        count += 1
        if count > _MOST_FRAMES:
            raise FormatError(f"{path}: a video has at most {_MOST_FRAMES} frames here; cut out the turn")
    return count


def _chosen(
    film: cv2.VideoCapture, path: str | os.PathLike[str], total: int, count: int
) -> tuple[list[NDArray[np.uint8]], int]:
    """The frames, and how many there are in the file (at most ``total``)."""
    pace = max(total / count, 1.0)
    wanted: dict[int, int] = {}  # number of a frame -> the stretch that it is looked at for
    for stretch in range(min(count, total)):
        middle, half = (stretch + 0.5) * pace - 0.5, _MIDDLE * pace / 2
        for at in np.linspace(middle - half, middle + half, _LOOKED_AT):
            wanted[min(max(round(float(at)), 0), total - 1)] = stretch
    best: dict[int, tuple[float, NDArray[np.uint8]]] = {}
    for number in range(total):
        if not film.grab():
            return [best[key][1] for key in sorted(best)], number
        if number in wanted:
            read, picture = film.retrieve()
            if not read or picture is None:
                raise FormatError(f"{path}: frame {number} of the video is damaged; convert it to .mp4 anew")
            if picture.ndim != 3 or picture.shape[2] != 3 or picture.shape[0] * picture.shape[1] > MAX_PIXELS:
                raise FormatError(f"{path}: frames of {picture.shape} are not pictures in colour of a usable size")
            sharp, stretch = _sharpness(picture), wanted[number]
            if stretch not in best or sharp > best[stretch][0]:
                best[stretch] = sharp, _usable(picture)
    return [best[key][1] for key in sorted(best)], total


def _sharpness(picture: NDArray[np.uint8]) -> float:
    """Of frames of one scene the sharper has the larger number."""
    scale = min(1.0, _GREY / min(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())


def _usable(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    if max(height, width) > MAX_SIDE_PX:
        scale = MAX_SIDE_PX / max(height, width)
        size = max(round(width * scale), 1), max(round(height * scale), 1)
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    return np.ascontiguousarray(picture[..., ::-1])
