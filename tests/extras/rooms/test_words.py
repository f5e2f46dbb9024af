"""Words in pictures: whole and readable whatever the cameras; notices always, labels by their rule."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, head_matrix, look_at, pinhole, stereo_cameras
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backends.lettering import draw_labels
from glsplat.net.client import Client
from glsplat.net.messages import WireOptions
from glsplat.net.reply import Reply
from glsplat.net.room_view import Label, RoomView, VisiblePerson, driven_by
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.scene import Scene, similarity
from glsplat.skinning.pose import Pose
from tests.net.running import running

NOTICE = "no consent on file"
HEAD = np.array([0.0, 1.75, 0.0])
BODY = np.array([[-0.9, 0.0, -0.15], [0.9, 1.75, 0.25]])
NAMES = ["Ann", "Zoë", "Ἀλέξανδρος", "山田太郎", "محمد", "W" * 32, "i" * 32, "A b-c.d'e " * 3 + "fg"]

Pixels = NDArray[np.uint8]


def written(cameras: list[Camera], labels: list[Label], notice: str = "") -> Pixels:
    """Return [V, H, W, 4] words on nothing; assert that nothing lies outside the returned box."""
    images = np.zeros((len(cameras), cameras[0].height, cameras[0].width, 4), np.uint8)
    x, y, width, height = draw_labels(images, cameras, labels, notice)
    outside = images.copy()
    outside[:, y : y + height, x : x + width] = 0
    assert not outside.any()
    return images


def extent(image: Pixels) -> tuple[int, int, int, int]:
    """Left, upper, right and lower edge of what is written."""
    rows, columns = np.nonzero(image[..., 3])
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def as_large(image: Pixels, wanted: Pixels) -> bool:
    """Whether the words are as large as the wanted ones, to a pixel."""
    found, usual = extent(image), extent(wanted)
    return all(abs((found[i + 2] - found[i]) - (usual[i + 2] - usual[i])) <= 1 for i in (0, 1))


def reads(image: Pixels, wanted: Pixels) -> float:
    """How well words are found in another picture: 1 to the pixel, above 0.8 shifted by part of a pixel."""
    left, top, right, bottom = extent(wanted)
    shape = cv2.cvtColor(np.ascontiguousarray(wanted[top:bottom, left:right, :3]), cv2.COLOR_RGB2GRAY)
    padded = cv2.copyMakeBorder(np.ascontiguousarray(image[..., :3]), 2, 2, 2, 2, cv2.BORDER_CONSTANT)
    return float(cv2.matchTemplate(cv2.cvtColor(padded, cv2.COLOR_RGB2GRAY), shape, cv2.TM_CCOEFF_NORMED).max())


def seen(eye: object, target: object, size: tuple[int, int] = (320, 240), fov: float = 50, **more: object) -> Camera:
    up = more.pop("up", (0, 1, 0))
    return Camera(look_at(eye, target, up), pinhole(*size, fov), *size, **more)  # type: ignore[arg-type]


def hostile_cameras(size: tuple[int, int] = (320, 240)) -> Iterator[tuple[str, Camera]]:
    plain = seen((0, 1.2, 3), (0, 1, 0), size)
    for near in (1e-6, 1.5, 1.56, 3.0, 1e9):
        yield f"near {near}", replace(plain, near=near)
    for far in (0.02, 1.5):
        yield f"far {far}", replace(plain, far=far)
    for cx, cy in ((-900, 120), (1e4, 120), (160, -1e4), (1e12, -1e12)):
        yield f"centre {cx} {cy}", replace(plain, K=[[300, 0, cx], [0, 300, cy], [0, 0, 1]])
    for fx, fy in ((300, 30), (1e-3, 1e-3), (1e9, 1e9), (1e12, 1e-6), (1e-9, 1e12)):
        yield f"focal {fx} {fy}", replace(plain, K=[[fx, 0, size[0] / 2], [0, fy, size[1] / 2], [0, 0, 1]])
    for up in ((1, 0, 0), (0, -1, 0)):
        yield f"up {up}", seen((0, 1.2, 3), (0, 1, 0), size, up=up)
    yield "from above", seen((0, 3.2, 0.9), (0, 1.3, 0), size)
    yield "straight down", seen((0, 5, 0), (0, 0, 0), size)
    yield "mirrored", replace(plain, viewmat=plain.viewmat @ np.diag([-1.0, 1, 1, 1]))
    yield "far off", seen((0, 1e6, 1e6), (0, 0, 0), size)


@pytest.mark.parametrize(
    ("name", "camera"), list(hostile_cameras()), ids=lambda one: one if isinstance(one, str) else ""
)
def test_a_notice_is_whole_in_every_picture(name: str, camera: Camera) -> None:
    wanted = written([seen((0, 1.2, 3), (0, 1, 0))], [], NOTICE)[0]
    image = written([camera], [], NOTICE)[0]
    assert as_large(image, wanted) and reads(image, wanted) > 0.8


@pytest.mark.parametrize(("width", "height"), [(64, 48), (96, 96), (120, 500), (500, 40), (73, 131), (2048, 1152)])
def test_a_notice_can_be_read_in_a_picture_of_any_usual_size(width: int, height: int) -> None:
    """At least 12 pixels a line, at most half of the picture's height."""
    camera = seen((0, 1.2, 3), (0, 1, 0), (width, height))
    left, top, right, bottom = extent(written([camera], [], NOTICE)[0])
    lines = round((bottom - top) / max(12, 0.03 * height))
    assert 1 <= lines <= 3 and bottom - top >= 11.5 * lines and bottom - top <= 0.5 * height + 1
    assert right - left > 6 * 12 / 2  # letters of half a line's height and more, of which "consent" has seven


