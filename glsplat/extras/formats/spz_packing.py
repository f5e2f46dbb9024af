"""Encoding of splats in SPZ: one attribute of all splats after another.

==============  =====  ==================================================================  ========================
attribute       bytes  a step                                                              what fits
==============  =====  ==================================================================  ========================
position        9      2^-bits m; we write 12 bits (0.24 mm), fewer in a larger scene       24 bits: +-2048 m
opacity         1      1/255                                                               0 to 1
colour          3      0.0261 of the coefficient, 0.0074 of the colour                     colours -0.44 to 1.44
scale           3      a factor of exp(1/16) = 1.064                                       exp(-10) m to 379 m
rotation        4      0.00138 of each of the three smaller components (0.28 degrees)       all
rotation, v1-2  3      0.0078 of x, y and z, where w >= 0 (14 degrees where w is 0)        all
SH coefficient  1      1/128; written in steps of 1/16 (degree 1) and 1/8, as others do    -1 to 0.992
==============  =====  ==================================================================  ========================

Version 1 has float16 positions of 6 bytes. The axes of an SPZ file are x right, y up, z back; a 3DGS PLY of the same
scene has x right, y down, z front. To agree with the PLY, splats are turned half around x on the way in and out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, frozen
from glsplat.extras.formats.packed import smallest_three, with_largest
from glsplat.extras.formats.splat import hidden
from glsplat.rotations import sh_rotations
from glsplat.splats import Splats, normalised

U8 = NDArray[np.uint8]
Bytes = bytes | bytearray | memoryview

HALF_TURN = np.diag([1.0, -1.0, -1.0])  # rotation from SPZ's axes to a 3DGS PLY's, and back

_CHUNK = 1 << 16  # splats converted at a time
_LARGEST = (1 << 23) - 1  # of a position, in steps
_BITS = 12  # of the positions' fraction, as in other writers
_FAR = 0.001  # share of splats that may be clamped instead of making all steps larger
_COLOUR = 0.15 * 255  # steps a unit of the coefficient: twice the range of a colour, which higher degrees correct
_BUCKETS = np.array([8, 16, 16], np.float32)  # of degree 1, 2, 3: steps of 1/128 joined for compression
_NO_TURN = np.array([0, 0, 0, 1], np.float32)  # xyzw
_ROOT = np.float32(0.5**0.5)  # largest possible smaller component of a unit quaternion
_SHIFTS = np.array([20, 10, 0], np.uint32)

_BYTES = np.arange(256)
_OPACITIES = (_BYTES / 255).astype(np.float32)
_COLOURS = ((_BYTES - 127.5) / _COLOUR).astype(np.float32)
_SCALES = np.exp(_BYTES / 16 - 10).astype(np.float32)
_COEFFICIENTS = ((_BYTES - 128) / 128).astype(np.float32)
_SIGNED = (_BYTES / 127.5 - 1).astype(np.float32)


@dataclass(frozen=True)
class SpzHeader:
    """The parsed first 16 bytes."""

    version: int
    count: int
    degree: int  # of the spherical harmonics, 0 to 4
    bits: int  # of the positions' fraction
    antialias: bool = False

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes a splat of each attribute, in the order of the file."""
        position, rotation = 6 if self.version == 1 else 9, 3 if self.version < 3 else 4
        return position, 1, 3, 3, rotation, 3 * ((self.degree + 1) ** 2 - 1)


