"""Read video files: all frames, or evenly spread sharp ones, upright; the header is not trusted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.photo.photo_file import MAX_PIXELS, MAX_SIDE_PX, reduced
from glsplat.io.files import open_regular

MIN_FRAMES = 8
"""Frames that a turn needs."""
_MAX_BYTES = 4_000_000_000
_MAX_FRAMES = 20_000  # five minutes at 60 Hz
_CANDIDATES = 5  # frames for each chosen one, the sharpest
_CANDIDATE_SPAN = 0.6  # fraction of the interval that these cover
_SHARPNESS_PX = 360  # shorter side at which sharpness is measured
_HINT = "give an .mp4, .mov, .webm, .mkv or .avi, or picture files"


def is_video(path: str | os.PathLike[str]) -> bool:
    """Return True for a file with the signature of a video. Raises FormatError if it cannot be read."""
    with open_regular(Path(path)) as (file, _):
        head = file.read(64)
    # playlists and other text that name further files or addresses are not accepted
    movie = head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
    return movie or head[:4] == b"\x1aE\xdf\xa3" or (head[:4] == b"RIFF" and head[8:12] == b"AVI ")


def read_frames(path: str | os.PathLike[str], count: int) -> list[NDArray[np.uint8]]:
    """Return at most ``count`` frames, RGB uint8 [H, W, 3], in order: the sharpest of a few in each interval.

    Frames are upright and at most MAX_SIDE_PX pixels a side. Raises FormatError, one line that names the file.
    """
    if not is_video(path):
        raise FormatError(f"{path}: not a video; {_HINT}")
    if os.path.getsize(path) > _MAX_BYTES:
        raise FormatError(f"{path}: a video has at most {_MAX_BYTES // 10**9} GB here; cut out the turn")
    with _opened(path) as film:
        reported = film.get(cv2.CAP_PROP_FRAME_COUNT)
        if not (np.isfinite(reported) and MIN_FRAMES <= reported <= _MAX_FRAMES):
            reported = _counted(film, path)
    with _opened(path) as film:
        frames, counted = _chosen(film, path, int(reported), count)
    if counted < reported - max(2, 0.02 * reported):  # the header reports more than there is
        with _opened(path) as film:
            frames, counted = _chosen(film, path, counted, count)
    if counted < MIN_FRAMES:
        raise FormatError(f"{path}: a video needs at least {MIN_FRAMES} frames, this has {counted}; film a whole turn")
    return frames


def each_frame(path: str | os.PathLike[str]) -> Iterator[NDArray[np.uint8]]:
    """Yield all frames, RGB uint8 [H, W, 3], at full size. Raises FormatError if the first cannot be read."""
    with _opened(path) as film:
        read, picture = film.read()
        if not read or picture is None:
            raise FormatError(f"{path}: the video is damaged; its first frame cannot be read")
        while read and picture is not None:
            _check_shape(picture, path)
            yield np.ascontiguousarray(picture[..., ::-1])
            read, picture = film.read()


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[cv2.VideoCapture]:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read once; errors are reported here, in one line
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        film = cv2.VideoCapture(str(Path(path).absolute()), cv2.CAP_FFMPEG)
    finally:
        cv2.utils.logging.setLogLevel(level)
    try:
        if not film.isOpened():
            raise FormatError(f"{path}: the video is damaged or of an unknown kind; {_HINT}")
        yield film
    finally:
        film.release()


def _counted(film: cv2.VideoCapture, path: str | os.PathLike[str]) -> int:
    count = 0
    while film.grab():
        count += 1
        if count > _MAX_FRAMES:
            raise FormatError(f"{path}: a video has at most {_MAX_FRAMES} frames here; cut out the turn")
    return count


def _chosen(
    film: cv2.VideoCapture, path: str | os.PathLike[str], total: int, count: int
) -> tuple[list[NDArray[np.uint8]], int]:
    """Return the chosen frames and the number of frames in the file, at most ``total``."""
    spacing = max(total / count, 1.0)
    candidates: dict[int, int] = {}  # number of a frame -> its interval
    for interval in range(min(count, total)):
        middle, half = (interval + 0.5) * spacing - 0.5, _CANDIDATE_SPAN * spacing / 2
        for at in np.linspace(middle - half, middle + half, _CANDIDATES):
            candidates[min(max(round(float(at)), 0), total - 1)] = interval
    best: dict[int, tuple[float, NDArray[np.uint8]]] = {}
    for number in range(total):
        if not film.grab():
            return [best[key][1] for key in sorted(best)], number
        if number in candidates:
            read, picture = film.retrieve()
            if not read or picture is None:
                raise FormatError(f"{path}: frame {number} of the video is damaged; convert it to .mp4 again")
            _check_shape(picture, path)
            sharp, interval = _sharpness(picture), candidates[number]
            if interval not in best or sharp > best[interval][0]:
                best[interval] = sharp, np.ascontiguousarray(reduced(picture, MAX_SIDE_PX)[..., ::-1])
    return [best[key][1] for key in sorted(best)], total


def _check_shape(picture: NDArray[np.uint8], path: str | os.PathLike[str]) -> None:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.shape[0] * picture.shape[1] > MAX_PIXELS:
        raise FormatError(f"{path}: frames of {picture.shape} are not pictures in colour of a usable size")


def _sharpness(picture: NDArray[np.uint8]) -> float:
    """Return the variance of the Laplacian: larger for sharper frames of one scene."""
    scale = min(1.0, _SHARPNESS_PX / min(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())