@pytest.mark.parametrize("side", [1, 7, 32])
def test_a_picture_that_is_too_small_to_read_anything_still_has_the_board(side: int) -> None:
    camera = seen((0, 1.2, 3), (0, 1, 0), (side, side))
    image = written([camera], [], NOTICE)[0]
    assert image[..., 3].max() > 100 or side < 7
    assert np.count_nonzero(image[..., 3]) >= side * side // 5 or side < 7


def test_both_eyes_see_a_notice_at_one_distance_where_that_is_inside_of_both_pictures() -> None:
    head = head_matrix((0, 1.5, 1.2), (0, 0, 0, 1))
    uneven = [[[400.0, 0, cx], [0, 400, 250], [0, 0, 1]] for cx in (330, 180)]
    eyes = list(stereo_cameras(head, ipd=0.064, size=(512, 512), K=uneven))
    left, right = (extent(image) for image in written(eyes, [], NOTICE))
    shift = (left[0] + left[2] - right[0] - right[2]) / 2
    assert shift == pytest.approx(330 - 180 + 400 * 0.064 / 1.5, abs=1) and left[1] == right[1]
    apart = list(stereo_cameras(head, ipd=0.064, size=(512, 512), K=[uneven[0], [[400.0, 0, -1e5], *uneven[1][1:]]]))
    wanted = written(eyes, [], NOTICE)[0]
    assert all(reads(image, wanted) > 0.8 for image in written(apart, [], NOTICE))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(512, 512), (160, 120)])
def test_any_name_can_be_read_over_a_head(name: str, size: tuple[int, int]) -> None:
    camera = seen((0, 1.2, 3), (0, 1, 0), size)
    label = Label(driven_by(name, NOTICE), HEAD, box=lambda: BODY)
    left, top, right, bottom = extent(written([camera], [label])[0])
    assert 0 <= left and right <= size[0] and 0 <= top and bottom <= size[1]
    lines = max(1, round((bottom - top) / max(12, size[1] / 40)))
    assert (bottom - top) / lines >= 11.5
    letters = right - left if lines == 1 else (right - left) * lines
    assert letters >= 3 * len(driven_by(name, NOTICE)) - 40 or name == "i" * 32


