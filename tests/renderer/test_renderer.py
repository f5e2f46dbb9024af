"""The frame as a whole, against reference.py and against itself."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, sorting_camera
from glsplat.config import RenderConfig, with_fields
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.compare import Difference, assert_contract
from tests.scenes import camera, cloud, eyes, limb, one_splat

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]


def bent(avatar: Avatar, angle: float = 0.7) -> Pose:
    return Pose(np.full((len(avatar.skeleton), 3), (0.1, 0.2, angle)), np.array([-0.8, -0.3, 0.1]))


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("antialias", [False, True])
def test_static_pair_matches_the_reference(renderer_of: Make, degree: int, antialias: bool) -> None:
    scene, views = cloud(degree=degree), eyes()
    image = renderer_of(scene, views=2, antialias=antialias).render(views)
    assert_contract(image, reference.render(scene, views, config=RenderConfig(antialias=antialias)))


@pytest.mark.parametrize("influences", [1, 2, 4, 8])
@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("rotation", ["polar", "raw"])
def test_skinned_pair_matches_the_reference(renderer_of: Make, influences: int, degree: int, rotation: str) -> None:
    avatar = limb(influences=influences, degree=degree)
    views, pose = eyes(), bent(avatar)
    image = renderer_of(avatar, views=2, rotation=rotation).render(views, pose)
    expected = reference.render(
        avatar.splats, views, avatar.skin, pose.bones(avatar.skeleton), with_fields(RenderConfig(), rotation=rotation)
    )
    assert expected[..., 3].max() > 0.9
    assert_contract(image, expected)


@pytest.mark.parametrize("scene", ["static", "skinned"])
@pytest.mark.parametrize("degree", [0, 2])
def test_each_eye_of_a_pair_is_its_single_render(renderer_of: Make, scene: str, degree: int) -> None:
    model: Splats | Avatar = cloud(degree=degree) if scene == "static" else limb(degree=degree)
    pose = bent(model) if isinstance(model, Avatar) else None
    views = eyes()
    pair = renderer_of(model, views=2).render(views, pose)
    for eye in (0, 1):
        alone = renderer_of(model).in_order(sorting_camera(views), [views[eye]], pose)
        assert np.array_equal(alone[0], pair[eye])


def test_geometry_shader_routes_the_same_picture(renderer_of: Make) -> None:
    scene, views = cloud(), eyes()
    assert np.array_equal(
        renderer_of(scene, views=2, layers="geometry").render(views), renderer_of(scene, views=2).render(views)
    )


@pytest.mark.parametrize("shape", ["quad", "triangle"])
@pytest.mark.parametrize("sigma", [3.33, 2.0])
def test_shape_and_extent(renderer_of: Make, shape: str, sigma: float) -> None:
    """Quad and triangle draw the same splats, which end where the reference's do."""
    scene, views, config = cloud(), eyes(), RenderConfig(max_sigma=sigma)
    expected = reference.render(scene, views, config=config)
    for sorter in ("cpu", "gpu"):
        image = renderer_of(scene, views=2, shape=shape, max_sigma=sigma, sorter=sorter).render(views)
        assert_contract(image, expected)
    if sigma < 3:
        assert Difference.of(reference.render(scene, views), expected).psnr < 50  # the knob does something


@pytest.mark.parametrize("bits", [16, 32])
def test_both_sorters_draw_the_same_bytes(renderer_of: Make, context: Context, bits: int) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3: there is no GPU sorter to compare")
    scene, views = cloud(3000), eyes()
    cpu, gpu = (renderer_of(scene, views=2, sorter=s, sort_bits=bits) for s in ("cpu", "gpu"))
    for step in range(3):
        moved = tuple(replace(v, viewmat=v.viewmat @ look_at((0.2 * step, 0, 1), (0, 0, 0))) for v in views)
        assert np.array_equal(cpu.render(moved), gpu.render(moved))
        assert (cpu.stats.drawn, cpu.stats.culled) == (gpu.stats.drawn, gpu.stats.culled)


def test_unmoved_scene_is_not_sorted_again(renderer_of: Make) -> None:
    avatar = limb()
    renderer, views, pose = renderer_of(avatar, views=2), eyes(), bent(avatar)
    first = renderer.render(views, pose)
    assert renderer.stats.sorted
    assert np.array_equal(renderer.render(views, pose), first) and not renderer.stats.sorted
    renderer.render(views, bent(avatar, 0.1))
    assert renderer.stats.sorted
    again = renderer.render(views, pose)
    assert renderer.stats.sorted and np.array_equal(again, first)
    renderer.render(eyes(distance=2.5), pose)
    assert renderer.stats.sorted


