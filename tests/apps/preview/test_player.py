"""The preview's clock and poses, its text, and what it makes of dropped files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from apps.preview.files import motion_names, read_dropped
from apps.preview.overlay import Overlay
from apps.preview.player import Player
from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.formats import save
from glsplat.motion.motion import Motion
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.scenes import cloud, limb


def swing(frames: int = 10, fps: float = 20.0) -> Motion:
    rotations = np.zeros((frames, 4, 3))
    rotations[:, 1, 2] = np.linspace(0, 0.9, frames)
    return Motion(fps, rotations, np.zeros((frames, 3)), limb().skeleton.names, "swing")


def test_clock() -> None:
    player = Player(limb().skeleton)
    assert not player.moving and not player.pose().rotations.any()
    player.play(swing())
    assert player.moving and player.frame == 0
    player.advance(0.15)
    assert player.frame == 3 and player.pose().rotations[1, 2] == pytest.approx(0.3)
    player.advance(0.5)  # round once
    assert player.frame == 3
    player.playing = False
    player.advance(0.2)
    assert player.frame == 3
    player.step(1)
    assert player.frame == 4 and player.pose().rotations[1, 2] == pytest.approx(0.4)
    player.step(-5)
    assert player.frame == 9 and not player.playing
    player.hold(Pose.zero(4))
    player.step(1)
    assert player.motion is None and not player.pose().rotations.any()


def test_joints_are_turned_on_top_of_the_motion() -> None:
    player = Player(limb().skeleton)
    player.play(swing())
    player.turn((0, 0, 1), 30)  # nothing is selected
    assert not player.pose().rotations.any()
    player.select(-1)
    assert player.joint_name == "joint3"
    player.select(1)
    player.select(1)
    assert player.joint_name == "joint1"
    player.turn((0, 0, 1), 30)
    player.turn((1, 0, 0), 20)
    player.advance(0.1)
    expected = Rotation.from_rotvec([0, 0, 0.2]) * Rotation.from_euler("ZX", [30, 20], degrees=True)
    assert np.allclose(player.pose().rotations[1], expected.as_rotvec())
    assert player.turned == pytest.approx(35.9, abs=0.1) and not player.pose().rotations[2].any()
    player.straighten()
    assert player.pose().rotations[1, 2] == pytest.approx(0.2) and player.turned == 0


def test_overlay_changes_only_when_there_is_something_to_read() -> None:
    asked = []
    overlay = Overlay()

    def numbers() -> list[tuple[str, ...]]:
        asked.append(1)
        return [(str(len(asked)),)]

    assert overlay.lines(numbers) == () and not asked
    overlay.numbers = True
    assert [overlay.lines(numbers) for _ in range(50)] == [(("1",),)] * 50
    overlay.renew()
    assert overlay.lines(numbers) == (("2",),)
    overlay.say("hello")
    assert overlay.lines(numbers)[-1] == ("hello",) and ("hello",) not in overlay.lines(numbers, live=False)
    assert not overlay.advance(1.0) and overlay.advance(5.0) and not overlay.advance(1.0)
    assert ("hello",) not in overlay.lines(numbers)


def test_dropped_files_are_told_apart_by_content(tmp_path: Path) -> None:
    skeleton = limb().skeleton
    pose = {"joints": {"joint1": [0, 0, 0.5]}}
    (tmp_path / "pose.txt").write_text(json.dumps(pose))
    (tmp_path / "motion").write_text(json.dumps({"fps": 10, "frames": [pose, pose]}))
    (tmp_path / "list").write_text(json.dumps([pose, pose, pose]))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "1.json").write_text(json.dumps(pose))
    save(limb(), tmp_path / "limb.gltf")
    save(cloud(), tmp_path / "cloud.ply")
    kinds = {"pose.txt": Pose, "motion": Motion, "list": Motion, "folder": Motion}
    for name, kind in {**kinds, "limb.gltf": Avatar, "cloud.ply": Splats}.items():
        what = read_dropped(str(tmp_path / name), skeleton)
        assert isinstance(what.content, kind) and what.label == name
    with pytest.raises(GlsplatError, match="no skeleton to move"):
        read_dropped(str(tmp_path / "motion"), None)
    assert motion_names(skeleton) == [] and motion_names(None) == []  # embedded ones are for their own rig
    path = tmp_path / "bad.bin"
    for text in (b"", b"{", b"[1]", b'{"frames": 3}', b"PK\x03\x04", b"HIERARCHY", b"\xff\xfe nonsense", b"[" * 9999):
        path.write_bytes(text)
        with pytest.raises(GlsplatError) as error:
            read_dropped(str(path), skeleton)
        assert "bad.bin" in str(error.value) and "\n" not in str(error.value)


def test_a_recording_of_head_and_hands_becomes_a_motion(tmp_path: Path) -> None:
    skeleton = default_avatar().skeleton
    still = {"head": [0, 1.6, 0.1, 0, 0, 0, 1], "left": None, "right": None}
    times = [0.0, 0.02, 0.04, 0.03, 0.06, 0.16, 0.18]  # one back, and a gap
    (tmp_path / "live.jsonl").write_text("\n".join(json.dumps({**still, "t": t}) for t in times))
    what = read_dropped(str(tmp_path / "live.jsonl"), skeleton)
    assert isinstance(what.content, Motion) and what.content.fps == pytest.approx(50)
    assert len(what.content) == 10 and what.content.names == skeleton.names
    (tmp_path / "bad.jsonl").write_text('{"head": [1, 2]}')
    (tmp_path / "empty.jsonl").write_text("\n")
    for name, text in (("bad", "line 1: "), ("empty", "found none")):
        with pytest.raises(GlsplatError, match=rf"{name}\.jsonl.*{text}"):
            read_dropped(str(tmp_path / f"{name}.jsonl"), skeleton)
    with pytest.raises(GlsplatError):
        read_dropped(str(tmp_path / "live.jsonl"), limb().skeleton)
