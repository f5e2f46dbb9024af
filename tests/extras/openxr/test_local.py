"""A scene in a headset: the runtime's images against Renderer.render with the same cameras."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat.config import RenderConfig
from glsplat.errors import ContextError
from glsplat.extras.openxr.eyes import DepthRange, EyeImages, EyePass
from glsplat.extras.openxr.local import FAR, LocalShow
from glsplat.extras.openxr.placing import ViewName
from glsplat.extras.openxr.runtime import Fov
from glsplat.extras.openxr.session import Session
from glsplat.extras.openxr.swapchains import fitting
from glsplat.extras.openxr.wearer import Wearer
from glsplat.gl.context import Context, create_context
from glsplat.passes.target import Target
from glsplat.scene import Item, Scene
from glsplat.scenes.scene_file import SceneFile
from glsplat.splats import Splats
from glsplat.tracking.calibration import Calibration
from tests.extras.openxr.fake import DEPTH24, DEPTH32F, HEAD, RGBA8, RGBA16F, SRGB8, FakeRuntime
from tests.extras.openxr.test_samples import pinch

pytestmark = pytest.mark.gl

SIZE = (96, 80)


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    made = create_context()
    yield made
    with made:
        assert made.ctx.error == "GL_NO_ERROR"
    made.release()


@pytest.fixture(scope="module")
def person() -> glsplat.Avatar:
    return replace(glsplat.default_avatar().levels[-1].content, levels=())


class Worn:
    """A session that a fake headset runs; ``pair()`` is what lies in its images."""

    def __init__(
        self, context: Context, scene: Any, view: ViewName = "facing", runtime: FakeRuntime | None = None, **how: Any
    ) -> None:
        self.context = context
        self._plain: Any = None
        self.runtime = runtime or FakeRuntime(context, size=SIZE)
        file = scene if isinstance(scene, SceneFile) else SceneFile.of(scene)
        self.show = LocalShow(file, context, Wearer(view), **({"floor": False} | how))
        try:
            self.session = Session(lambda: self.runtime, self.show)  # type: ignore[arg-type, return-value]
        except BaseException:
            self.show.release()
            raise

    def __enter__(self) -> Worn:
        return self

    def __exit__(self, *_: object) -> None:
        self._release_plain()
        self.session.close()
        self.show.release()

    def frames(self, count: int = 3) -> None:
        for _ in range(count):
            assert self.session.step()

    def chains(self, deep: bool = False) -> list[Any]:
        known = (DEPTH32F, DEPTH24)
        return [chain for chain in self.runtime.swapchains if not chain.closed and (chain.format in known) is deep]

    def pair(self, deep: bool = False) -> np.ndarray:
        return np.concatenate([chain.read() for chain in self.chains(deep)])

    def rendered(self, **config: Any) -> Any:
        """The same by a renderer of its own, which reads back; of floats with their depth."""
        size = (self.show.cameras[0].width, self.show.cameras[0].height)
        if self._plain is None or self._plain[0] != (self.show.scene, config):
            self._release_plain()
            made = glsplat.Renderer(self.show.scene, size=size, config=RenderConfig(**config), context=self.context)
            self._plain = (self.show.scene, config), made
        return self._plain[1].render(self.show.cameras, depth=config.get("output") == "float32")

    def metres(self) -> np.ndarray:
        """The depth that the runtime is given, from OpenGL's perspective."""
        projection = self.runtime.shown[-1][0]
        assert projection is not None and projection.depth_range is not None
        near, far = projection.depth_range.near, projection.depth_range.far
        assert far == FAR
        return near * far / (far - self.pair(deep=True) * (far - near))

    def _release_plain(self) -> None:
        if self._plain is not None:
            self._plain[1].release()


VIEWPOINTS = [  # heads, fields of view: none of them even, none symmetric
    (HEAD, (Fov(-0.94, 0.70, 0.73, -0.96), Fov(-0.70, 0.94, 0.73, -0.96))),
    ((0.4, 1.5, -0.3, 0.05, 0.33, -0.04, 0.94), (Fov(-0.6, 0.9, 0.5, -0.8), Fov(-1.0, 0.3, 0.6, -0.7))),
]


