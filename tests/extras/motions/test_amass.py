"""AMASS archives, and files that are no motion at all."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from tests.motion.test_motion import NAMES, refused, skeleton

__all__ = ["skeleton"]


@pytest.mark.parametrize("flavour", ["smplh", "smplx", "smpl"])
def test_amass_turns_z_up_to_y_up(tmp_path, skeleton, flavour):
    frames, path = 5, tmp_path / "a.npz"
    trans = np.zeros((frames, 3))
    trans[:, 1] = -np.arange(frames)  # walks towards -y, AMASS's front
    trans[:, 2] = 0.9
    root = np.tile(Rotation.from_euler("x", 90, degrees=True).as_rotvec(), (frames, 1))  # stands up in a z-up world
    elbow = np.zeros((frames, 21, 3))
    elbow[:, NAMES["left_elbow"] - 1] = (0, -1, 0)
    if flavour == "smplx":
        hand = np.full((frames, 90), 0.1)
        keys = {"root_orient": root, "pose_body": elbow.reshape(frames, 63), "pose_hand": hand}
        np.savez(path, trans=trans, mocap_frame_rate=60.0, **keys)
    else:
        poses = np.zeros((frames, 156 if flavour == "smplh" else 72))
        poses[:, :3], poses[:, 3:66] = root, elbow.reshape(frames, 63)
        if flavour == "smplh":
            poses[:, 66:] = 0.1
        np.savez(path, poses=poses, trans=trans, mocap_framerate=60.0)
    motion = load_motion(path, skeleton)
    assert motion.fps == 60
    last = skeleton.forward(motion.rotations[-1], motion.trans[-1])
    assert last[NAMES["head"], :3, 3] == pytest.approx([0, 1.6, 4], abs=1e-6)
    assert last[NAMES["left_ankle"], 1, 3] == pytest.approx(0.08, abs=1e-6)
    assert motion.rotations[0, NAMES["left_elbow"]] == pytest.approx([0, -1, 0])
    assert motion.rotations[:, 25:] == pytest.approx(0.0 if flavour == "smpl" else 0.1)


def test_amass_forward_turns_the_path_too(tmp_path, skeleton):
    root = Rotation.from_euler("z", 70, degrees=True) * Rotation.from_euler("x", 90, degrees=True)
    step = Rotation.from_euler("z", 70, degrees=True).apply([0, -1, 0])
    poses = np.zeros((4, 156))
    poses[:, :3] = root.as_rotvec()
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.arange(4)[:, None] * step, mocap_framerate=30)
    motion = load_motion(tmp_path / "a.npz", skeleton, forward=True)
    assert motion.rotations[0, 0] == pytest.approx(0, abs=1e-9)
    assert motion.trans[3] - motion.trans[0] == pytest.approx([0, 0, 3], abs=1e-9)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"poses": np.zeros((4, 100))}, ["156"]),
        ({"poses": np.zeros((0, 156))}, ["at least one frame"]),
        ({"poses": np.zeros(156)}, ["156"]),
        ({"pose_body": np.zeros((4, 63))}, ["root_orient"]),
        ({"pose_body": np.zeros((4, 63)), "root_orient": np.zeros((3, 3))}, ["root_orient"]),
        ({"poses": np.zeros((4, 156)), "trans": np.zeros((5, 3))}, ["trans"]),
        ({"poses": np.full((4, 156), 90.0)}, ["radians"]),
        ({"poses": np.full((4, 156), np.nan)}, ["NaN"]),
        ({"poses": np.array([["a"]])}, ["numbers"]),
        ({"betas": np.zeros(16)}, ["poses"]),
    ],
)
def test_wrong_amass(tmp_path, skeleton, arrays, words):
    np.savez(tmp_path / "bad.npz", **arrays)
    refused(tmp_path / "bad.npz", skeleton, *words)


def test_truncated_archive(tmp_path, skeleton):
    np.savez(tmp_path / "a.npz", poses=np.zeros((40, 156)))
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[: len(data) // 2])
    refused(tmp_path / "a.npz", skeleton)


def test_other_rigs_are_refused(tmp_path):
    other = Skeleton.from_joints(("a", "b"), [-1, 0], np.zeros((2, 3)))
    np.savez(tmp_path / "a.npz", poses=np.zeros((1, 156)))
    refused(tmp_path / "a.npz", other, "AMASS cannot drive this avatar: no joint for head")


@pytest.mark.parametrize("text", ["hello", ""])
def test_what_is_none_of_them(tmp_path, skeleton, text):
    (tmp_path / "bad.json").write_text(text)
    refused(tmp_path / "bad.json", skeleton, "none of them")
