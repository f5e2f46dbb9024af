"""NaN and infinity in glTF: weights are left out, texture coordinates (0, 0), colours white, in one warning."""

from __future__ import annotations

import logging
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.importers.lam import load_lam_zip
from glsplat.extras.rigs.meshes import reader
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import load, save
from glsplat.formats.format import opened
from glsplat.formats.gltf.container import read_container
from glsplat.formats.gltf.nodes import graph_of
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.splats import Splats
from tests.extras.authoring.importers.test_lam import skin_glb
from tests.extras.rigs.gltf.built import FAMILIES, build
from tests.extras.rigs.gltf.test_surfaces import CORNERS, UV, seen, square
from tests.formats.scenes import glb_parts, random_avatar, write_glb

INF, NAN = np.inf, np.nan
BAD = pytest.mark.parametrize("bad", [NAN, -INF])
PERSON = build(replace(FAMILIES["Unreal"], twists=(), more={"root": "pelvis"}))
ROOTED = "vertices without weights (now on the root joint)"
JOINTS, WEIGHTS = 1, 2  # accessors, and bufferViews, of the people of built.py


def person(path: Path, weights: Mapping[int, tuple[float, ...]], change: Callable[[Any], None] | None = None) -> Path:
    """The built person with the ``weights`` of some vertices; its pelvis hangs from a joint that moves nothing."""
    document, blob = glb_parts(PERSON.data)
    names = [node.get("name") for node in document["nodes"]]
    root, pelvis, armature = (names.index(name) for name in ("root", "pelvis", "Armature"))
    nodes = document["nodes"]
    nodes[pelvis]["children"].remove(root)
    nodes[armature]["children"] = [c for c in nodes[armature]["children"] if c != pelvis] + [root]
    nodes[root] = {"name": "root", "children": [pelvis]}
    values = np.frombuffer(bytearray(blob), np.uint8).copy()
    count = document["accessors"][WEIGHTS]["count"]
    start = document["bufferViews"][JOINTS]["byteOffset"]
    bound = values[start : start + 8 * count].view("<u2")
    bound[bound == root] = pelvis
    start = document["bufferViews"][WEIGHTS]["byteOffset"]
    stored = values[start : start + 16 * count].view("<f4").reshape(-1, 4)
    for vertex, row in weights.items():
        stored[vertex] = row
    if change is not None:
        change(document)
    write_glb(path, document, values.tobytes())
    return path


def heard(caplog: pytest.LogCaptureFixture, how: Callable[..., Any], *arguments: Any, **more: Any) -> tuple[Any, str]:
    """What is read, and what is said meanwhile: nothing, or one line."""
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        found = how(*arguments, **more)
    assert len(caplog.messages) <= 1 and "\n" not in caplog.text.strip()
    return found, caplog.messages[0] if caplog.messages else ""


def posed(mesh: RiggedMesh, seed: int = 1) -> np.ndarray:
    points = mesh.posed(Pose(np.random.default_rng(seed).normal(0, 0.4, (len(mesh.skeleton), 3))))
    assert np.isfinite(points).all()
    np.testing.assert_allclose(mesh.weights.sum(axis=1), 1, atol=1e-12)
    assert (mesh.weights >= 0).all()
    return points


@BAD
def test_one_bad_influence_has_no_effect(tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float) -> None:
    """As if its weight was zero, and what is left is normalised."""
    rows = {200: (0.25, bad, 0, 0), 211: (bad, 0.5, 0, 0), 402: (0.5, 0.5, bad, bad)}
    clean = {k: tuple(x if np.isfinite(x) else 0 for x in row) for k, row in rows.items()}
    wanted, silence = heard(caplog, read_gltf_person, person(tmp_path / "a.glb", clean))
    mesh, said = heard(caplog, read_gltf_person, person(tmp_path / "b.glb", rows))
    assert silence == "" and said == f"{tmp_path / 'b.glb'}: holds NaN or infinity: 4 skin weights (left out)"
    assert mesh.skeleton.names == JOINT_NAMES and mesh.meta["rig"] == wanted.meta["rig"]
    np.testing.assert_array_equal(posed(mesh), posed(wanted))
    np.testing.assert_array_equal(mesh.weights, wanted.weights)


