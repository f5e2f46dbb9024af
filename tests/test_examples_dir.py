"""docs/examples: each program runs, says what it made, stays short, and is linked where people look."""

from __future__ import annotations

import asyncio
import runpy
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.formats import save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.net.backends.server import make_server
from glsplat.net.server import ServerConfig
from tests.skinning.avatars import part

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = sorted((ROOT / "docs" / "examples").glob("*.py"))

pytestmark = pytest.mark.gl

Run = Callable[..., str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs one of them as a user does, in an empty folder; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(ROOT / "docs" / "examples" / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_they_are_six_short_and_linked() -> None:
    assert len(PROGRAMS) == 6
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/python.md")]
    for program in PROGRAMS:
        assert len(program.read_text(encoding="utf-8").splitlines()) <= 60
        assert all(f"examples/{program.name}" in page for page in pages), program.name


def test_one_picture(run: Run, tmp_path: Path) -> None:
    save(part(default_avatar(), np.arange(0, 40000, 2)), tmp_path / "me.glb")
    assert "the avatar covers" in run("one_picture.py", "out.png", "me.glb")
    picture = cv2.imread("out.png", cv2.IMREAD_UNCHANGED)
    assert picture.shape == (640, 480, 4) and 0.05 < (picture[..., 3] > 127).mean() < 0.5


def test_stereo_pair(run: Run) -> None:
    said = run("stereo_pair.py")
    assert "eyes 63 mm apart" in said
    left, right = np.split(cv2.imread("pair.png"), 2, axis=1)
    assert (left != right).any() and min(left.max(), right.max()) > 100


def test_two_people(run: Run) -> None:
    said = run("two_people.py")
    assert "3 items" in said
    picture = cv2.imread("people.png")
    assert picture.shape == (480, 640, 3) and (picture.max(axis=2) > 20).mean() > 0.7
    # both are there: each half differs from the bare wall
    assert all(half.std() > 20 for half in np.split(picture, 2, axis=1))


@pytest.fixture
def url() -> Iterator[str]:
    """A server of the default avatar."""
    ready, state = threading.Event(), {}

    async def main() -> None:
        server = make_server(default_avatar(), ServerConfig(port=0), own_process=False)
        await server.start()
        state.update(url=server.url, loop=asyncio.get_running_loop(), end=asyncio.Event())
        ready.set()
        await state["end"].wait()
        await server.stop()

    thread = threading.Thread(target=asyncio.run, args=(main(),))
    thread.start()
    assert ready.wait(30)
    yield state["url"]
    state["loop"].call_soon_threadsafe(state["end"].set)
    thread.join(20)


def test_drive_a_server(run: Run, url: str) -> None:
    said = run("drive_server.py", url, "out.jpg")
    assert said.count("bytes; ms:") == 5 and cv2.imread("out.jpg").shape == (256, 256, 3)


def test_without_a_server_it_says_so(run: Run) -> None:
    with pytest.raises(SystemExit, match=r"127\.0\.0\.1:9"):
        run("drive_server.py", "ws://127.0.0.1:9/ws")


def test_a_custom_solver(run: Run) -> None:
    said = run("custom_solver.py")
    assert float(said.split("neck [")[1].split(",")[0]) > 0.3 and "solver_failed" not in said
    assert cv2.imread("solved.png").max() > 100


def test_score_an_avatar(run: Run, tmp_path: Path) -> None:
    """On a mesh that a test can make: the embedded body's splats against a wall of another colour score badly."""
    avatar = part(default_avatar(), np.arange(0, 40000, 20))
    save(avatar, tmp_path / "me.glb")
    mesh = panel(avatar.skeleton)
    ok, png = cv2.imencode(".png", mesh.parts[0].texture)
    assert ok
    np.savez(
        tmp_path / "person.npz",
        vertices=mesh.vertices,
        joints=avatar.skeleton.joints,
        parents=avatar.skeleton.parents,
        joint_names=np.array(avatar.skeleton.names),
        skin_indices=mesh.joints,
        skin_weights=mesh.weights,
        part_names=np.array(["panel"]),
        faces_0=mesh.parts[0].faces,
        faces_uv_0=np.zeros_like(mesh.parts[0].faces),
        uv_0=np.full((1, 2), 0.5),
        texture_0=png.ravel(),
    )
    said = run("score_avatar.py", "me.glb", "person.npz", 1)
    assert said.count("SSIM") == 2 and 1 < float(said.split("worst ")[1].split()[0]) < 25


def panel(skeleton) -> RiggedMesh:
    """A green rectangle of a person's height that rides the pelvis."""
    corners = np.array([[-0.4, 0, 0], [0.4, 0, 0], [0.4, 1.7, 0], [-0.4, 1.7, 0]])
    texture = np.full((4, 4, 4), (60, 200, 60, 255), np.uint8)
    green = MeshPart("panel", np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.full((2, 3, 2), 0.5), texture)
    return RiggedMesh(corners, skeleton, np.zeros((4, 1), np.int64), np.ones((4, 1)), (green,))
