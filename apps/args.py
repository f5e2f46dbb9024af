"""What several commands share on their command lines: the scene, the view and the picture's size."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
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
from glsplat.io.files import naming, open_regular
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

__all__ = [
    "add_detail",
    "add_light",
    "add_scene",
    "add_solver",
    "add_up",
    "colour",
    "degrees",
    "detail_level",
    "detail_of",
    "driven",
    "expression",
    "light_of",
    "load_avatar",
    "motion_of",
    "natural",
    "not_negative",
    "open_scene",
    "point",
    "positive",
    "single",
    "size",
    "tracked",
]


_LIGHT_BYTES = 1 << 20
"""Of a file of --light."""

_PEOPLE = f"{', '.join(PEOPLE[:-1])} or {PEOPLE[-1]}"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The positional SCENE, --up and --strict."""
    what = f"a {suffixes()}, or a scene file (JSON), or an embedded person: {_PEOPLE}; default: the embedded avatar"
    parser.add_argument("scene", nargs="?", metavar="SCENE", help=what)
    add_up(parser)
    parser.add_argument("--strict", action="store_true", help="refuse files with NaN or infinity instead of skipping")


def add_light(parser: argparse.ArgumentParser) -> None:
    """--light."""
    parser.add_argument(
        "--light",
        metavar="NAME|FILE",
        help=f"light the avatars that know their surface (docs/light.md): {', '.join(PRESETS)}, or a JSON file; "
        "none: as they were photographed (default: what a scene file says, else none)",
    )


def _lit(file: SceneFile, args: Any) -> SceneFile:
    """The scene under --light, where that is an option and given."""
    asked = getattr(args, "light", None)
    if asked is not None:
        file.scene.light = None if asked == "none" else light_of(asked)
        if file.scene.light is not None and not any(_has_surface(item.content) for item in file.scene.items):
            print("--light: nothing here knows its surface, so nothing is lit (docs/light.md)", file=sys.stderr)
    return file


def _has_surface(content: Content) -> bool:
    """Of whatever level: one of them may be all that has one."""
    if isinstance(content, RiggedMesh):
        return False
    each = (content, *(level.content for level in content.levels))
    return any(splats_of(one).surface is not None for one in each)


def light_of(text: str) -> Light:
    """A preset's name, or a JSON file as a scene file's "light". Raises FormatError."""
    if text in PRESETS or not Path(text).exists():
        return Light.preset(text)
    with naming(text), open_regular(text) as (file, size):
        if size > _LIGHT_BYTES:
            raise FormatError(f"a light has at most {_LIGHT_BYTES} bytes, this one {size}")
        try:
            data = json.loads(file.read())
        except (ValueError, RecursionError) as error:
            raise FormatError(f"a light is JSON, but {error}") from None
        return Light.from_json(data)


def add_up(parser: argparse.ArgumentParser, what: str = "the file's axis that points up") -> None:
    """--up."""
    parser.add_argument("--up", choices=UPS, default="y", help=f"{what} (default y; most 3DGS captures: -y)")


def add_solver(parser: argparse.ArgumentParser) -> None:
    """--solver: what guesses the body."""
    from glsplat.tracking.solvers import SOLVERS  # and all of them, which few commands need

    parser.add_argument(
        "--solver", choices=SOLVERS, default=SOLVERS[0], help=f"what guesses the body (default {SOLVERS[0]})"
    )


def open_scene(args: Any) -> SceneFile:
    """All that the arguments name, turned so that --up is up: a scene file, or one thing as a scene."""
    if args.scene is None:
        return _lit(SceneFile.of(default_avatar()), args)
    path = embedded_file(args.scene)
    if not path.exists():
        raise FormatError(f"{args.scene}: no such file; give a {suffixes()} or a scene file, {_PEOPLE}, or nothing")
    file = load_scene(path, strict=args.strict)
    _say_doubts(file, args.scene)
    turn = upright(args.up)
    if args.up == "y":
        return _lit(file, args)
    if len(file.scene) == 1 and isinstance(splats := file.scene.items[0].content, Splats) and not file.composed:
        return _lit(SceneFile.of(transformed(splats, turn)), args)  # static splats stay the leanest scene
    for item in file.scene:
        item.transform = turn @ item.transform
    return _lit(file, args)


