"""What a photograph becomes, and the folder that keeps it: no name leads out of it, and only avatars get in."""

from __future__ import annotations

import io
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest

from glsplat.data import default_avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.upload_store import NoRoomError, UploadStore
from glsplat.extras.uploads.work import Maker
from glsplat.formats import load, save
from tests.extras.uploads.conftest import HEADERS
from tests.extras.uploads.makers import PICTURE, make
from tests.net.wire import HANG


async def test_a_photograph_becomes_an_avatar_that_is_offered_and_kept(takes):
    async with takes() as client:
        session = (await client.ask("GET", "/session"))[1]
        assert session["upload"]["views"] == ["front", "back", "left", "right"]
        status, told = await client.post()
        assert status == 202 and told["state"] == "waiting" and told["ahead"] == 0
        name = told["name"]
        told = await client.until(name, "done")
        assert told["steps"] == ["looking at the picture", "making the person"] and told["share"] == 1
        assert told["error"] is None and told["findings"] == []
        offered = (await client.ask("GET", "/session"))[1]["avatars"]
        assert [one["name"] for one in offered] == ["default", name]
        assert [one["made"] for one in offered] == [False, True]
        async with client.http.ws_connect(f"{client.server.url}?avatar={name}", headers=HEADERS) as ws:
            assert not ws.closed
        assert client.kept() == [f"{name}.glb"]
        path = client.folder / f"{name}.glb"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        avatar = load(path)
        assert avatar.meta["pictures"] == "front" and avatar.meta["height"] == "None"
        assert PICTURE not in path.read_bytes()


@pytest.mark.parametrize("how", [Maker.close, Maker.stop])
def test_a_process_is_not_closed_while_another_thread_ends_it(tmp_path: Path, how: Callable[[Maker], None]) -> None:
    """A process that is closed cannot be killed: that raises."""
    maker = Maker(UploadConfig(folder=tmp_path, make=make))
    with ThreadPoolExecutor(1) as other:
        with maker._lock:
            ending = other.submit(how, maker)
            done = wait([ending], 0.2).done
        ending.result(HANG)
    assert not done


def glb(scene) -> bytes:
    data = io.BytesIO()
    save(scene, data, format="glb")
    return data.getvalue()


@pytest.mark.parametrize(
    "name", ["../out", "photo-../../x", "photo-", "mine", "", "photo-abcdefgh/x", "photo-abcdefgh\n"]
)
def test_no_other_name_is_written_or_deleted(tmp_path: Path, name: str) -> None:
    store = UploadStore(tmp_path, 9, 10**9)
    assert not store.made_here(name)
    for change in (lambda: store.remove(name), lambda: store.put(name, glb(default_avatar()))):
        with pytest.raises(GlsplatError, match="only avatars that were made here"):
            change()
    assert not list(tmp_path.iterdir())


def test_what_is_no_avatar_is_not_kept(tmp_path: Path) -> None:
    store = UploadStore(tmp_path, 9, 10**9)
    for data in (b"", b"glTF\2\0\0\0\xff\xff\xff\xff", glb(default_avatar().splats)):
        with pytest.raises(FormatError):
            store.put(store.new_name(), data)
    assert not list(tmp_path.iterdir())


def test_the_bounds_count_what_the_operator_put_there(tmp_path: Path) -> None:
    (tmp_path / "mine.glb").write_bytes(bytes(1000))
    UploadStore(tmp_path, 2, 2000).check(1000)
    with pytest.raises(NoRoomError, match="keeps 1 avatars"):
        UploadStore(tmp_path, 1, 2000).check()
    with pytest.raises(NoRoomError, match="MB of avatars, which are used up"):
        UploadStore(tmp_path, 2, 2000).check(1001)
    with pytest.raises(NoRoomError):
        UploadStore(tmp_path, 2, 2000).put("photo-abcdefgh", glb(default_avatar()))
    assert len(list(tmp_path.iterdir())) == 1
