"""Motion capture files: parsing, retargeting to the SMPL-X rig, malformed input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import PoseError
from glsplat.extras.motions.bvh import parse_acclaim, parse_bvh
from glsplat.extras.motions.retarget import retarget
from glsplat.extras.rigs.match import match_rig
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

NAMES = {name: i for i, name in enumerate(JOINT_NAMES)}

# (name, parent, offset in metres) of a figure with its arms hanging, y up, facing +z
HANGING = [
    ("Hips", None, (0, 0.95, 0)),
    ("LeftUpLeg", "Hips", (0.1, -0.05, 0)),
    ("LeftLeg", "LeftUpLeg", (0, -0.42, 0)),
    ("LeftFoot", "LeftLeg", (0, -0.4, 0)),
    ("LeftToeBase", "LeftFoot", (0, -0.06, 0.13)),
    ("RightUpLeg", "Hips", (-0.1, -0.05, 0)),
    ("RightLeg", "RightUpLeg", (0, -0.42, 0)),
    ("RightFoot", "RightLeg", (0, -0.4, 0)),
    ("RightToeBase", "RightFoot", (0, -0.06, 0.13)),
    ("Spine", "Hips", (0, 0.1, 0)),
    ("Spine1", "Spine", (0, 0.2, 0)),
    ("Neck", "Spine1", (0, 0.25, 0)),
    ("Head", "Neck", (0, 0.1, 0)),
    ("LeftShoulder", "Spine1", (0.04, 0.2, 0)),
    ("LeftArm", "LeftShoulder", (0.14, 0, 0)),
    ("LeftForeArm", "LeftArm", (0, -0.28, 0)),
    ("LeftHand", "LeftForeArm", (0, -0.25, 0)),
    ("RightShoulder", "Spine1", (-0.04, 0.2, 0)),
    ("RightArm", "RightShoulder", (-0.14, 0, 0)),
    ("RightForeArm", "RightArm", (0, -0.28, 0)),
    ("RightHand", "RightForeArm", (0, -0.25, 0)),
]
_LIMBS = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand")


def family(trunk: str, limbs: str, left: str = "L", right: str = "R") -> dict[str, str]:
    """Names of a maker: of hips, two of the spine, neck and head; of a limb's joints with # for the side."""
    names = dict(zip(("Hips", "Spine", "Spine1", "Neck", "Head"), trunk.split(","), strict=True))
    for side, mark in (("Left", left), ("Right", right)):
        names |= {f"{side}{part}": name.replace("#", mark) for part, name in zip(_LIMBS, limbs.split(","), strict=True)}
    return names


PARTS = "UpperLeg,LowerLeg,Foot,ToeBase,Shoulder,UpperArm,LowerArm,Hand"
MAKEHUMAN = family(
    "root,spine04,spine01,neck03,head",
    "upperleg01.#,lowerleg01.#,foot.#,toe1-1.#,clavicle.#,upperarm01.#,lowerarm01.#,wrist.#",
)
# others are in test_exports.py
FAMILIES = {
    "makehuman": MAKEHUMAN,
    "acclaim": family(
        "root,lowerback,thorax,upperneck,head",
        "#femur,#tibia,#foot,#toes,#clavicle,#humerus,#radius,#wrist", "l", "r",
    ),
    "unreal": family(
        "pelvis,spine_01,spine_02,neck_01,head",
        "thigh_#,calf_#,foot_#,ball_#,clavicle_#,upperarm_#,lowerarm_#,hand_#", "l", "r",
    ),
    "vroid": family(
        ",".join(f"J_Bip_C_{part}" for part in ("Hips", "Spine", "Chest", "Neck", "Head")),
        ",".join(f"J_Bip_#_{part}" for part in PARTS.split(",")),
    ),
    "biped": family(
        "Bip001 Pelvis,Bip001 Spine,Bip001 Spine1,Bip001 Neck,Bip001 Head",
        ",".join(f"Bip001 # {part}" for part in "Thigh Calf Foot Toe0 Clavicle UpperArm Forearm Hand".split()),
    ),
    "rigify": family(
        "DEF-spine,DEF-spine.001,DEF-spine.003,DEF-spine.004,DEF-head",
        ",".join(f"DEF-{part}.#" for part in "thigh shin foot toe shoulder upper_arm forearm hand".split()),
    ),
}  # fmt: skip


