"""Scene files: items with transforms, poses and motions as JSON (docs/conventions.md, "Scene file").

::

    {"version": 1, "items": [{"path": "room.ply"}, {"path": "me.glb", "translation": [0, 0, 1], "motion": "walk.bvh"}]}
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import colour
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.format import Format, Opened, opened
from glsplat.formats.motion_files import embedded_motions, load_embedded_motion, load_motion
from glsplat.formats.registry import recognised
from glsplat.io.files import Source
from glsplat.light.light import Light
from glsplat.scene import Content, Item, Scene, SceneLike, similarity
from glsplat.skinning.pose import Pose, load_pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

if TYPE_CHECKING:
    from glsplat.motion.motion import Motion

VERSION = 1
MAX_ITEMS = 1000
"""Items of a scene file, with those of the scene files that it names."""

_MAX_DEPTH = 8  # scene files within scene files
_MAX_BYTES = 4 * 2**20  # of a scene file

UPS = ("y", "-y", "z", "-z")
"""Axes that may be up: y as in glsplat, -y for most captures, z for CAD and robots."""


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
    light: Any = None


_decoder = msgspec.json.Decoder(_File)


@dataclass(slots=True, eq=False)
class SceneFile:
    """Contents of a scene file: the scene, its background, and the motions of its items."""

    scene: Scene
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: str = "y"  # of the file; its items are turned already
    motions: dict[str, tuple[Item, Motion]] = field(default_factory=dict)  # by the item's place in the file: "2", "1.0"
    sources: list[tuple[Item, Path]] = field(default_factory=list)  # the files that items were read from
    composed: bool = False  # by a scene file; else a scene of one thing

    @classmethod
    def of(cls, thing: SceneLike) -> SceneFile:
        """Return the scene file of one thing."""
        return cls(Scene.of(thing))

    @property
    def avatar(self) -> Item | None:
        """The item whose pose a user or a client may set: the one visible avatar (a rigged mesh is one, too).

        None of none or several.
        """
        figures = self.scene.figures
        return figures[0] if len(figures) == 1 else None

    @property
    def duration(self) -> float:
        """Seconds of the longest motion; 0 without any."""
        return max((motion.duration for _, motion in self.motions.values()), default=0.0)

    def pose_at(self, seconds: float) -> None:
        """Pose every item that has a motion; each begins anew when it is over."""
        for item, motion in self.motions.values():
            item.pose = motion.at(seconds)


def upright(up: str) -> NDArray[np.float64]:
    """Return the rotation [4, 4] that turns a world whose ``up`` axis is up into one with y up."""
    half = np.sqrt(0.5)
    turns = {"y": (0, 0, 0, 1.0), "-y": (1.0, 0, 0, 0), "z": (-half, 0, 0, half), "-z": (half, 0, 0, half)}
    if up not in turns:
        raise GlsplatError(f"up is one of {', '.join(UPS)}, not {up!r:.20}")
    return np.round(similarity(rotation=turns[up]), 15)


def load_scene(path: Source, *, strict: bool = False) -> SceneFile:
    """Read a scene file and the files that it names; any other file that ``glsplat.load`` reads is a scene of one.

    Paths in a scene file are relative to it and stay inside its folder. Raises FormatError that names the file and the
    item: a file that is not there, leads out of the folder or back to a scene file that is being read, numbers that
    are no transform, more than MAX_ITEMS items. No items are legal.
    """
    with opened(path, strict) as start:
        known = recognised(start)
        if known.name == SCENE.name:
            return _read(start)
        content = known.read(start)
        assert not isinstance(content, Scene)
        file = SceneFile.of(content)
        file.sources = [(item, Path(start.name)) for item in file.scene] if start.folder is not None else []
        return file


def _read(start: Opened) -> SceneFile:
    if start.folder is None:
        raise FormatError("a scene file names others beside it, and an open file has no folder; give its path")
    reading = _Reading(start.strict)
    reading.file(start, Path(start.name), np.eye(4), "", ())
    return reading.out


class _Reading:
    """Reads one scene file and those it names; each content and motion once."""

    def __init__(self, strict: bool) -> None:
        self.out = SceneFile(Scene(), composed=True)
        self._strict = strict
        self._files = 0
        self._contents: dict[Path, Content] = {}
        self._motions: dict[tuple[str | Path, str | None, int], Motion] = {}  # by file, animation, id() of a skeleton

    def file(self, start: Opened, path: Path, place: NDArray[np.float64], prefix: str, trail: tuple[Path, ...]) -> None:
        """Add the items of one file, placed by ``place``."""
        data = _parsed(start)
        if len(trail) >= _MAX_DEPTH:
            raise FormatError(f"{path}: scene files are nested more than {_MAX_DEPTH} deep")
        self._files += 1
        if len(self.out.scene) + len(data.items) > MAX_ITEMS or self._files > MAX_ITEMS:
            raise FormatError(f"{path}: a scene file holds at most {MAX_ITEMS} items, it and those it names")
        if not trail:
            self.out.background, self.out.up = data.background, data.up
        try:
            light = None if data.light is None else Light.from_json(data.light)
            if not trail:
                self.out.scene.light = light
            colour(data.background, "background")
            turn = place @ upright(data.up)
        except GlsplatError as error:
            raise FormatError(f"{path}: {error}") from None
        here = path.resolve()
        for index, entry in enumerate(data.items):
            where = f"{path}: item {index}" + (f" ({entry.name!r:.40})" if entry.name else "")
            try:
                file = _inside(entry.path, here.parent)
                transform = turn @ similarity(entry.translation, entry.rotation, entry.scale)
                if file in (*trail, here):
                    raise FormatError(f"{entry.path} is being read already: no scene file may lead to itself")
                if file not in self._contents:
                    with opened(file, self._strict) as one:
                        known = recognised(one)
                        if known.name == SCENE.name:
                            if entry.pose is not None or entry.motion is not None or not entry.visible:
                                raise FormatError("a scene file as an item takes a place and nothing else")
                            self.file(one, file, transform, f"{prefix}{index}.", (*trail, here))
                            continue
                        content = known.read(one)
                        assert not isinstance(content, Scene)
                        self._contents[file] = content
                self._item(file, entry, transform, here.parent, f"{prefix}{index}")
            except GlsplatError as error:
                raise FormatError(f"{where}: {error}") from None

    def _item(self, file: Path, entry: _Item, transform: NDArray[np.float64], folder: Path, key: str) -> None:
        item = Item(self._contents[file], transform=transform, visible=entry.visible, name=entry.name or file.stem)
        if entry.pose is not None and entry.motion is not None:
            raise FormatError("an item has a pose or a motion, not both")
        if isinstance(item.content, Splats):
            if entry.pose is not None or entry.motion is not None:
                raise FormatError("splats without a skeleton have no pose and no motion")
        elif entry.motion is not None:
            motion = self._motion(entry.motion, folder, item.content.skeleton)
            self.out.motions[key] = item, motion
            item.pose = motion.at(0.0)
        elif isinstance(entry.pose, str):
            item.pose = load_pose(_inside(entry.pose, folder), item.content.skeleton)
        elif entry.pose is not None:
            item.pose = Pose.from_json(entry.pose, item.content.skeleton)
        self.out.scene.add(item)
        self.out.sources.append((item, file))

    def _motion(self, name: str, folder: Path, skeleton: Skeleton) -> Motion:
        """Load a file in the folder, or an embedded motion where there is none of that name."""
        embedded = name in embedded_motions() and not (folder / name).exists()
        whole = embedded or "#" not in name or (folder / name).exists()
        file, choice = (name, None) if whole else name.split("#", 1)
        source = name if embedded else _inside(file, folder)
        key = source, choice, id(skeleton)
        if key not in self._motions:
            # by its name alone load_motion() would look in the current folder first
            self._motions[key] = (
                load_embedded_motion(name, skeleton) if embedded else load_motion(source, skeleton, animation=choice)
            )
        return self._motions[key]


def _parsed(start: Opened) -> _File:
    if start.size > _MAX_BYTES:
        raise FormatError(f"a scene file has at most {_MAX_BYTES} bytes, this one {start.size}")
    try:
        data = _decoder.decode(start.begin(start.size).decode("utf-8-sig"))
    except (msgspec.DecodeError, UnicodeError) as error:
        raise FormatError(f"no scene file of version {VERSION}: {error}") from None
    except RecursionError:
        raise FormatError("no scene file: nested too deeply") from None
    if data.version != VERSION:
        raise FormatError(f"expected a scene file of version {VERSION}, found {data.version}")
    return data


def _inside(name: str, folder: Path) -> Path:
    """Return the file of that relative name in ``folder``. Raises FormatError, also for links that lead out."""
    if not name or "\0" in name or PurePosixPath(name).is_absolute() or Path(name).is_absolute() or "\\" in name:
        raise FormatError(f"a path is relative to the scene file, with /, not {name!r:.60}")
    try:
        file = (folder / name).resolve()
        if not file.is_relative_to(folder):
            raise FormatError(f"{name!r:.60} leads out of the scene file's folder")
        if not file.exists():
            raise FormatError(f"{name!r:.60}: no such file")
    except (OSError, ValueError, RuntimeError):  # too long, no text, a circle of links
        raise FormatError(f"{name!r:.60} is not the path of a file") from None
    return file


def _sniff(start: Opened) -> bool:
    """Return whether a file is JSON with items, but no glTF."""
    return bool(re.search(rb'"items"\s*:', start.json) and not re.search(rb'"asset"\s*:', start.json))


SCENE = Format(name="scene", title="a scene file", suffixes=(), sniff=_sniff, load=lambda start: _read(start).scene)


def add_formats(formats: dict[str, Format]) -> None:
    """Add scene files to the registry."""
    formats[SCENE.name] = SCENE
