"""Splats as one POINTS primitive of glTF with KHR_gaussian_splatting, and back.

Read: the ratified attribute names (KHR_gaussian_splatting:ROTATION, :SCALE, :OPACITY, :SH_DEGREE_l_COEF_n) and the
older drafts' (_ROTATION, _SCALE, colour and opacity in COLOR_0). Written: the ratified ones as float32, rotations as 16
bits where reading makes the same of them (narrow_quats), so that a round trip is exact, and a COLOR_0 for viewers that
know no splats.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.output import Output
from glsplat.formats.gltf.schema import Primitive
from glsplat.light.surface import SHADE_ONE, Surface
from glsplat.optional import missing, plugin
from glsplat.pictures import to_linear
from glsplat.splats import SH_C0, Splats, normalised

EXTENSION = "KHR_gaussian_splatting"
SPZ_EXTENSION = "KHR_gaussian_splatting_compression_spz_2"
"""Extension of splats that are stored as an SPZ."""

ANTIALIAS = "antialias"
"""In asset.extras.glsplat: Splats.antialias of all splats in the file."""

COLOUR = "colour"
"""In asset.extras.glsplat: the kind of the splats' colours. "albedo", or "shaded" (albedo times the light in
``_OCCLUSION``): both are lit by a scene's light. "baked" and all else are not."""

_ALBEDO, _SHADED = "albedo", "shaded"
_NORMAL, _OCCLUSION = "_NORMAL", "_OCCLUSION"  # Splats.surface: (x, y, z, 0); (occlusion, shade r, g, b)
# names of an application's own attributes start with an underscore (glTF 2.0, 3.7.2)
_CONE = "_VISIBILITY_CONE"  # Splats.cones
_CONES_PSNR = "cones_psnr"  # in the primitive's extras.glsplat: Splats.cones_psnr
_ROTATION_ONE = np.float32(32767)
_SPACES = ("srgb_rec709_display", "BT.709", "BT.709-sRGB", "BT.709-srgb")
_SH_NAMES = [(degree, n) for degree in range(4) for n in range(2 * degree + 1)]


def write_splats(out: Output, splats: Splats, *, coarse: bool = False) -> Primitive:
    """Add the arrays of splats and return their primitive, of material 0, without joints and weights.

    ``coarse`` levels show other viewers colours of 8 bits.
    """
    attributes = {"POSITION": out.add(splats.means, "VEC3", bounds=True)}
    rotations = np.roll(narrow_quats(splats.quats), -1, axis=1)  # xyzw
    attributes[f"{EXTENSION}:ROTATION"] = out.add(rotations, "VEC4", normalized=rotations.dtype == np.int16)
    attributes[f"{EXTENSION}:SCALE"] = out.add(splats.scales, "VEC3")
    attributes[f"{EXTENSION}:OPACITY"] = out.add(splats.opacities[:, None], "SCALAR")
    for k, (degree, n) in enumerate(_SH_NAMES[: splats.sh.shape[1]]):
        attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"] = out.add(splats.sh[:, k], "VEC3")
    if splats.cones is not None:
        attributes[_CONE] = out.add(splats.cones, "VEC4", normalized=True)
    if splats.surface is not None:
        surface, count = splats.surface, len(splats)
        attributes[_NORMAL] = out.add(np.pad(surface.normals, ((0, 0), (0, 1))), "VEC4", normalized=True)
        packed = np.concatenate([surface.occlusion.reshape(count, 1), surface.shades_or_one()], axis=1)
        attributes[_OCCLUSION] = out.add(packed, "VEC4", normalized=True)
    attributes["COLOR_0"] = _write_fallback(out, splats, np.uint8 if coarse else np.uint16)
    return Primitive(
        attributes=attributes,
        mode=0,
        material=0,
        extensions={EXTENSION: {"kernel": "ellipse", "colorSpace": _SPACES[0]}},
        extras=None if splats.cones_psnr is None else {"glsplat": {_CONES_PSNR: splats.cones_psnr}},
    )