def test_a_label_is_in_every_picture_that_may_show_its_person() -> None:
    label = Label("driven by Ann", HEAD, box=lambda: BODY)
    left, top, right, bottom = extent(written([seen((0, 1.2, 3), (0, 1, 0))], [label])[0])
    aspect = (right - left) / (bottom - top)
    cases = {
        "feet": seen((0, 0.4, 1), (0, 0.2, 0)),
        "a hand": seen((2.0, 1.3, 1.0), (1.0, 1.3, 0)),
        "from inside": seen((0, 1.0, 0.0), (0, 1.0, -1)),
        "head behind": seen((0, 1.9, 0.3), (0, 0.2, 0.6)),
        "from above": seen((0, 3.2, 0.9), (0, 1.3, 0), near=1.56),
        "head beyond": seen((0, 0.1, 0.6), (0, 1.75, 0), far=1.2),
        "long lens": replace(seen((0, 1.2, 3), (0, 0.6, 0)), K=[[6e4, 0, 160], [0, 6e4, 120], [0, 0, 1]]),
        "off centre": replace(seen((0, 1.2, 3), (3, 1.2, 0)), K=[[250, 0, 400], [0, 250, 120], [0, 0, 1]]),
    }
    for name, camera in cases.items():
        image = written([camera], [label])[0]
        assert image.any(), name
        left, top, right, bottom = extent(image)
        assert (right - left) / (bottom - top) == pytest.approx(aspect, rel=0.1) and bottom - top >= 11, name
    for name, camera in {
        "beside": seen((0, 1.2, 3), (6, 1.2, 0)),
        "behind": seen((0, 1.2, 3), (0, 1.2, 9)),
        "too near": seen((0, 1.2, 3), (0, 1.2, 0), near=3.2),
        "too far": seen((0, 1.2, 3), (0, 1.2, 0), far=2.7),
    }.items():
        assert not written([camera], [label]).any(), name


def test_a_head_out_of_the_picture_has_its_label_at_that_edge() -> None:
    label = Label("driven by Ann", HEAD, box=lambda: BODY)
    feet = extent(written([seen((0, 0.4, 1), (0, 0.2, 0))], [label])[0])
    upside_down = extent(written([seen((0, 0.4, 1), (0, 0.2, 0), up=(0, -1, 0))], [label])[0])
    lying = extent(written([seen((0, 0.4, 1), (0, 0.2, 0), up=(1, 0, 0))], [label])[0])
    assert feet[1] <= 1 and upside_down[3] >= 239 and min(lying[0], 320 - lying[2]) <= 1


def test_a_notice_is_never_covered_by_a_label() -> None:
    camera = seen((0, 1.2, 3), (0, 1, 0))
    alone = written([camera], [], NOTICE)[0]
    for depth in (0.05, 0.4, 1.0, 1.4, 2.9):
        place = camera.position + depth * camera.viewmat[2, :3] + 0.36 * depth * camera.viewmat[1, :3]
        both = written([camera], [Label("driven by somebody who wants to hide it", place)], NOTICE)[0]
        assert np.array_equal(both[alone[..., 3] > 0], alone[alone[..., 3] > 0])


def test_people_at_one_place_do_not_cover_each_others_labels() -> None:
    camera = seen((0, 1.5, 3), (0, 1.4, 0), (512, 512))
    labels = [Label(f"driven by person {i:02}", HEAD - (0, 0, 0.01 * i), box=lambda: BODY) for i in range(19)]
    found = written([camera], labels, NOTICE)[0]
    single = [written([camera], [one])[0] for one in labels]
    inked = sum(int(np.count_nonzero(one[..., 3])) for one in single)
    notice = int(np.count_nonzero(written([camera], [], NOTICE)[0][..., 3]))
    assert np.count_nonzero(found[..., 3]) == pytest.approx(inked + notice, rel=0.02)
    assert min(reads(found, one) for one in single) > 0.8


FACING_Z = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), ipd=0.064, size=(512, 512))


def drawn(labels: list[Label]) -> Pixels:
    return written(FACING_Z, labels)


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
        assert middles[0] - middles[1] == pytest.approx(FACING_Z[0].K[0, 0] * 0.064 / 2.1, abs=1)


