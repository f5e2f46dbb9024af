"""An avatar of each picture of a folder; what one of them is refused for costs that one."""

from __future__ import annotations

from pathlib import Path

import pytest

from apps.avatar import photo, photo_folder
from glsplat.errors import CaptureError, FormatError
from tests.apps.cli import parsed


@pytest.fixture
def people(tmp_path: Path) -> Path:
    folder = tmp_path / "people"
    folder.mkdir()
    for name in ("ann.jpg", "bob.PNG", "notes.txt"):
        (folder / name).write_bytes(b"x")
    return folder


def test_one_a_picture(people, tmp_path, capsys):
    seen = []

    def one(args):
        seen.append((args.front.name, args.out, args.debug, args.seed))
        if args.front.stem == "ann":
            raise CaptureError("no person")
        print(f"{args.out}: made")
        return 0

    out = tmp_path / "avatars"
    assert photo_folder.run(parsed(photo, people, "-o", out, "--seed", 3, "--debug", tmp_path / "d"), one) == 1
    assert seen == [(f"{n}{s}", out / f"{n}.glb", tmp_path / "d" / n, 3) for n, s in (("ann", ".jpg"), ("bob", ".PNG"))]
    said = capsys.readouterr()
    assert said.out == f"{out / 'bob.glb'}: made\n"
    assert said.err.splitlines() == [f"{people / 'ann.jpg'}: no person", "1 of 2 pictures", "2 of 2 pictures"]
    assert photo_folder.run(parsed(photo, people, "--check"), lambda args: 0) == 0  # which writes nothing


def test_what_is_refused(people, tmp_path):
    with pytest.raises(FormatError, match="expected pictures"):
        photo_folder.run(parsed(photo, tmp_path, "-o", tmp_path), lambda args: 0)
    (people / "ann.png").write_bytes(b"x")
    with pytest.raises(FormatError, match='two pictures are called "ann"'):
        photo_folder.run(parsed(photo, people, "-o", tmp_path), lambda args: 0)


def test_what_is_mine_is_signed_where_the_command_runs(people, tmp_path, monkeypatch, capsys):
    """Whatever makes it, on a cluster too, is not told to sign: it would with a key of its own machine."""
    signed, out = [], tmp_path / "avatars"

    def one(args):
        assert not args.mine
        return 1 if args.front.stem == "ann" else 0

    monkeypatch.setattr(photo_folder, "sign_mine", signed.append)
    assert photo_folder.run(parsed(photo, people, "-o", out, "--mine"), one) == 1 and signed == [out / "bob.glb"]

    def refused(path):
        raise FormatError(f"{path}: cannot be written")

    monkeypatch.setattr(photo_folder, "sign_mine", refused)
    assert photo_folder.run(parsed(photo, people, "-o", out, "--mine"), lambda args: 0) == 1
    assert capsys.readouterr().err.count("cannot be written") == 2