def _write_fallback(out: Output, splats: Splats, kind: type[np.uint8 | np.uint16]) -> int:
    """Add COLOR_0, linear RGB and opacity, for viewers without splats; return its accessor's index.

    They show points in plain colours (KHR_gaussian_splatting, "Fallback Behavior"). In 8 bits of linear light the
    darkest sRGB colours are up to 6 levels off, in 16 bits 0.05. Values are clamped to 0 to 1, NaN becomes 0.
    """
    colours = np.empty((len(splats), 4), np.float32)
    colours[:, :3] = splats.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)
    colours[:, 3] = splats.opacities
    np.clip(np.nan_to_num(colours, copy=False), 0, 1, out=colours)
    colours[:, :3] = to_linear(colours[:, :3])
    return out.add(np.rint(colours * np.iinfo(kind).max).astype(kind), "VEC4", normalized=True)


def narrow_quats(quats: NDArray[np.float32]) -> NDArray[np.float32] | NDArray[np.int16]:
    """Return quaternions [N, 4] in 32767ths where reading those gives the same; else as they are."""
    with np.errstate(invalid="ignore", over="ignore"):
        narrow = np.nan_to_num(np.rint(quats * _ROTATION_ONE)).clip(-_ROTATION_ONE, _ROTATION_ONE).astype(np.int16)
    return narrow if np.array_equal(normalised(narrow / _ROTATION_ONE), quats) else quats


def read_splats(container: Container, primitive: Primitive, name: str) -> Splats:
    """Read the splats of a primitive, untransformed; messages call it ``name``. Raises FormatError."""
    if primitive.mode != 0:
        raise FormatError(f"{name}: splats need a POINTS primitive (mode 0), not mode {primitive.mode}")
    extension = primitive.extensions[EXTENSION]
    # drafts made the colour space optional, and had other names for it
    space = extension.get("colorSpace", _SPACES[0]) if isinstance(extension, dict) else _SPACES[0]
    if space not in _SPACES:
        raise FormatError(f"{name}: needs colorSpace {_SPACES[0]}, not {str(space)[:40]!r}; convert the colours")
    view = packed_view(extension, name)
    if view is not None:
        return _packed_splats(container, primitive, view, name)
    attributes = {key.replace(f"{EXTENSION}:", "_", 1): index for key, index in primitive.attributes.items()}

    def read(key: str, *types: str) -> NDArray[np.float32] | None:
        return container.numbers(attributes[key], f"{name} {key}", types) if key in attributes else None

    means, quats, scales = read("POSITION", "VEC3"), read("_ROTATION", "VEC4"), read("_SCALE", "VEC3")
    opacities, dc = read("_OPACITY", "SCALAR"), read("_SH_DEGREE_0_COEF_0", "VEC3")
    color = read("COLOR_0", "VEC3", "VEC4") if opacities is None or dc is None else None
    if opacities is None and color is not None and color.shape[1] == 4:
        opacities = color[:, 3:]
    if dc is None and color is not None:
        dc = ((color[:, :3] - 0.5) / SH_C0).astype(np.float32)
    needed = {"POSITION": means, "ROTATION": quats, "SCALE": scales, "OPACITY": opacities, "SH_DEGREE_0_COEF_0": dc}
    if means is None or quats is None or scales is None or opacities is None or dc is None:
        missing = ", ".join(key for key, value in needed.items() if value is None)
        raise FormatError(f"{name}: splats need the attributes {missing}")
    sh = [dc]
    keys = [f"_SH_DEGREE_{degree}_COEF_{n}" for degree, n in _SH_NAMES[1:]]
    last = max((k for k, key in enumerate(keys) if key in attributes), default=-1)
    for key in keys[: ((3, 8, 15)[_SH_NAMES[last + 1][0] - 1] if last >= 0 else 0)]:  # all up to the highest degree
        coefficient = read(key, "VEC3")
        if coefficient is None:
            raise FormatError(f"{name}: incomplete spherical harmonics, {key[1:]} is missing")
        sh.append(coefficient)
    counts = {len(a) for a in (means, quats, scales, opacities, *sh)}
    if len(counts) > 1:
        raise FormatError(f"{name}: the attributes need one count, found {', '.join(map(str, sorted(counts)))}")
    ours = "version" in container.note()
    if not ours and int((scales < 0).sum()) * 2 > scales.size:  # logarithms, as in drafts
        with np.errstate(over="ignore"):
            scales = np.exp(scales)
    cones = None
    if _CONE in attributes:
        cones = _read_exactly(container, attributes[_CONE], f"{name} {_CONE}", np.int8, len(means))
    return Splats.create(
        means,
        np.roll(quats, 1, axis=1),
        scales,
        opacities,
        frozen(np.stack(sh, axis=1)),
        antialias=container.note().get(ANTIALIAS) is True,
        cones=cones,
        cones_psnr=number_of(our_extras(primitive.extras).get(_CONES_PSNR)),
        surface=_surface(container, attributes, len(means), name),
    )


