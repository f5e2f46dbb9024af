"""Map a rig's joints to the 55 of SMPL-X, by their names and positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.rigs.words import FINGERS, Word, words_of
from glsplat.skinning.smplx import JOINT_NAMES

_SIDES = ("left", "right")
NEEDED = ("head", *(f"{side}_{part}" for part in ("hip", "knee", "shoulder", "elbow") for side in _SIDES))
"""Joints that a driven rig must have; any other that is missing is placed as on the reference body."""

_LEG, _ARM = ("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist")
_DEEPEST = 256  # joints from a fingertip to the root; limits hostile files
_PELVIS = 0.25  # of the way from hips to shoulders; a spine's lowest joint below it is the pelvis
_ABOVE, _BELOW = 0.03, 1.1  # of that way: range of a spine's joints
_PLACE = 1e-4  # of a rig's size: joints closer than that coincide


@dataclass(frozen=True)
class RigMap:
    """SMPL-X joint -> index in the rig, in SMPL-X's order."""

    joints: Mapping[str, int]
    missing: tuple[str, ...]  # missing joints of NEEDED; with any, the rig cannot be driven

    def __len__(self) -> int:
        return len(self.joints)


def other_side(joint: str) -> str:
    """Return the joint's name with left and right exchanged."""
    side, _, part = joint.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, joint)


def match_rig(
    names: Sequence[str],
    parents: ArrayLike,  # [J] -1 for a root
    positions: ArrayLike,  # [J, 3] at rest, in any unit and axes
    given: Mapping[str, int | None] | None = None,  # SMPL-X joint -> index, None if the rig has none; has priority
    holds: ArrayLike | None = None,  # [J] whether the joint moves vertices; such a joint is preferred to its copy
) -> RigMap:
    """Return the map of a rig. Entries of ``given`` (a VRM's own map, a user's file) are not changed."""
    known = dict(given or {})
    unknown = sorted(set(known) - set(JOINT_NAMES))
    if unknown:
        raise PoseError(f'a rig map names joints of SMPL-X (left_hip, ...), not "{unknown[0]:.40}"')
    moves = np.ones(len(names), bool) if holds is None else np.asarray(holds, bool)
    rig = _Rig(names, np.asarray(parents, np.intp), np.asarray(positions, np.float64), moves)
    found: dict[str, int] = {name: index for name, index in known.items() if index is not None}
    for side in _SIDES:
        _take(found, known, _limbs(rig, side))
    _take(found, known, _middle(rig, found))
    for side in _SIDES:
        _take(found, known, _fingers(rig, side, found))
    taken = set(found.values())
    if len(taken) < len(found):
        double = next(name for name, index in found.items() if list(found.values()).count(index) > 1)
        raise PoseError(f"a rig map gives the joint {names[found[double]]!r:.60} twice, once as {double}")
    ordered = {name: found[name] for name in JOINT_NAMES if name in found}
    return RigMap(ordered, tuple(name for name in NEEDED if name not in ordered))


class _Rig:
    """Words, depths and ancestors of a rig's joints."""

    def __init__(
        self, names: Sequence[str], parents: NDArray[np.intp], positions: F64, holds: NDArray[np.bool_]
    ) -> None:
        self.parents, self.positions = parents, positions
        words = words_of(names)
        if any(word.deforms for word in words):  # Rigify: only these move the skin, others have the same names
            words = [word if word.deforms else Word(word.side, (), "", None, False) for word in words]
        self.words = words
        self.above = _Above(self.parents)
        self.holds = holds.copy()  # itself or a descendant
        for index in np.flatnonzero(holds):
            at = int(parents[index])
            while at >= 0 and not self.holds[at]:
                self.holds[at] = True
                at = int(parents[at])
        moved = {(part, word.side) for i, word in enumerate(words) if self.holds[i] for part in word.parts}
        for i, word in enumerate(words):  # a skeleton of controls beside the skin's, under the same names
            if word.parts and not (self.holds[i] or holds[self.above[i]].any()):
                words[i] = replace(word, parts=tuple(p for p in word.parts if (p, word.side) not in moved))
        self.leads = np.zeros(len(names), bool)  # has children
        self.leads[parents[parents >= 0]] = True

    def called(self, part: str, side: str = "") -> list[int]:
        """Return candidates for a part, best first: by the word, then the nearest to the root, then the big toe.

        A copy that moves no vertices (a target or control) comes last, as does a hand without children.
        """
        found = [i for i, word in enumerate(self.words) if part in word.parts and word.side == side]
        found = [i for i in found if not self._on_its_parent(i, found)]
        toe = [word.number or 0 if part == "foot" else 0 for word in self.words]
        ends = part == "wrist"
        return sorted(
            found,
            key=lambda i: (
                *(not self.holds[i], ends and not self.leads[i]),
                *(self.words[i].rank(part), len(self.above[i]), toe[i], i),
            ),
        )

    def _on_its_parent(self, joint: int, found: Sequence[int]) -> bool:
        """Return whether a joint is at its parent, above another of ``found`` with its word (CMU's LHipJoint)."""
        parent, stem = int(self.parents[joint]), self.words[joint].stem
        if parent < 0 or not any(joint in self.above[i] and self.words[i].stem == stem for i in found):
            return False
        size = float(np.abs(self.positions - self.positions[0]).max())
        return float(np.abs(self.positions[joint] - self.positions[parent]).max()) < _PLACE * size

    def stem(self, index: int | None) -> str:
        """Return the word that identifies a joint; "" for None."""
        return "" if index is None else self.words[index].stem