@pytest.mark.parametrize(
    ("view", "arrays"), [("mirror", True), ("facing", True), ("facing", False), ("own", True)], ids=str
)
def test_images_are_what_render_gives_to_the_bit(
    context: Context, person: glsplat.Avatar, view: ViewName, arrays: bool
) -> None:
    runtime = FakeRuntime(context, size=SIZE, arrays=arrays)
    with Worn(context, person, view, runtime) as worn:
        worn.frames(1)
        for head, fovs in VIEWPOINTS:
            unit = np.array(head[3:]) / np.linalg.norm(head[3:])
            head = (*head[:3], *unit.tolist())
            if view == "own":  # looking down at oneself
                head = (*head[:3], -0.5, 0.0, 0.0, 0.8660254)
            eyes = ((head[0] - 0.031, head[1], head[2], *head[3:]), (head[0] + 0.034, head[1] + 0.01, *head[2:]))
            runtime.tracked = replace(runtime.tracked, head=head)
            runtime.eyes, runtime.fovs = eyes, fovs
            worn.show.recentred()
            worn.frames(3)
            pair, wanted = worn.pair(), worn.rendered()
            assert pair.shape == wanted.shape == (2, SIZE[1], SIZE[0], 4)
            if view == "mirror":  # beyond the glass there is its frame, and nothing
                inside = pair[..., 3] == 255
                picture = inside & ~np.all(pair[..., :3] == np.array([115, 92, 56]), axis=-1)
                assert 0.1 < picture.mean() < 0.9 and np.array_equal(pair[picture][:, :3], wanted[picture][:, :3])
            else:
                assert np.array_equal(pair, wanted)
            assert (wanted[..., 3] > 128).mean() > 0.01  # somebody is in it
            assert (worn.show.renderer.stats.splats < len(person.splats)) == (view == "own")  # without a head
            projection = runtime.shown[-1][0]
            assert projection is not None and [v.pose for v in projection.views] == list(eyes)
            assert [v.fov for v in projection.views] == list(fovs)
    assert len(worn.runtime.swapchains) == (2 if arrays else 4) and all(c.closed for c in worn.runtime.swapchains)


@pytest.mark.parametrize(
    ("known", "order", "scale"),
    [(DEPTH32F, "shared", 1.0), (DEPTH24, "shared", 1.25), (DEPTH32F, "per_view", 1.0)],  # one eye after the other
)
def test_depth_is_the_renderers_in_the_wearers_metres(
    context: Context, person: glsplat.Avatar, known: int, order: Any, scale: float
) -> None:
    runtime, size = FakeRuntime(context, size=SIZE, formats=(SRGB8, known)), Calibration(scale=scale, automatic=False)
    config = RenderConfig(order=order)
    with Worn(context, person, "facing", runtime, calibration=size, config=config) as worn:
        worn.frames()
        assert np.array_equal(worn.pair(), worn.rendered(order=order))
        metres, (picture, z) = worn.metres(), worn.rendered(order=order, output="float32")
        for eye in (0, 1):
            covered = picture[eye, ..., 3] > 0.5
            assert covered.sum() > 50 and np.allclose(metres[eye][covered], z[eye][covered], rtol=2e-3)
        assert 1.0 < np.median(metres[picture[..., 3] > 0.5]) < 2.5
        assert np.all(worn.pair(deep=True)[picture[..., 3] == 0] == 1)


def test_no_depth_costs_none(context: Context, person: glsplat.Avatar) -> None:
    for formats, how in (((SRGB8,), {}), ((SRGB8, DEPTH32F), {"depth": False})):
        runtime = FakeRuntime(context, size=SIZE, formats=formats)
        with Worn(context, person, "facing", runtime, **how) as worn:
            worn.frames()
            assert not worn.chains(deep=True) and worn.show._target is not None and worn.show._target.depth is None
            assert not runtime.shown[-1][0].depth  # type: ignore[union-attr]
            assert np.array_equal(worn.pair(), worn.rendered())


def test_images_that_hold_light_get_light(context: Context, person: glsplat.Avatar) -> None:
    """RGBA8 and half floats are taken for linear by runtimes: what is written is the picture's light."""
    for known in (RGBA8, RGBA16F):
        with Worn(context, person, "facing", FakeRuntime(context, size=SIZE, formats=(known,))) as worn:
            worn.frames()
            pair, wanted = worn.pair(), worn.rendered(output="float32")[0]
            light = np.clip(wanted[..., :3], 0, 1)
            light = np.where(light <= 0.04045, light / 12.92, ((light + 0.055) / 1.055) ** 2.4)
            assert np.abs(pair[..., :3] - 255 * light).max() <= 1.01 and pair[..., :3].max() > 30
    with pytest.raises(ContextError, match="no images of a colour format"):
        Worn(context, person, "facing", FakeRuntime(context, size=SIZE, formats=(0x805B, DEPTH32F)))


