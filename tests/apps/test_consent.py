"""glsplat avatar consent, what inspect says, and whom serve lets in front of its cameras."""

from __future__ import annotations

import json
import logging
import time
from datetime import UTC, date, datetime, timedelta

import pytest

from apps.args import open_scene
from apps.serve import command as serve
from apps.serve.agreed import policy_of
from glsplat.data import embedded_file
from glsplat.errors import GlsplatError
from glsplat.extras.consent.file import on_file
from glsplat.extras.consent.keys import public_key
from glsplat.formats import save
from tests.apps.cli import run, serving
from tests.scenes import limb

LATER = (datetime.now(UTC).date() + timedelta(days=30)).isoformat()


def policy(*words):
    args = serving(*words)
    return policy_of(args, open_scene(args), serve.scene_name(args))


@pytest.fixture
def ann(tmp_path):
    """An avatar without a record, and a key."""
    save(limb(20), tmp_path / "ann.glb")
    assert run("avatar", "consent", "--new-key", tmp_path / "key") == 0
    return tmp_path / "ann.glb"


def sign(file, *more, drivers="*", until=LATER):
    words = ("--subject", "Ann", "--until", until, "--drivers", drivers, "--sign", file.parent / "key")
    return run("avatar", "consent", file, *words, *more)


def test_sign_and_look(ann, capsys):
    capsys.readouterr()
    assert sign(ann, "--given-by", "her mother", "--purpose", "a play", drivers="ann, bob") == 0
    assert "Ann, from " in capsys.readouterr().out
    assert run("inspect", ann) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "signed valid: Ann, given by her mother, purpose: a play" in text and "driven by ann, bob" in text
    assert run("inspect", ann, "--json") == 0
    told = json.loads(capsys.readouterr().out)["consent"]
    assert told["valid"] and told["until"] == LATER and told["drivers"] == ["ann", "bob"]
    assert told["key"] == public_key(ann.parent / "key.pub")
    data = bytearray(ann.read_bytes())
    data[-30] ^= 1
    ann.write_bytes(data)
    assert run("inspect", ann, "--json") == 0
    told = json.loads(capsys.readouterr().out)["consent"]
    assert not told["valid"] and "changed after it was signed" in told["fault"] and "subject" not in told


def test_hand_out_is_asked_for_and_said_and_served(ann, capsys):
    for words, given in ((), False), (("--hand-out",), True):
        assert sign(ann, *words) == 0
        assert ("splats may be handed out" in capsys.readouterr().out) == given
        assert run("inspect", ann, "--json") == 0
        assert json.loads(capsys.readouterr().out)["consent"]["hand_out"] is given
        assert run("inspect", ann) == 0
        assert ("splats may be handed out" in " ".join(capsys.readouterr().out.split())) == given
        served = policy(ann)
        assert (served.withheld("ann", time.time()) is None) == given
        assert served.refusal("ann", "", time.time()) is None
    assert policy().withheld("default", time.time()) is None  # what comes with glsplat shows nobody


def test_what_converting_does_to_it(ann, capsys):
    assert sign(ann) == 0
    folder = ann.parent
    assert run("convert", ann, folder / "copy.glb") == 0 and on_file(folder / "copy.glb").fault == ""
    capsys.readouterr()
    assert run("convert", ann, folder / "turned.glb", "--up", "z") == 0
    assert on_file(folder / "turned.glb").fault == "no consent on file"
    assert run("convert", ann, folder / "splats.ply") == 0
    assert "the signed consent is dropped" in capsys.readouterr().err


def test_serve_asks_for_consent(ann, caplog):
    folder = ann.parent
    for words in ((ann,), ("--avatar", ann)):
        with pytest.raises(GlsplatError, match=r'"ann": no consent on file; sign one .*without-consent = true'):
            policy(*words)
    assert policy(ann, "without-consent=true").label("ann") == "no consent on file"
    assert sign(ann) == 0
    assert not caplog.messages
    assert policy(ann).refusal("ann", "", datetime.now(UTC).timestamp()) is None
    assert len(caplog.messages) == 1 and "nobody told this server to trust" in caplog.text
    caplog.clear()
    assert policy(ann, f"trust={folder / 'key.pub'}", "without-consent=true").label("ann") == ""
    assert not caplog.messages
    assert run("avatar", "consent", "--new-key", folder / "other") == 0
    with pytest.raises(GlsplatError, match="which this server does not trust"):
        policy(ann, f"trust={folder / 'other.pub'}")
    with pytest.raises(GlsplatError, match="a private key"):
        policy(ann, f"trust={folder / 'key'}")
    assert sign(ann, "--from", "2020-01-01", until="2020-01-31") == 0
    with pytest.raises(GlsplatError, match="ended on 2020-01-31"):
        policy(ann)
    assert sign(ann, "--from", date(2999, 1, 1), until="2999-01-31") == 0
    with pytest.raises(GlsplatError, match="begins on 2999-01-01"):
        policy(ann)


def test_serve_says_that_drivers_need_accounts(ann, caplog):
    assert sign(ann, drivers="ann") == 0
    asked = policy(ann, f"trust={ann.parent / 'key.pub'}")
    assert "that is not you" in asked.refusal("ann", "", datetime.now(UTC).timestamp())
    assert asked.refusal("ann", "ann", datetime.now(UTC).timestamp()) is None
    assert [logging.getLevelName(record.levelno) for record in caplog.records] == ["WARNING"]
    assert "without --users nobody has a name" in caplog.text


def test_scenery_and_what_comes_with_glsplat_need_none(ann, tmp_path):
    now = datetime.now(UTC).timestamp()
    save(limb(20).splats, tmp_path / "cloud.ply")
    for words, name in (((), "default"), ((tmp_path / "cloud.ply",), "cloud")):
        asked = policy(*words)
        assert asked.refusal(name, "", now) is None and asked.label(name) == ""
    embedded = embedded_file("ben")
    assert policy(embedded).refusal("ben", "", now) is None


def test_every_avatar_of_a_scene_needs_one(ann):
    folder, now = ann.parent, datetime.now(UTC).timestamp()
    save(limb(21), folder / "bob.glb")
    save(limb(20).splats, folder / "cloud.ply")
    inner = {"version": 1, "items": [{"path": "bob.glb", "visible": False}]}
    (folder / "inner.json").write_text(json.dumps(inner))
    items = [{"path": name} for name in ("cloud.ply", "ann.glb", "ann.glb", "inner.json")]
    (folder / "scene.json").write_text(json.dumps({"version": 1, "items": items}))
    assert sign(ann, drivers="ann") == 0
    with pytest.raises(GlsplatError, match="no consent on file"):
        policy(folder / "scene.json")
    assert sign(folder / "bob.glb", drivers="bob") == 0
    asked = policy(folder / "scene.json")
    assert asked.refusal("scene", "", now) is None  # nobody drives where several are shown
