"""The page's levels, names and angles are the package's own."""

from __future__ import annotations

import numpy as np

import glsplat
from glsplat.detail.proxy import Proxy
from glsplat.detail.selector import chosen
from glsplat.motion.loading import load_motion
from glsplat.skinning.expression import ARKIT
from tests import scenes
from tests.browser.draw.conftest import Bench
from tests.browser.draw.exported import camera_file, posed
from tests.browser.draw.test_parity import eyes

ASK = """async ({ name, pose, cameras }) => {
  const { load, poseOf } = await import('/vr/test/page.js');
  const { densityOf, proxyOf } = await import('/vr/avatar/detail.js');
  const { cameraOfFile } = await import('/vr/draw/frame.js');
  const { HERE } = await import('/vr/draw/bones.js');
  const { splats, skeleton } = await load(name);
  const bones = skeleton?.bones(poseOf(pose)) ?? null;
  const proxy = proxyOf(splats);
  return cameras.map((camera) => densityOf(proxy, cameraOfFile(camera), bones, HERE));
}"""


def test_densities_of_views(bench: Bench) -> None:
    places = [
        ((0, 1, 3), (0, 1, 0)),
        ((0.4, 1.5, 0.5), (0, 1.4, 0)),
        ((0, 1.6, 0.02), (0.2, 0, 0.4)),
        ((0, 1, -9), (0, 1, 0)),
    ]
    cameras = [eyes(place, target)[0] for place, target in places]
    person = glsplat.default_avatar()
    pose = load_motion("walk", person.skeleton).at(0.3)
    expected = [Proxy.of(person).density(camera, bones=pose.bones(person.skeleton)) for camera in cameras]
    question = {"name": bench.offer("person", person), "pose": posed(pose), "cameras": [*map(camera_file, cameras)]}
    assert np.allclose(bench.js(ASK, question), expected, rtol=0.02)
    cloud = scenes.cloud(900, seed=3)
    expected = [Proxy.of(cloud).density(camera) for camera in cameras]
    question |= {"name": bench.offer("cloud", cloud), "pose": None}
    assert np.allclose(bench.js(ASK, question), expected, rtol=0.02)


def test_levels_for_densities(bench: Bench) -> None:
    rng = np.random.default_rng(2)
    cases = []
    for _ in range(200):
        densities = sorted(rng.uniform(50, 900, rng.integers(0, 5)), reverse=True)
        before = None if rng.random() < 0.3 else int(rng.integers(0, len(densities) + 1))
        near = rng.choice(densities) * rng.choice([0.94, 0.97, 1.0, 1.03, 1.06]) if densities else 300.0
        cases.append([densities, float(near), before])
    found = bench.js(
        "(cases) => import('/vr/avatar/detail.js')"
        ".then((m) => cases.map(([d, w, b]) => m.chosen(d, w, b ?? undefined)))",
        cases,
    )
    assert found == [chosen(*case) for case in cases]


def test_the_order_of_an_expression(bench: Bench) -> None:
    assert tuple(bench.js("import('/vr/draw/crowd.js').then((m) => m.ARKIT)")) == ARKIT


def test_a_mirror_is_the_picture_of_what_it_reflects(bench: Bench) -> None:
    """A camera before a mirror sees what the camera behind it would: frame.js takes the reflection in."""
    found = bench.js("""async () => {
      const { cameraOf } = await import('/vr/draw/frame.js');
      const { reflection, movePoint } = await import('/vr/space/matrix.js');
      const shown = reflection([0.3, 0, -1.2], [0.6, 0, 0.8]);
      const projection = [1, 0, 0, 0, 0, 1.5, 0, 0, 0.1, -0.2, -1, -1, 0, 0, -0.1, 0];
      const eye = { transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.1, 1.6, 0.2, 1], projection };
      const point = [0.2, 1.1, 0.4];
      const through = ({ rows }, [x, y, z]) =>
        [0, 4, 8].map((r) => rows[r] * x + rows[r + 1] * y + rows[r + 2] * z + rows[r + 3]);
      const still = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
      const [mirrored, plain] = [cameraOf(eye, 200, 100, shown), cameraOf(eye, 200, 100, still)];
      return { reflected: through(mirrored, point), there: through(plain, movePoint(shown, point)),
        eye: mirrored.eye, expected: movePoint(shown, [0.1, 1.6, 0.2]), intrinsics: plain.intrinsics };
    }""")
    assert np.allclose(found["reflected"], found["there"]) and np.allclose(found["eye"], found["expected"])
    # clip x = 1 * x + 0.1 * z with z = -1 ahead: the axis is at -0.1 of the half width; y likewise, rows from the top
    assert np.allclose(found["intrinsics"], [100, 75, 90, 40])