def colour_note(parts: Iterable[Splats]) -> dict[str, str]:
    """Return the extras on the colours of all ``parts`` of a file; empty where all are baked."""
    surfaces = [splats.surface for splats in parts if splats.surface is not None]
    if not surfaces:
        return {}
    return {COLOUR: _SHADED if any(surface.shade is not None for surface in surfaces) else _ALBEDO}


def our_extras(extras: Any) -> dict[str, Any]:
    """Return glsplat's part of the extras of an object; empty in the files of others."""
    ours = extras.get("glsplat") if isinstance(extras, dict) else None
    return ours if isinstance(ours, dict) else {}


def number_of(value: Any) -> float | None:
    """Return a finite number as float; None for all else."""
    usable = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300
    return float(value) if usable else None


def _read_exactly(container: Container, index: int, what: str, kind: type[np.generic], count: int) -> NDArray[Any]:
    """Read [count, 4] elements of ``kind``. Raises FormatError for others."""
    raw = container.read(index, what, ("VEC4",))
    if raw.dtype != kind or len(raw) != count:
        raise FormatError(f"{what} needs {count} elements of {np.dtype(kind)}, not {len(raw)} of {raw.dtype}")
    return np.array(raw, kind)


def _surface(container: Container, attributes: dict[str, int], count: int, name: str) -> Surface | None:
    """Read the surface of albedo or shaded colours. Raises FormatError for arrays that do not fit."""
    said = container.note().get(COLOUR)
    if said not in (_ALBEDO, _SHADED) or not {_NORMAL, _OCCLUSION} <= attributes.keys():
        return None
    normals = _read_exactly(container, attributes[_NORMAL], f"{name} {_NORMAL}", np.int8, count)
    packed = _read_exactly(container, attributes[_OCCLUSION], f"{name} {_OCCLUSION}", np.uint8, count)
    shade = None if said == _ALBEDO or (packed[:, 1:] == SHADE_ONE).all() else packed[:, 1:]
    return Surface(normals[:, :3], packed[:, 0], shade)


def packed_view(extension: Any, name: str) -> int | None:
    """Return the bufferView that splats are packed into, by the value of KHR_gaussian_splatting; None without.

    Raises FormatError for another compression than SPZ.
    """
    nested = extension.get("extensions") if isinstance(extension, dict) else None
    if not isinstance(nested, dict) or not any("compression" in key for key in nested):
        return None
    payload = nested.get(SPZ_EXTENSION)
    index = payload.get("bufferView") if isinstance(payload, dict) else None
    if type(index) is not int or index < 0:
        raise FormatError(f"{name}: the splats are compressed ({next(iter(nested))[:60]}); export them uncompressed")
    return index


def _packed_splats(container: Container, primitive: Primitive, index: int, name: str) -> Splats:
    """Read the splats of that bufferView. The primitive's attributes are placeholders of the same count.

    Raises FormatError where the counts differ.
    """
    spz = plugin("formats.spz")
    if spz is None:
        raise FormatError(missing("formats", f"{name}, which is packed as SPZ,"))
    splats: Splats = spz.spz_splats(container.view(index, f"{name} {SPZ_EXTENSION}"))
    position, accessors = primitive.attributes.get("POSITION"), container.gltf.accessors
    if position is not None and position < len(accessors) and accessors[position].count != len(splats):
        raise FormatError(f"{name}: POSITION has {accessors[position].count} elements, its SPZ data {len(splats)}")
    return splats
