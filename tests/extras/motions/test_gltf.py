"""Animations in glTF and VRM: samplers against figures by hand, the choice of one of several, hostile files."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import PoseError
from glsplat.formats import load
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.motions.clips import NODES, glb, turned, write
from tests.formats.scenes import glb_parts

AT = {name: i for i, name in enumerate(JOINT_NAMES)}
QUARTER = Rotation.from_euler("z", 90, degrees=True)  # lifts the left arm


def lift(how: str = "LINEAR", times=(0.0, 1.0), bone: str = "leftUpperArm"):
    """A channel that lifts the left arm from the T-pose straight up."""
    still, up = turned(bone, Rotation.identity()).as_quat(), turned(bone, QUARTER).as_quat()
    values = np.array([still, up])
    if how == "CUBICSPLINE":
        values = np.array([[0 * still, still, 0 * still], [0 * up, up, 0 * up]]).reshape(-1, 4)
    return bone, "rotation", how, np.array(times), values


def lifted(motion, skeleton, frame: int) -> float:
    """Degrees of the left upper arm above the T-pose's."""
    world = skeleton.forward(motion.rotations[frame], motion.trans[frame])[:, :3, 3]
    arm = world[AT["left_elbow"]] - world[AT["left_shoulder"]]
    return float(np.degrees(np.arctan2(arm[1], arm[0])))


@pytest.mark.parametrize("vrm", [False, True])
@pytest.mark.parametrize(("how", "quarter"), [("LINEAR", 22.5), ("STEP", 0.0), ("CUBICSPLINE", None)])
def test_samplers(tmp_path: Path, skeleton: Skeleton, how: str, quarter: float | None, vrm: bool) -> None:
    path = glb(tmp_path / "a.bin", [{"channels": [lift(how)]}], vrm=vrm)
    motion = load_motion(path, skeleton)
    assert motion.fps == 30 and len(motion) == 31 and motion.label == "a" and motion.note == ""
    assert lifted(motion, skeleton, 0) == pytest.approx(0, abs=0.01)
    assert lifted(motion, skeleton, 30) == pytest.approx(90, abs=0.01)
    if quarter is None:  # Hermite with flat ends at a fifth: 0.104 of the way between the quaternions, then normalised
        quarter = 2 * np.degrees(np.arctan2(0.104 * np.sin(np.pi / 4), 1 - 0.104 + 0.104 * np.cos(np.pi / 4)))
        assert lifted(motion, skeleton, 6) == pytest.approx(quarter, abs=0.01)
    else:
        assert lifted(motion, skeleton, 15) == pytest.approx(2 * quarter, abs=0.01)
    others = [AT[n] for n in ("pelvis", "head", "right_shoulder", "left_hip", "right_knee")]
    assert np.abs(motion.rotations[:, others]).max() < 0.15  # at rest, up to the lean of the bones of another body


def test_the_shorter_way(tmp_path: Path, skeleton: Skeleton) -> None:
    bone, kind, how, times, values = lift()
    path = glb(tmp_path / "a.glb", [{"channels": [(bone, kind, how, times, values * [[1], [-1]])]}])
    motion = load_motion(path, skeleton)
    assert lifted(motion, skeleton, 15) == pytest.approx(45, abs=0.01)


def test_tangents_of_a_cubic_spline(tmp_path: Path, skeleton: Skeleton) -> None:
    """Hermite over 2 s: at the middle half of the way, and an eighth of 2 s times what the tangents differ by."""
    height = np.array([0, 0.95, 0])
    keys = [[9.0] * 3, height, [0, 0, 1.0], [0, 0, 3.0], height + [0, 0, 1.0], [9.0] * 3]
    channel = ("hips", "translation", "CUBICSPLINE", np.array([0.0, 2.0]), np.array(keys))
    motion = load_motion(glb(tmp_path / "a.glb", [{"channels": [channel]}]), skeleton)
    share = motion.trans[30, 2] / motion.trans[60, 2]
    assert share == pytest.approx(0.5 + 2 * (1 - 3) / 8, abs=1e-5)


def test_hips_go_where_the_file_says(tmp_path: Path, skeleton: Skeleton) -> None:
    walk = ("hips", "translation", "LINEAR", np.array([0.5, 1.5]), np.array([[0, 0.95, 0], [0, 0.95, 2.0]]))
    motion = load_motion(glb(tmp_path / "a.vrma", [{"channels": [walk]}], vrm=True), skeleton)
    assert len(motion) == 31  # from the first key to the last
    j = skeleton.joints
    leg = sum(np.linalg.norm(j[AT[f"left_{a}"]] - j[AT[f"left_{b}"]]) for a, b in (("hip", "knee"), ("knee", "ankle")))
    theirs = np.hypot(0.4, 0.01) + np.hypot(0.41, 0.02)
    assert motion.trans[30] - motion.trans[0] == pytest.approx([0, 0, 2 * leg / theirs], abs=0.02)
    assert motion.trans[0, [0, 2]] == pytest.approx([0, 0])


