"""A server's light falls on all that it shows: the scene, avatars that clients choose, rooms without their own."""

from __future__ import annotations

from typing import Any

from apps.serve.rooms import lit_rooms
from glsplat.data import default_avatar
from glsplat.net.backends.renderer_pool import RendererPool
from glsplat.net.backends.room import RoomRenderer
from glsplat.scene import Item, Scene
from glsplat.scenes.scene_file import SceneFile
from tests.light.lit import random_light
from tests.scenes import limb


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
    for one in (pool.get(), pool.get("ann"), pool.get("", ("head",))):
        assert one.scene.light is light and len(one.scene) == 1
    assert RendererPool(limb(20), {"ann": limb(20)}, make).get("ann").scene.light is None


def test_rooms_keep_their_own_light_and_take_the_servers() -> None:
    own, servers = random_light(1), random_light(2)
    rooms = {"lit": SceneFile.of(Scene(light=own)), "plain": SceneFile.of(Scene())}
    found = lit_rooms(rooms, SceneFile.of(Scene([Item(limb(20))], light=servers)))
    assert found["lit"].scene.light is own and found["plain"].scene.light is servers
    make: Any = Drawn
    assert RoomRenderer(found["lit"], lambda name: limb(20), make).scene.light is own
