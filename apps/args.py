"""Options that several commands share: the scene, its light, levels of detail, and argparse types."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glsplat.avatar import splats_of
from glsplat.config import CULL_PSNR, LEAN, MAX_LEVELS
from glsplat.data import PEOPLE, default_avatar, embedded_file
from glsplat.errors import FormatError, PoseError
from glsplat.formats import suffixes
from glsplat.formats.motion_files import KINDS, split_choice
from glsplat.formats.registry import load
from glsplat.formats.scene_file import UPS, SceneFile, load_scene, upright
from glsplat.formats.transform import transformed
from glsplat.io.files import naming, read_json
from glsplat.light.light import PRESETS, Light
from glsplat.meshes import RiggedMesh
from glsplat.optional import plugin
from glsplat.scene import Content, Rigged, Scene, is_rigged
from glsplat.skinning.driven import why_not_tracked
from glsplat.skinning.expression import checked_expression
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

from .usage import UsageError

if TYPE_CHECKING:
    from glsplat.motion.motion import Motion

_MAX_LIGHT_BYTES = 1 << 20  # of a file of --light

_PEOPLE = f"{', '.join(PEOPLE[:-1])} or {PEOPLE[-1]}"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the positional SCENE, --up and --strict."""
    what = f"a {suffixes()}, or a scene file (JSON), or an embedded person: {_PEOPLE}; default: the embedded avatar"
    parser.add_argument("scene", nargs="?", metavar="SCENE", help=what)
    add_up(parser)
    parser.add_argument("--strict", action="store_true", help="refuse files with NaN or infinity")


def add_light(parser: argparse.ArgumentParser) -> None:
    """Add --light."""
    parser.add_argument(
        "--light",
        type=light_name,
        metavar="NAME|FILE",
        help=f"light on avatars with a surface (docs/light.md): {', '.join(PRESETS)}, or a JSON file; "
        "none: as photographed (default: the scene file's light, else none)",
    )


def _lit(file: SceneFile, args: Any) -> SceneFile:
    """Set the light of --light, if the command has it, and return ``file``."""
    name = getattr(args, "light", None)
    if name is not None:
        file.scene.light = None if name == "none" else light_of(name)
        splats = [item.content for item in file.scene.items if not isinstance(item.content, RiggedMesh)]
        every = [one for content in splats for one in (content, *(level.content for level in content.levels))]
        if file.scene.light is not None and all(splats_of(one).surface is None for one in every):
            print("--light: nothing here knows its surface, so nothing is lit (docs/light.md)", file=sys.stderr)
    return file


def light_of(text: str) -> Light:
    """Return a light of a preset's name, or of a JSON file (as "light" of a scene file). Raises FormatError."""
    if text in PRESETS or not Path(text).exists():
        return Light.preset(text)
    with naming(text):
        return Light.from_json(read_json(text, "a light", _MAX_LIGHT_BYTES))


def light_name(text: str) -> str:
    """Return a light's name after checking that it can be read; "none" for no light (argparse type)."""
    if text != "none":
        try:
            light_of(text)
        except FormatError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
    return text


def add_up(parser: argparse.ArgumentParser, what: str = "the file's axis that points up") -> None:
    """Add --up."""
    parser.add_argument("--up", choices=UPS, default="y", help=f"{what} (default y; most 3DGS captures: -y)")


def add_solver(parser: argparse.ArgumentParser) -> None:
    """Add --solver."""
    from glsplat.tracking.solvers import SOLVERS  # here: few commands need the solvers

    parser.add_argument(
        "--solver", choices=SOLVERS, default=SOLVERS[0], help=f"solver of the body's pose (default {SOLVERS[0]})"
    )


def open_scene(args: Any) -> SceneFile:
    """Return the scene file or single content that the arguments name, rotated by --up and lit by --light."""
    if args.scene is None:
        return _lit(SceneFile.of(default_avatar()), args)
    path = embedded_file(args.scene)
    if not path.exists():
        raise FormatError(f"{args.scene}: no such file; give a {suffixes()} or a scene file, {_PEOPLE}, or nothing")
    file = load_scene(path, strict=args.strict)
    _report_doubts(file, args.scene)
    turn = upright(args.up)
    if args.up == "y":
        return _lit(file, args)
    if len(file.scene) == 1 and isinstance(splats := file.scene.items[0].content, Splats) and not file.composed:
        return _lit(SceneFile.of(transformed(splats, turn)), args)  # an identity transform renders fastest
    for item in file.scene:
        item.transform = turn @ item.transform
    return _lit(file, args)


def _report_doubts(file: SceneFile, name: str) -> None:
    """Print what looks wrong in the motions of a scene file on stderr, once for each motion."""
    if not file.motions:
        return
    reported = set()
    for place, (item, motion) in file.motions.items():
        if is_rigged(item.content) and id(motion) not in reported:
            reported.add(id(motion))
            if line := _doubt(motion, item.content.skeleton, "FILE"):
                print(f"{name}: item {place}, motion {motion.label}: {line}", file=sys.stderr)


