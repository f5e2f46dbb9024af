"""Certificates and tokens that serve makes for itself, or is given."""

from __future__ import annotations

import asyncio
import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from apps.serve import command, keys
from apps.serve.ready import Endpoint, announce
from apps.usage import UsageError
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.extras.accounts.users import new_user, write_users
from glsplat.extras.operations import certificate
from glsplat.net.client import Client
from glsplat.net.guard.access import certificate_names, read_token, server_tls
from tests.apps.cli import mistake, serving

ROOT = Path(__file__).parents[3]
BEYOND = ("--host", "0.0.0.0", "--self-signed")


def names_of(path):
    return certificate_names(path, server_tls(path, path))


def test_on_this_machine_a_certificate_is_made_where_it_is_asked_for_and_no_token(state):
    assert keys.keys_of(serving()) == keys.Keys()
    with pytest.raises(UsageError):
        command.run(serving(*BEYOND, "--size", 4096))
    assert not state.exists()
    found = keys.keys_of(serving("--self-signed"))
    assert found.tls == (state / "glsplat" / certificate.KEY,) * 2
    assert (found.token, found.token_file) == (None, None) and not (state / "glsplat" / "token").exists()
    assert "localhost" in names_of(found.tls[0])


def test_beyond_it_a_token_too_and_both_stay(state, monkeypatch, caplog):
    monkeypatch.setattr(keys, "machine_names", lambda: ("Box", "box.local", "näme"))
    monkeypatch.setattr(keys, "reachable_at", lambda host: ("192.0.2.7",) if host == "0.0.0.0" else ())
    args = serving(*BEYOND, "allow-host=lab.example")
    found = keys.keys_of(args)
    assert found.token_file == state / "glsplat" / "token" and found.token == read_token(found.token_file)
    assert names_of(found.tls[0]) == ("localhost", "lab.example", "box", "box.local")
    assert keys.keys_of(args) == found and caplog.messages == []
    keys.keys_of(serving(*BEYOND, "allow-host=other.example"))
    assert "lacks other.example" in caplog.text  # browsers will ask once more
    assert found.token not in repr(found)
    config = command.server_config(args)
    assert (config.access.token, config.access.tls, config.tls) == (found.token, True, found.tls)


def test_ones_own_token_is_taken(state, tmp_path):
    path = tmp_path / "token"
    path.write_text("correct-horse-battery\n")
    found = keys.keys_of(serving(*BEYOND, f"token-file={path}"))
    assert (found.token, found.token_file) == ("correct-horse-battery", path)
    assert not (state / "glsplat" / "token").exists()


@pytest.mark.check
@pytest.mark.gl
def test_a_server_beyond_this_machine_just_works(state):
    """As a person would start it: ready, secure, and the token neither on standard output nor in the log."""
    words = [sys.executable, "-m", "apps.cli", "serve", *BEYOND, "--port", "0", "--json", "--verbose", "--size", "64"]
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        ready, token = json.loads(line), read_token(state / "glsplat" / "token")
        eyes = stereo_cameras(head_matrix((0, 1.0, 2.0), (0, 0, 0, 1)), size=(64, 64))

        async def main():
            url = f"wss://localhost:{ready['port']}/ws"
            async with Client(url, token, cafile=state / "glsplat" / certificate.CERTIFICATE) as client:
                return await client.render(eyes)

        assert len(asyncio.run(main()).images()) == 2
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0 and token not in line + out + err
    assert ready["page"].startswith("https://") and ready["page"].endswith(f":{ready['port']}/vr")


def test_accounts_stand_in_for_the_token(state, tmp_path):
    user, token = new_user("ann")
    write_users(tmp_path / "users.json", {"ann": user})
    words = ("--host", "0.0.0.0", "--self-signed", "--users", tmp_path / "users.json")
    made = keys.keys_of(serving(*words))
    assert made.token is None and made.accounts is not None and made.tls is not None
    assert not (state / "glsplat" / "token").exists()
    assert command.server_config(serving(*words), made).access.accounts is made.accounts
    assert token not in repr(made)
    out = io.StringIO()
    announce(Endpoint("127.0.0.1", 8000, made), out, show_qr=True)
    assert "each account has its own" in out.getvalue() and "#token" not in out.getvalue()
    (tmp_path / "token").write_text("0123456789abcdef")
    with pytest.raises(UsageError, match="not both"):
        keys.keys_of(serving(*words, f"token-file={tmp_path / 'token'}"))
    (tmp_path / "users.json").write_text("[]")
    with pytest.raises(GlsplatError, match=r"users\.json: no file of accounts"):
        keys.keys_of(serving(*words))


def test_a_folder_that_cannot_be_written_is_one_line(monkeypatch, capsys):
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    assert "glsplat serve: /proc/nowhere/glsplat: cannot be made (" in mistake(capsys, "serve", *BEYOND)
