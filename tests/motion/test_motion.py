"""Motions: reading every layout, refusing what is wrong with one line, interpolation, the embedded ones."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import PoseError
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

NAMES = {name: i for i, name in enumerate(JOINT_NAMES)}


@pytest.fixture(scope="module")
def skeleton() -> Skeleton:
    """A T-posed stick figure on the SMPL-X rig: left is +x, y up, facing +z, ankles at 0.08 m."""
    at = np.zeros((55, 3))
    place = {"pelvis": (0, 0.95, 0), "spine1": (0, 1.05, 0), "spine2": (0, 1.2, 0), "spine3": (0, 1.3, 0)}
    place |= {"neck": (0, 1.5, 0), "head": (0, 1.6, 0)}
    for side, sign in (("left", 1), ("right", -1)):
        place |= {f"{side}_hip": (0.1 * sign, 0.9, 0), f"{side}_knee": (0.1 * sign, 0.5, 0)}
        place |= {f"{side}_ankle": (0.1 * sign, 0.08, 0), f"{side}_foot": (0.1 * sign, 0.02, 0.13)}
        place |= {f"{side}_collar": (0.05 * sign, 1.42, 0), f"{side}_shoulder": (0.18 * sign, 1.42, 0)}
        place |= {f"{side}_elbow": (0.45 * sign, 1.42, 0), f"{side}_wrist": (0.7 * sign, 1.42, 0)}
    for name, i in NAMES.items():
        at[i] = place.get(name, at[PARENTS[i]] + (0.03 * np.sign(at[PARENTS[i]][0]), 0, 0.01))
    return Skeleton.from_joints(JOINT_NAMES, PARENTS, at)


def frame(**keys):
    return {"root_pose": [0, 0, 0], "trans": [0, 0, 0], **keys}


def refused(path, skeleton, *words, **options):
    with pytest.raises(PoseError) as caught:
        load_motion(path, skeleton, **options)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    for word in words:
        assert word in message, message


def test_folder_of_frames_in_numeric_order(tmp_path, skeleton):
    for i in (10, 9, 1):
        (tmp_path / f"{i}.json").write_text(json.dumps(frame(trans=[i, 0, 0], betas=[0] * 10)))
    motion = load_motion(tmp_path, skeleton)
    assert motion.trans[:, 0].tolist() == [1, 9, 10]
    assert motion.fps == 30 and len(motion) == 3


def test_one_file_list_object_and_single_pose(tmp_path, skeleton):
    file = tmp_path / "m.json"
    file.write_text(json.dumps({"fps": 12.5, "frames": [frame(), frame(trans=[0, 1, 0])]}))
    assert load_motion(file, skeleton).fps == 12.5
    assert load_motion(file, skeleton, fps=60).fps == 60
    file.write_text(json.dumps([frame(), frame(), frame()]))
    assert len(load_motion(file, skeleton)) == 3
    file.write_text(json.dumps(frame(body_pose=[0.1] * 63)))
    assert load_motion(file, skeleton).pose(0).rotations[1:22] == pytest.approx(0.1)


def test_video_frames_stand_up(tmp_path, skeleton):
    """LHM's files are in the camera's frame (y down, z away): such a person stands upright and faces +z here."""
    upright = Rotation.from_rotvec([np.pi, 0, 0]).as_rotvec().tolist()
    for i in range(3):
        data = frame(root_pose=upright, trans=[0.1, 0.2, 3 + 0.1 * i], focal=[1000, 1000], princpt=[1, 1])
        (tmp_path / f"{i:05d}.json").write_text(json.dumps(data))
    motion = load_motion(tmp_path, skeleton)
    frames = skeleton.forward(motion.rotations[0], motion.trans[0])
    assert frames[NAMES["head"], 1, 3] > frames[NAMES["pelvis"], 1, 3] + 0.5
    assert frames[0, :3, :3] @ [0, 0, 1] == pytest.approx([0, 0, 1], abs=1e-9)
    assert frames[[NAMES["left_ankle"], NAMES["right_ankle"]], 1, 3] == pytest.approx(0.08, abs=1e-6)
    assert motion.trans[2, 2] - motion.trans[0, 2] == pytest.approx(-0.2)  # away from the camera


def test_interpolation_is_slerp_and_loops():
    rotations = np.zeros((4, 55, 3))
    rotations[1, 5] = (0, 0, np.pi * 0.9)
    rotations[2, 5] = (0, 0, -np.pi * 0.9)  # 0.2 pi further, the short way
    motion = Motion(10.0, rotations, np.arange(12.0).reshape(4, 3))
    assert motion.at(0.05).rotations[5] == pytest.approx([0, 0, 0.45 * np.pi])
    half = Rotation.from_rotvec(motion.at(0.15).rotations[5].copy()).as_matrix()
    assert half == pytest.approx(Rotation.from_rotvec([0, 0, np.pi]).as_matrix(), abs=1e-9)
    assert motion.at(0.05).trans == pytest.approx([1.5, 2.5, 3.5])
    assert motion.at(0.4).trans == pytest.approx(motion.at(0).trans)
    assert motion.at(-0.1).trans == pytest.approx(motion.pose(3).trans)
    assert motion.at(0.35).trans == pytest.approx([4.5, 5.5, 6.5])  # half way from the last back to the first
    assert motion.at(99, loop=False).trans == pytest.approx([9, 10, 11])
    assert motion.at(-5, loop=False).trans == pytest.approx([0, 1, 2])
    assert motion.duration == pytest.approx(0.4)


def test_expressions_play_and_mix(tmp_path, skeleton):
    faces = [{"jawOpen": 0.0}, {"jawOpen": 1.0, "cheekPuff": 0.5}]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"fps": 10, "frames": [frame(expression=face) for face in faces]}))
    motion = load_motion(path, skeleton)
    assert motion.pose(0).expression == {} and motion.pose(-1).expression == faces[1]
    assert motion.at(0.05).expression == pytest.approx({"jawOpen": 0.5, "cheekPuff": 0.25})
    assert motion.at(0.15).expression == pytest.approx({"jawOpen": 0.5, "cheekPuff": 0.25})  # on the way back
    assert motion.resampled(20).pose(1).expression == pytest.approx({"jawOpen": 0.5, "cheekPuff": 0.25})
    fitted = {"fps": 10, "joints": skeleton.joints.tolist(), "frames": [frame(expression=face) for face in faces]}
    path.write_text(json.dumps(fitted))
    assert load_motion(path, skeleton).pose(1).expression == faces[1]
    path.write_text(json.dumps([frame(), frame()]))
    assert load_motion(path, skeleton).expressions == ()
    path.write_text(json.dumps([frame(expression={"jawOpen": "x"})]))
    refused(path, skeleton, "frame 0", "jawOpen")


def test_resampling_keeps_the_path():
    turn = np.linspace(0, 3, 61)
    rotations = np.zeros((61, 55, 3))
    rotations[:, 3, 0] = turn
    slow = Motion(60.0, rotations, np.zeros((61, 3))).resampled(20.0)
    assert len(slow) == 21 and slow.fps == 20
    assert slow.rotations[:, 3, 0] == pytest.approx(np.linspace(0, 3, 21))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", ["at least one frame"]),
        ('{"fps": 30, "frames": []}', ["at least one frame"]),
        ('{"fps": 0, "frames": [{"trans": [0,0,0], "root_pose": [0,0,0]}]}', ["frame rate"]),
        ('{"fps": "x", "frames": [{"root_pose": [0,0,0]}]}', ["fps"]),
        ('{"frames": {"a": 1}}', ["list"]),
        ('[{"root_pose": [0,0,0]}, {"body_pose": [0,0]}]', ["frame 1", "body_pose", "21 x 3"]),
        ('[{"root_pose": [0,0,NaN]}]', ["frame 0", "finite"]),
        ('[{"root_pose": [0,95,0]}]', ["frame 0", "radians"]),
        ('[{"pose": [1]}]', ["frame 0", "root_pose"]),
        ("[3]", ["frame 0", "object"]),
        ('[{"root_pose": [0,0,0]}', ["JSON"]),
    ],
)
def test_wrong_json(tmp_path, skeleton, text, words):
    (tmp_path / "bad.json").write_text(text)
    refused(tmp_path / "bad.json", skeleton, *words)


def test_wrong_folder_and_names(tmp_path, skeleton):
    refused(tmp_path, skeleton, "none")
    (tmp_path / "00001.json").write_text("{")
    with pytest.raises(PoseError, match=r"00001\.json"):
        load_motion(tmp_path, skeleton)
    refused(tmp_path / "absent.bvh", skeleton, "cannot be read")
    refused("no-such-motion", skeleton, "idle", "walk")


def test_other_rigs_take_named_joints_only(tmp_path, skeleton):
    other = Skeleton.from_joints(("a", "b"), [-1, 0], np.zeros((2, 3)))
    (tmp_path / "m.json").write_text('[{"joints": {"b": [0, 1, 0]}, "trans": [1, 0, 0]}]')
    motion = load_motion(tmp_path / "m.json", other)
    assert motion.names == ("a", "b") and motion.rotations[0, 1] == pytest.approx([0, 1, 0])


@pytest.mark.parametrize("name", embedded_motions())
def test_embedded_motions_loop_smoothly(name, skeleton):
    motion = load_motion(name, skeleton)
    assert motion.label == name and motion.duration >= 1
    turns = Rotation.from_rotvec(motion.rotations.reshape(-1, 3)).as_matrix().reshape(len(motion), 55, 3, 3)
    step = np.swapaxes(turns, -1, -2) @ np.roll(turns, -1, axis=0)  # includes the last frame to the first
    speed = Rotation.from_matrix(step.reshape(-1, 3, 3)).magnitude().reshape(len(motion), 55) * motion.fps
    assert speed.max() < 9.0  # rad/s
    change = np.abs(np.roll(speed, -1, axis=0) - speed).max() * motion.fps
    assert change < 120.0  # rad/s^2
    assert np.abs(np.roll(motion.trans, -1, axis=0) - motion.trans).max() < 0.02


@pytest.mark.parametrize("name", embedded_motions())
def test_embedded_motions_stand_on_the_floor(name, skeleton):
    motion = load_motion(name, skeleton)
    feet = [NAMES[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")]
    rest = skeleton.joints[feet, 1]
    for rotations, trans in zip(motion.rotations[::5], motion.trans[::5], strict=True):
        frames = skeleton.forward(rotations, trans)
        lowest = (frames[feet, 1, 3] - rest).min()
        assert -0.03 < lowest < 0.03
        assert frames[NAMES["head"], 1, 3] > 1.5
        for side in ("left", "right"):
            knee = frames[NAMES[f"{side}_hip"], :3, :3].T @ frames[NAMES[f"{side}_knee"], :3, :3]
            assert Rotation.from_matrix(knee).as_rotvec()[0] > -0.05  # never bent backwards


def test_expressions_of_another_number_are_refused():
    with pytest.raises(PoseError, match="2 frames needs as many expressions"):
        Motion(30.0, np.zeros((2, 55, 3)), np.zeros((2, 3)), expressions=({},))
