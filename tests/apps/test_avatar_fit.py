"""What fits splats on the command line: ``avatar make``, ``avatar reduce`` and levels, with numba and without."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import apps.cli as cli
from apps.avatar import making as made
from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING
from glsplat.extras.authoring.finish import levels as making
from glsplat.extras.authoring.finish.level_merge import merged
from glsplat.extras.authoring.finish.levels import FittedConfig
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.formats import load, save
from glsplat.skinning.pose import Pose
from glsplat.splats import Level
from tests.extras.authoring.optimize.without import without_numba
from tests.extras.authoring.reconstruct.stubs import small_avatar
from tests.extras.rigs.gltf.built import FAMILIES, build
from tests.scenes import cloud


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few and small pictures."""
    for name, value in {"size": 120, "poses": 1}.items():
        monkeypatch.setitem(FittedConfig.__init__.__kwdefaults__, name, value)


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """An avatar of 400 splats, with notes, cones and a level."""
    avatar = small_avatar(400)
    count = len(avatar.splats)
    splats = replace(avatar.splats, cones=np.full((count, 4), 127, np.int8), cones_psnr=45.0)
    level = Level(merged(avatar, 100), 50.0)
    save(replace(avatar, splats=splats, levels=(level,), meta={"consent": "my own", "unseen": 0.4}), tmp_path / "a.glb")
    return tmp_path / "a.glb"


def reduce(*words: object) -> int:
    return cli.main(["avatar", "reduce", *map(str, words)])


@pytest.mark.usefixtures("quick")
def test_an_avatar_of_fewer_splats(many: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, again, other, plain = (tmp_path / f"{name}.glb" for name in ("out", "again", "other", "plain"))
    words = (many, "--splats", 150, "--steps", 5)
    assert reduce(*words, "-o", out, "--licence", "mine", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["splats"] == 150 and facts["bytes"] == out.stat().st_size
    made = load(out)
    assert isinstance(made, Avatar) and len(made.splats) == 150 and np.isfinite(made.splats.means).all()
    assert made.splats.cones is None and made.levels == ()
    assert (made.meta["consent"], made.meta["licence"], made.meta["unseen"]) == ("my own", "mine", 0.4)
    assert made.skeleton.names == load(many).skeleton.names
    posed_splats(made, Pose.zero(len(made.skeleton)))
    assert reduce(*words, "-o", again, "--licence", "mine") == 0 and again.read_bytes() == out.read_bytes()
    assert capsys.readouterr().out.startswith(f"{again}: 150 splats, ")
    assert reduce(*words, "-o", other, "--licence", "mine", "--seed", 1) == 0 and other.read_bytes() != out.read_bytes()
    assert reduce(many, "-o", plain, "--splats", 150, "--steps", 0) == 0
    whole = load(many)
    np.testing.assert_allclose(load(plain).splats.means, merged(replace(whole, levels=()), 150).splats.means, atol=1e-6)


def test_nothing_is_reduced_without_numba(
    many: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_numba(monkeypatch)
    assert reduce(many, "-o", tmp_path / "out.glb", "--splats", 150) == 1
    said = capsys.readouterr()
    assert said.err == f"glsplat avatar: {NUMBA_MISSING}; --steps 0 merges without it\n" and said.out == ""
    assert not (tmp_path / "out.glb").exists()


def test_what_is_missing_is_said_before_an_avatar_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    person = tmp_path / "person.glb"
    person.write_bytes(build(FAMILIES["SMPL"]).data)
    asked: list[int] = []

    def fitted_to_mesh(avatar: Avatar, mesh: Any, seed: int, steps: int, show: Any) -> Avatar:
        asked.append(steps)
        return avatar

    monkeypatch.setattr(made, "make_avatar", lambda *words, **more: small_avatar())
    monkeypatch.setattr(made, "fitted_to_mesh", fitted_to_mesh)
    words = ["avatar", "make", str(person), "-o", str(tmp_path / "me.glb"), "--splats", "200", "--no-cones"]
    line = f"glsplat avatar make: {NUMBA_MISSING}\n"
    assert cli.main([*words, "--steps", "7"]) == 0 and line not in capsys.readouterr().err
    without_numba(monkeypatch)
    assert cli.main([*words, "--steps", "7"]) == 0 and line in capsys.readouterr().err
    assert cli.main([*words, "--steps", "0"]) == 0 and line not in capsys.readouterr().err
    assert asked == [7, 7]


@pytest.mark.extra(name="consent")
def test_levels_of_avatars_are_fitted_and_those_of_scenes_merged(
    many: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[tuple[Any, ...]] = []

    def fitted_levels(avatar: Avatar, counts: Any, seed: int, config: FittedConfig, show: Any) -> list[Avatar]:
        called.append(("fitted", list(counts), seed, config.steps, avatar.levels))
        return [merged(avatar, count) for count in counts]

    def covering_levels(scene: Any, counts: Any, *words: Any) -> list[Any]:
        called.append(("merged", counts))
        return []

    def measured(finest: Any, levels: Any, *words: Any) -> tuple[Level[Any], ...]:
        return tuple(Level(level, 100.0 / (number + 1)) for number, level in enumerate(levels))

    for stub in (fitted_levels, covering_levels, measured):
        monkeypatch.setattr(making, stub.__name__, stub)
    save(cloud(300), tmp_path / "s.ply")
    out, count = tmp_path / "out.glb", len(load(many).splats)

    def levels(name: str, *words: object) -> list[tuple[Any, ...]]:
        called.clear()
        arguments = ["avatar", "levels", tmp_path / name, "-o", out, "--force", *words]
        assert cli.main([*map(str, arguments)]) == 0
        return list(called)

    assert levels("a.glb", "--counts", 200, 100, "--steps", 7, "--seed", 3) == [("fitted", [200, 100], 3, 7, ())]
    assert [len(one.content.splats) for one in load(out).levels] == [200, 100]
    assert levels("a.glb") == [("fitted", [count // 2], 0, FittedConfig().steps, ())]
    assert levels("a.glb", "--counts", 200, "--steps", 0) == [("merged", [200])]
    assert levels("s.ply", "--counts", 200, "--steps", 7) == [("merged", [200])]
    without_numba(monkeypatch)
    assert levels("a.glb", "--counts", 200) == [("merged", [200])]
