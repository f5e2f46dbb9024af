"""How densely a view shows a thing, and cells of neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import default_avatar
from glsplat.renderer.levels import Proxy, cells
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.scenes import cloud


def looking(eye: tuple[float, float, float], target: tuple[float, float, float], size: int = 512) -> Camera:
    return Camera(look_at(eye, target), pinhole(size, size, 90), size, size)


def dots(places: list[list[float]], scale: float = 0.01) -> Splats:
    n = len(places)
    return Splats.create(places, [[1.0, 0, 0, 0]] * n, [[scale] * 3] * n, [1.0] * n, rgb=[[1, 1, 1]] * n)


def test_density_of_one_splat_is_focal_length_over_depth() -> None:
    proxy = Proxy.of(dots([[0, 0, 0]], 1e-4))
    assert proxy.density(looking((0, 0, 4), (0, 0, 0))) == pytest.approx(256 / 4)
    assert proxy.density(looking((0, 0, 2), (0, 0, 0), 1024)) == pytest.approx(512 / 2)
    assert proxy.density(looking((0, 0, 4), (1.5, 0, 0))) > 256 / 4  # depth, not distance


def test_near_ones_count_by_their_pixels() -> None:
    proxy = Proxy.of(dots([[0, 0, 0], [0, 0, -1]], 1e-4))
    near, far = 1 / 1.0, 1 / 2.0  # 1 and 2 m away
    expected = ((near**4 + far**4) / (near**2 + far**2)) ** 0.5
    assert proxy.density(looking((0, 0, 1), (0, 0, -1))) == pytest.approx(256 * expected, rel=1e-3)


def test_what_is_out_of_view_does_not_count() -> None:
    proxy = Proxy.of(dots([[0, 0, -2], [0, 0, 0.5]], 1e-4))
    assert proxy.density(looking((0, 0, 0), (0, 0, -1))) == pytest.approx(256 / 2)
    assert proxy.density(looking((0, 0, 0), (0, 0, 1))) == pytest.approx(256 / 0.5)
    assert proxy.density(looking((0, 0, 0), (1, 0, 0))) == 0
    assert Proxy.of(dots([])).density(looking((0, 0, 0), (1, 0, 0))) == 0


def test_an_item_that_is_scaled_is_dense_in_its_own_metres() -> None:
    proxy = Proxy.of(cloud(300))
    small, large = looking((0, 0, 5), (0, 0, 0)), looking((10, 0, 15), (10, 0, 0))
    place = similarity((10, 0, 0), scale=3.0)
    assert proxy.density(large, place) == pytest.approx(proxy.density(small))


def test_an_avatar_is_followed_by_its_bones() -> None:
    person = default_avatar()
    proxy = Proxy.of(person)
    assert len(proxy.points) <= 160 and proxy.joints is not None
    camera = looking((0, 0, 3), (0, 0, 0))
    zero = Pose.zero(len(person.skeleton))
    rest = proxy.density(camera)
    assert rest == pytest.approx(proxy.density(camera, np.eye(4), zero.bones(person.skeleton)))
    assert 256 / 3 < rest < 256 / 2.8
    nearer = Pose(zero.rotations, (0, 0, 1.0)).bones(person.skeleton)
    assert proxy.density(camera, None, nearer) == pytest.approx(proxy.density(looking((0, 0, 2), (0, 0, -1))), rel=1e-9)
    reaching = zero.rotations.copy()  # an arm towards the eye
    reaching[person.skeleton.names.index("left_shoulder")] = (0, -1.5, 0)
    assert proxy.density(camera, None, Pose(reaching).bones(person.skeleton)) > 1.01 * rest


def test_nothing_jumps_as_the_eye_walks_and_turns(rng: np.random.Generator) -> None:
    """Through the middle of a room full of splats: a step of a centimetre or a degree changes little."""
    proxy = Proxy.of(dots(rng.uniform(-2, 2, (5000, 3)).tolist()))
    walk = [proxy.density(looking((0.1, 0, z), (0.1, 0, z - 1))) for z in np.arange(3, -1.5, -0.01)]
    angles = np.radians(np.arange(0, 360))
    turn = [proxy.density(looking((0, 0.3, 0), (np.sin(a), 0.3, np.cos(a)))) for a in angles]
    for values, most in ((walk, 1.05), (turn, 1.1)):
        ratio = np.array(values[1:]) / np.array(values[:-1])
        assert max(ratio.max(), 1 / ratio.min()) < most
    assert np.isfinite(walk).all() and max(walk) < 256 / 0.05


def test_splats_that_are_not_drawn_do_not_count() -> None:
    two = dots([[0, 0, 0], [0, 0, 3.9]])
    opacities, means = two.opacities.copy(), two.means.copy()
    opacities[1] = 0
    hidden = Splats(two.means, two.quats, two.scales, opacities, two.sh)
    means[1] = np.nan
    broken = Splats(means, two.quats, two.scales, two.opacities, two.sh)
    for splats in (hidden, broken):
        assert Proxy.of(splats).density(looking((0, 0, 4), (0, 0, 0))) == pytest.approx(64, rel=1e-3)


def test_cells_share_the_points_evenly(rng: np.random.Generator) -> None:
    for count in (1, 7, 64, 100):
        sizes = np.bincount(cells(rng.normal(size=(100, 3)), count), minlength=count)
        assert len(sizes) == count and sizes.min() >= 1 and sizes.max() <= -(-100 // count) + 2
    apart = cells(np.array([[0.0, 0], [0.1, 0], [5, 0], [5.1, 0]]), 2)
    assert apart[0] == apart[1] != apart[2] == apart[3]
