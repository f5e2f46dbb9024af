"""Acclaim's skeletons and motions (ASF, AMC), and captured people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import PoseError
from glsplat.formats.person import read_person
from glsplat.motion.bvh import parse_acclaim
from glsplat.motion.loading import load_motion
from tests.motion.test_bvh import NAMES

ASF = """:version 1.10
:units
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name lfemur
     direction 0 -1 0
     length 2
     axis 0 0 20 XYZ
     dof rx rz
  end
  begin
     id 2
     name ltibia
     direction 0 -1 0
     length 3
     axis 0 90 0 XYZ
     dof rx
  end
:hierarchy
  begin
    root lfemur
    lfemur ltibia
  end
"""


def test_acclaim_axes_and_tips():
    clip = parse_acclaim(ASF, ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 2 3 0 90 0\nlfemur 10 20\nltibia 30\n")
    assert clip.names == ("root", "lfemur", "ltibia") and clip.fps == 120
    assert clip.places[0, 0].tolist() == [1, 2, 3]
    assert clip.rest[2].tolist() == [0, -2, 0]  # our joint is the near end of the bone
    axis = Rotation.from_euler("xyz", [0, 0, 20], degrees=True)
    turn = Rotation.from_euler("xyz", [10, 0, 20], degrees=True)
    root, femur, tibia = clip.turns[0]
    assert root.T @ femur == pytest.approx((axis * turn * axis.inv()).as_matrix())
    assert femur.T @ tibia == pytest.approx(Rotation.from_euler("z", -30, degrees=True).as_matrix())


@pytest.mark.parametrize(
    ("asf", "amc", "word"),
    [
        (ASF, ":DEGREES\n", "no frames"),
        (ASF, ":RADIANS\n1\nroot 0 0 0 0 0 0\n", "radians"),
        (ASF, "1\nroot 0 0 0 0 0 0\nlfemur 1 2\n", "ltibia"),
        (ASF, "1\nroot 0 0 0 0 0 0\nlfemur 1\nltibia 1\n", "lfemur"),
        (ASF, "1\nroot 0 0 0 0 0 0\nlfemur x 1\nltibia 1\n", "lfemur"),
        (ASF[:300], "1\nroot 0 0 0 0 0 0\n", ".asf"),
        ("", "1\nroot 0 0 0 0 0 0\n", ".asf"),
    ],
)
def test_malformed_acclaim(asf, amc, word):
    with pytest.raises(PoseError, match=word):
        parse_acclaim(asf, amc)


def test_amc_without_skeleton(tmp_path, skeleton):
    (tmp_path / "02_01.amc").write_text(":FULLY-SPECIFIED\n1\nroot 0 0 0 0 0 0\n")
    with pytest.raises(PoseError, match=r"\.asf"):
        load_motion(tmp_path / "02_01.amc", skeleton)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["cmu_131_01.bvh", "cmu_02_01.amc", "cmu_02_03.amc"])
def test_captured_people_walk_upright(shared_data: Path, name):
    """Real captures: head above pelvis above feet, soles down, knees and elbows never bent backwards."""
    skeleton = read_person(shared_data / "people" / "char_c_registry.npz").skeleton
    motion = load_motion(shared_data / "mocap" / name, skeleton, forward=True)
    assert motion.fps == pytest.approx(120, rel=1e-3) and len(motion) > 100
    assert motion.rotations[0, 0, 1] == pytest.approx(0, abs=0.3)
    upright, gap = 0, []
    frames = range(0, len(motion), 23)
    for i in frames:
        world = skeleton.forward(motion.rotations[i], motion.trans[i])
        at = world[:, :3, 3]
        upright += at[NAMES["head"], 1] - at[NAMES["pelvis"], 1] > 0.35 and at[NAMES["pelvis"], 1] > 0.7
        gap.append(min(at[NAMES[f"{s}_foot"], 1] for s in ("left", "right")))
        for side, sign in (("left", 1), ("right", -1)):
            thigh, shin, foot = (world[NAMES[f"{side}_{n}"], :3, :3] for n in ("hip", "knee", "ankle"))
            assert Rotation.from_matrix(thigh.T @ shin).as_rotvec()[0] > -0.25
            upper, fore = (
                at[NAMES[f"{side}_{b}"]] - at[NAMES[f"{side}_{a}"]]
                for a, b in (("shoulder", "elbow"), ("elbow", "wrist"))
            )
            ahead = world[NAMES[f"{side}_shoulder"], :3, 2]  # the side the elbow bends to, up to the arm's twist
            assert fore @ ahead > -0.12 * np.linalg.norm(fore) or upper @ fore > 0.8 * np.linalg.norm(upper) ** 2
            assert sign in (1, -1) and foot[1, 1] > -0.6
    assert upright >= 0.75 * len(frames)
    assert np.median(gap) == pytest.approx(skeleton.joints[NAMES["left_foot"], 1], abs=0.08)
