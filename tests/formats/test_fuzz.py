"""Mutated files: they load, or raise FormatError; nothing else, quickly, without a large allocation."""

from __future__ import annotations

import copy
import gzip
import json
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import all_formats, load, save
from glsplat.splats import Splats
from tests.formats.scenes import (
    SHARED_DATA,
    avatar_with_levels,
    awkward_splats,
    glb_parts,
    load_gltf,
    random_avatar,
    random_splats,
    splats_with_levels,
    spz_streams,
    write_glb,
)
from tests.formats.test_ply import columns, ply
from tests.skinning.faces import expressive

LIMIT = 8_000_000  # bytes a load of a file of a few kB may allocate
REAL = ("splats/splatapult_sh3_16.ply", "splats/unit_cube_ascii.ply", "formats/splat-transform/minimal.splat",
        "formats/splat-transform/minimal-raw.spz", "formats/splat-transform/minimal-v2.spz",
        "formats/splat-transform/minimal-v4.spz", "real/splats/khr_spz2_basic.glb")  # fmt: skip
fuzz = settings(database=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def _with_cones(avatar: Avatar) -> Avatar:
    cones = np.arange(-16, 16).astype(np.int8).reshape(8, 4)
    return replace(avatar, splats=replace(avatar.splats, antialias=True, cones=cones))


@lru_cache(maxsize=1)
def seeds() -> list[bytes]:
    import tempfile

    out = [ply(columns(random_splats(5, degree)), order) for degree in (0, 1) for order in ("<", ">", "")]
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in {
            "a.glb": _with_cones(random_avatar(8, degree=1)),
            "b.glb": awkward_splats(),
            "c.gltf": random_avatar(8, influences=8),
            "c.glb": avatar_with_levels(),
            "d.glb": splats_with_levels(),
            "e.glb": expressive(12),
            "d.splat": random_splats(8),
            "e.ply": awkward_splats(),
            "f.compressed.ply": random_splats(6, 1),
            "g.compressed.ply": random_splats(6),
            "h.spz": replace(random_splats(8, 3), antialias=True),
            "h.sog": random_splats(8, 1),
        }.items():
            if any(name.endswith(suffix) for known in all_formats().values() for suffix in known.suffixes):
                save(scene, Path(folder) / name)
                out.append((Path(folder) / name).read_bytes())
    for packed in [data for data in out if data.startswith(b"\x1f\x8b")]:
        out += [gzip.decompress(packed), spz_streams(packed)]  # SPZ without its gzip, and in version 4
    if "ksplat" in all_formats():
        from tests.extras.formats.ksplats import ksplat

        degrees, levels = (1, 0, 2), (0, 1, 2)
        out += [
            ksplat([random_splats(6, degree), random_splats(3)], level)[0]
            for degree, level in zip(degrees, levels, strict=True)
        ]
    out += [(SHARED_DATA / name).read_bytes() for name in REAL if (SHARED_DATA / name).is_file()]
    return out


def only_format_errors(path: Path, reader: Any) -> None:
    tracemalloc.start()
    try:
        scene = reader(path)
    except FormatError as error:
        assert "\n" not in str(error) and str(error).startswith(str(path)) and len(str(error)) < 600
    else:
        assert isinstance(scene, (Splats, Avatar))
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < LIMIT


numbers = st.sampled_from([0, 1, -1, 2**31, 2**32 - 1, 2**53, 2**63, 10**30, 0.5, 1e308, -1e-320])
json_values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=8) | st.integers(-3, 70_000),
    lambda inner: st.lists(inner, max_size=17) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=20,
)


@fuzz
@given(data=st.data())
def test_mutated_bytes(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(data.draw(st.sampled_from(seeds()), "seed"))
    for _ in range(data.draw(st.integers(1, 6))):
        kind = data.draw(st.sampled_from(["set", "set", "cut", "insert", "delete", "copy"]))
        at = data.draw(st.integers(0, min(len(content), 3000)))
        at = data.draw(st.sampled_from([at, min(len(content), 4096 + at)]))  # KSPLAT has its sections there
        some = data.draw(st.binary(min_size=1, max_size=8))
        length = data.draw(st.integers(1, 64))
        if kind == "set":
            content[at : at + len(some)] = some
        elif kind == "cut":
            del content[at:]
        elif kind == "insert":
            content[at:at] = some
        elif kind == "delete":
            del content[at : at + length]
        else:
            content[at:at] = content[at : at + length] * 3
    path = tmp_path / "fuzz"
    path.write_bytes(content)
    forced = [partial(load, format=name) for name in all_formats() if name not in ("obj", "npz")]
    for reader in (load, *forced):
        only_format_errors(path, reader)


@fuzz
@given(data=st.data())
def test_mutated_ply_header(tmp_path: Path, data: st.DataObject) -> None:
    content = data.draw(st.sampled_from([s for s in seeds() if s.startswith(b"ply")]))
    head, body = content.split(b"end_header\n", 1)
    lines = head.decode("latin-1").splitlines()
    words = ["0", "-1", "999999999999999999", "1e9", "vertex", "element", "property", "list", "double", "char", "uint",
             "format ascii 1.0", "format binary_big_endian 1.0", "f_rest_0", "x", "", "\x85", "end_header"]  # fmt: skip
    for _ in range(data.draw(st.integers(1, 4))):
        i = data.draw(st.integers(1, len(lines) - 1))
        kind = data.draw(st.sampled_from(["drop", "double", "word", "word", "swap"]))
        if kind == "drop" and len(lines) > 2:
            del lines[i]
        elif kind == "double":
            lines.insert(i, lines[i])
        elif kind == "swap":
            lines[i], lines[-1] = lines[-1], lines[i]
        else:
            parts = lines[i].split(" ")
            parts[data.draw(st.integers(0, len(parts) - 1))] = data.draw(st.sampled_from(words))
            lines[i] = " ".join(parts)
    path = tmp_path / "fuzz.ply"
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode("latin-1") + body)
    only_format_errors(path, load)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    out = [path] if path else []
    if isinstance(value, dict):
        for key in value:
            out += places(value[key], (*path, key))
    elif isinstance(value, list):
        for i in range(len(value)):
            out += places(value[i], (*path, i))
    return out