class _Above(dict[int, list[int]]):
    """Joint -> its ancestors, the nearest first, at most ``_DEEPEST``."""

    def __init__(self, parents: NDArray[np.intp]) -> None:
        self._parents = parents

    def __missing__(self, index: int) -> list[int]:
        out: list[int] = []
        at = int(self._parents[index])
        while at >= 0 and len(out) < _DEEPEST:
            out.append(at)
            at = int(self._parents[at])
        self[index] = out
        return out


def _take(found: dict[str, int], known: Mapping[str, int | None], more: Mapping[str, int]) -> None:
    """Add entries whose part is not known and whose joint is not used yet."""
    used = set(found.values())
    for name, index in more.items():
        if name not in found and name not in known and index not in used:
            found[name] = index
            used.add(index)


def _limbs(rig: _Rig, side: str) -> dict[str, int]:
    """Return the leg, arm, collar and eye of a side."""
    best = {part: cands[0] for part in (*_LEG, *_ARM) if (cands := rig.called(part, side))}
    feet = sorted(rig.called("ankle", side), key=lambda i: len(rig.above[i]))
    if len(feet) > 1 and feet[0] in rig.above[feet[1]]:  # SMPL's "ankle" and "foot": the lower is the toes
        best["ankle"] = feet[0]
        best.setdefault("foot", feet[1])
    for chain, stem in ((_LEG, "knee"), (_ARM, "shoulder")):  # "leg_joint_1", "leg_joint_2", ...: one word for all
        alike = [i for i in rig.called(stem, side) if rig.stem(i) == rig.stem(best.get(stem))]
        alike.sort(key=lambda i: len(rig.above[i]))
        alike = [i for i in alike if i == alike[0] or alike[0] in rig.above[i]]
        if not {chain[0], chain[1]} <= set(best) and len(alike) >= 2:
            best |= {part: i for part, i in zip(chain, alike, strict=False) if part in chain[:2] or part not in best}
    _ambiguous(rig, side, best)
    for chain in (_LEG, _ARM):  # with two people, or a skeleton and its copy, use one of them
        for upper, lower in pairwise(part for part in chain if part in best):
            below = [i for i in rig.called(lower, side) if best[upper] in rig.above[i]]
            if best[upper] not in rig.above[best[lower]] and below:
                best[lower] = below[0]
    collars = [i for i in rig.called("collar", side) if i not in best.values()]
    if collars and "collar" not in best:
        best["collar"] = collars[0]
    if eyes := rig.called("eye", side):
        best["eye_smplhf"] = eyes[0]
    return {f"{side}_{part}": index for part, index in best.items()}


def _ambiguous(rig: _Rig, side: str, best: dict[str, int]) -> None:
    """Resolve words that mean different bones in different rigs by the rig's other words."""
    knees = [i for i in rig.called("knee", side) if rig.stem(i) == "knee" and best["knee"] in rig.above[i]]
    if knees and rig.stem(best["knee"]) == "leg" and rig.stem(best.get("hip")) in ("", "hip"):  # "Leg", "Knee"
        best["hip"], best["knee"] = best["knee"], knees[0]
    upper = best.get("shoulder", -1)
    if "elbow" not in best:  # "UpperArm", "Arm"
        arms = [i for i in rig.called("shoulder", side) if rig.stem(i) == "arm" and upper in rig.above[i]]
        if arms:
            best["elbow"] = arms[0]
    if rig.stem(upper if upper >= 0 else None) == "shoulder":  # "shoulder 1", "shoulder 2": a collar and an arm
        lower = [i for i in rig.called("shoulder", side) if rig.stem(i) == "shoulder" and upper in rig.above[i]]
        if lower and not any(rig.stem(i) != "shoulder" for i in rig.called("collar", side)):
            best["shoulder"], best["collar"] = lower[0], upper


