"""Splats left out because no eye is inside their visibility cone: the decision, the lift, the cones themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.finish.cones import ConeConfig, hidden, with_cones
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.present import Layout, Present
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.compare import Difference
from tests.scenes import camera, cloud, eyes, limb

Make = Callable[..., Renderer]
F64 = NDArray[np.float64]

WIDER = (0.03, 0.06, 0.15, 0.35, 0.9)
QUICK = ConeConfig(directions=32, size=40, psnr=40, choosing=3, tests=3, rounds=2, test_size=44, wider=WIDER)


def coned(splats: Splats, seed: int = 5) -> Splats:
    """The splats with cones of any direction and width."""
    return replace(splats, cones=np.random.default_rng(seed).integers(-128, 128, (len(splats), 4)).astype(np.int8))


def ball(count: int = 1000) -> Splats:
    """An opaque ball of discs, and a few splats inside it that nothing shows."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    normal = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    half = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)], axis=1)  # turns z to the normal
    inside = 0.3 * normal[::20]
    quats = np.concatenate([half, np.tile([1.0, 0, 0, 0], (len(inside), 1))])
    means = np.concatenate([0.5 * normal, inside])
    disc = 0.03 * np.sqrt(4000 / count)  # close the surface
    colours = 0.5 + 0.4 * np.concatenate([normal, -inside])
    return Splats.create(
        means, quats, np.tile([disc, disc, 0.001], (len(means), 1)), np.full(len(means), 0.97), rgb=colours
    )


@pytest.mark.gl
@pytest.mark.parametrize("skinned", [False, True])
@pytest.mark.parametrize("margin", [0.0, -0.3, 0.4])
def test_what_is_left_out_is_what_the_cones_say(renderer_of: Make, skinned: bool, margin: float) -> None:
    views = eyes()
    scene: Splats | Avatar = coned(cloud(2000))
    pose, posed = None, coned(cloud(2000))
    if skinned:
        avatar = limb(2000)
        avatar = replace(avatar, splats=coned(avatar.splats))
        pose = Pose(np.full((len(avatar.skeleton), 3), (0.1, 0.2, 0.7)), np.array([-0.8, -0.3, 0.1]))
        scene, posed = avatar, posed_splats(avatar, pose)
    gone = hidden(posed, [view.position for view in views], margin)
    assert 0.1 < gone.mean() < 0.9
    culled = renderer_of(scene, views=2, cull_hidden=True, cull_margin=margin)
    kept = renderer_of(posed.take(~gone), views=2)
    pictures = culled.render(views, pose)
    expected = np.stack([reference.lifted(p, v.background) for p, v in zip(kept.render(views), views, strict=True)])
    assert Difference.of(pictures, expected).psnr > (100 if skinned else 130)
    assert culled.stats.culled["hidden"] == gone.sum()
    assert culled.stats.drawn + sum(culled.stats.culled.values()) == len(posed)


@pytest.mark.gl
def test_eight_bit_pictures_are_lifted_alike(renderer_of: Make) -> None:
    scene = coned(cloud(800))
    left, right = eyes(size=50)
    views = (replace(left, background=(0.9, 0.1, 0.5)), replace(right, background=(0.0, 0.6, 0.2)))
    exact = renderer_of(scene, size=(50, 50), views=2, cull_hidden=True).render(views)
    rounded = renderer_of(scene, size=(50, 50), views=2, cull_hidden=True, output="uint8").render(views)
    assert np.abs(rounded - np.rint(255 * np.clip(exact, 0, 1))).max() <= 1


def test_lift_keeps_background_opaque_pixels_and_infinite_colours() -> None:
    background = (0.25, 0.5, 0.75)
    nothing, solid = np.array([[[*background, 0.0]]]), np.array([[[0.1, 0.2, 0.3, 1.0]]])
    assert np.allclose(reference.lifted(nothing, background), nothing)
    assert np.allclose(reference.lifted(solid, background), solid)
    thin = np.array([[[0.6 * 0.9 + 0.4 * b for b in background] + [0.6]]])  # colour 0.9 at alpha 0.6
    alpha = 1 - 0.4 * (1 - 0.6**3)
    assert np.allclose(
        reference.lifted(thin, background), [[[alpha * 0.9 + (1 - alpha) * b for b in background] + [alpha]]]
    )

    pixel = np.array([[[np.inf, 0.5, 0.5, 1.0]]], np.float32)  # a colour beyond 65504 on a target of half floats
    assert np.array_equal(reference.lifted(pixel, (0.1, 0.2, 0.3)), pixel)


