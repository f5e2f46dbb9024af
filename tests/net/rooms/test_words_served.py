"""Words that a server writes into its pictures: who drives, and that nobody agreed."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.consent.file import NONE
from glsplat.consent.policy import ConsentPolicy
from glsplat.data import default_avatar
from glsplat.net.backends.server import make_server
from glsplat.net.client import Client
from glsplat.net.messages import WireOptions
from glsplat.net.reply import Reply
from glsplat.net.server import ServerConfig
from glsplat.scene import Scene

SIZE = 256
FACING = stereo_cameras(head_matrix((0, 1.2, 2.4), (0, 0, 0, 1)), size=(SIZE, SIZE))
POSE = {"root_pose": [0, 0.1, 0]}


@pytest.fixture(scope="module")
def person() -> Avatar:
    return replace(default_avatar().levels[-1].content, levels=())


def pictures(person: Avatar, consent: ConsentPolicy | None, *queries: str) -> list[Reply]:
    wire = WireOptions(size=(SIZE, SIZE), quality=95)
    config = ServerConfig(port=0, wire=wire, consent=consent)

    async def main() -> list[Reply]:
        server = make_server(person, config, own_process=False, consent=consent, rooms={"lab": Scene()})
        await server.start()
        try:
            replies = []
            for query in queries:
                async with Client(f"{server.url}?{query}", timeout=60) as client:
                    replies.append(await client.render(FACING, pose=POSE))
            return replies
        finally:
            await server.stop()

    return asyncio.run(main())


def changed(one: Reply, other: Reply) -> list[NDArray[np.bool_]]:
    """[H, W] of each eye: what differs by more than JPEG does."""
    pairs = zip(one.images(), other.images(), strict=True)
    return [np.abs(a.astype(int) - b.astype(int)).max(axis=2) > 60 for a, b in pairs]


@pytest.mark.gl
def test_the_name_of_who_drives_stands_over_the_head_for_who_asks(person: Avatar) -> None:
    plain, labelled, unsaid = pictures(person, None, "", "label=1&name=Ann", "name=Bob")
    assert (plain.info["driven_by"], labelled.info["driven_by"], unsaid.info["driven_by"]) == ("", "Ann", "Bob")
    columns = []
    for picture in changed(labelled, plain):
        rows, across = np.nonzero(picture)
        assert len(rows) > 60 and rows.max() < SIZE / 3
        columns.append(across.mean())
    assert 1 < columns[0] - columns[1] < 12  # at the distance of the head, not of the picture
    assert not any(picture.any() for picture in changed(unsaid, plain))


@pytest.mark.gl
def test_what_nobody_agreed_to_says_so_in_every_picture(person: Avatar) -> None:
    policy = ConsentPolicy(without=True)
    plain, alone, room = pictures(person, None, "")[0], *pictures(person, policy, "", "room=lab&name=Ann&at=0,0,0")
    for picture in changed(alone, plain):
        rows = np.nonzero(picture)[0]
        assert len(rows) > 60 and rows.min() > SIZE * 0.7
    for picture in changed(room, alone):
        rows = np.nonzero(picture)[0]
        assert len(rows) > 60 and rows.max() < SIZE / 3  # the label of the room; the notice is in both
    assert NONE == "no consent on file"