def _middle(rig: _Rig, found: Mapping[str, int]) -> dict[str, int]:
    """Return pelvis, spine, neck, head and jaw."""
    if not {f"{side}_{part}" for side in _SIDES for part in ("hip", "shoulder")} <= set(found):
        return {"head": named[0]} if (named := rig.called("head")) else {}  # or it would be reported missing
    hips, shoulders = (
        np.mean([rig.positions[found[f"{side}_{part}"]] for side in _SIDES], axis=0) for part in ("hip", "shoulder")
    )
    trunk = shoulders - hips
    height = (rig.positions - hips) @ trunk / max(float(trunk @ trunk), 1e-12)
    out: dict[str, int] = {}
    spine = sorted(rig.called("spine"), key=lambda i: (height[i], len(rig.above[i])))
    legs = _common(rig, [found[f"{side}_hip"] for side in _SIDES])
    if pelvis := rig.called("pelvis"):
        out["pelvis"] = pelvis[0]
    elif spine and height[spine[0]] < _PELVIS and not (legs in rig.above[spine[0]] and abs(height[legs]) < _PELVIS):
        out["pelvis"] = spine[0]
    else:
        out["pelvis"] = legs
    column = {*rig.called("neck"), *spine, out["pelvis"]}
    heads = sorted(rig.called("head"), key=lambda i: (not column & set(rig.above[i]), rig.words[i].rank("head")))
    if heads:
        out["head"] = heads[0]
    necks = sorted(rig.called("neck"), key=lambda i: (height[i], len(rig.above[i])))
    if necks:
        out["neck"] = necks[0]
        if len(necks) > 1 and not heads:
            out["head"] = necks[-1]
    bears = {i for side in _SIDES for i in rig.above[found[f"{side}_shoulder"]]}
    high = [i for i in spine if height[i] > 1 and i not in bears]
    if high and not heads and not necks:  # Rigify: the spine continues to the top of the head
        out |= {"neck": high[0], "head": high[-1]} if len(high) > 1 else {"head": high[0]}
    spine = [i for i in spine if i not in out.values()]
    if jaws := rig.called("jaw"):
        out["jaw"] = jaws[0]
    bones = [i for i in spine if _ABOVE < height[i] < _BELOW]
    if not bones:  # without names: the joints from the arms to the pelvis
        way = rig.above[found["left_shoulder"]]
        limbs = set(found.values())
        way = way[: way.index(out["pelvis"])] if out["pelvis"] in way else way
        bones = [i for i in way if i not in limbs and _ABOVE < height[i] < _BELOW][::-1]
    return out | spine_of(bones)


def spine_of(bones: Sequence[int]) -> dict[str, int]:
    """Map any number of bones, from below, to SMPL-X's three. One becomes the chest, two the first and the last."""
    if not bones:
        return {}
    if len(bones) == 1:
        return {"spine3": bones[0]}
    out = {"spine1": bones[0], "spine3": bones[-1]}
    if len(bones) > 2:
        out["spine2"] = bones[len(bones) // 2]
    return out


def _common(rig: _Rig, joints: Sequence[int]) -> int:
    """Return the nearest common ancestor; without one, the first joint's root."""
    shared = set.intersection(*(set(rig.above[i]) for i in joints))
    way = rig.above[joints[0]]
    return next((i for i in way if i in shared), way[-1] if way else joints[0])


def _fingers(rig: _Rig, side: str, found: Mapping[str, int]) -> dict[str, int]:
    """Return up to three bones a finger, from the palm outwards. Their arm decides the side, then their names."""
    out: dict[str, int] = {}
    arms = {
        s: {found[f"{s}_{part}"] for part in ("wrist", "elbow", "shoulder") if f"{s}_{part}" in found} for s in _SIDES
    }
    for finger in FINGERS:
        bones = []
        for i, word in enumerate(rig.words):
            if finger not in word.parts:
                continue
            on = next((s for s in _SIDES if arms[s] & set(rig.above[i])), word.side)
            if on == side:
                bones.append(i)
        bones.sort(key=lambda i: (len(rig.above[i]), rig.words[i].number or 0))
        beyond = [i for i in bones if rig.words[i].number != 0]
        bones = beyond if len(beyond) >= 3 else bones  # 0 is a bone in the palm
        if len(bones) > 3 and [rig.words[i].number for i in bones[:2]] == [None, 1]:
            bones.pop(0)  # without a number, before the first: in the palm
        out |= {f"{side}_{finger}{place}": i for place, i in enumerate(bones[:3], 1)}
    return out
