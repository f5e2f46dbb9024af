"""Wavefront OBJ: vertices, polygons as fans, texture coordinates, and the colours of the material file beside it.

trimesh's reader is not used: it fails on negative indices, reads index 0 as the last vertex, and drops the names of
materials without a file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.format import Format, Opened
from glsplat.meshes import MeshPart, RiggedMesh, standing

_GREY = 200  # of a face without a material
_BEGINS = re.compile(rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*[ \t]*(?:mtllib|usemtl|vt|vn|v|o|g)[ \t]+\S")  # behind comments


@dataclass(frozen=True)
class Obj:
    """The triangles of a file."""

    vertices: NDArray[np.float64]  # [V, 3]
    faces: NDArray[np.int32]  # [F, 3]
    uv: NDArray[np.float64]  # [F, 3, 2], v axis up; zero for corners without
    material: NDArray[np.int32]  # [F] index into names
    names: tuple[str, ...]  # of the materials, in the order of their use
    library: str | None  # the material file


def parse_obj(text: str) -> Obj:
    """Parse the lines of an OBJ. Raises ValueError or IndexError for invalid ones."""
    points: list[list[float]] = []
    coordinates: list[list[float]] = [[0.0, 0.0]]  # index 0: none
    triangles: list[list[int]] = []
    mapped: list[list[int]] = []
    names: dict[str, int] = {}
    materials: list[int] = []
    current, library = "", None
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            points.append([float(w) for w in words[1:4]])
        elif words[0] == "vt":
            coordinates.append([float(w) for w in (*words[1:3], "0")[:2]])
        elif words[0] == "usemtl":
            current = " ".join(words[1:])
        elif words[0] == "mtllib" and library is None and len(words) > 1:
            library = line.split(None, 1)[1].strip()
        elif words[0] == "f":
            corners = [word.split("/") for word in words[1:]]
            at = [_index(c[0], len(points)) - 1 for c in corners]
            uv = [_index(c[1], len(coordinates) - 1) if len(c) > 1 and c[1] else 0 for c in corners]
            for k in range(1, len(corners) - 1):
                triangles.append([at[0], at[k], at[k + 1]])
                mapped.append([uv[0], uv[k], uv[k + 1]])
                materials.append(names.setdefault(current, len(names)))
    return Obj(
        np.array(points, np.float64).reshape(-1, 3),
        np.array(triangles, np.int32).reshape(-1, 3),
        np.array(coordinates, np.float64)[np.array(mapped, np.intp).reshape(-1, 3)],
        np.array(materials, np.int32),
        tuple(names),
        library,
    )


def textures_of(source: Path, library: str | None) -> Iterator[tuple[str, NDArray[np.uint8], bool]]:
    """Yield (material, RGBA, whether it is an image) of each Kd and map_Kd, in the order of the material file.

    Raises FormatError for an image that is not beside the file.
    """
    from glsplat.extras.formats.texture import decode_texture  # not at the top, as it needs OpenCV

    file = None if library is None else _beside(source, library)
    if file is None:
        return
    name = ""
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if len(words) < 2:
            continue
        if words[0] == "newmtl":
            name = " ".join(words[1:])
        elif words[0] == "map_Kd":
            image = _beside(source, words[-1])
            if image is None:
                raise FormatError(f"{source}: the texture {words[-1][:60]!r} is not beside it")
            yield name, decode_texture(image.read_bytes(), f"{source}: {words[-1]}"), True
        elif words[0] == "Kd" and len(words) == 4:
            try:
                yield name, flat(tuple(np.rint(np.clip([float(w) for w in words[1:]], 0, 1) * np.float64(255)))), False
            except ValueError:
                raise FormatError(f"{source}: Kd needs three numbers, not {line[:60]!r}") from None


def flat(colour: tuple[float, ...] = (_GREY,) * 3) -> NDArray[np.uint8]:
    """Return a texture of one colour, 0 to 255."""
    return np.tile(np.array([*colour, 255], np.uint8), (4, 4, 1))


def _beside(source: Path, name: str) -> Path | None:
    """Return a file in the folder of ``source`` or below; None if it is absent or elsewhere."""
    try:
        folder = source.resolve().parent
        file = (folder / name).resolve()
        return file if file.is_relative_to(folder) and file.is_file() else None
    except (OSError, ValueError, RuntimeError):
        return None


def _index(word: str, count: int) -> int:
    """Convert an OBJ index, from 1 or negative from the end, to one from 1. Raises ValueError out of range."""
    value = int(word)
    value = count + 1 + value if value < 0 else value
    if not 1 <= value <= count:
        raise ValueError(f"a face names element {word} of {count}")
    return value


def _read(start: Opened) -> RiggedMesh:
    """Read the file as a standing mesh."""
    try:
        obj = parse_obj(start.file.read().decode("utf-8", "replace"))
    except (ValueError, IndexError) as error:
        raise FormatError(f"not a usable OBJ ({str(error)[:80]})") from None
    source, textures = Path(start.name), dict[str, tuple[NDArray[np.uint8], bool]]()
    library = obj.library if start.folder is not None else None  # an open file has no folder
    for name, texture, mapped in textures_of(source, library):
        if name in obj.names and (mapped or name not in textures or not textures[name][1]):
            textures[name] = texture, mapped
    parts = tuple(
        MeshPart(name or source.stem, obj.faces[mine], obj.uv[mine], textures[name][0] if name in textures else flat())
        for index, name in enumerate(obj.names)
        if (mine := obj.material == index).any()
    )
    return standing(obj.vertices, parts, source.name)


def _sniff(start: Opened) -> bool:
    return start.named(*OBJ.suffixes) or (start.text and _BEGINS.match(start.head) is not None)


OBJ = Format(name="obj", title="OBJ", suffixes=(".obj",), sniff=_sniff, load=_read, marked=False)
