"""Write an avatar's file for browsers. An avatar gives the same bytes with the same zlib."""

from __future__ import annotations

import json
import zlib
from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.browser.web_format.planes import (
    THINNEST,
    WEIGHT,
    colour_steps,
    mean_steps,
    quat_bits,
    scale_steps,
    to_planes,
    weight_steps,
)
from glsplat.extras.browser.web_format.read import (
    HEAD,
    MAGIC,
    MOST_ENTRIES,
    MOST_HEADER,
    MOST_JOINTS,
    MOST_SPLATS,
    VERSION,
    Header,
    Joints,
    Part,
    Targets,
    read_header,
)
from glsplat.extras.formats.packed import morton_order
from glsplat.light.surface import Surface
from glsplat.net.backend import WebFile
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import SH_C0, Splats

_VISIBLE = 1 / 255  # opacity below which a splat is never drawn
_FINE = 16  # units to which a shape's moves are rounded: 15 um of 3 cm, so that the low byte packs well


def web_file(avatar: Avatar) -> WebFile:
    """Return ``encode_avatar`` and the end of its first part."""
    data = encode_avatar(avatar)
    header, at = read_header(data)
    return WebFile(data, at + header.parts[0].bytes)


def encode_avatar(avatar: Avatar) -> bytes:
    """Return the file of docs/protocol.md, section 8.1: 25 bytes a splat and its SH, packed, coarsest level first.

    Splats that are never drawn and visibility cones are left out. Raises FormatError for an avatar without visible
    splats, or with more splats or joints than a reader accepts.
    """
    levels = [avatar, *(level.content for level in avatar.levels)]
    rated = [(None, None), *((level.density, level.psnr) for level in avatar.levels)]
    if len(avatar.skeleton) > MOST_JOINTS:
        raise FormatError(f"a browser takes avatars of at most {MOST_JOINTS} joints, not {len(avatar.skeleton)}")
    degree = max(level.splats.sh_degree for level in levels)
    influences = max(level.skin.influences for level in levels)
    made = [_prepared(level, degree, influences) for level in levels]
    order = [len(levels) - 1, *range(len(levels) - 1)]
    parts: list[tuple[Part, bytes]] = []
    for number in order:
        part = Part("splats", number, 0, 0, len(made[number].splats), density=rated[number][0], psnr=rated[number][1])
        parts.append((part, _packed(_splats(made[number], part))))
    for number in order:
        shapes = made[number].shapes
        if shapes is not None and len(shapes.targets):
            part = Part("shapes", number, 0, 0, entries=len(shapes.targets))
            parts.append((part, _packed(_shapes(shapes))))
    for number in order:
        surface = made[number].splats.surface
        if surface is not None:
            part = Part("surface", number, 0, 0, shaded=surface.shade is not None)
            parts.append((part, _packed(_surface(surface))))
    header = Header(
        splats=len(made[0].splats),
        sh_degree=degree,
        influences=influences,
        antialias=avatar.splats.antialias,
        joints=_joints(avatar.skeleton),
        shapes=_targets(avatar.shapes),
        parts=[part for part, _ in parts],
    )
    return _file(header, [data for _, data in parts])


def _file(header: Header, parts: list[bytes]) -> bytes:
    at = 0
    for part, data in zip(header.parts, parts, strict=True):
        part.offset, part.bytes = at, len(data)
        at += len(data)
    text = json.dumps(msgspec.to_builtins(header), separators=(",", ":"), ensure_ascii=False).encode()
    if len(text) > MOST_HEADER:
        raise FormatError(f"the header of an avatar for browsers has at most {MOST_HEADER} bytes, not {len(text)}")
    head = _packed(text)
    return b"".join([HEAD.pack(MAGIC, VERSION, 0, len(head), len(text)), head, *parts])


