"""Convert faces of OpenXR's extensions to ARKit's 52 shapes.

XR_FB_face_tracking2 (XrFaceExpression2FB: 70 weights after FACS; Meta's documentation "Movement SDK: ARKit mapping"
has the table) and XR_HTC_facial_tracking (XrEyeExpressionHTC: 14, XrLipExpressionHTC: 37).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from glsplat.skinning.expression import ARKIT

Table = Mapping[str, tuple[int, ...]]
"""ARKit's shape -> the weights of which it is the mean."""


def _pairs(**first: int) -> dict[str, tuple[int, ...]]:
    """Return entries for both sides; the right weight follows the left."""
    return {name + side: (index + i,) for name, index in first.items() for i, side in enumerate(("Left", "Right"))}


META: Table = {
    **_pairs(browDown=0, cheekSquint=4, mouthDimple=10, eyeBlink=12, eyeLookDown=14, eyeLookUp=20, eyeSquint=28),
    **_pairs(mouthFrown=30, mouthSmile=32, mouthPress=38, mouthStretch=42, mouthLowerDown=51, noseSneer=55),
    **_pairs(browOuterUp=57, eyeWide=59, mouthUpperUp=61),
    # weights are to the user's left and right, ARKit's in and out
    **{"eyeLookOutLeft": (16,), "eyeLookInRight": (17,), "eyeLookInLeft": (18,), "eyeLookOutRight": (19,)},
    **{"browInnerUp": (22, 23), "cheekPuff": (2, 3), "jawOpen": (24,), "jawLeft": (25,), "jawRight": (26,)},
    **{"jawForward": (27,), "mouthClose": (50,), "mouthFunnel": (34, 35, 36, 37), "mouthPucker": (40, 41)},
    **{"mouthRollLower": (44, 46), "mouthRollUpper": (45, 47), "mouthShrugLower": (8,), "mouthShrugUpper": (9,)},
    **{"mouthLeft": (53,), "mouthRight": (54,), "tongueOut": (68,)},
}

HTC_EYES: Table = {
    **{"eyeBlinkLeft": (0,), "eyeWideLeft": (1,), "eyeBlinkRight": (2,), "eyeWideRight": (3,)},
    **_pairs(eyeSquint=4, eyeLookDown=6, eyeLookUp=12),
    **{"eyeLookOutLeft": (8,), "eyeLookInRight": (9,), "eyeLookInLeft": (10,), "eyeLookOutRight": (11,)},
}

HTC_LIPS: Table = {
    **{"jawRight": (0,), "jawLeft": (1,), "jawForward": (2,), "jawOpen": (3,), "mouthClose": (4,)},
    **{"mouthRight": (5, 7), "mouthLeft": (6, 8), "mouthFunnel": (9, 10), "mouthPucker": (11,)},
    **{"mouthSmileRight": (12,), "mouthSmileLeft": (13,), "mouthFrownRight": (14,), "mouthFrownLeft": (15,)},
    **{"cheekPuff": (16, 17), "mouthUpperUpRight": (19,), "mouthUpperUpLeft": (20,)},
    **{"mouthLowerDownRight": (21,), "mouthLowerDownLeft": (22,), "mouthRollUpper": (23,), "mouthRollLower": (24,)},
    **{"mouthShrugLower": (25,), "tongueOut": (26, 32)},
}
_APE = 4  # XR_LIP_EXPRESSION_MOUTH_APE_SHAPE_HTC: jaw open behind closed lips, ARKit's mouthClose and jawOpen


def expression_of_meta(weights: Sequence[float]) -> dict[str, float]:
    """Return ARKit's weights by name, without zeros, from the 70 of XrFaceExpression2FB."""
    return _mapped(META, weights)


def expression_of_htc(eyes: Sequence[float] | None, lips: Sequence[float] | None) -> dict[str, float]:
    """Return ARKit's weights from XrEyeExpressionHTC's 14 and XrLipExpressionHTC's 37; None: no such tracker."""
    out = {} if eyes is None else _mapped(HTC_EYES, eyes)
    if lips is not None:
        out |= _mapped(HTC_LIPS, lips)
        if len(lips) > _APE and lips[_APE] > out.get("jawOpen", 0.0):
            out["jawOpen"] = float(lips[_APE])
    return out


def _mapped(table: Table, weights: Sequence[float]) -> dict[str, float]:
    found = {}
    for name in ARKIT:
        indices = table.get(name)
        if indices and indices[-1] < len(weights):
            value = sum(weights[i] for i in indices) / len(indices)
            if value:  # NaN is kept for the tracker to refuse
                found[name] = float(value)
    return found