@pytest.mark.parametrize("scene_degree", [1, 2, 3])
@pytest.mark.parametrize("camera_degree", [0, 1, 2, 3])
def test_a_camera_may_ask_for_a_lower_degree(renderer_of: Make, scene_degree: int, camera_degree: int) -> None:
    scene, view = cloud(degree=scene_degree), camera(sh_degree=camera_degree)
    assert_contract(renderer_of(scene).render([view]), reference.render(scene, [view]))


@pytest.mark.parametrize("layers", ["vertex", "geometry"])
@pytest.mark.parametrize("target", ["16f", "32f"])
def test_pair_and_singles_at_an_odd_size_in_8_bit(renderer_of: Make, layers: str, target: str) -> None:
    K = np.array([[83.7, 0, 51.3], [0, 77.1, 44.9], [0, 0, 1]])
    views = [replace(v, K=K, width=113, height=79, background=(0.1, 0.9, 0.35)) for v in eyes()]
    scene = cloud(200, 1, spread=0.2)
    config = {"layers": layers, "target": target, "output": "uint8"}
    pair = renderer_of(scene, (113, 79), 2, **config).render(views)
    for eye, view in enumerate(views):
        alone = renderer_of(scene, (113, 79), 1, **config).in_order(sorting_camera(views), [view])
        assert np.array_equal(alone[0], pair[eye])
    assert len(np.unique(pair[0, 0], axis=0)) == 1 and np.array_equal(pair[0, 0, 0], pair[0, -1, -1])  # no seam


def test_views_that_look_apart_get_an_order_each(renderer_of: Make) -> None:
    scene = cloud(400, spread=0.8)
    back = Camera(look_at((0, 0, -3), (0, 0, 0)), pinhole(64, 64), 64, 64)
    image = renderer_of(scene, views=2).render([camera(), back])
    assert_contract(image, np.concatenate([reference.render(scene, [v]) for v in (camera(), back)]))
    assert_contract(image, reference.render(scene, [camera(), back]))


def test_stats_of_several_passes(renderer_of: Make) -> None:
    scene = cloud(40, spread=0.1)
    left = Camera(look_at((-1.2, 0, 3), (-1.2, 0, 0)), pinhole(64, 64), 64, 64)
    right = Camera(look_at((1.2, 0, 3), (1.2, 0, 0)), pinhole(64, 64), 64, 64)
    renderer = renderer_of(scene, views=2, order="per_view", output="uint8")
    image = renderer.render([left, right])
    x, y, width, height = renderer.stats.covered
    box = np.zeros((64, 64), bool)
    box[y : y + height, x : x + width] = True
    assert image[..., 3].any() and not image[:, ~box, 3].any()
    assert renderer.stats.drawn + sum(renderer.stats.culled.values()) == 80
    assert all(type(v) is int for v in renderer.stats.covered)


def test_long_lists_of_views(renderer_of: Make) -> None:
    scene = cloud()
    views = [
        Camera(look_at((3 * np.sin(a), 0.3, 3 * np.cos(a)), (0, 0, 0)), pinhole(48, 48), 48, 48)
        for a in np.linspace(0, 5, 5)
    ]
    image = renderer_of(scene, (48, 48), 5).render(views)
    assert image.shape == (5, 48, 48, 4)
    for view, picture in zip(views, image, strict=True):
        assert_contract(picture[None], reference.render(scene, [view]))


def test_order_per_view(renderer_of: Make) -> None:
    scene, views = cloud(), eyes(ipd=1.5)
    config = with_fields(RenderConfig(), order="per_view")
    assert_contract(
        renderer_of(scene, views=2, order="per_view").render(views), reference.render(scene, views, config=config)
    )


def test_backgrounds(renderer_of: Make) -> None:
    views = [replace(v, background=c) for v, c in zip(eyes(), [(0.1, 0.2, 0.3), (0.9, 0.5, 0.0)], strict=True)]
    scene = cloud(50)
    image = renderer_of(scene, views=2).render(views)
    assert_contract(image, reference.render(scene, views))
    assert np.allclose(image[1, 0, 0], (0.9, 0.5, 0.0, 0.0), atol=3e-4)  # 16F has steps of 5e-4 there


