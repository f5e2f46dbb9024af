"""People built in code as programs of each family write them: their names, rest pose, axes, units and helper joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.rotations import matrix_quaternions, rotation_matrices
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from tests.formats.scenes import glb_arrays, glb_of

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.02
_FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4)]
    + [(1, 5, 7), (1, 7, 3)]
)


@dataclass(frozen=True)
class Family:
    """How a program writes people."""

    names: Mapping[str, str]  # SMPL-X joint -> theirs; what is left out, such a person lacks
    arms: float = 0.0  # degrees below the horizontal, as bound
    unit: float = 1.0  # of a stored length in metres; the armature's node has it as its scale
    z_up: bool = False  # stored with z up, turned by the armature's node
    backwards: bool = False  # faces -z
    along: bool = False  # a joint's own x axis points along its bone
    twists: tuple[str, ...] = ()  # SMPL-X joints that have a helper halfway to the next
    prone: bool = False  # the nodes rest in another pose than the skin was bound in
    vrm: int | None = None  # the version of VRM whose map is in the file
    more: Mapping[str, str] = field(default_factory=dict)  # extra joints: their name -> the SMPL-X joint they hang from


def sided(**parts: str) -> dict[str, str]:
    """SMPL-X joint -> name, of both sides: "{S}" is Left or Right, "{s}" left or right, "{L}" L or R, "{l}" l or r."""
    out = {}
    for side in ("left", "right"):
        words = {"S": side.title(), "s": side, "L": side[0].upper(), "l": side[0]}
        out |= {f"{side}_{part}": name.format(**words) for part, name in parts.items()}
    return out


def fingers(pattern: str, names: Mapping[str, str]) -> dict[str, str]:
    """SMPL-X finger joint -> name; "{f}" is the finger's name, "{n}" the bone's number, sides as in ``sided``."""
    parts = {
        f"{finger}{n}": pattern.replace("{f}", word).replace("{n}", str(n))
        for finger, word in names.items()
        for n in (1, 2, 3)
    }
    return sided(**parts)


def biped_fingers(start: str, gap: str = " ") -> dict[str, str]:
    """The names of 3ds Max: Finger0, Finger01, Finger02 of the thumb, Finger1 of the index, and so on."""
    numbers = [(finger, place, n) for place, finger in enumerate(FINGERS) for n in (1, 2, 3)]
    return {
        f"{side}_{finger}{n}": f"{start}{side[0].upper()}{gap}Finger{place}{n - 1 if n > 1 else ''}"
        for side in ("left", "right")
        for finger, place, n in numbers
    }


PLAIN = {finger: finger for finger in FINGERS}
TITLE = {finger: finger.title() for finger in FINGERS}
_MIXAMO = {
    **{"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"},
    **sided(hip="{S}UpLeg", knee="{S}Leg", ankle="{S}Foot", foot="{S}ToeBase", collar="{S}Shoulder"),
    **sided(shoulder="{S}Arm", elbow="{S}ForeArm", wrist="{S}Hand"),
    **fingers("{S}Hand{f}{n}", TITLE),
}
_VRM = {
    **{"pelvis": "J_Bip_C_Hips", "spine1": "J_Bip_C_Spine", "spine2": "J_Bip_C_Chest", "spine3": "J_Bip_C_UpperChest"},
    **{"neck": "J_Bip_C_Neck", "head": "J_Bip_C_Head"},
    **sided(hip="J_Bip_{L}_UpperLeg", knee="J_Bip_{L}_LowerLeg", ankle="J_Bip_{L}_Foot", foot="J_Bip_{L}_ToeBase"),
    **sided(collar="J_Bip_{L}_Shoulder", shoulder="J_Bip_{L}_UpperArm", elbow="J_Bip_{L}_LowerArm"),
    **sided(wrist="J_Bip_{L}_Hand", eye_smplhf="J_Adj_{L}_FaceEye"),
    **fingers("J_Bip_{L}_{f}{n}", {**TITLE, "pinky": "Little"}),
}
_UNREAL = {
    **{"pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_02", "spine3": "spine_03", "neck": "neck_01"},
    **{"head": "head"},
    **sided(hip="thigh_{l}", knee="calf_{l}", ankle="foot_{l}", foot="ball_{l}", collar="clavicle_{l}"),
    **sided(shoulder="upperarm_{l}", elbow="lowerarm_{l}", wrist="hand_{l}"),
    **fingers("{f}_0{n}_{l}", PLAIN),
}
_RIGIFY = {
    **{"pelvis": "DEF-spine", "spine1": "DEF-spine.001", "spine2": "DEF-spine.002", "spine3": "DEF-spine.003"},
    **{"neck": "DEF-neck", "head": "DEF-head"},
    **sided(hip="DEF-thigh.{L}", knee="DEF-shin.{L}", ankle="DEF-foot.{L}", foot="DEF-toe.{L}"),
    **sided(collar="DEF-shoulder.{L}", shoulder="DEF-upper_arm.{L}", elbow="DEF-forearm.{L}", wrist="DEF-hand.{L}"),
    **fingers("DEF-{f}.0{n}.{L}", {finger: finger if finger == "thumb" else f"f_{finger}" for finger in FINGERS}),
}
_MAKEHUMAN = {
    **{"pelvis": "root", "spine1": "spine05", "spine2": "spine03", "spine3": "spine01", "neck": "neck01"},
    **{"head": "head", "jaw": "jaw"},
    **sided(hip="upperleg01.{L}", knee="lowerleg01.{L}", ankle="foot.{L}", foot="toe1-1.{L}", collar="clavicle.{L}"),
    **sided(shoulder="upperarm01.{L}", elbow="lowerarm01.{L}", wrist="wrist.{L}", eye_smplhf="eye.{L}"),
    **fingers("finger{f}-{n}.{L}", {finger: str(place) for place, finger in enumerate(FINGERS, 1)}),
}
_BIPED = {
    **{"pelvis": "Bip01 Pelvis", "spine1": "Bip01 Spine", "spine2": "Bip01 Spine1", "spine3": "Bip01 Spine2"},
    **{"neck": "Bip01 Neck", "head": "Bip01 Head"},
    **sided(hip="Bip01 {L} Thigh", knee="Bip01 {L} Calf", ankle="Bip01 {L} Foot", foot="Bip01 {L} Toe0"),
    **sided(collar="Bip01 {L} Clavicle", shoulder="Bip01 {L} UpperArm", elbow="Bip01 {L} Forearm"),
    **sided(wrist="Bip01 {L} Hand"),
    **biped_fingers("Bip01 "),
}
_DAZ = {
    **{"pelvis": "hip", "spine1": "abdomenLower", "spine2": "abdomenUpper", "spine3": "chestLower"},
    **{"neck": "neckLower", "head": "head"},
    **sided(hip="{l}ThighBend", knee="{l}Shin", ankle="{l}Foot", foot="{l}Toe", collar="{l}Collar"),
    **sided(shoulder="{l}ShldrBend", elbow="{l}ForearmBend", wrist="{l}Hand", eye_smplhf="{l}Eye"),
    **fingers("{l}{f}{n}", {**TITLE, "middle": "Mid"}),
}
_REALLUSION = {
    **{"pelvis": "CC_Base_Hip", "spine1": "CC_Base_Waist", "spine2": "CC_Base_Spine01", "spine3": "CC_Base_Spine02"},
    **{"neck": "CC_Base_NeckTwist01", "head": "CC_Base_Head", "jaw": "CC_Base_JawRoot"},
    **sided(hip="CC_Base_{L}_Thigh", knee="CC_Base_{L}_Calf", ankle="CC_Base_{L}_Foot", foot="CC_Base_{L}_ToeBase"),
    **sided(collar="CC_Base_{L}_Clavicle", shoulder="CC_Base_{L}_Upperarm", elbow="CC_Base_{L}_Forearm"),
    **sided(wrist="CC_Base_{L}_Hand", eye_smplhf="CC_Base_{L}_Eye"),
    **fingers("CC_Base_{L}_{f}{n}", {**TITLE, "middle": "Mid"}),
}


def _other(joint: str) -> str:
    side, _, part = joint.partition("_")
    return {"left": "right_", "right": "left_"}.get(side, side) + part


_SMPL = {name: name for name in JOINT_NAMES[:22]}
_FEW = {
    **{"pelvis": "Hips", "spine3": "Chest", "head": "Head"},
    **sided(hip="UpperLeg.{L}", knee="LowerLeg.{L}", shoulder="UpperArm.{L}", elbow="LowerArm.{L}"),
}

FAMILIES = {
    "Mixamo, centimetres": Family(
        {joint: f"mixamorig:{name}" for joint, name in _MIXAMO.items()}, unit=0.01, along=True, prone=True
    ),
    "Ready Player Me": Family(_MIXAMO, arms=50.0, more={"HeadTop_End": "head"}, twists=("left_shoulder",)),
    "VRM 0.x": Family(_VRM, backwards=True, vrm=0, more={"J_Sec_Hair1_01": "head", "J_Opt_C_Tail": "pelvis"}),
    "VRM 1.0": Family({joint: f"bone {place}" for place, joint in enumerate(_VRM)}, vrm=1, prone=True),
    "Unreal": Family(
        _UNREAL, arms=45.0, unit=0.01, z_up=True, along=True, twists=("left_hip", "right_elbow", "left_shoulder"),
        more={"ik_foot_l": "pelvis", "index_metacarpal_l": "left_wrist"},
    ),
    "Rigify": Family(
        _RIGIFY, arms=30.0, z_up=True, along=True, more={"ORG-spine": "pelvis", "MCH-thigh.L": "left_hip"}
    ),
    "MakeHuman": Family(_MAKEHUMAN, arms=45.0, more={"upperleg02.L": "left_hip", "spine04": "spine1"}),
    "3ds Max Biped": Family(_BIPED, unit=0.0254, along=True, z_up=True, more={"Bip01": "pelvis"}),
    "Daz": Family(_DAZ, unit=0.01, arms=20.0, twists=("left_hip", "right_hip", "left_shoulder", "right_elbow")),
    "Reallusion": Family(_REALLUSION, unit=0.01, arms=35.0, more={"CC_Base_BoneRoot": "pelvis"}),
    "SMPL": Family(_SMPL, along=True),
    "left called right": Family(
        {_other(joint): name for joint, name in _UNREAL.items()}, more={"thigh_twist_01_r": "left_hip"}
    ),
    "a toy of nine joints": Family(_FEW, arms=60.0, unit=3.0),
}  # fmt: skip


@dataclass(frozen=True)
class Built:
    """A file, and what is true of it."""

    data: bytes
    names: list[str]  # of the nodes
    joint_nodes: dict[str, int]  # SMPL-X joint -> node


def build(family: Family) -> Built:
    """A glb: a cube around every joint and one between it and its parent, bound half and half."""
    body = open_body()
    joints = body.joints - np.array([0, body.joints[:, 1].min(), 0])
    rotations = np.zeros((55, 3))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        rotations[JOINT_NAMES.index(f"{side}_shoulder"), 2] = sign * np.radians(family.arms)
    frames = _forward(joints, rotations)  # as bound
    whole = np.eye(4)
    if family.backwards:
        whole[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    frames = whole @ frames

    # joints that there are, each with the nearest above it
    nodes: list[tuple[str, str | None, np.ndarray]] = []  # name, parent's name, world frame as bound
    called = dict(family.names)
    for index, joint in enumerate(JOINT_NAMES):
        if joint not in called:
            continue
        above = int(PARENTS[index])
        while above >= 0 and JOINT_NAMES[above] not in called:
            above = int(PARENTS[above])
        frame = frames[index].copy()
        if family.along:
            frame[:3, :3] = frame[:3, :3] @ rotation_matrices([0.3 * index, 1.1, -0.2 * index])
        nodes.append((called[joint], called[JOINT_NAMES[above]] if above >= 0 else None, frame))
        if joint in family.twists:
            half = frame.copy()
            half[:3, 3] += frames[index][:3, :3] @ (np.sign(joints[index, 0]) * np.array([0.05, 0, 0]))
            nodes.append((f"{called[joint]}_twist_01", called[joint], half))
    for name, joint in family.more.items():
        frame = frames[JOINT_NAMES.index(joint)].copy()
        frame[:3, 3] += (0.0, 0.01, 0.02)
        nodes.append((name, called[joint], frame))
    return _file(family, nodes)


def _forward(joints: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    out = np.tile(np.eye(4), (len(joints), 1, 1))
    turns = rotation_matrices(rotations)
    for index, parent in enumerate(PARENTS):
        above = out[parent] if parent >= 0 else np.eye(4)
        offset = joints[index] - (joints[parent] if parent >= 0 else 0)
        out[index, :3, :3] = above[:3, :3] @ turns[index]
        out[index, :3, 3] = above[:3, :3] @ offset + above[:3, 3]
    return out


def _file(family: Family, nodes: list[tuple[str, str | None, np.ndarray]]) -> Built:
    names = [name for name, _, _ in nodes]
    armature = np.diag([family.unit] * 3 + [1.0])  # the world from what is stored
    if family.z_up:
        armature[:3, :3] = family.unit * rotation_matrices([-np.pi / 2, 0, 0])
    stored = np.linalg.inv(armature) @ np.array([frame for _, _, frame in nodes])
    stored[:, :3, :3] *= family.unit  # joints have no scale of their own in the space that they are stored in
    rng = np.random.default_rng(3)
    locals_ = []
    for index, (_, parent, _) in enumerate(nodes):
        above = stored[names.index(parent)] if parent is not None else np.eye(4)
        local = np.linalg.solve(above, stored[index])
        if family.prone:
            local[:3, :3] = local[:3, :3] @ rotation_matrices(rng.normal(0, 0.2, 3))
        locals_.append(local)
    points, joints, weights, faces = [], [], [], []
    for index, (_, parent, frame) in enumerate(nodes):
        above = names.index(parent) if parent is not None else index
        for at, pair in ((frame[:3, 3], (index, index)), ((frame[:3, 3] + nodes[above][2][:3, 3]) / 2, (index, above))):
            faces.append(_FACES + len(points) * 8)
            points.append(np.linalg.inv(armature)[:3, :3] @ (_CUBE + at).T)
            joints += [(*pair, 0, 0)] * 8
            weights += [(0.5, 0.5, 0, 0)] * 8
    stack = np.concatenate([p.T for p in points]).astype("<f4")
    accessors, views, blob = glb_arrays(
        stack,
        np.array(joints, np.uint16),
        np.array(weights, "<f4"),
        np.concatenate(faces).reshape(-1, 1).astype("<u4"),
        np.linalg.inv(stored).transpose(0, 2, 1).reshape(-1, 16).astype("<f4"),
    )
    attributes = {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}
    children = {name: [i for i, (_, parent, _) in enumerate(nodes) if parent == name] for name in names}
    count = len(nodes)
    out = []
    for (name, _, _), local in zip(nodes, locals_, strict=True):
        turn = matrix_quaternions(local[:3, :3])
        node: dict[str, object] = {"name": name, "translation": local[:3, 3].tolist(), "rotation": [*turn[1:], turn[0]]}
        out.append(node | ({"children": children[name]} if children[name] else {}))
    roots = [i for i, (_, parent, _) in enumerate(nodes) if parent is None]
    out.append({"name": "Armature", "children": [*roots, count + 1], "matrix": armature.T.reshape(-1).tolist()})
    out.append({"name": "Body", "mesh": 0, "skin": 0})
    joint_nodes = {joint: names.index(name) for joint, name in family.names.items()}
    gltf: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [count]}],
        "nodes": out,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3}]}],
        "skins": [{"joints": list(range(count)), "inverseBindMatrices": 4}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    if family.vrm is not None:
        gltf["extensions"] = _vrm(family.vrm, joint_nodes)
    return Built(glb_of(gltf, blob), [str(n["name"]) for n in out], joint_nodes)


def _vrm(version: int, nodes: Mapping[str, int]) -> dict[str, object]:
    words = {"hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes", "collar": "Shoulder"}
    words |= {"shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand", "eye_smplhf": "Eye"}
    middle = {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest"}
    middle |= {"neck": "neck", "head": "head"}
    bones = {}
    for joint, node in nodes.items():
        side, _, part = joint.partition("_")
        if joint in middle:
            bones[middle[joint]] = node
        elif part in words:
            bones[side + words[part]] = node
        elif part[:-1] in FINGERS:
            finger = {"pinky": "Little"}.get(part[:-1], part[:-1].title())
            segments = ("Proximal", "Intermediate", "Distal")
            if version == 1 and finger == "Thumb":
                segments = ("Metacarpal", "Proximal", "Distal")
            bones[side + finger + segments[int(part[-1]) - 1]] = node
    if version == 1:
        humanoid = {"humanBones": {bone: {"node": node} for bone, node in bones.items()}}
        return {"VRMC_vrm": {"specVersion": "1.0", "humanoid": humanoid}}
    return {"VRM": {"humanoid": {"humanBones": [{"bone": b, "node": n} for b, n in bones.items()]}}}
