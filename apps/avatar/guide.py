"""``glsplat avatar guide``: draw a picture that explains how to take the photograph for an avatar."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import default_avatar
from glsplat.io.files import replace_file
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose

from ..usage import output_kind

Picture = NDArray[np.uint8]

A_POSE: Mapping[str, tuple[float, float, float]] = {
    "left_shoulder": (0, 0, -0.7),
    "right_shoulder": (0, 0, 0.7),
    "left_elbow": (0, -0.12, 0),
    "right_elbow": (0, 0.12, 0),
    "left_hip": (0, 0, 0.09),
    "right_hip": (0, 0, -0.09),
}
"""Axis-angle in radians: arms about 40 degrees below the horizontal, feet a little apart."""

_ARMS_DOWN = {**A_POSE, "left_shoulder": (0, 0, -1.42), "right_shoulder": (0, 0, 1.42)}
_TURNED = {**A_POSE, "pelvis": (0, 0.9, 0)}
_INK, _GOOD, _BAD = (40, 40, 40), (30, 130, 60), (190, 40, 40)  # RGB
_WALL, _FLOOR, _PAPER = (214, 211, 205), (164, 150, 134), (255, 255, 255)
_SIZE_PX = 1600, 1180
FOV_DEG = 32.0
"""Vertical field of view of a phone."""
_SUPERSAMPLE = 2  # a side


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("-o", "--out", default="guide.png", help="picture to write (.png; default %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Draw and write the picture."""
    output_kind("--out", args.out, (".png",), "a picture (.png)")
    drawn = cv2.cvtColor(draw_guide(), cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".png", drawn)
    replace_file(Path(args.out), [data.tobytes()])
    print(f"{args.out}: how to take the photograph, {_SIZE_PX[0]} x {_SIZE_PX[1]} pixels")
    return 0


def draw_guide() -> Picture:
    """Return the picture, RGB uint8 [H, W, 3]."""
    sheet = np.full((_SIZE_PX[1], _SIZE_PX[0], 3), _PAPER, np.uint8)
    avatar = default_avatar()
    with Renderer(avatar, size=(600 * _SUPERSAMPLE, 860 * _SUPERSAMPLE)) as renderer:

        def figure(pose: Mapping[str, tuple[float, float, float]], size: tuple[int, int], **view: float) -> Picture:
            rotations = np.zeros((len(avatar.skeleton), 3))
            for name, turn in pose.items():
                rotations[avatar.skeleton.names.index(name)] = turn
            return _figure(renderer, Pose(rotations), size, **view)

        _text(sheet, "The photograph for your avatar", (40, 62), 1.3, _INK, 2)
        _put(sheet, figure(A_POSE, (600, 860)), (40, 100))
        _large(sheet)
        _setting(sheet, figure({**A_POSE, "pelvis": (0, -np.pi / 2, 0)}, (250, 430), height=2.06, wall=0.0916))
        small = (176, 262)
        rows = (
            ("arms down", figure(_ARMS_DOWN, small)),
            ("turned away", figure(_TURNED, small)),
            ("cut off", figure(A_POSE, small, height=1.4, centre=0.95)),
            ("too small", figure(A_POSE, small, height=6.0, centre=1.6)),
            ("blurred", np.asarray(cv2.GaussianBlur(figure(A_POSE, small), (0, 0), 4))),
        )
        for index, (words, picture) in enumerate(rows):
            place = 680 + 178 * index, 744
            picture = picture[:, 3:-3]
            _put(sheet, picture, place)
            _cross(sheet, (place[0] + 22, place[1] + 24))
            _text(sheet, words, (place[0] + 4, place[1] + 292), 0.62, _BAD, 1)
    return sheet


def _large(sheet: Picture) -> None:
    """Draw the marks over the good figure, and the text below it."""
    cv2.rectangle(sheet, (40, 100), (640, 960), _GOOD, 4)
    _arrow(sheet, (54, 202), (54, 861), _INK)
    _text(sheet, "75 to 90 %", (68, 640), 0.62, _INK, 1)
    _text(sheet, "of the height", (68, 666), 0.62, _INK, 1)
    _text(sheet, "room above", (285, 130), 0.62, _INK, 1)
    _text(sheet, "and below", (293, 944), 0.62, _INK, 1)
    lines = (
        "Stand straight, face to the camera, mouth closed, eyes open.",
        "Arms 40 degrees below the horizontal, fingers a little apart.",
        "Feet as wide as the hips. Hair out of the face, tight clothes.",
        "For the back: turn around, same pose, same camera.",
    )
    for row, line in enumerate(lines):
        _text(sheet, line, (40, 1002 + 44 * row), 0.68, _INK, 1)


