"""Small scenes and files for the format tests."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.formats import load_splats
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Level, Splats

# each reads one format, whatever the content
load_ply = partial(load_splats, format="ply")
load_gltf = partial(load_splats, format="glb")
load_splat = partial(load_splats, format="splat")
load_spz = partial(load_splats, format="spz")
load_sog = partial(load_splats, format="sog")

SHARED_DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"  # may be absent
FIELDS = ("means", "quats", "scales", "opacities", "sh")


def random_splats(count: int = 50, degree: int = 0, seed: int = 1) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats.create(
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 4)),
        np.exp(rng.normal(-4, 1, (count, 3))),
        rng.uniform(0.01, 0.99, count),
        rng.normal(0, 0.4, (count, (degree + 1) ** 2, 3)),
    )


def awkward_splats() -> Splats:
    """Everything a file may hold that a renderer has to survive."""
    base = random_splats(10, 1)
    means, quats, scales = base.means.copy(), base.quats.copy(), base.scales.copy()
    opacities, sh = base.opacities.copy(), base.sh.copy()
    means[0, 1], means[1] = np.nan, np.inf
    quats[2], quats[3] = 0, np.nan
    scales[4], scales[5, 0], scales[6] = 0, -0.5, np.inf
    opacities[7:10] = (0, 1, np.nan)
    sh[0, 1, 2] = np.nan
    return Splats(means, quats, scales, opacities, sh)


def random_avatar(count: int = 40, joints: int = 5, influences: int = 4, degree: int = 0) -> Avatar:
    """Joint frames turned and off-centre, two roots, every joint used."""
    rng = np.random.default_rng(3)
    rest = np.tile(np.eye(4), (joints, 1, 1))
    for j in range(joints):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rest[j, :3, :3] = q * np.linalg.det(q)
        rest[j, :3, 3] = rng.normal(size=3)
    parents = np.array([-1, 0, 1, 1, -1][:joints])
    skeleton = Skeleton(tuple(f"bone {j}" for j in range(joints)), parents, rest)
    ids = np.argsort(rng.random((count, max(joints, 8))), axis=1)[:, :8]  # distinct, as glTF demands
    skin = Skin.create(ids % joints, rng.random((count, 8)) * (ids < joints), joints, influences)
    meta = {"source": "a test", "licence": "CC0", "consent": None, "body_model": {"name": "five bones"}, "empty": []}
    return Avatar(random_splats(count, degree), skeleton, skin, meta)


def avatar_with_levels() -> Avatar:
    """40, 20, 10 and 5 splats on one skeleton; cones on the finest and on one level, what a skin lost on another."""
    whole = random_avatar(40, degree=1)
    whole = replace(whole, splats=replace(whole.splats, antialias=True, cones=_cones(40), cones_psnr=45.5))
    levels: list[Level[Avatar]] = []
    for count, density, psnr in ((20, 200.0, 41.5), (10, 100.0, None), (5, 1 / 3, 40.0)):
        few = replace(whole, splats=whole.splats.take(range(count)), skin=whole.skin.take(np.arange(count)))
        if psnr is None:
            few = replace(few, splats=replace(few.splats, cones=None))
            few = replace(few, skin=Skin(few.skin.joints, few.skin.weights, 0.25, 3))
        levels.append(Level(few, density, psnr))
    return replace(whole, levels=tuple(levels))


def splats_with_levels() -> Splats:
    """40, 20, 10 and 5 splats; one level is drawn without compensation, and one has no spherical harmonics."""
    whole = replace(random_splats(40, 2), antialias=True)
    twenty, ten, five = (whole.take(range(count)) for count in (20, 10, 5))
    coarse = (replace(twenty, antialias=False), replace(ten, sh=ten.sh[:, :1]), five)
    levels = [Level(content, density) for content, density in zip(coarse, (300.0, 50.0, 7.0), strict=True)]
    return replace(whole, levels=levels)


def _cones(count: int) -> np.ndarray:
    return (np.arange(4 * count) % 255 - 127).astype(np.int8).reshape(count, 4)


def assert_equal(a: Splats, b: Splats) -> None:
    """Bit-equal, NaN included."""
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def spz_streams(data: bytes, extensions: bytes = b"") -> bytes:
    """SPZ version 4 of a file of version 3. The zstd frames are of blocks that are stored: that takes no library."""
    payload = gzip.decompress(data)
    count, degree = struct.unpack_from("<I", payload, 8)[0], payload[12]
    flags = payload[14] | 2 * bool(extensions)
    parts, at = [], 16
    for width in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)):
        parts.append(payload[at : at + count * width])
        at += count * width
    parts = [part for part in parts if part]
    head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, count, degree, payload[13], flags, len(parts), 32 + len(extensions))
    frames = [zstd_frame(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(frame), len(part)) for frame, part in zip(frames, parts, strict=True))
    return head + extensions + table + b"".join(frames)


def zstd_frame(data: bytes) -> bytes:
    """RFC 8878, 3.1.1: magic, one segment with a size of four bytes, blocks of at most 128 kB, the last one marked."""
    out = b"\x28\xb5\x2f\xfd\xa0" + struct.pack("<I", len(data))
    for at in range(0, len(data), 1 << 17):
        block = data[at : at + (1 << 17)]
        out += struct.pack("<I", len(block) << 3 | (at + (1 << 17) >= len(data)))[:3] + block
    return out


def glb_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def glb_of(document: dict[str, Any], blob: bytes) -> bytes:
    """A .glb; the blob ends on a multiple of four bytes unless the file is to be broken."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(blob), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(blob), 0x004E4942) + blob


def glb_arrays(*arrays: np.ndarray) -> tuple[list[dict[str, Any]], list[dict[str, Any]], bytes]:
    """Accessors, buffer views and the blob of arrays [N, K], each in a view of its own."""
    codes = {"|u1": 5121, "<u2": 5123, "<u4": 5125, "<f4": 5126}
    kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
    accessors: list[dict[str, Any]] = []
    views, blob = [], b""
    for view, array in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes})
        accessor = {"bufferView": view, "componentType": codes[array.dtype.str], "count": len(array)}
        accessors.append(accessor | {"type": kinds[array.shape[1]]})
        blob += array.tobytes() + bytes(-array.nbytes % 4)
    return accessors, views, blob


def write_glb(path: Path, document: dict[str, Any], blob: bytes) -> None:
    path.write_bytes(glb_of(document, blob))


def edit_glb(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    document, blob = glb_parts(path.read_bytes())
    change(document)
    write_glb(path, document, blob)
