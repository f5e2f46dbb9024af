"""File formats as rows of the registry: how each is called, recognised, read and written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.io.files import Source, folder_of, name_of, naming, open_regular, sampled, suffixes_of
from glsplat.meshes import RiggedMesh
from glsplat.scene import Content, Scene
from glsplat.splats import Splats

A_MOTION = "a motion, which shows nothing; give it to render, preview or replay as --motion"
"""Message where something to show is expected."""

_BOM = b"\xef\xbb\xbf"  # of UTF-8
_REST_TOLERANCE = 1e-3  # metres, or of an axis


@dataclass(frozen=True, eq=False)
class Opened:
    """An open file, for ``Format.sniff`` and the readers, which seek to where they begin."""

    file: BinaryIO
    size: int
    name: str  # for messages: the path, or an open file's name
    folder: Path | None  # of its other files; None where it has none
    endings: tuple[str, ...]  # suffixes of its name, the longest first (io.files.suffixes_of)
    strict: bool = False  # refuse broken parts instead of leaving them out

    @cached_property
    def head(self) -> bytes:
        """The first 512 bytes; empty where the file is."""
        return self.begin(512)

    @property
    def text(self) -> bool:
        """Whether the head may be text: it has no control characters but tabs and line ends."""
        return not any(byte < 32 and byte not in b"\t\n\r" for byte in self.head)

    @property
    def json(self) -> bytes:
        """The first 64 KiB of what may be a JSON object, from its brace on; b"" of all else."""
        begins = self.head.removeprefix(_BOM).lstrip()[:1] in (b"{", b"")
        text = self.begin(1 << 16).removeprefix(_BOM).lstrip() if begins else b""
        return text if text.startswith(b"{") else b""

    def named(self, *suffixes: str) -> bool:
        """Return whether the name ends in one of the suffixes."""
        return any(ending in suffixes for ending in self.endings)

    def begin(self, count: int) -> bytes:
        """Return the first ``count`` bytes, or all."""
        self.file.seek(0)
        return self.file.read(count)

    def spread(self) -> bytes:
        """Return the file, or of a large one blocks spread evenly over it (io.files.sampled)."""
        return sampled(self.file, 0, self.size)


@contextmanager
def opened(source: Source, strict: bool = False) -> Iterator[Opened]:
    """Open a path, or take an open file (io.files.open_regular); errors within the ``with`` name it."""
    with naming(source, strict), open_regular(source) as (file, size):
        yield Opened(file, size, name_of(source), folder_of(source), tuple(suffixes_of(source)), strict)


@dataclass(frozen=True, eq=False)
class Format:
    """One file format.

    ``load`` reads an open file at its start, ``save`` writes a scene to its target (by io.files.replace_file); None
    where the format is not read so, or not written. ``read_motion(opened, skeleton, forward, choice, corrections)``
    returns a Motion (formats/motion_files.py). All raise FormatError. ``loses`` yields a sentence for each thing that a
    saved file does not keep, rounding apart; sentences for ``rigs``, ``cones``, ``levels`` and ``surfaces`` that are
    False are added to it. ``order`` returns which splats a file has, in its order, where that is not all as they come.
    """

    name: str  # as ``format=`` takes it
    title: str  # as messages say it
    suffixes: tuple[str, ...]  # lower case, with the dot, or "meta.json"; the first is the usual, the longest counts
    sniff: Callable[[Opened], bool]
    load: Callable[[Opened], Content | Scene] | None = None  # None: a motion, which shows nothing
    save: Callable[[Splats | Avatar, Source], None] | None = None
    loses: Callable[[Splats | Avatar], Iterator[str]] = lambda _: iter(())
    rigs: bool = False  # holds avatars
    cones: bool = False  # holds visibility cones
    levels: bool = False  # holds levels of detail
    surfaces: bool = False  # holds surfaces for relighting
    order: Callable[[Splats], NDArray[np.intp]] | None = None
    save_mesh: Callable[[RiggedMesh, Source], None] | None = None
    read_motion: Callable[..., Any] | None = None
    marked: bool = True  # begins with a magic number; formats without one are tried last

    def read(self, opened: Opened) -> Content | Scene:
        """Read an open file of this format. Raises FormatError; of a strict one also for splats that are not finite."""
        if self.load is None:
            raise FormatError(A_MOTION)
        opened.file.seek(0)
        content = self.load(opened)
        if opened.strict and isinstance(content, (Splats, Avatar)):
            splats = splats_of(content)
            if bad := len(splats) - int(splats.finite().sum()):
                raise FormatError(
                    f"{bad} of {len(splats)} splats hold NaN or infinity; repair the file or load it without strict"
                )
        return content

    def losses(self, scene: Splats | Avatar) -> Iterator[str]:
        """Yield a sentence for each thing that a file of this format does not keep of ``scene``, rounding apart."""
        if isinstance(scene, Avatar) and not self.rigs:
            zero = scene.skeleton.rest @ scene.skeleton.inverse_bind
            at_rest = np.abs(zero - np.eye(4)).max() < _REST_TOLERANCE
            pose = "zero pose" if at_rest else "pose it was bound in (glsplat avatar export writes others)"
            yield f"the rig of {len(scene.skeleton)} joints is dropped, the file holds the {pose}"
            if scene.shapes is not None:
                yield f"the {len(scene.shapes)} shapes of the face are dropped"
            if isinstance(scene.meta.get("consent"), dict):
                yield "the signed consent is dropped, only a .glb carries one"
        if splats_of(scene).cones is not None and not self.cones:
            yield "the visibility cones are dropped"
        if splats_of(scene).surface is not None and not self.surfaces:
            yield "the surface is dropped, light will not change what is read back"
        if scene.levels and not self.levels:
            count = len(scene.levels)
            yield f"{count} coarser level{'s' if count > 1 else ''} of detail dropped, the file holds the finest"
        yield from self.loses(scene)


def clamped_opacities(scene: Splats | Avatar) -> Iterator[str]:
    """Yield the loss of a format whose opacities lie between 0 and 1."""
    splats = splats_of(scene)
    outside = int((splats.drawable() & ((splats.opacities < 0) | (splats.opacities > 1))).sum())
    if outside:
        yield f"{outside} opacities outside 0 to 1 are clamped"


def positive_scales(scene: Splats | Avatar) -> Iterator[str]:
    """Yield the loss of a format whose scales have no sign."""
    with np.errstate(invalid="ignore"):
        negative = int((splats_of(scene).scales < 0).any(axis=1).sum())
    if negative:
        yield f"{negative} splats with negative scales are written with positive ones (their shape is the same)"