def test_eight_bit_output_is_the_rounded_float(renderer_of: Make) -> None:
    scene, views = cloud(), eyes()
    exact = np.clip(renderer_of(scene, views=2).render(views), 0, 1) * 255
    byte = renderer_of(scene, views=2, output="uint8").render(views)
    assert byte.dtype == np.uint8
    assert np.abs(byte - exact).max() <= 0.51
    assert np.array_equal(byte, renderer_of(scene, views=2, output="uint8", layers="geometry").render(views))


@pytest.mark.parametrize("place", [(-0.9, 0.8), (0.0, 0.0), (1.3, -1.2), (40.0, 0.0)])
def test_only_the_covered_box_is_touched(renderer_of: Make, place: tuple[float, float]) -> None:
    """Moving the splats over stale pixels of the frame before changes nothing."""
    scene = cloud(40, spread=0.15)
    views = [replace(v, background=(0.2, 0.4, 0.6)) for v in eyes()]
    moved = replace(scene, means=scene.means + np.float32([*place, 0]))
    renderer = renderer_of(cloud(300), views=2, output="uint8")
    renderer.render(views)  # fills the target
    renderer.load(moved)
    image = renderer.render(views)
    exact = np.clip(renderer_of(moved, views=2).render(views), 0, 1) * 255
    assert np.abs(image - exact).max() <= 0.51
    x, y, width, height = renderer.stats.covered
    assert width < 64 and height < 64
    outside = np.ones((64, 64), bool)
    outside[y : y + height, x : x + width] = False
    assert not exact[:, outside, 3].any()


@pytest.mark.parametrize(("target", "floor"), [("16f", 50), ("8", 40)])
def test_cheaper_targets(renderer_of: Make, target: str, floor: float) -> None:
    scene, views = cloud(), eyes()
    exact = reference.render(scene, views)
    psnr = Difference.of(renderer_of(scene, views=2, target=target).render(views), np.clip(exact, 0, None)).psnr
    assert floor <= psnr < 75


def test_orientation(renderer_of: Make) -> None:
    """x to the right, y up in the world = towards row 0, and a thin ellipse deposits the same alpha at any angle."""
    image = renderer_of(one_splat(means=[[0.4, 0.6, 0.0]])).render([camera()])[0]
    row, column = np.unravel_index(image[..., 3].argmax(), (64, 64))
    assert column > 34 and row < 30
    sums = []
    for angle in (0.0, 0.4, np.pi / 4, 1.2):
        thin = one_splat(scales=[[0.5, 0.05, 0.05]], quats=[[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]])
        sums.append(renderer_of(thin).render([camera()])[0, ..., 3].sum())
    assert np.ptp(sums) < 0.01 * sums[0]


def test_a_splat_outside_one_eye_only_is_drawn_in_the_other(renderer_of: Make) -> None:
    scene, views = one_splat(means=[[-2.0, 0, 0]], scales=[[0.02] * 3]), eyes(ipd=0.4)
    image = renderer_of(scene, views=2).render(views)
    assert image[0].any() and not image[1].any()
    assert_contract(image, reference.render(scene, views))


def test_equal_depths_keep_the_file_order(renderer_of: Make) -> None:
    colours = np.random.default_rng(1).random((300, 3))
    scene = Splats.create(
        np.zeros((300, 3)), np.tile([1.0, 0, 0, 0], (300, 1)), np.full((300, 3), 0.2), np.full(300, 0.3), rgb=colours
    )
    image = renderer_of(scene).render([camera()])
    assert_contract(image, reference.render(scene, [camera()]))


def test_far_from_the_origin(renderer_of: Make) -> None:
    offset = np.array([1e5, -2e5, 5e4])
    scene = cloud()
    far = replace(scene, means=(scene.means + offset).astype(np.float32))
    view = Camera(look_at(offset + (0, 0, 3), offset), pinhole(64, 64), 64, 64)
    assert_contract(renderer_of(far).render([view]), reference.render(far, [view]))