def test_one_of_several(tmp_path: Path, skeleton: Skeleton) -> None:
    rest = np.array([turned("head", Rotation.identity()).as_quat()] * 2)
    still = ("head", "rotation", "LINEAR", np.array([0.0, 1]), rest)
    path = glb(tmp_path / "all.glb", [{"name": "Idle", "channels": [still]}, {"name": "Rig|Up", "channels": [lift()]}])
    first = load_motion(path, skeleton)
    assert first.label == "all#Idle" and "Rig|Up" in first.note and lifted(first, skeleton, 30) < 0.01
    for choice in ("Rig|Up", "up", "1"):
        assert lifted(load_motion(path, skeleton, animation=choice), skeleton, 30) == pytest.approx(90, abs=0.01)
        chosen = load_motion(f"{path}#{choice}", skeleton)
        assert chosen.label == "all#Rig|Up" and chosen.note == "" and lifted(chosen, skeleton, 30) > 89
    for choice in ("Run", "2", "", "²"):
        with pytest.raises(PoseError, match=r"all\.glb: no animation .*Idle, Rig\|Up$"):
            load_motion(path, skeleton, animation=choice)
    (tmp_path / "b.json").write_text('[{"root_pose": [0, 0, 0]}]')
    with pytest.raises(PoseError, match="only glTF"):
        load_motion(f"{tmp_path}/b.json#1", skeleton)


def test_keys_give_the_rate(tmp_path: Path, skeleton: Skeleton) -> None:
    times = np.arange(25) / 24
    values = Rotation.concatenate([turned("leftUpperArm", QUARTER**t) for t in times]).as_quat()
    channel = ("leftUpperArm", "rotation", "LINEAR", times, values)
    motion = load_motion(glb(tmp_path / "a.glb", [{"channels": [channel]}]), skeleton)
    assert motion.fps == pytest.approx(24, rel=1e-5) and len(motion) == 25
    assert lifted(motion, skeleton, 12) == pytest.approx(45, abs=0.01)


def test_an_animation_is_a_motion_and_no_scene(tmp_path: Path) -> None:
    path = glb(tmp_path / "a.glb", [{"channels": [lift()]}])
    with pytest.raises(Exception, match=r"a\.glb: a motion, which shows nothing; give it .* --motion"):
        load(path)
    with pytest.raises(Exception, match="a motion, which shows nothing"):
        load(io.BytesIO(b"HIERARCHY\nROOT x"))
    with pytest.raises(Exception, match="the file is empty"):
        load(io.BytesIO(b""))


def broken(tree: dict, key: str) -> None:
    sampler, channel = tree["animations"][0]["samplers"][0], tree["animations"][0]["channels"][0]
    arm = tree["nodes"][NODES.index("leftUpperArm")]
    {
        "no animation": lambda: tree.update(animations=[]),
        "not a list": lambda: tree.update(animations={"a": 1}),
        "no target": lambda: channel.pop("target"),
        "sampler 7": lambda: channel.update(sampler=7),
        "accessor": lambda: sampler.update(input=99),
        "kind": lambda: sampler.update(interpolation="BEZIER"),
        "cubic": lambda: sampler.update(interpolation="CUBICSPLINE"),
        "swapped": lambda: sampler.update(input=sampler["output"], output=sampler["input"]),
        "many": lambda: tree["accessors"][0].update(count=10**9),
        "sparse": lambda: tree["accessors"][1].update(sparse={"count": 1}),
        "names": lambda: [node.pop("name") for node in tree["nodes"]],
        "circle": lambda: arm.update(children=[0]),
        "overflow": lambda: arm.update(translation=[1e300] * 3, scale=[1e300] * 3),
        "point": lambda: [node.update(translation=[0, 0, 0]) for node in tree["nodes"]],
    }[key]()


@pytest.mark.parametrize(
    "key",
    ["no animation", "not a list", "no target", "sampler 7", "accessor", "kind", "cubic", "swapped", "many"]
    + ["sparse", "names", "circle", "overflow", "point"],
)
def test_malformed(tmp_path: Path, skeleton: Skeleton, key: str) -> None:
    tree, blob = glb_parts(glb(tmp_path / "good.glb", [{"channels": [lift()]}]).read_bytes())
    broken(tree, key)
    with pytest.raises(PoseError) as caught:
        load_motion(write(tmp_path / "bad.glb", tree, blob), skeleton)
    assert str(caught.value).startswith(f"{tmp_path}/bad.glb: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("times", [(0, np.nan), (0, np.inf), (1, 0), (0, 1e30), (-1e9, 1e9), (0, 1e6)])
def test_hostile_times(tmp_path: Path, skeleton: Skeleton, times) -> None:
    path = glb(tmp_path / "bad.glb", [{"channels": [lift(times=times)]}])
    with pytest.raises(PoseError, match=r"bad\.glb: "):
        load_motion(path, skeleton)


def test_frames_are_bounded_before_anything_is_made(tmp_path: Path, skeleton: Skeleton) -> None:
    joints = "".join(f"JOINT j{i} {{ OFFSET 0 0 0 CHANNELS 0 " for i in range(1000)) + "} " * 1000
    text = f"HIERARCHY ROOT r {{ OFFSET 0 0 0 CHANNELS 1 Xrotation {joints} }}\nMOTION\n"
    (tmp_path / "bomb.bvh").write_text(text + "Frames: 100000\nFrame Time: 0.1\n" + "0 " * 100000)
    with pytest.raises(PoseError, match="at most"):
        load_motion(tmp_path / "bomb.bvh", skeleton)


def test_every_truncation_is_one_line(tmp_path: Path, skeleton: Skeleton) -> None:
    data = glb(tmp_path / "good.glb", [{"channels": [lift()]}], vrm=True).read_bytes()
    for end in range(0, len(data) - 8, 97):
        (tmp_path / "cut.vrma").write_bytes(data[:end])
        with pytest.raises(PoseError) as caught:
            load_motion(tmp_path / "cut.vrma", skeleton)
        assert "\n" not in str(caught.value)