def bvh(angles, *, rename=None, unit=1.0, turn=None, frames=2, root=(0.0, 0.95, 0.0), own=None):
    """A BVH text of the hanging figure. ``angles``: joint -> (z, y, x) degrees; ``turn``: change of axes [3, 3].

    ``own``: joint -> [3, 3] axes of its own in which its children's offsets are written; the rest pose then is none.
    """
    turn = np.eye(3) if turn is None else turn
    own = own or {}
    parents = {name: parent for name, parent, _ in HANGING}
    rename = rename or {}
    children = {name: [n for n, p, _ in HANGING if p == name] for name, _, _ in HANGING}
    offsets = {name: own.get(parent, np.eye(3)).T @ turn @ np.array(offset) * unit for name, parent, offset in HANGING}
    lines, order = ["HIERARCHY"], []

    def emit(name, depth):
        order.append(name)
        kind = "JOINT" if depth else "ROOT"
        channels = "Zrotation Yrotation Xrotation"
        lines.append(f"{kind} {rename.get(name, name)}\n{{\nOFFSET {' '.join(map(str, offsets[name]))}")
        lines.append(f"CHANNELS 3 {channels}" if depth else f"CHANNELS 6 Xposition Yposition Zposition {channels}")
        for child in children[name]:
            emit(child, depth + 1)
        if not children[name]:
            lines.append("End Site\n{\nOFFSET 0 0.05 0\n}")
        lines.append("}")

    emit("Hips", 0)
    numbers = list(turn @ np.array(root) * unit)
    for name in order:
        matrix = Rotation.from_euler("ZYX", angles.get(name, (0, 0, 0)), degrees=True).as_matrix()
        local = own.get(parents[name], np.eye(3)).T @ turn @ matrix @ turn.T @ own.get(name, np.eye(3))
        numbers += Rotation.from_matrix(local).as_euler("ZYX", degrees=True).tolist()
    motion = "\n".join([" ".join(f"{v:.9f}" for v in numbers)] * frames)
    return "\n".join(lines) + f"\nMOTION\nFrames: {frames}\nFrame Time: 0.02\n{motion}\n"


@pytest.fixture(scope="module")
def skeleton() -> Skeleton:
    """A T-posed figure of other proportions than the BVH's."""
    at = np.zeros((55, 3))
    place = {"pelvis": (0, 0.9, 0), "spine1": (0, 1.0, 0), "spine2": (0, 1.1, 0), "spine3": (0, 1.2, 0)}
    place |= {"neck": (0, 1.4, 0), "head": (0, 1.5, 0)}
    for side, sign in (("left", 1), ("right", -1)):
        place |= {f"{side}_hip": (0.09 * sign, 0.8, 0), f"{side}_knee": (0.09 * sign, 0.45, 0)}
        place |= {f"{side}_ankle": (0.09 * sign, 0.1, 0), f"{side}_foot": (0.09 * sign, 0.03, 0.12)}
        place |= {f"{side}_collar": (0.05 * sign, 1.35, 0), f"{side}_shoulder": (0.16 * sign, 1.35, 0)}
        place |= {f"{side}_elbow": (0.42 * sign, 1.35, 0), f"{side}_wrist": (0.65 * sign, 1.35, 0)}
    for name, i in NAMES.items():
        at[i] = place.get(name, at[PARENTS[i]] + (0.03 * np.sign(at[PARENTS[i]][0]), 0, 0.01))
    return Skeleton.from_joints(JOINT_NAMES, PARENTS, at)


def positions(skeleton, clip, frame=0, **options):
    rotations, trans = retarget(clip, skeleton, **options)
    return skeleton.forward(rotations[frame], trans[frame])[:, :3, 3]


def direction(at, a, b):
    v = at[NAMES[b]] - at[NAMES[a]]
    return v / np.linalg.norm(v)


def test_rest_pose_hangs_the_arms(skeleton):
    clip = parse_bvh(bvh({}))
    assert clip.fps == pytest.approx(50) and len(clip) == 2
    at = positions(skeleton, clip)
    for side in ("left", "right"):
        assert direction(at, f"{side}_shoulder", f"{side}_elbow") == pytest.approx([0, -1, 0], abs=1e-6)
        assert direction(at, f"{side}_elbow", f"{side}_wrist") == pytest.approx([0, -1, 0], abs=1e-6)
        assert direction(at, f"{side}_hip", f"{side}_knee") == pytest.approx([0, -1, 0], abs=1e-6)
    rotations, _ = retarget(clip, skeleton)
    still = [NAMES[name] for name in ("pelvis", "left_ankle", "head", "left_elbow", "left_wrist")]
    assert rotations[0, still] == pytest.approx(0, abs=1e-6)
    # thumbs stay in front when the arms hang
    assert at[NAMES["left_thumb3"], 2] > 0.01


