"""The folder of avatars: no name leads out of it, and nothing that is no avatar gets in."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from glsplat.data import default_avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats import save
from glsplat.net.uploads.upload_store import NoRoomError, UploadStore


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
