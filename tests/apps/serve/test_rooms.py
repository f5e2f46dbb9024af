"""serve --room and replay --room: what they take, what they refuse, and a crowd on a fake renderer."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from apps.args import open_scene
from apps.replay import command as replay
from apps.serve import command as serve
from apps.serve.command import open_rooms
from apps.serve.options import RoomChoice, room_choice
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.messages import Request
from glsplat.net.server import ServerConfig
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.apps.cli import parsed, serving
from tests.browser.served import Served
from tests.net.conftest import FakeBackend

RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))


class Solver:
    def solve(self, request: Request, now: float) -> Solved:
        return Solved(Pose.zero(55))


def test_what_a_room_is_called_and_holds() -> None:
    assert room_choice("lab") == RoomChoice("lab", 8, None)
    assert room_choice("hall:20=a=b/scene.json") == RoomChoice("hall", 20, "a=b/scene.json")
    assert room_choice("Große Halle:1") == RoomChoice("Große Halle", 1, None)
    for wrong in ("", "../lab", "lab/x", ":3", "lab:0", "lab:65", "a" * 33, "=scene.json", "lab:x"):
        with pytest.raises(argparse.ArgumentTypeError):
            room_choice(wrong)


def test_what_stands_in_a_room(tmp_path: Path) -> None:
    (tmp_path / "empty.json").write_text('{"version": 1, "items": []}')
    args = serving("--room", "lab", "--room", f"hall:2={tmp_path}/empty.json")
    rooms = open_rooms(args)
    assert list(rooms) == ["lab", "hall"] and len(rooms["lab"].scene) == 0
    config = serve.server_config(args)
    assert dict(config.rooms) == {"lab": 8, "hall": 2}
    assert len(open_scene(args).scene) == 1  # the avatar that people wear


@pytest.mark.extra(name="rooms")
def test_a_crowd_is_one_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    backend = FakeBackend()
    offered = [AvatarInfo(name="ann", skeleton=RIG, solver=lambda height, span: Solver(), parts=frozenset(["head"]))]
    with Served(backend, ServerConfig(port=0, rooms={"lab": 3}), offered=offered) as served:
        url = f"ws://127.0.0.1:{served.port}/ws"
        words = ("--url", url, "--room", "lab", "--size", "32x32", "--fps", "30")
        crowd = ("--people", "3", "--name", "guest", "--frames", "15", "--json")
        assert replay.run(parsed(replay, *words, *crowd)) == 0
        out = json.loads(capsys.readouterr().out)
        assert [one["name"] for one in out] == ["guest 1", "guest 2", "guest 3"]
        assert all(one["shown"] > 0 and one["errors"] == 0 for one in out)
        people = {one.name for request in backend.drawn if request.room for one in request.room.people}
        assert people == {"guest 1", "guest 2", "guest 3"}
        assert all(request.options.hide == ("head",) for request in backend.drawn)
        # each is elsewhere in the recording
        heads = {tuple(np.round(request.cameras[0].position, 4)) for request in backend.drawn}
        assert len(heads) > 3
        assert replay.run(parsed(replay, *words, "--frames", "5", "--save", str(tmp_path / "one.png"))) == 0
        text = capsys.readouterr().out
        assert 'room "lab"' in text and "you " in text and (tmp_path / "one.png").is_file()
