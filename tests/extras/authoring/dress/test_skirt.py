"""A skirt is one surface between the legs, and follows both."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.body.segments import hand_weights
from glsplat.extras.authoring.dress.fitted_mesh import Dressed, dressed_mesh
from glsplat.extras.authoring.dress.skirt import coat_hem, hem_of, with_bare_hands, with_skirt
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.made_up import posed_view
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import photographed


def view_with(mask: np.ndarray) -> View:
    scene = photographed("front")
    view, _, _ = posed_view("front")
    return View(mask, view.landmarks * 2, view.visibility, scene.shots[0].focal, view.centre * 2)


def skirted(share: float, reach: float = 0.12) -> tuple[np.ndarray, float]:
    """The person's mask with cloth from leg to leg down to a share of the way from hip to ankle; the hem's row."""
    scene = photographed("front")
    front = scene.shots[0]
    at = front.project(front.view.joints)
    hips, ankles = (
        at[[JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")], 1].mean() for name in ("hip", "ankle")
    )
    hem = hips + share * (ankles - hips)
    mask = front.mask.copy()
    for row in range(int(hips), int(hem)):
        columns = np.flatnonzero(mask[row])
        middle = columns[np.abs(columns - at[0, 0]) < reach * (ankles - hips) * 2]
        mask[row, middle.min() : middle.max() + 1] = True
    return mask, hem


def test_hands_have_the_body_s_own_shape() -> None:
    scene = photographed("front")
    body, fit = scene.body, scene.fit
    bare, hands = body.shaped(fit.betas)[0], hand_weights(body) * body.skin > 0.999
    thin = np.where(hands, -0.006, fit.offsets)
    off = replace(fit.views[0], vertices=fit.views[0].vertices + 0.01)
    worn = replace(fit, offsets=thin, rest=bare + thin[:, None] * offset_directions(body, bare), views=(off,))
    made, (front,) = with_bare_hands(body, worn, [view_with(scene.shots[0].mask)])
    shift = made.vertices - bare
    assert np.ptp(shift[hands], axis=0).max() < 1e-6  # the floor's
    assert np.array_equal(made.vertices[body.part == 0], dressed_mesh(body, worn).vertices[body.part == 0])
    assert np.abs(front.vertices - fit.views[0].vertices)[hands].max() < 1e-5


def test_a_skirt_ends_at_its_hem_and_trousers_have_none() -> None:
    scene = photographed("front")
    assert hem_of(scene.body, scene.fit, scene.mesh, view_with(scene.shots[0].mask)) is None
    mask, row = skirted(0.6)
    hem = hem_of(scene.body, scene.fit, scene.mesh, view_with(mask))
    assert hem is not None
    front = scene.shots[0]
    legs = np.isin(scene.body.part, [JOINT_NAMES.index(f"{side}_knee") for side in ("left", "right")])
    there = legs & (np.abs(front.view.pixels[:, 1] - row) < 4)
    assert abs(hem - np.median(scene.mesh.vertices[there, 1])) < 0.03
    kernel = np.ones((3, 3), np.uint8)
    thin = cv2.erode(scene.shots[0].mask.astype(np.uint8), kernel) > 0
    assert hem_of(scene.body, scene.fit, scene.mesh, view_with(thin)) is None


def test_a_gown_ends_at_the_ankles() -> None:
    scene = photographed("front")
    mask, _ = skirted(1.1, 0.2)
    hem = hem_of(scene.body, scene.fit, scene.mesh, view_with(mask))
    ankle = scene.mesh.skeleton.joints[[JOINT_NAMES.index(f"{side}_ankle") for side in ("left", "right")], 1].mean()
    assert hem is not None and abs(hem - ankle) < 0.08
    torn = mask.copy()
    middle = int(scene.shots[0].project(scene.shots[0].view.joints)[0, 0])
    torn[:, middle - 3 : middle + 3] = False  # two trouser legs that nearly meet
    assert hem_of(scene.body, scene.fit, scene.mesh, view_with(torn)) is None


def test_a_skirt_is_closed_between_the_legs_and_follows_both() -> None:
    scene = photographed("front")
    mask, _ = skirted(0.6)
    view = view_with(mask)
    hem = hem_of(scene.body, scene.fit, scene.mesh, view)
    assert hem is not None
    made, seen = with_skirt(scene.body, scene.mesh.vertices, Dressed(scene.mesh, scene.fit.views), [view], hem)
    below = scene.mesh.vertices[:, 1] <= hem - 0.06  # the legs' vertices next to the hem close the skirt
    assert np.array_equal(made.vertices[below], scene.mesh.vertices[below])
    assert np.allclose(made.weights.sum(axis=1), 1)
    moved = np.linalg.norm(made.vertices - scene.mesh.vertices, axis=1) > 1e-4
    assert 100 < moved.sum() < 0.2 * len(moved)
    for side, sign in (("left", 1.0), ("right", -1.0)):  # each leg's half stays on its side
        leg = np.isin(scene.body.part, [JOINT_NAMES.index(f"{side}_{name}") for name in ("hip", "knee")])
        assert (sign * made.vertices[moved & leg, 0]).min() > -1e-3
    legs = np.isin(
        scene.body.part, [JOINT_NAMES.index(f"{side}_{at}") for side in ("left", "right") for at in ("hip", "knee")]
    )
    above = made.vertices[:, 1] - hem
    back = [made.vertices[legs & (np.abs(above - up) < 0.03), 2].min() for up in (0.18, 0.26)]
    assert back[0] < back[1] + 0.01  # it hangs from the seat, not in between the thighs
    # one leg steps forward: the sheet stays in one piece, the legs of trousers come apart
    stride = np.zeros((55, 3))
    stride[JOINT_NAMES.index("left_hip"), 0] = -0.5
    level = (scene.mesh.vertices[:, 1] > hem) & (scene.mesh.vertices[:, 1] < hem + 0.1)

    def torn(mesh) -> float:
        """Metres between what meets in the middle."""
        now = mesh.posed(Pose(stride))
        inmost = level & (np.abs(mesh.vertices[:, 0]) < 0.02 + np.abs(mesh.vertices[level, 0]).min())
        left, right = (now[inmost & (sign * mesh.vertices[:, 0] >= 0)].mean(axis=0) for sign in (1, -1))
        return float(np.linalg.norm(left - right))

    assert torn(made) < 0.4 * torn(scene.mesh)
    there = (made.posed(Pose(scene.fit.views[0].rotations)) - made.skeleton.joints[0]) @ scene.fit.views[0].root.T
    assert np.abs(there + scene.fit.views[0].pelvis - seen[0].vertices)[moved].max() < 1e-6


@pytest.mark.parametrize("angle", [0.0, np.pi])
def test_a_skirt_ends_in_one_edge_in_front_and_behind(angle: float) -> None:
    scene = photographed("front")
    hem = 0.55
    made = with_skirt(
        scene.body, scene.mesh.vertices, Dressed(scene.mesh, scene.fit.views), [view_with(scene.shots[0].mask)], hem
    ).mesh
    middle, size, focal = np.array([0, hem, 0]), 200, 100 / 0.05 * 60  # half a side is 5 cm
    camera = look_at(middle + 60 * np.array([np.sin(angle), 0, np.cos(angle)]), middle)
    lens = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    hit, where = visible_faces(made, made.vertices, Camera(camera, lens, size, size))
    above, under = hit[: size // 2 - 4], hit[size // 2 + 4 :]
    assert (above >= 0).mean() > 0.99 and (under < 0).mean() > 0.99
    hit[size // 2 - 4 :] = -1
    depth = (where[hit >= 0, :, None] * made.vertices[made.faces[hit[hit >= 0]]]).sum(axis=1)[:, 2]
    assert np.ptp(depth) < 0.01


def test_an_open_coat_hangs_as_one_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, low = made_up.albedo, 0.35  # heights of the person

    def coat(mesh: RiggedMesh) -> np.ndarray:
        colours, height = usual(mesh), mesh.vertices[:, 1] / mesh.vertices[:, 1].max()
        colours[(height > low) & (height < 0.84)] = (0.02, 0.02, 0.03)
        return colours

    mask, _ = skirted(0.6)
    plain = photographed("front")
    assert (
        coat_hem(plain.body, plain.fit, Dressed(plain.mesh, plain.fit.views), plain.shots[0].rgb, view_with(mask))
        is None
    )
    monkeypatch.setattr(made_up, "albedo", coat)
    scene = photographed.__wrapped__("front")
    dressed, front = Dressed(scene.mesh, scene.fit.views), scene.shots[0]
    hem = coat_hem(scene.body, scene.fit, dressed, front.rgb, view_with(mask))
    assert hem is not None and abs(hem - low * scene.mesh.vertices[:, 1].max()) < 0.03
    assert (
        coat_hem(scene.body, scene.fit, dressed, front.rgb, view_with(front.mask)) is None
    )  # the room shows between the legs: trousers
    made = with_skirt(scene.body, scene.mesh.vertices, dressed, [view_with(mask)], hem).mesh
    moved = np.linalg.norm(made.vertices - scene.mesh.vertices, axis=1) > 1e-4
    assert moved.sum() > 50
    for sense in (1, -1):  # in front, too, it does not follow each leg
        inner = moved & (np.abs(made.vertices[:, 0]) < 0.01) & (np.abs(made.vertices[:, 1] - hem - 0.1) < 0.04)
        inner &= sense * made.vertices[:, 2] > 0
        assert inner.any() and (sense * (made.vertices - scene.mesh.vertices)[inner, 2] > 0).all()
