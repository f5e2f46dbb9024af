"""``glsplat page``: what lies in the folder, who is refused, and that nothing is half-written."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import glsplat
from apps import cli
from glsplat.extras.browser.web_format.read import decode_avatar
from tests.scenes import cloud, limb


def page(*words: object) -> int:
    return cli.main(["page", *map(str, words)])


def test_the_folder_is_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert page("-o", tmp_path / "a", "--motion", "walk") == 0
    assert "python -m http.server" in capsys.readouterr().err
    files = {str(path.relative_to(tmp_path / "a")) for path in (tmp_path / "a").rglob("*") if path.is_file()}
    scripts = [name for name in files if name.endswith(".js")]
    for name in scripts:  # every import leads to a file that is there
        text = (tmp_path / "a" / name).read_text()
        for target in re.findall(r"(?:from|import\()\s*'(\.[^']+)'", text):
            found = (tmp_path / "a" / name).parent / target
            assert found.resolve().is_file(), (name, target)
        assert "http" not in re.sub(r"//.*", "", text).replace("http-equiv", ""), name  # nothing external
    assert not any(name.startswith(("photo", "main.js", "show/xr")) for name in files)
    html = (tmp_path / "a" / "index.html").read_text()
    assert '<base href="alone/">' in html and "default-src 'none'" in html
    about = json.loads((tmp_path / "a" / "page.json").read_text())
    assert [motion["label"] for motion in about["motions"]] == ["Walk"] and about["name"] == "The embedded avatar"
    assert len(decode_avatar((tmp_path / "a" / about["avatar"]).read_bytes()).levels) == 3
    assert page("-o", tmp_path / "b", "--motion", "walk") == 0
    for name in files:  # the same bytes again
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_nobody_is_given_away_without_having_agreed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "ann.glb"
    glsplat.save(limb(60), path)
    assert page(path, "-o", tmp_path / "out") == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "ann" in said and "consent" in said and not (tmp_path / "out").exists()
    splats = tmp_path / "cloud.ply"
    glsplat.save(cloud(20), splats)  # nor what is no avatar
    for words in ([splats], [tmp_path / "nothing.glb"], ["--motion", "nonsense"]):
        assert page(*words, "-o", tmp_path / "out") in (1, 2) and not (tmp_path / "out").exists()
        assert capsys.readouterr().err.count("\n") == 1


def test_a_full_disk_leaves_no_page_that_lacks_something(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from apps import webpage as command

    kept = command.replace_file

    def full(path: Path, parts: list[bytes]) -> None:
        if path.name == "avatar.splats":
            raise OSError(28, "No space left on device")
        kept(path, parts)

    monkeypatch.setattr(command, "replace_file", full)
    assert page("-o", tmp_path / "out") == 1
    assert "No space left" in capsys.readouterr().err and not (tmp_path / "out" / "index.html").exists()


def test_motions_of_a_rig_that_is_not_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own joints move; embedded motions that do not fit are left out."""
    from apps import webpage as command

    rod = replace(limb(60), meta={"source": "made here", "licence": "CC0"})
    monkeypatch.setattr(command, "default_avatar", lambda: rod)
    assert page("-o", tmp_path / "out") == 0
    about = json.loads((tmp_path / "out" / "page.json").read_text())
    assert about["motions"] == [] and about["credit"] == "made here; CC0"
    assert len(decode_avatar((tmp_path / "out" / "avatar.splats").read_bytes()).skeleton) == 4