def _setting(sheet: Picture, side: Picture) -> None:
    """Draw camera, person and distances, seen from the side."""
    left, top, right, floor = 680, 100, 1564, 640
    sheet[top:floor, left:right] = _WALL
    sheet[floor - 40 : floor, left:right] = _FLOOR
    place = right - 320, floor - side.shape[0]  # its floor ends where the room's does
    _put(sheet, side, place)
    feet, ground = place[0] + 125, floor - 20
    camera = left + 120, floor - 250
    cv2.rectangle(sheet, (camera[0] - 12, camera[1] - 28), (camera[0] + 12, camera[1] + 28), _INK, -1)
    cv2.line(sheet, (camera[0], camera[1] + 28), (camera[0], ground), _INK, 3, cv2.LINE_AA)
    for height in (-182, 220):
        cv2.line(sheet, (camera[0] + 12, camera[1]), (feet - 52, camera[1] + height), (120, 120, 120), 1, cv2.LINE_AA)
    _arrow(sheet, (camera[0], ground), (feet, ground), _INK)
    _text(sheet, "2.5 to 4 m", (camera[0] + 190, ground - 8), 0.72, _INK, 2)
    _arrow(sheet, (camera[0] - 44, camera[1]), (camera[0] - 44, ground), _INK)
    _text(sheet, "chest height, upright", (left + 14, top + 36), 0.66, _INK, 1)
    _text(sheet, "plain wall, 1 m behind", (right - 290, top + 36), 0.66, _INK, 1)
    _text(sheet, "soft light from the front, no flash", (left + 250, top + 78), 0.66, _INK, 1)
    _text(sheet, "One person, nobody else. Rear camera, no zoom, no filter.", (left, floor + 42), 0.68, _INK, 1)
    _text(sheet, "Not like this:", (left, floor + 86), 0.8, _BAD, 2)


def _figure(
    renderer: Renderer,
    pose: Pose,
    size: tuple[int, int],
    height: float = 2.5,
    centre: float = 0.93,
    wall: float = 0.2,
) -> Picture:
    """Return a person before a wall; the picture is ``height`` m high about ``centre``, the floor ends at ``wall``."""
    width, rows = size[0] * _SUPERSAMPLE, size[1] * _SUPERSAMPLE
    distance = height / 2 / np.tan(np.radians(FOV_DEG) / 2)
    view = look_at(eye=(0, centre, distance), target=(0, centre, 0))
    camera = Camera(view, pinhole(width, rows, fov=FOV_DEG), width, rows)
    renderer.resize(width, rows)
    image = renderer.render([camera], pose)[0].astype(np.float32)
    room = np.empty((rows, width, 3), np.float32)
    room[:] = _WALL
    room[int(np.clip(rows * (0.5 + (centre - wall) / height), 0, rows)) :] = _FLOOR
    drawn = image[..., :3] + room * (1 - image[..., 3:] / 255)
    return np.clip(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA) + 0.5, 0, 255).astype(np.uint8)


def _put(sheet: Picture, picture: Picture, place: tuple[int, int]) -> None:
    sheet[place[1] : place[1] + picture.shape[0], place[0] : place[0] + picture.shape[1]] = picture


def _text(
    sheet: Picture, words: str, place: tuple[int, int], size: float, ink: tuple[int, int, int], bold: int
) -> None:
    cv2.putText(sheet, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, ink, bold, cv2.LINE_AA)


def _arrow(sheet: Picture, start: tuple[int, int], end: tuple[int, int], ink: tuple[int, int, int]) -> None:
    """Draw a dimension line with two heads."""
    tip = 14 / max(np.hypot(end[0] - start[0], end[1] - start[1]), 1)
    for a, b in ((start, end), (end, start)):
        cv2.arrowedLine(sheet, a, b, ink, 2, cv2.LINE_AA, tipLength=float(tip))


def _cross(sheet: Picture, middle: tuple[int, int]) -> None:
    x, y = middle
    for sign in (-1, 1):
        cv2.line(sheet, (x - 12, y - 12 * sign), (x + 12, y + 12 * sign), _BAD, 5, cv2.LINE_AA)
