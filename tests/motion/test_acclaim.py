"""Acclaim's skeletons and motions (ASF, AMC), and captured people."""

from __future__ import annotations

import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import PoseError
from glsplat.motion.bvh import parse_acclaim
from glsplat.motion.loading import load_motion

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
