"""Draws docs/images/faces-*: the 52 shapes of an avatar on one sheet, close-ups of faces; light.jpg, people in lights.

python -m tools.docs.faces sheet AVATAR OUT.jpg
python -m tools.docs.faces close OUT.jpg AVATAR [AVATAR ...]
python -m tools.docs.faces light OUT.jpg AVATAR [AVATAR ...]

AVATAR is a file or the name of an embedded person. A close-up is drawn at 1024 x 1024 and put down at half of that.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat import Item, Renderer, Scene
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import embedded_file
from glsplat.extras.evaluate.avatar_poses import Rotations, pose_of
from glsplat.formats.registry import load_splats
from glsplat.light import Light
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose

U8 = NDArray[np.uint8]

_GREY = 145
_SIDES = ("Left", "Right")


def _both(**weights: float) -> dict[str, float]:
    return {name + side: weight for name, weight in weights.items() for side in _SIDES}


CLOSE: Sequence[tuple[str, float, Mapping[str, float], tuple[float, float]]] = (  # degrees around, expression, gaze
    ("front", 0, {}, (0, 0)),
    ("side", 70, {}, (0, 0)),
    ("smiling", 15, _both(mouthSmile=0.9, cheekSquint=0.5, mouthUpperUp=0.25), (0, 0)),
    ("speaking", 0, {"jawOpen": 0.35, "mouthFunnel": 0.3}, (0, 0)),
    ("blinking", 0, _both(eyeBlink=1.0), (0, 0)),
    ("looking aside", 0, {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0}, (0, 25)),
)


LIGHTS = (None, "studio", "left", "right", "evening")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("sheet", "close", "light"))
    parser.add_argument("names", nargs="+")
    options = parser.parse_args()
    if options.what == "sheet":
        avatar, out = _avatar(options.names[0]), options.names[1]
        jobs = [(" + ".join(some), 0.0, dict.fromkeys(some, 1.0), (0.0, 0.0)) for some in map(_shown, ARKIT)]
        picture = _grid(_drawn(avatar, jobs, 288), 9)
    elif options.what == "light":
        out = options.names[0]
        picture = _grid([one for name in options.names[1:] for one in _lit(_avatar(name))], len(LIGHTS))
    else:
        out = options.names[0]
        rows = [_drawn(_avatar(name), CLOSE, 1024, "") for name in options.names[1:]]
        half = [[cv2.resize(one, (512, 512), interpolation=cv2.INTER_AREA) for one in row] for row in rows]
        picture = _grid([one for row in half for one in row], len(CLOSE))
    cv2.imwrite(out, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 86])


def _shown(name: str) -> tuple[str, ...]:
    """The expression, and the one that it is meant with: alone they pull closed lips over each other, or go through."""
    return (name, "jawOpen") if name in ("mouthClose", "tongueOut") else (name,)


def _avatar(name: str) -> Avatar:
    found = load_splats(embedded_file(name))
    assert isinstance(found, Avatar)
    return found


def _drawn(
    avatar: Avatar,
    jobs: Sequence[tuple[str, float, Mapping[str, float], tuple[float, float]]],
    size: int,
    title: str | None = None,
) -> list[U8]:
    """One picture a job, with its name in a corner unless ``title`` says otherwise."""
    names, joints = avatar.skeleton.names, np.array(avatar.skeleton.joints, np.float64)
    eyes = [names.index(f"{side.lower()}_eye_smplhf") for side in _SIDES]
    middle = joints[eyes].mean(axis=0) + (0, -0.025, -0.03)
    out = []
    with Renderer(avatar, size=(size, size)) as renderer:
        for name, around, expression, gaze in jobs:
            turn = np.radians(around)
            eye = middle + 0.8 * np.array([np.sin(turn), 0, np.cos(turn)])
            camera = Camera(look_at(eye, middle), pinhole(size, size, 22.0), size, size)
            rotations = np.zeros((len(names), 3))
            rotations[eyes, :2] = np.radians(gaze)
            seen = renderer.render([camera], Pose(rotations, expression=expression))[0].astype(np.float64)
            picture = np.clip(seen[..., :3] + (255 - seen[..., 3:]) / 255 * _GREY, 0, 255).astype(np.uint8)
            label = name if title is None else title
            cv2.putText(picture, label, (6, size - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
            out.append(picture)
    return out


def _lit(avatar: Avatar) -> list[U8]:
    """Head and chest from a little aside, in each of LIGHTS."""
    head = np.array(avatar.skeleton.joints[avatar.skeleton.names.index("head")], np.float64)
    middle, (width, height) = head - (0, 0.09, 0), (600, 800)
    view = look_at(middle + 1.5 * np.array([np.sin(0.3), 0.05, np.cos(0.3)]), middle)
    camera = Camera(view, pinhole(width, height, 30.0), width, height, background=(0.18, 0.19, 0.2))
    arms: Rotations = {"left_shoulder": (0, 0, -1.1)}
    pose = pose_of(arms, avatar.skeleton)
    out = []
    for name in LIGHTS:
        light = Light.preset(name) if name else None
        with Renderer(Scene([Item(avatar, pose=pose)], light=light), size=(width, height)) as renderer:
            seen = renderer.render([camera])[0][..., :3]
        out.append(cv2.resize(seen, (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return out


def _grid(pictures: list[U8], columns: int) -> U8:
    rows = [pictures[i : i + columns] for i in range(0, len(pictures), columns)]
    blank = np.full_like(pictures[0], _GREY)
    return np.concatenate([np.concatenate(row + [blank] * (columns - len(row)), axis=1) for row in rows])


if __name__ == "__main__":
    main()
