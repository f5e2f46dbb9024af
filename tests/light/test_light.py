"""Light as a value and a server's light: what it takes, what it shines on."""

from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest

from apps.serve.command import lit_rooms
from glsplat.data import default_avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.visibility import sphere
from glsplat.formats.scene_file import SceneFile
from glsplat.light.light import Light
from glsplat.net.backends.renderer_pool import RendererPool
from glsplat.net.backends.scene_renderer import SceneRenderer
from glsplat.scene import Item, Scene
from tests.light.lit import random_light
from tests.scenes import limb

NINE = np.zeros((9, 3)).tolist()


def radiance(light: Light, directions: np.ndarray) -> np.ndarray:
    """[N, 3] by the harmonics themselves, written down once more."""
    x, y, z = directions.T
    pi = np.pi
    basis = [
        np.full_like(x, np.sqrt(1 / (4 * pi))),
        *(np.sqrt(3 / (4 * pi)) * a for a in (y, z, x)),
        *(np.sqrt(15 / (4 * pi)) * a for a in (x * y, y * z)),
        np.sqrt(5 / (16 * pi)) * (3 * z * z - 1),
        np.sqrt(15 / (4 * pi)) * x * z,
        np.sqrt(15 / (16 * pi)) * (x * x - y * y),
    ]
    return np.stack(basis, axis=1) @ light.ambient


def test_irradiance_is_the_cosine_weighted_integral_of_radiance() -> None:
    light, ways = random_light(3, sun=False), sphere(20_000)
    normals = sphere(7)
    cosine = np.maximum(normals @ ways.T, 0)
    wanted = cosine @ radiance(light, ways) * (4 * np.pi / len(ways)) / np.pi
    assert np.abs(light.irradiance(normals) - np.maximum(wanted, 0)).max() < 1e-3


def test_radiance_of_one_from_everywhere_shows_albedo_as_it_is() -> None:
    assert Light.uniform(1.0).irradiance(sphere(50)) == pytest.approx(np.ones((50, 3)), abs=1e-12)
    assert Light.uniform((0.1, 0.2, 0.3)).irradiance([[0, 0, 1]])[0] == pytest.approx((0.1, 0.2, 0.3))


def test_a_hemisphere_is_the_sky_above_and_the_ground_below() -> None:
    light = Light.hemisphere((0.5, 0.6, 0.7), (0.2, 0.1, 0.3), (0, 3, 4), (1, 2, 3))
    assert light.irradiance([[0, 1, 0], [0, -1, 0], [1, 0, 0]]) == pytest.approx(
        np.array([[0.5, 0.6, 0.7], [0.2, 0.1, 0.3], [0.35, 0.35, 0.5]])
    )
    assert light.sun_direction == pytest.approx((0, 0.6, 0.8)) and light.sun_colour.tolist() == [1, 2, 3]


@pytest.mark.parametrize("light", [random_light(1), random_light(2, sun=False), Light.preset("evening")])
def test_json_and_pickle_give_the_same_light(light: Light) -> None:
    for other in (Light.from_json(json.loads(json.dumps(light.to_json()))), pickle.loads(pickle.dumps(light))):
        assert other.same(light) and np.array_equal(other.ambient, light.ambient)
        assert not other.ambient.flags.writeable
    assert not light.same(None) and not light.same(Light.uniform())


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("noon", "a light is one of studio"),
        (3, "a light is an object with ambient"),
        ({}, "needs ambient: nine coefficients"),
        ({"ambient": NINE, "suns": 1}, "has the keys ambient and sun, not 'suns'"),
        ({"ambient": [[0, 0, 0]] * 8}, r"ambient needs 9 x 3 numbers, not an array of \(8, 3\)"),
        ({"ambient": [[0, 0, float("nan")], *NINE[1:]]}, "finite numbers up to 10000"),
        ({"ambient": [[0, 0, 1e9], *NINE[1:]]}, "finite numbers up to 10000"),
        ({"ambient": "bright"}, "ambient"),
        ({"ambient": NINE, "sun": 4}, "object with direction and color"),
        ({"ambient": NINE, "sun": {"direction": [0, 1, 0]}}, "object with direction and color"),
        ({"ambient": NINE, "sun": {"direction": [0, 2, 0], "color": [1, 1, 1]}}, "unit vector towards the light"),
        ({"ambient": NINE, "sun": {"direction": [0, 0, 0], "color": [1, 1, 1]}}, "unit vector towards the light"),
        ({"ambient": NINE, "sun": {"direction": [0, 1, 0], "color": [1, -1, 1]}}, "0 and more"),
        ({"ambient": NINE, "sun": {"direction": [0, 1], "color": [1, 1, 1]}}, "needs 3 numbers"),
    ],
)
def test_what_is_no_light_is_refused_in_a_line(data: Any, words: str) -> None:
    with pytest.raises(FormatError, match=words) as refused:
        Light.from_json(data)
    assert "\n" not in str(refused.value)


def test_a_colour_needs_a_direction_and_a_direction_a_length() -> None:
    with pytest.raises(FormatError, match="needs a direction"):
        Light(NINE, None, (1, 1, 1))
    with pytest.raises(FormatError, match="not zero"):
        Light.hemisphere((1, 1, 1), (0, 0, 0), (0, 0, 0), (1, 1, 1))


def test_a_turned_light_lights_what_turns_with_it_alike() -> None:
    """Any rotation, on normals all around: what faced a light faces it still."""
    rng = np.random.default_rng(8)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    way = rng.normal(size=3)
    light = Light(rng.normal(size=(9, 3)), way / np.linalg.norm(way), (1, 2, 3))
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turned = light.turned(turn)
    np.testing.assert_allclose(turned.irradiance(normals @ turn.T), light.irradiance(normals), atol=1e-12)
    assert turned.sun_direction is not None and light.sun_direction is not None
    np.testing.assert_allclose(normals @ turn.T @ turned.sun_direction, normals @ light.sun_direction, atol=1e-12)
    assert not np.allclose(turned.irradiance(normals), light.irradiance(normals), atol=0.1)
    assert Light((np.arange(27) / 9).reshape(9, 3)).turned(turn).sun_direction is None


class Drawn:
    """Stands in for a renderer."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def nbytes(self) -> dict[str, int]:
        return {}

    def release(self) -> None: ...


def test_the_scene_its_parts_and_other_avatars() -> None:
    light: Any = random_light(1)
    make: Any = Drawn
    pool = RendererPool(Scene([Item(default_avatar())], light=light), {"ann": limb(20)}, make)
    for one in (pool.get(), pool.get("ann")):
        assert one.scene.light is light and len(one.scene) == 1
    assert RendererPool(limb(20), {"ann": limb(20)}, make).get("ann").scene.light is None


def test_rooms_keep_their_own_light_and_take_the_servers() -> None:
    own, servers = random_light(1), random_light(2)
    rooms = {"lit": SceneFile.of(Scene(light=own)), "plain": SceneFile.of(Scene())}
    found = lit_rooms(rooms, SceneFile.of(Scene([Item(limb(20))], light=servers)))
    assert found["lit"].scene.light is own and found["plain"].scene.light is servers
    make: Any = Drawn
    assert SceneRenderer(found["lit"], make, lambda name: limb(20)).scene.light is own
