"""What further programs call the joints of people: names alone, with the helpers that stand beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from glsplat.authoring.fit.body import open_body
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from tests.authoring.gltf.built import FINGERS, PLAIN, TITLE, biped_fingers, fingers, sided

__all__ = ["NAMED", "Named", "laid_out"]


@dataclass(frozen=True)
class Named:
    """A rig by its names."""

    names: Mapping[str, str]  # SMPL-X joint -> theirs
    more: Mapping[str, str] = field(default_factory=dict)  # helper -> the SMPL-X joint that it hangs from
    above: Mapping[str, str] = field(default_factory=dict)  # helper -> the SMPL-X joint that hangs from it


def laid_out(rig: Named) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, parents and positions, as the reference body stands."""
    body = open_body().joints
    names: list[str] = []
    parents: list[int] = []
    points: list[np.ndarray] = []
    place: dict[str, int] = {}

    def add(name: str, parent: int, point: np.ndarray) -> int:
        names.append(name)
        parents.append(parent)
        points.append(point)
        return len(names) - 1

    for index, joint in enumerate(JOINT_NAMES):
        if joint not in rig.names:
            continue
        up = int(PARENTS[index])
        while up >= 0 and JOINT_NAMES[up] not in rig.names:
            up = int(PARENTS[up])
        parent = place[JOINT_NAMES[up]] if up >= 0 else -1
        start = body[up] if up >= 0 else body[0]
        for helper in [name for name, below in rig.above.items() if below == joint]:
            parent = add(helper, parent, 0.75 * start + 0.25 * body[index])
        place[joint] = add(rig.names[joint], parent, body[index])
    for n, (helper, joint) in enumerate(rig.more.items()):
        add(helper, place[joint], body[JOINT_NAMES.index(joint)] + np.array([0.003, 0.002 * n, 0.01]))
    return names, np.array(parents), np.array(points)


def _finger_list(pattern: str, words: Mapping[str, str], numbers: tuple[str, str, str]) -> dict[str, str]:
    return {joint: name.replace("§", numbers[int(joint[-1]) - 1]) for joint, name in fingers(pattern, words).items()}


def _trunk(pelvis: str, *rest: str) -> dict[str, str]:
    """Pelvis, as many of the spine as there are, neck and head."""
    *spine, neck, head = rest
    which = {0: (), 1: ("spine3",), 2: ("spine1", "spine3"), 3: ("spine1", "spine2", "spine3")}[len(spine)]
    return {"pelvis": pelvis, **dict(zip(which, spine, strict=True)), "neck": neck, "head": head}


_KANJI = {"thumb": "親指", "index": "人指", "middle": "中指", "ring": "薬指", "pinky": "小指"}
_WIDE = str.maketrans("0123", "０１２３")


def _mmd() -> dict[str, str]:
    out = {"pelvis": "下半身", "spine1": "上半身", "spine3": "上半身2", "neck": "首", "head": "頭"}
    for side, kanji in (("left", "左"), ("right", "右")):
        parts = {"hip": "足", "knee": "ひざ", "ankle": "足首", "foot": "つま先", "collar": "肩"}
        parts |= {"shoulder": "腕", "elbow": "ひじ", "wrist": "手首", "eye_smplhf": "目"}
        out |= {f"{side}_{part}": kanji + word for part, word in parts.items()}
        for finger, word in _KANJI.items():
            for n in (1, 2, 3):
                number = str(n - 1 if finger == "thumb" else n).translate(_WIDE)
                out[f"{side}_{finger}{n}"] = kanji + word + number
    return out


