"""Convert VRCFaceTracking's parameters to ARKit's shapes.

Names: Unified Expressions, single and combined (benaclejames/VRCFaceTracking, UnifiedExpressionsParameters.cs and
UnifiedSimpleExpressions.cs, whose formulas are inverted here). Shapes: the table "Tracking Standard Comparison" of
docs.vrcft.io. ARKit's own names are accepted, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from glsplat.skinning.expression import ARKIT, arkit_name

_PREFIX = "/avatar/parameters/"  # then perhaps FT/v2/, v2/, or a prefix of the avatar's maker

Part = tuple[str, float]  # a parameter with the sign of its conversion, and its share
Ways = tuple[tuple[Part, ...], ...]  # alternatives; the first with received values is used

# conversions by sign: identity, positive half, negative half, complement to 1, lids that close, lids that widen
_CONVERSIONS: dict[str, Callable[[float], float]] = {
    "": lambda v: v,
    "+": lambda v: max(0.0, v),
    "-": lambda v: max(0.0, -v),
    "!": lambda v: 1 - v,
    "~": lambda v: 1 - min(1.0, v / 0.75),  # EyeLid: 0 closed, .75 open, 1 wide
    "^": lambda v: (v - 0.75) / 0.25,
}


def _one(*names: str) -> Ways:
    return tuple(((name, 1.0),) for name in names)


def _mean(*names: str) -> tuple[Part, ...]:
    return tuple((name, 1 / len(names)) for name in names)


def _lips(name: str) -> Ways:
    upper, lower = (tuple(f"{name}{half}{side}" for side in ("Left", "Right")) for half in ("Upper", "Lower"))
    return (_mean(*upper, *lower), _mean(f"{name}Upper", f"{name}Lower"), *_one(name))


def _sided(side: str) -> dict[str, Ways]:
    """Return the shapes of one side."""
    ways = {
        "eyeBlink": _one(f"EyeClosed{side}", f"!EyeOpen{side}", f"~EyeLid{side}", "EyeClosed", "!EyeOpen", "~EyeLid"),
        "eyeWide": _one(f"EyeWide{side}", f"^EyeLid{side}", "EyeWide", "^EyeLid"),
        "eyeSquint": _one(f"EyeSquint{side}", "EyeSquint", "EyesSquint"),
        "mouthSmile": (
            ((f"MouthCornerPull{side}", 0.8), (f"MouthCornerSlant{side}", 0.2)),
            *_one(f"MouthSmile{side}", f"+SmileFrown{side}", f"+SmileSad{side}", "+SmileFrown", "+SmileSad"),
        ),
        "mouthFrown": _one(
            f"MouthFrown{side}", f"-SmileFrown{side}", f"MouthSad{side}", f"-SmileSad{side}", "-SmileFrown", "-SmileSad"
        ),
        "mouthDimple": _one(f"MouthDimple{side}", "MouthDimple"),
        "mouthStretch": _one(f"MouthStretch{side}", "MouthStretch"),
        "mouthPress": _one(f"MouthPress{side}", "MouthPress"),
        "mouthLowerDown": _one(f"MouthLowerDown{side}", "MouthLowerDown", "MouthOpen"),
        "mouthUpperUp": _one(f"MouthUpperUp{side}", "MouthUpperUp", "MouthOpen"),
        "browDown": (
            ((f"BrowLowerer{side}", 0.75), (f"BrowPinch{side}", 0.25)),
            *_one(f"BrowDown{side}", f"-BrowExpression{side}", "BrowDown", "-BrowExpression"),
        ),
        "browOuterUp": _one(
            f"BrowOuterUp{side}", "BrowOuterUp", f"BrowUp{side}", f"+BrowExpression{side}", "BrowUp", "+BrowExpression"
        ),
        "cheekSquint": _one(f"CheekSquint{side}", "CheekSquint"),
        "noseSneer": _one(f"NoseSneer{side}", "NoseSneer"),
    }
    return {name + side: way for name, way in ways.items()}


def _pair(name: str, sign: str = "") -> tuple[Part, ...]:
    return _mean(f"{sign}{name}Left", f"{sign}{name}Right")


_RULES: dict[str, Ways] = {
    **_sided("Left"),
    **_sided("Right"),
    "jawOpen": _one("JawOpen"),
    "jawForward": _one("JawForward", "+JawZ"),
    "jawLeft": _one("JawLeft", "-JawX"),
    "jawRight": _one("JawRight", "+JawX"),
    "mouthClose": _one("MouthClosed"),
    "mouthFunnel": _lips("LipFunnel"),
    "mouthPucker": _lips("LipPucker"),
    "mouthLeft": (_mean("MouthUpperLeft", "MouthLowerLeft"), _mean("-MouthUpperX", "-MouthLowerX"), *_one("-MouthX")),
    "mouthRight": (
        _mean("MouthUpperRight", "MouthLowerRight"),
        _mean("+MouthUpperX", "+MouthLowerX"),
        *_one("+MouthX"),
    ),
    "mouthRollLower": (_pair("LipSuckLower"), *_one("LipSuckLower", "LipSuck")),
    "mouthRollUpper": (_pair("LipSuckUpper"), *_one("LipSuckUpper", "LipSuck")),
    "mouthShrugLower": _one("MouthRaiserLower"),
    "mouthShrugUpper": _one("MouthRaiserUpper"),
    "browInnerUp": (
        *(_pair("BrowInnerUp"), *_one("BrowInnerUp"), _pair("BrowUp"), _pair("BrowExpression", "+")),
        *_one("BrowUp", "+BrowExpression"),
    ),
    "cheekPuff": (_pair("CheekPuff"), _pair("CheekPuffSuck", "+"), *_one("CheekPuff", "+CheekPuffSuck")),
    "tongueOut": _one("TongueOut"),
}
_GAZE = ("EyeLeftX", "EyeLeftY", "EyeRightX", "EyeRightY", "EyeX", "EyeY")

PARAMETERS: frozenset[str] = frozenset(
    [*(name.lstrip("+-!~^") for ways in _RULES.values() for way in ways for name, _ in way), *_GAZE, *ARKIT]
)
"""All known parameters, with ARKit's own names."""


