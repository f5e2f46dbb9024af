"""A rigged mesh wherever a command takes an avatar, and a standing one where it does not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from apps.args import driven, load_avatar
from apps.cli import main
from apps.preview.player import players_of
from apps.replay.command import load_drive
from apps.serve.command import other_avatars
from apps.serve.options import ServeOptions
from apps.tracking.options import skeleton_of
from apps.usage import UsageError
from glsplat.formats import load_scene, save
from tests.scene.people import boxes, save_person
from tests.scenes import cloud

pytestmark = pytest.mark.extra(name="formats")

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """me.npz, room.obj, cloud.ply, and a scene of the first two."""
    path = tmp_path_factory.mktemp("people")
    save_person(boxes(), path / "me.npz")
    (path / "room.obj").write_text(OBJ)
    save(cloud(100), path / "cloud.ply")
    items = [{"path": "room.obj", "translation": [0, 0, -1]}, {"path": "me.npz", "translation": [0.1, 0, 0]}]
    (path / "both.json").write_text(json.dumps({"version": 1, "items": items}))
    return path


@pytest.mark.gl
def test_render(folder: Path, tmp_path: Path) -> None:
    """A pose and a motion find the person, beside a room as well."""
    pictures = []
    for more in ([], ["--motion", "walk", "--frame", "20"]):
        out = tmp_path / f"{len(pictures)}.npy"
        assert main(["render", str(folder / "both.json"), *more, "--size", "96x96", "-o", str(out)]) == 0
        pictures.append(np.load(out))
    assert pictures[0][..., 3].any() and (pictures[0] != pictures[1]).any()


def test_players(folder: Path) -> None:
    """The preview's poses go to the mesh with joints."""
    for scene in ("me.npz", "both.json"):
        player, _ = players_of(load_scene(folder / scene))
        assert player is not None and len(player.skeleton) == 55
    assert players_of(load_scene(folder / "room.obj"))[0] is None
    with pytest.raises(UsageError, match=r"needs an avatar \(a .glb with a skin, a rigged mesh\)"):
        driven(load_scene(folder / "room.obj"), "--pose")


def test_what_an_option_takes_for_an_avatar(folder: Path) -> None:
    me = folder / "me.npz"
    assert len(load_avatar(me, "--avatar").skeleton) == len(skeleton_of(str(me))) == 55
    named = other_avatars(ServeOptions(avatar=(me,)))
    assert list(named) == ["me"]
    drive, seconds = load_drive("walk", str(me))
    assert seconds > 0.5 and drive.at(0.1).pose is not None
    tracked, _ = load_drive("walk", str(me), tracking=True)
    assert tracked.at(0.1).tracking is not None
    mistakes = {
        "room.obj": "a mesh without joints to move",
        "cloud.ply": "splats without a skeleton",
        "both.json": "a scene file",
        "none.glb": "no such file",
    }
    for name, found in mistakes.items():
        with pytest.raises(UsageError, match=f"--avatar .*{name}: .*{found}"):
            load_avatar(folder / name, "--avatar")