def test_bending_the_right_way(skeleton):
    angles = {"LeftLeg": (0, 0, 50), "RightUpLeg": (0, 0, -40), "LeftForeArm": (0, 0, -90), "Head": (0, 30, 0)}
    at = positions(skeleton, parse_bvh(bvh(angles)))
    assert direction(at, "left_knee", "left_ankle")[2] < -0.7  # the shin goes back
    assert direction(at, "right_hip", "right_knee")[2] > 0.6  # the thigh goes forward
    assert direction(at, "left_elbow", "left_wrist") == pytest.approx([0, 0, 1], abs=1e-6)  # the forearm forward
    rotations, _ = retarget(parse_bvh(bvh(angles)), skeleton)
    assert rotations[0, NAMES["head"]] == pytest.approx([0, np.radians(30), 0], abs=1e-6)


@pytest.mark.parametrize("rename", FAMILIES.values(), ids=FAMILIES)
def test_joint_names_of_several_makers(skeleton, rename):
    angles = {"LeftLeg": (0, 0, 50), "RightArm": (-70, 0, 0), "Spine1": (0, 20, 0), "LeftToeBase": (0, 0, -20)}
    plain = retarget(parse_bvh(bvh(angles)), skeleton)[0]
    renamed = retarget(parse_bvh(bvh(angles, rename=rename)), skeleton)[0]
    together = [NAMES[n] for n in JOINT_NAMES if not n.startswith("spine")]
    assert renamed[:, together] == pytest.approx(plain[:, together], abs=1e-6)
    spine = np.abs(renamed[0, [NAMES[f"spine{i}"] for i in (1, 2, 3)]].sum(axis=0))
    assert spine == pytest.approx([0, np.radians(20), 0], abs=1e-6)


@pytest.mark.parametrize("unit", [1.0, 100.0, 39.37])
def test_units_follow_from_the_legs(skeleton, unit):
    clip = parse_bvh(bvh({}, unit=unit, root=(3.0, 0.95, 4.0)))
    clip.places[1] += [0, 0, unit]
    _, trans = retarget(clip, skeleton)
    leg = 0.7 / 0.82
    assert trans[0, [0, 2]] == pytest.approx([0, 0], abs=1e-9)
    assert trans[1] - trans[0] == pytest.approx([0, 0, leg], abs=1e-6)


def test_at_rest_y_is_up_and_z_as_they_move(skeleton):
    """Of a skeleton with y up, moved by a root that turns it: they stand, look ahead, and lie down where they lie."""
    angles = {"LeftLeg": (0, 0, 50), "RightArm": (-70, 0, 0)}
    plain = retarget(parse_bvh(bvh(angles)), skeleton)
    for heading in (0, 180):
        text = bvh(angles | {"Hips": (heading, 0, 90)}, root=(0.3, 0.2, 0.95))
        moved = retarget(parse_bvh(text), skeleton)
        assert moved[0] == pytest.approx(plain[0], abs=1e-6)
        assert moved[1] == pytest.approx(plain[1], abs=1e-6)
    for far in (3.0, -3.0):
        lying = retarget(parse_bvh(bvh(angles | {"Hips": (0, 0, -90)}, root=(0.0, 0.1, far))), skeleton)
        assert abs(lying[0][0, 0, 0]) == pytest.approx(np.pi / 2, abs=1e-6)


def test_the_middle_of_the_hips_goes_where_the_file_has_it(skeleton):
    lean = bvh({"Hips": (30, 0, 0)}, frames=1).rsplit("Frame Time: 0.02", 1)[1]
    clip = parse_bvh(bvh({}, frames=1).replace("Frames: 1", "Frames: 2").rstrip() + lean)
    hips = [NAMES["left_hip"], NAMES["right_hip"]]
    first, second = (positions(skeleton, clip, frame)[hips].mean(axis=0) for frame in (0, 1))
    down = np.array([0, -0.05, 0])
    theirs = Rotation.from_euler("z", 30, degrees=True).apply(down) - down
    assert second - first == pytest.approx(theirs * 0.7 / 0.82, abs=1e-6)


def test_what_joints_are_of_families_with_helpers():
    """Of CMU the spine begins where the pelvis is; a finger without a number is within the palm."""
    names = [name for name, _, _ in HANGING]
    parents = [names.index(parent) if parent else -1 for _, parent, _ in HANGING]
    at = np.zeros((len(names), 3))
    for i, (_, _, offset) in enumerate(HANGING):
        at[i] = np.array(offset) + (at[parents[i]] if parents[i] >= 0 else 0)
    called = [FAMILIES["acclaim"][name] for name in names] + ["lindex", "lindex1", "lindex2", "lindex3"]
    at[names.index("Spine")] = at[0]
    hand = names.index("LeftHand")
    parents += [hand, len(names), len(names) + 1, len(names) + 2]
    at = np.vstack([at, at[hand] - np.outer([1, 2, 3, 4], [0, 0.02, 0])])
    found = match_rig(called, parents, at).joints
    assert called[found["pelvis"]] == "root"
    assert [called[found[f"left_index{i}"]] for i in (1, 2, 3)] == ["lindex1", "lindex2", "lindex3"]


