"""``avatar photo --mine``: one command, and a server of the same user shows it; elsewhere its key is a stranger's."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps import cli
from apps.args import open_scene
from apps.serve import command as serve
from apps.serve.agreed import policy_of
from glsplat.authoring.reconstruct import registry
from glsplat.consent.file import on_file
from glsplat.consent.policy import ConsentPolicy
from glsplat.errors import GlsplatError
from glsplat.net.guard.kept import known_key, state_folder
from tests.apps.cli import parsed
from tests.authoring.reconstruct.stubs import replace_check


@pytest.fixture
def front(monkeypatch, tmp_path) -> Path:
    monkeypatch.setitem(registry.OWN, "builtin", "tests.authoring.reconstruct.stubs:Detailed")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    replace_check(monkeypatch)
    path = tmp_path / "front.jpg"
    cv2.imwrite(str(path), np.full((90, 60, 3), 77, np.uint8))
    return path


def photo(*words: object) -> int:
    return cli.main(["avatar", "photo", *map(str, words)])


def policy(*words: object) -> ConsentPolicy:
    args = parsed(serve, *words)
    return policy_of(args, open_scene(args), serve.scene_name(args))


def test_one_command_and_it_is_served(front, tmp_path, capsys, caplog) -> None:
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


def test_elsewhere_the_key_is_nobodys(front, tmp_path, caplog, monkeypatch) -> None:
    """Beyond loopback, with --trust, and for another user: as before."""
    me, other = tmp_path / "me.glb", tmp_path / "other.key"
    assert photo(front, "-o", me, "--mine") == 0
    assert cli.main(["avatar", "consent", "--new-key", str(other)]) == 0
    policy(me, "--host", "0.0.0.0")
    assert "which nobody told this server to trust" in caplog.text
    with pytest.raises(GlsplatError, match="which this server does not trust"):
        policy(me, "--trust", f"{other}.pub")
    caplog.clear()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    policy(me)
    assert "which nobody told this server to trust" in caplog.text