_METARIG = {
    **{"pelvis": "spine", "spine1": "spine.001", "spine2": "spine.002", "spine3": "spine.003"},
    **{"neck": "spine.004", "head": "spine.006"},
    **sided(hip="thigh.{L}", knee="shin.{L}", ankle="foot.{L}", foot="toe.{L}", collar="shoulder.{L}"),
    **sided(shoulder="upper_arm.{L}", elbow="forearm.{L}", wrist="hand.{L}"),
    **fingers("{f}.0{n}.{L}", {finger: finger if finger == "thumb" else f"f_{finger}" for finger in FINGERS}),
}
_BIPED = {
    **_trunk("Bip001 Pelvis", "Bip001 Spine", "Bip001 Spine1", "Bip001 Neck", "Bip001 Head"),
    **sided(hip="Bip001 {L} Thigh", knee="Bip001 {L} Calf", ankle="Bip001 {L} Foot", foot="Bip001 {L} Toe0"),
    **sided(collar="Bip001 {L} Clavicle", shoulder="Bip001 {L} UpperArm", elbow="Bip001 {L} Forearm"),
    **sided(wrist="Bip001 {L} Hand"),
    **biped_fingers("Bip001 "),
}
_PLAINLY = {
    **_trunk("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"),
    **sided(hip="{S}UpLeg", knee="{S}Leg", ankle="{S}Foot", foot="{S}ToeBase", collar="{S}Shoulder"),
    **sided(shoulder="{S}Arm", elbow="{S}ForeArm", wrist="{S}Hand"),
    **fingers("{S}Hand{f}{n}", TITLE),
}


def _numbered(names: Mapping[str, str], pattern: str) -> dict[str, str]:
    """With what an uploader's converter adds: "_01", "_02", ... over all joints."""
    return {joint: pattern.format(name=name, n=place + 1) for place, (joint, name) in enumerate(names.items())}


