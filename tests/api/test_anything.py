"""Anything at all as each argument of the public API: taken, or refused in one line; nothing hangs, nothing leaks."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import (
    Avatar,
    Camera,
    GlsplatError,
    Item,
    Pose,
    RenderConfig,
    Renderer,
    RiggedMesh,
    Scene,
    Skeleton,
    Skin,
    Splats,
)
from glsplat.config import DebugConfig
from glsplat.renderer.probe import Probe

pytestmark = [pytest.mark.gl, pytest.mark.timeout(60)]

cam = Camera(glsplat.look_at((0, 1, 3), (0, 1, 0)), glsplat.pinhole(32, 32), 32, 32)
sp = glsplat.default_avatar().splats.take(np.arange(500))
sk = glsplat.default_avatar().skeleton
small = Avatar(sp, sk, glsplat.default_avatar().skin.take(np.arange(500)))
_held: list[Probe] = []


def held() -> Probe:
    return _held[0]


def drawn_with(name: str, value: Any) -> None:
    former = getattr(held(), name)
    setattr(held(), name, value)
    try:
        held().render([cam])
    finally:
        setattr(held(), name, former)


@pytest.fixture(scope="module", autouse=True)
def _renderer() -> Iterator[None]:
    with Probe(Scene([Item(small), Item(sp)]), size=(32, 32)) as renderer:
        _held.append(renderer)
        yield
    _held.clear()


THINGS: dict[str, Any] = {
    repr(thing)[:24] + f" {number}": thing
    for number, thing in enumerate(
        [None, True, 1.5, -1, "x", b"x", [], {}, (1, 2), object(), np.nan, np.inf, 1j, np.array([1, 2])]
        + [np.array("x")]
        + [lambda: 0, 10**400, np.float64(2), Splats, range(3), np.ma.masked, np.datetime64("2020"), np.array([None])]
        + [
            memoryview(b"ab"),
            np.array(3),
            np.zeros((2, 0)),
            [[1, 2], 3],
            {1: 2},
            "1",
            float("-inf"),
            2**70,
            np.uint8(3),
        ]
    )
}

CALLS: dict[str, Any] = {
    "Camera.far": lambda v: replace(cam, far=v),
    "Camera.name": lambda v: replace(cam, name=v),
    "resized": lambda v: cam.resized(v, 3),
    "resized2": lambda v: cam.resized(3, v),
    "look.target": lambda v: glsplat.look_at((0, 0, 9), v),
    "look.up": lambda v: glsplat.look_at((0, 0, 9), (0, 0, 0), v),
    "stereo.fov": lambda v: glsplat.stereo_cameras(np.eye(4), fov=v),
    "stereo.K": lambda v: glsplat.stereo_cameras(np.eye(4), K=v),
    "Item": Item,
    "Item.pose": lambda v: Item(small, pose=v),
    "Item.op": lambda v: Item(sp, opacity=v),
    "Item.name": lambda v: Item(sp, name=v),
    "Scene": Scene,
    "Scene.add": lambda v: Scene().add(v),
    "Scene.remove": lambda v: Scene().remove(v),
    "Scene.of": Scene.of,
    "Pose.tl": lambda v: Pose(np.zeros((2, 3)), translations=v),
    "Pose.smplx": Pose.from_smplx,
    "Pose.smplx3": lambda v: Pose.from_smplx({"trans": v}),
    "Pose.json": lambda v: Pose.from_json(v, sk),
    "Pose.json2": lambda v: Pose.from_json({"joints": {"head": v}}, sk),
    "Pose.json3": lambda v: Pose.from_json({"joints": v}, sk),
    "Pose.json4": lambda v: Pose.from_json({"joints": {}}, v),
    "Pose.bones": lambda v: Pose.zero().bones(v),
    "Skeleton.names": lambda v: Skeleton(v, [-1], np.eye(4)[None]),
    "Skeleton.rest": lambda v: Skeleton(["a"], [-1], v),
    "Skeleton.ib": lambda v: Skeleton(["a"], [-1], np.eye(4)[None], v),
    "from_joints.names": lambda v: Skeleton.from_joints(v, [-1], [[0, 0, 0]]),
    "under": lambda v: sk.under(v),
    "same": lambda v: sk.same(v),
    "forward": lambda v: sk.forward(v),
    "forward.t": lambda v: sk.forward(np.zeros((55, 3)), v),
    "forward.tl": lambda v: sk.forward(np.zeros((55, 3)), translations=v),
    "Skin.lost": lambda v: Skin([[0]], [[1]], v),
    "Skin.rep": lambda v: Skin([[0]], [[1]], 0, v),
    "Skin.create.j": lambda v: Skin.create(v, [[1.0]], 2),
    "Skin.create.w": lambda v: Skin.create([[0]], v, 2),
    "Skin.create.i": lambda v: Skin.create([[0]], [[1]], 2, v),
    "Skin.take": lambda v: small.skin.take(v),
    "Skin.reduced": lambda v: small.skin.reduced(v),
    "Skin.dense": lambda v: Skin([[0]], [[1]]).dense(v),
    "Skin.anchored": lambda v: small.skin.anchored(v),
    **{
        f"Splats.{n}": (
            lambda v, n=n: Splats.create(
                **{
                    **dict(
                        means=[[0, 0, 0]], quats=[[1, 0, 0, 0]], scales=[[1, 1, 1]], opacities=[1.0], rgb=[[1, 0, 0]]
                    ),
                    n: v,
                }
            )
        )
        for n in ("antialias", "cones", "cones_psnr")
    },
    "Splats.levels": lambda v: replace(sp, levels=v),
    "Splats.sh": lambda v: replace(sp, sh=v),
    "take": lambda v: sp.take(v),
    "Avatar.splats": lambda v: Avatar(v, sk, small.skin),
    "Avatar.sk": lambda v: Avatar(sp, v, small.skin),
    "Avatar.skin": lambda v: Avatar(sp, sk, v),
    "Avatar.meta": lambda v: Avatar(sp, sk, small.skin, v),
    "Avatar.levels": lambda v: replace(small, levels=v),
    "Avatar.without": lambda v: small.without(v),
    "Avatar.only": lambda v: small.only(v),
    "RiggedMesh.v": lambda v: RiggedMesh(v, sk, np.zeros((3, 1), int), np.ones((3, 1)), ()),
    "RiggedMesh.sk": lambda v: RiggedMesh(np.eye(3), v, np.zeros((3, 1), int), np.ones((3, 1)), ()),
    "RiggedMesh.j": lambda v: RiggedMesh(np.eye(3), sk, v, np.ones((3, 1)), ()),
    "RiggedMesh.w": lambda v: RiggedMesh(np.eye(3), sk, np.zeros((3, 1), int), v, ()),
    "RiggedMesh.p": lambda v: RiggedMesh(np.eye(3), sk, np.zeros((3, 1), int), np.ones((3, 1)), v),
    "RiggedMesh.m": lambda v: RiggedMesh(np.eye(3), sk, np.zeros((3, 1), int), np.ones((3, 1)), (), v),
    **{f"Config.{n}": (lambda v, n=n: RenderConfig(**{n: v})) for n in RenderConfig.__dataclass_fields__},
    **{f"Debug.{n}": (lambda v, n=n: DebugConfig(**{n: v})) for n in DebugConfig.__dataclass_fields__},
    "straight": glsplat.straight,
    "load": glsplat.load,
    "load.format": lambda v: glsplat.load(io.BytesIO(b""), format=v),
    "load.strict": lambda v: glsplat.load(io.BytesIO(b""), strict=v),
    "save": lambda v: glsplat.save(v, io.BytesIO(), format="ply"),
    "save.target": lambda v: glsplat.save(sp, v),
    "save.format": lambda v: glsplat.save(sp, io.BytesIO(), format=v),
    "create_context.device": lambda v: glsplat.create_context(device=v).release(),
    "create_context.backend": lambda v: glsplat.create_context(backend=v).release(),
    "create_context.given": lambda v: glsplat.create_context(given=v).release(),
    "Renderer": lambda v: Renderer(v, size=(8, 8)).release(),
    "Renderer.size": lambda v: Renderer(sp, size=v).release(),
    "Renderer.views": lambda v: Renderer(sp, size=(8, 8), views=v).release(),
    "Renderer.config": lambda v: Renderer(sp, size=(8, 8), config=v).release(),
    "Renderer.context": lambda v: Renderer(sp, size=(8, 8), context=v).release(),
    "Renderer.timed": lambda v: Renderer(sp, size=(8, 8), timed=v).release(),
    "render": lambda v: held().render(v),
    "render.in": lambda v: held().render([v]),
    "render.pose": lambda v: held().render([cam], v),
    "in_order": lambda v: held().in_order(v, [cam]),
    "prepare": lambda v: held().prepare(v),
    "prepare.pose": lambda v: held().prepare([cam], v),
    "Prepared.out": lambda v: held().prepare([cam]).render(out=v),
    "render.depth": lambda v: held().render([cam], depth=v),
    "render.out": lambda v: held().render([cam], out=v),
    "selector": lambda v: drawn_with("selector", v),
    "selector.bias": lambda v: setattr(held().selector, "bias", v),
    "step": lambda v: drawn_with("step", v),
    "layers": lambda v: held().render([replace(cam, layers=v)]),
    "draw": lambda v: held().draw(v),
    "draw.pose": lambda v: held().draw([cam], v),
    "redraw": lambda v: held().redraw(v),
    "resize": lambda v: held().resize(v, v),
    "load a scene": lambda v: held().load(v),
}


@pytest.mark.parametrize("name", CALLS)
def test_anything_is_taken_or_refused_in_one_line(name: str) -> None:
    wrong = {}
    for shown, thing in THINGS.items():
        try:
            CALLS[name](thing)
        except GlsplatError as error:
            if "\n" in str(error) or len(str(error)) > 300:
                wrong[shown] = str(error)[:80]
        except Exception as error:
            wrong[shown] = f"{type(error).__name__}: {error}"
    held().resize(32, 32)
    held().load(Scene([Item(small), Item(sp)]))
    assert held().render([cam]).any() and not wrong, wrong