def test_split_bones_point_where_their_ends_are(skeleton):
    """MakeHuman's upperleg01 and 02, the second bent against the first, and position channels that are all zero."""
    text = bvh({}, rename=MAKEHUMAN)
    head, motion = text.split("MOTION")
    old = "JOINT lowerleg01.L"
    channels = "6 Xposition Yposition Zposition Zrotation Yrotation Xrotation"
    piece = f"JOINT upperleg02.L {{\nOFFSET 0 -0.2 0\nCHANNELS {channels}\n"
    start = head.index(old)
    end = start + len(_block(head[start:]))
    leg = _block(head[start:]).replace("OFFSET 0.0 -0.42 0.0", "OFFSET 0.0 -0.22 0.0", 1)
    head = head[:start] + piece + leg + "}\n" + head[end:]
    lines = motion.strip().split("\n")
    rows = [line.split() for line in lines[2:]]
    clip, twisted = (
        parse_bvh(head + "MOTION\n" + "\n".join([*lines[:2], *(" ".join([*r[:9], piece, *r[9:]]) for r in rows)]))
        for piece in ("0 0 0 0 0 -60", "0 0 0 0 30 0")  # after hips and thigh
    )
    turns = retarget(twisted, skeleton)[0][0]
    assert turns[NAMES["left_hip"]] == pytest.approx([0, np.radians(30), 0], abs=1e-6)
    assert turns[NAMES["left_knee"]] == pytest.approx([0, 0, 0], abs=1e-6)
    at = positions(skeleton, clip)
    bend = np.radians(60)
    thigh = np.array([0, -0.2 - 0.22 * np.cos(bend), 0.22 * np.sin(bend)])
    assert direction(at, "left_hip", "left_knee") == pytest.approx(thigh / np.linalg.norm(thigh), abs=1e-6)
    shin = np.array([0, -np.cos(bend), np.sin(bend)])
    assert direction(at, "left_knee", "left_ankle") == pytest.approx(shin, abs=1e-6)


def _block(text):
    """From a joint's name to the brace that ends it."""
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "{") - (letter == "}")
        if letter == "}" and depth == 0:
            return text[: place + 1] + "\n"
    raise AssertionError


def test_forward_turns_to_z(skeleton):
    clip = parse_bvh(bvh({"Hips": (0, 130, 0)}))
    clip.places[1] += [np.sin(np.radians(130)), 0, np.cos(np.radians(130))]
    kept, ahead = retarget(clip, skeleton), retarget(clip, skeleton, forward=True)
    assert kept[0][0, 0] == pytest.approx([0, np.radians(130), 0], abs=1e-6)
    assert ahead[0][0, 0] == pytest.approx([0, 0, 0], abs=1e-6)
    assert (ahead[1][1] - ahead[1][0])[2] > 0.5


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("Frames: 2", "Frames: 0", "frame"),
        ("Frames: 2", "Frames: two", "Frames"),
        ("Frame Time: 0.02", "Frame Time: 0", "frame time"),
        ("Xposition Yposition", "Xposition Wposition", "channel"),
        ("Frames: 2", "Frames: 3", "numbers"),
        ("LeftUpLeg", "Thing", "left_hip"),
        ("0.950000000", "nan", "finite"),
        ("0.950000000", "abc", "numbers"),
        ("OFFSET 0.0 0.95 0.0", "OFFSET 0.0 x 0.0", "malformed"),
        ("0.950000000", "1e300", "far too large"),
        ("OFFSET 0.0 -0.4", "OFFSET 0.0 1e300", "far too large"),
    ],
)
def test_malformed_files(tmp_path, skeleton, old, new, word):
    text = bvh({})
    assert old in text
    (tmp_path / "bad.bvh").write_text(text.replace(old, new))
    with pytest.raises(PoseError) as caught:
        load_motion(tmp_path / "bad.bvh", skeleton)
    assert word in str(caught.value) and "bad.bvh" in str(caught.value)


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


@pytest.mark.parametrize("cut", [0.05, 0.3, 0.7, 0.97])
def test_truncated_files(tmp_path, skeleton, cut):
    text = bvh({}, frames=20)
    path = tmp_path / "cut.bvh"
    path.write_text(text[: int(len(text) * cut)])
    with pytest.raises(PoseError) as caught:
        load_motion(path, skeleton)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
