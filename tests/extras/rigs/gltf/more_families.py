"""What further programs call the joints of people: names alone, with the helpers that stand beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from tests.extras.rigs.gltf.built import FINGERS, PLAIN, TITLE, biped_fingers, fingers, sided

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
    "MMD": Named(
        _mmd(),
        {"左足ＩＫ": "pelvis", "左腕捩": "left_shoulder", "左手捩": "left_elbow", "左肩P": "spine3", "両目": "head"}
        | {"前髪１": "head", "左胸": "spine3", "左スカート1": "pelvis"},
        {"センター": "pelvis"},
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
    "Mixamo, numbered by an uploader": Named(
        _numbered({j: f"mixamorig:{n}" for j, n in _PLAINLY.items()}, "{name}_{n:02d}"),
        {"mixamorig:HeadTop_End_066": "head", "mixamorig:LeftHandThumb4_067": "left_thumb3"},
        {"_rootJoint": "pelvis"},
    ),
    "a name of one's own before all": Named(
        {joint: f"Hero42_{name}" for joint, name in _PLAINLY.items()}, {"Hero42_LeftArmTwist": "left_shoulder"}
    ),
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