@pytest.mark.gl
@pytest.mark.parametrize("thickness", [0.0, 1e-38, 1e-25, 1e-20, 1e-16])
def test_splats_without_thickness_are_never_hidden(renderer_of: Make, thickness: float) -> None:
    scene = coned(cloud(500))
    scales = scene.scales.copy()
    scales[::2, 1] = thickness
    scene = replace(scene, scales=scales)
    gone = hidden(scene, [camera(64).position])
    assert not gone[::2].any() and gone[1::2].any()
    renderer = renderer_of(scene, cull_hidden=True)
    renderer.render([camera(64)])
    assert renderer.stats.culled["hidden"] == gone.sum()


@pytest.mark.gl
def test_the_lowest_byte_is_minus_one_as_gltf_says(renderer_of: Make) -> None:
    one = Splats.create([[0.0, 0, 0]], [[1.0, 0, 0, 0]], [[0.1, 0.1, 0.01]], [0.9], rgb=[[1.0, 1, 1]])
    one = replace(one, cones=np.array([[0, 0, -127, -128]], np.int8))  # all but what the margin takes off
    assert hidden(one, [camera(64).position], 0.005)[0]
    renderer = renderer_of(one, cull_hidden=True, cull_margin=0.005)
    renderer.render([camera(64)])
    assert renderer.stats.culled["hidden"] == 1


@pytest.fixture(scope="module")
def coned_ball() -> Splats:
    """With a splat, the fourth, that cannot be drawn."""
    scene = ball()
    means = scene.means.copy()
    means[3] = np.nan
    return with_cones(replace(scene, means=means), QUICK)


@pytest.mark.gl
def test_half_a_ball_is_hidden_and_the_picture_stays(renderer_of: Make, coned_ball: Splats) -> None:
    splats = coned_ball
    whole, culled = renderer_of(splats), renderer_of(splats, cull_hidden=True)
    for angle in (0.3, 2.9):
        view = replace(camera(64), viewmat=look_at((3 * np.sin(angle), 0.7, 3 * np.cos(angle)), (0, 0, 0)))
        expected = whole.render([view])
        # from 32 directions, the ball fills a fifth of the picture
        assert Difference.of(culled.render([view]), expected).psnr > 36
        assert 0.38 < culled.stats.culled["hidden"] / len(splats) < 0.6
    inside = splats.take(np.arange(len(splats)) >= 1000)
    assert hidden(inside, [np.array([0, 0, 3.0])]).mean() > 0.8
    turned = Splats.create(
        splats.means, splats.quats * -1, splats.scales, splats.opacities, splats.sh, cones=splats.cones
    )  # -q is the same rotation
    assert np.array_equal(hidden(turned, [np.array([0, 0, 3.0])]), hidden(splats, [np.array([0, 0, 3.0])]))


def missing_at_worst(scene: Splats | Avatar, renderer_of: Make, views: int = 12) -> float:
    """dB of the worst picture without what the cones hide, drawn by the renderer, from directions of its own."""
    pictures = [renderer_of(scene, size=(44, 44), cull_hidden=culled) for culled in (True, False)]
    found = []
    for way in np.random.default_rng(11).normal(size=(views, 3)):
        eye = 2.2 * way / np.linalg.norm(way)
        view = Camera(look_at(eye, (0, 0, 0)), pinhole(44, 44, 28.0), 44, 44)  # a ball of 0.5 m fills it
        less, all_of_it = (np.array(one.render([view])[0, ..., :3], np.float64) for one in pictures)
        found.append(float(-10 * np.log10(((less - all_of_it) ** 2).mean())))
    return min(found)


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.parametrize("antialias", [False, True])
def test_what_cones_keep_is_what_the_renderer_keeps(renderer_of: Make, antialias: bool) -> None:
    splats = with_cones(replace(ball(), antialias=antialias), replace(QUICK, directions=128, tests=8))
    assert splats.cones_psnr is not None and splats.cones_psnr > 37
    assert hidden(splats, [np.array([0.0, 0, 3])]).mean() > 0.2
    assert missing_at_worst(splats, renderer_of) > splats.cones_psnr - 3  # the worst of other pictures


