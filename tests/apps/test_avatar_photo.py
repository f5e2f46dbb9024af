"""``glsplat avatar photo``: what it makes, says and refuses; a reconstructor that needs no work stands in."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import apps.cli as cli
from apps.args import open_scene
from apps.avatar import photo as photo_module
from apps.avatar import photo_folder
from apps.avatar.photo import _guessed
from apps.serve import command as serve
from apps.serve.agreed import policy_of
from glsplat.errors import CaptureError, FormatError, GlsplatError
from glsplat.extras.authoring.check.capture import Finding
from glsplat.extras.authoring.finish.cones import ConeConfig
from glsplat.extras.authoring.models import store
from glsplat.extras.authoring.reconstruct import mesh_from_photos, registry
from glsplat.extras.consent.file import on_file
from glsplat.extras.consent.keys import known_key
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.formats import load
from glsplat.meshes import RiggedMesh
from glsplat.net.guard.state_dir import state_folder
from tests.apps.cli import parsed, serving
from tests.extras.authoring.reconstruct.stubs import Meshed, Plain, replace_check

STUBS = "tests.extras.authoring.reconstruct.stubs"
ARMS = Finding("arms", "an arm lies against the body")


@pytest.fixture(autouse=True)
def stand_in(monkeypatch) -> None:
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Detailed")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


@pytest.fixture
def seen(monkeypatch) -> dict[str, tuple[Finding, ...]]:
    return replace_check(monkeypatch)


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
    monkeypatch.setattr("apps.avatar.photo_sheet._visible_surface", lambda avatar, made, sides: avatar)
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
    from glsplat.extras.authoring.networks.network import network

    network.cache_clear()
    assert photo(front, "-o", tmp_path / "me.glb") == 1
    error = capsys.readouterr().err
    assert "the network is not on this machine; run: glsplat models get" in error and error.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in"] and store.folder().name == "none"


# ---------------------------------------------------------------------------------------------------------- as a mesh


NOTES = {
    "source": "1 photograph (front)",
    "made_by": "glsplat 0.1.0, builtin",
    "date": "2023-11-14",
    "consent": "my own",
    "body_model": "SMPL-X joints (55)",
    "unseen": 0.43,
}


@pytest.fixture
def meshed(monkeypatch) -> None:
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Meshed")


def test_the_line_names_the_templates() -> None:
    templates = {"hair": "painted, none is found", "shoes": "low shoe, template shoes03"}
    words = "; 43% of the surface is guessed; hair: painted, none is found; shoes: low shoe, template shoes03"
    assert _guessed({"unseen": 0.43, "templates": templates}) == words


def test_a_mesh_is_made(seen, meshed, front, tmp_path, capsys) -> None:
    out = tmp_path / "me.glb"
    words = (front, "--as", "mesh", "-o", out, "--texture", 256, "--consent", "my own")
    assert photo(*words) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{out}: 27420 triangles, 256 x 256 texels, ")
    assert said.endswith("43% of the surface is guessed\n")
    mesh = load(out)
    assert isinstance(mesh, RiggedMesh) and dict(mesh.meta) == NOTES and len(mesh.faces) == 27420
    assert [part.name for part in mesh.parts] == ["skin", "eyes", "mouth"]
    first = out.read_bytes()
    assert photo(*words, "--json") == 0 and out.read_bytes() == first
    facts = json.loads(capsys.readouterr().out)
    assert (facts["triangles"], facts["texture"], facts["bytes"]) == (27420, [256, 256], len(first))
    assert (facts["unseen"], facts["made_by"], facts["stature"], facts["overlap"]) == (0.43, "builtin", 1.7, [0.5])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", out.name]


def test_a_mesh_from_python(seen, meshed, front) -> None:
    mesh = mesh_from_photos(front, texture=300, meta={"consent": "my own"})
    assert dict(mesh.meta) == NOTES and mesh.parts[0].texture.shape == (300, 300, 4)
    with pytest.raises(GlsplatError, match='"Plain" makes splats, no mesh'):
        mesh_from_photos(front, using=Plain())
    with pytest.raises(CaptureError, match="far off"):
        mesh_from_photos(front, using=Meshed(problem="far off"), texture=256)


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
    assert photo_folder.run(parsed(photo_module, people, "-o", out, "--seed", 3, "--debug", tmp_path / "d"), one) == 1
    assert seen == [(f"{n}{s}", out / f"{n}.glb", tmp_path / "d" / n, 3) for n, s in (("ann", ".jpg"), ("bob", ".PNG"))]
    said = capsys.readouterr()
    assert said.out == f"{out / 'bob.glb'}: made\n"
    assert said.err.splitlines() == [f"{people / 'ann.jpg'}: no person", "1 of 2 pictures", "2 of 2 pictures"]
    assert photo_folder.run(parsed(photo_module, people, "--check"), lambda args: 0) == 0  # which writes nothing


def test_what_is_refused(people, tmp_path):
    with pytest.raises(FormatError, match="expected pictures"):
        photo_folder.run(parsed(photo_module, tmp_path, "-o", tmp_path), lambda args: 0)
    (people / "ann.png").write_bytes(b"x")
    with pytest.raises(FormatError, match='two pictures are called "ann"'):
        photo_folder.run(parsed(photo_module, people, "-o", tmp_path), lambda args: 0)


def test_what_is_mine_is_signed_where_the_command_runs(people, tmp_path, monkeypatch, capsys):
    """Whatever makes it, on a cluster too, is not told to sign: it would with a key of its own machine."""
    signed, out = [], tmp_path / "avatars"

    def one(args):
        assert not args.mine
        return 1 if args.front.stem == "ann" else 0

    monkeypatch.setattr(photo_folder, "sign_mine", signed.append)
    assert photo_folder.run(parsed(photo_module, people, "-o", out, "--mine"), one) == 1 and signed == [out / "bob.glb"]

    def refused(path):
        raise FormatError(f"{path}: cannot be written")

    monkeypatch.setattr(photo_folder, "sign_mine", refused)
    assert photo_folder.run(parsed(photo_module, people, "-o", out, "--mine"), lambda args: 0) == 1
    assert capsys.readouterr().err.count("cannot be written") == 2


def policy(*words: object) -> ConsentPolicy:
    args = serving(*words)
    return policy_of(args, open_scene(args), serve.scene_name(args))


def test_with_mine_one_command_and_it_is_served(seen, state, front, tmp_path, capsys, caplog) -> None:
    me, plain = tmp_path / "me.glb", tmp_path / "plain.glb"
    assert known_key(state_folder()) is None  # nothing is made before it is used
    assert photo(front, "-o", plain) == 0 and known_key(state_folder()) is None
    assert photo(front, "-o", me, "--mine") == 0
    assert f"glsplat serve {me}" in capsys.readouterr().err
    consent, key = on_file(me).consent, known_key(state_folder())
    assert consent is not None and key is not None and consent.key == key.public
    assert consent.lets("") and consent.lets("anybody") and not consent.hand_out
    with caplog.at_level(logging.WARNING):
        found = policy(me)
    assert found.refusal("me", "", consent.begins + 1) is None and caplog.text == ""
    assert "hand out" in (found.withheld("me", consent.begins + 1) or "")
    assert found.refusal("me", "", consent.ends + 1) is not None  # a year, no longer
    with pytest.raises(GlsplatError, match="no consent on file"):
        policy(plain)


def test_elsewhere_its_key_is_nobodys(seen, state, front, tmp_path, caplog, monkeypatch) -> None:
    """Beyond loopback, with ``trust``, and for another user: as before."""
    me, other = tmp_path / "me.glb", tmp_path / "other.key"
    assert photo(front, "-o", me, "--mine") == 0
    assert cli.main(["avatar", "consent", "--new-key", str(other)]) == 0
    policy(me, "--host", "0.0.0.0")
    assert "which nobody told this server to trust" in caplog.text
    with pytest.raises(GlsplatError, match="which this server does not trust"):
        policy(me, f"trust={other}.pub")
    caplog.clear()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    policy(me)
    assert "which nobody told this server to trust" in caplog.text


@pytest.mark.check
@pytest.mark.gl
def test_the_guide_is_drawn_and_the_same_every_time(tmp_path, capsys) -> None:
    for name in ("a.png", "b.png"):
        assert cli.main(["avatar", "guide", "-o", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert capsys.readouterr().out.startswith(f"{tmp_path}/a.png: how to take the photograph, 1600 x 1180 pixels\n")
    sheet = cv2.imread(str(tmp_path / "a.png"))[..., ::-1].astype(int)
    shirt = (sheet[..., 2] - sheet[..., 0] > 60) & (sheet[..., 2] > 110)  # the embedded person wears blue
    small = [(680 + 178 * k, 744, 852 + 178 * k, 1006) for k in range(5)]
    for x0, y0, x1, y1 in ((40, 100, 640, 960), (1200, 200, 1564, 640), *small):
        assert shirt[y0:y1, x0:x1].sum() > 150
    assert (sheet[744:1006, 1036:1208][:2] == sheet[744, 1120]).all(axis=-1).mean() < 1  # "cut off": the head is
    assert np.ptp(sheet[1010:1080, 680:1560]) > 100  # words below


def test_mine_without_what_signs_is_refused_before_the_work(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "cryptography", None)
    assert cli.main(["avatar", "photo", str(tmp_path / "none.jpg"), "-o", str(tmp_path / "me.glb"), "--mine"]) == 1
    assert "--mine needs cryptography: pip install 'glsplat[server]'" in capsys.readouterr().err
