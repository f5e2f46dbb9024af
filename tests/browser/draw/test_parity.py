"""Pictures of the page against those of ``Renderer``: the same splats, the same cameras, another context."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import glsplat
from glsplat import Avatar, Camera, Item, Pose, RenderConfig, Renderer, Scene
from glsplat.config import with_fields
from glsplat.formats.motion_files import load_motion
from glsplat.renderer.project import ProjectPass
from glsplat.views import view_of
from tests import scenes
from tests.browser.draw.conftest import Bench, bench_on, posed

SIZE = (256, 224)


def psnr(picture: NDArray[np.float32], truth: NDArray[np.float32]) -> float:
    error = float(((picture.astype(np.float64) - truth) ** 2).mean())
    return 200.0 if error == 0 else float(-10 * np.log10(error))


def truth(scene: Any, cameras: list[Camera], target: str = "32f") -> NDArray[np.float32]:
    settings = with_fields(RenderConfig(), output="float32", target=target, shape="quad", level=0)
    with Renderer(scene, size=(cameras[0].width, cameras[0].height), views=len(cameras), config=settings) as renderer:
        picture = renderer.render(cameras)
    assert isinstance(picture, np.ndarray) and picture[..., 3].mean() > 0.005  # there is something to see
    return picture


def eyes(place: tuple[float, float, float], target: tuple[float, float, float], fov: float = 50.0) -> list[Camera]:
    return list(view_of(np.array(place), np.array(target), SIZE, fov, ipd=0.063))


def thing(pose: Pose | None = None, item: Item | None = None, amounts: Any = None) -> dict[str, Any]:
    out: dict[str, Any] = {"pose": None if pose is None else posed(pose), "amounts": amounts}
    if item is not None:
        linear = item.transform[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        w, x, y, z = glsplat.rotations.quaternion_of(linear / scale)
        rotation = [float(v) for v in (x, y, z, w)]
        out["place"] = {"translation": item.transform[:3, 3].tolist(), "rotation": rotation, "scale": scale}
    return out


@pytest.fixture(scope="module")
def person() -> Avatar:
    return glsplat.default_avatar()


def turning(person: Avatar, second: float) -> Pose:
    return load_motion("wave-and-turn", person.skeleton).at(second)


def test_an_embedded_person(bench: Bench, person: Avatar) -> None:
    pose, name = turning(person, 1.37), bench.offer("person", person)
    question = {"things": [name], "poses": [thing(pose)], "kinds": ["32f"]}
    scene = Scene([Item(person, pose=pose)])
    near = eyes((-0.35, 1.52, 0.8), (0.05, 1.2, 0))[1:]
    assert psnr(bench.pictures(near, **question)["32f"], truth(scene, near)) >= 100
    cameras = eyes((0.9, 1.1, 2.7), (0.05, 0.95, 0))
    expected = truth(scene, cameras)
    found = bench.pictures(cameras, **question | {"kinds": ["32f", "16f", "8"]})
    assert found["drawn"] == len(person.splats)
    assert psnr(found["32f"], expected) >= 100
    assert psnr(found["16f"], expected) >= 60
    assert psnr(found["8"], expected) >= 50
    triangles = bench.pictures(cameras, triangle=True, **question)
    assert psnr(triangles["32f"], expected) >= 95
    upward = bench.pictures(cameras, upward=True, **question)
    assert psnr(upward["32f"][:, ::-1], expected) >= 95


def test_by_the_same_keys_the_same_bits(bench: Bench, person: Avatar, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the desktop's key pass the picture is the desktop's own, bit for bit."""
    written: list[NDArray[np.uint32]] = []
    plain = ProjectPass.write_order

    def spied(self: ProjectPass, order: NDArray[np.uint32]) -> None:
        written.append(order.copy())
        plain(self, order)

    monkeypatch.setattr(ProjectPass, "write_order", spied)
    person = person.levels[0].content
    sh = np.concatenate([person.splats.sh, np.random.default_rng(3).normal(0, 0.1, (len(person.splats), 15, 3))], 1)
    person = replace(person, splats=replace(person.splats, sh=sh.astype(np.float32)), levels=())
    pose, cameras = turning(person, 2.93), eyes((-0.8, 1.6, 1.9), (0, 1.1, 0))
    expected = truth(Scene([Item(person, pose=pose)]), cameras)
    question = {"things": [bench.offer("person", person)], "poses": [thing(pose)], "kinds": ["32f"]}
    found = bench.pictures(cameras, order=written[-1].tolist(), **question)
    assert np.array_equal(found["32f"], expected)


def test_directional_colours_of_degree_3(bench: Bench) -> None:
    """Splats without a skeleton, placed, turned and scaled; opacity compensation asked for and not, in one scene."""
    still = scenes.cloud(7000, degree=3, seed=11, spread=0.4)
    asks = replace(scenes.cloud(3000, degree=1, seed=12, spread=0.3), antialias=True)
    first = Item(still, transform=glsplat.similarity((0.2, 1.0, -0.3), (0.3, -0.5, 0.2, 0.6), 0.7))
    second = Item(asks, transform=glsplat.similarity((-0.4, 0.9, 0.2), (0, 1, 0, 1e-9)))
    cameras = eyes((0.5, 1.4, 2.2), (0, 1, 0))
    expected = truth(Scene([first, second]), cameras)
    names = [bench.offer("still", still), bench.offer("asks", asks)]
    poses = [thing(item=first), thing(item=second)]
    found = bench.pictures(cameras, things=names, poses=poses, kinds=["32f", "16f"])
    assert psnr(found["32f"], expected) >= 100
    # colours far above 1, of which 16 bits keep less: as much as the desktop's do
    assert psnr(found["16f"], expected) >= psnr(truth(Scene([first, second]), cameras, target="16f"), expected) - 0.5


