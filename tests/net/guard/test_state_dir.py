"""The folder, the lock and the token that a server keeps."""

from __future__ import annotations

import os
import stat
import time

import pytest

from glsplat.errors import GlsplatError
from glsplat.net.guard import state_dir as kept
from glsplat.net.guard.access import read_token
from glsplat.net.guard.state_dir import kept_token, lock_of, state_folder


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_the_folder_is_for_its_user_alone(state):
    folder = state_folder()
    assert folder == state / "glsplat" and mode(folder) == 0o700
    folder.chmod(0o755)
    assert mode(state_folder()) == 0o700


@pytest.mark.parametrize("given", [None, "", "relative/path"])
def test_without_an_absolute_path_it_is_in_the_home_folder(tmp_path, monkeypatch, given):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    if given is not None:
        monkeypatch.setenv("XDG_STATE_HOME", given)
    assert state_folder() == tmp_path / ".local" / "state" / "glsplat"


def test_a_folder_that_cannot_be_had_is_one_line(state):
    state.write_text("a file in its place")
    with pytest.raises(GlsplatError, match=r"/glsplat: cannot be made \(.*\); set XDG_STATE_HOME to another folder$"):
        state_folder()


def test_somebody_elses_folder_is_not_used(state, monkeypatch):
    state_folder()
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    with pytest.raises(GlsplatError, match="belongs to another user"):
        state_folder()


def test_the_token_is_made_once(state):
    folder = state_folder()
    token = kept_token(folder)
    assert kept_token(folder) == token == read_token(folder / "token")
    assert len(token) >= 24 and mode(folder / "token") == 0o600
    (folder / "token").unlink()
    assert kept_token(folder) != token


def test_a_damaged_token_is_said_and_left_alone(state):
    folder = state_folder()
    (folder / "token").write_text("short")
    with pytest.raises(GlsplatError, match=r"token: a token needs 16 .* found 5; delete it"):
        kept_token(folder)
    assert (folder / "token").read_text() == "short"


def test_a_lock_that_is_held_is_waited_for_and_then_said(state, monkeypatch):
    folder = state_folder()
    monkeypatch.setattr(kept, "_LOCK_TIMEOUT_S", 0.1)
    with lock_of(folder):
        start = time.monotonic()
        with pytest.raises(GlsplatError, match="lock: another process holds it"), lock_of(folder):
            pass
        assert time.monotonic() - start >= 0.1
    with lock_of(folder):
        pass
