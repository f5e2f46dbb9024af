"""Notices in pictures: whole and readable whatever the cameras, for all who must have one."""

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
from glsplat.net.backends.lettering import write_notice
from glsplat.net.client import Client
from glsplat.net.messages import WireOptions
from glsplat.net.reply import Reply
from glsplat.net.room_view import RoomView, VisiblePerson, driven_by
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.scene import Scene
from glsplat.skinning.pose import Pose
from tests.net.running import running

NOTICE = "no consent on file"
NAMES = ["Ann", "Zoë", "Ἀλέξανδρος", "山田太郎", "محمد", "W" * 32, "i" * 32, "A b-c.d'e " * 3 + "fg"]

Pixels = NDArray[np.uint8]


def written(cameras: list[Camera], notice: str = NOTICE) -> Pixels:
    """Return [V, H, W, 4] words on nothing; assert that nothing lies outside the returned box."""
    images = np.zeros((len(cameras), cameras[0].height, cameras[0].width, 4), np.uint8)
    x, y, width, height = write_notice(images, cameras, notice)
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
    wanted = written([seen((0, 1.2, 3), (0, 1, 0))])[0]
    image = written([camera])[0]
    assert as_large(image, wanted) and reads(image, wanted) > 0.8


@pytest.mark.parametrize(("width", "height"), [(64, 48), (96, 96), (120, 500), (500, 40), (73, 131), (2048, 1152)])
def test_a_notice_can_be_read_in_a_picture_of_any_usual_size(width: int, height: int) -> None:
    """At least 12 pixels a line, at most half of the picture's height."""
    camera = seen((0, 1.2, 3), (0, 1, 0), (width, height))
    left, top, right, bottom = extent(written([camera])[0])
    lines = round((bottom - top) / max(12, 0.03 * height))
    assert 1 <= lines <= 3 and bottom - top >= 11.5 * lines and bottom - top <= 0.5 * height + 1
    assert right - left > 6 * 12 / 2  # letters of half a line's height and more, of which "consent" has seven


@pytest.mark.parametrize("side", [1, 7, 32])
def test_a_picture_that_is_too_small_to_read_anything_still_has_the_board(side: int) -> None:
    camera = seen((0, 1.2, 3), (0, 1, 0), (side, side))
    image = written([camera])[0]
    assert image[..., 3].max() > 100 or side < 7
    assert np.count_nonzero(image[..., 3]) >= side * side // 5 or side < 7


def test_both_eyes_see_a_notice_at_one_distance_where_that_is_inside_of_both_pictures() -> None:
    head = head_matrix((0, 1.5, 1.2), (0, 0, 0, 1))
    uneven = [[[400.0, 0, cx], [0, 400, 250], [0, 0, 1]] for cx in (330, 180)]
    eyes = list(stereo_cameras(head, ipd=0.064, size=(512, 512), K=uneven))
    left, right = (extent(image) for image in written(eyes))
    shift = (left[0] + left[2] - right[0] - right[2]) / 2
    assert shift == pytest.approx(330 - 180 + 400 * 0.064 / 1.5, abs=1) and left[1] == right[1]
    apart = list(stereo_cameras(head, ipd=0.064, size=(512, 512), K=[uneven[0], [[400.0, 0, -1e5], *uneven[1][1:]]]))
    wanted = written(eyes)[0]
    assert all(reads(image, wanted) > 0.8 for image in written(apart))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(512, 512), (160, 120)])
def test_any_name_can_be_read(name: str, size: tuple[int, int]) -> None:
    text = driven_by([name], NOTICE)
    left, top, right, bottom = extent(written([seen((0, 1.2, 3), (0, 1, 0), size)], text)[0])
    assert 0 <= left and right <= size[0] and 0 <= top and bottom <= size[1]
    lines = max(1, round((bottom - top) / max(12, 0.03 * size[1])))
    assert (bottom - top) / lines >= 11.5
    letters = right - left if lines == 1 else (right - left) * lines
    assert letters >= 3 * len(text) - 40 or name == "i" * 32


def test_words_are_read_from_left_to_right_in_a_mirror_too() -> None:
    eye = seen((0, 1.5, 0), (0, 1.5, 2), (256, 256))
    mirror = replace(eye, viewmat=eye.viewmat @ np.diag([-1.0, 1, 1, 1]))
    assert np.array_equal(written([eye], "LLL ..."), written([mirror], "LLL ..."))


def test_a_rooms_words_are_the_notices_of_all_who_are_seen_and_who_drives_for_who_asks() -> None:
    pose, place = Pose.zero(55), np.eye(4)
    people = (
        VisiblePerson(1, "Ann", "a", pose, place, notice=NOTICE),
        VisiblePerson(2, "Bob", "b", pose, place),
        VisiblePerson(3, "Zoë", "c", pose, place, opacity=0.0, notice="gone"),
    )
    view = RoomView("lab", 0, 1, people)
    assert view.words(label=False) == NOTICE and view.words(label=True) == f"driven by Ann, Bob, synthetic, {NOTICE}"
    assert RoomView("lab", 0, 2, people[1:]).words(label=False) == ""
    assert [one["label"] for one in view.fields()["people"]][:2] == [
        f"driven by Ann, synthetic, {NOTICE}",
        "driven by Bob, synthetic",
    ]


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
def test_the_name_of_who_drives_is_in_the_picture_for_who_asks(somebody: Avatar) -> None:
    plain, labelled, unsaid = served(somebody, None, "", "label=1&name=Ann", "name=Bob")
    assert (plain.info["driven_by"], labelled.info["driven_by"], unsaid.info["driven_by"]) == ("", "Ann", "Bob")
    for picture in changed(labelled, plain):
        rows, _ = np.nonzero(picture)
        assert len(rows) > 60 and rows.min() > 256 * 0.7
    assert not any(picture.any() for picture in changed(unsaid, plain))


@pytest.mark.gl
def test_what_nobody_agreed_to_says_so_in_every_picture(somebody: Avatar) -> None:
    policy = ConsentPolicy(without=True)
    plain = served(somebody, None, "")[0]
    alone, room, said = served(somebody, policy, "", "room=lab&name=Ann&at=0,0,0&label=0", "room=lab&at=0,0,0")
    for picture in (*changed(alone, plain), *changed(room, plain)):
        rows = np.nonzero(picture)[0]
        assert len(rows) > 60 and rows.min() > 256 * 0.7
    assert all(picture.any() for picture in changed(said, room))  # and who drives, unless the client shows it
