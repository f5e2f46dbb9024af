"""The container file: what it installs and copies is what there is, and where docker works it is built and run."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest

from apps.serve import command as serve
from tests import needs
from tests.apps.cli import serving

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")


def test_it_installs_what_drawing_needs():
    last = TEXT[TEXT.rindex("FROM ") :]
    needed = {name for need in needs.NEEDS.values() if need.tier == "run" for name in need.packages} - {"python3-venv"}
    assert needed <= set(last.split())
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert {"!apps", "!glsplat", "!pyproject.toml", "!README.md", "!LICENSE"} <= set(ignored)
    assert re.search(r"^USER [1-9]\d*$", last, re.M)  # a number: Kubernetes can see that it is not root


def test_its_command_is_one_that_serve_understands():
    words = json.loads(re.search(r"^CMD (\[.*\])$", TEXT, re.M)[1])
    option, path = re.search(r"echo '(.*)' > (/etc/glsplat/server.toml)", TEXT).groups()
    assert words[0] == "serve" and words[-2:] == ["--config", path]
    options = serving(*words[1:-2], option.replace(" = ", "=").replace('"', ""))
    config = serve.server_config(options)
    assert options.log_format == "json"
    assert f"EXPOSE {config.port}" in TEXT and config.access.host == "0.0.0.0"


def test_it_builds_and_serves():
    if not os.environ.get("GLSPLAT_TEST_DOCKER"):
        pytest.skip("building an image takes minutes and a registry: set GLSPLAT_TEST_DOCKER=1 to do it")
    docker = needs.program("docker")
    if docker is None or subprocess.run([docker, "info"], capture_output=True, timeout=60).returncode:
        pytest.skip("no docker, or its daemon does not answer")
    subprocess.run([docker, "build", "-q", "-t", "glsplat-test", str(ROOT)], check=True, timeout=280)
    start = [docker, "run", "-d", "--rm", "-p", "127.0.0.1::8000", "--cap-drop", "ALL"]
    container = subprocess.run(
        [*start, "--tmpfs", "/tmp", "glsplat-test"], check=True, capture_output=True, text=True
    ).stdout.strip()
    try:
        port = subprocess.run([docker, "port", container, "8000"], check=True, capture_output=True, text=True)
        url = f"http://{port.stdout.split()[0]}/healthz"
        for _ in range(120):
            try:
                assert urllib.request.urlopen(url, timeout=60).read() == b"ok"
                return
            except OSError:
                time.sleep(0.5)
        pytest.fail(f"{url} does not answer")
    finally:
        subprocess.run([docker, "stop", "-t", "10", container], capture_output=True, timeout=60)