def unpacked(header: SpzHeader, attributes: Sequence[Bytes], *, turn: bool) -> Splats:
    """Return the splats of a file's attributes, of ``count`` times their widths in bytes; SH of degree 4 is left out.

    ``turn`` converts to the axes of a 3DGS PLY.
    """
    count, kept = header.count, (min(header.degree, 3) + 1) ** 2
    columns: list[U8] = [
        np.frombuffer(data, np.uint8).reshape(count, width)
        for data, width in zip(attributes, header.widths, strict=True)
    ]
    means, scales = np.empty((2, count, 3), np.float32)
    quats, opacities = np.empty((count, 4), np.float32), np.empty(count, np.float32)
    sh = np.empty((count, kept, 3), np.float32)
    axes = HALF_TURN.diagonal().astype(np.float32)
    for at in range(0, count, _CHUNK):
        part = slice(at, at + _CHUNK)
        position, alpha, colour, scale, rotation, rest = (column[part] for column in columns)
        means[part] = _positions(position, header)
        quats[part] = normalised(_smallest_three(rotation) if header.version > 2 else _first_three(rotation))
        opacities[part] = _OPACITIES[alpha[:, 0]]
        scales[part] = _SCALES[scale]
        sh[part, 0] = _COLOURS[colour]
        sh[part, 1:] = _COEFFICIENTS[rest[:, : 3 * (kept - 1)]].reshape(len(rest), kept - 1, 3)
        if turn:
            means[part] *= axes
            quats[part, 1:] *= axes
            sh[part, 1:] *= _sh_signs()[1:kept]
    return Splats(frozen(means), frozen(quats), frozen(scales), frozen(opacities), frozen(sh), header.antialias)


def packed(splats: Splats, header: SpzHeader) -> Iterator[bytes]:
    """Yield the bytes after the header, of version 2 or 3, in SPZ's axes.

    A splat that is never drawn (not finite, or a zero quaternion) becomes transparent and moves to the origin, as SPZ
    cannot store such numbers.
    """
    drawn = splats.drawable()
    parts = [slice(at, at + _CHUNK) for at in range(0, len(splats), _CHUNK)]
    axes = HALF_TURN.diagonal().astype(np.float32)
    with np.errstate(all="ignore"):  # values of undrawn splats are arbitrary
        for part in parts:
            means = np.where(drawn[part, None], splats.means[part] * axes, 0)
            steps = np.clip(np.rint(means.astype(np.float64) * 2**header.bits), -_LARGEST - 1, _LARGEST)
            yield steps.astype("<i4").view(np.uint8).reshape(-1, 3, 4)[:, :, :3].tobytes()
        for part in parts:
            yield _rounded(np.where(drawn[part], splats.opacities[part], 0) * np.float32(255))
        for part in parts:
            yield _rounded(splats.sh[part, 0] * np.float32(_COLOUR) + np.float32(127.5))
        for part in parts:
            yield _rounded((np.log(np.abs(splats.scales[part].astype(np.float64))) + 10) * 16)
        for part in parts:
            quats = np.where(drawn[part, None], np.roll(splats.quats[part], -1, axis=1), _NO_TURN)
            quats[:, :3] *= axes
            yield (_as_smallest_three if header.version > 2 else _as_first_three)(quats)
        buckets = _buckets(splats)
        for part in parts if len(buckets) else []:
            rest = splats.sh[part, 1:] * _sh_signs()[1 : splats.sh.shape[1]]
            yield _rounded(np.floor(rest * 128 / buckets + np.float32(0.5)) * buckets + 128)


def position_bits(splats: Splats) -> int:
    """Return the bits of the positions' fraction: 12, or fewer to reach all but one in a thousand of the splats."""
    reach = np.abs(splats.means).max(axis=1, initial=0)
    reach = np.sort(reach[np.isfinite(reach)])
    if not len(reach):
        return _BITS
    far = float(reach[int((len(reach) - 1) * (1 - _FAR))])
    return next((bits for bits in range(_BITS, 0, -1) if far * 2**bits <= _LARGEST), 0)


