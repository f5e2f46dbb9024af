"""Parse a joint's name: side, part of the body and number. The only table of names, for all rigs.

Names are split into words ("mixamorig:LeftHandThumb1", "DEF-upper_arm.L.001", "lThighBend", "J_Bip_R_LowerLeg",
"CC_Base_L_Calf"), so that rigs of unknown families are parsed as well.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# part -> its names without side, number, prefix and blanks, best first
_PARTS: dict[str, tuple[str, ...]] = {
    "hip": ("thigh", "upleg", "upperleg", "thighbend", "legupper", "femur", "hip"),
    "knee": ("shin", "calf", "lowerleg", "lowleg", "leglower", "leg", "knee", "tibia"),
    "ankle": ("foot", "ankle"),
    "foot": ("toebase", "ball", "toe", "toes", "foottoe", "forefoot"),
    "collar": ("clavicle", "collar", "collarbone", "clav", "scapula", "shoulder"),
    "shoulder": ("upperarm", "uparm", "armupper", "arm", "humerus", "uarm", "shldrbend", "shldr", "shoulder", "bicep"),
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
        *("ribs", "trunk", "bust", "sternum", "lumbar"),
    ),
    **{finger: (finger, f"hand{finger}", f"f{finger}", f"{finger}finger", f"finger{finger}") for finger in FINGERS},
}
_PARTS["middle"] += ("mid", "handmid", "fmid")
_PARTS["pinky"] += ("little", "handlittle", "flittle", "littlefinger", "pinkie", "small")
_PARTS["index"] += ("point", "pointer", "fore")
_KNOWN = {
    stem: tuple(part for part, others in _PARTS.items() if stem in others)
    for stems in _PARTS.values()
    for stem in stems
}
_RANK = {(part, stem): rank for part, stems in _PARTS.items() for rank, stem in enumerate(stems)}
_PHALANX = {"proximal": 1, "intermediate": 2, "distal": 3}
_SIDES = {"left": "left", "l": "left", "lft": "left", "lf": "left", "right": "right", "r": "right", "rgt": "right"}
_SIDES |= {"rt": "right", "lt": "left"}
# words that make a joint a helper, a target or a tip instead of the named part
_HELPERS = set(
    """
ik fk pole target ctrl control ctl controller orient helper twist roll mch org tweak vis end
nub tip site top tracker slot socket attach prop hair skirt brow eyebrow lid eyelid lash lip
tongue teeth breast boob butt metacarpal carpal weapon muscle corrective adj offset parent
share leaf part pectoral pec buttock glute chin mouth eyebrows both wrinkle bulge gun
virtual dyn physics spring cloth sleeve cape tail wing ear nose cheek
""".split()
)
_PREFIXES = set(
    """
def bip bip01 bip001 biped bone jnt joint rig armature skeleton b j cc base mixamorig valve
valvebiped character c m sk jt bn root actor avg stretch x bind deform dfm skin start
""".split()
)
_WHERE = {"upper", "lower", "middle", "mid", "low", "up"}  # position on a spine or a neck
_LIMBS = {"arm", "leg", "head", "hand", "foot", "face"}  # the limb of a part: "arm left elbow"
_PIECES = {"finger", "phalanx"}
# MikuMikuDance
_JAPANESE = dict(
    pair.split("=")
    for pair in (
        "足首=ankle 手首=wrist つま先=toe 足先=toe ひざ=knee ひじ=elbow 親指=thumb 人指=index 人差指=index "
        "人差し指=index 中指=middle 薬指=ring 小指=pinky 上半身=spine 下半身=pelvis 両=both 捩=twist 膝=knee "
        "肘=elbow 左=left 右=right 頭=head 首=neck 肩=shoulder 腕=upperarm 足=thigh 手=hand 目=eye 髪=hair "
        "胸=breast スカート=skirt 先=end キャンセル=helper"
    ).split()
)
_FOREIGN = re.compile("|".join(sorted(_JAPANESE, key=len, reverse=True)))
_COPIES = re.compile(r"(thigh|knee|ankle) D$")  # MikuMikuDance: the bone that moves the skin
_ESCAPED = re.compile(r"FBXASC(\d{3})")  # Autodesk's escape of a character that FBX does not allow
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


@dataclass(frozen=True)
class Word:
    """A parsed name."""

    side: str  # "left", "right" or ""
    parts: tuple[str, ...]  # candidates, keys of _PARTS; empty for anything else
    stem: str  # the word that matched
    number: int | None  # of a joint of the spine or a finger
    deforms: bool  # "DEF-": a joint of Rigify that moves the skin

    def rank(self, part: str) -> int:
        """Return the rank of the word for the part; 0 is best."""
        return _RANK.get((part, self.stem), 99)


def words_of(names: Sequence[str]) -> list[Word]:
    """Parse the names, without a word with which more than half of them begin or end ("Bob_LeftArm")."""
    split = [_split(name) for name in names]
    for end in (0, 0, -1):
        said = Counter(words[end] for words in split if len(words) > 1)
        word, count = said.most_common(1)[0] if said else ("", 0)
        if 2 * count > sum(1 for words in split if words) and not _means(word):
            keep = slice(1, None) if end == 0 else slice(None, -1)
            split = [words[keep] if len(words) > 1 and words[end] == word else words for words in split]
    return [_word(words) for words in split]


def word_of(name: str) -> Word:
    """Parse one joint's name. An unknown name has no parts."""
    return _word(_split(name))


