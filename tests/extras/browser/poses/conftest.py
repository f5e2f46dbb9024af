"""A server that hands out a small avatar and one that it does not."""

from __future__ import annotations

from typing import Any

import numpy as np

import glsplat
from glsplat.extras.browser.web_format.write import web_file
from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.messages import Request
from glsplat.net.server import ServerConfig
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

RIG = glsplat.Skeleton.from_joints(JOINT_NAMES, PARENTS, np.random.default_rng(4).normal(0, 0.5, (55, 3)))


class Solver:
    """Puts the head's place into the root and turns the neck."""

    def solve(self, request: Request, now: float) -> Solved:
        assert request.tracking is not None and request.tracking.head is not None
        rotations = np.zeros((55, 3))
        rotations[12] = (0.1, 0.2, -0.3)
        pose = glsplat.Pose(rotations, request.tracking.head[:3], expression=request.tracking.expression)
        return Solved(pose, ("left_lost",), scale=1.25, floor=0.5)


def avatar(count: int = 40, seed: int = 1) -> glsplat.Avatar:
    rng = np.random.default_rng(seed)
    splats = glsplat.Splats.create(
        rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.uniform(0.01, 0.1, (count, 3)),
        rng.uniform(0.1, 0.9, count), rgb=rng.uniform(size=(count, 3)),
    )  # fmt: skip
    return glsplat.Avatar(splats, RIG, glsplat.Skin(rng.integers(0, 55, (count, 4)), rng.dirichlet([1] * 4, count)))


def offer(name: str, **more: Any) -> AvatarInfo:
    made = avatar()
    return AvatarInfo(
        name=name, skeleton=RIG, solver=lambda height, span: Solver(), file=lambda: web_file(made), **more
    )


OFFERS = (offer("ann"), offer("bob"), AvatarInfo(name="scenery"))


def policy(*handed: str) -> ConsentPolicy:
    """Shows all, hands out these."""
    found = ConsentPolicy(without=True)
    for name in ("ann", "bob", "scenery"):
        found.add(name, [OnFile(nobody=True)] if name in handed else [OnFile(fault="no consent on file")])
    return found


def config(*handed: str, **changes: Any) -> ServerConfig:
    return ServerConfig(port=0, rooms={"lab": 8}, consent=policy(*handed), **changes)


def head(x: float = 0.0, **more: Any) -> dict[str, Any]:
    return {"head": [x, 1.6, 0, 0, 0, 0, 1], **more}
