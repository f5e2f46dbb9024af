"""The core runs without any extra: ``render``, the preview's viewer, a golden, a server and a client."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

REFUSING = """
import importlib.abc, sys

class Refusing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.startswith("glsplat.extras."):
            raise ModuleNotFoundError(f"hidden: {name}", name=name)

sys.meta_path.insert(0, Refusing())
"""

# the extra that a command names where there is none; the others print their help, and look for extras later
NEEDED = {
    "page": "browser",
    "bench": "evaluate",
    "users": "accounts",
    "models": "authoring",
    "study": "study",
    "tracking": "evaluate",
    "evaluate": "evaluate",
    "watermark": "authoring",
    "report": "evaluate",
    "selftest": "evaluate",
    "inspect": "consent",
}

COMMAND = """
from apps.cli import main
options = ["--motion", "walk", "--frame", "5", "--stereo", "--size", "64x64"]
assert main(["render", *options, "-o", sys.argv[1]]) in (0, None)
"""

GOLDEN = """
import json
import cv2, numpy as np
import glsplat
from glsplat.config import with_fields
from tests.golden.test_goldens import CASES, FOLDER
name = "sh3_pair"
scene, cameras, pose, config = CASES[name]()
size = cameras[0].width, cameras[0].height
settings = with_fields(glsplat.RenderConfig(), target="32f", shape="triangle", **config)
with glsplat.Renderer(scene, size=size, views=len(cameras), config=settings) as renderer:
    image = np.concatenate(list(renderer.render(cameras, pose)), axis=1)
    driver = renderer.driver
expected = cv2.cvtColor(cv2.imread(str(FOLDER / f"{name}.png"), cv2.IMREAD_UNCHANGED), cv2.COLOR_BGRA2RGBA)
error = np.abs(image.astype(int) - expected).max(axis=-1)
same = json.loads((FOLDER / f"{name}.json").read_text())["driver"] == driver
assert image.any() and (error.max() <= 1 if same else (error > 5).mean() <= 0.001)
"""

VIEWER = """
import glsplat
from apps.preview.cameras import Options
from apps.preview.viewer import Viewer
context = glsplat.create_context()
with context:
    options = Options(eye=(0.4, 0.3, 3.0), target=(0.7, 0.0, 0.0), background=(0.1, 0.2, 0.3))
    viewer = Viewer(glsplat.default_avatar(), context, (64, 48), options, "scene")
    for layout in "123":
        viewer.press(layout)
        assert viewer.capture().any()
    viewer.release()
context.release()
"""


SERVER = """
import asyncio
import glsplat
from glsplat.camera import head_matrix
from glsplat.net import Client, ServerConfig, gl_server

async def main():
    server = gl_server(glsplat.default_avatar(), ServerConfig(port=0), own_process=False)
    await server.start()
    try:
        async with Client(server.url) as client:
            eyes = glsplat.stereo_cameras(head_matrix([0, 1.6, 0], [0, 0, 0, 1]), size=(64, 64))
            reply = await client.render(eyes, tracking={"head": [0, 1.7, -2, 0, 0, 0, 1]})
            assert all(image.any() for image in reply.images())
            try:
                await client.poses(pose=glsplat.Pose.zero())
            except glsplat.errors.ProtocolError as error:
                assert "want: pose needs glsplat.extras.browser, which is not installed" in str(error), error
            else:
                raise AssertionError("poses without extras/browser")
    finally:
        await server.stop()
asyncio.run(main())
"""


@pytest.mark.gl
@pytest.mark.parametrize("program", [COMMAND, GOLDEN, VIEWER, SERVER], ids=["render", "golden", "preview", "serve"])
def test_the_core_runs_alone(program: str, tmp_path: Path) -> None:
    picture = tmp_path / "pair.png"
    command = [sys.executable, "-c", REFUSING + program, str(picture)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    assert program is not COMMAND or picture.stat().st_size > 500


@pytest.mark.gl
@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("render --speech hello.wav -o out.mp4", "render: --speech needs glsplat.extras.speech"),
        ("preview --xr", "preview: --xr needs glsplat.extras.openxr"),
        ("serve", "serve needs glsplat.extras.consent"),
        ("users list users.json", "users needs glsplat.extras.accounts"),
    ],
    ids=["speech", "xr", "serve", "users"],
)
def test_an_option_without_its_extra_is_refused_in_one_line(words: str, line: str) -> None:
    program = "from apps.cli import main\nsys.exit(main(sys.argv[1:]))\n"
    command = [sys.executable, "-c", REFUSING + program, *words.split()]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert (done.returncode, done.stderr) == (1, f"glsplat {line}, which is not installed\n")


def test_a_command_names_the_extra_that_it_lacks() -> None:
    program = """
from apps.cli import COMMANDS, main
for words in ([], *([name] for name in COMMANDS)):
    try:
        assert main([*words, "--help"]) == 1
    except SystemExit as end:
        assert end.code == 0
"""
    command = [sys.executable, "-c", REFUSING + program]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0 and done.stdout.startswith("usage: glsplat ")
    lines = [f"glsplat {name} needs glsplat.extras.{extra}, which is not installed" for name, extra in NEEDED.items()]
    assert sorted(done.stderr.splitlines()) == sorted(lines)