@BAD
def test_a_vertex_without_any_other_goes_with_the_root(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float
) -> None:
    """Not with the first joint of the list, nor with the one that the vertex names."""
    rows = {300: (bad, bad, bad, bad), 301: (bad, 0, 0, 0), 602: (0, 0, 0, bad)}
    whole, _ = heard(caplog, read_gltf_person, person(tmp_path / "a.glb", {}))
    for own in (False, True):
        mesh, said = heard(caplog, read_gltf_person, person(tmp_path / "b.glb", rows), own_joints=own)
        assert said.endswith(f": 6 skin weights (left out), 3 {ROOTED}")
        top = "root" if own else "pelvis"
        for vertex in rows:
            assert mesh.skeleton.names[mesh.joints[vertex, 0]] == top and mesh.weights[vertex, 0] == 1
        if own:
            assert mesh.joints[300, 0] != 0 and mesh.skeleton.parents[mesh.joints[300, 0]] < 0
            posed(mesh)
            continue
        others = np.setdiff1d(np.arange(len(whole.vertices)), list(rows))
        np.testing.assert_allclose(posed(mesh)[others], posed(whole)[others], atol=1e-9)
        assert mesh.meta["rig"] == whole.meta["rig"]
    with opened(tmp_path / "b.glb") as start:
        container = read_container(start.file, start.size, start.folder)
        shown = reader._shown(container, graph_of(container.gltf))
        holds = reader._holding(container, shown, [])  # what is there for want of a weight is no sign of a joint
    assert not holds[[node.name for node in container.gltf.nodes].index("root")] and holds.sum() > 20


