"""The file of docs/deploying.md, "TLS for twenty users": a real server starts by it, and takes twenty and no more."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import ProtocolError
from glsplat.net.accounts.users import new_user, write_users
from glsplat.net.client import Client
from glsplat.net.guard.certificate import CERTIFICATE, kept_certificate

ROOT = Path(__file__).parents[3]


def written(folder: Path, **lines: str) -> Path:
    """The page's file with the embedded avatar, and with paths and lines of the test's own."""
    page = (ROOT / "docs" / "deploying.md").read_text(encoding="utf-8")
    (block,) = (b for b in re.findall(r"```toml\n(.*?)```", page, re.S) if "max-clients = 20" in b)
    for key, value in {"scene": "", "size": 'size = "64x64"', **lines}.items():
        block, count = re.subn(rf"(?m)^{key} = .*\n", value + "\n", block)
        assert count == 1, key
    path = folder / "twenty.toml"
    path.write_text(block)
    return path


@pytest.mark.gl
@pytest.mark.check
def test_twenty_come_in_by_it_and_the_next_is_told_so(tmp_path: Path) -> None:
    kept_certificate(tmp_path, ("localhost",))
    pem = next(path for path in tmp_path.glob("*.pem") if path.name != CERTIFICATE)
    made = [new_user(f"user{n}") for n in range(21)]
    write_users(tmp_path / "users.json", {user.name: user for user, _ in made})
    lines = {"tls-cert": str(pem), "tls-key": str(pem), "users": f"{tmp_path}/users.json"}
    config = written(tmp_path, **{key: f'{key} = "{value}"' for key, value in lines.items()})
    command = [sys.executable, "-m", "apps.cli", "serve", "--config", config, "--port", "0", "--json"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    eyes = stereo_cameras(head_matrix((0, 1.0, 2.0), (0, 0, 0, 1)), size=(64, 64))

    async def main(port: int) -> None:
        """All by one address, as behind a router."""

        def client(token: str) -> Client:
            return Client(f"wss://localhost:{port}/ws", token, cafile=tmp_path / CERTIFICATE, timeout=60)

        clients = [client(token) for _, token in made]
        for one in clients[:20]:
            await one.connect()
        with pytest.raises(ProtocolError, match=r"503|full"):
            await clients[20].connect()
        replies = await asyncio.gather(*(one.render(eyes) for one in clients[:20]))
        assert all(len(reply.images()) == 2 for reply in replies)
        for one in clients[:20]:
            await one.close()

    try:
        line = process.stdout.readline()
        assert line, process.communicate(timeout=60)[1]
        asyncio.run(main(json.loads(line)["port"]))
        process.send_signal(signal.SIGINT)
        assert "Traceback" not in process.communicate(timeout=60)[1]
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