@pytest.mark.parametrize(("size", "least"), [(256, 12), (512, 13), (1024, 26)])
def test_from_afar_it_keeps_a_share_of_the_picture(size: int, least: int) -> None:
    eyes = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), ipd=0.064, size=(size, size))
    for low, high in rows(written(eyes, [Label("driven by Ann", np.array([0.0, 1.5, 30.0]))])[..., 3] > 0):
        assert high - low + 1 == pytest.approx(least, abs=1)


def test_at_the_upper_edge_it_goes_below_and_without_room_it_stays() -> None:
    top = 1.5 + 1.6 * (FACING_Z[0].K[1, 2] - 12) / FACING_Z[0].K[1, 1]
    near, far = (Label("driven by Ann", np.array([0.0, top - 0.01 * z, z])) for z in (1.6, 1.7))
    both = drawn([near, far])
    both[alone(near)] = 0
    (first, _), (second, _) = rows(both[..., 3] > 0)
    assert first > rows(alone(near))[0][0] and second > rows(alone(near))[1][0]
    crowd = [Label(f"P{i}", np.array([0.0, 1.5, 1.6 + 0.01 * i]), 0.5) for i in range(8)]
    bright = drawn(crowd[:1])[..., :3].min(axis=-1) > 200  # the letters of the nearest
    assert bright.any() and (drawn(crowd)[..., :3].min(axis=-1)[bright] > 200).all()  # without room it is in front


def test_a_label_is_at_its_place_in_both_eyes() -> None:
    place = np.array([0.1, 1.55, 1.6])
    for image, camera in zip(drawn([Label("driven by Zoë, synthetic", place)]), FACING_Z, strict=True):
        left, top, right, bottom = extent(image)
        at = camera.K @ (camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3])
        assert np.abs(np.array([(left + right) / 2, (top + bottom) / 2]) - at[:2] / at[2]).max() < 1
        assert image[..., :3].max() > 100 and (image[..., :3].max(axis=2) <= image[..., 3]).all()


@pytest.mark.parametrize("behind", [-2.0, 0.0, 0.005])
def test_a_label_behind_the_eyes_is_not_drawn(behind: float) -> None:
    assert not drawn([Label("driven by Ann", np.array([0, 1.5, behind]))]).any()


def test_labels_are_read_from_left_to_right_in_a_mirror_too() -> None:
    eye = seen((0, 1.5, 0), (0, 1.5, 2), (256, 256))
    mirror = replace(eye, viewmat=eye.viewmat @ np.diag([-1.0, 1, 1, 1]))
    label = Label("LLL ...", np.array([0, 1.5, 1.0]), 0.1)
    assert np.array_equal(written([eye], [label]), written([mirror], [label]))


@pytest.fixture(scope="module")
def backend(somebody: Avatar) -> Iterator[RendererBackend]:
    made = RendererBackend(somebody, (96, 72), rooms={"lab": SceneFile.of(Scene())}, max_cost=float("inf"))
    made.open()
    yield made
    made.close()


def pictures(backend: RendererBackend, cameras: list[Camera], bob: VisiblePerson) -> tuple[Pixels, Pixels]:
    """Without the label and with it."""
    plain, labelled = (
        RenderJob(cameras=tuple(cameras), frame_id=1, room=RoomView("lab", 0, 9, (one,)))
        for one in (replace(bob, label=""), bob)
    )
    return backend.render(plain).images.copy(), backend.render(labelled).images.copy()


