"""--allow-upload: what it needs before the server starts, and a real process that takes a photograph."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from apps.serve.photos import upload_config
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.models.catalogue import PHOTO
from glsplat.extras.authoring.models.store import state_of
from glsplat.extras.uploads.job import Job
from glsplat.formats import load
from tests.apps.cli import serve_words, serving

ROOT = Path(__file__).parents[3]
needs_networks = pytest.mark.skipif(
    any(state_of(model) != "here" for model in PHOTO.models), reason="needs the networks of 'glsplat models get'"
)


def test_it_is_off_unless_it_is_asked_for() -> None:
    assert upload_config(serving()) is None


@needs_networks
def test_the_folder_is_the_one_that_is_named(tmp_path: Path) -> None:
    config = upload_config(serving("--allow-upload", tmp_path))
    assert config is not None and config.folder == tmp_path and config.nice == 0
    for words in (("--host", "0.0.0.0"), ("trusted-proxy=127.0.0.1/32",)):
        shared = upload_config(serving("--allow-upload", tmp_path, *words))
        assert shared is not None and shared.nice > 0  # those who look on go first


def test_without_the_networks_it_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path))
    with pytest.raises(GlsplatError, match="run: glsplat models get"):
        upload_config(serving("--allow-upload", tmp_path))


def test_errors_that_fall_are_one_step() -> None:
    job = Job("a", "127.0.0.1")
    for step, share in (
        ("painting", 0.5),
        ("fitting splats, error 0.2000", 0.0),
        ("fitting splats, error 0.1000", 0.5),
        ("stopped after 30 of 400 steps, error 0.1000", 1.0),
        ("looking at hands, feet", 0.25),
    ):
        job.progress(step, share)
    assert job.steps == ["painting", "fitting splats", "stopped after 30 of 400 steps", "looking at hands, feet"]
    assert job.status(0)["share"] == 0.25


@pytest.mark.gl
@pytest.mark.check
@pytest.mark.shared
@pytest.mark.timeout(1200)
@needs_networks
def test_a_photograph_becomes_an_avatar(tmp_path: Path, shared_data: Path) -> None:
    capture = shared_data / "participants" / "capture" / "p01.jpg"
    folder, token = tmp_path / "avatars", tmp_path / "token"
    token.write_text("0123456789abcdef")
    token.chmod(0o600)
    options = serve_words(tmp_path, ["--port", "0", "--json", "--allow-upload", folder, f"token-file={token}"])
    process = subprocess.Popen(
        [sys.executable, "-c", "from tests.apps.serve.quick import main; main()", "serve", *options],
        cwd=ROOT,
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path / "state")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        origin = f"http://127.0.0.1:{json.loads(process.stdout.readline())['port']}"

        def ask(method: str, path: str, data: bytes | None = None) -> tuple[int, dict]:
            headers = {"Authorization": "Bearer 0123456789abcdef", "Content-Type": "image/jpeg"}
            request = urllib.request.Request(f"{origin}{path}", data, headers, method=method)
            with urllib.request.urlopen(request, timeout=60) as answer:
                body = answer.read()
                return answer.status, json.loads(body) if body else {}

        def until_ended(name: str) -> dict:
            while (told := ask("GET", f"/avatars/{name}")[1])["state"] not in ("done", "failed"):
                time.sleep(0.3)
            return told

        told = until_ended(ask("POST", "/avatars?consent=yes", b"\xff\xd8 no picture")[1]["name"])
        assert told["state"] == "failed" and told["error"].startswith("front picture: "), told
        told = until_ended(ask("POST", "/avatars?consent=yes&height=1.74", capture.read_bytes())[1]["name"])
        assert told["state"] == "done", told
        assert "fitting splats" in told["steps"] and len(told["steps"]) == len(set(told["steps"])) > 4
        name = told["name"]
        avatar = load(folder / f"{name}.glb")
        assert "agreed" in avatar.meta["consent"]["purpose"] and "photograph" in avatar.meta["source"]
        offered = {one["name"]: one for one in ask("GET", "/session")[1]["avatars"]}
        assert offered[name]["tracking"] and offered[name]["head"] and abs(offered[name]["height"] - 1.74) < 0.15
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"{origin}/avatars/{name}", timeout=60)  # without the token
        assert ask("DELETE", f"/avatars/{name}")[0] == 204 and not list(folder.iterdir())
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=60)
        assert process.returncode == 0 and not log.strip(), log
    finally:
        process.kill()
        process.wait()
