"""An arm in front of the trunk is not painted on it, and the cloth it hides is continued."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from glsplat.extras.authoring.body.segments import arm_segments, layer_of, mirror_vertices
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.picture_layers.fill import fill_hole
from glsplat.extras.authoring.paint.picture_layers.labels import NOTHING, labels_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.sample.scatter import even_points
from tests.extras.authoring.paint.scene import photographed

RED, BLUE, GREEN = (200, 40, 40), (40, 40, 200), (30, 160, 60)


@cache
def crossing() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A blue trunk before a green room with a red arm over it: picture, mask, true layers, and the fit's segments,
    which have the arm some pixels aside."""
    rng = np.random.default_rng(0)
    mask, truth = np.zeros((480, 300), bool), np.full((480, 300), NOTHING)
    mask[10:470, 100:200] = True
    arm = np.zeros(mask.shape, np.uint8)
    cv2.line(arm, (185, 80), (140, 260), 1, 22)
    truth[mask], truth[arm > 0] = 0, 1
    mask |= arm > 0
    picture = np.full((*mask.shape, 3), GREEN, float)
    picture[truth == 0], picture[truth == 1] = BLUE, RED
    picture = (picture + rng.normal(0, 6, picture.shape)).clip(0, 255).astype(np.uint8)
    fitted = np.roll(arm, 6, axis=1)
    segment = np.where(mask, 0, NOTHING)
    segment[fitted > 0] = 1
    segment[(fitted > 0) & (np.arange(480)[:, None] > 170)] = 2
    return picture, mask, truth, segment


def test_colours_correct_a_misplaced_arm() -> None:
    picture, mask, truth, segment = crossing()
    nothing = np.zeros(mask.shape, bool)
    label = labels_of(picture, mask, segment, nothing, nothing)
    fitted = layer_of(segment) == 1
    right = (label == 1) & (truth == 1)
    assert right.sum() / ((label == 1) | (truth == 1)).sum() > 0.93
    assert (fitted & (truth == 1)).sum() / (fitted | (truth == 1)).sum() < 0.7  # the fit alone
    assert (label[~mask] == NOTHING).all()
    assert np.array_equal(label, labels_of(picture, mask, segment, nothing, nothing))


def test_an_arm_lies_along_its_bones_even_in_the_trunks_colour() -> None:
    """A sleeve of the trunk's own cloth, which the fit has beside the true arm: landmarks tell where it ends."""
    picture, mask, truth, segment = crossing()
    picture = picture.copy()
    picture[truth == 1] = picture[truth == 0][: (truth == 1).sum()]
    bones = np.full((2, 24, 2), np.nan)
    bones[0, :3] = (185, 80), (162, 170), (140, 260)
    nothing = np.zeros(mask.shape, bool)
    far = cv2.distanceTransform((truth != 1).astype(np.uint8), cv2.DIST_L2, 3) > 12
    spilt = [
        ((labels_of(picture, mask, segment, nothing, nothing, detected) == 1) & far).sum() for detected in (None, bones)
    ]
    assert spilt[1] < 0.2 * spilt[0]


def test_a_thing_in_a_hand_is_not_the_body() -> None:
    picture, mask, _, segment = crossing()
    picture, mask, hand = picture.copy(), mask.copy(), np.zeros(mask.shape, bool)
    bag = np.zeros(mask.shape, np.uint8)
    cv2.circle(bag, (225, 330), 40, 1, -1)
    picture[bag > 0] = (230, 210, 30)
    mask |= bag > 0
    hand[280:300, 190:200] = True
    label = labels_of(picture, mask, segment, hand, np.zeros(mask.shape, bool))
    assert (label[bag > 0] == NOTHING).mean() > 0.95  # also where it hangs before the trunk
    assert (label[segment == 0] == 0).mean() > 0.8


def test_cloth_hidden_by_an_arm_is_continued_across() -> None:
    rows = np.arange(200)[:, None, None]
    stripes = np.where(rows // 20 % 2, 0.6, 0.1) * np.ones((200, 120, 3))
    hole = np.zeros((200, 120), bool)
    hole[40:160, 50:70] = True
    spoilt = stripes.copy()
    spoilt[hole] = 1.0
    filled = fill_hole(spoilt.astype(np.float32), ~hole, hole, 200.0)
    assert np.array_equal(filled[~hole], spoilt[~hole].astype(np.float32))
    middle = filled[50:150:20, 55:65].mean(axis=(1, 2)), stripes[50:150:20, 55:65].mean(axis=(1, 2))
    assert np.abs(middle[0] - middle[1]).max() < 0.1


@pytest.mark.check
def test_an_arm_before_the_trunk_is_not_painted_on_it() -> None:
    """The made-up person's left arm is said to be over the trunk by its label: a stripe of green on the belly."""
    scene = photographed("front")
    front = scene.shots[0]
    segment = arm_segments(scene.body)
    assert set(np.unique(segment)) == {0, 1, 2, 3, 4}
    twin = mirror_vertices()
    assert (layer_of(segment)[twin] == np.array([0, 2, 1])[layer_of(segment)]).mean() > 0.99
    shot = FittedPicture(front.rgb, front.mask, front.focal, front.view, front.mesh, segment)
    points = even_points(scene.mesh, 1500)
    plain, layered = (painter_of(scene.body, [each], points).paint(points) for each in (front, shot))
    close = layer_of(segment)[points.corners[:, 0]] == 0
    assert np.median(np.abs(plain.rgb - layered.rgb)[close]) < 0.01  # arms are away: nothing changes
    label = shot.picture_layers.label.copy()
    pixels = front.view.pixels[scene.body.part == 3]
    left, right = np.quantile(pixels[:, 0], [0.4, 0.6]).astype(int)
    top, bottom = np.quantile(pixels[:, 1], [0.2, 0.8]).astype(int)
    rgb = front.rgb.copy()
    rgb[top:bottom, left:right] = GREEN
    label[top:bottom, left:right] = 1
    hidden = replace(shot, rgb=rgb)
    hidden.picture_layers.__dict__["label"] = label
    painted = painter_of(scene.body, [hidden], points).paint(points).rgb
    greenness = (painted[:, 1] - painted[:, [0, 2]].max(axis=1))[close]
    printed = painter_of(scene.body, [replace(front, rgb=rgb)], points).paint(points).rgb
    assert (printed[:, 1] - printed[:, [0, 2]].max(axis=1))[close].max() > 0.3
    assert greenness.max() < 0.1
    assert not hidden.picture_layers.agreed[top:bottom, left:right].any()  # and no splat is fitted to it


def test_another_body_keeps_one_layer() -> None:
    front = photographed("front").shots[0]
    assert not front.layer.any() and front.picture_layers.agreed is front.mask
