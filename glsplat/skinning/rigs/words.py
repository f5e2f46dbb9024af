"""What a joint's name says: the side, the part of the body, and its number. The one table of names of all rigs.

Names are read as words ("mixamorig:LeftHandThumb1", "DEF-upper_arm.L.001", "lThighBend", "J_Bip_R_LowerLeg" and
"CC_Base_L_Calf" say so each in their own way), so that a rig of a family that nobody thought of is read as well.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

__all__ = ["FINGERS", "Word", "word_of"]

FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# part -> what is left of its names without side, number, prefix and blanks; the first that a rig has is the best
_PARTS: dict[str, tuple[str, ...]] = {
    "hip": ("thigh", "upleg", "upperleg", "thighbend", "legupper", "femur", "hip"),
    "knee": ("shin", "calf", "lowerleg", "lowleg", "leglower", "leg", "knee", "tibia"),
    "ankle": ("foot", "ankle"),
    "foot": ("toebase", "toe", "toes", "ball", "foottoe", "forefoot"),
    "collar": ("clavicle", "collar", "collarbone", "clav", "shoulder"),
    "shoulder": ("upperarm", "uparm", "armupper", "arm", "humerus", "uarm", "shldrbend", "shldr", "shoulder"),
    "elbow": ("forearm", "lowerarm", "lowarm", "armlower", "farm", "elbow", "radius", "forearmbend"),
    "wrist": ("wrist", "hand", "palm"),
    "eye": ("eye", "faceeye", "eyesmplhf", "eyeball"),
    "jaw": ("jaw", "lowerjaw", "jawroot"),
    "head": ("head",),
    "neck": ("neck", "lowerneck", "necklower", "upperneck", "neckupper", "necktwist"),
    "pelvis": ("pelvis", "hips", "hip"),
    "spine": (
        *("spine", "chest", "upperchest", "chestupper", "chestlower", "abdomen", "abdomenlower", "abdomenupper", "ab"),
        *("torso", "waist", "thorax", "lowerback", "upperback", "stomach", "belly", "tummy", "back", "ribcage"),
    ),
    **{finger: (finger, f"hand{finger}", f"f{finger}", f"{finger}finger", f"finger{finger}") for finger in FINGERS},
}
_ALSO = {
    "middle": ("mid", "handmid", "fmid"),
    "pinky": ("little", "handlittle", "flittle", "littlefinger", "pinkie", "small"),
    "index": ("point", "pointer"),
}
_KNOWN = {
    stem: tuple(part for part, stems in _PARTS.items() if stem in (*stems, *_ALSO.get(part, ())))
    for stem in {stem for part in _PARTS for stem in (*_PARTS[part], *_ALSO.get(part, ()))}
}
_RANK = {
    (part, stem): rank for part, stems in _PARTS.items() for rank, stem in enumerate((*stems, *_ALSO.get(part, ())))
}
_PHALANX = {"proximal": 1, "intermediate": 2, "distal": 3}
_SIDES = {"left": "left", "l": "left", "lft": "left", "lf": "left", "right": "right", "r": "right", "rgt": "right"}
_SIDES |= {"rt": "right", "lt": "left"}
# words that make a joint something else than the part they stand beside: a helper, a target, a tip
_HELPERS = {
    *("ik", "fk", "pole", "target", "ctrl", "control", "ctl", "controller", "orient", "helper", "twist", "roll"),
    *("mch", "org", "tweak", "vis", "end", "nub", "tip", "site", "top", "tracker", "slot", "socket", "attach", "prop"),
    *("hair", "skirt", "brow", "eyebrow", "lid", "eyelid", "lash", "lip", "tongue", "teeth", "breast", "boob", "butt"),
    *("metacarpal", "carpal", "weapon", "muscle", "corrective", "adj", "offset", "parent", "share"),
    *("gun", "virtual", "dyn", "physics", "spring", "cloth", "sleeve", "cape", "tail", "wing", "ear", "nose", "cheek"),
}
_PREFIXES = {"def", "bip", "bip01", "bip001", "biped", "bone", "jnt", "joint", "rig", "armature", "skeleton", "b", "j"}
_PREFIXES |= {"cc", "base", "mixamorig", "valvebiped", "character", "c", "m", "sk", "jt", "bn", "root", "actor", "avg"}
_ESCAPED = re.compile(r"FBXASC(\d{3})")  # Autodesk's way to write a character that FBX does not allow
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


@dataclass(frozen=True)
class Word:
    """What a name says."""

    side: str  # "left", "right" or ""
    parts: tuple[str, ...]  # what it may be, of _PARTS; empty for anything else
    stem: str  # the word by which
    number: int | None  # of a spine, a finger's bone
    deforms: bool  # "DEF-": of a Rigify rig, the joint that holds the skin

    def rank(self, part: str) -> int:
        """How well the word fits the part; 0 is best."""
        return _RANK.get((part, self.stem), 99)


def word_of(name: str) -> Word:
    """Read a joint's name. A name that means nothing has no parts."""
    plain = _ESCAPED.sub(lambda found: chr(int(found[1])), name)
    plain = re.sub(r"(?i)\bbip\d+", "bip", re.split(r"[:|]", plain)[-1])
    plain = re.sub(r"(?<![A-Za-z])([LR])([UF])(?=Arm)", r"\1 \2", plain)  # OptiTrack: the upper arm, the forearm
    words = [word.lower() for word in _WORDS.findall(plain)]
    deforms = words[:1] == ["def"]
    side, kept, number = "", [], None
    for place, word in enumerate(words):
        if word.isdigit():
            number = int(word) if number is None else number  # what follows is an exporter's own ("_07")
        elif word in _SIDES and not side and (len(word) > 2 or _stands_alone(words, place)):
            side = _SIDES[word]
        elif word in _PHALANX:
            number = _PHALANX[word]
        else:
            kept.append(word)
    helper = any(word in _HELPERS for word in kept)
    while len(kept) > 1 and kept[0] in _PREFIXES:
        kept.pop(0)
    while len(kept) > 1 and kept[-1] in _PREFIXES:
        kept.pop()
    stem = "".join(kept)
    if helper and stem not in _KNOWN:  # a "NeckTwist" is a neck, an "UpperArmTwist" a helper
        return Word(side, (), "", number, deforms)
    if stem == "finger":
        stem, number = _numbered_finger([word for word in words if word.isdigit()])
    if stem not in _KNOWN and not side and stem[1:] in _KNOWN and stem[:1] in ("l", "r"):  # "lfemur"
        side, stem = _SIDES[stem[0]], stem[1:]
    elif stem not in _KNOWN and not side and stem[-1:] in ("l", "r") and stem[:-1] in _KNOWN:  # "thighl"
        side, stem = _SIDES[stem[-1]], stem[:-1]
    for word, found in (("left", "left"), ("right", "right")):  # "leftupleg"
        if stem not in _KNOWN and not side and stem.startswith(word) and stem[len(word) :] in _KNOWN:
            side, stem = found, stem[len(word) :]
    return Word(side, _KNOWN.get(stem, ()), stem, number, deforms)


def _numbered_finger(digits: list[str]) -> tuple[str, int | None]:
    """ "finger2-1" (MakeHuman: from the thumb, 1; then the bone) and "Finger11" (Biped: from the thumb, 0)."""
    if len(digits) == 2 and digits[0] in "12345":
        return FINGERS[int(digits[0]) - 1], int(digits[1])
    if len(digits) == 1 and len(digits[0]) <= 2 and digits[0][0] in "01234":
        return FINGERS[int(digits[0][0])], int(digits[0][1:] or 0) + 1
    return "finger", None


def _stands_alone(words: list[str], place: int) -> bool:
    """Whether a letter is a word of its own: at either end but for numbers, or between others."""
    return len(words) > 1 and words[place] in ("l", "r", "lf", "lt", "rt")