def test_zero_weights_stay_where_they_were(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A file without NaN is read as ever: of zeros the specification says nothing, viewers take the first joint."""
    path = person(tmp_path / "a.glb", {300: (0, 0, 0, 0)})
    mesh, said = heard(caplog, read_gltf_person, path, own_joints=True)
    assert said == "" and mesh.joints[300, 0] == 0 and mesh.weights[300, 0] == 1


@BAD
def test_texture_coordinates(tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float) -> None:
    uv = UV.copy()
    uv[2, 1], uv[3] = bad, bad
    clean = UV.copy()
    clean[2:] = 0
    mesh, said = heard(caplog, square, tmp_path, TEXCOORD_0=uv)
    assert said.endswith("square.glb: holds NaN or infinity: 2 texture coordinates (now 0, 0)")
    np.testing.assert_array_equal(mesh.parts[0].uv, square(tmp_path, TEXCOORD_0=clean).parts[0].uv)


@BAD
@pytest.mark.parametrize("channels", [3, 4])
def test_colours_of_vertices(tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float, channels: int) -> None:
    colours = np.full((4, channels), 0.25, "<f4")
    colours[1, 0], colours[2] = bad, bad
    material = {"alphaMode": "BLEND"}
    mesh, said = heard(caplog, square, tmp_path, material, COLOR_0=colours)
    assert said.endswith("square.glb: holds NaN or infinity: 2 vertex colours (now white)")
    for vertex in (1, 2):
        assert seen(mesh, *CORNERS[vertex, :2]) == pytest.approx([1, 1, 1, 1], abs=0.003)
    assert seen(mesh, 0.0, 1.0)[0] < 0.6
    whole = np.full((4, channels), bad, "<f4")
    mesh, said = heard(caplog, square, tmp_path, material, COLOR_0=whole)
    assert "4 vertex colours" in said and (mesh.parts[0].texture == 255).all()


def everything(path: Path) -> Path:
    """A person whose weights, texture coordinates and colours are wrong, three parts, in a file."""
    mesh = read_gltf_person(person(path.with_name("whole.glb"), {}))
    part = mesh.parts[0]
    parts = tuple(replace(part, faces=part.faces[k::3], uv=part.uv[k::3], name=f"p{k}") for k in range(3))
    save_gltf_mesh(replace(mesh, parts=parts), path)
    document, blob = glb_parts(path.read_bytes())
    values = np.frombuffer(bytearray(blob), np.uint8).copy()
    for primitive in document["meshes"][0]["primitives"]:
        for name, width in (("WEIGHTS_0", 4), ("TEXCOORD_0", 2)):
            accessor = document["accessors"][primitive["attributes"][name]]
            start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
            values[start : start + 4 * width * 2].view("<f4")[:: 2 * width - 1] = NAN  # the first and the last of two
        primitive["attributes"]["COLOR_0"] = primitive["attributes"]["WEIGHTS_0"]
    write_glb(path, document, values.tobytes())
    return path


SAID = "6 skin weights (left out), 6 texture coordinates (now 0, 0), 6 vertex colours (now white), 3 " + ROOTED


def test_strict_refuses_it(tmp_path: Path) -> None:
    path = everything(tmp_path / "in.glb")
    with pytest.raises(FormatError) as caught:
        load(path, strict=True)
    assert str(caught.value) == f"{path}: holds NaN or infinity: {SAID}; repair the file or load it without strict"


@BAD
def test_points_are_refused_as_ever(tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float) -> None:
    """In one line, without a warning before it; and weights below zero, too."""
    corners = CORNERS.copy()
    corners[1, 2] = bad
    with pytest.raises(FormatError, match=r"square\.glb: a mesh needs finite vertices \(V, 3\), not \(4, 3\)$"):
        heard(caplog, square, tmp_path, POSITION=corners, TEXCOORD_0=np.full((4, 2), NAN, "<f4"))
    with pytest.raises(FormatError, match="weights need numbers from 0 on"):
        heard(caplog, read_gltf_person, person(tmp_path / "a.glb", {5: (NAN, -0.5, 0, 0)}))
    assert caplog.messages == []


@BAD
def test_avatars_of_splats_have_the_same_rule(tmp_path: Path, caplog: pytest.LogCaptureFixture, bad: float) -> None:
    avatar = random_avatar()
    save(avatar, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    document["skins"][0]["joints"].reverse()  # the first of the list hangs from another
    primitive = document["meshes"][0]["primitives"][0]["attributes"]
    start = document["bufferViews"][document["accessors"][primitive["WEIGHTS_0"]]["bufferView"]].get("byteOffset", 0)
    rows = np.array([[0.5, bad, 0.5, 0], [bad, bad, bad, bad], [bad, -1, 1, 0], [1, bad, 0, 0]], "<f4")
    write_glb(tmp_path / "a.glb", document, blob[:start] + rows.tobytes() + blob[start + 64 :])
    found, said = heard(caplog, load, tmp_path / "a.glb")
    assert said.endswith(f"a.glb: holds NaN or infinity: 7 skin weights (left out), 1 {ROOTED}")
    assert isinstance(found, Avatar) and found.skin.repaired == 4
    np.testing.assert_allclose(found.skin.weights.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_array_equal(found.skin.weights[0], [0.5, 0.5, 0, 0])
    top = found.skin.joints[1, 0]
    assert found.skin.weights[1, 0] == 1 and found.skeleton.parents[top] < 0 and top == 0
    with pytest.raises(FormatError, match=r"7 skin weights .*; repair the file or load it without strict"):
        load(tmp_path / "a.glb", strict=True)


def test_a_head_of_lam_names_the_zip(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "head.zip"
    skin = skin_glb()
    at = skin.index(np.array([0.75, 0.25], "<f4").tobytes())
    sh = np.full((4, 1, 3), 0.5, np.float32)
    splats = Splats.create(np.zeros((4, 3)), [[1, 0, 0, 0]] * 4, [[0.1] * 3] * 4, [1] * 4, sh)
    save(splats, tmp_path / "offset.ply")
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(tmp_path / "offset.ply", "offset.ply")
        archive.writestr("skin.glb", skin[:at] + np.float32(NAN).tobytes() + skin[at + 4 :])
    avatar, said = heard(caplog, load_lam_zip, path)
    assert said == f"{path}: skin.glb: holds NaN or infinity: 1 skin weights (left out)"
    assert avatar.skin.joints[1, 0] == 1 and avatar.skin.weights[1, 0] == 1
