"""Labels of people who stand close, or behind each other: each can be read, in both eyes, as long as there is room."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.camera import Camera, head_matrix, stereo_cameras
from glsplat.net.backends.labels import Label
from glsplat.net.backends.lettering import draw_labels

SIDE = 512
EYES = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), ipd=0.064, size=(SIDE, SIDE))


def drawn(labels: list[Label], eyes: list[Camera] = EYES) -> NDArray[np.uint8]:
    images = np.zeros((len(eyes), SIDE, SIDE, 4), np.uint8)
    draw_labels(images, eyes, labels)
    return images


def alone(label: Label) -> NDArray[np.bool_]:
    return drawn([label])[..., 3] > 0


def rows(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The rows in which each eye sees something, from and to."""
    found = [np.nonzero(one.any(axis=1))[0] for one in mask]
    return [(int(each.min()), int(each.max())) for each in found]


def test_two_people_at_one_bearing_can_both_be_read() -> None:
    near = Label("driven by Ann, synthetic", np.array([0.0, 1.55, 1.6]))
    far = Label("driven by Zoë, synthetic", np.array([0.0, 1.56, 2.1]))
    assert (alone(near) & alone(far)).any(axis=(1, 2)).all()  # where they are they cover each other
    for order in ([near, far], [far, near]):
        both = drawn(order)
        assert np.array_equal(both[alone(near)], drawn([near])[alone(near)])  # the nearer stands where it stood
        above = both.copy()
        above[alone(near)] = 0
        edges = zip(rows(above[..., 3] > 0), rows(alone(near)), rows(alone(far)), strict=True)
        for (top, bottom), (other, _), own in edges:
            assert bottom < other and bottom - top >= own[1] - own[0] - 1  # all of it, over the nearer
        # read in full, fainter, and still at its own distance
        assert 0.7 < above[..., 3].max() / drawn([far])[..., 3].max() < 0.9
        middles = [np.nonzero(one.any(axis=0))[0][[0, -1]].mean() for one in above[..., 3] > 0]
        assert middles[0] - middles[1] == pytest.approx(EYES[0].K[0, 0] * 0.064 / 2.1, abs=1)


@pytest.mark.parametrize(("size", "least"), [(256, 12), (512, 13), (1024, 26)])
def test_from_afar_it_keeps_a_share_of_the_picture(size: int, least: int) -> None:
    eyes = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), ipd=0.064, size=(size, size))
    images = np.zeros((len(eyes), size, size, 4), np.uint8)
    draw_labels(images, eyes, [Label("driven by Ann", np.array([0.0, 1.5, 30.0]))])
    for low, high in rows(images[..., 3] > 0):
        assert high - low + 1 == pytest.approx(least, abs=1)


def test_who_stands_apart_is_left_alone() -> None:
    labels = [Label("Ann", np.array([x, 1.5, 2.0])) for x in (-0.6, 0.6)]
    assert np.array_equal(drawn(labels), np.maximum(drawn(labels[:1]), drawn(labels[1:])))


@pytest.mark.parametrize("seed", range(6))
def test_a_crowd_can_be_read(seed: int) -> None:
    """People in random places: no two boards share a pixel of any eye, and no board leaves the picture."""
    chance = np.random.default_rng([37, seed])
    places = [np.array([chance.uniform(-0.3, 0.3), chance.uniform(1.3, 1.6), chance.uniform(1.5, 4)]) for _ in range(5)]
    labels = [Label(f"P{i}, synthetic", place) for i, place in enumerate(places)]
    both = drawn(labels)[..., 3]
    inked = sum(int(np.count_nonzero(drawn([label])[..., 3])) for label in labels)
    assert np.count_nonzero(both) == pytest.approx(inked, rel=0.05)


def test_at_the_upper_edge_it_goes_below_and_without_room_it_stays() -> None:
    top = 1.5 + 1.6 * (EYES[0].K[1, 2] - 12) / EYES[0].K[1, 1]
    near, far = (Label("driven by Ann", np.array([0.0, top - 0.01 * z, z])) for z in (1.6, 1.7))
    both = drawn([near, far])
    both[alone(near)] = 0
    (first, _), (second, _) = rows(both[..., 3] > 0)
    assert first > rows(alone(near))[0][0] and second > rows(alone(near))[1][0]
    crowd = [Label(f"P{i}", np.array([0.0, 1.5, 1.6 + 0.01 * i]), 0.5) for i in range(8)]
    bright = drawn(crowd[:1])[..., :3].min(axis=-1) > 200  # the letters of the nearest
    assert bright.any() and (drawn(crowd)[..., :3].min(axis=-1)[bright] > 200).all()  # without room it is in front
