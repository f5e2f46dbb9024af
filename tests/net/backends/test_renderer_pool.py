"""What a server draws of what it offers: avatars by name, with and without parts, and where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, head_matrix, look_at, pinhole, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError, PoseError, ProtocolError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import Rendered, RenderJob, Solved
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backends.renderer_pool import MAX_RENDERERS
from glsplat.net.backends.scene_renderer import SceneRenderer
from glsplat.net.client import Client
from glsplat.net.messages import PictureOptions
from glsplat.net.served_scene import TrackingOptions, gl_server
from glsplat.net.server import ServerConfig
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, SceneLike, similarity
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import Calibration
from tests.compare import Difference
from tests.net.legacy.test_legacy import thinned
from tests.net.running import opened, running
from tests.scenes import limb
from tests.skinning.faces import expressive

SIZE = (96, 80)
PAIR = stereo_cameras(head_matrix((0.1, 1.2, 2.2), (0, 0, 0, 1)), size=SIZE)
CLOSE = (Camera(look_at((0.3, 1.6, 0.9), (0, 1.45, 0)), pinhole(*SIZE, fov=50), *SIZE),)
BENT = Pose.from_smplx({"body_pose": np.full((21, 3), 0.15), "trans": [0.2, 0, 0]})
PERSON = thinned(default_avatar(), 40)
BIG = replace(PERSON, splats=replace(PERSON.splats, sh=PERSON.splats.sh * -1))  # the same person in other colours
HEADS = ({}, {"hide": ("head",)})


def request(cameras=PAIR, **more) -> RenderJob:
    options = PictureOptions(**{key: more.pop(key) for key in ("hide", "box") if key in more})
    return RenderJob(frame_id=1, cameras=tuple(cameras), options=options, **more)


def direct(avatar: SceneLike, cameras=PAIR, pose: Pose | None = None) -> np.ndarray:
    with Renderer(avatar, size=SIZE, views=len(cameras), config=RenderConfig(output="uint8")) as renderer:
        return renderer.render(cameras, pose)


@pytest.fixture
def backend():
    backend = RendererBackend(PERSON, SIZE, avatars={"big": BIG, "rod": limb(200)})
    backend.open()
    yield backend
    backend.close()


@pytest.mark.gl
def test_each_is_drawn_as_if_it_were_alone(backend) -> None:
    for _ in range(2):
        for name, avatar in (("", PERSON), ("big", BIG), ("what nobody knows", PERSON), ("rod", limb(200))):
            pose = BENT if len(avatar.skeleton) == 55 else None
            assert (backend.render(request(avatar=name, pose=pose)).images == direct(avatar, pose=pose)).all()
            hidden = backend.render(request(avatar="big", hide=("head",))).images
            assert len(backend._pool) <= MAX_RENDERERS
    assert (hidden == direct(BIG.without("head"))).all() and (hidden != direct(BIG)).any()


@pytest.mark.gl
@pytest.mark.parametrize("pose", [None, BENT], ids=["rest", "bent"])
def test_a_hidden_head_is_that_of_an_avatar_without_it(pose) -> None:
    """Against the float64 contract, seen from close by."""
    bare = PERSON.without("head")
    bones = (pose or Pose.zero()).bones(bare.skeleton)
    expected = reference.render(bare.splats, CLOSE, bare.skin, bones)
    whole = reference.render(PERSON.splats, CLOSE, PERSON.skin, bones)
    with opened(RendererBackend(PERSON, SIZE, config=RenderConfig(output="float32", target="32f"))) as backend:
        found = backend.render(request(CLOSE, pose=pose, hide=("head",))).images
        again = backend.render(request(CLOSE, pose=pose)).images
    assert Difference.of(found, expected).psnr >= 65 and Difference.of(again, whole).psnr >= 65
    assert Difference.of(whole, expected).psnr < 35  # there was a head


@pytest.mark.gl
def test_a_head_is_hidden_in_a_scene_of_several_things_that_move() -> None:
    person = Item(PERSON, transform=similarity((0.3, 0, 0.2), scale=1.1))
    rod = Item(limb(200).splats, transform=similarity((-0.5, 1, 0)))
    scene = Scene([rod, person])
    with opened(RendererBackend(scene, SIZE)) as backend:
        for transform, pose in ((person.transform, None), (similarity((-0.2, 0.1, 0)), BENT)):
            person.transform, person.pose = transform, pose
            found = backend.render(request(hide=("head",))).images
            bare = Item(PERSON.without("head"), transform=transform, pose=pose)
            with Renderer(Scene([rod, bare]), size=SIZE, views=2, config=RenderConfig(output="uint8")) as renderer:
                assert (found == renderer.render(PAIR)).all()


@pytest.mark.gl
@pytest.mark.parametrize("scene", [limb(50).splats, Scene([Item(PERSON), Item(PERSON)]), limb(50)])
def test_what_has_no_head_cannot_hide_it(scene) -> None:
    (one,) = gl_server(scene, ServerConfig(port=0), own_process=False).session()["avatars"]
    assert not one["head"]
    with opened(RendererBackend(scene, SIZE)) as backend:
        with pytest.raises(GlsplatError, match=r"scene has none or several|no joint"):
            backend.render(request(hide=("head",)))
        assert backend.render(request()).images.any()  # nothing is wrong with the context
        assert ("box" in backend.render(request(box=True)).places) == isinstance(scene, Avatar)


def top(avatar: Avatar) -> float:
    """Height of the highest point of the splats' ellipsoids of two standard deviations, in the zero pose."""
    still = reference.rest(avatar.splats)
    return float((still.means[:, 1] + 2 * np.linalg.norm(still.shapes[:, 1], axis=1)).max())


