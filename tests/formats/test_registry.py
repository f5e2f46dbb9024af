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
from glsplat.extras.formats.fidelity import fidelity, read_back
from glsplat.formats import Format, all_formats, load, losses, recognise, save, suffixes
from glsplat.formats.format import Opened
from glsplat.io.files import Source, replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import avatar_with_levels, awkward_splats, random_avatar, random_splats
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


def two(**changes: object) -> Splats:
    """Two splats, the first as it is changed."""
    values: dict[str, object] = {
        "means": [[1, 2, 3], [0, 0, 0]],
        "quats": [[1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5]],
        "scales": [[0.1, 0.05, 0.2], [1, 1, 1]],
        "opacities": [0.5, 0.25],
        "sh": np.zeros((2, 4, 3)),
    }
    return Splats(**(values | changes))  # type: ignore[arg-type]


def test_differences_by_hand() -> None:
    half = np.radians(10) / 2
    sh = np.zeros((2, 4, 3))
    sh[0, 0, 1] = 0.12 / SH_C0  # 30.6 levels of green
    sh[0, 2, 0], sh[0, 3, 0] = 0.3, 0.4  # 0.5 over sqrt(4 pi): 0.14105, 35.97 levels of red
    found = fidelity(
        two(),
        two(
            means=[[1, 2.003, 3.004], [0, 0, 0]],
            quats=[[-np.cos(half), 0, 0, -np.sin(half)], [0.5, 0.5, 0.5, 0.5]],
            scales=[[0.11, -0.05, 0.2], [1, 1, 1]],  # 0.01 of 0.2; a sign is none
            opacities=[0.45, 0.25],
            sh=sh,
        ),
    )
    for error, largest in (
        (found.positions, 0.005),
        (found.scales, 5),
        (found.rotations, 10),
        (found.colours, 30.6),
        (found.view, 35.968),
        (found.opacities, 0.05),
    ):
        assert error.largest == pytest.approx(largest, rel=1e-4) and error.mean == pytest.approx(largest / 2, rel=1e-4)
    assert len(list(found.words())) == 6


def test_nothing_is_said_of_rounding() -> None:
    splats = random_splats(200, 3)
    nudged = Splats(*(np.nextafter(getattr(splats, n), 9) for n in ("means", "quats", "scales", "opacities", "sh")))
    assert not list(fidelity(splats, nudged).words())
    assert not list(fidelity(random_splats(0), random_splats(0)).words())


def test_one_splat_far_away_hides_no_loss_of_the_others(tmp_path: Path) -> None:
    """Rounding to float32 is that of each splat where it is, not that of the whole scene."""
    means = random_splats(300, 0).means.copy()
    means[0] = 3000
    scene = replace(random_splats(300, 0), means=means)
    for suffix in (".compressed.ply", ".sog"):
        save(scene, tmp_path / f"a{suffix}")
        assert any(words.startswith("positions") for words in read_back(scene, tmp_path / f"a{suffix}").words())


def test_what_is_drawn_alike_is_alike() -> None:
    """Below 0 a colour is drawn as 0, and an opacity outside 0 to 1 as the nearer end."""
    dark, darker = np.full((2, 4, 3), -1 / SH_C0), np.full((2, 4, 3), -2 / SH_C0)
    dark[:, 1:], darker[:, 1:] = 0, 0
    assert not list(fidelity(two(sh=dark, opacities=[1, 0]), two(sh=darker, opacities=[1.5, -1])).words())
    dropped = fidelity(two(sh=np.ones((2, 4, 3))), two(sh=np.ones((2, 1, 3))))
    assert dropped.colours.largest == 0 and dropped.view.largest == pytest.approx(255 * np.sqrt(3 / (4 * np.pi)))


def test_broken_splats_do_not_count() -> None:
    splats = awkward_splats()
    found = fidelity(splats, random_splats(10, 1))
    assert np.isfinite([found.positions.largest, found.rotations.largest, found.scales.mean]).all()
    assert found.positions.largest == 0 and found.rotations.largest == pytest.approx(0, abs=1e-3)


def test_order_and_missing_splats() -> None:
    splats = random_splats(100_000, 0)  # more than one chunk
    order = np.random.default_rng(4).permutation(len(splats))[:-3]
    found = fidelity(splats, splats.take(order), order)
    assert list(found.words()) == ["3 of 100000 splats are not there"]
    assert fidelity(splats, splats.take(np.roll(np.arange(len(splats)), 1))).positions.largest > 1
    with pytest.raises(FormatError, match="99997 splats were read back, not the 100000"):
        fidelity(splats, splats.take(order))


@pytest.mark.parametrize("suffix", [known.suffixes[0] for known in all_formats().values() if known.save])
def test_every_format_says_in_which_order_it_writes(tmp_path: Path, suffix: str) -> None:
    """A format that puts splats into another order, or leaves some out, has ``order``: else figures mean nothing."""
    base = random_splats(300, 1)
    means = base.means.copy()
    means[7] = np.nan
    scene = Splats(means, base.quats, base.scales, base.opacities, base.sh)
    save(scene, tmp_path / f"a{suffix}")
    found = read_back(scene, tmp_path / f"a{suffix}")
    assert found.positions.largest < 0.05
    assert found.rotations.largest < 5 and found.colours.mean < 20 and found.opacities.largest < 0.1


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
