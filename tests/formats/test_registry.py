"""A format is a module and one line: loading, saving, recognising, converting and every text follow from it."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps import cli
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats import Format, load, losses, recognise, save, suffixes
from glsplat.formats import registry as formats
from glsplat.formats.format import Opened
from glsplat.io.files import Source, replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats
from tests.formats.scenes import random_avatar, random_splats


def load_toy(start: Opened) -> Splats:
    """Positions as text, a splat a line; all else is made up."""
    lines = start.file.read(start.size).decode().splitlines()[1:]
    means = np.array([[float(word) for word in line.split()] for line in lines]).reshape(-1, 3)
    count = len(means)
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    return Splats.create(means, quats, np.full((count, 3), 0.01), np.ones(count), rgb=np.zeros((count, 3)))


def save_toy(scene: Splats | Avatar, target: Source) -> None:
    rows = "\n".join(" ".join(map(str, mean)) for mean in splats_of(scene).means.tolist())
    replace_file(target, [f"toy\n{rows}\n".encode()])


def lost_by_toy(scene: Splats | Avatar) -> Iterator[str]:
    yield f"the colours of {len(splats_of(scene))} splats are dropped"


TOY = Format(
    "toy", "a toy of points", (".toy", ".points"), lambda start: start.head.startswith(b"toy\n"),
    load_toy, save_toy, lost_by_toy,
)  # fmt: skip


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "FORMATS", [*formats.FORMATS, TOY])


@pytest.mark.usefixtures("registered")
def test_a_new_format_is_saved_recognised_and_loaded(tmp_path: Path) -> None:
    splats = random_splats(7)
    for name in ("a.toy", "b.POINTS"):
        save(splats, tmp_path / name)
        assert recognise(tmp_path / name) == "toy"
    (tmp_path / "a.toy").rename(tmp_path / "a.jpg")  # the content counts
    again = load(tmp_path / "a.jpg")
    np.testing.assert_array_equal(again.means, splats.means)
    stream = io.BytesIO()
    save(splats, stream, format="toy")
    stream.seek(0)
    assert len(load(stream, format=".TOY")) == 7  # type: ignore[arg-type]
    broken = splats.means.copy()
    broken[3] = np.nan
    save(Splats(broken, splats.quats, splats.scales, splats.opacities, splats.sh), tmp_path / "c.toy")
    with pytest.raises(FormatError, match="1 of 7 splats hold NaN"):
        load(tmp_path / "c.toy", strict=True)


@pytest.mark.usefixtures("registered")
def test_every_text_names_a_new_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none").write_bytes(b"hello")
    with pytest.raises(FormatError, match=r"expected 3DGS PLY, .*glTF/GLB .*, a toy of points, or \.splat, but"):
        load(tmp_path / "none")
    with pytest.raises(FormatError, match=r"needs to end in \.ply, .*\.gltf, \.toy or \.points, not '\.stl'"):
        save(random_splats(), tmp_path / "a.stl")
    with pytest.raises(FormatError, match=r"format is one of ply, .*glb, gltf, .*toy, not 'stl'"):
        save(random_splats(), io.BytesIO(), format="stl")
    for command in ("convert", "inspect", "render"):
        with pytest.raises(SystemExit):
            cli.main([command, "--help"])
        assert suffixes() in " ".join(capsys.readouterr().out.split()), command
    assert suffixes().endswith(".toy or .points")


@pytest.mark.usefixtures("registered")
def test_a_format_that_is_only_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save(random_splats(3), tmp_path / "a.toy")
    monkeypatch.setattr(formats, "FORMATS", [*formats.FORMATS[:-1], replace(TOY, save=None)])
    assert ".toy" in suffixes() and ".toy" not in suffixes(written=True) and ".ply" in suffixes(written=True)
    assert len(load(tmp_path / "a.toy")) == 3  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"b\.toy: a toy of points is read, not written; choose \.ply, .*\.gltf$"):
        save(random_splats(), tmp_path / "b.toy")
    with pytest.raises(FormatError, match="is read, not written"):
        losses(random_splats(), "b.toy")
    assert cli.main(["convert", str(tmp_path / "a.toy"), str(tmp_path / "b.toy")]) == 1
    assert "is read, not written" in capsys.readouterr().err and not (tmp_path / "b.toy").exists()
    with pytest.raises(SystemExit):
        cli.main(["convert", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert suffixes() in said and suffixes(written=True) in said


@pytest.mark.usefixtures("registered")
def test_the_longest_suffix_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "FORMATS", [*formats.FORMATS[:-1], replace(TOY, suffixes=(".toy", ".toy.ply"))])
    for name, expected in {
        "a.ply": "ply", "a.toy.ply": "toy", "a.TOY.Ply": "toy", "v1.2.toy.ply": "toy", "a.toy.b.ply": "ply",
        ".toy.ply": "ply", "toy.ply": "ply",
    }.items():  # fmt: skip
        save(random_splats(), tmp_path / name)
        assert recognise(tmp_path / name) == expected, name
    stream = io.BytesIO()
    save(random_splats(), stream, format="toy.ply")
    assert stream.getvalue().startswith(b"toy")


@pytest.mark.usefixtures("registered")
def test_commands_know_a_new_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(random_avatar(), tmp_path / "me.glb")
    assert cli.main(["convert", str(tmp_path / "me.glb"), str(tmp_path / "me.toy")]) == 0
    said = capsys.readouterr().err
    assert "rig" in said and "colours" in said and "spherical harmonics" not in said
    assert cli.main(["inspect", str(tmp_path / "me.toy")]) == 0
    assert "splats, toy, " in capsys.readouterr().out
    assert cli.main(["avatar", "export", str(tmp_path / "me.glb"), "-o", str(tmp_path / "pose.toy")]) == 0
    assert recognise(tmp_path / "pose.toy") == "toy"


def test_what_formats_lose_is_theirs_to_say(tmp_path: Path) -> None:
    avatar = random_avatar()
    assert not list(losses(avatar, "a.glb")) and not list(losses(avatar, io.BytesIO(), format="gltf"))
    assert any("rig" in line and line.endswith("the file holds the zero pose") for line in losses(avatar, "a.ply"))
    bound = avatar.skeleton.inverse_bind.copy()
    bound[2, 0, 3] += 0.1  # a rig of others, bound in another pose than it rests in
    rig = Skeleton(avatar.skeleton.names, avatar.skeleton.parents, avatar.skeleton.rest, bound)
    assert "the file holds the pose it was bound in" in next(losses(replace(avatar, skeleton=rig), "a.ply"))
    with pytest.raises(FormatError, match=r"a\.stl: the name needs to end in"):
        losses(avatar, "a.stl")
    assert suffixes(rigs=True) == ".glb or .gltf"


def test_names_and_suffixes_are_one_formats_own() -> None:
    names = [known.name for known in formats.FORMATS]
    endings = [suffix for known in formats.FORMATS for suffix in known.suffixes]
    assert len(set(names)) == len(names) and len(set(endings)) == len(endings)
    assert all((suffix[0] == "." or suffix == "meta.json") and suffix == suffix.lower() for suffix in endings)
