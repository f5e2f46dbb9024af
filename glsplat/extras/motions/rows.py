"""Formats of the registry: motions of other programs. Readers are imported when a file needs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

from glsplat.errors import FormatError
from glsplat.extras.motions.clip import Clip
from glsplat.extras.motions.corrections import Corrections
from glsplat.formats.format import Format, Opened
from glsplat.motion.motion import Motion
from glsplat.optional import missing, plugin
from glsplat.skinning.skeleton import Skeleton

_AMASS_ARRAYS = {"poses", "pose_body"}
_MESH_ARRAYS = {"v_template", "vertices", "faces"}


def add_formats(formats: dict[str, Format]) -> None:
    """Add the formats of motions, and make glTF's read animations."""
    for name in ("glb", "gltf"):
        formats[name] = replace(formats[name], read_motion=_animation)
    if "npz" in formats:
        formats["npz"] = replace(formats["npz"], read_motion=_amass)  # reports what an archive lacks
    formats |= {row.name: row for row in (_AMASS, _BVH, _ACCLAIM)}


def _animation(start: Opened, skeleton: Skeleton, forward: bool, choice: str | None, said: Corrections) -> Motion:
    clip = _needed("gltf").read_animation(start, choice)
    return _retargeted(clip, skeleton, forward, said)


def _bvh(start: Opened, skeleton: Skeleton, forward: bool, _choice: str | None, said: Corrections) -> Motion:
    from glsplat.extras.motions.bvh import parse_bvh

    start.file.seek(0)
    return _retargeted(parse_bvh(start.file.read().decode("latin-1")), skeleton, forward, said)


def _acclaim(start: Opened, skeleton: Skeleton, forward: bool, _choice: str | None, said: Corrections) -> Motion:
    from glsplat.extras.motions.bvh import parse_acclaim, skeleton_file

    start.file.seek(0)
    bones = skeleton_file(Path(start.name)).read_text(encoding="latin-1")
    return _retargeted(parse_acclaim(bones, start.file.read().decode("latin-1")), skeleton, forward, said)


def _amass(start: Opened, skeleton: Skeleton, forward: bool, _choice: str | None, said: Corrections) -> Motion:
    from glsplat.extras.motions.amass import read_amass

    start.file.seek(0)
    return said.applied(read_amass(start.file, skeleton, forward), skeleton, ground=True)


def _retargeted(clip: Clip, skeleton: Skeleton, forward: bool, said: Corrections) -> Motion:
    module = _needed("retarget")
    rotations, trans = module.retarget(clip, skeleton, forward=forward, world=said.world, swapped=said.swapped)
    note = "; ".join(line for line in (clip.note, module.stretched(clip)) if line)
    known_up = clip.y_up or said.up != "y"
    motion = Motion(clip.fps, rotations, trans, label=clip.label, note=note, known_up=known_up)
    return replace(said, up="y", swapped=False).applied(motion, skeleton, ground=True)


def _needed(name: str) -> ModuleType:
    """Import a module of this extra that needs extras/rigs. Raises FormatError if that is not installed."""
    module = plugin(f"motions.{name}")
    if module is None:
        raise FormatError(missing("rigs", "the skeleton of a motion"))
    return module


def _sniff_amass(start: Opened) -> bool:
    npz = plugin("formats.npz")
    if npz is None or not start.head.startswith(b"PK"):
        return False
    start.file.seek(0)
    names = set(npz.array_names(start.file))
    return bool(names & _AMASS_ARRAYS) and not names & _MESH_ARRAYS


def _sniff_acclaim(start: Opened) -> bool:
    text = start.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return text.startswith((b"#!OML", b":FULLY", b":DEGREES")) or start.named(".amc")


_AMASS = Format(name="amass", title="AMASS (.npz)", suffixes=(), sniff=_sniff_amass, read_motion=_amass)
_BVH = Format(
    name="bvh",
    title="BVH",
    suffixes=(".bvh",),
    sniff=lambda start: start.head.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper() == b"HIERARCHY",
    read_motion=_bvh,
)
_ACCLAIM = Format(
    name="amc", title=".amc", suffixes=(".amc",), sniff=_sniff_acclaim, read_motion=_acclaim, marked=False
)