def test_avatar_far_from_the_origin(renderer_of: Make) -> None:
    avatar = limb()
    offset = np.array([1e5, 0.0, -3e4])
    near, pose = renderer_of(avatar), bent(avatar)
    far_pose = replace(pose, trans=pose.trans + offset)
    view = camera()
    far_view = replace(view, viewmat=view.viewmat @ np.block([[np.eye(3), -offset[:, None]], [0, 0, 0, 1]]))
    d = Difference.of(renderer_of(avatar).render([far_view], far_pose), near.render([view], pose))
    assert d.psnr > 65


@pytest.mark.parametrize("count", [0, 1])
def test_tiny_scenes_and_targets(renderer_of: Make, count: int) -> None:
    scene = one_splat().take(np.arange(count))
    for sorter in ("cpu", "gpu"):
        renderer = renderer_of(scene, (1, 1), sorter=sorter)
        image = renderer.render([camera(1)])
        assert image.shape == (1, 1, 1, 4) and bool(image.any()) == bool(count)
    avatar = limb(count=8)
    empty = Avatar(
        avatar.splats.take([]),
        avatar.skeleton,
        replace(avatar.skin, joints=avatar.skin.joints[:0], weights=avatar.skin.weights[:0]),
    )
    assert not renderer_of(empty).render([camera()]).any()


def test_clear_errors(renderer_of: Make, context: Context) -> None:
    renderer = renderer_of(limb())
    with pytest.raises(GlsplatError, match="at least one camera"):
        renderer.render([])
    with pytest.raises(GlsplatError, match="size 64x64"):
        renderer.render([camera(32)])
    with pytest.raises(PoseError, match="2 joints, the avatar 4"):
        renderer.render([camera()], Pose.zero(2))
    with pytest.raises(ContextError, match="size needs 1 to"):
        renderer.resize(context.max_size + 1, 4)
    with pytest.raises(GlsplatError, match="viewmat needs 4x4 finite numbers"):
        renderer.in_order(np.full((4, 4), np.nan), [camera()])
    with pytest.raises(GlsplatError, match="views needs at least 1"):
        Renderer(limb(), views=0, context=context)
    with pytest.raises(GlsplatError, match="an item shows Splats, an Avatar or a RiggedMesh, not NoneType"):
        Renderer(None, size=(8, 8), context=context)  # type: ignore[arg-type]
    released = Renderer(limb(), size=(8, 8), context=context)
    released.release()
    for call in (lambda: released.render([camera(8)]), lambda: released.load(limb())):
        with pytest.raises(GlsplatError, match="was released"):
            call()
    with pytest.raises(GlsplatError, match="target needs one of"):
        RenderConfig(target="12f")  # type: ignore[arg-type]


def test_a_pass_that_cannot_be_made_leaves_nothing(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    from glsplat.renderer import pipeline

    def fail(*_: object) -> None:
        raise ContextError("no more")

    monkeypatch.setattr(pipeline, "DrawPass", fail)
    with context.ctx:
        context.ctx.gc_mode = "context_gc"
        try:
            with (
                Renderer(limb(), size=(8, 8), context=context) as renderer,
                pytest.raises(ContextError, match="no more"),
            ):
                renderer.render([camera(8)])
            del renderer
            gc.collect()
            assert not [o for o in context.ctx.objects if not isinstance(o, moderngl.InvalidObject)]
        finally:
            context.ctx.gc_mode = None


@pytest.mark.check
def test_nothing_is_left_behind(context: Context) -> None:
    """Render, resize, load another scene and release, 50 times: no GL object stays, memory does not grow."""
    import psutil

    scenes: list[Splats | Avatar] = [cloud(2000, 1), limb(1000), cloud(10)]
    with context.ctx:
        context.ctx.gc_mode = "context_gc"
        process, resident = psutil.Process(), []
        try:
            for round_ in range(50):
                with Renderer(scenes[round_ % 3], size=(64, 64), views=2, context=context) as renderer:
                    renderer.render(eyes())
                    renderer.resize(32 + round_, 48)
                    views = [replace(v, width=32 + round_, height=48) for v in eyes()]
                    renderer.render(views)
                    renderer.load(scenes[(round_ + 1) % 3])
                    renderer.render(views)
                resident.append(process.memory_info().rss)
            gc.collect()
            left = [o for o in context.ctx.objects if not isinstance(o, moderngl.InvalidObject)]
            assert not left
            assert resident[-1] < resident[20] * 1.05
        finally:
            context.ctx.gc_mode = None
