"""Where an avatar is shown, by a headset of a PC and by the page (space/placing.js): the same for the same heads."""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.openxr.placing import VIEWS, matrix_of, placing, rigid_inverse, standing
from glsplat.rotations import FLIP_X
from tests.twins import Twin, both_sides


def matrix(columns: list[float]) -> Any:
    return np.array(columns).reshape(4, 4).T


def columns(found: Any) -> list[float]:
    return found.T.ravel().tolist()


def views(head: list[float], eye: list[float]) -> list[dict[str, Any]]:
    """Return where each view shows the avatar to a head, and what an eye there is for a server. Matrices by columns."""
    out = []
    for name in VIEWS:
        place = placing(name, matrix(head))
        glass = place.glass
        shown = place.shown @ FLIP_X if glass is not None else place.shown  # as FeedShow requests it
        out.append({
            "view": name,
            "shown": columns(place.shown),
            "mirror": glass is not None,
            "right": None if glass is None else glass.right.tolist(),
            "normal": None if glass is None else glass.normal.tolist(),
            "server": columns(rigid_inverse(rigid_inverse(matrix(eye)) @ shown)),
        })  # fmt: skip
    return out


def stands(head: list[float]) -> list[float]:
    """Return x and z, and sine and cosine of half the yaw, of a space that has a head over its origin."""
    return [float(v) for v in standing(matrix(head))]


def heads() -> list[list[float]]:
    rng = np.random.default_rng(4)
    poses = [(*rng.normal(size=3).tolist(), *rng.normal(size=4).tolist()) for _ in range(8)]
    poses += [(0.1, 1.6, 0, sign * sin(pi / 4), 0, 0, cos(pi / 4)) for sign in (1, -1)]  # straight up, straight down
    return [columns(matrix_of(pose)) for pose in poses]


TWINS = {
    "views": Twin(views, lambda: [{"head": head, "eye": heads()[0]} for head in heads()]),
    "stands": Twin(stands, lambda: [{"head": head} for head in heads()]),
}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS)