@pytest.mark.parametrize("influences", [1, 8])
def test_influences_and_colours_that_turn_with_bones(bench: Bench, influences: int) -> None:
    rod = scenes.limb(2500, joints=9, influences=influences, degree=2, seed=5)
    rng = np.random.default_rng(influences)
    pose = Pose(rng.normal(0, 0.4, (9, 3)), (-2.0, 0.9, 0.1), rng.normal(0, 0.05, (9, 3)))
    cameras = eyes((0.3, 1.3, 4.5), (0, 1, 0))
    expected = truth(Scene([Item(rod, pose=pose)]), cameras)
    found = bench.pictures(cameras, things=[bench.offer("rod", rod)], poses=[thing(pose)], kinds=["32f"])
    assert psnr(found["32f"], expected) >= 100


def test_two_people_who_embrace(bench: Bench, person: Avatar) -> None:
    """One mirrored into the arms of the other: they interleave splat by splat."""
    person = person.levels[0].content
    body = np.zeros((21, 3))
    body[15], body[16] = (0.2, -1.1, 0.3), (0.1, 1.0, -0.2)  # shoulders ahead
    body[17], body[18] = (0, -0.9, 0.2), (0, 0.8, 0)
    pose = Pose.from_smplx({"body_pose": body})
    other = Item(person, pose=pose, transform=glsplat.similarity((0.06, 0.02, 0.27), (0, 1, 0, 0.12), 0.93))
    items = [Item(person, pose=pose), other]
    cameras = eyes((1.6, 1.5, 1.0), (0, 1.1, 0.13))
    expected = truth(Scene(items), cameras)
    name = bench.offer("person", person)
    poses = [thing(item.pose, item) for item in items]
    found = bench.pictures(cameras, things=[name, name], poses=poses, kinds=["32f", "16f"])
    assert found["drawn"] == 2 * len(person.splats)
    assert psnr(found["32f"], expected) >= 100 and psnr(found["16f"], expected) >= 60
    # the order is one over both: one after the other would be another picture
    apart = [truth(Scene([item]), cameras) for item in items]
    after = apart[0] + apart[1] * (1 - apart[0][..., 3:])
    assert psnr(after, expected) < 45


def test_another_driver(chromium: Any, person: Avatar) -> None:
    """SwiftShader: one triangle a splat, as software gets it; of degree 3 where textures are 8192 wide at most."""
    with bench_on(chromium) as bench:
        pose, cameras = turning(person, 0.61), eyes((0.4, 1.2, 2.5), (0, 1, 0))
        expected = truth(Scene([Item(person, pose=pose)]), cameras)
        name = bench.offer("person", person)
        found = bench.pictures(cameras, things=[name], poses=[thing(pose)], kinds=["32f"])
        assert psnr(found["32f"], expected) >= 65
        cloud, cameras = scenes.cloud(1200, degree=3, seed=21, spread=0.4), eyes((0.3, 0.2, 2.4), (0, 0, 0))
        found = bench.pictures(cameras, things=[bench.offer("cloud", cloud)], poses=[thing()], kinds=["32f"])
        assert psnr(found["32f"], truth(cloud, cameras)) >= 60


def test_a_headset_of_four_views_is_drawn_in_pairs(bench: Bench) -> None:
    name = bench.offer("cloud", scenes.cloud(900, seed=5, spread=0.4))
    rows = bench.js(
        """async (name) => {
          const { context, load } = await import('/vr/test/page.js');
          const { Drawing } = await import('/vr/draw/drawing.js');
          const table = await (await fetch('/vr/draw/programs.json')).json();
          const gl = context(256, 64);
          const drawing = new Drawing(gl, table);
          drawing.show([await load(name)]);
          const eyes = [0, 1, 2, 3].map((i) => ({
            transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.3 * (i % 2), 0, 2.2, 1],
            projection: [1.8, 0, 0, 0, 0, 1.8, 0, 0, 0, 0, -1, -1, 0, 0, -0.1, 0],
            viewport: { x: 64 * i, y: 0, width: 64, height: 64 },
          }));
          drawing.draw(eyes, null, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
          const pixels = new Uint8Array(256 * 64 * 4);
          gl.readPixels(0, 0, 256, 64, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
          return { pixels: [...pixels], error: gl.getError() };
        }""",
        name,
    )
    assert rows["error"] == 0
    picture = np.array(rows["pixels"], np.uint8).reshape(64, 4, 64, 4)
    assert picture[:, 0].mean() > 5 and (picture[:, 0] != picture[:, 1]).any()
    # another place of the canvas rounds otherwise, and that is all
    assert np.abs(picture[:, :2].astype(int) - picture[:, 2:]).max() <= 3