def single(file: SceneFile) -> Content | None:
    """Return the content of a scene of one still item at its original place; None for other scenes."""
    items = file.scene.items
    alone = len(items) == 1 and items[0].visible and not file.motions and items[0].pose is None
    return items[0].content if alone and np.array_equal(items[0].transform, np.eye(4)) else None


def load_avatar(path: str | Path, option: str, *, strict: bool = False) -> Rigged:
    """Return the avatar that an option names: splats with a skin, or a rigged mesh. Raises UsageError."""
    file = embedded_file(path)
    if not file.exists():
        raise UsageError(f"{option} {path}: no such file, nor an embedded person ({_PEOPLE})")
    try:
        content = load(file, strict=strict)
    except FormatError as error:
        raise FormatError(f"{option} {error}") from None
    if isinstance(content, Scene):
        raise UsageError(f"{option} {path}: expected one avatar, found a scene file")
    if not is_rigged(content):
        found = "splats without a skeleton" if isinstance(content, Splats) else "a mesh without joints to move"
        raise UsageError(f"{option} {path}: expected an avatar (a .glb with a skin, a rigged mesh), found {found}")
    return content


def driven(file: SceneFile, what: str) -> Rigged:
    """Return the single visible avatar, whose pose an option or a client sets. Raises UsageError without one."""
    if file.avatar is not None:
        assert is_rigged(file.avatar.content)
        return file.avatar.content
    if file.scene.figures:
        raise UsageError(f"{what} is for one avatar, this scene has several; say in the scene file what each does")
    raise UsageError(f"this scene has no skeleton; {what} needs an avatar (a .glb with a skin, a rigged mesh)")


def tracked(skeleton: Skeleton, name: str) -> Skeleton:
    """Return ``skeleton``. Raises PoseError, which names the file ``name``, if tracking cannot drive it."""
    if why := why_not_tracked(skeleton):
        raise PoseError(f"{name}: tracking cannot drive this avatar: {why}")
    return skeleton


def _doubt(motion: Motion, skeleton: Skeleton, name: str) -> str:
    """Return a line about what looks wrong in a motion; "" if nothing does, or extras/motions is not installed."""
    module = plugin("motions.doubts")
    return "" if module is None else module.doubt(motion, skeleton, name)


def motion_of(name: str, skeleton: Skeleton, option: str = "--motion") -> Motion:
    """Return the motion that an option names, from a file or embedded; notes about it are printed on stderr.

    Raises UsageError if there is none.
    """
    from glsplat.formats.motion_files import embedded_motions, load_motion

    if not split_choice(name)[0].exists() and name not in embedded_motions():
        known = ", ".join(embedded_motions()) or "none"
        raise UsageError(f"{option} {name}: no such file and no such motion; files are {KINDS}; embedded are {known}")
    motion = load_motion(name, skeleton)
    own = name in embedded_motions() and not Path(name).exists()
    for line in (motion.note, "" if own else _doubt(motion, skeleton, name)):
        if line:
            print(f"{option} {name}: {line}", file=sys.stderr)
    return motion


def add_driver(parser: argparse.ArgumentParser) -> None:
    """Add --float-target, --sorter and --device."""
    parser.add_argument(
        "--float-target", choices=("auto", "8", "16f", "32f"), default="auto", help="accumulation format"
    )
    parser.add_argument(
        "--sorter", choices=("auto", "cpu", "gpu"), default="auto", help="where splats are sorted (auto: the faster)"
    )
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE)")


def add_detail(parser: argparse.ArgumentParser, *, lean: bool) -> None:
    """Add --level, --lod-bias and --cull-hidden; if they are on by default (``lean``), also --exact."""
    default = "auto" if lean else "0"
    parser.add_argument(
        "--level",
        type=detail_level,
        metavar="N",
        help="level of detail: 0 the finest, higher numbers coarser, auto: by the pixels that an item covers "
        f"(default {default})",
    )
    parser.add_argument(
        "--lod-bias",
        type=Number(-8, 8),
        metavar="B",
        help="bias of --level auto: 1 chooses levels for twice the pixels, -1 for half (default 0)",
    )
    parser.add_argument(
        "--cull-hidden",
        action="store_true",
        help="cull splats that are hidden by their visibility cones"
        + (f" (default: if the worst picture keeps {CULL_PSNR:g} dB)" if lean else ""),
    )
    if lean:
        parser.add_argument(
            "--exact", action="store_true", help="draw every splat of the finest level, without cut-off"
        )


_LEAN = ("target", "level", "cull_hidden", "max_sigma")  # fields of LEAN that differ from the pixel contract