NAMED = {
    "Rigify's own bones, unrigged": Named(
        _METARIG,
        {"pelvis.L": "pelvis", "pelvis.R": "pelvis", "breast.L": "spine3", "palm.01.L": "left_wrist"}
        | {"heel.02.L": "left_ankle"},
        {"spine.005": "head"},
    ),
    "Rigify, head as spine": Named(
        {joint: f"DEF-{name}" for joint, name in _METARIG.items()},
        {"DEF-pelvis.L": "pelvis", "DEF-breast.R": "spine3", "DEF-thigh.L.001": "left_hip", "ORG-spine.006": "head"}
        | {"DEF-upper_arm.L.001": "left_shoulder", "DEF-palm.02.R": "right_wrist"},
        {"DEF-spine.005": "head"},
    ),
    "Auto-Rig Pro": Named(
        {
            **_trunk("root.x", "spine_01.x", "spine_02.x", "spine_03.x", "neck.x", "head.x"),
            **sided(hip="thigh_stretch.{l}", knee="leg_stretch.{l}", ankle="foot.{l}", foot="toes_01.{l}"),
            **sided(collar="shoulder.{l}", shoulder="arm_stretch.{l}", elbow="forearm_stretch.{l}", wrist="hand.{l}"),
            **fingers("{f}{n}.{l}", PLAIN),
        },
        {"thigh_twist.l": "left_hip", "leg_twist.l": "left_knee", "arm_twist.r": "right_shoulder"}
        | {"forearm_twist.r": "right_elbow", "index1_base.l": "left_wrist", "breast_01.l": "spine3"},
    ),
    "Synty": Named(
        {
            **_trunk("Hips", "Spine_01", "Spine_02", "Spine_03", "Neck", "Head"),
            **sided(hip="UpperLeg_{L}", knee="LowerLeg_{L}", ankle="Ankle_{L}", foot="Ball_{L}"),
            **sided(collar="Clavicle_{L}", shoulder="Shoulder_{L}", elbow="Elbow_{L}", wrist="Hand_{L}"),
            **_finger_list("{f}_0§", {"thumb": "Thumb", "index": "IndexFinger"}, ("1", "2", "3")),
        }
        | {
            f"right_{f}{n}": f"{w}_0{n} 1" for f, w in (("thumb", "Thumb"), ("index", "IndexFinger")) for n in (1, 2, 3)
        },
        {"Toes_L": "left_foot", "Toes_R": "right_foot", "Eyes": "head", "Eyebrows": "head"},
    ),
    "Poser": Named(
        {
            **_trunk("pelvis", "abdomen", "abdomen2", "chest", "neck", "head"),
            **sided(hip="{l}Thigh", knee="{l}Shin", ankle="{l}Foot", foot="{l}Toe", collar="{l}Collar"),
            **sided(shoulder="{l}Shldr", elbow="{l}ForeArm", wrist="{l}Hand", eye_smplhf="{l}Eye"),
            **fingers("{l}{f}{n}", {**TITLE, "middle": "Mid"}),
            "jaw": "lowerJaw",
        },
        {"lButtock": "pelvis", "lCarpal1": "left_wrist"},
        {"hip": "pelvis"},
    ),
    "Daz, of nine": Named(
        {
            **_trunk("pelvis", "spine1", "spine2", "spine4", "neck1", "head"),
            **sided(hip="{l}_thigh", knee="{l}_shin", ankle="{l}_foot", foot="{l}_toes", collar="{l}_shoulder"),
            **sided(shoulder="{l}_upperarm", elbow="{l}_forearm", wrist="{l}_hand", eye_smplhf="{l}_eye"),
            **fingers("{l}_{f}{n}", {**PLAIN, "middle": "mid"}),
        },
        {"l_thightwist1": "left_hip", "l_upperarmtwist1": "left_shoulder", "l_pectoral": "spine3"}
        | {"l_indexmetacarpal": "left_wrist", "l_bigtoe1": "left_foot", "l_metatarsal": "left_ankle", "l_ear": "head"},
        {"hip": "pelvis", "neck2": "head"},
    ),
    "Second Life": Named(
        {
            **_trunk("mPelvis", "mTorso", "mChest", "mNeck", "mHead"),
            **sided(hip="mHip{S}", knee="mKnee{S}", ankle="mAnkle{S}", foot="mToe{S}", collar="mCollar{S}"),
            **sided(shoulder="mShoulder{S}", elbow="mElbow{S}", wrist="mWrist{S}", eye_smplhf="mEye{S}"),
            **fingers("mHand{f}{n}{S}", TITLE),
            "jaw": "mFaceJaw",
        },
        {"mSkull": "head", "mFaceRoot": "head", "mFaceEyeAltLeft": "head", "mTail1": "pelvis", "mWing1Left": "spine3"}
        | {"mHindLimb1Left": "pelvis"},
        {"mFootLeft": "left_foot", "mFootRight": "right_foot"},
    ),
    "Maya, advanced skeleton": Named(
        {
            **_trunk("Root_M", "Spine1_M", "Spine2_M", "Chest_M", "Neck_M", "Head_M"),
            **sided(hip="Hip_{L}", knee="Knee_{L}", ankle="Ankle_{L}", foot="Toes_{L}", collar="Scapula_{L}"),
            **sided(shoulder="Shoulder_{L}", elbow="Elbow_{L}", wrist="Wrist_{L}", eye_smplhf="Eye_{L}"),
            **fingers("{f}Finger{n}_{L}", TITLE),
            "jaw": "Jaw_M",
        },
        {"HipPart1_L": "left_hip", "ShoulderPart1_R": "right_shoulder", "ToesEnd_L": "left_foot", "Cup_L": "left_wrist"}
        | {"HeadEnd_M": "head"},
    ),
    "Maya, modules": Named(
        {
            **_trunk(*(f"spine_C0_{n}_jnt" for n in range(4)), "neck_C0_0_jnt", "head_C0_jnt"),
            **sided(hip="leg_{L}0_0_jnt", knee="leg_{L}0_1_jnt", ankle="foot_{L}0_0_jnt"),
            **sided(collar="shoulder_{L}0_0_jnt", shoulder="arm_{L}0_0_jnt", elbow="arm_{L}0_1_jnt"),
            **sided(wrist="arm_{L}0_2_jnt"),
        }
    ),
    "ARKit": Named(
        {
            **_trunk("hips_joint", "spine_1_joint", "spine_4_joint", "spine_7_joint", "neck_1_joint", "head_joint"),
            **sided(hip="{s}_upLeg_joint", knee="{s}_leg_joint", ankle="{s}_foot_joint", foot="{s}_toes_joint"),
            **sided(collar="{s}_shoulder_1_joint", shoulder="{s}_arm_joint", elbow="{s}_forearm_joint"),
            **sided(wrist="{s}_hand_joint", eye_smplhf="{s}_eye_joint"),
            **fingers("{s}_hand{f}_{n}_joint", TITLE),
            "jaw": "jaw_joint",
        },
        {"left_handThumbStart_joint": "left_wrist", "left_toesEnd_joint": "left_foot"}
        | {
            "left_eyeball_joint": "left_eye_smplhf",
            "left_eyeUpperLid_joint": "left_eye_smplhf",
            "nose_joint": "head",
            "chin_joint": "jaw",
        },
        {"spine_2_joint": "spine2", "spine_6_joint": "spine3", "neck_2_joint": "head"},
    ),
    "Kinect": Named(
        {
            **_trunk("PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK", "HEAD"),
            **sided(hip="HIP_{s}", knee="KNEE_{s}", ankle="ANKLE_{s}", foot="FOOT_{s}", collar="CLAVICLE_{s}"),
            **sided(shoulder="SHOULDER_{s}", elbow="ELBOW_{s}", wrist="WRIST_{s}"),
        },
        {"HAND_LEFT": "left_wrist", "HANDTIP_LEFT": "left_wrist", "NOSE": "head"},
    ),
    "Xsens": Named(
        {
            **_trunk("Pelvis", "L5", "L3", "T8", "Neck", "Head"),
            **sided(hip="{S}UpperLeg", knee="{S}LowerLeg", ankle="{S}Foot", foot="{S}Toe", collar="{S}Shoulder"),
            **sided(shoulder="{S}UpperArm", elbow="{S}ForeArm", wrist="{S}Hand"),
        }
    ),
    "a robot with joints in words": Named(
        {
            **_trunk("Hip", "Ribs", "Neck", "Head"),
            **sided(hip="{S}_Thigh_Joint_01", knee="{S}_Knee_Joint_01", ankle="{S}_Ankle_Joint_01"),
            **sided(foot="{S}_Toe_Joint_01", collar="{S}_Shoulder_Joint_01", shoulder="{S}_Upper_Arm_Joint_01"),
            **sided(elbow="{S}_Forearm_Joint_01", wrist="{S}_Wrist_Joint_01"),
            **_finger_list("{S}_{f}_Joint_01§", {"thumb": "Thumb", "index": "Index_Finger"}, ("a", "b", "c")),
        },
        {"Left_Toe_Joint_02": "left_foot"},
    ),
    "blocks of fifteen": Named(
        {
            **_trunk("LowerTorso", "UpperTorso", "Neck", "Head"),
            **sided(hip="{S}UpperLeg", knee="{S}LowerLeg", ankle="{S}Foot"),
            **sided(shoulder="{S}UpperArm", elbow="{S}LowerArm", wrist="{S}Hand"),
        },
        {},
        {"HumanoidRootPart": "pelvis"},
    ),
    "MMD": Named(
        _mmd(),
        {"左足ＩＫ": "pelvis", "左腕捩": "left_shoulder", "左手捩": "left_elbow", "左肩P": "spine3", "両目": "head"}
        | {"前髪１": "head", "左胸": "spine3", "左スカート1": "pelvis"},
        {"センター": "pelvis"},
    ),
    "XNALara": Named(
        {
            **_trunk("root hips", "spine lower", "spine middle", "spine upper", "head neck lower", "head neck upper"),
            **sided(hip="leg {s} thigh", knee="leg {s} knee", ankle="leg {s} ankle", foot="leg {s} toes"),
            **sided(collar="arm {s} shoulder 1", shoulder="arm {s} shoulder 2", elbow="arm {s} elbow"),
            **sided(wrist="arm {s} wrist", eye_smplhf="head eyeball {s}"),
            "jaw": "head jaw",
        },
        {"head eyelid left upper": "head", "head mouth corner left": "head", "breast left base": "spine3"},
    ),
    "Valve": Named(
        {
            **_trunk(*(f"ValveBiped.Bip01_{p}" for p in ("Pelvis", "Spine", "Spine1", "Spine4", "Neck1", "Head1"))),
            **sided(hip="ValveBiped.Bip01_{L}_Thigh", knee="ValveBiped.Bip01_{L}_Calf"),
            **sided(ankle="ValveBiped.Bip01_{L}_Foot", foot="ValveBiped.Bip01_{L}_Toe0"),
            **sided(collar="ValveBiped.Bip01_{L}_Clavicle", shoulder="ValveBiped.Bip01_{L}_UpperArm"),
            **sided(elbow="ValveBiped.Bip01_{L}_Forearm", wrist="ValveBiped.Bip01_{L}_Hand"),
            **biped_fingers("ValveBiped.Bip01_", "_"),
        },
        {"ValveBiped.Bip01_L_Ulna": "left_elbow", "ValveBiped.Bip01_L_Wrist": "left_elbow"}
        | {"ValveBiped.Bip01_L_Shoulder": "left_collar", "ValveBiped.Bip01_L_Bicep": "left_shoulder"}
        | {"ValveBiped.Bip01_L_Elbow": "left_shoulder", "ValveBiped.Bip01_L_Knee": "left_hip"}
        | {"ValveBiped.forward": "head"},
    ),
    "bodies of a headset": Named(
        {
            **_trunk("hips", "spine-lower", "spine-middle", "chest", "neck", "head"),
            **sided(hip="{s}-upper-leg", knee="{s}-lower-leg", ankle="{s}-foot-ankle", foot="{s}-foot-ball"),
            **sided(collar="{s}-scapula", shoulder="{s}-arm-upper", elbow="{s}-arm-lower", wrist="{s}-hand-wrist"),
            **_finger_list(
                "{s}-hand-{f}-phalanx-§",
                {f: w for f, w in {**PLAIN, "pinky": "little"}.items() if f != "thumb"},
                ("proximal", "intermediate", "distal"),
            ),
            **_finger_list("{s}-hand-{f}-§", {"thumb": "thumb"}, ("metacarpal", "phalanx-proximal", "phalanx-distal")),
        },
        {"left-hand-wrist-twist": "left_elbow", "left-hand-palm": "left_wrist", "left-hand-index-tip": "left_index3"}
        | {"left-foot-ankle-twist": "left_knee", "left-foot-subtalar": "left_ankle"}
        | {"left-hand-index-metacarpal": "left_wrist"},
        {"left-shoulder": "left_collar"},
    ),
    "VRChat": Named(
        {
            **_trunk("Hips", "Spine", "Chest", "Neck", "Head"),
            **sided(hip="{S} leg", knee="{S} knee", ankle="{S} ankle", foot="{S} toe", collar="{S} shoulder"),
            **sided(shoulder="{S} arm", elbow="{S} elbow", wrist="{S} wrist", eye_smplhf="{S}Eye"),
            **fingers(
                "{f}{n}_{L}", {**{f: f"{w}Finger" for f, w in TITLE.items() if f != "thumb"}, "pinky": "LittleFinger"}
            ),
            **_finger_list("{f}§_{L}", {"thumb": "Thumb"}, ("0", "1", "2")),
        },
        {"Left_Breast": "spine3", "hair_front_L": "head"},
    ),
    "Biped, numbered by an uploader": Named(
        _numbered(_BIPED, "{name}_{n:03d}"), {"Bip001 HeadNub_090": "head", "Bip001 L Finger0Nub_091": "left_thumb3"}
    ),
    "Mixamo, numbered by an uploader": Named(
        _numbered({j: f"mixamorig:{n}" for j, n in _PLAINLY.items()}, "{name}_{n:02d}"),
        {"mixamorig:HeadTop_End_066": "head", "mixamorig:LeftHandThumb4_067": "left_thumb3"},
        {"_rootJoint": "pelvis"},
    ),
    "a name of one's own before all": Named(
        {joint: f"Hero42_{name}" for joint, name in _PLAINLY.items()}, {"Hero42_LeftArmTwist": "left_shoulder"}
    ),
    "a name of one's own behind all": Named({joint: f"{name}_Bob" for joint, name in _PLAINLY.items()}),
    "legs and knees": Named(
        {
            **_trunk("Pelvis", "Torso", "Neck", "Head"),
            **sided(hip="Leg.{L}", knee="Knee.{L}", ankle="Foot.{L}", shoulder="UpperArm.{L}", elbow="Arm.{L}"),
            **sided(wrist="Hand.{L}"),
        },
        {},
        {"Hip.L": "left_hip", "Hip.R": "right_hip"},
    ),
    "two bones of one word": Named(
        {
            **_trunk("hips", "spine", "chest", "neck", "head"),
            **sided(hip="leg1_{L}", knee="leg2_{L}", ankle="foot_{L}", shoulder="arm1_{L}", elbow="arm2_{L}"),
            **sided(wrist="hand_{L}"),
        }
    ),
}