def _say_doubts(file: SceneFile, name: str) -> None:
    """What looks wrong in the motions of a scene file, on stderr; of each once."""
    if not file.motions:
        return
    said = set()
    for place, (item, motion) in file.motions.items():
        if is_rigged(item.content) and id(motion) not in said:
            said.add(id(motion))
            if line := _doubt(motion, item.content.skeleton, "FILE"):
                print(f"{name}: item {place}, motion {motion.label}: {line}", file=sys.stderr)


def single(file: SceneFile) -> Content | None:
    """The one thing of a scene of one that stands where its file puts it; None for anything more."""
    items = file.scene.items
    alone = len(items) == 1 and items[0].visible and not file.motions and items[0].pose is None
    return items[0].content if alone and np.array_equal(items[0].transform, np.eye(4)) else None


def load_avatar(path: str | Path, option: str, *, strict: bool = False) -> Rigged:
    """What an option names as an avatar: splats with a skin, or a rigged mesh. Raises UsageError for anything else."""
    file = embedded_file(path)
    if not file.exists():
        raise UsageError(f"{option} {path}: no such file, nor an embedded person ({_PEOPLE})")
    content = load(file, strict=strict)
    if isinstance(content, Scene):
        raise UsageError(f"{option} {path}: expected one avatar, found a scene file")
    if not is_rigged(content):
        found = "splats without a skeleton" if isinstance(content, Splats) else "a mesh without joints to move"
        raise UsageError(f"{option} {path}: expected an avatar (a .glb with a skin, a rigged mesh), found {found}")
    return content


def driven(file: SceneFile, what: str) -> Rigged:
    """The one visible avatar, whose pose an option or a client sets. Raises UsageError where there is not just one."""
    if file.avatar is not None:
        assert is_rigged(file.avatar.content)
        return file.avatar.content
    if file.scene.figures:
        raise UsageError(f"{what} is for one avatar, this scene has several; say in the scene file what each does")
    raise UsageError(f"this scene has no skeleton; {what} needs an avatar (a .glb with a skin, a rigged mesh)")


def tracked(skeleton: Skeleton, name: str) -> Skeleton:
    """The same. Raises PoseError naming the file ``name`` where tracking cannot drive it."""
    if why := why_not_tracked(skeleton):
        raise PoseError(f"{name}: tracking cannot drive this avatar: {why}")
    return skeleton


def _doubt(motion: Motion, skeleton: Skeleton, name: str) -> str:
    """Return what looks wrong in a motion, in one line; "" where nothing does, or extras/motions is not installed."""
    module = plugin("motions.doubts")
    return "" if module is None else module.doubt(motion, skeleton, name)