@pytest.mark.gl
def test_where_the_avatar_is() -> None:
    """The box of the splats as posed and placed."""
    transform = similarity((0.5, 0.2, -1), rotation=(0, 0.7071, 0, 0.7071), scale=1.2)
    backend = RendererBackend(Scene([Item(PERSON, transform=transform)]), SIZE)
    backend.open()

    def rendered(**more) -> Rendered:
        return backend.render(request(**more))

    try:
        assert not rendered().places
        for pose in (None, BENT):
            bones, names = (pose or Pose.zero()).bones(PERSON.skeleton), PERSON.skeleton.names
            stands = [names.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot")]
            at = [bones[j, :3, :3] @ PERSON.skeleton.joints[j] + bones[j, :3, 3] for j in stands]
            feet = np.reshape(rendered(pose=pose, box=True).places["feet"], (4, 3))
            assert np.abs(feet - (np.array(at) @ transform[:3, :3].T + transform[:3, 3])).max() < 1e-5
            posed = reference.skin(PERSON.splats, PERSON.skin, (pose or Pose.zero()).bones(PERSON.skeleton))
            means = posed.means @ transform[:3, :3].T + transform[:3, 3]
            box = np.reshape(rendered(pose=pose, box=True).places["box"], (2, 3))
            assert ((means >= box[0]) & (means <= box[1])).all(axis=1).mean() >= 0.995
            reach = 2 * np.linalg.norm(transform[:3, :3] @ posed.shapes, axis=2)
            spans = (means + reach).max(axis=0) - (means - reach).min(axis=0)
            assert (np.ptp(box, axis=0) < 1.25 * spans + 0.1).all()
            bare = np.reshape(rendered(pose=pose, box=True, hide=("head",)).places["box"], (2, 3))
            assert (bare[0] >= box[0]).all() and (bare[1] <= box[1]).all()  # of what is shown
            if pose is None:  # exact where nothing bends: two standard deviations beyond what is shown
                tops = [top(content) * 1.2 + 0.2 for content in (PERSON, PERSON.without("head"))]
                assert [box[1, 1], bare[1, 1]] == pytest.approx(tops, abs=1e-4) and bare[1, 1] < box[1, 1] - 0.05
    finally:
        backend.close()


@pytest.mark.gl
@pytest.mark.parametrize(("scale", "floor"), [(0.8, 0.0), (1.25, -1.2), (0.01, 0.3), (50.0, -20.0)])
def test_a_placed_scene_is_what_moved_eyes_see(scale: float, floor: float) -> None:
    """Seen by eyes that are scaled alike: the same picture; places and depths are in the user's metres."""
    scene = Scene([Item(limb(200).splats, transform=similarity((-0.5, 1, 0))), Item(PERSON)])
    solved = Solved(BENT, scale=scale, floor=floor)
    to_user = similarity((0, floor, 0), scale=scale)
    eyes = []
    for camera in PAIR:
        viewmat = camera.viewmat @ np.linalg.inv(to_user)
        viewmat[:3] *= scale
        eyes.append(replace(camera, viewmat=viewmat, near=camera.near * scale, far=camera.far * scale))
    asked = PictureOptions(box=True, depth=True)
    with opened(RendererBackend(scene, SIZE)) as backend:
        own = backend.render(RenderJob(cameras=tuple(PAIR), pose=BENT, options=asked))
        expected = own.images.copy()
        placed = backend.render(RenderJob(cameras=tuple(eyes), pose=BENT, to_user=solved.to_user, options=asked))
        assert Difference.of(placed.images / 255, expected / 255).psnr >= 55
    for eye, camera in zip(eyes, PAIR, strict=True):
        np.testing.assert_allclose(solved.seen(eye).viewmat, camera.viewmat, atol=1e-9)
    for name, place in own.places.items():
        moved = np.reshape(place, (-1, 3)) * scale + (0, floor, 0)
        np.testing.assert_allclose(np.reshape(placed.places[name], (-1, 3)), moved, rtol=1e-6, atol=1e-6 * scale)
    for mine, theirs in zip(placed.depth, own.depth, strict=True):
        np.testing.assert_allclose(mine.metres(), theirs.metres() * scale, rtol=0.02)


@pytest.mark.gl
def test_a_scene_keeps_its_own_place_and_a_new_scale_skins_nothing_again() -> None:
    own = similarity((0.2, 0, 0.1), rotation=(0, 0.3, 0, 0.95), scale=1.2)
    scene = Scene([Item(limb(200).splats), Item(PERSON)], transform=own)
    with opened(RendererBackend(scene, SIZE)) as backend:
        found = backend.render(request(pose=BENT)).images
        with Renderer(scene, size=SIZE, views=2, config=RenderConfig(output="uint8")) as renderer:
            assert (found == renderer.render(PAIR, BENT)).all()
        for scale in (0.9, 0.91, 0.92):
            placed = backend.render(request(pose=BENT, to_user=similarity(scale=scale)))
            assert placed.posed == 0
        assert (placed.images != found).any()


@pytest.mark.gl
def test_the_layers_of_a_scenes_own_items_are_the_cameras_alone() -> None:
    """Whether a head is hidden or not; people are above all of them."""
    marks = [Item(limb(200).splats, transform=similarity((0.3 * i - 0.3, 1, 0)), layers=1 << i) for i in range(3)]
    scene = Scene([*marks, Item(PERSON)])
    with opened(RendererBackend(scene, SIZE)) as backend:
        for layers in (1, 2, 4, 6):
            cameras = [replace(camera, layers=layers) for camera in PAIR]
            for hide in ((), ("head",)):
                found = backend.render(request(cameras, hide=hide)).images
                person = PERSON.without("head") if hide else PERSON
                with Renderer(Scene([*marks, Item(person, layers=-1)]), size=SIZE, views=2) as renderer:
                    assert Difference.of(found / 255, renderer.render(cameras) / 255).psnr >= 60


def test_a_hidden_head_without_an_avatar_is_refused_before_anything_is_drawn() -> None:
    with pytest.raises(PoseError, match="this scene has none or several"):
        SceneRenderer(SceneFile.of(limb(50).splats), lambda scene: None).follow(request(hide=("head",)), 0.0)  # type: ignore[arg-type, return-value]


@pytest.mark.gl
def test_the_box_holds_what_a_face_moves() -> None:
    avatar, boxes, images = expressive(400), [], []
    with opened(RendererBackend(avatar, SIZE)) as backend:
        for face in ({}, {"jawOpen": 1.0}, {"jawOpen": 1.0, "eyeBlinkLeft": 1.0}):
            pose = Pose(np.zeros((4, 3)), expression=face)
            out = backend.render(request(pose=pose, box=True))
            boxes.append(np.reshape(out.places["box"], (2, 3)))
            images.append(np.array(out.images))
            bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
            means = reference.skin(avatar.splats, avatar.skin, bones, "polar", avatar.shapes, weights).means
            assert ((means >= boxes[-1][0]) & (means <= boxes[-1][1])).all()
    assert (np.diff([np.ptp(box, axis=0) for box in boxes], axis=0) > 0.05).all()
    assert (images[0] != images[1]).any() and (images[1] != images[2]).any()


async def test_a_reply_has_the_box_in_the_room_of_its_client() -> None:
    """Also where the user is smaller than the avatar and stands on another floor; the mirror changes nothing."""
    tracking = TrackingOptions(calibration=Calibration(scale=0.8, floor=-0.25))
    async with running(gl_server(PERSON, ServerConfig(port=0), tracking=tracking, own_process=False)) as server:
        async with Client(server.url) as client:
            ask = ({}, {"box": True}, {"box": True, "mirror": True})
            posed = [await client.render(PAIR, pose=BENT, **more) for more in ask]
            head = {"head": [1.0, 1.1, 2.0, 0, 0, 0, 1]}
            plain, posed, mirrored, tracked = (
                *posed,
                [await client.render(PAIR, tracking=head, box=True) for _ in range(3)][-1],
            )
    assert plain.box is None and not {"box", "feet"} & plain.info.keys()
    means = reference.skin(PERSON.splats, PERSON.skin, BENT.bones(PERSON.skeleton)).means
    assert np.abs(posed.box - [means.min(axis=0), means.max(axis=0)]).max() < 0.12
    assert (posed.box == mirrored.box).all()
    assert np.linalg.det(np.reshape(mirrored.info["eyes"][0]["viewmat"], (4, 4))) < 0
    low, high = tracked.box
    assert low[1] == pytest.approx(-0.25, abs=0.06)  # on the user's floor
    assert np.reshape(tracked.info["feet"], (4, 3))[:, 1].min() > -0.25
    assert high[1] == pytest.approx(1.2, abs=0.1) and low[0] < 1.0 < high[0] and low[2] < 2.3  # about the head


@pytest.mark.extra(name="browser")
@pytest.mark.gl
async def test_each_is_tracked_by_its_own_skeleton_and_measures() -> None:
    small = default_avatar().skeleton
    half = type(small).from_joints(small.names, small.parents, small.joints * 0.5)
    splats = replace(PERSON.splats, means=PERSON.splats.means * 0.5, scales=PERSON.splats.scales * 0.5)
    child = replace(PERSON, skeleton=half, splats=splats)
    server = gl_server(PERSON, ServerConfig(port=0), own_process=False, avatars={"child": child, "rod": limb(50)})
    first, second, rod = server.session()["avatars"]
    assert first["height"] == pytest.approx(2 * second["height"], rel=1e-3) and second["tracking"]
    nothing = {"title": "", "height": None, "hand_out": None} | dict.fromkeys(("tracking", "head", "made"), False)
    assert rod == nothing | {"name": "rod"}
    await server.start()
    try:
        out = []
        for name in ("default", "child"):
            async with Client(server.url, avatar=name, height=1.7, span=1.3) as client:
                out.append(await client.render(PAIR, tracking={"head": [0, 1.6, 0, 0, 0, 0, 1]}, box=True))
        async with Client(server.url, avatar="rod") as client:
            out.append(await client.render(PAIR, pose={"joints": {"joint1": [0, 0, 1]}}))
            with pytest.raises(ProtocolError, match="no tracking solver") as caught:
                await client.render(PAIR, tracking={"head": [0, 1.6, 0, 0, 0, 0, 1]})
            assert caught.value.code == "bad_pose"
            with pytest.raises(ProtocolError, match=r'"hide": .* needs one avatar that has a joint'):
                await client.render(PAIR, hide="head")
        grown, child_reply, _ = out
    finally:
        await server.stop()
    assert np.abs(grown.box - child_reply.box).max() < 0.02  # both as tall as the user
    assert grown.box[1, 1] == pytest.approx(1.7, abs=0.12) and grown.box[0, 1] == pytest.approx(0, abs=0.09)


@pytest.mark.parametrize(
    ("avatars", "words"),
    [
        ({"default": PERSON}, 'two avatars are called "default"'),
        ({"": PERSON}, "name needs 1 to 64"),
        ({"x" * 65: PERSON}, "needs 1 to 64 printable"),
        ({"a\nb": PERSON}, "needs 1 to 64 printable"),
        ({"cloud": PERSON.splats}, '"cloud": clients choose avatars, not Splats'),
    ],
)
def test_names_and_things_that_cannot_be_offered(avatars, words) -> None:
    with pytest.raises(GlsplatError, match=words):
        gl_server(PERSON, ServerConfig(port=0), avatars=avatars)
    bare = replace(PERSON, splats=replace(PERSON.splats, cones=None))
    with pytest.raises(GlsplatError, match='"ben": cull_hidden needs visibility cones'):
        gl_server(PERSON, ServerConfig(port=0), rendering=RenderConfig(cull_hidden=True), avatars={"ben": bare})
