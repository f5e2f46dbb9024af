"""People and meshes in glTF whose JSON was mutated: read, or refused in one line; and rigs that no body has."""

from __future__ import annotations

import base64
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.errors import FormatError
from glsplat.extras.rigs.match import match_rig
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.meshes import RiggedMesh
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from tests.extras.rigs.gltf.built import FAMILIES, build
from tests.formats.scenes import glb_parts, write_glb
from tests.formats.test_fuzz import fuzz, mutated


@lru_cache(maxsize=1)
def seeds() -> list[tuple[dict[str, Any], bytes]]:
    return [glb_parts(build(replace(FAMILIES[name], twists=(), more={})).data) for name in ("VRM 0.x", "Unreal")]


def only_format_errors(path: Path) -> None:
    try:
        assert isinstance(read_gltf_person(path), RiggedMesh)
    except FormatError as error:
        assert "\n" not in str(error) and str(error).startswith(str(path)) and len(str(error)) < 700


@fuzz
@given(data=st.data())
def test_mutated_json(tmp_path: Path, data: st.DataObject) -> None:
    document, blob = data.draw(st.sampled_from(seeds()))
    document = mutated(data, document)
    write_glb(tmp_path / "fuzz.glb", document, blob)
    only_format_errors(tmp_path / "fuzz.glb")


def test_two_skins_of_which_one_is_not_there(tmp_path: Path) -> None:
    document, blob = glb_parts(build(FAMILIES["Unreal"]).data)
    skinned = next(node for node in document["nodes"] if "skin" in node)
    document["nodes"].append({**skinned, "skin": 7, "name": "second"})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    write_glb(tmp_path / "two.glb", document, blob)
    with pytest.raises(FormatError, match=r"two\.glb: the file refers to skin 7, but has 1"):
        read_gltf_person(tmp_path / "two.glb")


def test_a_small_file_that_shows_its_mesh_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture is decoded and held once; what would not go into memory is refused before it is read."""
    document, blob = glb_parts(build(FAMILIES["Unreal"]).data)
    skinned = next(node for node in document["nodes"] if "skin" in node)
    mesh = document["meshes"][skinned["mesh"]]
    mesh["primitives"] *= 12
    picture = cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (512, 512, 3), np.uint8))[1].tobytes()
    document["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(picture).decode()}]
    document["textures"] = [{"source": 0}]
    document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    for primitive in mesh["primitives"]:
        primitive["material"] = 0
    write_glb(tmp_path / "a.glb", document, blob)
    read = read_gltf_person(tmp_path / "a.glb")
    assert len(read.parts) >= 12 and len({id(part.texture) for part in read.parts}) < 5
    monkeypatch.setattr("glsplat.extras.rigs.meshes.reader._MOST", 1 << 17)
    document["nodes"] += [skinned] * 400
    document["scenes"][0]["nodes"] += range(len(document["nodes"]) - 400, len(document["nodes"]))
    write_glb(tmp_path / "a.glb", document, blob)
    with pytest.raises(FormatError, match=r"a\.glb: the nodes show \d+ vertices and corners in all; 131072 are read"):
        read_gltf_person(tmp_path / "a.glb")


@pytest.mark.check
def test_a_chain_of_many_joints() -> None:
    """Looking a rig up takes no square of its length, in time or memory."""
    count = 20_000
    names = [f"spine_{k}" for k in range(count)]
    found = match_rig(names, np.arange(count) - 1, np.zeros((count, 3)))
    assert len(found.missing) == 9

    def took(count: int) -> float:
        began = time.process_time()
        assert len(Skeleton.from_joints(names[:count], np.arange(count) - 1, np.zeros((count, 3)))) == count
        return time.process_time() - began

    # 4 times where each joint is looked at once, 16 where each level looks at all joints
    assert min(took(count) for _ in range(3)) < 9 * min(took(count // 4) for _ in range(3))
    limb = Skeleton.from_joints(["left_hip\n\x1b[2J", "b", "c", "d", "e"], [-1, 0, 1, 2, 3], np.full((5, 3), 1e300))
    why = why_not_driven(limb)
    assert why.isprintable() and "no joint for head" in why
