"""Scene files: several things, where they stand and what they do, as JSON (docs/conventions.md, "Scene file").

::

    {"version": 1, "items": [{"path": "room.ply"}, {"path": "me.glb", "translation": [0, 0, 1], "motion": "walk.bvh"}]}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, GlsplatError, PoseError
from glsplat.formats import load
from glsplat.motion.motion import Motion, load_motion
from glsplat.scene import Content, Item, Scene, similarity
from glsplat.skinning.pose import Pose, load_pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

__all__ = ["MOST_ITEMS", "UPS", "SceneFile", "load_scene_file", "looks_like_scene_file", "upright"]

VERSION = 1
MOST_ITEMS = 1000
"""Items of a scene file, those of the files it names included."""

_DEEPEST = 8  # scene files within scene files
_LARGEST = 4 * 2**20  # bytes of a scene file

UPS = ("y", "-y", "z", "-z")
"""Axes that may be up: y as everywhere here, -y for most captures, z for CAD and robots."""


class _Item(msgspec.Struct, forbid_unknown_fields=True):
    path: str
    name: str = ""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: float = 1.0
    pose: str | dict[str, Any] | None = None
    motion: str | None = None
    visible: bool = True


class _File(msgspec.Struct, forbid_unknown_fields=True):
    version: int
    items: list[_Item]
    up: str = "y"
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


_decoder = msgspec.json.Decoder(_File)


@dataclass(slots=True, eq=False)
class SceneFile:
    """What a scene file holds: the scene, its background, and the motions of the items that move."""

    scene: Scene
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motions: dict[str, tuple[Item, Motion]] = field(default_factory=dict)  # by the item's place in the file: "2", "1.0"

    @property
    def duration(self) -> float:
        """Seconds of the longest motion; 0 without any."""
        return max((motion.duration for _, motion in self.motions.values()), default=0.0)

    def pose_at(self, seconds: float) -> None:
        """Pose every item that has a motion; each begins anew when it is over."""
        for item, motion in self.motions.values():
            item.pose = motion.at(seconds)


def looks_like_scene_file(data: bytes) -> bool:
    """Whether the start of a file is that of a scene file (JSON with items) and not of another JSON format."""
    return data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") and b'"items"' in data and b'"asset"' not in data


def upright(up: str) -> NDArray[np.float64]:
    """[4, 4] the rotation that turns a world whose ``up`` axis is up into one with y up."""
    half = np.sqrt(0.5)
    turns = {"y": (0, 0, 0, 1.0), "-y": (1.0, 0, 0, 0), "z": (-half, 0, 0, half), "-z": (half, 0, 0, half)}
    if up not in turns:
        raise GlsplatError(f"up is one of {', '.join(UPS)}, not {up!r:.20}")
    return np.round(similarity(rotation=turns[up]), 15)


def load_scene_file(
    path: str | Path,
    *,
    strict: bool = False,
    read: Callable[[Path, bool], Content] | None = None,  # of an item's file; default: splats, avatars and meshes
) -> SceneFile:
    """Read a scene file and all it names. Paths are relative to it and stay inside its folder.

    Raises FormatError that names the file and the item: a file that is not there, leads out of the folder or back to a
    scene file that is being read, numbers that are no transform, more than MOST_ITEMS items. No items are legal.
    """
    out = SceneFile(Scene())
    _read(Path(path), np.eye(4), "", (), out, read or _read_thing, strict)
    return out


def _read(
    path: Path,
    place: NDArray[np.float64],
    prefix: str,
    trail: tuple[Path, ...],
    out: SceneFile,
    read: Callable[[Path, bool], Content],
    strict: bool,
) -> None:
    data = _parsed(path)
    if len(trail) >= _DEEPEST:
        raise FormatError(f"{path}: scene files are nested more than {_DEEPEST} deep")
    if not trail:
        out.background = data.background
        if not np.isfinite(data.background).all() or np.abs(data.background).max() > 1e12:
            raise FormatError(f"{path}: background needs three finite numbers")
    try:
        turn = place @ upright(data.up)
    except GlsplatError as error:
        raise FormatError(f"{path}: {error}") from None
    folder, here = path.resolve().parent, path.resolve()
    loaded: dict[Path, Content] = {}  # one file for several items is read once
    for index, entry in enumerate(data.items):
        where = f"{path}: item {index}" + (f" ({entry.name!r:.40})" if entry.name else "")
        if len(out.scene) >= MOST_ITEMS:
            raise FormatError(f"{where}: a scene file holds at most {MOST_ITEMS} items, it and those it names")
        file = _inside(entry.path, folder, where)
        try:
            transform = turn @ similarity(entry.translation, entry.rotation, entry.scale)
            if _is_scene(file):
                if file in (*trail, here):
                    raise FormatError(f"{entry.path} is being read already: no scene file may lead to itself")
                if entry.pose is not None or entry.motion is not None or not entry.visible:
                    raise FormatError("a scene file as an item takes a place and nothing else")
                _read(file, transform, f"{prefix}{index}.", (*trail, here), out, read, strict)
                continue
            if file not in loaded:
                loaded[file] = read(file, strict)
            item = Item(loaded[file], transform=transform, visible=entry.visible, name=entry.name or file.stem)
            _move(item, entry, folder, where, out, f"{prefix}{index}")
            out.scene.add(item)
        except GlsplatError as error:
            text = str(error)
            raise FormatError(text if text.startswith(str(path)) else f"{where}: {text}") from None


def _move(item: Item, entry: _Item, folder: Path, where: str, out: SceneFile, key: str) -> None:
    if entry.pose is None and entry.motion is None:
        return
    if entry.pose is not None and entry.motion is not None:
        raise FormatError("an item has a pose or a motion, not both")
    if isinstance(item.content, Splats):
        raise FormatError("splats without a skeleton have no pose and no motion")
    skeleton: Skeleton = item.content.skeleton
    if entry.motion is not None:
        motion = load_motion(_inside(entry.motion, folder, where), skeleton)
        out.motions[key] = item, motion
        item.pose = motion.at(0.0)
    elif isinstance(entry.pose, str):
        item.pose = load_pose(_inside(entry.pose, folder, where), skeleton)
    elif isinstance(entry.pose, Mapping):
        item.pose = Pose.from_json(entry.pose, skeleton)
    else:
        raise PoseError("pose is a file or an object of joint rotations")


def _parsed(path: Path) -> _File:
    try:
        if path.stat().st_size > _LARGEST:
            raise FormatError(f"{path}: a scene file has at most {_LARGEST} bytes, this one {path.stat().st_size}")
        data = _decoder.decode(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise FormatError(f"{path}: cannot read the scene file ({error.strerror})") from None
    except (msgspec.DecodeError, UnicodeError) as error:
        raise FormatError(f"{path}: no scene file of version {VERSION}: {error}") from None
    except RecursionError:
        raise FormatError(f"{path}: no scene file: nested too deeply") from None
    if data.version != VERSION:
        raise FormatError(f"{path}: expected a scene file of version {VERSION}, found {data.version}")
    return data


def _inside(name: str, folder: Path, where: str) -> Path:
    """The file of that relative name in ``folder``; links that lead out count as out."""
    if not name or "\0" in name or PurePosixPath(name).is_absolute() or Path(name).is_absolute() or "\\" in name:
        raise FormatError(f"{where}: a path is relative to the scene file, with /, not {name!r:.60}")
    file = (folder / name).resolve()
    if not file.is_relative_to(folder):
        raise FormatError(f"{where}: {name!r:.60} leads out of the scene file's folder")
    if not file.exists():
        raise FormatError(f"{where}: {name!r:.60}: no such file")
    return file


def _is_scene(file: Path) -> bool:
    if file.suffix.lower() != ".json":
        return False
    with file.open("rb") as source:
        return looks_like_scene_file(source.read(65536))


def _read_thing(file: Path, strict: bool) -> Content:
    return load(file, strict=strict)