def test_splats_that_cannot_be_drawn_have_no_cone(coned_ball: Splats) -> None:
    broken = coned_ball
    assert broken.cones is not None and broken.cones[3].tolist() == [0, 0, 0, -127]
    assert np.isfinite(broken.cones).all() and not hidden(broken, [np.array([0, 0, 3.0])])[3]
    with pytest.raises(GlsplatError, match="at least one finite splat"):
        with_cones(broken.take([3]), QUICK)


@pytest.mark.gl
def test_antialias_follows_the_splats(renderer_of: Make) -> None:
    scene, views = cloud(300), (camera(64, distance=9.0),)
    meant = replace(scene, antialias=True)
    plain, soft = (renderer_of(scene, antialias=a).render(views) for a in (False, True))
    assert np.array_equal(renderer_of(meant).render(views), soft)
    assert np.array_equal(renderer_of(meant, antialias=False).render(views), plain)
    assert np.array_equal(renderer_of(scene).render(views), plain) and not np.array_equal(plain, soft)
    assert Difference.of(renderer_of(meant).render(views), reference.render(meant, views)).psnr > 90


def test_a_camera_inside_the_cone_sees_the_splat() -> None:
    one = Splats.create([[0.0, 0, 0]], [[1.0, 0, 0, 0]], [[0.1, 0.1, 0.01]], [0.9], rgb=[[1.0, 1, 1]])
    one = replace(one, cones=np.array([[0, 0, 127, 90]], np.int8))  # within 45 degrees of its z axis
    assert not hidden(one, [np.array([0.5, 0, 1.0])])[0]
    assert hidden(one, [np.array([1.5, 0, 1.0])])[0] and hidden(one, [np.array([0, 0, -1.0])])[0]
    assert not hidden(one, [np.array([1.5, 0, 1.0]), np.array([0, 0, 2.0])])[0]  # one eye is enough
    upside_down = replace(one, quats=np.array([[0.0, 1, 0, 0]], np.float32))
    assert hidden(upside_down, [np.array([0.5, 0, 1.0])])[0] and not hidden(upside_down, [np.array([0, 0, -1.0])])[0]


@pytest.mark.gl
@pytest.mark.parametrize("layout", ["mono", "side-by-side", "anaglyph"])
def test_a_window_shows_lifted_pictures_too(renderer_of: Make, context: Context, layout: Layout) -> None:
    """What hidden splats shone through is put back there as it is in render()."""
    scene, size = coned(cloud(800)), (50, 50)
    behind = ((0.1, 0.3, 0.2), (0.9, 0.0, 0.6))
    views = [replace(view, background=colour) for view, colour in zip(eyes(size=50), behind, strict=True)]
    views = views[: 1 if layout == "mono" else 2]
    window = (100, 50) if layout == "side-by-side" else size
    rounded = renderer_of(scene, size=size, views=2, cull_hidden=True, output="uint8").render(views)
    renderer = renderer_of(scene, size=size, views=2, cull_hidden=True)
    with context.entered("test"):
        framebuffer = context.ctx.framebuffer([context.ctx.texture(window, 4)])
    present = Present(context)
    try:
        present.run(renderer.draw(views), framebuffer, window, layout)
        shown = np.frombuffer(framebuffer.read(components=3), np.uint8).reshape(window[1], window[0], 3)[::-1]
    finally:
        present.release()
    wanted = {
        "mono": lambda: rounded[0, ..., :3],
        "side-by-side": lambda: np.hstack([picture[..., :3] for picture in rounded]),
        "anaglyph": lambda: np.dstack([rounded[0, ..., :1], rounded[1, ..., 1:3]]),
    }[layout]()
    assert np.abs(shown.astype(int) - wanted).max() <= 1  # half a level either way
    assert renderer_of(scene, size=size, views=2).draw(views).lift is None


@pytest.mark.gl
def test_no_cones_is_one_clear_line(renderer_of: Make) -> None:
    with pytest.raises(GlsplatError, match="cull_hidden needs splats with visibility cones"):
        renderer_of(cloud(10), cull_hidden=True)
    with pytest.raises(GlsplatError, match="no visibility cones"):
        hidden(cloud(10), [np.zeros(3)])
    with pytest.raises(FormatError, match="cones needs int8"):
        replace(cloud(10), cones=np.zeros((9, 4), np.int8))