def parameter_of(address: str) -> str | None:
    """Return the parameter of an address; None for an unknown one.

    >>> parameter_of("/avatar/parameters/FT/v2/JawOpen"), parameter_of("/avatar/parameters/mouth_smile_left")
    ('JawOpen', 'mouthSmileLeft')
    """
    if not address.startswith(_PREFIX):
        return None
    name = address.rpartition("/")[2]
    return name if name in PARAMETERS else arkit_name(name)


def weights_of(values: Mapping[str, float]) -> dict[str, float]:
    """Return the weights of ARKit's shapes, 0 to 1, for which parameters are known."""
    out = {}
    for shape in ARKIT:
        for way in (((shape, 1.0),), *_RULES.get(shape, ())):
            known = [(name, share) for name, share in way if name.lstrip("+-!~^") in values]
            if known:
                total = sum(share * _converted(name, values) for name, share in known) / sum(
                    share for _, share in known
                )
                out[shape] = min(1.0, max(0.0, total))
                break
    return out


def gaze_of(values: Mapping[str, float], side: str) -> tuple[float, float, float] | None:
    """Return the gaze of the "Left" or "Right" eye in the head's axes (-z ahead); X, Y are tangents, right and up."""
    for eye in (f"Eye{side}", "Eye"):
        if f"{eye}X" in values or f"{eye}Y" in values:
            return (values.get(f"{eye}X", 0.0), values.get(f"{eye}Y", 0.0), -1.0)
    return None


def _converted(name: str, values: Mapping[str, float]) -> float:
    bare = name.lstrip("+-!~^")
    return _CONVERSIONS[name.removesuffix(bare)](values[bare])
