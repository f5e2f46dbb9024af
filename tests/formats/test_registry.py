"""A format is a module and one line, and says what a file lost."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats import Format, all_formats, load, losses, recognise, save, suffixes
from glsplat.formats.format import Opened
from glsplat.io.files import Source, replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats
from tests.formats.scenes import avatar_with_levels, random_avatar, random_splats
from tests.light.lit import surfaced
from tests.skinning.faces import expressive


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
    monkeypatch.setitem(all_formats(), TOY.name, TOY)


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
def test_the_longest_suffix_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(all_formats(), TOY.name, replace(TOY, suffixes=(".toy", ".toy.ply")))
    for name, expected in {
        "a.ply": "ply", "a.toy.ply": "toy", "a.TOY.Ply": "toy", "v1.2.toy.ply": "toy", "a.toy.b.ply": "ply",
        ".toy.ply": "ply", "toy.ply": "ply",
    }.items():  # fmt: skip
        save(random_splats(), tmp_path / name)
        assert recognise(tmp_path / name) == expected, name
    stream = io.BytesIO()
    save(random_splats(), stream, format="toy.ply")
    assert stream.getvalue().startswith(b"toy")


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


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (expressive(20), ["4 shapes of the face are dropped", "the rig of 4 joints"]),
        (avatar_with_levels(), ["3 coarser levels of detail dropped", "the visibility cones are dropped"]),
        (surfaced(random_splats(5, 0)), ["the surface is dropped"]),
    ],
    ids=["shapes", "levels", "surface"],
)
def test_a_plain_format_says_what_it_drops(scene: Splats | Avatar, words: list[str]) -> None:
    said = list(losses(scene, "a.ply"))
    assert all(any(word in line for line in said) for word in words), said
    assert not list(losses(scene, "a.glb"))


def test_the_name_of_an_embedded_avatar_is_not_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError, match=r'^anna: no such file; an embedded avatar is glsplat.data.person\("anna"\)$'):
        load("anna")
    for name in ("nobody", "anna.glb", "./anna"):
        with pytest.raises(FormatError, match="cannot be read"):
            load(name)
    save(random_splats(3), Path("anna.ply"))
    Path("anna.ply").rename("anna")
    assert len(splats_of(load("anna"))) == 3
