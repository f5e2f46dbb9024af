"""What is made of a photograph is drawn: by a server with a real renderer, at once and after the next start."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import aiohttp
import numpy as np
import pytest

from apps.serve.wiring import assemble
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.job import UploadConfig
from glsplat.formats import save
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backends.avatar_store import AvatarStore
from glsplat.net.client import Client as Streaming
from glsplat.net.messages import WireOptions
from glsplat.net.served_scene import ServedScene
from glsplat.net.server import Server, ServerConfig
from tests.extras.uploads.conftest import GUARD, LIMITS, Client
from tests.extras.uploads.makers import PICTURE, make
from tests.net.legacy.test_legacy import thinned
from tests.scenes import limb

pytestmark = pytest.mark.check

SIZE = (96, 80)
PAIR = stereo_cameras(head_matrix((0.1, 1.2, 2.2), (0, 0, 0, 1)), size=SIZE)
PERSON = thinned(default_avatar(), 40)
DARK = replace(PERSON, splats=replace(PERSON.splats, sh=PERSON.splats.sh * -1))


def server_of(folder: Path, **options):
    config = ServerConfig(port=0, wire=WireOptions(size=SIZE), limits=LIMITS)
    served = ServedScene(file=SceneFile.of(PERSON), **options)
    return assemble(served, config, uploads=UploadConfig(folder=folder, make=make, nice=0))


async def picture(server, name: str | None = None, **more) -> np.ndarray:
    async with Streaming(f"{server.url}{f'?avatar={name}' if name else ''}", timeout=GUARD) as client:
        return (await client.render(PAIR, quality=95, **more)).images()[0].astype(int)


@asynccontextmanager
async def started(folder: Path) -> AsyncIterator[Server]:
    server = server_of(folder)
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


@pytest.mark.gl
async def test_an_avatar_is_drawn_as_soon_as_it_is_made_and_after_the_next_start(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    async with started(folder) as server, aiohttp.ClientSession() as http:
        default = await picture(server)
        name = await Client(http, server, folder).made(PICTURE)
        headless = await picture(server, name, tracking={"head": [0, 1.6, 0, 0, 0, 0, 1]}, hide="head")
        made = await picture(server, name)
    assert headless.max() > 60 and np.abs(headless - default).max() > 30
    async with started(folder) as server:
        offered = [(one["name"], one["made"]) for one in server.session()["avatars"]]
        assert offered == [("default", False), (name, True)]
        assert np.abs(made - await picture(server, name)).max() <= 2
    assert folder.stat().st_mode & 0o777 == 0o700


def test_what_lies_in_the_folder_is_offered_and_what_is_no_avatar_left_out(tmp_path: Path, caplog) -> None:
    save(DARK, tmp_path / "mine.glb")
    save(PERSON.splats, tmp_path / "room.glb")
    (tmp_path / "photo-abcdefgh.glb").write_bytes(b"glTF, but not really")
    (tmp_path / "notes.txt").write_text("of somebody")
    (tmp_path / " x.glb").write_bytes(b"")
    offered = server_of(tmp_path).session()["avatars"]
    assert [(one["name"], one["made"]) for one in offered] == [("default", False), ("mine", False)]
    assert len(caplog.records) == 3 and all("skipped" in record.message for record in caplog.records)


@pytest.mark.parametrize("name", ["default", "ann"])
def test_two_of_one_name_are_refused(tmp_path: Path, name: str) -> None:
    save(DARK, tmp_path / f"{name}.glb")
    with pytest.raises(GlsplatError, match=f'two avatars are called "{name}"'):
        server_of(tmp_path, avatars={"ann": DARK})


def test_a_folder_that_cannot_be_used_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "no" / "where"):
        with pytest.raises(GlsplatError, match="avatars cannot be kept there"):
            server_of(folder)


def test_a_wardrobe_holds_what_is_given_and_what_lies_there_by_now(tmp_path: Path) -> None:
    rod = limb(20)
    store = AvatarStore({"rod": rod}, tmp_path, "default")
    assert list(store) == ["rod"] and store["rod"] is rod and "ann" not in store
    save(DARK, tmp_path / "ann.glb")
    save(DARK, tmp_path / "default.glb")  # the scene's name stays the scene's
    assert "ann" in store and "default" not in store and len(store["ann"].splats) == len(DARK.splats)
    (tmp_path / "ann.glb").unlink()
    assert "ann" not in store and store.get("ann") is None