@pytest.mark.gl
@pytest.mark.parametrize("scale", [0.05, 1.0, 20.0])
def test_nobody_is_in_a_picture_without_a_label(backend: RendererBackend, scale: float) -> None:
    """Random cameras around or in a person who stands, moves or is torn apart."""
    chance = np.random.default_rng([3, int(scale * 20)])
    shown = bare = 0
    for number in range(60):
        turns, moves = chance.normal(0, 0.4, (55, 3)), None
        if number % 3 == 0:
            moves = np.zeros((55, 3))
            moves[int(chance.integers(55))] = chance.normal(0, 10 ** chance.uniform(-1, 3), 3)
        pose = Pose(turns, chance.normal(0, 0.3, 3), moves, {"jawOpen": 1.0})
        place = similarity(chance.normal(0, 1, 3), chance.normal(size=4), scale)
        bob = VisiblePerson(1, "bob", "", pose, place, label="driven by bob")
        middle = place[:3, :3] @ (chance.normal(0, 0.3, 3) + (0, 1, 0)) + place[:3, 3]
        eye = middle + scale * chance.normal(0, 10 ** chance.uniform(-1.5, 0.5), 3)
        side = int(chance.integers(2))
        focal = 72 * 10 ** chance.uniform(-0.5, 1.5)
        centre = chance.normal((48, 36), 10 ** chance.uniform(0, 2))
        k = [[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]]
        view = look_at(eye, middle + scale * chance.normal(0, 0.5, 3), chance.normal(size=3))
        near = scale * 10 ** chance.uniform(-3, 0.3)
        cameras = [Camera(view, k, 96, 72, near=near)]
        if side:
            cameras.append(replace(cameras[0], viewmat=view + np.pad([[-0.064 * scale]], ((0, 3), (3, 0)))))
        plain, labelled = pictures(backend, cameras, bob)
        for before, after in zip(plain, labelled, strict=True):
            words = np.abs(before.astype(int) - after).max(axis=-1) > 8
            if before[..., 3].max() > 8:
                shown += 1
                assert np.count_nonzero(words) > 96 * 72 / 20, number
            elif not words.any():
                bare += 1
    assert shown > 15 and bare > 2  # it is not simply always there


def served(somebody: Avatar, consent: ConsentPolicy | None, *queries: str) -> list[Reply]:
    """One picture of a server for each query."""
    facing = stereo_cameras(head_matrix((0, 1.2, 2.4), (0, 0, 0, 1)), size=(256, 256))
    config = ServerConfig(port=0, wire=WireOptions(size=(256, 256), quality=95), consent=consent)

    async def main() -> list[Reply]:
        async with running(
            gl_server(somebody, replace(config, consent=consent), own_process=False, rooms={"lab": Scene()})
        ) as server:
            replies = []
            for query in queries:
                async with Client(f"{server.url}?{query}", timeout=60) as client:
                    replies.append(await client.render(facing, pose={"root_pose": [0, 0.1, 0]}))
            return replies

    return asyncio.run(main())


def changed(one: Reply, other: Reply) -> list[NDArray[np.bool_]]:
    """[H, W] of each eye: what differs by more than JPEG does."""
    pairs = zip(one.images(), other.images(), strict=True)
    return [np.abs(a.astype(int) - b.astype(int)).max(axis=2) > 60 for a, b in pairs]


@pytest.mark.gl
def test_the_name_of_who_drives_stands_over_the_head_for_who_asks(somebody: Avatar) -> None:
    plain, labelled, unsaid = served(somebody, None, "", "label=1&name=Ann", "name=Bob")
    assert (plain.info["driven_by"], labelled.info["driven_by"], unsaid.info["driven_by"]) == ("", "Ann", "Bob")
    columns = []
    for picture in changed(labelled, plain):
        rows, across = np.nonzero(picture)
        assert len(rows) > 60 and rows.max() < 256 / 3
        columns.append(across.mean())
    assert 1 < columns[0] - columns[1] < 12  # at the distance of the head, not of the picture
    assert not any(picture.any() for picture in changed(unsaid, plain))


@pytest.mark.gl
def test_what_nobody_agreed_to_says_so_in_every_picture(somebody: Avatar) -> None:
    policy = ConsentPolicy(without=True)
    plain, alone, room = served(somebody, None, "")[0], *served(somebody, policy, "", "room=lab&name=Ann&at=0,0,0")
    for picture in changed(alone, plain):
        rows = np.nonzero(picture)[0]
        assert len(rows) > 60 and rows.min() > 256 * 0.7
    for picture in changed(room, alone):
        rows = np.nonzero(picture)[0]
        assert len(rows) > 60 and rows.max() < 256 / 3  # the label of the room; the notice is in both
