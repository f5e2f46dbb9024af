"""What the page's own modules compute (net/web), and their twins in Python."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.data import default_avatar
from glsplat.light import Light
from glsplat.motion.motion import Motion
from glsplat.net.options import NAME
from glsplat.rotations import FLIP_X, rotation_matrices
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import EYES_OF_STATURE, calibrate
from glsplat.tracking.sample import Sample
from tests.light.lit import random_light
from tests.twins import Twin, both_sides


def turned(light: dict[str, Any], matrix: list[float]) -> dict[str, Any]:
    """Return a light that is moved by a matrix (by columns) whose axes are orthonormal, a mirror's too."""
    found = Light.from_json(light).turned(np.reshape(matrix, (4, 4)).T[:3, :3])
    sun = None if found.sun_direction is None else {"direction": found.sun_direction, "color": found.sun_colour}
    return {"ambient": found.ambient, "sun": sun}


def turns() -> list[dict[str, Any]]:
    rotation = similarity((0, 0, 0), (0.3, -0.5, 0.7, 1.1))
    lights = [random_light(3), random_light(4, sun=False), Light.preset("evening")]
    return [
        {"light": {"sun": None, **light.to_json()}, "matrix": matrix.T.ravel()}
        for light in lights
        for matrix in (rotation, rotation @ FLIP_X)
    ]


def motion(fps: float, frames: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
    """Return a motion's pose at a time: rotations as matrices, and the translation."""
    poses = [Pose.from_smplx(frame) for frame in frames]
    rotations, trans = np.stack([pose.rotations for pose in poses]), np.stack([pose.trans for pose in poses])
    found = Motion(fps, rotations, trans).at(seconds)
    return {"body": rotation_matrices(found.rotations[:22]).ravel(), "trans": found.trans}


def moments() -> list[dict[str, Any]]:
    text = resources.files("glsplat.data").joinpath("walk.json").read_text(encoding="utf-8")
    frames = [{key: frame[key] for key in ("trans", "root_pose", "body_pose")} for frame in json.loads(text)["frames"]]
    out = [{"fps": 30.0, "frames": frames[:3], "seconds": t} for t in (0.0, 0.011, 1 / 12, 0.099, 1234.567, -0.02)]
    half_turn = [
        {"root_pose": [0, angle, 0], "body_pose": [[0, 0, 0]] * 21, "trans": [0, 0, 0]} for angle in (3.0, -3.0)
    ]
    return [*out, {"fps": 1.0, "frames": half_turn, "seconds": 0.5}]  # the short way, over pi


def calibrated(samples: list[dict[str, Any]], height: float | None) -> dict[str, Any]:
    """Return a user's measures, metres."""
    found = calibrate([Sample.from_json(one, t=0) for one in samples], default_avatar().skeleton, height=height)
    stature = found.eye_height / EYES_OF_STATURE if height is None else height
    return {"eyes": found.eye_height, "floor": found.floor, "span": found.arm_span, "height": stature}


def standing() -> list[dict[str, Any]]:
    rng, out = np.random.default_rng(2), []
    for span, height in ((None, None), (1.39, None), (0.7, None), (1.39, 1.8)):
        samples = []
        for _ in range(30):
            head = np.round(np.array([0.3, 1.6, -0.2]) + rng.normal(0, 0.004, 3), 5).tolist()
            sample = {"head": [*head, 0.0, 0.0, 0.0, 1.0]}
            if span is not None:
                width = round(span * rng.uniform(0.97, 1), 5)
                for side, x in (("left", -width / 2), ("right", width / 2)):
                    sample[side] = [0.3 + x, 1.3, -0.2, 0.0, 0.0, 0.0, 1.0]
            samples.append(sample)
        out.append({"samples": samples, "height": height})
    return out


def named(name: str) -> bool:
    """Return whether people and avatars may be called so."""
    return NAME.fullmatch(name) is not None


def names() -> list[dict[str, str]]:
    texts = [
        "Ann",
        "Jürgen B.",
        "-x",
        "x-",
        "a" * 32,
        "a" * 33,
        "日本",
        "a_b",
        "_a",
        "a_",
        "O'Neil",
        "a\nb",
        "<b>",
        "1",
    ]
    return [{"name": name} for name in texts]


TWINS = {
    "turned": Twin(turned, turns),
    "motion": Twin(motion, moments, 1e-6),
    "calibrated": Twin(calibrated, standing, 2e-3),
    "named": Twin(named, names, 0),
}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS)