def detail_of(args: Any) -> dict[str, Any]:
    """Return the fields of RenderConfig of the options of ``add_detail``. Raises UsageError for contradictions."""
    exact = getattr(args, "exact", False)
    given = [name for name in ("level", "lod_bias") if getattr(args, name) is not None]
    given += ["cull_hidden"] if args.cull_hidden else []
    if exact:
        if given:
            raise UsageError(f"--exact and --{given[0].replace('_', '-')} contradict each other; leave one out")
        return {}
    lean = hasattr(args, "exact")
    defaults: dict[str, Any] = {name: getattr(LEAN, name) for name in _LEAN} if lean else {}
    level = defaults.get("level", 0) if args.level is None else args.level
    if args.lod_bias is not None and level != "auto":
        raise UsageError("--lod-bias goes with --level auto")
    return defaults | {
        "level": level,
        "lod_bias": args.lod_bias or 0.0,
        "cull_hidden": True if args.cull_hidden else defaults.get("cull_hidden", False),
    }


@dataclass(frozen=True, slots=True)
class Number:
    """A parser of finite numbers from ``low`` to ``high``, both included; whole ones for ``kind`` int."""

    low: float
    high: float = sys.float_info.max
    unit: str = ""
    kind: type[float] | type[int] = float

    def __call__(self, text: str) -> float:
        """Parse a word of the command line. Raises ArgumentTypeError."""
        try:
            value = self.kind(text)
        except ValueError:
            raise self.error(text) from None
        return self.checked(value)

    def checked(self, value: object) -> float:
        """Return a value of the file, or a parsed one. Raises ArgumentTypeError."""
        if not isinstance(value, (int, self.kind)) or isinstance(value, bool) or not self.low <= value <= self.high:
            raise self.error(value)
        return self.kind(value)

    def error(self, got: object) -> argparse.ArgumentTypeError:
        """Return the error for a value that is no such number."""
        span = f"of at least {self.low:g}" if self.high == sys.float_info.max else f"from {self.low:g} to {self.high:g}"
        whole = "whole " if self.kind is int else ""
        unit = self.unit and f" {self.unit}"
        return argparse.ArgumentTypeError(f"needs a {whole}number {span}{unit}, not {as_toml(got)}")


def whole(low: int, high: float = sys.float_info.max, unit: str = "") -> Number:
    """Return a parser of whole numbers from ``low`` to ``high``, both included (argparse type)."""
    return Number(low, high, unit, int)


def as_toml(value: object) -> str:
    """Return a value about as a TOML file has it, for messages."""
    shown = str(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False, default=str)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."


def detail_level(text: str) -> int | str:
    """Parse a level of detail, a number or auto (argparse type)."""
    if text == "auto":
        return text
    if not text.isdecimal() or int(text) > MAX_LEVELS:
        raise argparse.ArgumentTypeError(f"a level is 0 to {MAX_LEVELS} or auto, not {text!r}")
    return int(text)


def size(text: str) -> tuple[int, int]:
    """Parse WxH, or one number for a square (argparse type)."""
    try:
        parts = [int(part) for part in text.lower().split("x")]
        width, height = parts * 2 if len(parts) == 1 else parts
    except ValueError:
        raise argparse.ArgumentTypeError(f"a size is WxH, for example 1024x1024, not {text!r}") from None
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"a size is at least 1x1, not {text!r}")
    return width, height


natural = whole(0)
"""Parse a whole number of at least 0 (argparse type)."""

not_negative = Number(0)
"""Parse a finite number of at least 0 (argparse type)."""


def positive(text: str) -> float:
    """Parse a finite number above 0 (argparse type)."""
    try:
        value = not_negative(text)
    except argparse.ArgumentTypeError:
        value = 0.0
    if value == 0:
        raise argparse.ArgumentTypeError(f"needs a number above 0, not {text!r}")
    return value


def degrees(text: str) -> float:
    """Parse a field of view between 0 and 180 degrees (argparse type)."""
    value = positive(text)
    if value >= 180:
        raise argparse.ArgumentTypeError(f"a field of view lies between 0 and 180 degrees, not {text!r}")
    return value


def point(text: str) -> tuple[float, float, float]:
    """Parse a point x,y,z in metres (argparse type)."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"a point is x,y,z, for example 0,1,3, not {text!r}") from None
    if not np.isfinite((x, y, z)).all():
        raise argparse.ArgumentTypeError(f"a point is three finite numbers, not {text!r}")
    return x, y, z


def expression(text: str) -> Mapping[str, float]:
    """Parse weights NAME=WEIGHT,... of an avatar's shapes (argparse type)."""
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    try:
        found = {name.strip(): float(weight) for name, _, weight in pairs}
        checked_expression(found)
        if not found or len(found) < len(pairs):
            raise ValueError
    except (ValueError, PoseError):
        raise argparse.ArgumentTypeError(
            f"an expression is NAME=WEIGHT,..., for example jawOpen=0.7,eyeBlinkLeft=1, not {text!r:.60}"
        ) from None
    return found  # with zeros, which override the weights of a motion


def colour(text: str) -> tuple[float, float, float]:
    """Parse red,green,blue from 0 to 1 (argparse type)."""
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        red = green = blue = np.nan
    if not (0 <= red <= 1 and 0 <= green <= 1 and 0 <= blue <= 1):
        raise argparse.ArgumentTypeError(f"a colour is R,G,B from 0 to 1, for example 0.2,0.2,0.2, not {text!r}")
    return red, green, blue