def test_a_floor_lies_below_and_the_avatar_stands_on_it(context: Context, person: glsplat.Avatar) -> None:
    with Worn(context, person, "facing", floor=True) as worn:
        worn.frames()
        pair, wanted = worn.pair().astype(int), worn.rendered().astype(int)
        solid = wanted[..., 3] == 255
        assert np.array_equal(pair[solid][:, :3], wanted[solid][:, :3])
        added = (pair - wanted)[..., :3].max(axis=-1)
        rows = np.nonzero(added.max(axis=(0, 2)) > 5)[0]
        horizon = SIZE[1] * np.tan(0.73) / (np.tan(0.73) + np.tan(0.96))
        assert len(rows) > 5 and rows.min() > horizon - 1 and added.min() >= 0


def test_passthrough_shows_by_alpha(context: Context, person: glsplat.Avatar) -> None:
    file = replace(SceneFile.of(person), background=(0.3, 0.2, 0.1))
    runtime = FakeRuntime(context, size=SIZE, blends=("alpha", "opaque"))
    with Worn(context, file, "facing", runtime, transparent=True, floor=True) as worn:
        worn.session.blend = "alpha"
        worn.frames()
        projection, blend = runtime.shown[-1]
        assert projection is not None and projection.transparent and blend == "alpha"
        pair = worn.pair()
        assert np.all(pair[pair[..., 3] == 0] == 0) and (pair[..., 3] > 200).any()  # premultiplied, no background
    with Worn(context, file, "facing") as worn:
        worn.frames()
        assert np.all(np.abs(worn.pair()[:, 0, 0, :3] - [76.5, 51, 25.5]) < 1)
        assert not worn.runtime.shown[-1][0].transparent  # type: ignore[union-attr]


def test_a_scene_around_its_wearer(context: Context, person: glsplat.Avatar, rng: np.random.Generator) -> None:
    """A room that stands still, and a person in it who is moved."""
    places = rng.normal(size=(300, 3)) * [1, 0.5, 1] + [0, 1, -2]
    room = Splats.create(
        places, [[1.0, 0, 0, 0]] * 300, np.full((300, 3), 0.05), np.ones(300), rgb=rng.random((300, 3))
    )
    items = [Item(room), Item(person)]
    with Worn(context, SceneFile(Scene(items)), "own") as worn:
        worn.frames()
        assert worn.show.solved and np.array_equal(worn.pair(), worn.rendered())
        before = items[1].pose
        worn.runtime.tracked = replace(worn.runtime.tracked, hands=(pinch(0.05), None))  # type: ignore[arg-type]
        worn.frames(5)
        assert items[1].pose is not before
    with Worn(context, room, "own") as still:  # nobody in it
        still.frames()
        assert not still.show.solved and np.array_equal(still.pair(), still.rendered())


def test_a_lost_head_and_eyes_that_see_nothing_leave_the_last_picture(context: Context, person: glsplat.Avatar) -> None:
    runtime = FakeRuntime(context, size=SIZE)
    good, eyes = runtime.fovs, runtime.eyes
    with Worn(context, person, runtime=runtime) as worn:
        for bad in (Fov(0, 0, 0, 0), Fov(nan, 1, 1, -1), Fov(-2, 2, 1, -1)):
            runtime.fovs = (bad, bad)
            worn.frames()
        runtime.fovs, runtime.eyes = good, ((0.0,) * 7,) * 2
        worn.frames()
        assert all(projection is None for projection, _ in runtime.shown)
        runtime.eyes = eyes
        worn.frames(1)
        last, acquired = runtime.shown[-1][0], runtime.log.count("acquire")
        runtime.eyes = None
        worn.frames(2)
        assert last is not None and runtime.shown[-1][0] is last and runtime.log.count("acquire") == acquired


def test_sizes() -> None:
    runtime: Any = FakeRuntime(size=(2000, 2200))
    found = [fitting(runtime, *how) for how in ((1.0, 16384), (0.5, 16384), (4.0, 16384), (1.0, 1100), (1e-9, 16384))]
    assert found == [(2000, 2200), (1000, 1100), (3723, 4096), (1000, 1100), (1, 1)]  # the shape is kept


@pytest.mark.parametrize("depth", [None, DepthRange(0.1, 10.0)])
def test_images_of_depth_need_a_picture_with_depth_and_its_range(context: Context, depth: DepthRange | None) -> None:
    """With one of the two it is refused before anything is drawn."""
    with context, ExitStack() as made:
        ctx = context.ctx
        colour, deep = [ctx.texture((8, 8), 4) for _ in "ab"], [ctx.depth_texture((8, 8)) for _ in "ab"]
        target = Target(ctx, 8, 8, 2, "f4", depth=depth is None)
        eyes = EyePass(context)
        for owner in (*colour, *deep, target, eyes):
            made.callback(owner.release)
        with pytest.raises(ContextError, match="images of depth need a picture with depth and the range"):
            eyes.run(target, EyeImages(*(tuple(texture.glo for texture in images) for images in (colour, deep))), depth)
