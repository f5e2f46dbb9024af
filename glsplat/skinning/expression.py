"""Expressions: weights of named shapes of a face, by the 52 names of ARKit; reading, mixing, and names of others."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

from glsplat.errors import PoseError


def _sides(*names: str) -> tuple[str, ...]:
    return tuple(name + side for name in names for side in ("Left", "Right"))


_EYE = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")

ARKIT: tuple[str, ...] = (
    *(name + "Left" for name in _EYE),
    *(name + "Right" for name in _EYE),
    *("jawForward", "jawLeft", "jawRight", "jawOpen"),
    *("mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *_sides("mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch"),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *_sides("mouthPress", "mouthLowerDown", "mouthUpperUp", "browDown"),
    *("browInnerUp", *_sides("browOuterUp"), "cheekPuff", *_sides("cheekSquint"), *_sides("noseSneer"), "tongueOut"),
)
"""The blend shapes of Apple's ARFaceAnchor.BlendShapeLocation, in the order of its documentation."""

MOST_NAMES = 256
"""Limit of the names of an expression, and of the shapes of an avatar."""

_MAX_NAME = 64  # characters
_NONE: Mapping[str, float] = MappingProxyType({})

# letters of a name in lower case -> ARKit's; left and right as ending or as L and R
_KNOWN = {name.lower(): name for name in ARKIT} | {
    re.sub(r"(Left|Right)$", lambda match: match.group()[0], name).lower(): name for name in ARKIT
}
# https://github.com/vrm-c/vrm-specification/blob/master/specification/VRMC_vrm-1.0/expressions.md (presets that are one
# shape of ARKit); VRM 0.x has the same under Blink, Blink_L, Blink_R
_KNOWN |= {"blinkleft": "eyeBlinkLeft", "blinkright": "eyeBlinkRight", "blinkl": "eyeBlinkLeft"}
_KNOWN |= {"blinkr": "eyeBlinkRight"}


def arkit_name(name: str) -> str | None:
    """Return ARKit's name of another program's shape; None where ARKit has no such shape.

    Capitals, separators and prefixes before a dot are ignored, L and R are Left and Right: Live Link's
    ``EyeBlinkLeft``, ICT-FaceKit's ``eyeBlink_L``, ``blendShape1.jaw_open``, VRM's ``blinkLeft``.

    >>> arkit_name("Face.M_F00_EyeBlink_L"), arkit_name("mouth_smile_right"), arkit_name("Fcl_ALL_Joy")
    ('eyeBlinkLeft', 'mouthSmileRight', None)
    """
    last = re.split(r"[.:/|]", name)[-1]
    words = [word for word in re.split(r"[^A-Za-z0-9]+", last) if word]
    for first in range(len(words)):  # a prefix of the exporter's may stand before it
        found = _KNOWN.get("".join(words[first:]).lower())
        if found is not None:
            return found
    return None


def checked_expression(value: Any) -> Mapping[str, float]:
    """Return weights by name, without zeros, from a mapping or from numbers in ``ARKIT``'s order; empty for None.

    The mapping is read-only. Raises PoseError for other values, NaN, infinity, and more than 256 names.
    """
    if value is None:
        return _NONE
    if isinstance(value, Mapping):
        pairs = list(value.items())
    elif isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes)):
        if len(value) != len(ARKIT):
            raise PoseError(f"an expression needs {len(ARKIT)} numbers in ARKit's order, or names, not {len(value)}")
        pairs = list(zip(ARKIT, value, strict=True))
    else:
        raise PoseError(f"an expression needs weights by name, or {len(ARKIT)} numbers, not {type(value).__name__}")
    if not pairs:
        return _NONE
    if len(pairs) > MOST_NAMES:
        raise PoseError(f"an expression needs at most {MOST_NAMES} names, not {len(pairs)}")
    out: dict[str, float] = {}
    for name, weight in pairs:
        if not isinstance(name, str) or not 0 < len(name) <= _MAX_NAME:
            raise PoseError(f"an expression names shapes by 1 to {_MAX_NAME} characters, not {name!r:.40}")
        if isinstance(weight, (bool, np.bool_, str, bytes)):
            raise PoseError(f'the weight of "{name}" needs a number, not {type(weight).__name__}')
        try:
            amount = float(weight)
        except (TypeError, ValueError, OverflowError):
            raise PoseError(f'the weight of "{name}" needs a number, not {type(weight).__name__}') from None
        if not isfinite(amount):
            raise PoseError(f'the weight of "{name}" needs a finite number, found NaN or infinity')
        if amount:
            out[name] = amount
    return MappingProxyType(out)


def mixed(first: Mapping[str, float], second: Mapping[str, float], part: float) -> Mapping[str, float]:
    """Interpolate two expressions: ``part`` 0 is the first, 1 the second; beyond, extrapolate.

    >>> dict(mixed({"jawOpen": 0.2}, {"jawOpen": 0.6, "cheekPuff": 1.0}, 0.5))
    {'jawOpen': 0.4, 'cheekPuff': 0.5}
    """
    if not first and not second:
        return _NONE
    names = dict.fromkeys([*first, *second])
    return checked_expression({n: first.get(n, 0.0) * (1 - part) + second.get(n, 0.0) * part for n in names})