def lost(splats: Splats) -> Iterator[str]:
    """Yield a sentence for each loss of ``packed`` but rounding."""
    drawn = splats.drawable()
    yield from hidden(~drawn)
    with np.errstate(all="ignore"):
        limit = (_LARGEST + 1) / 2 ** position_bits(splats)
        beyond = int((np.abs(splats.means[drawn]) > limit).any(axis=1).sum())
        if beyond:
            yield f"{beyond} splats farther out than {limit:g} m on an axis are moved to there"
        steps = (np.log(np.abs(splats.scales[drawn].astype(np.float64))) + 10) * 16
        for what, count in (
            (f"below {_SCALES[0]:.2g} m", (steps < -0.5)),
            (f"above {_SCALES[255]:.3g} m", (steps > 255.5)),
        ):
            if count.any():
                yield f"{int(count.any(axis=1).sum())} splats have a scale {what}, which it becomes"
        outside = np.abs(splats.sh[drawn, 0] * _COLOUR) > 128
        if outside.any():
            yield f"{int(outside.any(axis=1).sum())} splats have colours outside -0.44 to 1.44, which are clamped"
        if splats.sh_degree:
            rest = splats.sh[drawn, 1:]
            high = int((np.abs(rest) > 1 + _buckets(splats) / 256).sum())
            yield (
                "spherical harmonics keep 5 bits in degree 1 and 4 above, between -1 and 1"
                + f"; {high} of {rest.size} coefficients are clamped" * bool(high)
            )


def _buckets(splats: Splats) -> F32:
    """Return the bucket sizes [K - 1, 1] of the coefficients above degree 0."""
    return np.repeat(_BUCKETS, (3, 5, 7))[: splats.sh.shape[1] - 1, None]


def _rounded(values: NDArray[np.floating]) -> bytes:
    return np.rint(np.clip(np.nan_to_num(values), 0, 255)).astype(np.uint8).tobytes()


def _positions(data: U8, header: SpzHeader) -> NDArray[np.floating]:
    if header.version == 1:
        return data.view("<f2")
    low, middle, high = np.moveaxis(data.reshape(-1, 3, 3), -1, 0)
    steps = low | middle.astype(np.int32) << 8 | high.view(np.int8).astype(np.int32) << 16
    return steps.astype(np.float32) * np.float32(2.0**-header.bits)


def _first_three(data: U8) -> F32:
    """Return quaternions [N, 4] wxyz of x, y and z; ``normalised`` shortens those longer than one."""
    xyz = _SIGNED[data]
    w = np.sqrt(np.maximum(0, 1 - np.einsum("ni,ni->n", xyz, xyz)))
    return np.concatenate([w[:, None], xyz], axis=1)


def _smallest_three(data: U8) -> F32:
    """Return quaternions [N, 4] wxyz of two bits for the index of the largest, a sign and nine bits for the others."""
    words = data.view("<u4")
    largest = (words[:, 0] >> 30).astype(np.intp)
    fields = words >> _SHIFTS
    smaller = (fields & 511).astype(np.float32) * (_ROOT / 511)
    np.negative(smaller, out=smaller, where=(fields & 512) != 0)
    return np.roll(with_largest(largest, smaller), 1, axis=1)


def _as_first_three(xyzw: F32) -> bytes:
    xyz = np.where(xyzw[:, 3:] < 0, -xyzw[:, :3], xyzw[:, :3])
    return _rounded(xyz * np.float32(127.5) + np.float32(127.5))


def _as_smallest_three(xyzw: F32) -> bytes:
    largest, smaller = smallest_three(xyzw)
    size = np.minimum(np.floor(np.abs(smaller) * (511 / _ROOT) + np.float32(0.5)), 511).astype(np.uint32)
    fields = (size | (smaller < 0).astype(np.uint32) << 9) << _SHIFTS
    words = largest.astype(np.uint32) << 30 | fields[:, 0] | fields[:, 1] | fields[:, 2]
    return words.astype("<u4").tobytes()


@cache
def _sh_signs() -> F32:
    """Return the signs [16, 1] of the coefficients after half a turn."""
    return frozen(np.rint(sh_rotations(HALF_TURN, 3).diagonal()).astype(np.float32)[:, None])
