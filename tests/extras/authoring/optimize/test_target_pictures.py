"""The pictures that splats are fitted to: the same by OpenGL and by numpy, of the whole figure and of what is small."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.errors import ContextError
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.optimize import target_pictures as module
from glsplat.extras.authoring.optimize.target_pictures import TargetPicture, ViewConfig, pictures_of, pictures_of_splats
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from tests.extras.authoring.optimize.figures import decibel, mesh, start

FEW = ViewConfig(body=3, poses=2, each=2, size=96, close=64)
ARMED = ("pelvis", "left_shoulder", "right_shoulder")  # what random poses need


def named(*names: str) -> RiggedMesh:
    """The ball, half as wide as it is high, on joints of these names; the first three move it from below to above."""
    places = np.linspace((0, 0.7, 0), (0, 1.3, 0), 3)
    skeleton = Skeleton.from_joints(names, [-1, 0, 1], places)
    vertices = mesh().vertices * (0.5, 1, 0.5)
    joint = np.clip(((vertices[:, 1] - 0.7) / 0.2).astype(int), 0, 2)[:, None]
    return replace(mesh(), vertices=vertices, skeleton=skeleton, joints=joint, weights=np.ones((len(vertices), 1)))


def no_context(*words: Any, **more: Any) -> None:
    raise ContextError("there is none")


def pixels_of(picture: TargetPicture, points: np.ndarray) -> np.ndarray:
    camera = picture.camera
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    return (seen @ camera.K.T)[:, :2] / seen[:, 2:]


@pytest.mark.gl
@pytest.mark.usefixtures("gl")
def test_opengl_and_numpy_draw_the_same(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    figure, config = named(*ARMED), replace(FEW, size=192)
    drawn = pictures_of(figure, 3, config, context=context)
    monkeypatch.setattr(module, "create_context", no_context)
    computed = pictures_of(figure, 3, config)
    assert len(drawn) == len(computed) == 3 + 2 * 2
    for ours, theirs in zip(drawn, computed, strict=True):
        assert np.array_equal(ours.camera.K, theirs.camera.K) and ours.metres_per_pixel == theirs.metres_per_pixel
        mine, other = ours.target / 255, theirs.target / 255
        assert decibel(mine, other) > 35
        inner = cv2.erode((mine[..., 3] == 1).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        assert inner.mean() > 0.2 and decibel(mine[inner], other[inner]) > 40
        assert (ours.target[..., :3] <= ours.target[..., 3:]).all()  # premultiplied


@pytest.mark.parametrize(
    ("names", "close_ups"),
    [
        (("low", "middle", "high"), 0),
        (("pelvis", "spine1", "head"), 12),
        (("left_wrist", "left_index1", "right_ankle"), 8),
        (("left_thumb3", "right_wrist", "jaw"), 20),
    ],
)
def test_close_ups_need_the_joints_of_the_rig(
    names: tuple[str, ...], close_ups: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "create_context", no_context)
    figure = named(*names)
    found = pictures_of(figure, config=replace(FEW, body=1, poses=1, each=1, size=48, close=48))
    assert len(found) == 1 + close_ups + 1
    for picture in found[1:-1]:
        assert picture.pose is None and max(picture.target.shape) <= 48
        assert picture.metres_per_pixel < 0.85 * found[0].metres_per_pixel
    if names[2] == "head":
        upper = figure.vertices[figure.joints[:, 0] == 2]
        for picture in found[1:-1]:
            at = pixels_of(picture, upper)
            assert (at > 0).all() and (at < (picture.camera.width, picture.camera.height)).all()


def test_the_figure_fills_the_pictures_and_is_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "create_context", no_context)
    figure = named(*ARMED)
    found = pictures_of(figure, 3, replace(FEW, size=160))
    zero = module.Pose.zero(3)
    for picture in found:
        height, width = picture.target.shape[:2]
        assert (width, height) == (picture.camera.width, picture.camera.height) and width < 0.85 * 160
        at = pixels_of(picture, figure.posed(picture.pose or zero))
        assert (at.min(axis=0) > 3).all() and (at.max(axis=0) < np.array([width, height]) - 3).all()
        alpha = picture.target[..., 3]
        assert not any(edge.any() for edge in (alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]))
        shown = np.flatnonzero(alpha.any(axis=1))
        assert np.ptp(shown) == pytest.approx(np.ptp(at[:, 1]), abs=2) and np.ptp(shown) > 0.7 * 160
        assert np.ptp(at[:, 1]) * picture.metres_per_pixel == pytest.approx(0.6, rel=0.25)
    poses = [picture.pose for picture in found]
    assert poses[:3] == [None] * 3 and poses[3] is poses[4] and poses[5] is poses[6] and poses[3] is not poses[5]
    assert np.abs(poses[3].rotations - poses[5].rotations).max() > 0.1
    places = np.array([picture.camera.position for picture in found])
    assert min(np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]) > 0.2


def same(one: list[TargetPicture], other: list[TargetPicture]) -> bool:
    return all(a.target.tobytes() == b.target.tobytes() for a, b in zip(one, other, strict=True))


def on_three_joints() -> Avatar:
    """Splats on the ball of two joints, on three; one of them nowhere."""
    avatar = start()
    means = avatar.splats.means.copy()
    means[7] = np.nan
    skeleton = Skeleton.from_joints(ARMED, [-1, 0, 0], [[0, 0.7, 0], [0, 1, 0], [0, 1.2, 0]])
    return replace(avatar, splats=replace(avatar.splats, means=means), skeleton=skeleton)


@pytest.mark.parametrize("antialias", [False, True])
def test_pictures_of_splats_equal_the_renderer(antialias: bool) -> None:
    avatar = on_three_joints()
    avatar = replace(avatar, splats=replace(avatar.splats, antialias=antialias))
    found = pictures_of_splats(avatar, 3, FEW)
    assert len(found) == 3 + 2 * 2
    for picture in found:
        splats = avatar.splats if picture.pose is None else posed_splats(avatar, picture.pose)
        truth = reference.render(splats.take(splats.finite()), [picture.camera])[0]
        assert truth[..., 3].max() > 0.9 and np.abs(picture.target - truth * 255).max() < 0.6
    assert same(found, pictures_of_splats(avatar, 3, FEW)) and not same(found, pictures_of_splats(avatar, 4, FEW))