def _means(word: str) -> bool:
    """Return whether a word has a meaning and has to be kept."""
    return word in _KNOWN or word in _SIDES or word in _HELPERS or word in ("def", "bip", "finger")


def _split(name: str) -> list[str]:
    plain = _ESCAPED.sub(lambda found: chr(int(found[1]) % 128), name)
    plain = next((part for part in reversed(re.split(r"[:|]", plain)) if part), "")
    text = re.sub(r"(?i)(?<![a-z])bip\d+", "bip ", plain)
    text = re.sub(r"(?<![A-Za-z])([LR])([UF])(?=Arm)", r"\1 \2", text)  # OptiTrack: the upper arm, the forearm
    if not text.isascii():
        text = _FOREIGN.sub(lambda found: f" {_JAPANESE[found[0]]} ", unicodedata.normalize("NFKC", text))
        text = _COPIES.sub(r"\1", re.sub(" +", " ", re.sub(r"[^\x00-\x7f]+", " x0 ", text)).strip())
    return [word.lower() for word in _WORDS.findall(text)]


def _word(words: Sequence[str]) -> Word:
    deforms = list(words[:1]) == ["def"]
    side, kept, number = "", [], None
    for place, word in enumerate(words):
        if word.isdigit():
            number = int(word[:6]) if number is None else number  # later ones are an exporter's ("_07")
        elif word in _SIDES and not side and (len(word) > 2 or len(words) > 1):
            side = _SIDES[word]
        elif word in _PHALANX:
            number = _PHALANX[word]
        elif word in ("a", "b", "c") and place == len(words) - 1 and place and words[place - 1].isdigit():
            number = "abc".index(word) + 1  # "index_01a": of one finger
        else:
            kept.append(word)
    if "thumb" in kept and "metacarpal" in kept:  # a thumb's first moving bone
        kept.remove("metacarpal")
        number = 0
    helper = any(word in _HELPERS for word in kept)
    if len(kept) > 1 and {"base", "start"} & set(kept) and set(FINGERS) & set(kept):
        number = 0
    while len(kept) > 1 and kept[-1] in _PREFIXES:
        kept.pop()
    while len(kept) > 1 and kept[0] in _PREFIXES:
        kept.pop(0)
    stem = "".join(kept)
    if helper and stem not in _KNOWN:  # a "NeckTwist" is a neck, an "UpperArmTwist" a helper
        return Word(side, (), "", number, deforms)
    if stem == "finger":
        stem, number = _numbered_finger([word for word in words if word.isdigit()], "bip" in words)
    if stem not in _KNOWN:
        stem = _simplified(kept)
    if stem not in _KNOWN and not side and stem[1:] in _KNOWN and stem[:1] in ("l", "r"):  # "lfemur"
        side, stem = _SIDES[stem[0]], stem[1:]
    elif stem not in _KNOWN and not side and stem[-1:] in ("l", "r") and stem[:-1] in _KNOWN:  # "thighl"
        side, stem = _SIDES[stem[-1]], stem[:-1]
    for word, found in (("left", "left"), ("right", "right")):  # "leftupleg"
        if stem not in _KNOWN and not side and stem.startswith(word) and stem[len(word) :] in _KNOWN:
            side, stem = found, stem[len(word) :]
    return Word(side, _KNOWN.get(stem, ()), stem, number, deforms)


def _simplified(kept: Sequence[str]) -> str:
    """Join the words without redundant ones: "head neck lower", "hand index phalanx", "spine middle"."""
    words = [word for word in kept if word not in _PIECES]
    if len(words) > 1 and words[0] in _LIMBS and "".join(words) not in _KNOWN:
        words = words[1:]
    stem = "".join(words)
    if stem in _KNOWN:
        return stem
    plain = "".join(word for word in words if word not in _WHERE)
    return plain if {"spine", "neck"} & set(_KNOWN.get(plain, ())) else "".join(kept)


def _numbered_finger(digits: Sequence[str], biped: bool) -> tuple[str, int | None]:
    """Parse "finger2-1" (MakeHuman: finger from the thumb, 1; bone) and "Finger11" (Biped: from the thumb, 0)."""
    if not biped and len(digits) > 1 and digits[0] in ("1", "2", "3", "4", "5"):
        return FINGERS[int(digits[0]) - 1], int(digits[1][:6])
    if digits and len(digits[0]) <= 2 and digits[0][0] in "01234" and (biped or len(digits) == 1):
        return FINGERS[int(digits[0][0])], int(digits[0][1:] or 0) + 1
    return "finger", None