def motion_of(name: str, skeleton: Skeleton, option: str = "--motion") -> Motion:
    """The motion an option names: a file or an embedded one; what a user should know of it is said on stderr.

    Raises UsageError where there is neither.
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


def add_detail(parser: argparse.ArgumentParser, *, lean: bool) -> None:
    """--level, --lod-bias, --cull-hidden, and where they are on unasked (``lean``) --exact, which is none of them."""
    unasked = "auto" if lean else "0"
    parser.add_argument(
        "--level",
        type=detail_level,
        metavar="N",
        help="level of detail of what has several: 0 the finest, higher numbers coarser ones, auto: by the pixels it "
        f"covers (default {unasked})",
    )
    parser.add_argument(
        "--lod-bias",
        type=float,
        metavar="B",
        help="of --level auto, in halvings of what is seen: 1 for finer levels, -1 for coarser ones (default 0)",
    )
    parser.add_argument(
        "--cull-hidden",
        action="store_true",
        help="leave out what the splats' visibility cones say is hidden"
        + (f" (default: where the worst picture keeps {CULL_PSNR:g} dB)" if lean else ""),
    )
    if lean:
        parser.add_argument("--exact", action="store_true", help="draw every splat of the finest level, to its end")


_LEAN = ("level", "cull_hidden", "max_sigma")  # where LEAN differs from the pixel contract


def detail_of(args: Any) -> dict[str, Any]:
    """What those options say, as fields of RenderConfig. Raises UsageError where they contradict each other."""
    exact = getattr(args, "exact", False)
    given = [name for name in ("level", "lod_bias") if getattr(args, name) is not None]
    given += ["cull_hidden"] if args.cull_hidden else []
    if exact:
        if given:
            raise UsageError(f"--exact and --{given[0].replace('_', '-')} contradict each other; leave one out")
        return {}
    lean = hasattr(args, "exact")
    unasked: dict[str, Any] = {name: getattr(LEAN, name) for name in _LEAN} if lean else {}
    level = unasked.get("level", 0) if args.level is None else args.level
    if args.lod_bias is not None and level != "auto":
        raise UsageError("--lod-bias goes with --level auto")
    if args.lod_bias is not None and not -8 <= args.lod_bias <= 8:
        raise UsageError(f"--lod-bias needs -8 to 8, not {args.lod_bias:g}")
    return unasked | {
        "level": level,
        "lod_bias": args.lod_bias or 0.0,
        "cull_hidden": True if args.cull_hidden else unasked.get("cull_hidden", False),
    }


def detail_level(text: str) -> int | str:
    """argparse type: a number of a level, or auto."""
    if text == "auto":
        return text
    number = natural(text)
    if number > MAX_LEVELS:
        raise argparse.ArgumentTypeError(f"a level is 0 to {MAX_LEVELS} or auto, not {text!r}")
    return number


def size(text: str) -> tuple[int, int]:
    """argparse type: WxH, or one number for a square."""
    try:
        parts = [int(part) for part in text.lower().split("x")]
        width, height = parts * 2 if len(parts) == 1 else parts
    except ValueError:
        raise argparse.ArgumentTypeError(f"a size is WxH, for example 1024x1024, not {text!r}") from None
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"a size is at least 1x1, not {text!r}")
    return width, height


def positive(text: str) -> float:
    """argparse type: a finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not 0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"a finite number above 0 is needed, not {text!r}")
    return value


def not_negative(text: str) -> float:
    """argparse type: a finite number, zero or above."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not 0 <= value < np.inf:
        raise argparse.ArgumentTypeError(f"a finite number of at least 0 is needed, not {text!r}")
    return value


def natural(text: str) -> int:
    """argparse type: a whole number, zero or above."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"a whole number of at least 0 is needed, not {text!r}")
    return int(text)


def degrees(text: str) -> float:
    """argparse type: a field of view between 0 and 180 degrees."""
    value = positive(text)
    if value >= 180:
        raise argparse.ArgumentTypeError(f"a field of view lies between 0 and 180 degrees, not {text!r}")
    return value


def point(text: str) -> tuple[float, float, float]:
    """argparse type: x,y,z in metres."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"a point is x,y,z, for example 0,1,3, not {text!r}") from None
    if not np.isfinite((x, y, z)).all():
        raise argparse.ArgumentTypeError(f"a point is three finite numbers, not {text!r}")
    return x, y, z


def expression(text: str) -> Mapping[str, float]:
    """argparse type: NAME=WEIGHT,... of an avatar's shapes."""
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
    return found  # also those of 0, which a motion may not have


def colour(text: str) -> tuple[float, float, float]:
    """argparse type: red,green,blue from 0 to 1."""
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        red = green = blue = np.nan
    if not (0 <= red <= 1 and 0 <= green <= 1 and 0 <= blue <= 1):
        raise argparse.ArgumentTypeError(f"a colour is R,G,B from 0 to 1, for example 0.2,0.2,0.2, not {text!r}")
    return red, green, blue