def mutated(data: st.DataObject, document: Any, keep: Callable[[tuple[Any, ...]], bool] = lambda path: True) -> Any:
    """A copy with one to three places of those to ``keep`` deleted or given another value."""
    document = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        left = [path for path in places(document) if keep(path)]
        if not left:
            break
        *steps, last = data.draw(st.sampled_from(left))
        target = document
        for step in steps:
            target = target[step]
        if isinstance(target, dict) and data.draw(st.booleans()):
            del target[last]
        else:
            target[last] = data.draw(json_values)
    return document


@fuzz
@given(data=st.data())
def test_mutated_gltf_json(tmp_path: Path, data: st.DataObject) -> None:
    document, blob = glb_parts(data.draw(st.sampled_from([s for s in seeds() if s.startswith(b"glTF")])))
    document = mutated(data, document)
    path = tmp_path / "fuzz.glb"
    write_glb(path, document, blob)
    only_format_errors(path, load)
    path.write_text(json.dumps(document))
    only_format_errors(path, load_gltf)


def _within(part: str, path: tuple[Any, ...]) -> bool:
    return path[0] == part and len(path) > 1


@fuzz
@given(data=st.data())
def test_mutated_levels_leave_the_finest(tmp_path: Path, data: st.DataObject) -> None:
    """Whatever the nodes of coarser levels hold: the file opens, with all of the finest."""
    save(avatar_with_levels(), tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    first = len(document["nodes"]) - 3
    for part in ("extensions", "extras"):
        if data.draw(st.booleans()):
            document["nodes"][0] = mutated(data, document["nodes"][0], partial(_within, part))
    for place in range(first, first + 3):
        node = document["nodes"][place]
        if data.draw(st.booleans()):
            kept = mutated(data, node, lambda path: path[0] in ("extras", "name"))
            document["nodes"][place] = kept
        accessors = document["meshes"][node["mesh"]]["primitives"][0]["attributes"]
        if data.draw(st.booleans()):
            key = data.draw(st.sampled_from(sorted(accessors)))
            accessors[key] = data.draw(st.integers(0, len(document["accessors"]) + 2))
    write_glb(tmp_path / "b.glb", document, blob)
    try:
        found = load(tmp_path / "b.glb")
    except FormatError as error:
        assert "glTF JSON is broken" in str(error)  # a name that is a number, extensions that are none
        return
    assert isinstance(found, Avatar) and len(found.splats) == 40


@fuzz
@given(data=st.data())
def test_random_rig_values(tmp_path: Path, data: st.DataObject) -> None:
    """Any float in the buffers: skins are repaired or refused, splats kept."""
    document, blob = glb_parts(next(s for s in seeds() if s.startswith(b"glTF")))
    values = np.frombuffer(bytearray(blob), "<f4").copy()
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(values) - 1))
        values[at] = data.draw(st.floats(width=32))
    path = tmp_path / "fuzz.glb"
    write_glb(path, document, values.tobytes())
    only_format_errors(path, load)


def test_names_of_a_file_do_not_steer_the_terminal(tmp_path: Path) -> None:
    data = b"ply\nformat ascii 1.0\nelement v\x80\x1b[2Jx 1\nproperty float x\nend_header\n0\n"
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(FormatError) as caught:
        load(tmp_path / "a.ply")
    assert str(caught.value).isprintable() and "found v??[2Jx" in str(caught.value)


@pytest.mark.filterwarnings("error")
def test_nans_that_signal(tmp_path: Path) -> None:
    """Casting one to float64 warns; files may hold them wherever they hold floats, and they may be saved again."""
    signals = b"\1\0\x80\x7f"
    save(random_avatar(8), tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    view = document["bufferViews"][document["accessors"][document["skins"][0]["inverseBindMatrices"]]["bufferView"]]
    start = view.get("byteOffset", 0)
    write_glb(tmp_path / "a.glb", document, blob[:start] + signals + blob[start + 4 :])
    only_format_errors(tmp_path / "a.glb", load)
    value = np.frombuffer(signals, "<f4")[0:1]
    base = random_splats(8, 1)
    means, scales, sh = base.means.copy(), base.scales.copy(), base.sh.copy()
    means.view("<u4")[0], scales.view("<u4")[1], sh.view("<u4")[2] = (value.view("<u4")[0],) * 3
    sh[3] = 3e38  # has no square
    for suffix in [known.suffixes[0] for known in all_formats().values() if known.save]:
        save(replace(base, means=means, scales=scales, sh=sh), tmp_path / f"b{suffix}")
        load(tmp_path / f"b{suffix}")