def _prepared(level: Avatar, degree: int, influences: int) -> Avatar:
    """Return the visible splats in the file's order, with a quantised skin, as they will be read."""
    splats, weights = level.splats, weight_steps(level.skin.weights)
    drawn = np.flatnonzero(splats.drawable() & (splats.opacities >= _VISIBLE))
    if not 0 < len(drawn) <= MOST_SPLATS:
        found = "nothing of which is drawn" if not len(drawn) else f"of {len(drawn)} splats"
        raise FormatError(f"a browser takes avatars of 1 to {MOST_SPLATS} splats a level, not one {found}")
    order = drawn[morton_order(splats.means[drawn])]
    chosen = splats.take(order)
    sh = np.zeros((len(order), (degree + 1) ** 2, 3), np.float32)
    sh[:, : chosen.sh.shape[1]] = chosen.sh
    pad = ((0, 0), (0, influences - level.skin.influences))
    joints, shares = np.pad(level.skin.joints[order], pad, mode="edge"), np.pad(weights[order], pad)
    skin = Skin(joints, shares / WEIGHT)
    shapes = None if level.shapes is None else level.shapes.take(order)
    whole = Splats(
        *(chosen.means, chosen.quats, chosen.scales, chosen.opacities, sh, splats.antialias), surface=chosen.surface
    )
    return replace(level, splats=whole, skin=skin, shapes=shapes, levels=())


def _splats(level: Avatar, part: Part) -> list[bytes]:
    """Return the planes of a level, and write the ranges of its steps to ``part``."""
    splats, skin = level.splats, level.skin
    low, high = splats.means.min(axis=0).astype(np.float64), splats.means.max(axis=0).astype(np.float64)
    sizes = np.abs(splats.scales[np.abs(splats.scales) >= THINNEST]).astype(np.float64)
    logs = np.log(sizes) if len(sizes) else np.zeros(1)
    span = float(logs.min()), float(logs.max())
    colours = splats.sh[:, 0]
    if splats.sh_degree == 0:  # darker than black is drawn black
        colours = np.maximum(colours, np.float32(-0.5 / SH_C0))
    dark, bright = colours.min(axis=0).astype(np.float64), colours.max(axis=0).astype(np.float64)
    part.low, part.high, part.scales = low.tolist(), high.tolist(), list(span)
    part.colours = [*dark.tolist(), *bright.tolist()]
    planes = [
        mean_steps(splats.means, low, high),
        quat_bits(splats.quats),
        scale_steps(splats.scales, span),
        np.rint(splats.opacities.clip(0, 1) * 255).astype(np.uint8),
        colour_steps(colours, dark, bright),
    ]
    for band in range(1, splats.sh_degree + 1):
        rest = splats.sh[:, band**2 : (band + 1) ** 2].astype(np.float64)
        most = float(np.abs(rest).max())
        part.sh.append(most)
        planes.append(np.rint(rest / (most or 1.0) * 127).astype(np.int8))
    wide = np.uint8 if len(level.skeleton) <= 256 else np.uint16
    planes += [skin.joints.astype(wide), np.rint(skin.weights[:, 1:] * WEIGHT).astype(np.uint16)]
    return [to_planes(plane) for plane in planes]


def _shapes(shapes: Shapes) -> list[bytes]:
    if len(shapes.targets) > MOST_ENTRIES:
        raise FormatError(f"a browser takes at most {MOST_ENTRIES} entries of shapes, not {len(shapes.targets)}")
    moves = (np.rint(shapes.moves / _FINE) * _FINE).clip(-32767, 32767).astype(np.int16)
    each = np.diff(shapes.starts).astype(np.uint16)
    return [to_planes(rows) for rows in (each, shapes.targets, moves, shapes.bends)]


def _surface(surface: Surface) -> list[bytes]:
    planes = [surface.normals, surface.occlusion, *([] if surface.shade is None else [surface.shade])]
    return [to_planes(np.diff(plane, axis=0, prepend=plane[:1] * 0)) for plane in planes]


def _packed(parts: list[bytes] | bytes) -> bytes:
    packer = zlib.compressobj(7, zlib.DEFLATED, -15)
    return packer.compress(parts if isinstance(parts, bytes) else b"".join(parts)) + packer.flush()


def _joints(skeleton: Skeleton) -> Joints:
    def rows(matrices: NDArray[np.float64]) -> list[float]:
        flat: list[float] = matrices[:, :3].ravel().tolist()
        return flat

    names, parents = list(skeleton.names), skeleton.parents.tolist()
    return Joints(names, parents, rows(skeleton.rest), rows(skeleton.inverse_bind))


def _targets(shapes: Shapes | None) -> Targets | None:
    if shapes is None:
        return None
    return Targets(list(shapes.names), shapes.sizes.tolist(), shapes.limits.ravel().tolist())
