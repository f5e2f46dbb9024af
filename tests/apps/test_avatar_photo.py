"""``glsplat avatar photo``: what it makes, says and refuses; a reconstructor that needs no work stands in."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import apps.cli as cli
from glsplat.authoring.cones import ConeConfig
from glsplat.authoring.fit.standing.doubt import LIMBS
from glsplat.authoring.optimize.compiled import MISSING
from glsplat.authoring.photo.capture import Finding
from glsplat.authoring.reconstruct import registry
from glsplat.formats import load
from glsplat.models import store
from tests.authoring.captures import needs_networks
from tests.authoring.optimize.without import without_numba
from tests.authoring.reconstruct.stubs import replace_check

STUBS = "tests.authoring.reconstruct.stubs"
ARMS = Finding("arms", "an arm lies against the body")


@pytest.fixture(autouse=True)
def stand_in(monkeypatch) -> None:
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Detailed")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


@pytest.fixture
def seen(monkeypatch) -> dict[str, tuple[Finding, ...]]:
    return replace_check(monkeypatch)


@pytest.fixture
def front(tmp_path) -> Path:
    path = tmp_path / "in" / "front.jpg"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.full((90, 60, 3), 77, np.uint8))
    return path


def photo(*words: object) -> int:
    return cli.main(["avatar", "photo", *map(str, words)])


def test_an_avatar_is_made(seen, front, tmp_path, capsys) -> None:
    out, notes = tmp_path / "me.glb", ("--consent", "my own", "--licence", "mine")
    assert photo(front, "--back", front, "-o", out, "--height", "1.74", *notes) == 0
    said = capsys.readouterr()
    assert said.out.startswith(f"{out}: 20") and said.out.endswith(" s; 43% of the surface is guessed\n")
    assert said.err == "" or "%" in said.err
    made = load(out)
    assert dict(made.meta) == {
        "version": 1,
        "source": "2 photographs (front, back)",
        "made_by": "glsplat 0.1.0, builtin",
        "date": "2023-11-14",
        "consent": "my own",
        "licence": "mine",
        "body_model": "SMPL-X joints (55)",
        "unseen": 0.43,
    }
    first = out.read_bytes()
    assert photo(front, "--back", front, "-o", out, "--height", "1.74", *notes) == 0 and out.read_bytes() == first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "me.glb"]


def test_cones_are_made_when_asked_for(seen, front, tmp_path, monkeypatch) -> None:
    for name, value in {"directions": 16, "size": 48, "test_size": 64, "tests": 2, "choosing": 2}.items():
        monkeypatch.setitem(ConeConfig.__init__.__kwdefaults__, name, value)
    out = tmp_path / "me.glb"
    assert photo(front, "-o", out) == 0 and load(out).splats.cones is None
    assert photo(front, "-o", out, "--cones") == 0 and load(out).splats.cones is not None


@pytest.mark.check
def test_what_is_not_fitted_without_numba_is_said(seen, front, tmp_path, monkeypatch, capsys) -> None:
    without_numba(monkeypatch)
    out = tmp_path / "me.glb"
    for words, said in (((), True), (("--steps", 0), False), (("--as", "mesh"), False)):
        monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Meshed")
        assert photo(front, "-o", out, *words) == 0
        assert (MISSING in "".join(capsys.readouterr())) == said
    assert photo(front, "-o", out, "--json") == 0 and json.loads(capsys.readouterr().out)["made_by"] == "builtin"


def test_findings_in_words_and_as_json(seen, front, tmp_path, capsys, monkeypatch) -> None:
    """Some refuse; others are notes of what was guessed, which refuse nothing."""
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Plain")
    out = tmp_path / "me.glb"
    guessed = Finding("arms", "both arms hang along the body", refusal=False)
    seen["front"] = (guessed,)
    assert photo(front, "--check") == 0 and f"{front}: will do as the front\n" in capsys.readouterr().out
    assert photo(front, "-o", out) == 0 and f"{front}: {guessed.text}" in capsys.readouterr().out
    assert load(out).meta["guessed"] == [{"side": "front", "code": "arms", "text": guessed.text}]
    seen["front"] = (ARMS, guessed)
    assert photo(front, "--check") == 1
    assert f"{front}: arms: {ARMS.text}" in capsys.readouterr().out.splitlines()
    seen["front"] = (ARMS,)
    assert photo(front, "-o", out, "--json") == 1
    found = {"code": "arms", "kind": "refusal", "text": ARMS.text}
    assert json.loads(capsys.readouterr().out) == {"out": None, "findings": [{"side": "front", **found}]}
    assert photo(front, "-o", out, "--json", "--anyway") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["bytes"] == out.stat().st_size and facts["made_by"] == "builtin" and facts["unseen"] is None
    (picture,) = facts["pictures"]
    assert (picture["side"], picture["file"], picture["size"]) == ("front", str(front), [60, 90])
    assert picture["findings"] == [found] and picture["notes"] == []


def test_a_refusal_leaves_the_sheet_and_no_avatar(seen, front, tmp_path, capsys) -> None:
    seen["front"] = (ARMS,)
    assert photo(front, "-o", tmp_path / "me.glb", "--debug", tmp_path / "sheets") == 1
    assert capsys.readouterr().err == (
        f"glsplat avatar: {front}: an arm lies against the body; --anyway goes on all the same\n"
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "sheets"]
    sheet = cv2.imread(str(tmp_path / "sheets" / "photo.png"))
    assert sheet.shape == (720, 3 * 480 + 2 * 4, 3)
    assert (sheet[0:2, 10:470] == (70, 70, 255)).all()  # a red frame says that something is wrong


@pytest.mark.check
@pytest.mark.gl
def test_a_body_that_does_not_fit_leaves_the_whole_sheet(seen, front, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:misfitting")
    monkeypatch.setattr("apps.avatar.photo_sheet._fitted", lambda shot, view: np.zeros((720, 480, 3), np.uint8))
    monkeypatch.setattr("apps.avatar.photo_sheet._seen", lambda avatar, made, sides: avatar)
    words = (front, "-o", tmp_path / "me.glb", "--debug", tmp_path / "a")
    assert photo(*words) == 1
    error = capsys.readouterr().err
    assert "the body does not fit the picture (far off); take another one; --anyway goes on" in error
    assert cv2.imread(str(tmp_path / "a" / "photo.png")).shape[0] == 3 * 720 + 2 * 4
    assert not (tmp_path / "me.glb").exists()
    assert photo(*words, "--anyway", "--json") == 0
    assert json.loads(capsys.readouterr().out)["problem"] == "far off"


def test_missing_networks_are_one_line(front, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path / "none"))
    from glsplat.authoring.networks.network import network

    network.cache_clear()
    assert photo(front, "-o", tmp_path / "me.glb") == 1
    error = capsys.readouterr().err
    assert "the network is not on this machine; run: glsplat models get" in error and error.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in"] and store.folder().name == "none"


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.gl
def test_a_capture_with_its_sheet(shared_data, tmp_path, monkeypatch, capsys) -> None:
    needs_networks()
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:fitting")
    front = shared_data / "participants" / "capture" / "p01.jpg"
    assert photo(front, "-o", tmp_path / "me.glb", "--debug", tmp_path / "a", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["overlap"][0] > 0.94 and 1.4 < facts["stature"] < 2 and facts["problem"] == ""
    assert set(facts["doubts"][0]) == set(LIMBS) and max(facts["doubts"][0].values()) < 0.3
    sheet = cv2.imread(str(tmp_path / "a" / "photo.png"))
    assert sheet.shape == (3 * 720 + 2 * 4, 4 * 480 + 3 * 4, 3)
    front_view, back_view = sheet[730:1440, :480].astype(int), sheet[730:1440, 968:1448].astype(int)
    green = [(v[..., 1] > v[..., 2] + 20).sum() for v in (front_view, back_view)]
    orange = [(v[..., 2] > v[..., 1] + 20).sum() for v in (front_view, back_view)]
    assert green[0] > 2 * orange[0] and orange[1] > 2 * green[1]
